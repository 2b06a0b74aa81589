"""What the arm did in a whole build, and whether such a record is sound.

One sequence of samples at a fixed rate, cut into steps; a step is one attempt to pick up an object
and to put it down. Cells are numbered as the blocks of the plan. Times count from the beginning of
the build. The fields are described in ``docs/trajectory.md``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.geometry.hulls import Hull
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.moves import Outcome
from learn2assemble.robot.studs import Studs

RATE = 50.0
"""Samples per second."""


class Stage(NamedTuple):
    """A part of a step."""

    name: str
    """One of :data:`~.moves.STAGES`."""
    start: float
    """[s]."""
    end: float
    """[s]."""


@dataclass(frozen=True, eq=False)
class ArmFacts:
    """The arm of a record: what a reader of its samples has to know."""

    name: str
    joints: tuple[str, ...]
    lower: np.ndarray
    """float64[n] [rad]."""
    upper: np.ndarray
    """float64[n] [rad]."""
    velocity: np.ndarray
    """float64[n], largest magnitude [rad/s]."""
    acceleration: np.ndarray
    """float64[n], largest magnitude [rad/s^2]."""
    base_position: np.ndarray
    """float64[3] [m, world]."""
    base_yaw: float
    """Turn of the base about z [rad]."""
    tool: str
    """Name of the tool frame."""
    max_width: float
    """Largest opening between the pads [m]; 0 for a suction tool."""
    tool_name: str = "gripper"
    """What it holds blocks with, a name of :data:`~.registry.TOOLS`."""
    suction: bool = False
    """It does so with a cup; commands of the tool are then 1 (vacuum on) and 0 (off)."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Joint motion at equal steps of time; T may be 0."""

    time: np.ndarray
    """float64[T] [s]."""
    joints: np.ndarray
    """float64[T, n], commanded positions [rad]."""
    velocity: np.ndarray
    """float64[T, n], commanded velocities [rad/s]."""
    width: np.ndarray
    """float64[T], opening between the pads as it was [m]; 0 for a suction tool."""
    command: np.ndarray
    """float64[T], what the tool was told: the opening [m], less than what it holds where it
    presses; for a suction tool 1 (vacuum on) or 0 (off)."""


@dataclass(frozen=True, eq=False)
class StepRecord:
    """One attempt to pick up an object and to put it down."""

    number: int
    """1, 2, ... in the order of execution."""
    plan_step: int | None
    """The step of ``plan.json`` it carries out, also where it failed and was tried again; None
    where the plan has no such step (any more)."""
    cells: tuple[int, ...]
    """Cells of the object, the grasped one first; of several that are brought as one, all."""
    target: np.ndarray
    """float64[7]: pose the grasped cell shall have."""
    outcome: Outcome
    detail: str
    """Why it failed, in one line; empty for a success."""
    replanned: bool
    """After it the rest of the build was planned anew from where the blocks really were."""
    stages: tuple[Stage, ...]
    grip: float | None
    """When the object follows the hand from [s]; None: never."""
    release: float | None
    """When it does not any more, on purpose or not [s]; None: never held, or still at the end."""
    samples: Samples
    before: np.ndarray
    """float64[C, 7]: poses of all cells before the step: x, y, z [m, world], quaternion
    (w, x, y, z)."""
    after: np.ndarray
    """The same when everything has come to rest, as it was seen."""
    truth: np.ndarray | None = None
    """The same as it really was, which a simulation tells when the build is over; None: nobody
    tells, or all was seen exactly."""
    source: np.ndarray | None = None
    """float64[7]: pose in which the grasped cell is meant to wait; None: nobody tells, or it was
    seen exactly."""

    @property
    def seconds(self) -> float:
        """How long the arm takes for it [s]."""
        return float(np.ptp(self.samples.time)) if len(self.samples.time) else 0.0

    @property
    def error(self) -> float:
        """Distance of the grasped cell from where it should stand, at the end [m]."""
        return float(np.linalg.norm(self.after[self.cells[0], :3] - self.target[:3]))

    def stage_at(self, time: float) -> str:
        """The stage at a time [s]; empty outside all of them."""
        for stage in reversed(self.stages):
            if stage.start - 1e-9 <= time <= stage.end + 1e-9:
                return stage.name
        return ""


