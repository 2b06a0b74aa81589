"""Bricks before cameras, for the tests of what is seen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from learn2assemble.geometry.rotations import quaternion_matrix, yaw_quaternion
from learn2assemble.robot.bodies import Part, Shape
from learn2assemble.sensing.camera import DepthCamera, looking

BRICK: Shape = (Part((0.0, 0.0, 0.0), (0.04, 0.02, 0.015)),)
TURNS = tuple(np.diag(d).astype(float) for d in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)))
"""Rotations that leave the brick as it is."""
CORNER = DepthCamera("corner", (0.6, 0.5, 0.8, *looking(np.array([-0.6, -0.5, -0.8]))))
"""Looks over the table from one side."""


def lying(x: float, y: float, yaw: float, z: float = 0.015) -> np.ndarray:
    """float64[7]: pose of a brick."""
    return np.array([x, y, z, *yaw_quaternion(yaw)])


def shifted(pose: np.ndarray, by: Sequence[float] | np.ndarray) -> np.ndarray:
    """A pose float64[7] moved along the first axes of the world [m]."""
    moved = pose.copy()
    moved[: len(by)] += by
    return moved


def off_by(pose: np.ndarray, true: np.ndarray) -> np.ndarray:
    """float64[6]: how far a pose is off: position [m], rotation vector about world axes [rad]."""
    turn = quaternion_matrix(pose[3:]) @ quaternion_matrix(true[3:]).T
    spin = 0.5 * np.array(
        [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    )
    return np.concatenate([pose[:3] - true[:3], spin])
