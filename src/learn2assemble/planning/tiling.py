r"""Which blocks of a kit fill which cells: exact covers by integer programming.

With a binary :math:`x_p` for every block kind, turn and place :math:`p` inside the design,

.. math::

    \min \sum_p c_p x_p \quad \text{s.t.} \quad \sum_{p \ni c} x_p = 1 \; \forall c, \qquad
    \sum_{p \in k} x_p \le n_k \; \forall k \text{ with a limited number},

where :math:`c_p` is 1 for the block, less a bonus for every vertical seam of the layer below that
it bridges, plus what an overhang costs (:class:`Costs`). A block whose centroid is not above the
hull of what carries it cannot be put down on its own: it costs as much as a prop.

Layers are decided from below, each connected part on its own, wide ones strip by strip. Where the
heap is limited or blocks are taller than a layer, one program decides the whole building; with a
limited heap the layers are then bonded again, each with the blocks that program gave it (and in
:mod:`.bonding` with those of the layers around it).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from learn2assemble.assembly.kit import Cell, Kit, Orientation, orientations
from learn2assemble.errors import InputError
from learn2assemble.planning.programs import INF, Answer, Clock, Program, by_column, solve

MAX_EXTENT, MAX_CELLS = 64, 64 * 64 * 64
STRIP = 240
"""Cells of a layer that one program decides; wider parts are cut into strips of about as many."""
TIME_OPTION = "--seconds"
"""The option of the command line that gives more time; named where time ran out."""


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
    """``"complete"``, ``"refused"`` or ``"time"``."""
    reason: str = ""
    """Why it is not complete, in one line."""
    missing: tuple[Cell, ...] = ()
    """Wanted cells without a block."""
    seconds: float = 0.0


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

    def __len__(self) -> int:
        return len(self.way)

    def size(self) -> np.ndarray:
        """int64[n]: cells of every candidate."""
        return np.diff(self.start)

    def take(self, keep: np.ndarray) -> Candidates:
        """The candidates with the given indices."""
        size = self.size()[keep]
        start = np.concatenate([[0], np.cumsum(size)])
        inner = np.arange(start[-1]) - np.repeat(start[:-1], size)
        cell = self.cell[np.repeat(self.start[keep], size) + inner]
        return Candidates(self.ways, self.way[keep], self.origin[keep], start, cell,
                          self.support[keep], self.hanging[keep])  # fmt: skip


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
        raise InputError("cells", f"a design that begins at level {level}",
                         "one that stands on the table (level 0)")  # fmt: skip
    return np.ascontiguousarray(cells)


def placement_cells(placement: BlockPlacement, kit: Kit) -> np.ndarray:
    """int64[m, 3]: the lattice cells of a block."""
    ways = {(kit.kinds[way.kind].name, way.turn): way.cells for way in orientations(kit)}
    return np.array(ways[placement.kind, placement.turn]) + placement.origin


# ---------------------------------------------------------------- candidates


def support_margin(cells: np.ndarray, carried: np.ndarray, kit: Kit) -> float:
    """How far inside the hull of its carried cells the centroid of a block is [cells].

    Args:
        cells: int[m, 3], cells of the block.
        carried: bool[m]: what is below bears this cell.
        kit: for the joint gap, by half of which bed faces are smaller than cells.
    """
    if not carried.any():
        return -INF
    centre = cells[:, :2].mean(0) + 0.5
    inset = kit.joint_gap / 2 / np.array(kit.pitch[:2])
    low, high = cells[carried, :2] + inset, cells[carried, :2] + 1 - inset
    corners = np.concatenate([low, high, np.stack([low[:, 0], high[:, 1]], -1),
                              np.stack([high[:, 0], low[:, 1]], -1)])  # fmt: skip
    hull = convex_hull(corners)
    edge = np.roll(hull, -1, 0) - hull
    beyond = edge[:, 0] * (centre[1] - hull[:, 1]) - edge[:, 1] * (centre[0] - hull[:, 0])
    return float((beyond / np.hypot(edge[:, 0], edge[:, 1])).min())


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
    wanted: np.ndarray, kit: Kit, below: np.ndarray | None = None, flat_only: bool = False
) -> Candidates:
    """Every block of ``kit`` that lies inside ``wanted``.

    Args:
        wanted: bool[X, Y, Z].
        below: bool[X, Y], what lies under the lowest level; without it, the table.
        flat_only: leave out ways that are taller than a cell.
    """
    ground = np.ones(wanted.shape[:2], bool) if below is None else below
    carried = np.concatenate([ground[:, :, None], wanted[:, :, :-1]], 2)
    flat_carried = carried.reshape(-1)
    ways = orientations(kit)
    part_way, part_origin, part_cell, part_size, part_support, part_hanging = [], [], [], [], [], []
    strides = np.array([wanted.shape[1] * wanted.shape[2], wanted.shape[2], 1])
    for number, way in enumerate(ways):
        cells = np.array(way.cells)
        extent = cells.max(0) + 1
        if (extent > wanted.shape).any() or (flat_only and extent[2] > 1):
            continue
        room = np.array(wanted.shape) - extent + 1
        fits = np.ones(room, bool)
        for x, y, z in way.cells:
            fits &= wanted[x : x + room[0], y : y + room[1], z : z + room[2]]
        origin = np.argwhere(fits)
        if not len(origin):
            continue
        index = (origin @ strides)[:, None] + cells @ strides
        own = set(way.cells)
        lowest = np.array([(x, y, z - 1) not in own for x, y, z in way.cells])
        bears = flat_carried[index] & lowest
        patterns, which = np.unique(bears, axis=0, return_inverse=True)
        margins = np.array([support_margin(cells, pattern, kit) for pattern in patterns])
        part_way.append(np.full(len(origin), number))
        part_origin.append(origin)
        part_cell.append(index.reshape(-1))
        part_size.append(np.full(len(origin), len(cells)))
        part_support.append(margins[which.reshape(-1)])
        part_hanging.append(1 - bears.sum(1) / lowest.sum())
    if not part_way:
        none = np.empty(0, np.int64)
        return Candidates(ways, none, np.empty((0, 3), np.int64), np.zeros(1, np.int64), none,
                          np.empty(0), np.empty(0))  # fmt: skip
    start = np.concatenate([[0], np.cumsum(np.concatenate(part_size))])
    return Candidates(ways, np.concatenate(part_way), np.concatenate(part_origin), start,
                      np.concatenate(part_cell), np.concatenate(part_support),
                      np.concatenate(part_hanging))  # fmt: skip


def standing_cost(candidates: Candidates, costs: Costs) -> np.ndarray:
    """float64[n]: 1 for the block, and what its overhang costs."""
    bad = candidates.support <= 1e-9
    slender = np.clip(1 - candidates.support / 0.5, 0.0, 1.0)
    slender[bad] = 0.0
    depth = np.where(np.isfinite(candidates.support), -candidates.support, 8.0)
    return (
        1
        + costs.overhang * candidates.hanging
        + costs.slender * slender
        + np.where(bad, costs.prop * (1 + 0.05 * np.clip(depth, 0, 8)), 0.0)
    )


def glued(candidates: Candidates, edges: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """float64[n]: how many of the given pairs of neighbouring cells every candidate fills both.

    Args:
        edges: bool[X - 1, Y, Z] and bool[X, Y - 1, Z]: pairs of neighbours in x, and in y.
    """
    worth = np.zeros(len(candidates))
    for number, way in enumerate(candidates.ways):
        chosen = np.flatnonzero(candidates.way == number)
        if not len(chosen):
            continue
        own, (x, y, z) = set(way.cells), candidates.origin[chosen].T
        for u, v, w in way.cells:
            if (u + 1, v, w) in own:
                worth[chosen] += edges[0][x + u, y + v, z + w]
            if (u, v + 1, w) in own:
                worth[chosen] += edges[1][x + u, y + v, z + w]
    return worth


def find_seams(owner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertical joints of one layer between neighbours in x, and in y.

    Args:
        owner: int[X, Y], which block fills the cell, -1 for none.
    """
    x = (owner[1:] != owner[:-1]) & (owner[1:] >= 0) & (owner[:-1] >= 0)
    y = (owner[:, 1:] != owner[:, :-1]) & (owner[:, 1:] >= 0) & (owner[:, :-1] >= 0)
    return x, y


