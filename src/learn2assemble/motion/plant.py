"""What stands between the side that decides and the cell in which things happen.

A *plant* is an arm with its tool and whatever is on the table: simulated (``sim://``), or behind
the controller of a robot. It answers what it senses, carries motions out one after the other, and
says how far each came and why it ended. The side that decides knows of the world what
:class:`Readings` and :class:`Report` say and nothing else; so these are values that can be sent to
another process or machine as they are.

All of them are frozen; whoever makes one gives away its arrays. World frame: z up, the top of the
table at 0; quaternions (w, x, y, z); metres, radians, seconds, newtons, kilograms.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from enum import StrEnum
from typing import Any, NamedTuple, Protocol

import numpy as np

from learn2assemble.errors import InputError, Learn2AssembleError, look_up
from learn2assemble.motion.settings import ProgramSettings
from learn2assemble.registry import Registry, add_plugin
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.bodies import Shape
from learn2assemble.robot.studs import Studs

# ---------------------------------------------------------------- what is sensed


class BlockReading(NamedTuple):
    """A block as it was seen."""

    block: str
    """Its name, as the plan or a :class:`Request` says it."""
    pose: np.ndarray
    """float64[7]: position [m] and quaternion of the frame of its shape, world frame."""
    covariance: np.ndarray
    """float64[6, 6] of what the pose is off: position [m], then a small rotation about the axes of
    the world [rad]. Zero where the reading is exact."""
    time: float
    """When it was seen [s of the plant's clock]; older readings may come late."""


class ToolReading(NamedTuple):
    """What the tool feels."""

    vacuum: bool | None = None
    """Of a suction tool: whether the vacuum is made, that is, something closes the lip."""
    width: float | None = None
    """Of fingers: between the pads [m]."""
    grip: float | None = None
    """Of fingers: what they press with [N]."""
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """On the tool and what it holds from what they touch, weight and inertia taken off; world
    frame [N]."""


class Readings(NamedTuple):
    """All that is sensed at one moment."""

    time: float
    """[s of the plant's clock]"""
    joints: np.ndarray
    """float64[n] as measured [rad]."""
    velocity: np.ndarray
    """float64[n] [rad/s]."""
    blocks: tuple[BlockReading, ...]
    """Blocks that were seen; one that is not listed was not."""
    tool: ToolReading
    arm: str
    """Name of the arm, see :mod:`learn2assemble.robot.registry`."""
    state: str = "ready"
    """One of :data:`STATES`."""


STATES = ("ready", "moving", "stopped")
"""``stopped``: a protective stop, which a person has to clear."""


# ---------------------------------------------------------------- what is asked


class Motion(NamedTuple):
    """Where the joints shall be; from rest to rest, within the limits of the arm.

    An empty motion (no samples) does not wait. Two samples at one position wait, standing still.
    """

    stage: str
    """One of :data:`~learn2assemble.robot.moves.STAGES`."""
    time: np.ndarray
    """float64[T], increasing from 0 [s]."""
    joints: np.ndarray
    """float64[T, n] [rad]; the first one is where the arm is."""
    velocity: np.ndarray
    """float64[T, n] [rad/s]. Between two samples it is the cubic with these positions and
    velocities."""

    @property
    def seconds(self) -> float:
        """How long it takes [s]."""
        return float(self.time[-1]) if len(self.time) else 0.0

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities, each float64[m, n], at times float64[m]; it stands where it
        has one sample."""
        if len(self.time) < 2:
            there = np.repeat(self.joints[:1], len(time), 0)
            return there, np.zeros_like(there)
        k = np.clip(np.searchsorted(self.time, time, "right") - 1, 0, len(self.time) - 2)
        h = np.diff(self.time)[k][:, None]
        u = (np.clip(time, 0.0, self.seconds) - self.time[k])[:, None] / h
        q0, q1 = self.joints[k], self.joints[k + 1]
        v0, v1 = self.velocity[k] * h, self.velocity[k + 1] * h
        bend, third = 3 * (q1 - q0) - 2 * v0 - v1, v0 + v1 - 2 * (q1 - q0)
        q = q0 + u * (v0 + u * (bend + u * third))
        return q, (v0 + u * (2 * bend + 3 * u * third)) / h


def standing(stage: str, joints: np.ndarray, seconds: float) -> Motion:
    """To wait at joints float64[n] [rad]."""
    two = np.stack([joints, joints])
    return Motion(stage, np.array([0.0, seconds]), two, np.zeros_like(two))


class ToolCommand(NamedTuple):
    """What the tool, or the controller about it, is told at some instant of a motion; None: as
    before."""

    at: float = 0.0
    """[s of the motion]"""
    vacuum: bool | None = None
    width: float | None = None
    """Opening between the pads to go to [m]; with a ``force`` what they are to close on."""
    force: float = 0.0
    """To hold with [N]; 0: only move."""
    speed: float = 0.0
    """Of the opening [m/s]; 0: that of the tool."""
    load: float | None = None
    """Mass at the tool from then on [kg]."""


class Guard(NamedTuple):
    """When a motion ends early. Several may follow one another; each holds until the next begins.
    Where one is broken, the arm brakes on its path and stands."""

    begin: float = 0.0
    """From then on [s of the motion]."""
    contact: float | None = None
    """Wanted: ends as soon as what is held, or the empty tool, rests on something with so much
    force [N] against the way it comes (:attr:`Stop.CONTACT`)."""
    bears: bool = False
    """Where a contact is wanted: the controller bears most of the force, so that the arm does not
    give way, and eases it when it stands; for what is pressed home on studs."""
    force: float | None = None
    """Not wanted: stops where the arm or its tool touches anything but what it holds with so much
    [N] (:attr:`Stop.FORCE`)."""
    held: float | None = None
    """The same of what it holds [N]. A plant that cannot tell the two apart takes the smaller."""
    hold: str | None = None
    """``"made"``: ends as soon as the vacuum is made, or the fingers press (:attr:`Stop.HELD`);
    ``"kept"``: stops where it is lost (:attr:`Stop.VACUUM`, :attr:`Stop.WIDTH`)."""
    taken: float | None = None
    """Not wanted: the same as ``force`` between the empty tool and what it comes to [N]. A plant
    that cannot tell the two apart takes the smaller."""
    width: tuple[float, float] | None = None
    """Stops where the opening between the pads leaves this range [m] (:attr:`Stop.WIDTH`)."""


class Request(NamedTuple):
    """What others in the cell do while the arm stands: a magazine, a person."""

    what: str
    """``present``: the magazine presents this block; ``return``: it takes it back; ``place``,
    ``remove``: a person puts the block where it shall be, or takes it away; ``join``: nobody does
    anything, but a simulation, in which studs do not hold, is told that the block clutches the one
    called ``kind`` and follows it until that is let go."""
    block: str
    """From now on it is called so."""
    kind: str
    """The block of the plan whose shape it has."""
    pose: np.ndarray
    """float64[7]: where it shall be then, or was before."""


REQUESTS = ("present", "return", "place", "remove", "join")


# ---------------------------------------------------------------- what came of it


class Stop(StrEnum):
    """Why a motion ended."""

    END = "end"
    """It was carried out."""
    CONTACT = "contact"
    """Contact was made, as wanted."""
    HELD = "held"
    """The tool has taken hold, as wanted."""
    FORCE = "force"
    """Something was touched."""
    VACUUM = "vacuum"
    """What was held came off the cup."""
    WIDTH = "width"
    """The fingers are closed further, or opened wider, than they may be."""
    PROTECTIVE = "protective"
    """The controller stopped the arm by itself."""
    REFUSED = "refused"
    """The controller did not take the motion."""
    LOST = "lost"
    """The connection was lost."""
    LATE = "late"
    """No answer in time."""


class Played(NamedTuple):
    """What the drives were told, braking included, at times float64[t] after those of the motion
    before."""

    time: np.ndarray
    """float64[t] [s of the plant's clock]"""
    joints: np.ndarray
    """float64[t, n] [rad]"""
    velocity: np.ndarray
    """float64[t, n] [rad/s]"""
    width: np.ndarray
    """float64[t]: opening between the pads as it was [m]; 0 for a suction tool."""
    command: np.ndarray
    """float64[t]: opening the fingers were told [m]; for a suction tool 1 with the vacuum on, else
    0."""


class Report(NamedTuple):
    """What came of a motion; the arm stands."""

    stop: Stop
    done: float
    """Share of the motion that was carried out, 0 to 1, by its time."""
    joints: np.ndarray
    """float64[n] where the arm was told to be at the end [rad]; the next motion begins there."""
    seconds: float
    """How long it took [s of the plant's clock]."""
    detail: str = ""
    """Why, in one line, where it is known."""
    tool: ToolReading = ToolReading()
    """What the tool felt at the end."""
    played: Played | None = None
    """How it went, at 50 samples a second or more, where the plant knows."""


class Plant(Protocol):
    """An arm with its tool and the world it works in. One thread at a time uses it."""

    def sense(self) -> Readings:
        """What is sensed now."""
        ...

    def execute(
        self,
        motion: Motion,
        commands: Sequence[ToolCommand] = (),
        guards: Sequence[Guard] = (),
    ) -> Report:
        """Carry a motion out, and return when the arm stands.

        Args:
            motion: from where the arm is.
            commands: in the order of their times.
            guards: in the order of their times; none: nothing ends it early.
        """
        ...

    def request(self, request: Request) -> Report:
        """Let a magazine or a person do something, and return when it is done."""
        ...

    def stop(self) -> None:
        """The arm stands; as often as one likes."""
        ...

    def close(self) -> None:
        """Give the plant back; the arm stands."""
        ...


# ---------------------------------------------------------------- how one is opened


class BlockKind(NamedTuple):
    """What a block is, by the name that it has in the plan."""

    shape: Shape
    density: float
    """[kg/m3]; from :data:`~learn2assemble.robot.moves.IMMOVABLE` on nothing moves it."""


UNWANTED = 2.5
"""See :attr:`Surroundings.feel`."""


class Surroundings(NamedTuple):
    """What belongs to a cell beside the controller of its arm; a simulated one needs none of it."""

    program: ProgramSettings = ProgramSettings()
    """Which output and input the tool is wired to, and how far the arm may be from where a motion
    begins."""
    look: Callable[[], Sequence[BlockReading]] | None = None
    """Cameras or tags: called whenever the plant is asked what it senses; None: no block is ever
    seen."""
    serve: Callable[[Request], None] | None = None
    """Magazines and people: returns when a request has been met; None: all are met at once, as by
    magazines that are never empty."""
    feel: float = 8.0
    """Smallest force that the robot can tell from noise [N]: so much counts as a contact that is
    wanted, and :data:`UNWANTED` times as much as one that is not."""
    trust_placements: bool = False
    """Where nothing sees blocks, they are taken to be where they were put."""
    patience: float = 0.25
    """Longest silence towards the controller before the arm stops by itself [s of its clock]."""
    silence: float = 0.25
    """Longest silence of the controller before it counts as lost [s of this machine]."""
    answer: float = 2.0
    """In which a controller has to begin with what it was told [s of this machine]."""


class Noise(NamedTuple):
    """Of readings: standard deviations, and what becomes of them."""

    place: float = 0.0
    """x and y [m]"""
    turn: float = 0.0
    """About each axis [rad]"""
    height: float | None = None
    """z [m]; None: as x and y."""
    missing: float = 0.0
    """Share of readings of blocks that are missing."""
    outliers: float = 0.0
    """Share that is off by far."""
    late: float = 0.0
    """Share that is as old as the look before."""


class Disturbance(NamedTuple):
    """What goes otherwise than planned in a simulated cell."""

    supply: tuple[float, float] = (0.0, 0.0)
    """Standard deviations of where a presented block stands [m] and of its yaw [rad]."""
    friction: float = 0.0
    """Share by which friction differs, and ..."""
    mass: float = 0.0
    """... largest share by which masses differ."""
    drop: frozenset[int] = frozenset()
    """Numbers of grasps, from 1, after which the block is let go on the way."""
    push: frozenset[int] = frozenset()
    """Numbers of grasps after whose return a block that carries nothing is pushed by 15 mm."""
    table: tuple[float, float] = (0.0, 0.0)
    """Largest height by which the table is off [m], and largest angle it leans by [rad]."""
    height: float = 0.0
    """Largest amount by which blocks are higher or lower than meant [m]."""


class Simulated(NamedTuple):
    """What a simulated plant is; others do not look at it."""

    physics: str = "dynamic"
    """``dynamic``, or ``kinematic``: blocks follow the hand and stay where they are let go."""
    seed: int = 0
    noise: Noise = Noise()
    disturbance: Disturbance = Disturbance()


class Setup(NamedTuple):
    """The cell as its owner describes it, that is, as it is meant to be."""

    arm: Arm
    """With its tool, at its place."""
    kinds: Mapping[str, BlockKind]
    """Blocks of the plan by their names."""
    waiting: Mapping[str, np.ndarray]
    """float64[7]: poses of those that lie on the table from the beginning; all others are in
    magazines until they are presented."""
    fixed: tuple[tuple[BlockKind, np.ndarray], ...] = ()
    """Obstacles, and their poses float64[7]."""
    friction: float = 0.5
    """Of blocks on one another and on the table."""
    joints: np.ndarray | None = None
    """float64[n] where the arm stands [rad]; None: at home."""
    studs: Studs | None = None
    """Where blocks clutch: the joints they have where they belong. Their cells are numbers of
    ``kinds``; a block that is called otherwise has those of its kind."""
    around: Surroundings = Surroundings()
    simulated: Simulated = Simulated()


PLANTS: Registry[Callable[[str, Setup], Plant]] = Registry("plant", {})
"""What opens a plant, by the scheme of its address: called with what follows ``SCHEME://`` and the
cell as it is meant to be."""
add_plugin("learn2assemble.simulation.plant", "plant")


def check_address(address: str) -> tuple[str, str]:
    """Scheme and place of an address.

    Raises:
        InputError: for an address without a scheme, and for a scheme nobody knows.
    """
    scheme, mark, place = address.partition("://")
    if not mark:
        raise InputError("robot", address, "an address as sim:// or ur://HOST")
    look_up("robot", scheme, PLANTS)
    return scheme, place


def open_plant(address: str, setup: Setup) -> Plant:
    """The plant behind an address, as ``sim://`` or ``ur://192.168.0.2``.

    Raises:
        InputError: see :func:`check_address`; also for a place that is none.
        PlantError: where nobody answers, or another arm.
    """
    scheme, place = check_address(address)
    return PLANTS[scheme](place, setup)


# ---------------------------------------------------------------- answers that make no sense


class PlantError(Learn2AssembleError):
    """A plant answered what cannot be, or not at all; the arm was told to stop.

    Args:
        stop: :attr:`Stop.LOST`, :attr:`Stop.LATE`, :attr:`Stop.PROTECTIVE`, or
            :attr:`Stop.REFUSED`, also where an answer was refused.
        why: one line.
    """

    def __init__(self, stop: Stop, why: str) -> None:
        super().__init__(f"plant {stop}: {why}")
        self.stop, self.why = stop, why

    def __reduce__(self) -> tuple[type[PlantError], tuple[Stop, str]]:
        return PlantError, (self.stop, self.why)


CLOCK_SLACK = 1e-6
"""By so much readings may lie in the future, and the clock go back [s]."""
SYMMETRY = 1e-9
"""Covariances are symmetric, and their eigenvalues not negative, but for this share."""


class Checked:
    """A plant whose answers are looked at before anyone sees them: names, shapes, finite numbers,
    unit quaternions, covariances that are some, a clock that does not go back, readings that are
    not older than ``oldest``. What makes no sense stops the arm and raises.

    Args:
        plant: the one behind it.
        arm: name of the arm it has to be.
        joints: how many joints that has.
        names: of blocks there are; asked at every reading, as replacements come.
        oldest: age of the oldest reading that is used [s]; older ones are left out.

    Raises:
        PlantError: from all its methods but ``stop`` and ``close``.
    """

    def __init__(
        self,
        plant: Plant,
        arm: str,
        joints: int,
        names: Collection[str],
        oldest: float = math.inf,
    ) -> None:
        self.plant, self.arm, self.count, self.names = plant, arm, joints, names
        self.oldest, self.clock = oldest, -math.inf

    def sense(self) -> Readings:
        """See :class:`Plant`; readings that came too late are left out."""
        found = self._asked(self.plant.sense)
        why = self._odd_readings(found)
        if why:
            self._refuse(why)
        self.clock = found.time
        kept = tuple(one for one in found.blocks if found.time - one.time <= self.oldest)
        return found._replace(blocks=kept)

    def execute(
        self,
        motion: Motion,
        commands: Sequence[ToolCommand] = (),
        guards: Sequence[Guard] = (),
    ) -> Report:
        """See :class:`Plant`."""
        return self._reported(self._asked(self.plant.execute, motion, commands, guards))

    def request(self, request: Request) -> Report:
        """See :class:`Plant`."""
        return self._reported(self._asked(self.plant.request, request))

    def stop(self) -> None:
        """See :class:`Plant`."""
        self.plant.stop()

    def close(self) -> None:
        """See :class:`Plant`."""
        self.plant.close()

    def _asked(self, method: Callable[..., Any], *given: object) -> Any:
        """Its answer, whatever the plant is; errors of the connection as ours."""
        try:
            return method(*given)
        except PlantError as error:
            self._halt()
            raise error from None
        except TimeoutError as error:
            self._halt()
            raise PlantError(Stop.LATE, _line(error)) from error
        except (OSError, EOFError) as error:
            self._halt()
            raise PlantError(Stop.LOST, _line(error)) from error

    def _reported(self, report: Report) -> Report:
        why = self._odd_report(report)
        if why:
            self._refuse(why)
        if report.stop in (Stop.LOST, Stop.LATE, Stop.REFUSED, Stop.PROTECTIVE):
            self._halt()
            raise PlantError(report.stop, report.detail or "the plant says so")
        return report

    def _refuse(self, why: str) -> None:
        self._halt()
        raise PlantError(Stop.REFUSED, why)

    def _halt(self) -> None:
        try:
            self.plant.stop()
        except (OSError, EOFError, PlantError):
            return  # Nobody hears it; the plant stops by itself when its connection ends.

    def _odd_readings(self, found: object) -> str:
        """What makes no sense in readings, in words; empty where nothing does."""
        if not isinstance(found, Readings):
            return f"an answer of type {type(found).__name__} instead of readings"
        if not _finite(found.time):
            return "readings without a time"
        if found.time < self.clock - CLOCK_SLACK:
            return f"the clock went back by {self.clock - found.time:.3f} s"
        if found.arm != self.arm:
            return f"an arm {found.arm!r}, not {self.arm!r}"
        if found.state not in STATES:
            return f"a state {found.state!r}"
        for name, array in (("joints", found.joints), ("velocity", found.velocity)):
            if not _numbers(array, (self.count,)):
                return f"{name} that are not {self.count} finite numbers"
        seen: set[str] = set()
        for one in found.blocks:
            why = self._odd_block(one, found.time, seen)
            if why:
                return why
        return _odd_tool(found.tool)

    def _odd_block(self, one: object, now: float, seen: set[str]) -> str:
        if not isinstance(one, BlockReading):
            return f"a reading of type {type(one).__name__}"
        if not isinstance(one.block, str) or one.block not in self.names:
            return f"a reading of a block {one.block!r} that does not exist"
        if one.block in seen:
            return f"two readings of {one.block}"
        seen.add(one.block)
        if not _finite(one.time) or one.time > now + CLOCK_SLACK:
            return f"a reading of {one.block} from the future"
        if not _numbers(one.pose, (7,)) or abs(float(np.linalg.norm(one.pose[3:])) - 1) > 1e-6:
            return f"a pose of {one.block} that is none"
        if not covariance_is_sound(one.covariance):
            return f"a covariance of {one.block} that is none"
        return ""

    def _odd_report(self, report: object) -> str:
        if not isinstance(report, Report):
            return f"an answer of type {type(report).__name__} instead of a report"
        if not isinstance(report.stop, Stop):
            return f"an end {report.stop!r}"
        if not (_finite(report.done) and 0 <= report.done <= 1):
            return f"a share {report.done!r} of a motion"
        if not (_finite(report.seconds) and report.seconds >= 0):
            return f"a motion of {report.seconds!r} s"
        if not _numbers(report.joints, (self.count,)):
            return f"joints that are not {self.count} finite numbers"
        return _odd_tool(report.tool)


def covariance_is_sound(matrix: object) -> bool:
    """Whether it is a float64[6, 6] of finite numbers, symmetric, with no negative eigenvalue."""
    if not isinstance(matrix, np.ndarray) or not _numbers(matrix, (6, 6)):
        return False
    size = float(np.abs(matrix).max())
    if size == 0:
        return True
    if float(np.abs(matrix - matrix.T).max()) > SYMMETRY * size:
        return False
    return float(np.linalg.eigvalsh(matrix)[0]) >= -SYMMETRY * size


def _odd_tool(tool: object) -> str:
    if not isinstance(tool, ToolReading):
        return f"a tool of type {type(tool).__name__}"
    if tool.vacuum not in (None, True, False):
        return f"a vacuum {tool.vacuum!r}"
    for name, value in (("width", tool.width), ("grip", tool.grip)):
        if value is not None and not _finite(value):
            return f"a {name} {value!r} of the fingers"
    if not (
        isinstance(tool.force, tuple) and len(tool.force) == 3 and all(map(_finite, tool.force))
    ):
        return "a force that is not three finite numbers"
    return ""


def _finite(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _numbers(value: object, shape: tuple[int, ...]) -> bool:
    return (
        isinstance(value, np.ndarray)
        and value.shape == shape
        and value.dtype == np.float64
        and bool(np.isfinite(value).all())
    )


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
