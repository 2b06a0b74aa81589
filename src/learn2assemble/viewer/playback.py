"""Playing records: where arms and every cell are at any time, for the page and the video.

The clock of a replay is the time of the record, with a pause for steps in which the arm does not
move, so that they can be read. Between samples joints are interpolated; what is held follows the
tool; what moves otherwise glides from where it was to where the record says it came to rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from learn2assemble.constants import GRAVITY
from learn2assemble.errors import InputError
from learn2assemble.geometry.rotations import (
    interpolate_quaternions,
    matrix_quaternion,
    quaternion_product,
)
from learn2assemble.kinematics.shape import ArmShape, arm_shape
from learn2assemble.motion.attempts import ArmStep, merged
from learn2assemble.motion.record import BuildRecord, Samples, StepRecord
from learn2assemble.planning.plan import Plan
from learn2assemble.robot.arm import Arm, get_arm

PAUSE = 2.5
"""What a step without motion takes in a replay [s]."""
SETTLE = 0.25
"""A released or pushed object comes to rest within this time [s]; a fall takes longer."""
_STILL = 1e-5
"""Cells whose poses differ by less have not moved."""


class Glide(NamedTuple):
    """How a cell moves in a step: held from ``grip`` to ``release``, or not at all, then gliding to
    rest.

    Times are on the clock of the replay [s].
    """

    cell: int
    grip: float | None
    release: float
    """The end of the step where it is not released."""
    offset: np.ndarray
    """float64[3]: the cell in the tool frame while held [m]."""
    turn: np.ndarray
    """float64[4]: its orientation there (w, x, y, z)."""
    end: float
    """When it has come to rest."""
    position: np.ndarray
    """float64[3]: where the glide begins [m, world]."""
    quaternion: np.ndarray
    """float64[4]: orientation there."""
    falls: bool


class ReplaySegment(NamedTuple):
    """A step of the record on the clock of the replay."""

    arm: int
    """Number of the arm."""
    step: StepRecord
    start: float
    """[s]."""
    end: float
    delay: float
    """Clock of the replay minus time of the record [s]."""
    glides: tuple[Glide, ...]


class PlayedArm(NamedTuple):
    """An arm that is drawn."""

    name: str
    """As steps call it, or what it is."""
    suction: bool
    shape: ArmShape
    samples: Samples
    """Of the whole build."""


class Playback:
    """Records of a build, of an arm each, ready to be drawn.

    Raises:
        UnknownNameError: for an arm that does not exist.
        InputError: where the record does not fit the arm or the plan.
    """

    def __init__(self, records: Sequence[BuildRecord], plan: Plan) -> None:
        names = [arm.name for arm in plan.arms] or [record.arm.name for record in records]
        self.arms: tuple[PlayedArm, ...] = tuple(
            _played(record, name) for record, name in zip(records, names, strict=True)
        )
        self.steps: list[ArmStep] = merged(records)
        record = max(records, key=lambda one: one.num_cells)
        if len(records) > 1:
            hands = tuple(
                hand._replace(after=sum(one.end <= hand.time + 1e-6 for one in self.steps))
                for one in records
                for hand in one.hands
                if hand.time is not None
            )
            steps = tuple(one.step for one in self.steps)
            record = replace(record, steps=steps, hands=hands)
        _fits(record, plan)
        self.record = record
        """Of all arms: the cells, and the attempts in the order in which they ended."""
        self.blocks: list[int | None] = block_of_cell(record, plan)
        cube = np.full((record.num_cells, 3), record.block_edge / 2)
        self.half: np.ndarray = cube if record.half is None else record.half
        """float64[C, 3]: half extents of every cell [m]."""
        self.segments: tuple[ReplaySegment, ...] = tuple(self._segments())

    @property
    def duration(self) -> float:
        """Length of the replay [s]."""
        return self.segments[-1].end if self.segments else 0.0

    @property
    def side(self) -> float:
        """The side of the structure on which the first arm stands: angle [rad] about z, 0 for -x;
        whole steps of 15 degrees."""
        after = self.record.steps[-1].after
        there = after[after[:, 2] > 0, :2]
        # Nothing may stand when a build was ended.
        middle = there.mean(0) if len(there) else np.zeros(2)
        away = self.arms[0].shape.chain.offset[0, :2] - middle
        step = math.radians(15)
        return step * round(math.atan2(-away[1], -away[0]) / step)

    def segment_at(self, clock: float) -> ReplaySegment:
        """The step at a time of the replay; its end belongs to it."""
        for segment in self.segments:
            if clock <= segment.end + 1e-9:
                return segment
        return self.segments[-1]

    def active_at(self, clock: float) -> list[ReplaySegment]:
        """The steps at a time of the replay, the one that ends next first."""
        now = self.segment_at(clock)
        later = self.segments[self.segments.index(now) + 1 :]
        return [now, *(segment for segment in later if segment.start < clock)]

    def arm_at(self, clock: float, arm: int = 0) -> tuple[np.ndarray, float]:
        """Joints float64[n] [rad] of an arm, and its opening [m]."""
        segment = self.segment_at(clock)
        # A step without samples finds the arm as the one before has left it.
        return self._arm(
            arm, (clock if len(segment.step.samples.time) else segment.start) - segment.delay
        )

    def cells_at(self, clock: float) -> tuple[np.ndarray, np.ndarray]:
        """Where all cells are: float64[C, 3] [m, world] and float64[C, 4] (w, x, y, z)."""
        active = self.active_at(clock)
        position, quaternion = split(active[0].step.before)
        for segment in active[1:]:
            own = list(segment.step.cells)
            position[own], quaternion[own] = split(segment.step.before[own])
        for segment, glide in ((one, glide) for one in active for glide in one.glides):
            c = glide.cell
            if glide.grip is None or clock >= glide.release:
                share = (clock - glide.release) / max(glide.end - glide.release, 1e-9)
                share = min(max(share, 0.0), 1.0)
                share = share * share if glide.falls else share * share * (3 - 2 * share)
                end, turn = split(segment.step.after[c])
                position[c] = glide.position + share * (end - glide.position)
                quaternion[c] = interpolate_quaternions(glide.quaternion, turn, share)
            elif clock >= glide.grip:
                position[c], quaternion[c] = self._held(
                    segment.arm, clock - segment.delay, glide.offset, glide.turn
                )
        return position, quaternion

    def _held(
        self, arm: int, time: float, offset: np.ndarray, turn: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where something is that the tool of an arm holds there, at a time of the record."""
        tool, rotation = self.arms[arm].shape.tool(self._arm(arm, time)[0])
        return tool + rotation @ offset, quaternion_product(matrix_quaternion(rotation), turn)

    def _arm(self, arm: int, time: float) -> tuple[np.ndarray, float]:
        samples = self.arms[arm].samples
        at = min(max(time * self.record.rate, 0.0), len(samples.time) - 1.0)
        low = min(int(at), max(len(samples.time) - 2, 0))
        high = min(low + 1, len(samples.time) - 1)
        share = at - low
        joints = samples.joints[low] + share * (samples.joints[high] - samples.joints[low])
        width = samples.width[low] + share * (samples.width[high] - samples.width[low])
        return joints, float(width)

    def _segments(self) -> list[ReplaySegment]:
        delay, found = 0.0, list[ReplaySegment]()
        for arm, step, start, end in self.steps:
            pause = 0.0 if len(step.samples.time) else PAUSE
            segment = ReplaySegment(arm, step, start + delay, end + delay + pause, delay, ())
            found.append(segment._replace(glides=tuple(self._glides(segment))))
            delay += pause
        return found

    def _glides(self, segment: ReplaySegment) -> list[Glide]:
        step, delay = segment.step, segment.delay
        moved = np.abs(step.after - step.before).max(1) > _STILL
        if step.grip is not None:
            moved[list(step.cells)] = True
        found = list[Glide]()
        position, quaternion = split(step.before)
        for cell in np.flatnonzero(moved).tolist():
            where, turned = position[cell], quaternion[cell]
            offset, turn = np.zeros(3), np.array([1.0, 0, 0, 0])
            grip, release = None, _moment(segment)
            if step.grip is not None and cell in step.cells:
                let_go = segment.end - delay if step.release is None else step.release
                arm = segment.arm
                tool, rotation = self.arms[arm].shape.tool(self._arm(arm, step.grip)[0])
                offset = rotation.T @ (where - tool)
                turn = quaternion_product(matrix_quaternion(rotation.T), turned)
                where, turned = self._held(arm, let_go, offset, turn)
                grip, release = step.grip + delay, let_go + delay
            drop = float(where[2] - step.after[cell, 2])
            falls = drop > 0.01
            takes = max(SETTLE, math.sqrt(2 * drop / GRAVITY)) if falls else SETTLE
            end = min(release + takes, segment.end)
            found.append(Glide(cell, grip, release, offset, turn, end, where, turned, falls))
        return found