def owners(placements: tuple[BlockPlacement, ...], kit: Kit, shape: tuple[int, ...]) -> np.ndarray:
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
    for z in range(owner.shape[2] - 1):
        for axis, seam in enumerate(find_seams(owner[:, :, z])):
            above = owner[:, :, z + 1]
            first, second = (above[:-1], above[1:]) if axis == 0 else (above[:, :-1], above[:, 1:])
            counts = seam & (first >= 0) & (second >= 0)
            total += int(counts.sum())
            bridged += int((counts & (first == second)).sum())
    return bridged, total


# ---------------------------------------------------------------- one program


def cover(
    candidates: Candidates, cost: np.ndarray, must: np.ndarray, *, may: np.ndarray | None = None,
    kit: Kit, counts: dict[int, int] | None = None, exact: bool = False, open_cost: float = 0.0,
    cuts: Sequence[np.ndarray] = (), seconds: float = INF,
) -> tuple[Answer, np.ndarray, np.ndarray, dict[int, int]]:  # fmt: skip
    """The cheapest choice of candidates that covers cells.

    Args:
        must: int64[m], flat indices of cells to cover exactly once.
        may: of cells to cover once at most.
        counts: how many blocks there are of the kinds with these indices.
        exact: use exactly so many.
        open_cost: where positive, a cell may stay open and a heap may be exceeded at this price.
        cuts: int64 each: of these candidates at least one is chosen.

    Returns:
        the solver's answer; the chosen candidates; cells of ``must`` left open; blocks that the
        heap does not have, by kind.
    """
    may = np.empty(0, np.int64) if may is None else may
    counts = counts or {}
    limits = sorted(counts)
    n, cells = len(candidates), np.concatenate([must, may])
    row_of_cell = np.full(int(cells.max(initial=0)) + 1, -1)
    row_of_cell[cells] = np.arange(len(cells))
    kinds = np.array([way.kind for way in candidates.ways])[candidates.way]
    row_of_kind = np.full(len(kit.kinds), -1)
    row_of_kind[limits] = len(cells) + np.arange(len(limits))
    counted = np.flatnonzero(row_of_kind[kinds] >= 0)
    rows = [row_of_cell[candidates.cell], row_of_kind[kinds[counted]]]
    columns = [np.repeat(np.arange(n), candidates.size()), counted]
    first = len(cells) + len(limits)
    for number, cut in enumerate(cuts):
        rows.append(np.full(len(cut), first + number))
        columns.append(cut)
    price, upper = cost, np.ones(n)
    signs = [np.ones(len(row)) for row in rows]
    if open_cost > 0:
        # A block that the heap lacks is a better answer than cells left open.
        sizes = 0.5 * np.array([len(kit.kinds[k].cells) for k in limits])
        spare = np.concatenate([np.arange(len(must)), len(cells) + np.arange(len(limits))])
        rows.append(spare)
        columns.append(n + np.arange(len(spare)))
        signs += [np.ones(len(must)), -np.ones(len(limits))]
        price = np.concatenate([cost, np.full(len(must), open_cost), open_cost * sizes])
        upper = np.concatenate([upper, np.ones(len(must)), np.full(len(limits), 1e5)])
    number = np.array([counts[k] for k in limits], float)
    lower = number if exact else np.full(len(limits), -INF)
    row_lower = np.concatenate([np.ones(len(must)), np.zeros(len(may)), lower, np.ones(len(cuts))])
    row_upper = np.concatenate([np.ones(len(cells)), number, np.full(len(cuts), INF)])
    program = Program(price, np.zeros(len(price)), upper, row_lower, row_upper,
                      *by_column(rows, columns, signs, len(price)), integer=True)  # fmt: skip
    answer = solve(program, seconds)
    if answer.x is None:
        return answer, np.empty(0, np.int64), must, {}
    x = np.round(answer.x).astype(int)
    left = must[x[n : n + len(must)] > 0] if open_cost > 0 else must[:0]
    lack = x[n + len(must) :] if open_cost > 0 else []
    short = {k: int(amount) for k, amount in zip(limits, lack, strict=False) if amount > 0}
    return answer, np.flatnonzero(x[:n]), left, short