class ByHand(NamedTuple):
    """A block is placed or taken away by hand, while the arm waits."""

    after: int
    """So many steps of the arm come before it."""
    cells: tuple[int, ...]
    """Of the block."""
    name: str
    """What the block is called."""
    place: bool
    """It is placed, rather than taken away."""
    time: float | None = None
    """When, on the clock of the record, which two arms share [s]; None: not told."""
    poses: tuple[tuple[float, ...], ...] = ()
    """Where its cells are then: x, y, z [m, world], quaternion (w, x, y, z); empty: not told."""

    @classmethod
    def read(cls, told: Sequence[Any]) -> ByHand:
        """From a list of the fields, of which older files have fewer.

        Raises:
            TypeError, ValueError: for what is none.
        """
        after, cells, name, place, *more = told
        time = None if not more else float(more[0])
        poses = tuple(tuple(map(float, pose)) for pose in (more[1] if more[1:] else ()))
        return cls(int(after), tuple(map(int, cells)), str(name), place is True, time, poses)

    @property
    def words(self) -> str:
        """What has to be done, in words."""
        return f"by hand: {'place' if self.place else 'take away'} {self.name}"


@dataclass(frozen=True, eq=False)
class BuildRecord:
    """A build by an arm."""

    arm: ArmFacts
    rate: float
    """Samples per second."""
    block_edge: float
    """[m]."""
    objects: tuple[tuple[int, ...], ...]
    """Cells of every rigid object; each cell of the build is in exactly one."""
    simulated_by: str
    """What the outcomes come from, in words."""
    steps: tuple[StepRecord, ...]
    half: np.ndarray | None = None
    """float64[C, 3]: half extents of the box of each cell in its own frame [m]; None: all are
    cubes with edge ``block_edge``."""
    density: np.ndarray | None = None
    """float64[C] of each cell [kg/m3], see :class:`~.moves.Scene`; None: that of the cubes."""
    hull: tuple[Hull | None, ...] | None = None
    """Of each cell about its centre, where it is no box; None: all are boxes."""
    hands: tuple[ByHand, ...] = ()
    """What was done by hand, in its order."""
    studs: Studs | None = None
    """Joints of studs that bricks make in the structure, in cells; None: there are none."""
    names: tuple[str, ...] = ()
    """What the plan calls every object, obstacles ``""``; empty where that is not told."""
    kinds: tuple[str, ...] = ()
    """Kind of every object, as ``names``."""

    @property
    def num_cells(self) -> int:
        return sum(map(len, self.objects))

    def spans(self) -> list[tuple[float, float]]:
        """Start and end of every step [s]; one without samples takes no time."""
        now, found = 0.0, list[tuple[float, float]]()
        for step in self.steps:
            start = now
            if len(step.samples.time):
                now = float(step.samples.time[-1])
            found.append((start, now))
        return found

    def joined(self) -> tuple[Samples, np.ndarray]:
        """All samples in a row, and int64[T], the number of the step of each."""
        n, found = len(self.arm.joints), list[np.ndarray]()
        none = Samples(np.empty(0), np.empty((0, n)), np.empty((0, n)), np.empty(0), np.empty(0))
        for parts in zip(*(vars(one.samples).values() for one in self.steps), strict=True):
            found.append(np.concatenate(parts))
        numbers = [np.full(len(step.samples.time), step.number) for step in self.steps]
        return Samples(*found) if found else none, np.concatenate([np.empty(0, np.int64), *numbers])


def arm_facts(arm: Arm) -> ArmFacts:
    """What a record says about an arm."""
    return ArmFacts(
        arm.name,
        arm.joints,
        arm.lower,
        arm.upper,
        arm.velocity,
        arm.acceleration,
        arm.base_position,
        arm.base_yaw,
        arm.tool,
        arm.gripper.max_width,
        arm.tool_name,
        arm.suction is not None,
    )


GRAIN = 1e-6
"""Numbers are rounded to this, which is all the slack the limits get [rad], [rad/s], [m]."""
WIDTH_SPEED = 1.0
"""No opening between pads changes faster; what does is a jump in the record [m/s]."""


def require_sound(record: BuildRecord) -> None:
    """Refuse a record that is not sound.

    Raises:
        InputError: saying what is wrong, in one line.
    """
    fault = find_fault(record)
    if fault is not None:
        raise InputError("trajectory", fault, "a motion within the limits, without jumps")


