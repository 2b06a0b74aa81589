"""Which pixels a box fills, from ray casting in closed form.

For one image row the rays lie in a plane, and the part of a box nearer than some depth is convex,
so the pixels it covers are one interval. Two pixel sets per side are enough for both coverages of
the paper, and both only grow when a box is added:

* ``covered``: pixels whose ray meets something no deeper than a depth window reaches (the complete
  filter), 0.226 m without a robot;
* ``occluded``: pixels whose ray meets something nearer than the window, 0.224 m.

Plane filter = covered and not occluded. Complete filter = covered. The window is a
:class:`DepthFilter`, as it is wider in the environments with a robot.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from learn2assemble.geometry.images import (
    CAMERA_Y,
    CAMERA_Z,
    CENTRE,
    FAR_CLIP,
    IMAGE_SIZE,
    NEAR_CLIP,
    ROWS,
    TAN_HALF_FOV,
    WORDS,
    popcount,
    span_word,
)

PLANE_NEAR, PLANE_FAR = 0.224, 0.226
"""Depth window of the plane filter without a robot [m]."""
WIDE_NEAR, WIDE_FAR = 0.21, 0.25
"""The same with a robot, whose blocks stand up to some millimetres beside their places [m]."""


class DepthFilter(NamedTuple):
    """Which depths count as standing in the plane of a side."""

    hiding: float
    """Greatest depth at which something hides the plane [m]."""
    far: float
    """Greatest depth that counts [m]."""
    margin: float
    """How much smaller a block is seen than it is, on every side [m]."""


def _window(near: float, far: float, margin: float) -> DepthFilter:
    return DepthFilter(float(np.nextafter(near, 0.0)), far, margin)


NARROW = _window(PLANE_NEAR, PLANE_FAR, 0.0)
WIDE = _window(WIDE_NEAR, WIDE_FAR, 1e-6)
"""The wide window also sees the tops of blocks, whose edges pass exactly through pixels where
blocks stand on the lattice; in the recordings such pixels do not show the block."""
FILTERS = {"narrow": NARROW, "wide": WIDE}
"""Depth filters by name: without a robot, with a robot."""


@njit(cache=True, inline="always")
def _add_box(image, x, y, z, half, depth_limit):
    """Add the pixels whose ray meets the axis-aligned cube before ``depth_limit`` to ``image``."""
    d0 = max(y - half - CAMERA_Y, NEAR_CLIP)
    d1 = min(min(y + half - CAMERA_Y, FAR_CLIP), depth_limit)
    if d1 < d0:
        return
    z0, z1 = z - half - CAMERA_Z, z + half - CAMERA_Z
    x0, x1 = x - half, x + half
    # Pixel row r looks along (50 - (r + 1)) / 50 * tan 60.
    high_slope = z1 / d0 if z1 > 0 else z1 / d1
    low_slope = z0 / d1 if z0 > 0 else z0 / d0
    first = max(int(math.ceil(CENTRE - 1 - high_slope * CENTRE / TAN_HALF_FOV)), 0)
    last = min(int(math.floor(CENTRE - 1 - low_slope * CENTRE / TAN_HALF_FOV)), ROWS - 1)
    for row in range(first, last + 1):
        slope = (CENTRE - (row + 1)) / CENTRE * TAN_HALF_FOV
        da, db = d0, d1
        if slope < 0:
            da, db = max(da, z1 / slope), min(db, z0 / slope)
        elif slope > 0:
            da, db = max(da, z0 / slope), min(db, z1 / slope)
        if db < da:
            continue
        left = x0 / da if x0 < 0 else x0 / db
        right = x1 / da if x1 > 0 else x1 / db
        c0 = max(int(math.ceil(CENTRE + CENTRE * left / TAN_HALF_FOV)), 0)
        c1 = min(int(math.floor(CENTRE + CENTRE * right / TAN_HALF_FOV)), IMAGE_SIZE - 1)
        if c1 < c0:
            continue
        for w in range(WORDS):
            image[row, w] |= span_word(c0, c1, w)


@njit(cache=True)
def add_box(covered, occluded, x, y, z, half, depths=NARROW):
    """Add one axis-aligned cube (local centre, half edge [m]) to both pixel sets of a side."""
    _add_box(covered, x, y, z, half - depths.margin, depths.far)
    _add_box(occluded, x, y, z, half - depths.margin, depths.hiding)


@njit(cache=True)
def clear_to_ground(covered, occluded, depths=NARROW):
    """Reset both pixel sets to the empty ground or table, of which only a front strip is seen."""
    for row in range(ROWS):
        slope = (CENTRE - (row + 1)) / CENTRE * TAN_HALF_FOV
        depth = -CAMERA_Z / slope if slope < 0 else FAR_CLIP + 1.0
        for w in range(WORDS):
            full = span_word(0, IMAGE_SIZE - 1, w)
            covered[row, w] = full if depth <= depths.far else np.uint64(0)
            occluded[row, w] = full if depth <= depths.hiding else np.uint64(0)


@njit(cache=True)
def count_cover(mask, covered, occluded, first, last):
    """Mask pixels passed by the plane filter and by the complete filter, rows ``first..last-1``."""
    plane = np.uint64(0)
    complete = np.uint64(0)
    for row in range(first, last):
        for w in range(WORDS):
            seen = mask[row, w] & covered[row, w]
            complete += popcount(seen)
            plane += popcount(seen & ~occluded[row, w])
    return np.int64(plane), np.int64(complete)
