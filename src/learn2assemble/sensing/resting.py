"""What statics says of a block that stands alone on the table: it rests on one of its faces.

A body that touches nothing but a plane and does not move stands with a face on it, above which its
centre of mass is. So height and lean are known as exactly as the plane is, which is far better than
a depth camera sees them: its error varies slowly over the picture and tilts a small face. Of a
reading that contradicts this (a block that moves, or leans on something unseen) nothing is taken
away.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from learn2assemble.geometry.hulls import resting_turns
from learn2assemble.geometry.rotations import quaternion_matrix, stepped_pose
from learn2assemble.robot.bodies import Shape, body_of

TABLE, LEVEL = 1e-3, float(np.radians(0.25))
"""How exactly the table is known: standard deviations of its height [m] and of its lean about
each axis [rad]."""
CONTRADICTS = 25.0
"""Squared distance, in standard deviations and three coordinates, from which a reading contradicts
that a block rests: one of 65,000 readings of a block that rests does."""
APART = 0.015
"""Blocks whose boxes are farther from one another do not touch, wherever they are exactly [m]."""


@lru_cache(maxsize=1024)
def _faces_down(shape: Shape) -> np.ndarray:
    """float64[n, 3]: outward normals, in the frame of the shape, of the faces on which it rests."""
    body = body_of(shape)
    return np.array([-rest.turn[2] for rest in resting_turns(body.hull, body.centre)])


def rested(
    pose: np.ndarray, covariance: np.ndarray, shape: Shape
) -> tuple[np.ndarray, np.ndarray] | None:
    """A reading of a block that stands alone, with what that says.

    Args:
        pose: float64[7], position [m] and quaternion (w, x, y, z).
        covariance: float64[6, 6]: position [m] and small rotation about the axes of the world
            [rad].
        shape: of the block.

    Returns:
        the same two by Bayes' rule; None where the reading contradicts that the block rests on a
        face.
    """
    faces = _faces_down(shape)
    if not len(faces):
        return None
    turn = quaternion_matrix(pose[3:])
    outward = faces @ turn.T
    nearest = int(outward[:, 2].argmin())
    down = outward[nearest]
    # By which the normal has to turn about x and y until it points down: n x (0, 0, -1).
    axis = np.array([-down[1], down[0]])
    sine = float(np.linalg.norm(axis))
    if down[2] >= 0:
        return None
    lean = axis * (np.arcsin(min(sine, 1.0)) / sine) if sine > 1e-12 else axis
    # What of the position the table tells: the height that the frame has above the face.
    below = float(-(body_of(shape).points @ faces[nearest]).max())
    residual = np.array([-below - pose[2], *lean])
    rows = np.eye(6)[[2, 3, 4]]
    innovation = rows @ covariance @ rows.T + np.diag([TABLE**2, LEVEL**2, LEVEL**2])
    if residual @ np.linalg.solve(innovation, residual) > CONTRADICTS:
        return None
    gain = np.linalg.solve(innovation, rows @ covariance).T
    kept = covariance - gain @ innovation @ gain.T
    return stepped_pose(pose, gain @ residual), (kept + kept.T) / 2


def alone(bodies: Sequence[tuple[Shape, np.ndarray]]) -> np.ndarray:
    """bool[n]: which of all bodies there are stand on the table, with nothing so near that they
    could lean on it.

    Args:
        bodies: shapes and poses float64[7], where they are believed to be.
    """
    boxes = np.empty((len(bodies), 2, 3))
    for box, (shape, pose) in zip(boxes, bodies, strict=True):
        points = pose[:3] + body_of(shape).points @ quaternion_matrix(pose[3:]).T
        box[:] = points.min(0), points.max(0)
    low, high = boxes[:, 0], boxes[:, 1]
    near = (low[:, None] < high + APART).all(2) & (high[:, None] > low - APART).all(2)
    return (near.sum(1) == 1) & (abs(low[:, 2]) < APART)
