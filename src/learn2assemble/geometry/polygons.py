"""Polygons in space: plane ones, and rings that nearly are."""

from __future__ import annotations

import numpy as np


def area_vector(corners: np.ndarray) -> np.ndarray:
    """float64[3]: along the normal of a ring of corners, float64[n, 3], towards where it is
    counter-clockwise from, and twice as long as its area is large."""
    # From the middle: far from the origin rounding is larger than small faces.
    arm = corners - corners.mean(0)
    x, y, z = arm.T
    u, v, w = np.concatenate([arm[1:], arm[:1]]).T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], 1).sum(0)
