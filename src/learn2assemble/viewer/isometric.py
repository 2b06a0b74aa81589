"""Boxes in parallel projection: which faces show, and which box hides which.

The viewer stands at the front left and above. Picture coordinates are ``(right, up)`` in metres.
"""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np

from learn2assemble.viewer.scene import Placed

TO_VIEWER = np.array([-0.52, -1.0, 0.62]) / np.linalg.norm([-0.52, -1.0, 0.62])
"""float64[3]: unit direction from the structure to the viewer, world frame."""
_RIGHT = np.cross([0.0, 0.0, 1.0], TO_VIEWER) / np.linalg.norm(TO_VIEWER[:2])
_UP = np.cross(TO_VIEWER, _RIGHT)
_SUN = np.array([-0.35, -0.8, 1.0])
"""Direction to the light."""
_SHADE = np.array([-0.55, -0.12])
"""Shadows fall to the right, where the viewer sees them; a drawing may light them apart."""
_FACES = (
    (0, 1, (1, 1), (2, 1)),
    (0, -1, (1, -1), (2, 1)),
    (1, 1, (0, -1), (2, 1)),
    (1, -1, (0, 1), (2, 1)),
    (2, 1, (0, 1), (1, 1)),
    (2, -1, (0, 1), (1, -1)),
)
"""Every face of a cube: outward axis and sign, then its right and up axes as seen from outside."""


class Face(NamedTuple):
    """A visible face of a block."""

    corners: np.ndarray
    """float64[4, 2]: in the picture; lower left, lower right, upper right, upper left."""
    normal: np.ndarray
    """float64[3]: outward, world frame."""
    light: float
    """0 to 1, how bright it is."""


def project(points: np.ndarray) -> np.ndarray:
    """World points ``float64[..., 3]`` to picture points ``float64[..., 2]`` [m]."""
    return np.stack([points @ _RIGHT, points @ _UP], -1)


def shadow(points: np.ndarray) -> np.ndarray:
    """Where the light casts world points onto the table: ``float64[..., 2]``, world (x, y) [m]."""
    return points[..., :2] - points[..., 2:] * _SHADE


def visible_faces(block: Placed, edge: float) -> list[Face]:
    """The faces of a cube that are turned to the viewer."""
    faces, rotation, half = [], block.rotation, edge / 2
    for axis, sign, (right, right_sign), (up, up_sign) in _FACES:
        normal = sign * rotation[:, axis]
        if normal @ TO_VIEWER <= 1e-9:
            continue
        u, v = right_sign * rotation[:, right], up_sign * rotation[:, up]
        square = [normal - u - v, normal + u - v, normal + u + v, normal - u + v]
        corners = project(block.position + half * np.array(square))
        light = 0.7 + 0.3 * max(float(normal @ _SUN) / _SUN[2], 0.0)
        faces.append(Face(corners, normal, min(light, 1.0)))
    return faces


def numbered_face(faces: list[Face], block: Placed, others: np.ndarray, edge: float) -> Face | None:
    """The upright face that shows best and has no other block against it.

    Args:
        faces: of :func:`visible_faces`.
        others: float64[n, 3], centres of the blocks that stand [m, world].
    """
    best: Face | None = None
    for face in faces:
        neighbour = np.abs(others - block.position - edge * face.normal).max(-1, initial=0.0)
        free = not bool((neighbour < 0.6 * edge).any())
        upright = abs(face.normal[2]) < 0.7
        if upright and free and (best is None or face.normal @ TO_VIEWER > best.normal @ TO_VIEWER):
            best = face
    return best


def painters_order(positions: np.ndarray, edge: float) -> list[int]:
    """Indices of equal cubes so that each is drawn after all it hides.

    Comparing centre depths is wrong for cubes off a common lattice, so every pair that overlaps
    in the picture is compared along the axis that separates it, and the pairs are sorted
    topologically. Cubes are taken as aligned with the axes.

    Args:
        positions: float64[n, 3], centres [m, world].
        edge: [m].
    """
    count = len(positions)
    if not count:
        return []
    apart = positions[:, None] - positions[None]
    axis = np.argmax(np.abs(apart), -1)
    along = np.take_along_axis(apart, axis[..., None], -1)[..., 0]
    nearer = (along * TO_VIEWER[axis] > 0) & _overlap_in_picture(apart, edge)
    blockers = nearer.sum(1)
    depth = positions @ TO_VIEWER
    ready = [(depth[i], i) for i in range(count) if not blockers[i]]
    heapq.heapify(ready)
    order: list[int] = []
    while ready:
        _, first = heapq.heappop(ready)
        order.append(first)
        for i in np.flatnonzero(nearer[:, first]).tolist():
            blockers[i] -= 1
            if not blockers[i]:
                heapq.heappush(ready, (depth[i], i))
    missing = set(range(count)).difference(order)  # Only cubes that interpenetrate get here.
    return order + sorted(missing, key=lambda i: depth[i])


def _overlap_in_picture(apart: np.ndarray, edge: float) -> np.ndarray:
    """Whether two cubes this far apart share picture points: their difference meets the ray."""
    enter = (-edge - np.sign(TO_VIEWER) * apart) / np.abs(TO_VIEWER)
    leave = (edge - np.sign(TO_VIEWER) * apart) / np.abs(TO_VIEWER)
    return enter.max(-1) < leave.min(-1) - 1e-9
