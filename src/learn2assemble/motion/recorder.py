"""How the record of a build is taken, attempt by attempt, while the build goes on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from learn2assemble.constants import EDGE
from learn2assemble.geometry.hulls import Hull
from learn2assemble.geometry.rotations import yaw_quaternion
from learn2assemble.kinematics.chain import forward_many, get_chain
from learn2assemble.motion.record import RATE, BuildRecord, Samples, Stage, StepRecord, arm_facts
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.moves import STAGES, Attempt, Move, Outcome, Scene, Trajectory, carried

LOST = 0.008
"""What has moved so far in the hand is not drawn as held any more [m]."""


class StepMotion(NamedTuple):
    """A motion of the arm in T samples, 1 / 50 s apart; times from the beginning of its step."""

    joints: np.ndarray
    """float64[T, n]: the first ones a period after the last of the step before."""
    velocity: np.ndarray
    """float64[T, n]."""
    width: np.ndarray
    """float64[T]."""
    command: np.ndarray
    """float64[T]: what the tool is told."""
    stages: Sequence[Stage] = ()
    grip: float | None = None
    """When the object is held [s], and when it is let go."""
    release: float | None = None

    def after(self, seconds: float, there: np.ndarray) -> StepMotion:
        """The same after the arm has stood for some time [s] at joints float64[n] [rad]."""
        count = round(seconds * RATE)
        if not count or not len(self.joints):
            return self
        still = np.zeros((count, self.velocity.shape[1]))
        width, command = (np.repeat(values[:1], count) for values in (self.width, self.command))
        there = np.repeat(there[None], count, axis=0)
        return StepMotion(there, still, width, command).then(self)

    def then(self, other: StepMotion) -> StepMotion:
        """The same before another one, whose step it belongs to."""
        lag = len(self.joints) / RATE
        return StepMotion(
            np.concatenate([self.joints, other.joints]),
            np.concatenate([self.velocity, other.velocity]),
            np.concatenate([self.width, other.width]),
            np.concatenate([self.command, other.command]),
            [Stage(one.name, one.start + lag, one.end + lag) for one in other.stages],
            None if other.grip is None else other.grip + lag,
            None if other.release is None else other.release + lag,
        )


class CellShapes(NamedTuple):
    """What cells are where they are no cubes."""

    half: np.ndarray | None = None
    """float64[C, 3]: half extents of their boxes [m]."""
    density: np.ndarray | None = None
    """float64[C] of them [kg/m3]."""
    hull: tuple[Hull | None, ...] | None = None
    """What they are where they are no boxes."""


_CUBES = CellShapes()


class BuildRecorder:
    """Appends steps to a record and puts them on its clock.

    Args:
        arm: it stands still at ``joints`` with its gripper open by ``width`` when the build begins.
        poses: float64[C, 7] of every cell at the beginning, as in
            :class:`StepRecord`.
        objects: cells of every rigid object.
        simulated_by: what the outcomes come from, in words.
    """

    half: np.ndarray | None
    density: np.ndarray | None
    hull: tuple[Hull | None, ...] | None

    def __init__(
        self,
        arm: Arm,
        joints: np.ndarray,
        width: float,
        poses: np.ndarray,
        objects: Sequence[Sequence[int]],
        simulated_by: str,
        shapes: CellShapes = _CUBES,
    ) -> None:
        self.arm = arm
        self.poses: np.ndarray = np.array(poses, float)
        self.objects: tuple[tuple[int, ...], ...] = tuple(tuple(cells) for cells in objects)
        self.simulated_by = simulated_by
        self.half, self.density, self.hull = shapes
        self.steps: list[StepRecord] = []
        self._first = np.array(joints, float), float(width)
        self._count = 0

    @property
    def now(self) -> float:
        """Time of the record at which the next step begins [s]."""
        return max(self._count - 1, 0) / RATE

    def add(
        self,
        *,
        plan_step: int | None,
        cells: Sequence[int],
        target: np.ndarray,
        outcome: Outcome,
        detail: str = "",
        motion: StepMotion | None = None,
        after: np.ndarray | None = None,
        source: np.ndarray | None = None,
    ) -> None:
        """Append a step; fields as in :class:`StepRecord`.

        Args:
            motion: None where the arm does not move.
            after: float64[C, 7]; None where nothing has moved.
        """
        n, start = len(self.arm.joints), self.now
        parts = [np.empty((0, n)), np.empty((0, n)), np.empty(0), np.empty(0)]
        stages, grip, release = (), None, None
        if motion is not None:
            parts = [np.array(part, float) for part in motion[:4]]
            stages, grip, release = motion.stages, motion.grip, motion.release
        if not self._count and len(parts[0]):
            first = self._first[0][None], np.zeros((1, n)), [self._first[1]], [self._first[1]]
            parts = [np.concatenate(pair) for pair in zip(first, parts, strict=True)]
        count = len(parts[0])
        time = (self._count + np.arange(count)) / RATE
        self._count += count
        end = self.poses if after is None else np.array(after, float)
        self.steps.append(
            StepRecord(
                len(self.steps) + 1,
                plan_step,
                tuple(map(int, cells)),
                np.array(target, float),
                outcome,
                detail,
                False,
                tuple(Stage(s.name, s.start + start, s.end + start) for s in stages),
                None if grip is None else grip + start,
                None if release is None else release + start,
                Samples(time, *parts),
                self.poses,
                end,
                source=source,
            )
        )
        self.poses = end

    def add_attempt(
        self,
        attempt: Attempt,
        scene: Scene,
        move: Move,
        numbers: np.ndarray,
        plan_step: int | None = None,
    ) -> np.ndarray:
        """Append what a cell reports of a move.

        Args:
            attempt: the report.
            scene: as things were before it.
            move: the order.
            numbers: int64[n], which cell of the build each row of ``scene`` is.
            plan_step: as in :class:`StepRecord`.

        Returns:
            int64[n]: which cell of the build each row of ``attempt.after`` is.
        """
        members = scene.members(move.cell)
        rest = np.setdiff1d(np.arange(scene.num_placed, len(scene.position)), members)
        order = numbers[np.concatenate([np.arange(scene.num_placed), members, rest])]
        turn = carried(scene, move, members)[1][0]
        after = None
        if attempt.after is not None and attempt.quaternion is not None:
            after = self.poses.copy()
            after[order] = np.hstack([attempt.after.position, attempt.quaternion])
        done, motion = attempt.trajectory, None
        if done is not None and len(done.time) > 1:
            width = done.width[1:].clip(0, self.arm.gripper.max_width)
            motion = StepMotion(
                done.joints[1:],
                done.velocity[1:],
                width,
                done.command[1:],
                stages_of(done),
                *holding(self.arm, done, move.cell),
            )
        self.add(
            plan_step=plan_step,
            cells=numbers[members].tolist(),
            target=np.array([*move.target, *turn]),
            outcome=attempt.outcome,
            detail=attempt.detail,
            motion=motion,
            after=after,
        )
        return order

    def take(self, step: StepRecord) -> None:
        """Append a step that was recorded before, with its times as they are."""
        self.steps.append(step)
        self._count += len(step.samples.time)

    def replanned(self) -> None:
        """The rest of the build has been planned anew after the last step."""
        self.steps[-1] = replace(self.steps[-1], replanned=True)

    def number_steps(self, plan_steps: Sequence[int | None]) -> None:
        """Say which step of the finished plan each step of the record carries out."""
        self.steps = [
            replace(step, plan_step=number)
            for step, number in zip(self.steps, plan_steps, strict=True)
        ]

    def record(self) -> BuildRecord:
        """The record so far."""
        return BuildRecord(
            arm_facts(self.arm),
            RATE,
            EDGE,
            self.objects,
            self.simulated_by,
            tuple(self.steps),
            self.half,
            self.density,
            self.hull,
        )


def upright(position: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Poses float64[n, 7] of cells at centres float64[n, 3] [m], turned about z by float64[n]."""
    return np.hstack([position, yaw_quaternion(yaw)])


