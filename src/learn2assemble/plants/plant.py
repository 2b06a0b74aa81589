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

from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple, Protocol

import numpy as np

from learn2assemble.errors import Learn2AssembleError

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
        return between(self, np.minimum(np.maximum(time, 0.0), self.seconds))[:2]


def between(motion: Motion, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and accelerations, each float64[m, n], at times float64[m] within a
    motion of two samples or more."""
    time, q, v = motion.time, motion.joints, motion.velocity
    piece = np.searchsorted(time, at, "right") - 1
    piece = np.minimum(np.maximum(piece, 0), len(time) - 2)
    h = (time[piece + 1] - time[piece])[:, None]
    u = (at - time[piece])[:, None] / h
    v0, v1, d = v[piece] * h, v[piece + 1] * h, q[piece + 1] - q[piece]
    c2, c3 = 3 * d - 2 * v0 - v1, v0 + v1 - 2 * d
    return (
        q[piece] + u * (v0 + u * (c2 + u * c3)),
        (v0 + u * (2 * c2 + 3 * u * c3)) / h,
        (2 * c2 + 6 * u * c3) / h**2,
    )


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


Commands = Sequence[ToolCommand]
Guards = Sequence[Guard]


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

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
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


class WrappedPlant:
    """A plant that stands before another one, and passes on what it has nothing to say about.

    Args:
        plant: the one behind it.
    """

    def __init__(self, plant: Plant) -> None:
        self.plant = plant

    def sense(self) -> Readings:
        """See :class:`Plant`."""
        return self.plant.sense()

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        """See :class:`Plant`."""
        return self.plant.execute(motion, commands, guards)

    def request(self, request: Request) -> Report:
        """See :class:`Plant`."""
        return self.plant.request(request)

    def stop(self) -> None:
        """See :class:`Plant`."""
        self.plant.stop()

    def close(self) -> None:
        """See :class:`Plant`."""
        self.plant.close()


class PlantError(Learn2AssembleError):
    """A plant answered what cannot be, or not at all; the arm was told to stop.

    Args:
        stop: :attr:`Stop.LOST`, :attr:`Stop.LATE`, :attr:`Stop.PROTECTIVE`, or
            :attr:`Stop.REFUSED`, also where an answer was refused.
        why: one line.
    """

    def __init__(self, stop: Stop, why: str) -> None:
        super().__init__(f"plant {stop}: {why}")
        self.stop = stop
        self.why = why

    def __reduce__(self) -> tuple[type[PlantError], tuple[Stop, str]]:
        return PlantError, (self.stop, self.why)
