r"""Which blocks of a kit fill which cells: exact covers by integer programming.

With a binary :math:`x_p` for every block kind, turn and place :math:`p` inside the design,

.. math::

    \min \sum_p c_p x_p \quad \text{s.t.} \quad \sum_{p \ni c} x_p = 1 \; \forall c, \qquad
    \sum_{p \in k} x_p \le n_k \; \forall k \text{ with a limited number},

where :math:`c_p` is 1 for the block, less a bonus for every vertical seam of the layer below that
it bridges, plus what an overhang costs and what cells of another colour than most of the block's
cost (:class:`Costs`). A block whose centroid is not above the
hull of what carries it cannot be put down on its own: it costs as much as a prop.

Layers are decided from below, each connected part on its own, wide ones strip by strip. Where the
heap is limited or blocks are taller than a layer, one program decides the whole building; with a
limited heap the layers are then bonded again, each with the blocks that program gave it (and in
:mod:`.retiling` with those of the layers around it).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.assembly.kit import Cell, Kit, Orientation, orientations, parts_of
from learn2assemble.errors import InputError
from learn2assemble.linear_programs import INF, Answer, Clock, Model, solve
from learn2assemble.progress import Progress, silent

MAX_EXTENT, MAX_CELLS = 64, 64 * 64 * 64
STRIP = 240
"""Cells of a layer that one program decides; wider parts are cut into strips of about as many."""
MORE_TIME = "`seconds=` gives more"
"""Said where time ran out."""


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
class Tiling:
    """A design filled with blocks."""

    placements: tuple[BlockPlacement, ...]
    """From below, those of the structure first, then the props."""
    wanted: np.ndarray = field(repr=False)
    """bool[X, Y, Z]: the design."""
    status: str = "complete"
    """``"complete"``, ``"refused"`` (proven to be impossible), ``"not found"`` or ``"time"``."""
    reason: str = ""
    """Why it is not complete, in one line."""
    missing: tuple[Cell, ...] = ()
    """Wanted cells without a block."""
    lacking: tuple[Cell, ...] = ()
    """Where it is not complete: cells that nothing carries."""
    shades: np.ndarray | None = field(default=None, repr=False)
    """int[X, Y, Z]: equal where cells have one colour; None where the design has no colours."""


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

    def size(self) -> np.ndarray:
        """int64[n]: cells of every candidate."""
        return np.diff(self.start)

    def take(self, keep: np.ndarray) -> Candidates:
        """The candidates with the given indices."""
        size = self.size()[keep]
        start = np.concatenate([[0], np.cumsum(size)])
        inner = np.arange(start[-1]) - np.repeat(start[:-1], size)
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
        ways = [self.ways[k] for k in self.way[picked].tolist()]
        return [
            BlockPlacement(kit.kinds[way.kind].name, way.turn, (x, y, z))
            for way, (x, y, z) in zip(ways, self.origin[picked].tolist(), strict=True)
        ]


def check_cells(wanted: object) -> np.ndarray:
    """``wanted`` as bool[X, Y, Z], at most 64 cells a side, with a filled cell on the table.

    Raises:
        InputError: otherwise.
    """
    cells = np.asarray(wanted)
    if cells.ndim != 3 or cells.dtype != bool:
        raise InputError("cells", f"{cells.dtype}{list(cells.shape)}", "bool[X, Y, Z]")
    if max(cells.shape) > MAX_EXTENT or min(cells.shape) < 1:
        raise InputError("cells", list(cells.shape), f"1 to {MAX_EXTENT} along every axis")
    if not cells.any():
        raise InputError("cells", "no filled cell", "at least one")
    if not cells[:, :, 0].any():
        level = int(np.flatnonzero(cells.any((0, 1)))[0])
        raise InputError(
            "cells",
            f"a design that begins at level {level}",
            "one that stands on the table (level 0)",
        )
    return np.ascontiguousarray(cells)


def placement_cells(placement: BlockPlacement, kit: Kit) -> np.ndarray:
    """int64[m, 3]: the lattice cells of a block."""
    return _cells_by_way(kit)[placement.kind, placement.turn] + placement.origin


@lru_cache(maxsize=64)
def _cells_by_way(kit: Kit) -> dict[tuple[str, int], np.ndarray]:
    return {(kit.kinds[way.kind].name, way.turn): np.array(way.cells) for way in orientations(kit)}


def from_below(blocks: Iterable[BlockPlacement]) -> tuple[BlockPlacement, ...]:
    """Blocks in the order in which a tiling holds them."""
    return tuple(sorted(blocks, key=lambda block: block.origin[::-1]))


# ---------------------------------------------------------------- candidates


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


def convex_hull(points: np.ndarray) -> np.ndarray:
    """float64[h, 2]: corners of the hull of float64[n, 2], counter-clockwise, none on an edge."""
    ordered = sorted({(float(x), float(y)) for x, y in points})
    if len(ordered) < 3:
        return np.array(ordered)

    def half(line: list[tuple[float, float]]) -> list[tuple[float, float]]:
        out: list[tuple[float, float]] = []
        for x, y in line:
            while len(out) > 1:
                (ax, ay), (bx, by) = out[-2:]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 1e-9:
                    break
                out.pop()
            out.append((x, y))
        return out[:-1]

    return np.array(half(ordered) + half(ordered[::-1]))


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


def find_seams(owner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertical joints between neighbours in x, and in y.

    Args:
        owner: int[X, Y] or int[X, Y, Z], which block fills the cell, -1 for none.
    """
    x = (owner[1:] != owner[:-1]) & (owner[1:] >= 0) & (owner[:-1] >= 0)
    y = (owner[:, 1:] != owner[:, :-1]) & (owner[:, 1:] >= 0) & (owner[:, :-1] >= 0)
    return x, y


