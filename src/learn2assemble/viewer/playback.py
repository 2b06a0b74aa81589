"""Playing a record: where the arm and every cell are at any time, for the page and the video.

The clock of a replay is the time of the record, with a pause for steps in which the arm does not
move, so that they can be read. Between samples joints are interpolated; what is held follows the
tool; what moves otherwise glides from where it was to where the record says it came to rest.

What the script of a page needs to move an arm: meshes, chain, samples and steps as data.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.geometry.rotations import (
    interpolate_quaternions,
    matrix_quaternion,
    quaternion_matrix,
    quaternion_product,
)
from learn2assemble.planning.plan import Plan
from learn2assemble.robot.arm import Arm, get_arm
from learn2assemble.robot.moves import Outcome, fillers
from learn2assemble.robot.record import BuildRecord, Samples, StepRecord
from learn2assemble.robot.shape import Part, Shape, arm_shape
from learn2assemble.viewer.html import packed, to_base64
from learn2assemble.viewer.words import (
    arm_caption,
    block_names,
    block_numbers,
    caption,
    stage_words,
)

PAUSE = 2.5
"""What a step without motion takes in a replay [s]."""
SETTLE = 0.25
"""A released or pushed object comes to rest within this time [s]; a fall takes longer."""
_GRAVITY = 10.0
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


class Segment(NamedTuple):
    """A step of the record on the clock of the replay."""

    step: StepRecord
    start: float
    """[s]."""
    end: float
    delay: float
    """Clock of the replay minus time of the record [s]."""
    glides: tuple[Glide, ...]


class Playback:
    """A record, ready to be drawn.

    Raises:
        UnknownNameError: for an arm that does not exist.
        InputError: where the record does not fit the arm or the plan.
    """

    def __init__(self, record: BuildRecord, plan: Plan) -> None:
        arm = get_arm(record.arm.name)
        _fits(record, plan, arm)
        self.record = record
        self.shape: Shape = arm_shape(arm)
        self.samples = _samples(record, arm)
        self.segments = tuple(self._segments())

    @property
    def duration(self) -> float:
        """Length of the replay [s]."""
        return self.segments[-1].end if self.segments else 0.0

    def segment_at(self, clock: float) -> Segment:
        """The step at a time of the replay; its end belongs to it."""
        for segment in self.segments:
            if clock <= segment.end + 1e-9:
                return segment
        return self.segments[-1]

    def arm_at(self, clock: float) -> tuple[np.ndarray, float]:
        """Joints float64[n] [rad] and opening [m]."""
        segment = self.segment_at(clock)
        time = clock - segment.delay if len(segment.step.samples.time) else self._before(segment)
        return self._arm(time)

    def cells_at(self, clock: float) -> tuple[np.ndarray, np.ndarray]:
        """Where all cells are: float64[C, 3] [m, world] and float64[C, 4] (w, x, y, z)."""
        segment = self.segment_at(clock)
        position, quaternion = split(segment.step.before)
        for glide in segment.glides:
            place = self._place(segment, glide, clock)
            if place is not None:
                position[glide.cell], quaternion[glide.cell] = place
        return position, quaternion

    def _place(
        self, segment: Segment, glide: Glide, clock: float
    ) -> tuple[np.ndarray, np.ndarray] | None:
        if glide.grip is not None and clock < glide.release:
            if clock < glide.grip:
                return None
            where, rotation = self.shape.tool(self._arm(clock - segment.delay)[0])
            return where + rotation @ glide.offset, quaternion_product(
                matrix_quaternion(rotation), glide.turn
            )
        share = (clock - glide.release) / max(glide.end - glide.release, 1e-9)
        share = min(max(share, 0.0), 1.0)
        share = share * share if glide.falls else share * share * (3 - 2 * share)
        end, turn = split(segment.step.after[glide.cell])
        return (
            glide.position + share * (end - glide.position),
            interpolate_quaternions(glide.quaternion, turn, share),
        )

    def _arm(self, time: float) -> tuple[np.ndarray, float]:
        samples = self.samples
        at = min(max(time * self.record.rate, 0.0), len(samples.time) - 1.0)
        low = min(int(at), max(len(samples.time) - 2, 0))
        high = min(low + 1, len(samples.time) - 1)
        share = at - low
        joints = samples.joints[low] + share * (samples.joints[high] - samples.joints[low])
        width = samples.width[low] + share * (samples.width[high] - samples.width[low])
        return joints, float(width)

    def _before(self, segment: Segment) -> float:
        """Time of the record at which a step without samples finds the arm."""
        return segment.start - segment.delay

    def _segments(self) -> list[Segment]:
        delay, found = 0.0, []
        for step, (start, end) in zip(self.record.steps, self.record.spans(), strict=True):
            pause = 0.0 if len(step.samples.time) else PAUSE
            segment = Segment(step, start + delay, end + delay + pause, delay, ())
            found.append(segment._replace(glides=tuple(self._glides(segment))))
            delay += pause
        return found

    def _glides(self, segment: Segment) -> list[Glide]:
        step, delay = segment.step, segment.delay
        moved = np.abs(step.after - step.before).max(1) > _STILL
        if step.grip is not None:
            moved[list(step.cells)] = True
        found = []
        position, quaternion = split(step.before)
        for cell in np.flatnonzero(moved).tolist():
            where, turned = position[cell], quaternion[cell]
            offset, turn = np.zeros(3), np.array([1.0, 0, 0, 0])
            grip, release = None, _moment(segment)
            if step.grip is not None and cell in step.cells:
                let_go = segment.end - delay if step.release is None else step.release
                tool, rotation = self.shape.tool(self._arm(step.grip)[0])
                offset = rotation.T @ (where - tool)
                turn = quaternion_product(matrix_quaternion(rotation.T), turned)
                tool, rotation = self.shape.tool(self._arm(let_go)[0])
                where, turned = (
                    tool + rotation @ offset,
                    quaternion_product(matrix_quaternion(rotation), turn),
                )
                grip, release = step.grip + delay, let_go + delay
            drop = float(where[2] - step.after[cell, 2])
            falls = drop > 0.01
            takes = max(SETTLE, math.sqrt(2 * drop / _GRAVITY)) if falls else SETTLE
            end = min(release + takes, segment.end)
            found.append(Glide(cell, grip, release, offset, turn, end, where, turned, falls))
        return found


def _samples(record: BuildRecord, arm: Arm) -> Samples:
    """Of the whole build; an arm that never moves stands at home."""
    samples, _ = record.joined()
    if len(samples.time):
        return samples
    home = arm.home[None]
    return Samples(np.zeros(1), home, np.zeros_like(home), np.array([arm.gripper.max_width]))


def _moment(segment: Segment) -> float:
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


def _fits(record: BuildRecord, plan: Plan, arm: Arm) -> None:
    facts, where = record.arm, f"those of arm {arm.name}"
    if facts.joints != arm.joints:
        raise InputError("trajectory.arm.joints", facts.joints, where)
    base = np.array([*facts.base_position, facts.base_yaw])
    if not np.allclose(base, [*arm.base_position, arm.base_yaw], rtol=0, atol=1e-5):
        raise InputError("trajectory.arm, base", base.tolist(), where)
    count = len(plan.blocks.waiting)
    if not record.steps:
        raise InputError("trajectory.steps", 0, "at least one step")
    if record.num_cells != count:
        raise InputError("trajectory.objects", record.num_cells, f"the {count} blocks of the plan")
    last = len(plan.steps)
    for step in record.steps:
        if step.plan_step is not None and not 1 <= step.plan_step <= last:
            what = f"trajectory.steps[{step.number - 1}].plan_step"
            raise InputError(what, step.plan_step, f"1 to {last}, the steps of the plan")
        if step.plan_step is not None and step.outcome == Outcome.REACHED:
            block = plan.steps[step.plan_step - 1].block
            if block not in step.cells:
                what = f"trajectory.steps[{step.number - 1}].cells"
                raise InputError(what, step.cells, f"block {block}, as in the plan")


def arm_data(plan: Plan, playback: Playback, kinds: Mapping[int, str]) -> dict:
    """What the scripts need to move the arm: metres, seconds, radians, quaternions (w, x, y, z).

    Args:
        kinds: colour of every block by its number.
    """
    record, shape = playback.record, playback.shape
    chain, samples = shape.chain, playback.samples
    numbers = block_numbers(plan)
    first = record.steps[0].before
    tool_turn = matrix_quaternion(chain.tool_turn)
    return {
        "rate": record.rate,
        "duration": _short(playback.duration),
        "joints": [
            {"offset": _list(offset), "turn": _list(matrix_quaternion(turn))}
            for offset, turn in zip(chain.offset, chain.turn, strict=True)
        ],
        "tool": {"offset": _list(chain.tool_offset), "turn": _list(tool_turn)},
        "fingers": [
            {"offset": _list(f.offset), "turn": _list(matrix_quaternion(f.turn)),
             "travel": _list(f.travel)}
            for f in shape.fingers
        ],
        "parts": [_part(part) for part in shape.parts],
        "samples": packed(np.column_stack([samples.joints, samples.width]), np.uint16),
        "cells": [
            {"number": numbers.get(cell), "kind": kinds.get(numbers.get(cell, -1), "wall"),
             "position": position, "quaternion": quaternion}
            for cell, (position, quaternion) in enumerate(
                zip(*map(_list, split(first)), strict=True)
            )
        ],
        "fillers": _fillers(playback, first),
        "segments": [_segment(plan, s) for s in playback.segments],
        "start": caption(plan, 0),
        "extent": _list(extent(playback)),
    }  # fmt: skip


def _segment(plan: Plan, segment: Segment) -> dict[str, Any]:
    step, delay = segment.step, segment.delay
    block = block_names(plan).get(step.cells[0], "a waiting block")
    return {
        "start": _short(segment.start),
        "end": _short(segment.end),
        "delay": _short(delay),
        "moves": bool(len(step.samples.time)),
        "step": step.plan_step,
        "cells": list(step.cells),
        "target": _list(step.target),
        "reached": step.outcome == Outcome.REACHED,
        "outcome": step.outcome.label,
        "caption": arm_caption(plan, step),
        "still": f"cannot move: {step.outcome.label}",
        "stages": [
            [_short(s.start + delay), _short(s.end + delay), stage_words(step, s, block)]
            for s in step.stages
        ],
        "glides": [_glide(glide) for glide in segment.glides],
        "after": {
            str(glide.cell): [_list(v) for v in split(step.after[glide.cell])]
            for glide in segment.glides
        },
    }


def _glide(glide: Glide) -> dict[str, Any]:
    return {
        "cell": glide.cell, "grip": _time(glide.grip), "release": _short(glide.release),
        "offset": _list(glide.offset), "turn": _list(glide.turn),
        "end": _short(glide.end),
        "position": _list(glide.position), "quaternion": _list(glide.quaternion),
        "falls": glide.falls,
    }  # fmt: skip


def glued_cells(record: BuildRecord) -> np.ndarray:
    """int64[f, 2]: neighbouring cells of one object, between which there is a filler."""
    owner = np.empty(record.num_cells, np.int64)
    for number, cells in enumerate(record.objects):
        owner[list(cells)] = number
    return fillers(record.steps[0].before[:, :3], owner)


def _fillers(playback: Playback, first: np.ndarray) -> list[dict[str, Any]]:
    """Between neighbouring cells of one object: both cells, and the middle in the first's frame."""
    found = []
    for a, b in glued_cells(playback.record).tolist():
        gap = first[b, :3] - first[a, :3]
        x, y, _ = quaternion_matrix(first[a, 3:]).T @ gap
        found.append({"cell": a, "middle": _list(np.array([x / 2, y / 2, 0.0])),
                      "yaw": _short(math.atan2(y, x)),
                      "gap": _short(math.hypot(x, y) - playback.record.block_edge)})  # fmt: skip
    return found


