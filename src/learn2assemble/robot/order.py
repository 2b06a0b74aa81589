"""A move in a scene as the simulation sees it: rigid objects with poses, one to be moved."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.mjcf import Objects, about_z, group, matrix
from learn2assemble.robot.scene import Move, Scene, put_down


class Order(NamedTuple):
    """What is asked of the arm, and where."""

    scene: Scene
    quaternion: np.ndarray
    """float64[n, 4]: orientations (w, x, y, z) of the cells."""
    move: Move
    objects: Objects
    poses: np.ndarray
    """float64[b, 7] of the objects: position [m] and quaternion."""
    names: list[str]
    """Of the objects, in messages."""
    target: int
    """Number of the object to be moved."""

    def in_hand(self, grasp: Attitude) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the object in the tool frame once it is grasped so: float64[3] [m] and [3, 3]."""
        tool, pose = grasp.rotation(), self.poses[self.target]
        contact = grasp.tool_point(self.scene.position[self.move.cell])
        return tool.T @ (pose[:3] - contact), tool.T @ matrix(pose[3:])

    def in_world(self, grasp: Attitude, place: Attitude) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the object once it is placed: float64[3] [m] and float64[3, 3]."""
        position, rotation = self.in_hand(grasp)
        tool = place.rotation()
        return place.tool_point(self.move.target) + tool @ position, tool @ rotation

    def after(self, poses: np.ndarray) -> tuple[Scene, np.ndarray]:
        """The scene with objects at ``poses`` float64[b, 7], the moved one listed as
        :func:`~.scene.put_down` does, and quaternions of its cells float64[n, 4]."""
        position, quaternion, yaw = self.objects.cells(poses)
        # Which cell goes where in the list, by sending their numbers instead of their yaws.
        numbered = self.scene._replace(yaw=np.arange(len(yaw), dtype=float))
        meant = put_down(numbered, self.move)
        new = np.rint(meant.yaw).astype(np.int64)
        members = self.scene.members(self.move.cell)
        new[self.scene.num_placed : self.scene.num_placed + len(members)] = members
        return meant._replace(position=position[new], yaw=yaw[new]), quaternion[new]


def take_order(scene: Scene, move: Move, quaternion: np.ndarray | None = None) -> Order:
    """The order to carry out ``move``.

    Args:
        scene: as things are.
        move: what shall be done.
        quaternion: float64[n, 4] orientations (w, x, y, z) of the cells; by default all stand
            upright at their yaw.

    Raises:
        InputError: for a cell that is not waiting, or numbers that are not finite.
    """
    if not scene.num_placed <= move.cell < len(scene.position):
        waiting = f"the index of a waiting cell, {scene.num_placed} to {len(scene.position) - 1}"
        raise InputError("cell", move.cell, waiting)
    if not np.isfinite(move.target).all():
        raise InputError("target", np.asarray(move.target).tolist(), "finite numbers")
    objects, poses, names = rigid_objects(scene, quaternion)
    turns = poses[objects.owner, 3:]
    return Order(scene, turns, move, objects, poses, names, int(objects.owner[move.cell]))


def rigid_objects(
    scene: Scene, quaternion: np.ndarray | None = None
) -> tuple[Objects, np.ndarray, list[str]]:
    """The objects of a scene, their poses float64[b, 7] and their names in messages.

    Raises:
        InputError: for numbers that are not finite.
    """
    turns = about_z(scene.yaw) if quaternion is None else np.asarray(quaternion, float)
    for array in (scene.position, turns):
        if not np.isfinite(array).all():
            raise InputError("scene", array.tolist(), "finite numbers")
    objects = group(scene, turns)
    poses = np.hstack([scene.position[objects.lead], turns[objects.lead]])
    return objects, poses, [f"block {k}" for k in objects.lead]
