"""The depth camera that looks at one side of a structure (protocol 3.1, 3.2, 3.5).

Local frame of a side: x right, y away from the viewer, z up [m]. The camera stands at
``(0, -0.25, 0.25)`` and looks along +y; its image has 100x100 pixels and a field of view of
120 degrees both ways. The face plane of the side is ``y = -0.025``, at depth 0.225 m.
"""

from __future__ import annotations

import math

IMAGE_SIZE = 100
"""Rows and columns of the square image [px]."""
CENTRE = 50.0
TAN_HALF_FOV = math.tan(math.radians(60.0))
CAMERA_Y = -0.25
CAMERA_Z = 0.25
NEAR_CLIP, FAR_CLIP = 0.05, 1.0
FACE_DEPTH = 0.225
"""Depth of the face plane along the optical axis [m]."""
HALF_EXTENT = FACE_DEPTH * TAN_HALF_FOV
"""Half the width of the image at the face plane [m]."""


def project(x: float, z: float) -> tuple[float, float]:
    """Image point ``(u, v)`` [px, v down] of ``(x, z)`` [m] in the face plane (protocol 3.2)."""
    return CENTRE * (1 + x / HALF_EXTENT), CENTRE * (1 - (z - CAMERA_Z) / HALF_EXTENT)


def unproject(u: float, v: float) -> tuple[float, float]:
    """Inverse of :func:`project`."""
    return (u / CENTRE - 1) * HALF_EXTENT, (1 - v / CENTRE) * HALF_EXTENT + CAMERA_Z
