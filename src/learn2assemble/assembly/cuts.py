"""Posts: how they are cut from a bar (its section, its length, the top), and where they stand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Block
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


def ground_of(blocks: Sequence[Block], table: bool = False) -> float:
    """Height of the ground [m]: 0, or that of the lowest point of support blocks.

    Args:
        table: whether there is a table at z = 0, below which supports may reach, but no post.
    """
    lowest = min((float(b.vertices[:, 2].min()) for b in blocks if b.support), default=0.0)
    return max(lowest, 0.0) if table else lowest


def ground_of_each(blocks: Sequence[Block], carried: np.ndarray) -> np.ndarray:
    """float64[B]: height of the ground for each block [m], NaN where it has none.

    Without supports it is 0 for all. With some, props alone have one, at the lowest point of these;
    or at 0, a table below which these reach, for props that begin there and that nothing carries.

    Args:
        carried: indices of blocks that lie on others.
    """
    if not any(block.support for block in blocks):
        return np.zeros(len(blocks))
    ground, on_blocks = ground_of(blocks), set(carried.tolist())
    height = np.full(len(blocks), np.nan)
    for k, block in enumerate(blocks):
        if block.prop and not block.support:
            nearer = block.vertices[:, 2].min() > ground / 2 > ground
            height[k] = 0.0 if nearer and k not in on_blocks else ground
    return height
