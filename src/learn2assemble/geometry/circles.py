"""Round limits of convex sets about zero: a circle inside points of the plane, a ball around a
polyhedron."""

from __future__ import annotations

from functools import lru_cache
from itertools import product

import numpy as np

_SAME = 1e-12


def inner_circle(points: np.ndarray) -> tuple[float, float]:
    """The largest circle about zero inside the convex hull of points in the plane.

    Whatever convex set the points were proven to be in contains it.

    Args:
        points: float64[n, 2].

    Returns:
        The radius, 0 where zero is not inside the hull, and the angle [rad] at which the circle
        touches it: the direction in which one more point would help most.
    """
    edge = points[None] - points[:, None]
    length = np.linalg.norm(edge, axis=-1)
    apart = length > _SAME
    out = np.stack([edge[..., 1], -edge[..., 0]], -1) / np.where(apart, length, 1.0)[..., None]
    offset = np.einsum("ijk,ik->ij", out, points)
    beyond = (np.einsum("ijk,lk->ijl", out, points) - offset[..., None]).max(-1, initial=-np.inf)
    # The sides of the hull are the edges that no point lies outside of.
    side = apart & (beyond <= _SAME + 1e-9 * np.abs(points).max(initial=0.0))
    if not side.any():
        return 0.0, 0.0
    distance = np.where(side, offset, np.inf)
    i, j = np.unravel_index(np.argmin(distance), distance.shape)
    return max(float(distance[i, j]), 0.0), float(np.arctan2(out[i, j, 1], out[i, j, 0]))


@lru_cache(maxsize=8)
def ball(dimensions: int) -> tuple[np.ndarray, float]:
    """Directions float64[k, n], and the share s for which {x: d x <= s r} lies in the ball of
    radius r about zero.

    Args:
        dimensions: 2 (sixteen directions) or 3 (those of the faces, edges and corners of a cube).
    """
    from scipy.spatial import HalfspaceIntersection  # pyright: ignore[reportMissingTypeStubs]

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
