"""The world as the robot sees it: cubes on a table, rigid objects made of them, and one order."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.robot.grasps import Attitude, turn
from learn2assemble.world.blocks import HALF

GAP = 0.01
"""Between horizontal neighbours on the lattice of the robot cell [m] (protocol 7)."""


class Scene(NamedTuple):
    """Cubes on the table, in the world frame; the placed ones first.

    Objects of several cells are rigid; where two of their cells are horizontal neighbours the gap
    between them is filled (protocol 7).
    """

    position: np.ndarray
    """float64[n, 3]: cell centres [m]."""
    yaw: np.ndarray
    """float64[n]: rotation of each cell about z [rad]."""
    object_id: np.ndarray
    """int64[n]: cells with one number are one rigid object."""
    num_placed: int

    def members(self, cell: int) -> np.ndarray:
        """int64[m]: the cells of the object of ``cell``, that cell first."""
        others = np.flatnonzero(self.object_id == self.object_id[cell])
        return np.concatenate([[cell], others[others != cell]])


class Move(NamedTuple):
    """Pick up the object of a waiting cell and put that cell somewhere else."""

    cell: int
    """Index of the grasped cell in the scene."""
    target: np.ndarray
    """float64[3]: centre the grasped cell shall have [m]."""
    grasp: Attitude
    place: Attitude

    @property
    def turn(self) -> float:
        """Rotation of the object about z between picking and placing [rad]."""
        return self.place.yaw - self.grasp.yaw


def put_down(scene: Scene, move: Move) -> Scene:
    """The scene after a move that went as ordered: the object's cells are the last placed ones,
    the grasped one first."""
    members = scene.members(move.cell)
    position, yaw = carried(scene, move, members)
    rest = np.setdiff1d(np.arange(scene.num_placed, len(scene.position)), members)
    order = np.concatenate([np.arange(scene.num_placed), members, rest])
    after = Scene(
        scene.position[order], scene.yaw[order], scene.object_id[order],
        scene.num_placed + len(members),
    )  # fmt: skip
    after.position[scene.num_placed : after.num_placed] = position
    after.yaw[scene.num_placed : after.num_placed] = yaw
    return after


def carried(scene: Scene, move: Move, members: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a move takes cells of the object: centres float64[m, 3] [m] and yaw float64[m]."""
    offset = scene.position[members] - scene.position[move.cell]
    return move.target + offset @ turn(move.turn).T, scene.yaw[members] + move.turn


def fillers(position: np.ndarray, object_id: np.ndarray) -> np.ndarray:
    """Pairs of horizontal neighbours of one object; the gap between them is filled (protocol 7).

    Args:
        position: float64[n, 3] cell centres [m].
        object_id: int64[n].

    Returns:
        int64[f, 2].
    """
    same = object_id[:, None] == object_id
    if same.sum() == len(object_id):
        return np.empty((0, 2), np.int64)
    a, b = np.nonzero(np.triu(same, 1))
    gap = np.abs(position[b] - position[a])
    near = (gap[:, 2] < HALF) & (np.hypot(gap[:, 0], gap[:, 1]) < 3 * HALF)
    return np.stack([a, b], -1)[near]
