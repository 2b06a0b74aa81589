"""Posts as they are cut from a bar: its section, its length, and how the top is cut."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from learn2assemble.geometry.hulls import area_vector

POST = "post"
"""Kind of the blocks that are cut to what they carry."""
_ALIKE = 1e-4
"""Cuts that differ by less are one [m]."""
_NEAR = 1e-6
"""Lengths that count as nothing, as a share of the height."""


class Cut(NamedTuple):
    """How a post is cut."""

    width: float
    """Larger edge of its section [m]."""
    depth: float
    longest: float
    """Height of its highest corner: the length of the bar [m]."""
    shortest: float
    """Height at its lowest corner of the top [m]."""
    angles: tuple[float, ...]
    """Of the faces of its top, from level [deg]."""

    def like(self, other: Cut) -> bool:
        """Whether a saw makes both with one setting."""
        return len(self.angles) == len(other.angles) and bool(
            np.abs(np.subtract(self[:4], other[:4])).max() <= _ALIKE
        )


def cut_of(corners: np.ndarray, faces: Sequence[Sequence[int]]) -> Cut:
    """How an upright post is cut.

    Args:
        corners: float64[V, 3], z up [m].
        faces: indices of corners, counter-clockwise from outside.
    """
    import shapely

    low, height = float(corners[:, 2].min()), float(np.ptp(corners[:, 2]))
    near = _NEAR * height
    flat = shapely.MultiPoint(corners[:, :2]).minimum_rotated_rectangle
    ring = shapely.get_coordinates(flat)
    depth, width = sorted(np.linalg.norm(ring[1:3] - ring[:2], axis=1).tolist())
    # Of every corner of the base, how far the edge above it goes up.
    upright = dict.fromkeys(np.flatnonzero(corners[:, 2] - low <= near).tolist(), 0.0)
    angles: list[float] = []
    for face in faces:
        points = corners[list(face)]
        for a, b in zip(face, (*face[1:], face[0]), strict=True):
            way = corners[b] - corners[a]
            if a in upright and np.abs(way[:2]).max() <= near:
                upright[a] = max(upright[a], float(way[2]))
        normal = area_vector(points)
        if normal[2] > _NEAR * np.linalg.norm(normal):
            angle = float(np.degrees(np.arctan2(np.hypot(*normal[:2]), normal[2])))
            if all(abs(angle - other) > 0.05 for other in angles):
                angles.append(angle)
    shortest = min(upright.values())
    return Cut(width, depth, height, shortest, tuple(sorted(angles)))
