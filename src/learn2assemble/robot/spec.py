"""Reading the MJCF of an arm."""

# The compiled module has no stubs that pyright finds.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

PICTURE_GROUP, COLLISION_GROUP = 2, 3
"""Geom groups of every vendored arm."""


def read_spec(mjcf: Path, position: np.ndarray, yaw: float, pictures: bool) -> mujoco.MjSpec:
    """The arm's MJCF, its root bodies moved to the base pose.

    Args:
        mjcf: file of the arm.
        position: float64[3] of the base [m, world].
        yaw: turn of the base about z [rad].
        pictures: keep the geoms without contact, which only pictures need; loading is faster
            without them.
    """
    spec = mujoco.MjSpec.from_file(str(mjcf))
    turn = np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])
    for body in spec.worldbody.bodies:
        moved, turned, rotated = np.empty(3), np.empty(4), np.empty(3)
        own = np.asarray(body.quat) / np.linalg.norm(body.quat)
        mujoco.mju_rotVecQuat(rotated, np.asarray(body.pos), turn)
        mujoco.mju_mulQuat(turned, turn, own)
        np.add(position, rotated, out=moved)
        body.pos, body.quat = moved, turned
    if not pictures:
        for geom in list(spec.geoms):
            if geom.group == PICTURE_GROUP:
                spec.delete(geom)
        for mesh in list(spec.meshes):
            spec.delete(mesh)
    return spec
