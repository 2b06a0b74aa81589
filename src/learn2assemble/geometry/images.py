"""The depth camera that looks at one side of a structure, and target masks as its images.

Local frame of a side: x right, y away from the viewer, z up [m]. The camera stands at
``(0, -0.25, 0.25)`` and looks along +y; its image has 100x100 pixels and a field of view of
120 degrees both ways. The face plane of the side is ``y = -0.025``, at depth 0.225 m.

A binary image is ``uint64[ROWS, WORDS]``; bit ``c % 64`` of word ``c // 64`` is column ``c``.

The published mask intersects half-planes, so it is exact for convex outlines with at most five
vertices only; tasks draw no others.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, types
from numba.extending import intrinsic

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


def project(x: float, z: float) -> tuple[float, float]:
    """Image point ``(u, v)`` [px, v down] of ``(x, z)`` [m] in the face plane."""
    return CENTRE * (1 + x / HALF_EXTENT), CENTRE * (1 - (z - CAMERA_Z) / HALF_EXTENT)


def unproject(u: float, v: float) -> tuple[float, float]:
    """Inverse of :func:`project`."""
    return (u / CENTRE - 1) * HALF_EXTENT, (1 - v / CENTRE) * HALF_EXTENT + CAMERA_Z


ROWS = IMAGE_SIZE
WORDS = (IMAGE_SIZE + 63) // 64


@intrinsic
def _ctpop(typingctx, word):
    def codegen(context, builder, signature, args):
        return builder.ctpop(args[0])

    return types.uint64(types.uint64), codegen


@njit(cache=True, inline="always")
def popcount(word):
    """Number of ones in an unsigned 64-bit word (one machine instruction)."""
    return _ctpop(word)  # pyright: ignore[reportCallIssue]


@njit(cache=True, inline="always")
def span_word(first, last, word):
    """The bits of columns ``first..last`` (inclusive) that fall in word number ``word``."""
    low = max(first - 64 * word, 0)
    high = min(last - 64 * word, 63)
    if high < low:
        return np.uint64(0)
    full = np.uint64(0xFFFFFFFFFFFFFFFF)
    return (full >> np.uint64(63 - (high - low))) << np.uint64(low)


def to_pixels(image: np.ndarray) -> np.ndarray:
    """``uint64[..., ROWS, WORDS]`` to ``bool[..., ROWS, IMAGE_SIZE]``."""
    shifts = np.arange(64, dtype=np.uint64)
    bits = (image[..., None] >> shifts) & np.uint64(1)
    return bits.reshape(*image.shape[:-1], -1)[..., :IMAGE_SIZE].astype(bool)


def from_pixels(pixels: np.ndarray) -> np.ndarray:
    """Inverse of :func:`to_pixels`."""
    padded = np.zeros((*pixels.shape[:-1], 64 * WORDS), np.uint64)
    padded[..., : pixels.shape[-1]] = pixels
    words = padded.reshape(*pixels.shape[:-1], WORDS, 64)
    weights = np.uint64(1) << np.arange(64, dtype=np.uint64)
    return (words * weights).sum(-1, dtype=np.uint64)


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
