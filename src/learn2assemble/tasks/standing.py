"""What really stands after an action of an arm: the cell of a build, and the state to plan from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from learn2assemble.constants import EDGE, HALF
from learn2assemble.geometry.rotations import yaw_quaternion
from learn2assemble.handling.dynamic_cell import DynamicCell
from learn2assemble.kinematics.cell import KinematicCell
from learn2assemble.motion.recorder import BuildRecorder
from learn2assemble.robot.grasps import QUARTER, along
from learn2assemble.robot.grasps import get_grasps as grasps_of
from learn2assemble.robot.moves import OPENING, Attempt, Move, Scene
from learn2assemble.robot.scene import rotation_matrix
from learn2assemble.tasks.checkers import scene_of
from learn2assemble.tasks.task import Task
from learn2assemble.tasks.world.coverage import FILTERS
from learn2assemble.tasks.world.layouts import side_frames
from learn2assemble.tasks.world.rules import count_row, recover_all, target_cell
from learn2assemble.tasks.world.state import State

STANDS, ON_TABLE = 0.02, 0.01
"""A block farther from its place does not stand there any more; one whose centre is this much
higher than on the table is not on it [m]."""


UPRIGHT = float(np.cos(np.deg2rad(5.0)))
"""Cosine of the largest lean of a block that stands."""


class RealCell:
    """A robot cell in which a build goes on: it remembers the arm, and every cube's full pose.

    Implements :class:`learn2assemble.tasks.checkers.Cell` on a :class:`DynamicCell`.

    Args:
        cell: carries the moves out; it should recover from failures.
        state: a batch of one, before the build; object numbers are the numbers of the cubes.
    """

    name = "real"

    def __init__(self, cell: DynamicCell, state: State) -> None:
        count = int(state.num_blocks[0])
        self.cell = cell
        self.joints: np.ndarray = cell.arm.home.copy()
        self.poses: NDArray[np.float64] = np.empty((count, 7))
        """float64[C, 7]: x, y, z [m], quaternion (w, x, y, z) of every cube by its number."""
        self.poses[state.object_id[0, :count]] = np.hstack(
            [state.position[0, :count], state.quaternion[0, :count]]
        )
        words = "dynamic cell: MuJoCo, friction grasp, all collisions"
        cubes = [[number] for number in range(count)]
        self.log: BuildRecorder = BuildRecorder(
            cell.arm, self.joints, OPENING, self.poses, cubes, words
        )

    def attempt(self, scene: Scene, move: Move) -> Attempt:
        """Carry out a move from where the arm is, with the cubes where they are."""
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


def left_to_build(
    task: Task, before: State, action: np.ndarray, poses: np.ndarray, cell: KinematicCell
) -> State:
    """The state after an action of an arm has failed.

    What still stands where it belongs, or lies on something, is the structure; what lies on the
    table waits, first what is loose and can be taken: it may be in the way.

    Args:
        before: the state before the action, a batch of one.
        action: the one that failed.
        poses: float64[C, 7] of all cubes now, by number.
        cell: of the arm, to find out what it can take.
    """
    placed, count = int(before.num_placed[0]), int(before.num_blocks[0])
    numbers = before.object_id[0, :count].tolist()
    target = target_cell(before, 0, int(action[1]), int(action[2]) // task.rotations, task.pitch)
    meant = {n: before.position[0, k] for k, n in enumerate(numbers[:placed])}
    meant[numbers[placed + action[0]]] = np.array(target)
    upright = {n: bool(_lean(poses[n]) > UPRIGHT) for n in numbers}
    off = {n: np.linalg.norm(poses[n, :3] - place) for n, place in meant.items()}
    standing = [n for n in meant if upright[n] and off[n] < STANDS]
    on_table = {n for n in numbers if upright[n] and abs(poses[n, 2] - HALF) < ON_TABLE}
    kept = [*standing, *(n for n in numbers if n not in standing and n not in on_table)]
    kept = kept or numbers[:1]
    waiting = list(dict.fromkeys(n for n in [*meant, *numbers] if n not in kept))
    state = _standing(task, before, kept, waiting, poses)
    loose = [n for n in meant if n in waiting]
    stuck = [n for n in loose if not _can_take(state, n, cell, task.grasps)]
    order = [*(n for n in waiting if n not in stuck), *stuck]
    return _standing(task, before, kept, order, poses)


def _standing(
    task: Task, before: State, placed: list[int], waiting: list[int], poses: np.ndarray
) -> State:
    """The state with these cubes in this order, where they are."""
    state, order = before.copy(), [*placed, *waiting]
    state.object_id[0, : len(order)] = order
    state.position[0, : len(order)] = poses[order, :3]
    state.quaternion[0, : len(order)] = yaw_quaternion(np.array([_yaw(poses[n]) for n in order]))
    state.num_placed[0] = len(placed)
    state.terminated[0] = False
    frames = side_frames(task.num_sides, task.pitch, task.aisle)
    recover_all(state, 0, frames, FILTERS[task.cover_filter])
    count_row(state, 0)
    return state


def _can_take(state: State, number: int, cell: KinematicCell, grasps: str) -> bool:
    """Whether the arm can lift a waiting cube by any grasp of its set."""
    count, placed = int(state.num_blocks[0]), int(state.num_placed[0])
    scene = scene_of(
        state.position[0, :count], state.quaternion[0, :count], state.object_id[0, :count], placed
    )
    row = int(np.flatnonzero(scene.object_id == number)[0])
    high = np.array([0.0, 0.0, scene.position[:placed, 2].max() + EDGE])
    for pair in grasps_of(grasps):
        turned = along(pair.grasp, float(scene.yaw[row]))
        if cell.pick(scene, Move(row, high, turned, turned)).reached:
            return True
    return False


def _lean(pose: np.ndarray) -> float:
    """Cosine of the angle between the vertical and the nearest axis of a cube."""
    return float(np.abs(rotation_matrix(pose[3:])[2]).max())


def _yaw(pose: np.ndarray) -> float:
    """Turn about the vertical of a cube, on whichever face it lies, within an eighth."""
    axes = rotation_matrix(pose[3:])
    flat = np.argmin(np.abs(axes[2]))
    yaw = np.arctan2(axes[1, flat], axes[0, flat])
    return float(yaw - QUARTER * np.rint(yaw / QUARTER))
