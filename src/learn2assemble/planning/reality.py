"""A build as it really goes: what the arm did, where everything stands, what is left to build."""

from __future__ import annotations

import dataclasses

import numpy as np

from learn2assemble.geometry.coverage import FILTERS
from learn2assemble.planning.problem import Problem, placement_key
from learn2assemble.robot.attempt import Attempt
from learn2assemble.robot.dynamic import DynamicCell
from learn2assemble.robot.grasps import QUARTER, get_grasps
from learn2assemble.robot.judge import scene_of
from learn2assemble.robot.kinematic import KinematicCell
from learn2assemble.robot.logbook import Logbook
from learn2assemble.robot.mjcf import matrix
from learn2assemble.robot.motion import OPENING
from learn2assemble.robot.scene import Move, Scene
from learn2assemble.robot.waiting import taking_order
from learn2assemble.world.blocks import HALF
from learn2assemble.world.rules import count_row, recover_all
from learn2assemble.world.state import State

STANDS = 0.02
"""A block farther from its place than this does not stand there any more [m]."""
ON_TABLE = 0.01
"""Nor is a block whose centre is this much higher than on the table on the table [m]."""
UPRIGHT = np.cos(np.deg2rad(5.0))
"""Cosine of the largest lean of a block that stands."""


class RealCell:
    """A robot cell in which a build goes on: it remembers the arm, and every block's full pose.

    Implements :class:`learn2assemble.robot.judge.Cell` on a :class:`DynamicCell`.

    Args:
        cell: carries the moves out; it should recover from failures.
        state: a batch of one, before the build; object numbers are the numbers of the cubes.
    """

    name = "real"

    def __init__(self, cell: DynamicCell, state: State) -> None:
        count = int(state.num_blocks[0])
        self.cell, self.joints = cell, cell.arm.home.copy()
        self.poses = np.empty((count, 7))
        """float64[C, 7]: x, y, z [m], quaternion (w, x, y, z) of every block by its number."""
        self.poses[state.object_id[0, :count]] = np.hstack(
            [state.position[0, :count], state.quaternion[0, :count]]
        )
        words = "dynamic cell: MuJoCo, friction grasp, all collisions"
        objects = [[number] for number in range(count)]
        self.log = Logbook(cell.arm, self.joints, OPENING, self.poses, objects, words)

    def attempt(self, scene: Scene, move: Move) -> Attempt:
        """Carry out a move from where the arm is, with the blocks where they are."""
        numbers = scene.object_id
        real = scene._replace(position=self.poses[numbers, :3])
        found = self.cell.attempt(
            real, move, joints=self.joints, quaternion=self.poses[numbers, 3:]
        )
        order = self.log.add_attempt(found, real, move, numbers)
        if found.after is not None and found.quaternion is not None:
            self.poses[order] = np.hstack([found.after.position, found.quaternion])
        if found.joints is not None:
            self.joints = found.joints
        return found


def replan_from(
    problem: Problem, before: State, target: np.ndarray, action: np.ndarray, poses: np.ndarray,
    cell: KinematicCell,
) -> Problem:  # fmt: skip
    """What is left to build after an action has failed.

    What still stands where it belongs, or lies on something, is the structure; what lies on the
    table waits, what is in the way of the site first. The same placement is not tried again.

    Args:
        problem: as it was planned.
        before: the state before the action.
        target: float64[3] the block should have come to [m].
        action: the one that failed.
        poses: float64[C, 7] of all blocks now, by number.
        cell: of the arm, to find out what it can take.
    """
    placed, count = int(before.num_placed[0]), int(before.num_blocks[0])
    numbers = before.object_id[0, :count]
    moved = int(numbers[placed + action[0]])
    meant = {int(n): before.position[0, k] for k, n in enumerate(numbers[:placed])}
    meant[moved] = target
    fallen = [n for n in meant if not _stands(poses[n], meant[n])]
    standing = [n for n in meant if n not in fallen]
    lying = [n for n in map(int, numbers) if n not in standing and not _on_table(poses[n])]
    kept = [*standing, *lying] or [int(numbers[0])]
    loose = [n for n in fallen if n not in kept]
    waiting = [*loose, *(int(n) for n in numbers if n not in kept and n not in loose)]
    key = placement_key(target, int(action[2]) % problem.task.rotations)
    state = _state(problem, before, kept, waiting, poses)
    order = _taking(state, cell, problem.task.grasps)
    return dataclasses.replace(
        problem, state=_state(problem, before, kept, order, poses), avoid=problem.avoid | {key}
    )


def _stands(pose: np.ndarray, meant: np.ndarray) -> bool:
    return bool(np.linalg.norm(pose[:3] - meant) < STANDS and _lean(pose) > UPRIGHT)


def _on_table(pose: np.ndarray) -> bool:
    return bool(abs(pose[2] - HALF) < ON_TABLE and _lean(pose) > UPRIGHT)


def _lean(pose: np.ndarray) -> float:
    """Cosine of the angle between the vertical and the nearest axis of a cube."""
    return float(np.abs(matrix(pose[3:])[2]).max())


def _yaw(pose: np.ndarray) -> float:
    """Turn about the vertical of a cube, on whichever face it lies, within an eighth."""
    axes = matrix(pose[3:])
    flat = np.argmin(np.abs(axes[2]))
    yaw = np.arctan2(axes[1, flat], axes[0, flat])
    return float(yaw - QUARTER * np.rint(yaw / QUARTER))


def _state(
    problem: Problem, before: State, placed: list[int], waiting: list[int], poses: np.ndarray
) -> State:
    """The state with these blocks in this order, where they are."""
    state = before.copy()
    order = [*placed, *waiting]
    yaw = np.array([_yaw(poses[n]) for n in order])
    count = len(order)
    state.object_id[0, :count] = order
    state.position[0, :count] = poses[order, :3]
    state.quaternion[0, :count] = 0.0
    state.quaternion[0, :count, 0] = np.cos(yaw / 2)
    state.quaternion[0, :count, 3] = np.sin(yaw / 2)
    state.num_placed[0] = len(placed)
    state.terminated[0] = False
    recover_all(state, 0, problem.frames, FILTERS[problem.task.cover_filter])
    count_row(state, 0)
    return state


def _taking(state: State, cell: KinematicCell, grasps: str) -> list[int]:
    """Numbers of the waiting blocks in an order the arm can take them; the stuck ones last."""
    count, placed = int(state.num_blocks[0]), int(state.num_placed[0])
    numbers = state.object_id[0, :count]
    scene = scene_of(state.position[0, :count], state.quaternion[0, :count], numbers, placed)
    order, stuck = taking_order(cell, get_grasps(grasps), scene)
    return [int(numbers[k]) for k in [*order, *stuck]]