def _played(record: BuildRecord, name: str) -> PlayedArm:
    """The arm of a record.

    Raises:
        InputError: where the record does not fit it.
    """
    facts = record.arm
    arm = get_arm(facts.name, facts.tool_name, (*facts.base_position.tolist(), facts.base_yaw))
    if facts.joints != arm.joints:
        raise InputError("trajectory.arm.joints", facts.joints, f"those of arm {arm.name}")
    return PlayedArm(name, facts.suction, arm_shape(arm), _samples(record, arm))


def _samples(record: BuildRecord, arm: Arm) -> Samples:
    """Of the whole build; an arm that never moves stands at home."""
    samples, _ = record.joined()
    return samples if len(samples.time) else standing(arm).samples


def standing(arm: Arm) -> PlayedArm:
    """An arm that stands at home."""
    home = arm.home[None]
    width = np.array([arm.gripper.max_width])
    samples = Samples(np.zeros(1), home, np.zeros_like(home), width, width)
    return PlayedArm(arm.name, arm.suction is not None, arm_shape(arm), samples)


def _moment(segment: ReplaySegment) -> float:
    """When something that is not held moves: as the block is let go, else as it is grasped."""
    step = segment.step
    if step.release is not None:
        return step.release + segment.delay
    for stage in step.stages:
        if stage.name == "pick":
            return (stage.start + stage.end) / 2 + segment.delay
    return (segment.start + segment.end) / 2


