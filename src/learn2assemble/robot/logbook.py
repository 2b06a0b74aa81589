"""Making a record while a build goes on: steps come in with times of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.outcome import Outcome
from learn2assemble.robot.record import (
    RATE,
    BuildRecord,
    Samples,
    Stage,
    StepRecord,
    arm_facts,
)
from learn2assemble.world.blocks import EDGE


class Logbook:
    """Appends steps to a record and puts them on its clock.

    Args:
        arm: it stands still at ``joints`` with its gripper open by ``width`` when the build begins.
        poses: float64[C, 4], x, y, z [m, world] and yaw [rad] of every cell at the beginning.
        objects: cells of every rigid object.
        simulated_by: what the outcomes come from, in words.
    """

    def __init__(
        self,
        arm: Arm,
        joints: np.ndarray,
        width: float,
        poses: np.ndarray,
        objects: Sequence[Sequence[int]],
        simulated_by: str,
    ) -> None:
        self.arm, self.poses = arm, np.array(poses, float)
        self.objects = tuple(tuple(cells) for cells in objects)
        self.simulated_by = simulated_by
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
        joints: np.ndarray | None = None,
        velocity: np.ndarray | None = None,
        width: np.ndarray | None = None,
        stages: Sequence[Stage] = (),
        grip: float | None = None,
        release: float | None = None,
        after: np.ndarray | None = None,
    ) -> None:
        """Append a step; fields as in :class:`~.record.StepRecord`, times from its beginning.

        Args:
            joints: float64[T, n], the first one a period (1 / 50 s) after the last of the step
                before; None where the arm does not move.
            velocity: float64[T, n].
            width: float64[T].
            after: float64[C, 4]; None where nothing has moved.
        """
        n, start = len(self.arm.joints), self.now
        count = 0 if joints is None else len(joints)
        q = np.array([] if joints is None else joints, float).reshape(count, n)
        v = np.array([] if velocity is None else velocity, float).reshape(count, n)
        w = np.array([] if width is None else width, float).reshape(count)
        if not self._count and count:
            q = np.vstack([self._first[0], q])
            v = np.vstack([np.zeros(n), v])
            w = np.concatenate([[self._first[1]], w])
        time = (self._count + np.arange(len(q))) / RATE
        self._count += len(q)
        end = self.poses if after is None else np.array(after, float)
        self.steps.append(
            StepRecord(
                number=len(self.steps) + 1,
                plan_step=plan_step,
                cells=tuple(map(int, cells)),
                target=np.array(target, float),
                outcome=outcome,
                detail=detail,
                replanned=False,
                stages=tuple(Stage(s.name, s.start + start, s.end + start) for s in stages),
                grip=None if grip is None else grip + start,
                release=None if release is None else release + start,
                samples=Samples(time, q, v, w),
                before=self.poses,
                after=end,
            )
        )
        self.poses = end

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
            arm_facts(self.arm), RATE, EDGE, self.objects, self.simulated_by, tuple(self.steps)
        )
