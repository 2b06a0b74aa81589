"""Which brick goes where in one layer: the one that links most, and that is nearest to the ground.

How near is a matter of *ways*: from a cell along its brick to one that the brick bears on, from
there along the brick below, and so on down to the ground; the level parts of the shortest way, in
studs. The least that a way could be is known from the cells alone, as if every layer were one
brick. Bricks whose ways are much longer hang on the tips of others: they would stand last of all,
and need more strength than knobs have.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.kernels import kernel

NO_WAY = 1e6
"""Studs to the ground of what bears on nothing."""
_LINK, _LOOSE, _HANGING, _EXCESS = 3.0, 100.0, 60.0, 3.0
"""What a brick linked above or below is worth, in cells; what it costs to link none, to bear on
none, and of a stud that its ways are longer than they could be."""
_ALLOWED = 0.5
"""Studs that ways are longer at no cost, once a layer is covered."""


class Covering(NamedTuple):
    """What a layer is covered by, and beside.

    All are arrays [X, Y].
    """

    free: np.ndarray
    """bool: cells that are still to be covered."""
    below: np.ndarray
    """int64: the brick below every cell, or -1."""
    above: np.ndarray
    """int64: that above it."""
    ways: np.ndarray
    """float64: from the brick below every cell to the ground; 0 of the ground."""
    least: np.ndarray
    """float64: the least that ways from the layer's cells could be."""


@kernel
def least_ways(below: np.ndarray, cells: np.ndarray) -> np.ndarray:  # pragma: no cover
    """float64[X, Y]: ways to the ground as if a layer were one brick.

    Args:
        below: float64[X, Y], of what is below.
        cells: bool[X, Y], of the layer.
    """
    across, along = cells.shape
    found = np.where(cells, below, NO_WAY)
    changed = True
    while changed:
        changed = False
        for turn in range(2):  # There and back: a way goes along both axes either way.
            for m in range(across):
                for n in range(along):
                    x, y = (across - 1 - m, along - 1 - n) if turn else (m, n)
                    if not cells[x, y]:
                        continue
                    i, j = (x + 1, y + 1) if turn else (x - 1, y - 1)
                    shortest = found[x, y]
                    if 0 <= i < across and cells[i, y]:
                        shortest = min(shortest, found[i, y] + 1.0)
                    if 0 <= j < along and cells[x, j]:
                        shortest = min(shortest, found[x, j] + 1.0)
                    if shortest < found[x, y]:
                        found[x, y] = shortest
                        changed = True
    return found


@kernel
def ways_of(ways: np.ndarray, i: int, j: int, a: int, b: int) -> np.ndarray:  # pragma: no cover
    """float64[a, b]: from the cells of a brick to the ground.

    Args:
        ways: float64[X, Y], of what is below.
        i, j, a, b: the brick's first cell, and how many there are.
    """
    found = np.full((a, b), NO_WAY)
    for p in range(a):
        for q in range(b):
            for r in range(a):
                for s in range(b):
                    way = ways[i + r, j + s]
                    if way < NO_WAY:
                        found[p, q] = min(found[p, q], way + abs(p - r) + abs(q - s))
    return found


@kernel
def _different(names: np.ndarray, seen: np.ndarray) -> int:  # pragma: no cover
    """How many names from 0 on there are in an array; ``seen`` is room to note them."""
    count = 0
    for name in names.flat:
        if name < 0:
            continue
        new = True
        for k in range(count):
            if seen[k] == name:
                new = False
        if new:
            seen[count] = name
            count += 1
    return count


@kernel
def best_brick(  # pragma: no cover
    layer: tuple[np.ndarray, ...],
    sizes: np.ndarray,
    x: int,
    y: int,
    corner: np.ndarray,
    chance: np.ndarray,
) -> tuple[int, int, int, int]:
    """The brick that covers a cell best: its first cell and its extents.

    Args:
        layer: the fields of a :class:`Covering`; as a plain tuple, as what is kept of compiled code
            names the classes that it was made for, and fails to load where one is called otherwise.
        sizes: int64[n, 2], extents of the bricks there are.
        x, y: the cell, which is free.
        corner: bool[2], whether it is the brick's last one along an axis, else the first; an empty
            array where it may be any of it.
        chance: float64[m], added in turn, for what is as good.
    """
    free, below, above, ways, least = layer
    seen = np.empty(sizes[:, 0].max() * sizes[:, 1].max(), np.int64)
    best, turn = -np.inf, 0
    found = (x, y, 1, 1)
    for k in range(len(sizes)):
        a, b = sizes[k]
        for p in range(a):
            for q in range(b):
                if len(corner) and (p != (a - 1) * corner[0] or q != (b - 1) * corner[1]):
                    continue
                i, j = x - p, y - q
                turn += 1
                if i < 0 or j < 0 or i + a > free.shape[0] or j + b > free.shape[1]:
                    continue
                if not free[i : i + a, j : j + b].all():
                    continue
                worth = a * b + chance[turn % len(chance)]
                links = _different(below[i : i + a, j : j + b], seen)
                links += _different(above[i : i + a, j : j + b], seen)
                worth += _LINK * links if links else -_LOOSE
                mine = ways_of(ways, i, j, a, b)
                if mine[0, 0] >= NO_WAY:
                    worth -= _HANGING
                else:
                    worth -= _EXCESS * (mine - least[i : i + a, j : j + b]).mean()
                if worth > best:
                    best = worth
                    found = (i, j, a, b)
    return found


def cost_of(mine: np.ndarray, least: np.ndarray) -> float:
    """What a brick costs that is there, beside one.

    Args:
        mine: float64[a, b], ways of its cells to the ground.
        least: float64[a, b], the least that they could be.
    """
    if mine[0, 0] >= NO_WAY:
        return _HANGING
    return _EXCESS * max(0.0, float((mine - least).mean()) - _ALLOWED)