def extent(playback: Playback) -> np.ndarray:
    """float64[m, 3]: outermost points of what the arm's joints and tool reach [m, world]."""
    points = [playback.shape.chain.offset[0] * [1, 1, 0]]
    joints = playback.samples.joints
    for q in joints[:: max(1, len(joints) // 200)]:
        points += [*playback.shape.frames(q, 0.0)[0], playback.shape.tool(q)[0]]
    reached = np.array(points)
    around = [v for v in np.ndindex(3, 3, 3) if v != (1, 1, 1)]
    return reached[np.unique((reached @ (np.array(around).T - 1.0)).argmax(0))]


def _part(part: Part) -> dict[str, Any]:
    wide = len(part.mesh.vertices) >= 65536
    return {
        "frame": part.frame,
        "colour": list(part.colour),
        "vertices": packed(part.mesh.vertices, np.uint16),
        "normals": packed(part.mesh.normals, np.uint8, (-1.0, 1.0)),
        "faces": to_base64(part.mesh.faces.astype(np.uint32 if wide else np.uint16)),
        "wide": wide,
    }


def _list(values: np.ndarray) -> list[Any]:
    return (np.round(values, 6) + 0.0).tolist()


def _short(value: float) -> float:
    return round(float(value), 4) + 0.0


def _time(value: float | None) -> float | None:
    return None if value is None else _short(value)