# ---------------------------------------------------------------- layers


def components(mask: np.ndarray) -> list[np.ndarray]:
    """bool[X, Y] each: parts of ``mask`` that hang together by edges of cells."""
    label = np.zeros(mask.shape, np.int64)
    found = []
    for seed in map(tuple, np.argwhere(mask).tolist()):
        if label[seed]:
            continue
        label[seed] = len(found) + 1
        queue = [seed]
        for x, y in queue:
            for u, v in ((x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)):
                inside = 0 <= u < mask.shape[0] and 0 <= v < mask.shape[1]
                if inside and mask[u, v] and not label[u, v]:
                    label[u, v] = len(found) + 1
                    queue.append((u, v))
        found.append(label == len(found) + 1)
    return found


class _Layers:
    """Tiles a building layer by layer and remembers layers it has seen."""

    def __init__(self, wanted: np.ndarray, kit: Kit, costs: Costs, clock: Clock) -> None:
        self.wanted, self.kit, self.costs, self.clock = wanted, kit, costs, clock
        self.known: dict[bytes, tuple[list[tuple[int, int, int]], list[tuple[int, int]]]] = {}
        self.fills_any = any(kind.cells == ((0, 0, 0),) for kind in kit.kinds)
        self.timed_out = False
        self.left: list[Cell] = []

    def run(self, heaps: list[dict[int, int]] | None = None) -> list[tuple[int, Cell]]:
        """Ways and origins of blocks; ``heaps`` are the blocks each layer has to use."""
        chosen: list[tuple[int, Cell]] = []
        owner = np.full(self.wanted.shape[:2], -1)
        for z in range(self.wanted.shape[2]):
            layer = self.wanted[:, :, z]
            below = np.ones_like(layer) if z == 0 else self.wanted[:, :, z - 1]
            seams = find_seams(owner)
            owner = np.full_like(owner, -1)
            parts = [layer] if heaps else components(layer)
            for part in parts:
                heap = heaps[z] if heaps else None
                for way, x, y in self._part(part, below, seams, z, heap):
                    cells = np.array(orientations(self.kit)[way].cells, np.int64)
                    owner[cells[:, 0] + x, cells[:, 1] + y] = len(chosen)
                    chosen.append((way, (x, y, z)))
        return chosen

    def _part(self, part: np.ndarray, below: np.ndarray, seams: tuple[np.ndarray, ...],
              z: int, heap: dict[int, int] | None) -> list[tuple[int, int, int]]:  # fmt: skip
        """``way, x, y`` of the blocks of one part of the layer at level ``z``."""
        if not part.any():
            return []
        x0, y0 = (int(np.flatnonzero(part.any(axis))[0]) for axis in (1, 0))
        x1, y1 = (int(np.flatnonzero(part.any(axis))[-1]) + 1 for axis in (1, 0))
        mask, under = part[x0:x1, y0:y1], (below & part)[x0:x1, y0:y1]
        near = seams[0][x0 : x1 - 1, y0:y1], seams[1][x0:x1, y0 : y1 - 1]
        key = b"|".join([repr((mask.shape, heap)).encode(), mask.tobytes(), under.tobytes(),
                         near[0].tobytes(), near[1].tobytes()])  # fmt: skip
        if key not in self.known:
            self.known[key] = self._solve(mask, under, near, heap)
        blocks, left = self.known[key]
        self.left += [(x + x0, y + y0, z) for x, y in left]
        return [(way, x + x0, y + y0) for way, x, y in blocks]

    def _solve(
        self, mask: np.ndarray, under: np.ndarray, seams: tuple[np.ndarray, np.ndarray],
        heap: dict[int, int] | None,
    ) -> tuple[list[tuple[int, int, int]], list[tuple[int, int]]]:  # fmt: skip
        """Blocks and open cells of a mask, about its corner."""
        found = find_candidates(mask[:, :, None], self.kit, under, flat_only=True)
        joints = seams[0][:, :, None], seams[1][:, :, None]
        cost = standing_cost(found, self.costs) - self.costs.seam * glued(found, joints)
        along = int(mask.shape[0] < mask.shape[1])
        width = max(4, STRIP // max(1, int(mask.sum(1 - along).max())))
        whole = heap is not None or not self.fills_any or mask.sum() <= 1.5 * STRIP
        chosen, open_, open_cells = [], [], np.flatnonzero(mask.reshape(-1))
        while len(open_cells):
            at = open_cells // mask.shape[1] if along == 0 else open_cells % mask.shape[1]
            inside = np.ones(len(open_cells), bool) if whole else at < at.min() + width
            must, may = open_cells[inside], open_cells[~inside]
            covers = np.zeros(mask.size, np.int64)
            covers[must], covers[may] = 1, 0
            free = np.zeros(mask.size, bool)
            free[open_cells] = True
            starts = found.start[:-1]
            fits = np.logical_and.reduceat(free[found.cell], starts)
            share = np.add.reduceat(covers[found.cell], starts)
            keep = np.flatnonzero(fits & (share > 0))
            part = found.take(keep)
            # A block that reaches into the next strip pays here for the cells of this one.
            price = cost[keep] - (1 - share[keep] / part.size())
            answer, picked, left, _ = cover(
                part, price, must, may=may, kit=self.kit, counts=heap, exact=heap is not None,
                open_cost=0.0 if self.fills_any and heap is None else self.costs.open_cell,
                seconds=self.clock.left,
            )  # fmt: skip
            if answer.status == "time":
                self.timed_out = True
            open_ += [(int(c) // mask.shape[1], int(c) % mask.shape[1]) for c in left]
            used = part.take(picked)
            chosen += [(int(way), int(o[0]), int(o[1]))
                       for way, o in zip(used.way, used.origin, strict=True)]  # fmt: skip
            open_cells = np.setdiff1d(may, used.cell)
        return sorted(chosen, key=lambda block: block[1:]), open_


# ---------------------------------------------------------------- the building


def tile(
    wanted: np.ndarray, kit: Kit, *, seconds: float = 60.0, costs: Costs = COSTS,
) -> Tiling:  # fmt: skip
    """Fill the cells of ``wanted``, and no others, with blocks of ``kit``.

    Args:
        wanted: bool[X, Y, Z], z up from the table.
        seconds: wall-clock limit.

    Raises:
        InputError: for cells that cannot be used, see :func:`check_cells`.
    """
    wanted = check_cells(wanted)
    clock, ways = Clock(seconds), orientations(kit)
    flat = all(cell[2] == 0 for way in ways for cell in way.cells)
    layers = _Layers(wanted, kit, costs, clock)
    heap = {k: kind.count for k, kind in enumerate(kit.kinds) if kind.count is not None}
    short: dict[int, int] = {}
    if flat and not heap:
        chosen, left = layers.run(), layers.left
    else:
        chosen, left, short, done = _whole(wanted, kit, costs, clock, heap)
        layers.timed_out |= not done
        if flat and chosen and not left and not short and clock.left > 0:
            used = [Counter(ways[way].kind for way, o in chosen if o[2] == z)
                    for z in range(wanted.shape[2])]  # fmt: skip
            kinds = range(len(kit.kinds))
            bonded = layers.run([{k: counter[k] for k in kinds} for counter in used])
            if not layers.left:
                chosen = bonded
    made = Tiling(
        to_placements(chosen, kit), wanted, missing=tuple(sorted(left)), seconds=clock.spent
    )
    return _judged(made, kit, layers.timed_out, short, seconds)


def to_placements(chosen: list[tuple[int, Cell]], kit: Kit) -> tuple[BlockPlacement, ...]:
    """Blocks from ways and origins, from below."""
    ways = orientations(kit)
    return tuple(
        BlockPlacement(kit.kinds[ways[way].kind].name, ways[way].turn, origin)
        for way, origin in sorted(chosen, key=lambda block: block[1][::-1])
    )


def chosen_blocks(candidates: Candidates, picked: np.ndarray) -> list[tuple[int, Cell]]:
    """Ways and origins of the candidates ``picked``."""
    return [(int(candidates.way[p]), (int(x), int(y), int(z)))
            for p, (x, y, z) in zip(picked, candidates.origin[picked], strict=True)]  # fmt: skip


def _whole(
    wanted: np.ndarray, kit: Kit, costs: Costs, clock: Clock, heap: dict[int, int]
) -> tuple[list[tuple[int, Cell]], list[Cell], dict[int, int], bool]:  # fmt: skip
    """One program over the whole building: blocks, open cells, what the heap lacks, in time."""
    found = find_candidates(wanted, kit)
    cost = standing_cost(found, costs)
    must = np.flatnonzero(wanted.reshape(-1))
    answer, picked, left, short = cover(
        found, cost, must, kit=kit, counts=heap, open_cost=costs.open_cell, seconds=clock.left
    )
    at = np.stack(np.unravel_index(left, wanted.shape), -1)
    cells = [(int(x), int(y), int(z)) for x, y, z in at]
    return chosen_blocks(found, picked), cells, short, answer.status != "time"


def _judged(
    made: Tiling, kit: Kit, timed_out: bool, short: dict[int, int], seconds: float
) -> Tiling:
    """The tiling with its status and reason."""
    if timed_out and made.missing:
        reason = (f"time ran out after {seconds:g} s with {len(made.missing)} of "
                  f"{int(made.wanted.sum())} cells open; {TIME_OPTION} gives more")  # fmt: skip
        return replace(made, status="time", reason=reason)
    if short:
        names = ", ".join(f"{n} x {kit.kinds[k].name}" for k, n in sorted(short.items()))
        reason = f"the heap of kit `{kit.name}` lacks {names}"
        return replace(made, status="refused", reason=reason)
    if made.missing:
        levels = sorted({z for _, _, z in made.missing})
        reason = (f"no blocks of kit `{kit.name}` fill {len(made.missing)} cells exactly, "
                  f"the first at {made.missing[0]}, level {levels[0]}")  # fmt: skip
        return replace(made, status="refused", reason=reason)
    return made