def stages_of(trajectory: Trajectory) -> list[Stage]:
    """The stages one after the other; a sample ends the time that led to it."""
    changes = np.flatnonzero(np.diff(trajectory.stage[1:])) + 1
    ends = [*changes.tolist(), len(trajectory.time) - 1]
    starts = [0, *changes.tolist()]
    return [
        Stage(STAGES[trajectory.stage[b]], float(trajectory.time[a]), float(trajectory.time[b]))
        for a, b in zip(starts, ends, strict=True)
    ]


def holding(arm: Arm, trajectory: Trajectory, cell: int) -> tuple[float | None, float | None]:
    """When a cell begins to follow the hand and when it ceases to [s].

    It does from the moment it is lifted, until the fingers open or it has moved in the hand by
    more than :data:`LOST`.
    """
    lifted = np.flatnonzero(trajectory.stage == STAGES.index("lift"))
    if not len(lifted):
        return None, None
    grip = int(lifted[0]) - 1
    where, turn = forward_many(get_chain(arm), np.ascontiguousarray(trajectory.joints))
    inside = np.einsum("tji,tj->ti", turn, trajectory.pose[:, cell, :3] - where)
    gone = np.linalg.norm(inside - inside[grip], axis=1) > LOST
    gone |= trajectory.stage == STAGES.index("release")
    gone[: grip + 1] = False
    first = int(np.argmax(gone))
    return float(trajectory.time[grip]), float(trajectory.time[first - 1]) if gone.any() else None