def seams_below(owner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The joints of the layer below each layer of int[X, Y, Z], see :func:`find_seams`."""
    x, y = (np.pad(seam[:, :, :-1], ((0, 0), (0, 0), (1, 0))) for seam in find_seams(owner))
    return x, y


def owners(placements: Iterable[BlockPlacement], kit: Kit, shape: tuple[int, ...]) -> np.ndarray:
    """int64[X, Y, Z]: which placement fills each cell, -1 for none."""
    owner = np.full(shape, -1)
    for number, placement in enumerate(placements):
        owner[tuple(placement_cells(placement, kit).T)] = number
    return owner


def seams_bridged(tiling: Tiling, kit: Kit) -> tuple[int, int]:
    """Interior vertical joints not continued in the next layer, and all of them [cell edges].

    A joint counts where the two cells above it are filled, too.
    """
    stays = tuple(p for p in tiling.placements if not p.prop)
    owner = owners(stays, kit, tiling.wanted.shape)
    bridged = total = 0
    pairs = (owner[:-1], owner[1:]), (owner[:, :-1], owner[:, 1:])
    for seam, (first, second) in zip(seams_below(owner), pairs, strict=True):
        counts = seam & (first >= 0) & (second >= 0)
        total += int(counts.sum())
        bridged += int((counts & (first == second)).sum())
    return bridged, total


# ---------------------------------------------------------------- one program


class CoverRules(NamedTuple):
    """What a choice of candidates is held to, besides the cells."""

    counts: dict[int, int] | None = None
    """How many blocks there are of the kinds with these indices."""
    exact: bool = False
    """Use exactly so many."""
    open_cost: float = 0.0
    """Where positive, a cell may stay open and a heap may be exceeded at this price."""
    cuts: Sequence[np.ndarray] = ()
    """int64 each: of these candidates at least one is chosen."""
    barred: Sequence[np.ndarray] = ()
    """int64 each: of these candidates at least one is not chosen."""


_FREE = CoverRules()


def cover(
    candidates: Candidates,
    cost: np.ndarray,
    must: np.ndarray,
    *,
    may: np.ndarray | None = None,
    kit: Kit,
    rules: CoverRules = _FREE,
    seconds: float = INF,
) -> tuple[Answer, np.ndarray, np.ndarray, dict[int, int]]:
    """The cheapest choice of candidates that covers cells.

    Args:
        must: int64[m], flat indices of cells to cover exactly once.
        may: of cells to cover once at most.

    Returns:
        the solver's answer; the chosen candidates; cells of ``must`` left open; blocks that the
        heap does not have, by kind.
    """
    may = np.empty(0, np.int64) if may is None else may
    counts, exact, open_cost, cuts, barred = rules
    limits, number = sorted(counts or {}), np.array([n for _, n in sorted((counts or {}).items())])
    cells = np.concatenate([must, may])
    row_of_cell = np.full(int(cells.max(initial=0)) + 1, -1)
    row_of_cell[cells] = np.arange(len(cells))
    row_of_kind = np.full(len(kit.kinds), -1)
    row_of_kind[limits] = np.arange(len(limits))
    kinds = row_of_kind[candidates.kind]
    counted = np.flatnonzero(kinds >= 0)
    model = Model()
    used = model.columns(cost, 1.0, integer=True)
    left = lack = used[:0]
    if open_cost > 0:
        # A block that the heap lacks is a better answer than cells left open.
        sizes = 0.5 * np.array([len(kit.kinds[k].cells) for k in limits])
        left = model.columns(np.full(len(must), open_cost), 1.0, integer=True)
        lack = model.columns(open_cost * sizes, 1e5, integer=True)
    model.rows(
        np.arange(len(cells)) < len(must),
        1.0,
        (np.arange(len(left)), left, 1.0),
        (row_of_cell[candidates.cell], np.repeat(used, candidates.size()), 1.0),
    )
    model.rows(
        number if exact else -INF,
        number.astype(float),
        (kinds[counted], counted, 1.0),
        (np.arange(len(lack)), lack, -1.0),
    )
    for cut in cuts:
        model.rows(1.0, INF, (0, cut, 1.0))
    for together in barred:
        model.rows(-INF, len(together) - 1.0, (0, together, 1.0))
    answer = solve(model.program(), seconds)
    if answer.x is None:
        return answer, used[:0], must, {}
    x = np.round(answer.x).astype(int)
    short = {k: int(n) for k, n in zip(limits, x[lack], strict=False) if n > 0}
    return answer, np.flatnonzero(x[used]), must[: len(left)][x[left] > 0], short


# ---------------------------------------------------------------- layers


class _Layers:
    """Tiles a building layer by layer and remembers layers it has seen."""

    def __init__(
        self, wanted: np.ndarray, kit: Kit, clock: Clock, shades: np.ndarray | None = None
    ) -> None:
        self.wanted, self.kit, self.clock, self.shades = wanted, kit, clock, shades
        self.known: dict[bytes, tuple[list[BlockPlacement], list[Cell]]] = {}
        self.fills_any = any(kind.cells == ((0, 0, 0),) for kind in kit.kinds)
        self.timed_out = False
        self.left: list[Cell] = []

    def run(self, heaps: list[dict[int, int]] | None = None) -> list[BlockPlacement]:
        """The blocks; ``heaps`` are those each layer has to use."""
        chosen: list[BlockPlacement] = []
        owner = np.full(self.wanted.shape[:2], -1)
        for z in range(self.wanted.shape[2]):
            layer = self.wanted[:, :, z]
            below = np.ones_like(layer) if z == 0 else self.wanted[:, :, z - 1]
            seams = find_seams(owner)
            self.clock.tell(
                f"choosing blocks: level {z + 1} of {self.wanted.shape[2]}, {len(chosen)} so far"
            )
            owner = np.full_like(owner, -1)
            for part in [layer] if heaps else parts_of(layer):
                for block in self._part(part, below, seams, z, heaps[z] if heaps else None):
                    owner[tuple(placement_cells(block, self.kit)[:, :2].T)] = len(chosen)
                    chosen.append(block)
        return chosen

    def _part(
        self,
        part: np.ndarray,
        below: np.ndarray,
        seams: tuple[np.ndarray, ...],
        z: int,
        heap: dict[int, int] | None,
    ) -> list[BlockPlacement]:
        """The blocks of one part of the layer at level ``z``."""
        if not part.any():
            return []
        x0, y0 = (int(np.flatnonzero(part.any(axis))[0]) for axis in (1, 0))
        x1, y1 = (int(np.flatnonzero(part.any(axis))[-1]) + 1 for axis in (1, 0))
        mask, under = part[x0:x1, y0:y1], (below & part)[x0:x1, y0:y1]
        near = seams[0][x0 : x1 - 1, y0:y1], seams[1][x0:x1, y0 : y1 - 1]
        tint = None if self.shades is None else self.shades[x0:x1, y0:y1, z, None]
        key = b"|".join(
            [
                repr((mask.shape, heap)).encode(),
                mask.tobytes(),
                under.tobytes(),
                near[0].tobytes(),
                near[1].tobytes(),
                b"" if tint is None else tint[mask].tobytes(),
            ]
        )
        if key not in self.known:
            self.known[key] = self._solve(mask[:, :, None], under, near, heap, tint)
        blocks, left = self.known[key]
        self.left += [(x + x0, y + y0, z) for x, y, _ in left]
        return [
            replace(block, origin=(block.origin[0] + x0, block.origin[1] + y0, z))
            for block in blocks
        ]

    def _solve(
        self,
        mask: np.ndarray,
        under: np.ndarray,
        seams: tuple[np.ndarray, np.ndarray],
        heap: dict[int, int] | None,
        shades: np.ndarray | None,
    ) -> tuple[list[BlockPlacement], list[Cell]]:
        """Blocks and open cells of a mask (bool[X, Y, 1]), about its corner."""
        found = find_candidates(mask, self.kit, under, flat_only=True, shades=shades)
        cost = bond_cost(found, (seams[0][:, :, None], seams[1][:, :, None]))
        along = int(mask.shape[0] < mask.shape[1])
        width = max(4, STRIP // max(1, int(mask.sum(1 - along).max())))
        whole = heap is not None or not self.fills_any or mask.sum() <= 1.5 * STRIP
        chosen: list[BlockPlacement] = []
        open_: list[Cell] = []
        open_cells = np.flatnonzero(mask)
        while len(open_cells):
            at = np.unravel_index(open_cells, mask.shape)[along]
            inside = np.ones(len(open_cells), bool) if whole else at < at.min() + width
            must, may = open_cells[inside], open_cells[~inside]
            covers, free = np.zeros(mask.size, np.int64), np.zeros(mask.size, bool)
            covers[must], free[open_cells] = 1, True
            starts = found.start[:-1]
            fits = np.logical_and.reduceat(free[found.cell], starts)
            share = np.add.reduceat(covers[found.cell], starts)
            keep = np.flatnonzero(fits & (share > 0))
            part = found.take(keep)
            # A block that reaches into the next strip pays here for the cells of this one.
            price = cost[keep] - (1 - share[keep] / part.size())
            answer, picked, left, _ = cover(
                part,
                price,
                must,
                may=may,
                kit=self.kit,
                rules=CoverRules(
                    heap,
                    exact=heap is not None,
                    open_cost=0.0 if self.fills_any and heap is None else COSTS.open_cell,
                ),
                seconds=self.clock.left,
            )
            self.timed_out |= answer.status == "time"
            open_ += to_cells(left, mask.shape)
            chosen += part.blocks(self.kit, picked)
            open_cells = np.setdiff1d(may, part.take(picked).cell)
        return sorted(chosen, key=lambda block: block.origin), open_


# ---------------------------------------------------------------- the building


def tile(
    wanted: np.ndarray,
    kit: Kit,
    *,
    seconds: float = 60.0,
    shades: np.ndarray | None = None,
    progress: Progress = silent,
) -> Tiling:
    """Fill the cells of ``wanted``, and no others, with blocks of ``kit``.

    Args:
        wanted: bool[X, Y, Z], z up from the table.
        seconds: wall-clock limit.
        shades: int[X, Y, Z], equal where cells have one colour; blocks keep to one where they can.
        progress: told how many blocks there are.

    Raises:
        InputError: for cells that cannot be used, see :func:`check_cells`.
    """
    wanted = check_cells(wanted)
    clock = Clock(seconds, progress=progress)
    layers = _Layers(wanted, kit, clock, shades)
    short: dict[int, int] = {}
    if kit.flat and not kit.limited:
        chosen, left = layers.run(), layers.left
    else:
        found = find_candidates(wanted, kit, shades=shades)
        answer, picked, open_, short = cover(
            found,
            standing_cost(found),
            np.flatnonzero(wanted),
            kit=kit,
            rules=CoverRules(heap_of(kit), open_cost=COSTS.open_cell),
            seconds=clock.left,
        )
        layers.timed_out = answer.status == "time"
        chosen, left = found.blocks(kit, picked), to_cells(open_, wanted.shape)
        if kit.flat and chosen and not left and not short and clock.left > 0:
            used = Counter((block.kind, block.origin[2]) for block in chosen)
            bonded = layers.run(
                [
                    {k: used[kind.name, z] for k, kind in enumerate(kit.kinds)}
                    for z in range(wanted.shape[2])
                ]
            )
            if not layers.left:
                chosen = bonded
    made = Tiling(from_below(chosen), wanted, missing=tuple(sorted(left)), shades=shades)
    return _judged(made, kit, layers.timed_out, short, seconds)


def heap_of(kit: Kit) -> dict[int, int]:
    """How many blocks there are of the kinds that are limited, by their index."""
    return {k: kind.count for k, kind in enumerate(kit.kinds) if kind.count is not None}


def to_cells(flat: np.ndarray, shape: tuple[int, ...]) -> list[Cell]:
    """Cells from flat indices (C order)."""
    x, y, z = (axis.tolist() for axis in np.unravel_index(flat, shape))
    return list(zip(x, y, z, strict=True))


def _judged(
    made: Tiling, kit: Kit, timed_out: bool, short: dict[int, int], seconds: float
) -> Tiling:
    """The tiling with its status and reason."""
    if timed_out and made.missing:
        reason = (
            f"time ran out after {seconds:g} s with {len(made.missing)} of "
            f"{int(made.wanted.sum())} cells open; {MORE_TIME}"
        )
        return replace(made, status="time", reason=reason)
    if short:
        names = ", ".join(f"{n} x {kit.kinds[k].name}" for k, n in sorted(short.items()))
        reason = f"the heap of kit `{kit.name}` lacks {names}"
        return replace(made, status="refused", reason=reason)
    if made.missing:
        levels = sorted({z for _, _, z in made.missing})
        reason = (
            f"no blocks of kit `{kit.name}` fill {len(made.missing)} cells exactly, "
            f"the first at {made.missing[0]}, level {levels[0]}"
        )
        return replace(made, status="refused", reason=reason)
    return made
