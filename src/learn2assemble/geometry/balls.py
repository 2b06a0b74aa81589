"""Polyhedra inside balls, for round limits in linear programs."""

from __future__ import annotations

from functools import lru_cache
from itertools import product

import numpy as np


@lru_cache(maxsize=8)
def ball(dimensions: int) -> tuple[np.ndarray, float]:
    """Directions float64[k, n], and the share s for which {x: d x <= s r} lies in the ball of
    radius r about zero.

    Args:
        dimensions: 2 (sixteen directions) or 3 (those of the faces, edges and corners of a cube).
    """
    from scipy.spatial import HalfspaceIntersection

    if dimensions == 2:
        angle = np.pi / 8 * np.arange(16)
        ways = np.stack([np.cos(angle), np.sin(angle)], 1)
    else:
        grid = np.array([p for p in product((-1.0, 0.0, 1.0), repeat=dimensions) if any(p)])
        ways = grid / np.linalg.norm(grid, axis=1)[:, None]
    planes = np.hstack([ways, -np.ones((len(ways), 1))])
    corners = HalfspaceIntersection(planes, np.zeros(dimensions)).intersections
    ways.flags.writeable = False
    return ways, 1.0 / float(np.linalg.norm(corners, axis=1).max())
