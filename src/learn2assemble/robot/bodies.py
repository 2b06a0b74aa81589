"""Rigid blocks as an arm meets them: convex parts that are glued together, in the block's frame.

The frame of a block has its origin in the middle of the bounding box along its axes.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from learn2assemble.geometry.hulls import Hull, box_hull, hull_of, separation
from learn2assemble.geometry.rotations import quaternion_matrix


class Part(NamedTuple):
    """A convex part of a block."""

    centre: tuple[float, float, float]
    """Middle of its bounding box in the block's frame [m]."""
    half: tuple[float, float, float]
    """Half extents of that box [m]."""
    hull: Hull | None = None
    """About the centre; None: the part is the box."""

    @property
    def solid(self) -> Hull:
        """The part about its centre, whatever it is."""
        return _box(self.half) if self.hull is None else self.hull

    @property
    def points(self) -> np.ndarray:
        """float64[V, 3]: its corners in the block's frame [m]."""
        return self.solid.points + np.array(self.centre)

    @property
    def volume(self) -> float:
        """[m³]"""
        if self.hull is None:
            x, y, z = self.half
            return 8 * x * y * z
        return self.hull.volume


Shape = tuple[Part, ...]
"""The parts of a block; equal for blocks that can stand for one another."""


class Body(NamedTuple):
    """What the parts of a block are together, in its frame."""

    points: np.ndarray
    """float64[V, 3]: corners of all parts [m]."""
    hull: Hull
    """Of all of them."""
    volume: float
    """[m³]"""
    centre: np.ndarray
    """float64[3]: of mass [m]."""
    half: np.ndarray
    """float64[3]: half extents of the bounding box [m]."""


@lru_cache(maxsize=4096)
def body_of(shape: Shape) -> Body:
    """The parts of a block together."""
    points = np.vstack([part.points for part in shape])
    volumes = np.array([part.volume for part in shape])
    middles = [np.array(part.centre) + part.solid.centroid for part in shape]
    centre = volumes @ np.array(middles) / volumes.sum()
    half = np.abs(points).max(0)
    return Body(points, hull_of(points), float(volumes.sum()), centre, half)


@lru_cache(maxsize=4096)
def _box(half: tuple[float, float, float]) -> Hull:
    return box_hull(half)


Solid = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Corners, normals of faces and directions of edges of a convex part, where it is."""


def solids(shape: Shape, pose: np.ndarray) -> list[Solid]:
    """The parts of a block at a pose float64[7], as :func:`~.hulls.separation` takes them."""
    turn = quaternion_matrix(pose[3:])
    return [
        (pose[:3] + part.points @ turn.T, part.solid.normals @ turn.T, part.solid.edges @ turn.T)
        for part in shape
    ]


def overlaps(one: list[Solid], two: list[Solid], depth: float) -> bool:
    """Whether two blocks share more than ``depth`` along every axis that could part them [m]."""
    return any(separation(a, b)[0] < -depth for a in one for b in two)