def find_fault(record: BuildRecord) -> str | None:
    """The first thing that is wrong with a record, in one line; None where nothing is."""
    checks = (_structure, _times, _motion, _steps)
    return next((fault for check in checks for fault in check(record)), None)


def _structure(record: BuildRecord) -> Iterator[str]:
    cells = sorted(cell for cells in record.objects for cell in cells)
    count, arm, n = len(cells), record.arm, len(record.arm.joints)
    if cells != list(range(count)):
        yield f"objects: cells {cells} are not 0 to {count - 1}, each once"
    if not record.rate > 0:
        yield f"rate: {record.rate:g} samples per second"
    for what in ("lower", "upper", "velocity", "acceleration"):
        if getattr(arm, what).shape != (n,):
            yield f"arm.{what}: {len(getattr(arm, what))} numbers for {n} joints"
    for what, given, shape, words in (
        ("half", record.half, (count, 3), "three lengths"),
        ("density", record.density, (count,), "a number"),
    ):
        if given is not None and (given.shape != shape or not (given > 0).all()):
            yield f"{what}: not {words} above 0 for each of {count} cells"
    if record.hull is not None and len(record.hull) != count:
        yield f"hull: {len(record.hull)} entries for {count} cells"
    own = [set(c) for c in record.objects]
    for hand in record.hands:
        if set(hand.cells) not in own or not 0 <= hand.after <= len(record.steps):
            yield f"hands: cells {list(hand.cells)} after step {hand.after} are none of the build"
        if hand.time is not None and not np.isfinite(hand.time):
            yield f"hands: {hand.words} at {hand.time:g} s"
        shapes = [len(pose) == 7 and bool(np.isfinite(pose).all()) for pose in hand.poses]
        if len(shapes) not in (0, len(hand.cells)) or not all(shapes):
            yield f"hands: {hand.words}: not 7 numbers for each of {len(hand.cells)} cells"
    for k, step in enumerate(record.steps, 1):
        if step.number != k:
            yield f"step {step.number}: should have number {k}"
        if not are_objects(step.cells, record.objects, record.studs):
            yield f"step {k}: cells {list(step.cells)} are no object of the build"
        truth = step.after if step.truth is None else step.truth
        for what, poses in (("before", step.before), ("after", step.after), ("truth", truth)):
            if poses.shape != (count, 7):
                yield f"step {k}: {what} does not hold 7 numbers for each of {count} cells"
            elif np.abs(np.linalg.norm(poses[:, 3:], axis=1) - 1).max(initial=0.0) > 1e-4:
                yield f"step {k}: {what} holds a quaternion that is not of length 1"
        if step.source is not None and abs(np.linalg.norm(step.source[3:]) - 1) > 1e-4:
            yield f"step {k}: source holds a quaternion that is not of length 1"
        arrays, long = list(vars(step.samples).values()), len(step.samples.time)
        if [array.shape for array in arrays] != [(long,), (long, n), (long, n), (long,), (long,)]:
            yield f"step {k}: its samples differ in number"
        if not all(
            np.isfinite(array).all() for array in (*arrays, step.before, step.after, step.target)
        ):
            yield f"step {k}: a number is not finite"


def are_objects(
    cells: Sequence[int], objects: Sequence[Sequence[int]], studs: Studs | None
) -> bool:
    """Whether cells are those of an object; where there are studs, perhaps those of several, which
    are brought as one."""
    own = set(cells)
    touched = [set(one) for one in objects if own & set(one)]
    whole = bool(own) and len(own) == len(cells) and own == set[int]().union(*touched)
    return whole and (studs is not None or len(touched) == 1)


def _times(record: BuildRecord) -> Iterator[str]:
    samples, number = record.joined()
    wanted = np.arange(len(samples.time)) / record.rate
    for i in np.flatnonzero(np.abs(samples.time - wanted) > 2 * GRAIN).tolist():
        yield (
            f"step {number[i]}: sample {i} of the build is at {samples.time[i]:.6g} s, at "
            f"{record.rate:g} per second it should be at {wanted[i]:.6g} s"
        )
    for step, (before, end) in zip(record.steps, record.spans(), strict=True):
        for stage in step.stages:
            if not (before - GRAIN <= stage.start <= stage.end <= end + GRAIN):
                yield (
                    f"step {step.number}: stage {stage.name} from {stage.start:g} to "
                    f"{stage.end:g} s lies outside {before:g} to {end:g} s"
                )
            before = stage.end


