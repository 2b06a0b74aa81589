"""A wall of twenty cubes, built by the dynamic cell: how well and how fast."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from learn2assemble.robot.attempt import Attempt
from learn2assemble.robot.dynamic import DynamicCell
from learn2assemble.robot.grasps import get_grasps
from learn2assemble.robot.scene import GAP, Move, Scene
from learn2assemble.world.blocks import EDGE, HALF
from learn2assemble.world.layouts import waiting_places

PITCH = EDGE + GAP


class WallReport(NamedTuple):
    """One wall."""

    attempts: list[Attempt]
    """One per cube, in order; the last one is the first that failed, if any."""
    seconds: np.ndarray
    """float64[k]: processor time of each [s]."""
    target: np.ndarray
    """float64[k, 3]: where the cubes should be [m]."""

    @property
    def errors(self) -> np.ndarray:
        """float64[k]: distance of each cube from its target once everything stands [m]."""
        last = self.attempts[-1].after
        assert last is not None
        return np.linalg.norm(last.position[: len(self.target)] - self.target, axis=1)


def build_wall(cell: DynamicCell, columns: int = 5, rows: int = 4) -> WallReport:
    """Build a wall along x from cubes that wait in the paper's rows (protocol 1.4), the farthest
    first; every attempt begins with what the one before left behind."""
    count = columns * rows
    waiting = waiting_places("slanted-rows", count).position[::-1]
    scene = Scene(waiting.copy(), np.zeros(count), np.arange(count), 0)
    pair = get_grasps("along-y")[0]
    report = WallReport([], np.empty(0), np.empty((0, 3)))
    joints = quaternion = None
    for k in range(count):
        target = np.array(
            [((k % columns) - columns // 2) * PITCH, 0.0, HALF + EDGE * (k // columns)]
        )
        begun = time.process_time()
        done = cell.attempt(
            scene, Move(k, target, *pair), joints=joints, quaternion=quaternion
        )  # fmt: skip
        report = WallReport(
            [*report.attempts, done],
            np.append(report.seconds, time.process_time() - begun),
            np.vstack([report.target, target]),
        )
        if not done.reached:
            break
        assert done.after is not None
        scene, quaternion, joints = done.after, done.quaternion, done.joints
    return report
