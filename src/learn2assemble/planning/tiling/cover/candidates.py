"""Blocks at all places where they could stand among cells, and what each of them costs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np

from learn2assemble.assembly.kit import Cell, Kit, Orientation, orientations
from learn2assemble.kernels import kernel
from learn2assemble.planning.tiling.cover.ways import WayCells, WayTable, ways_of


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

    table: WayTable
    """Of the kit."""
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
    def ways(self) -> tuple[Orientation, ...]:
        """All ways of the kit."""
        return self.table.all

    @property
    def kind(self) -> np.ndarray:
        """int64[n]: index into the kinds of the kit."""
        return self.table.kind[self.way]

    @property
    def extents(self) -> np.ndarray:
        """int64[ways, 3]: cells along x, y and z of each way."""
        return self.table.shapes.extent

    @cached_property
    def lowest(self) -> np.ndarray:
        """bool[start[n]], of all cells: no cell of the same candidate is right below."""
        shapes = self.table.shapes
        inner = np.arange(len(self.cell)) + np.repeat(
            shapes.start[self.way] - self.start[:-1], self.size()
        )
        return shapes.lowest[inner]

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
            self.table,
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
    # Arrays of one layout: of every other one the kernel would be compiled anew.
    carried = np.ascontiguousarray(np.concatenate([ground[:, :, None], wanted[:, :, :-1]], 2))
    table, wanted = ways_of(kit), np.ascontiguousarray(wanted)
    tall = 1 if flat_only else wanted.shape[2]
    way, origin, start, cell, bears, hanging = _fitting(
        wanted, np.ascontiguousarray(np.argwhere(wanted)), carried, tall, table.shapes
    )
    support = table.margins(way, bears, start)
    strange = np.zeros(len(way), np.int64)
    if shades is not None:
        tint, first = shades.reshape(-1)[cell], np.searchsorted(way, np.arange(len(table.all) + 1))
        for low, high in pairwise(first.tolist()):
            if high > low:
                of_way = tint[start[low] : start[high]].reshape(high - low, -1)
                strange[low:high] = strange_cells(of_way)
    return Candidates(table, way, origin, start, cell, support, hanging, strange)


@kernel
def _fitting(
    wanted: np.ndarray, cells: np.ndarray, carried: np.ndarray, tall: int, shapes: WayCells
) -> tuple[np.ndarray, ...]:
    """Everywhere where a block lies inside what is wanted, by way and then by origin.

    Args:
        wanted: bool[X, Y, Z].
        cells: int64[m, 3], those that are wanted, in C order.
        carried: bool[X, Y, Z], of each cell: what is below bears.
        tall: levels of the tallest way.

    Returns:
        tuple: ``way``, ``origin``, ``start`` and ``cell`` as in :class:`Candidates`;
        bool[start[n]], which lowest cells are borne; float64[n], the share of the lowest cells that
        are not.
    """
    x_room, y_room, z_room = wanted.shape
    ways = len(shapes.start) - 1
    fits = np.zeros((ways, len(cells)), np.bool_)
    number, total = 0, 0
    for w in range(ways):
        first, end = shapes.start[w], shapes.start[w + 1]
        if shapes.extent[w, 2] > tall:
            continue
        for m in range(len(cells)):
            # The first cell of a block is a wanted one.
            x = cells[m, 0] - shapes.cell[first, 0]
            y = cells[m, 1] - shapes.cell[first, 1]
            z = cells[m, 2] - shapes.cell[first, 2]
            good = x >= 0 and y >= 0 and z >= 0
            good = good and x + shapes.extent[w, 0] <= x_room
            good = good and y + shapes.extent[w, 1] <= y_room
            good = good and z + shapes.extent[w, 2] <= z_room
            k = first + 1
            while good and k < end:
                good = wanted[x + shapes.cell[k, 0], y + shapes.cell[k, 1], z + shapes.cell[k, 2]]
                k += 1
            s = shapes.slot_start[w]
            while good and s < shapes.slot_start[w + 1]:
                good = False
                for level in range(shapes.slot[s, 2], shapes.slot[s, 3]):
                    if not wanted[x + shapes.slot[s, 0], y + shapes.slot[s, 1], z + level]:
                        good = True
                s += 1
            if good:
                fits[w, m] = True
                number += 1
                total += end - first
    way, origin = np.empty(number, np.int64), np.empty((number, 3), np.int64)
    start, cell = np.empty(number + 1, np.int64), np.empty(total, np.int64)
    bears, hanging = np.empty(total, np.bool_), np.empty(number)
    n, at = 0, 0
    for w in range(ways):
        first, end = shapes.start[w], shapes.start[w + 1]
        for m in range(len(cells)):
            if not fits[w, m]:
                continue
            way[n], start[n] = w, at
            for axis in range(3):
                origin[n, axis] = cells[m, axis] - shapes.cell[first, axis]
            low, borne = 0, 0
            for k in range(first, end):
                x = origin[n, 0] + shapes.cell[k, 0]
                y = origin[n, 1] + shapes.cell[k, 1]
                z = origin[n, 2] + shapes.cell[k, 2]
                cell[at] = (x * y_room + y) * z_room + z
                bears[at] = shapes.lowest[k] and carried[x, y, z]
                if shapes.lowest[k]:
                    low += 1
                if bears[at]:
                    borne += 1
                at += 1
            hanging[n] = 1 - borne / low
            n += 1
    start[number] = at
    return way, origin, start, cell, bears, hanging


def strange_cells(shades: np.ndarray) -> np.ndarray:
    """int64[n]: how many cells of every block have another colour than most of its cells.

    Args:
        shades: int[n, m], those of the cells of n blocks.
    """
    return shades.shape[1] - (shades[:, :, None] == shades[:, None]).sum(2).max(1)


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
    order = np.argsort(candidates.way, kind="stable")
    first = np.searchsorted(candidates.way[order], np.arange(len(candidates.ways) + 1))
    return _filled_pairs(candidates.origin, order, first, candidates.table.shapes, axis)


@kernel
def _filled_pairs(
    origin: np.ndarray, order: np.ndarray, first: np.ndarray, shapes: WayCells, axis: int
) -> tuple[np.ndarray, np.ndarray]:
    """:func:`filled_pairs`, of candidates in an order by ways that begin at ``first``."""
    start, total = shapes.pair_start, 0
    for w in range(len(first) - 1):
        total += (first[w + 1] - first[w]) * (start[axis, w + 1] - start[axis, w])
    which, place = np.empty(total, np.int64), np.empty((total, 3), np.int64)
    k = 0
    for w in range(len(first) - 1):
        for p in range(start[axis, w], start[axis, w + 1]):
            for i in range(first[w], first[w + 1]):
                n = order[i]
                which[k] = n
                for a in range(3):
                    place[k, a] = origin[n, a] + shapes.pair[p, a]
                k += 1
    return which, place
