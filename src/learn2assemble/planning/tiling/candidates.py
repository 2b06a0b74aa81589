"""Blocks at all places where they could stand among cells, and what each of them costs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from learn2assemble.assembly.kit import Cell, Kit, Orientation, orientations
from learn2assemble.kernels import kernel
from learn2assemble.linear_programs import INF


@dataclass(frozen=True)
class Costs:
    """What the tiler pays, in blocks."""

    seam: float = 1.2
    """Bonus for bridging a seam of the layer below, per cell edge."""
    overhang: float = 0.25
    """For a block with nothing below any of its cells, in proportion to such cells."""
    slender: float = 0.5
    """For a centroid right on the edge of the support, falling to 0 half a cell inside."""
    prop: float = 40.0
    """For a block that cannot be put down without a prop."""
    colour: float = 4.0
    """For every cell of a block that has another colour than most of its cells."""
    open_cell: float = 2000.0
    """For a cell left open, and half of it for a cell of a block that the heap does not have."""


COSTS = Costs()


@dataclass(frozen=True)
class BlockPlacement:
    """One block on the lattice."""

    kind: str
    turn: int
    """See :func:`learn2assemble.assembly.kit.turned_cells`."""
    origin: Cell
    """Smallest corner of its cells."""
    prop: bool = False
    """Whether it is a temporary support, taken away again."""


@dataclass(frozen=True)
class Candidates:
    """Every way to put one block into a design, as arrays."""

    ways: tuple[Orientation, ...]
    way: np.ndarray
    """int64[n]: index into ``ways``."""
    origin: np.ndarray
    """int64[n, 3]."""
    start: np.ndarray
    """int64[n + 1]."""
    cell: np.ndarray
    """int64[start[n]]: flat indices of cells (C order) of all candidates, one after the other."""
    support: np.ndarray
    """float64[n]: how far inside the hull of what carries it the centroid is [cells]; negative
    outside, -inf where nothing is below."""
    hanging: np.ndarray
    """float64[n]: share of its lowest cells with nothing below."""
    strange: np.ndarray
    """int64[n]: its cells that have another colour than most of them."""

    def __len__(self) -> int:
        return len(self.way)

    @property
    def kind(self) -> np.ndarray:
        """int64[n]: index into the kinds of the kit."""
        return np.array([way.kind for way in self.ways], np.int64)[self.way]

    @cached_property
    def extents(self) -> np.ndarray:
        """int64[ways, 3]: cells along x, y and z of each way."""
        return np.array([np.max(way.cells, axis=0) + 1 for way in self.ways])

    def size(self) -> np.ndarray:
        """int64[n]: cells of every candidate."""
        return np.diff(self.start)

    def take(self, keep: np.ndarray) -> Candidates:
        """The candidates with the given indices."""
        size = self.size()[keep]
        start = np.concatenate([[0], np.cumsum(size)])
        inner = np.arange(int(start[-1])) - np.repeat(start[:-1], size)
        cell = self.cell[np.repeat(self.start[keep], size) + inner]
        return Candidates(
            self.ways,
            self.way[keep],
            self.origin[keep],
            start,
            cell,
            self.support[keep],
            self.hanging[keep],
            self.strange[keep],
        )

    def blocks(self, kit: Kit, picked: np.ndarray) -> list[BlockPlacement]:
        """The candidates with the given indices as blocks of ``kit``."""
        numbers: list[int] = self.way[picked].tolist()
        ways = [self.ways[k] for k in numbers]
        return [
            BlockPlacement(kit.kinds[way.kind].name, way.turn, (x, y, z))
            for way, (x, y, z) in zip(ways, self.origin[picked].tolist(), strict=True)
        ]


def placement_cells(placement: BlockPlacement, kit: Kit) -> np.ndarray:
    """int64[m, 3]: the lattice cells of a block."""
    return _cells_by_way(kit)[placement.kind, placement.turn] + placement.origin


@lru_cache(maxsize=64)
def _cells_by_way(kit: Kit) -> dict[tuple[str, int], np.ndarray]:
    return {(kit.kinds[way.kind].name, way.turn): np.array(way.cells) for way in orientations(kit)}


def from_below(blocks: Iterable[BlockPlacement]) -> tuple[BlockPlacement, ...]:
    """Blocks in the order in which a tiling holds them."""
    return tuple(sorted(blocks, key=lambda block: block.origin[::-1]))


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


def find_candidates(
    wanted: np.ndarray,
    kit: Kit,
    below: np.ndarray | None = None,
    flat_only: bool = False,
    shades: np.ndarray | None = None,
) -> Candidates:
    """Every block of ``kit`` that lies inside ``wanted`` and can be put down.

    A block is left out where everything between two of its cells, one above the other, is wanted:
    what fills such a slot lies on the block and carries it, so neither can come first.

    Args:
        wanted: bool[X, Y, Z].
        below: bool[X, Y], what lies under the lowest level; without it, the table.
        flat_only: leave out ways that are taller than a cell.
        shades: int[X, Y, Z], equal where cells have one colour.
    """
    ground = np.ones(wanted.shape[:2], bool) if below is None else below
    carried = np.concatenate([ground[:, :, None], wanted[:, :, :-1]], 2)
    flat_carried = carried.reshape(-1)
    ways, strides = orientations(kit), np.array([*wanted.shape[1:], 1])[::-1].cumprod()[::-1]
    parts: list[tuple[Any, ...]] = [
        (
            none := np.empty(0, np.int64),
            np.empty((0, 3), np.int64),
            none,
            none,
            np.empty(0),
            np.empty(0),
            none,
        ),
    ]
    for number, way in enumerate(ways):
        cells = np.array(way.cells)
        extent = cells.max(0) + 1
        if (extent > wanted.shape).any() or (flat_only and extent[2] > 1):
            continue
        room = np.array(wanted.shape) - extent + 1
        fits = np.ones(room, bool)
        for x, y, z in way.cells:
            fits &= wanted[x : x + room[0], y : y + room[1], z : z + room[2]]
        for x, y, low, high in _slots(way.cells):
            full = wanted[x : x + room[0], y : y + room[1]]
            fits &= ~np.all([full[:, :, z : z + room[2]] for z in range(low, high)], axis=0)
        origin = np.argwhere(fits)
        if not len(origin):
            continue
        index = (origin @ strides)[:, None] + cells @ strides
        lowest = np.array([(x, y, z - 1) not in way.cells for x, y, z in way.cells])
        bears = flat_carried[index] & lowest
        patterns, which = np.unique(bears, axis=0, return_inverse=True)
        margins = np.array([support_margin(cells, pattern, kit) for pattern in patterns])
        parts.append(
            (
                np.full(len(origin), number),
                origin,
                index.reshape(-1),
                np.full(len(origin), len(cells)),
                margins[which.reshape(-1)],
                1 - bears.sum(1) / lowest.sum(),
                np.zeros(len(origin), np.int64)
                if shades is None
                else strange_cells(shades.reshape(-1)[index]),
            )
        )
    which, origin, cell, size, support, hanging, strange = map(
        np.concatenate, zip(*parts, strict=True)
    )
    start = np.concatenate([[0], np.cumsum(size)])
    return Candidates(ways, which, origin, start, cell, support, hanging, strange)


def strange_cells(shades: np.ndarray) -> np.ndarray:
    """int64[n]: how many cells of every block have another colour than most of its cells.

    Args:
        shades: int[n, m], those of the cells of n blocks.
    """
    return shades.shape[1] - (shades[:, :, None] == shades[:, None]).sum(2).max(1)


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


def standing_cost(candidates: Candidates) -> np.ndarray:
    """float64[n]: 1 for the block, and what its overhang and its colours cost."""
    bad = candidates.support <= 1e-9
    slender = np.clip(1 - candidates.support / 0.5, 0.0, 1.0)
    slender[bad] = 0.0
    depth = np.where(np.isfinite(candidates.support), -candidates.support, 8.0)
    return (
        1
        + COSTS.overhang * candidates.hanging
        + COSTS.slender * slender
        + COSTS.colour * candidates.strange
        + np.where(bad, COSTS.prop * (1 + 0.05 * np.clip(depth, 0, 8)), 0.0)
    )


def bond_cost(candidates: Candidates, joints: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """float64[n]: :func:`standing_cost`, less what bridging ``joints`` is worth, see
    :func:`glued`."""
    return standing_cost(candidates) - COSTS.seam * glued(candidates, joints)


def glued(candidates: Candidates, edges: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """float64[n]: how many of the given pairs of neighbouring cells every candidate fills both.

    Args:
        edges: bool[X - 1, Y, Z] and bool[X, Y - 1, Z]: pairs of neighbours in x, and in y.
    """
    found = [(*filled_pairs(candidates, axis), edge) for axis, edge in enumerate(edges)]
    one, other = (
        np.bincount(which, edge[tuple(place.T)], len(candidates)) for which, place, edge in found
    )
    return one + other


def filled_pairs(candidates: Candidates, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of neighbours along an axis both of which a candidate fills: the candidates (int64[m]),
    and the first cell of each pair (int64[m, 3])."""
    which: list[np.ndarray] = [np.empty(0, np.int64)]
    place: list[np.ndarray] = [np.empty((0, 3), np.int64)]
    for number, way in enumerate(candidates.ways):
        chosen = np.flatnonzero(candidates.way == number)
        for x, y, z in way.cells:
            if (x + (axis == 0), y + (axis == 1), z) in way.cells:
                which.append(chosen)
                place.append(candidates.origin[chosen] + (x, y, z))
    return np.concatenate(which), np.concatenate(place)
