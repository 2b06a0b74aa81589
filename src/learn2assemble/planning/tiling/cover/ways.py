"""Ways to put down the blocks of a kit as arrays, and how firmly blocks stand on their cells."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.assembly.kit import Cell, Kit, Orientation, orientations
from learn2assemble.kernels import kernel
from learn2assemble.linear_programs import INF

_MOST_BITS = 12
"""Cells of the largest way whose patterns of carried cells are looked up in a table."""


class WayCells(NamedTuple):
    """The cells of all ways to put down blocks, one way after the other."""

    start: np.ndarray
    """int64[ways + 1]."""
    cell: np.ndarray
    """int64[start[-1], 3]."""
    lowest: np.ndarray
    """bool[start[-1]]: no cell of the same block is right below."""
    extent: np.ndarray
    """int64[ways, 3]: cells along x, y and z."""
    slot_start: np.ndarray
    """int64[ways + 1]."""
    slot: np.ndarray
    """int64[slots, 4]: x, y, and the levels, first and after the last, between two cells of a
    block, one above the other."""
    pair_start: np.ndarray
    """int64[2, ways + 1]."""
    pair: np.ndarray
    """int64[pairs, 3]: cells that have a neighbour in the block, in x and then in y."""


class WayTable:
    """All ways to put down the blocks of a kit, as tuples and as arrays.

    Args:
        kit: of which pitch and gap of joints count, too.
    """

    def __init__(self, kit: Kit) -> None:
        self.all: tuple[Orientation, ...] = orientations(kit)
        self.kind: np.ndarray = np.array([way.kind for way in self.all], np.int64)
        """int64[ways]: index into the kinds of the kit."""
        cells = [np.array(way.cells, np.int64).reshape(-1, 3) for way in self.all]
        size = np.array([len(one) for one in cells], np.int64)
        slots = [_slots(way.cells) for way in self.all]
        pairs = [
            [
                [at for at in way.cells if (at[0] + dx, at[1] + 1 - dx, at[2]) in way.cells]
                for way in self.all
            ]
            for dx in (1, 0)
        ]
        pair_start = np.cumsum([0] + [len(way) for axis in pairs for way in axis])
        self.shapes: WayCells = WayCells(
            _starts(size),
            np.concatenate(cells),
            np.array([(x, y, z - 1) not in way.cells for way in self.all for x, y, z in way.cells]),
            np.array([one.max(0) + 1 for one in cells]),
            _starts([len(way) for way in slots]),
            np.array([slot for way in slots for slot in way], np.int64).reshape(-1, 4),
            np.stack([pair_start[: len(size) + 1], pair_start[len(size) :]]),
            np.array([at for axis in pairs for way in axis for at in way], np.int64).reshape(-1, 3),
        )
        self._inset: tuple[float, ...] = tuple(kit.joint_gap / 2 / pitch for pitch in kit.pitch[:2])
        room = np.where(size <= _MOST_BITS, 1 << np.minimum(size, _MOST_BITS), 0)
        self._first: np.ndarray = np.where(room > 0, _starts(room)[:-1], -1)
        self._known: np.ndarray = np.full(int(room.sum()), np.nan)
        """float64: margins by way and carried cells, each found when it is first asked for."""

    def margins(self, way: np.ndarray, bears: np.ndarray, start: np.ndarray) -> np.ndarray:
        """float64[n]: how firmly blocks stand, see :func:`support_margin`.

        Args:
            way: int64[n].
            bears: bool[start[n]], of all cells of all blocks: what is below bears it.
            start: int64[n + 1].
        """
        code = _codes(way, bears, start, self._first)
        found = np.full(len(way), np.nan)
        found[code >= 0] = self._known[code[code >= 0]]
        for n in np.flatnonzero(np.isnan(found)).tolist():
            w, known = int(way[n]), int(code[n])
            if known >= 0 and not np.isnan(self._known[known]):
                found[n] = self._known[known]
                continue
            cells = self.shapes.cell[self.shapes.start[w] : self.shapes.start[w + 1]]
            carried = bears[start[n] : start[n + 1]]
            plan = (cells[:, :2] - cells[:, :2].min(0)).tobytes()
            found[n] = _support_margin(plan, carried.tobytes(), self._inset)
            if known >= 0:
                self._known[known] = found[n]
        return found


@lru_cache(maxsize=64)
def ways_of(kit: Kit) -> WayTable:
    """The table of a kit, made once."""
    return WayTable(kit)


def _starts(sizes: Any) -> np.ndarray:
    """int64[n + 1]: where each of n parts of the given sizes begins, one after the other."""
    return np.concatenate([[0], np.cumsum(np.asarray(sizes, np.int64))])


def support_margin(cells: np.ndarray, carried: np.ndarray, kit: Kit) -> float:
    """How far inside the hull of its carried cells the centroid of a block is [cells].

    Args:
        cells: int[m, 3], cells of the block.
        carried: bool[m]: what is below bears this cell.
        kit: for the joint gap, by half of which bed faces are smaller than cells.
    """
    plan = cells[:, :2] - cells[:, :2].min(0)
    inset = tuple(kit.joint_gap / 2 / pitch for pitch in kit.pitch[:2])
    return _support_margin(plan.astype(np.int64).tobytes(), carried.tobytes(), inset)


@lru_cache(maxsize=1 << 16)
def _support_margin(plan: bytes, bears: bytes, inset: tuple[float, ...]) -> float:
    """:func:`support_margin` of int64[m, 2] and bool[m] as bytes; few patterns come up often."""
    cells = np.frombuffer(plan, np.int64).reshape(-1, 2)
    carried = np.frombuffer(bears, bool)
    if not carried.any():
        return -INF
    centre = cells.mean(0) + 0.5
    hull = hull_of_boxes(cells[carried] + inset, cells[carried] + 1 - np.array(inset))
    edge = np.roll(hull, -1, 0) - hull
    beyond = edge[:, 0] * (centre[1] - hull[:, 1]) - edge[:, 1] * (centre[0] - hull[:, 0])
    return float((beyond / np.hypot(edge[:, 0], edge[:, 1])).min())


def hull_of_boxes(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """float64[h, 2]: the convex hull of rectangles with the corners float64[n, 2]."""
    ends = np.stack([low, high])
    return convex_hull(
        np.concatenate(
            [np.stack([ends[i, :, 0], ends[j, :, 1]], -1) for i in (0, 1) for j in (0, 1)]
        )
    )


@kernel
def convex_hull(points: np.ndarray) -> np.ndarray:
    """float64[h, 2]: corners of the hull of float64[n, 2], counter-clockwise, none on an edge."""
    order = np.argsort(points[:, 1], kind="mergesort")
    order = order[np.argsort(points[order, 0], kind="mergesort")]
    line, count = np.empty((len(order), 2)), 0
    for k in order:
        x, y = points[k, 0], points[k, 1]
        if count == 0 or line[count - 1, 0] != x or line[count - 1, 1] != y:
            line[count, 0], line[count, 1] = x, y
            count += 1
    if count < 3:
        return line[:count]
    # Along the lower side, and back along the upper one; the end of each begins the other.
    out, size = np.empty((2 * count, 2)), 0
    for way in range(2):
        first = size
        for i in range(count):
            x, y = line[count - 1 - i if way else i]
            while size - first > 1:
                ax, ay = out[size - 2]
                bx, by = out[size - 1]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 1e-9:
                    break
                size -= 1
            out[size, 0], out[size, 1] = x, y
            size += 1
        size -= 1
    return out[:size]


@kernel
def _codes(way: np.ndarray, bears: np.ndarray, start: np.ndarray, first: np.ndarray) -> np.ndarray:
    """int64[n]: places in a table of patterns: a bit for every cell, after what comes before the
    way (int64[ways]); -1 where the table has no place for a way."""
    code = np.full(len(way), -1)
    for n in range(len(way)):
        if first[way[n]] >= 0:
            pattern = 0
            for k in range(start[n + 1] - start[n]):
                if bears[start[n] + k]:
                    pattern |= 1 << k
            code[n] = first[way[n]] + pattern
    return code


def _slots(cells: tuple[Cell, ...]) -> list[tuple[int, int, int, int]]:
    """``x, y, low, high``: levels between two cells of a block, one above the other."""
    columns: dict[tuple[int, int], list[int]] = {}
    for x, y, z in sorted(cells):
        columns.setdefault((x, y), []).append(z)
    return [
        (*at, low + 1, high)
        for at, levels in columns.items()
        for low, high in pairwise(levels)
        if high > low + 1
    ]
