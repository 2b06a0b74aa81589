"""How far a convex set about zero reaches in every direction, from points known to be in it."""

from __future__ import annotations

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
