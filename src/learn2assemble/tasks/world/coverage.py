"""What a depth camera sees of one side of a structure: target masks, and which pixels boxes fill.

Local frame of a side: x right, y away from the viewer, z up [m]. The camera stands at
``(0, -0.25, 0.25)`` and looks along +y; its image has 100x100 pixels and a field of view of
120 degrees both ways. The face plane of the side is ``y = -0.025``, at depth 0.225 m.

A binary image is ``uint64[ROWS, WORDS]``; bit ``c % 64`` of word ``c // 64`` is column ``c``.

The published mask intersects half-planes, so it is exact for convex outlines with at most five
vertices only; tasks draw no others.

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
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import intrinsic

from learn2assemble.kernels import kernel

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


@kernel(inline="always")
def project(x: float, z: float) -> tuple[float, float]:
    """Image point ``(u, v)`` [px, v down] of ``(x, z)`` [m] in the face plane."""
    return CENTRE * (1 + x / HALF_EXTENT), CENTRE * (1 - (z - CAMERA_Z) / HALF_EXTENT)


@kernel(inline="always")
def unproject(u: float, v: float) -> tuple[float, float]:
    """Inverse of :func:`project`."""
    return (u / CENTRE - 1) * HALF_EXTENT, (1 - v / CENTRE) * HALF_EXTENT + CAMERA_Z


ROWS = IMAGE_SIZE
WORDS = (IMAGE_SIZE + 63) // 64


@intrinsic
def _ctpop(typingctx: Any, word: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.ctpop(args[0])

    return types.uint64(types.uint64), codegen


@kernel(inline="always")
def popcount(word: np.uint64) -> np.uint64:
    """Number of ones in an unsigned 64-bit word (one machine instruction)."""
    return _ctpop(word)  # pyright: ignore[reportCallIssue]


@kernel(inline="always")
def span_word(first: int, last: int, word: int) -> np.uint64:
    """The bits of columns ``first..last`` (inclusive) that fall in word number ``word``."""
    low = max(first - 64 * word, 0)
    high = min(last - 64 * word, 63)
    if high < low:
        return np.uint64(0)
    full = np.uint64(0xFFFFFFFFFFFFFFFF)
    return (full >> np.uint64(63 - (high - low))) << np.uint64(low)


def to_pixels(image: np.ndarray) -> np.ndarray:
    """``uint64[..., ROWS, WORDS]`` to ``bool[..., ROWS, IMAGE_SIZE]``."""
    octets = np.ascontiguousarray(image, "<u8").view(np.uint8)
    return np.unpackbits(octets, -1, IMAGE_SIZE, "little").astype(bool)


@kernel(inline="always")
def pixel_vertex(x: float, z: float) -> tuple[int, int]:
    """Vertex ``(x, z)`` [m] as an integer image point, rounded towards the image centre."""
    u, v = project(x, z)
    iu = math.floor(u) if u > CENTRE else math.ceil(u)
    iv = math.floor(v) if v > CENTRE else math.ceil(v)
    return int(iu), int(iv)


@kernel(inline="always")
def _clip_row(au: int, av: int, bu: int, bv: int, v: int, low: int, high: int) -> tuple[int, int]:
    """Columns of row ``v`` within ``low..high`` strictly right of the directed edge a->b."""
    du, dv = bu - au, bv - av
    side = du * (v - av)
    # Pixel (u, v) is inside when dv * (u - au) < side.
    if dv == 0:
        if side <= 0:
            return 1, 0
    elif dv > 0:
        high = min(high, au - ((-side) // dv) - 1)  # u < au + side/dv
    else:
        low = max(low, au + ((-side) // (-dv)) + 1)  # u > au + side/dv
    return low, high


@kernel
def paper_mask(vertices: np.ndarray, count: int, mask: np.ndarray) -> int:
    """Write the mask of one side into ``mask`` and return its number of pixels.

    Args:
        vertices: ``float64[V, 2]`` local (x, z) [m], clockwise as seen, ``count`` of them used.
        count: 3, 4 or 5; with 5 the third vertex is the roof vertex M.
        mask: ``uint64[ROWS, WORDS]``, overwritten.
    """
    us = np.empty(count, np.int64)
    vs = np.empty(count, np.int64)
    for k in range(count):
        us[k], vs[k] = pixel_vertex(vertices[k, 0], vertices[k, 1])
    total = 0
    for row in range(ROWS):
        for w in range(WORDS):
            mask[row, w] = 0
    top, bottom = max(vs.min(), 0), min(vs.max(), ROWS - 1)
    if count == 5:
        top = 0  # With a dented roof the half-planes may stay open above the vertices.
    for row in range(top, bottom + 1):
        low, high = 0, IMAGE_SIZE - 1
        for k in range(count):
            if count == 5 and (k == 1 or k == 2):
                continue
            n = (k + 1) % count
            low, high = _clip_row(us[k], vs[k], us[n], vs[n], row, low, high)
        if count == 5:
            # LT->M binds only columns left of M, M->RT only those from M on.
            l1, h1 = _clip_row(us[1], vs[1], us[2], vs[2], row, low, min(high, us[2] - 1))
            l2, h2 = _clip_row(us[2], vs[2], us[3], vs[3], row, max(low, us[2]), high)
        else:
            l1, h1, l2, h2 = low, high, 1, 0
        total += max(h1 - l1 + 1, 0) + max(h2 - l2 + 1, 0)
        for w in range(WORDS):
            mask[row, w] = span_word(l1, h1, w) | span_word(l2, h2, w)
    return total


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


@kernel(inline="always")
def _add_box(
    image: np.ndarray, x: float, y: float, z: float, half: float, depth_limit: float
) -> None:
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


@kernel
def add_box(
    covered: np.ndarray,
    occluded: np.ndarray,
    x: float,
    y: float,
    z: float,
    half: float,
    depths: DepthFilter = NARROW,
) -> None:
    """Add one axis-aligned cube (local centre, half edge [m]) to both pixel sets of a side."""
    _add_box(covered, x, y, z, half - depths.margin, depths.far)
    _add_box(occluded, x, y, z, half - depths.margin, depths.hiding)


@kernel
def clear_to_ground(
    covered: np.ndarray, occluded: np.ndarray, depths: DepthFilter = NARROW
) -> None:
    """Reset both pixel sets to the empty ground or table, of which only a front strip is seen."""
    for row in range(ROWS):
        slope = (CENTRE - (row + 1)) / CENTRE * TAN_HALF_FOV
        depth = -CAMERA_Z / slope if slope < 0 else FAR_CLIP + 1.0
        for w in range(WORDS):
            full = span_word(0, IMAGE_SIZE - 1, w)
            covered[row, w] = full if depth <= depths.far else np.uint64(0)
            occluded[row, w] = full if depth <= depths.hiding else np.uint64(0)


@kernel
def count_cover(
    mask: np.ndarray, covered: np.ndarray, occluded: np.ndarray, first: int, last: int
) -> tuple[int, int]:
    """Mask pixels passed by the plane filter and by the complete filter, rows ``first..last-1``."""
    plane = np.uint64(0)
    complete = np.uint64(0)
    for row in range(first, last):
        for w in range(WORDS):
            seen = mask[row, w] & covered[row, w]
            complete += popcount(seen)
            plane += popcount(seen & ~occluded[row, w])
    # Numba gives its callers integers of Python.
    return np.int64(plane), np.int64(complete)  # pyright: ignore[reportReturnType]
