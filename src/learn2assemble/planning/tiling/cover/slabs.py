"""Cells cut into slabs that bricks of one height fill, and hollowed."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage  # pyright: ignore[reportMissingTypeStubs]

_library: Any = ndimage
"""Functions without types."""


class Slab(NamedTuple):
    """Cells that bricks of one height fill, from one level."""

    low: int
    high: int
    """Their lowest level, and that above the highest."""
    cells: np.ndarray
    """bool[X, Y]."""


def slabs_of(wanted: np.ndarray, layers: int) -> list[Slab]:
    """Every cell in one slab, ``layers`` levels high where that many are filled, else one; from
    below.

    Bricks are in layers that go through the whole design, so that they bond; of the levels at which
    these may begin the one is taken that leaves the fewest parts of columns, then the fewest slabs.
    Plates fill what is left of a column below and above. A column that is high enough for a brick
    but meets no such layer has a brick where it begins, so nowhere are as many plates in one column
    as make a brick.

    Args:
        wanted: bool[X, Y, Z].
        layers: height of a brick [cells]; 1: all slabs are of one level.
    """
    return _slabs(_cut(wanted, layers, _first_layer(wanted, layers)))


def _first_layer(wanted: np.ndarray, layers: int) -> int:
    """The level at which layers of bricks begin, see :func:`slabs_of`."""

    def worth(first: int) -> tuple[int, int]:
        slabs = _slabs(_cut(wanted, layers, first))
        return sum(int(slab.cells.sum()) for slab in slabs), len(slabs)

    return min(range(layers), key=worth)


def inside(wanted: np.ndarray, thick: int, layers: int) -> np.ndarray:
    """bool[X, Y, Z]: cells that are more than ``thick`` cells, up and down so many bricks, from
    outside, in layers as high as bricks: nobody sees finer steps there, and plates would hang."""
    around = 2 * thick + 1
    deep: np.ndarray = _library.binary_erosion(
        wanted, np.ones((around, around, 2 * thick * layers + 1), bool)
    )
    found = np.zeros_like(wanted)
    for low in range(_first_layer(wanted, layers), wanted.shape[2] - layers + 1, layers):
        found[:, :, low : low + layers] = deep[:, :, low : low + layers].all(2, keepdims=True)
    return found


def _slabs(heights: np.ndarray) -> list[Slab]:
    """The slabs of a cut, from below, the highest first."""
    found = list[Slab]()
    for low in range(heights.shape[2]):
        for height in np.unique(heights[:, :, low])[::-1].tolist():
            if height:
                found.append(Slab(low, low + height, heights[:, :, low] == height))
    return found


def _cut(wanted: np.ndarray, layers: int, first: int) -> np.ndarray:
    """int64[X, Y, Z]: height of the part of a column that begins at a cell, 0 where none does.

    Args:
        first: level at which a layer of bricks begins; others follow above.
    """
    depth = wanted.shape[2]
    found = wanted.astype(np.int64)
    free = wanted.copy()

    def fill(low: int) -> None:
        where = np.logical_and.reduce(free[:, :, low : low + layers], axis=2)
        found[:, :, low : low + layers][where] = [layers] + [0] * (layers - 1)
        free[:, :, low : low + layers][where] = False

    if layers == 1:
        return found
    for low in range(first, depth - layers + 1, layers):
        fill(low)
    # Columns that meet no layer of bricks; what bricks leave of others is lower than one.
    for low in range(depth - layers + 1):
        fill(low)
    return found
