"""Target outline to mask pixels, exactly as the published environment does it (protocol 3.2, 3.3).

The published rule intersects half-planes, so it is exact for convex outlines with at most five
vertices and says something else for others. :func:`polygon_mask` is the general rule (even-odd on
the same pixel points) that designs use; it is deviation D3 in ``docs/deviations.md``.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from learn2assemble.geometry.bits import ROWS, WORDS, from_pixels, span_word
from learn2assemble.geometry.camera import CAMERA_Z, CENTRE, HALF_EXTENT, IMAGE_SIZE


@njit(cache=True, inline="always")
def pixel_vertex(x, z):
    """Vertex ``(x, z)`` [m] as an integer image point, rounded towards the image centre."""
    u = CENTRE * (1 + x / HALF_EXTENT)
    v = CENTRE * (1 - (z - CAMERA_Z) / HALF_EXTENT)
    iu = math.floor(u) if u > CENTRE else math.ceil(u)
    iv = math.floor(v) if v > CENTRE else math.ceil(v)
    return int(iu), int(iv)


@njit(cache=True, inline="always")
def _clip_row(au, av, bu, bv, v, low, high):
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


@njit(cache=True)
def paper_mask(vertices, count, mask):
    """Write the mask of one side into ``mask`` and return its number of pixels.

    Args:
        vertices: ``float64[V, 2]`` local (x, z) [m], clockwise as seen, ``count`` of them used.
        count: 3, 4 or 5; with 5 the third vertex is the roof vertex M of protocol section 2.
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


def polygon_mask(outline: np.ndarray) -> np.ndarray:
    """Mask of any simple polygon: pixel points inside ``outline`` by the even-odd rule.

    Args:
        outline: ``float[V, 2]`` local (x, z) [m], either orientation.

    Returns:
        ``uint64[ROWS, WORDS]``. Pixel (row, column) stands for the image point (column, row), like
        in the published rule, but the vertices are not rounded.
    """
    u = CENTRE * (1 + outline[:, 0] / HALF_EXTENT)
    v = CENTRE * (1 - (outline[:, 1] - CAMERA_Z) / HALF_EXTENT)
    columns = np.arange(IMAGE_SIZE, dtype=float)[None, :]
    rows = np.arange(IMAGE_SIZE, dtype=float)[:, None]
    inside = np.zeros((IMAGE_SIZE, IMAGE_SIZE), bool)
    for k in range(len(outline)):
        u0, v0, u1, v1 = u[k - 1], v[k - 1], u[k], v[k]
        if v0 == v1:
            continue
        crosses = (v0 > rows) != (v1 > rows)
        inside ^= crosses & (columns < (u1 - u0) * (rows - v0) / (v1 - v0) + u0)
    return from_pixels(inside)