def split(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses float64[..., 7] as positions float64[..., 3] and quaternions float64[..., 4]."""
    return poses[..., :3].copy(), poses[..., 3:].copy()


def _fits(record: BuildRecord, plan: Plan) -> None:
    if not record.steps:
        raise InputError("trajectory.steps", 0, "at least one step")
    count = 0 if plan.assembly is None else len(plan.assembly.blocks)
    if len(record.objects) < count:
        raise InputError(
            "trajectory.objects", len(record.objects), f"the {count} blocks of the plan"
        )
    last = len(plan.steps)
    for step in record.steps:
        if step.plan_step is not None and not 1 <= step.plan_step <= last:
            what = f"trajectory.steps[{step.number - 1}].plan_step"
            raise InputError(what, step.plan_step, f"1 to {last}, the steps of the plan")


def block_of_cell(record: BuildRecord, plan: Plan) -> list[int | None]:
    """The block of the plan each cell belongs to; None for obstacles, blocks that are not used, and
    those that were lost."""
    count = 0 if plan.assembly is None else len(plan.assembly.blocks)
    blocks: list[int | None] = [None] * record.num_cells
    for number, cells in enumerate(record.objects[:count]):
        for cell in cells:
            blocks[cell] = number
    for step in record.steps:
        if step.plan_step is not None:
            for cell in step.cells:
                blocks[cell] = plan.steps[step.plan_step - 1].block
    return blocks
