"""Layers covered so that nothing is loose, as an integer program.

What is right over or under another cell is linked to it, whatever bricks they are of. So where some
bricks hang together with nothing else, all of their cells have only one another over and under
them, and a brick that links them has to have some of these cells and others beside them. Such
*cuts* are added until nothing is loose, or until there is no such cover, which is a proof.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from learn2assemble.linear_programs import Model, solve


class LayerCells(NamedTuple):
    """Cells that are covered by bricks of one height."""

    cells: np.ndarray
    """bool[X, Y]."""
    linked: np.ndarray
    """bool[X, Y]: cells with something right over or under them; the ground is something."""
    sizes: np.ndarray
    """int64[n, 2]: extents of the bricks there are."""
    cuts: np.ndarray
    """bool[k, X, Y]: cells of the k sets of which each has to be linked to others."""


Cover = list[tuple[int, int, int, int]]
"""Of each brick its first cell and its extents."""


class NoCover(Exception):
    """There is no cover without something loose."""


def linked_cover(layers: list[LayerCells], seconds: float) -> list[Cover] | None:
    """Bricks that cover layers, each with a cell that is linked, and across every cut one at least;
    few, and of these such as have many linked cells.

    Args:
        layers: with as many cuts each.
        seconds: of a clock, at most.

    Returns:
        Of each layer its bricks; None where none were found in time.

    Raises:
        NoCover: where there are none.
    """
    model = Model()
    bricks = [_bricks(layer) for layer in layers]
    total = sum(int(layer.cells.sum()) for layer in layers)
    across: list[np.ndarray] = []
    for layer, (some, owner, cell) in zip(layers, bricks, strict=True):
        wanted = np.flatnonzero(layer.cells)
        if len(np.unique(cell)) < len(wanted):
            raise NoCover
        # All that is added is less than one brick more.
        few = 1.0 / ((1 + total) * (1.0 + some[:, 4]))
        which = model.columns(1.0 + few, 1.0, integer=True)
        once = np.ones(len(wanted))
        model.rows(once, once, (np.searchsorted(wanted, cell), which[owner], 1.0))
        for cut in layer.cuts:
            mine = np.bincount(owner, cut.reshape(-1)[cell], len(some))
            both = (mine > 0) & (mine < some[:, 2] * some[:, 3])
            across.append(which[both])
    count = len(layers[0].cuts) if layers else 0
    for number in range(count):
        column = np.concatenate(across[number::count])
        if not len(column):
            raise NoCover
        model.rows(1.0, np.inf, (0, column, 1.0))
    answer = solve(model.program(), seconds)
    if answer.status == "infeasible":
        raise NoCover
    if answer.x is None:
        return None
    taken = np.split(answer.x > 0.5, np.cumsum([len(some) for some, _, _ in bricks])[:-1])
    return [
        [(i, j, a, b) for i, j, a, b, _ in some[mine].tolist()]
        for (some, _, _), mine in zip(bricks, taken, strict=True)
    ]


def _bricks(layer: LayerCells) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All bricks that have linked cells: int64[n, 5], first cell, extents, and how many; and their
    cells, int64[m] each: of which brick, and its number in the layer, row by row."""
    found = [np.empty((0, 5), np.int64)]
    owner, cell = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    count, wide = 0, layer.cells.shape[1]
    sizes: list[list[int]] = layer.sizes.tolist()
    for a, b in sizes:
        if a <= layer.cells.shape[0] and b <= wide:
            there = sliding_window_view(layer.cells, (a, b)).all((2, 3))
            links = sliding_window_view(layer.linked & layer.cells, (a, b)).sum((2, 3))
            at = np.argwhere(there & (links > 0))
            size = np.broadcast_to([a, b], at.shape)
            found.append(np.column_stack([at, size, links[tuple(at.T)]]))
            inside = (wide * np.arange(a)[:, None] + np.arange(b)).reshape(-1)
            cell.append((at @ [wide, 1])[:, None] + inside)
            owner.append(np.repeat(count + np.arange(len(at)), a * b))
            count += len(at)
    cells = np.concatenate([some.reshape(-1) for some in cell])
    return np.concatenate(found), np.concatenate(owner), cells
