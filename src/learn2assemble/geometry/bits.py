"""Binary images as rows of 64-bit words: a pixel set, its union and its count, without pixels.

An image is ``uint64[ROWS, WORDS]``; bit ``c % 64`` of word ``c // 64`` is column ``c``.
"""

from __future__ import annotations

import numpy as np
from numba import njit, types
from numba.extending import intrinsic

from learn2assemble.geometry.camera import IMAGE_SIZE

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