def _motion(record: BuildRecord) -> Iterator[str]:
    """Limits; and positions follow from velocities: what the limits on acceleration cannot explain
    is a jump."""
    samples, number = record.joined()
    arm, rate, period = record.arm, record.rate, 1 / record.rate
    q, v, width = samples.joints, samples.velocity, samples.width

    def at(i: int) -> str:
        return f"step {number[i]}, t = {samples.time[i]:.2f} s"

    for i, j in np.argwhere((q < arm.lower - GRAIN) | (q > arm.upper + GRAIN)).tolist():
        limits = f"limits {arm.lower[j]:.4f} to {arm.upper[j]:.4f}"
        yield f"{at(i)}: {arm.joints[j]} is at {q[i, j]:.4f} rad, {limits}"
    # Mean over a sample, too, which the commanded velocity at its ends does not show.
    mean = np.abs(np.diff(q, axis=0)) * rate
    fast = np.maximum(np.abs(v), np.vstack([np.zeros((min(len(v), 1), v.shape[1])), mean]))
    for i, j in np.argwhere(fast > arm.velocity + GRAIN * (1 + 2 * rate)).tolist():
        speed = f"{fast[i, j]:.4f} rad/s, limit {arm.velocity[j]:.4f}"
        yield f"{at(i)}: {arm.joints[j]} moves at {speed}"
    rest = np.zeros((min(len(v), 1), v.shape[1]))  # before the first sample and after the last
    change = np.abs(np.diff(np.vstack([rest, v, rest]), axis=0)) * rate
    for i, j in np.argwhere(change > arm.acceleration + 2 * GRAIN * rate).tolist():
        much = f"{change[i, j]:.4f} rad/s^2, limit {arm.acceleration[j]:.4f}"
        yield f"{at(min(i, len(v) - 1))}: {arm.joints[j]} accelerates at {much}"
    for i in np.flatnonzero((width < -GRAIN) | (width > arm.max_width + GRAIN)).tolist():
        open_by = f"{1000 * width[i]:.3f} mm, limits 0 to {1000 * arm.max_width:g}"
        yield f"{at(i)}: the gripper is open {open_by}"
    told = samples.command if arm.suction else np.zeros(0)
    for i in np.flatnonzero((told != 0) & (told != 1)).tolist():
        yield f"{at(i)}: the vacuum is told {told[i]:g}, neither 0 nor 1"
    gap = np.abs(np.diff(q, axis=0) - period * (v[1:] + v[:-1]) / 2)
    slack = arm.acceleration * period**2 / 4 + GRAIN * (1 + period)
    for i, j in np.argwhere(gap > slack).tolist():
        yield f"{at(i + 1)}: {arm.joints[j]} jumps by {gap[i, j]:.4f} rad against its velocity"
    jump = np.abs(np.diff(width))
    for i in np.flatnonzero(jump > WIDTH_SPEED * period + GRAIN).tolist():
        yield f"{at(i + 1)}: the gripper jumps by {1000 * jump[i]:.1f} mm"


def _steps(record: BuildRecord) -> Iterator[str]:
    last = None
    for step, (start, end) in zip(record.steps, record.spans(), strict=True):
        k, reached = step.number, step.outcome == Outcome.REACHED
        if reached and (step.grip is None or step.release is None):
            yield f"step {k}: reached, but the object is never held and released"
        if step.grip is None and step.release is not None:
            yield f"step {k}: released at {step.release:g} s, but never held"
        if step.grip is not None:
            release = end if step.release is None else step.release
            if not start - GRAIN <= step.grip <= release <= end + GRAIN:
                held = f"held from {step.grip:g} to {release:g} s"
                yield f"step {k}: {held}, outside {start:g} to {end:g} s"
            if not len(step.samples.time):
                yield f"step {k}: holds an object without a motion"
        if not reached and not step.detail:
            yield f"step {k}: {step.outcome.label} without a reason"
        if last is not None and not np.allclose(last.after, step.before, rtol=0, atol=2 * GRAIN):
            cell = int(np.abs(last.after - step.before).max(1).argmax())
            yield f"step {k}: cell {cell} does not begin where step {last.number} has left it"
        last = step
