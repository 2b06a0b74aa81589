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
from typing import NamedTuple

import numpy as np

from learn2assemble.assembly.kit import Cell, Kit, boxed_parts_of
from learn2assemble.errors import InputError
from learn2assemble.linear_programs import INF, Answer, Clock, Model, solve
from learn2assemble.planning.tiling.cover.candidates import (
    COSTS,
    BlockPlacement,
    Candidates,
    bond_cost,
    find_candidates,
    from_below,
    placement_cells,
    standing_cost,
)
from learn2assemble.progress import Progress, silent

MAX_EXTENT, MAX_CELLS = 64, 64 * 64 * 64
STRIP = 240
"""Cells of a layer that one program decides; wider parts are cut into strips of about as many."""
_FREE_SHARE = 0.2
"""Of the time, to look whether a heap has what one would lay without a limit."""
MORE_TIME = "`seconds=` gives more"
"""Said where time ran out."""


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
    closed: bool = False
    """No cell may stay open, only the heap be exceeded."""
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
    counts, exact, open_cost, closed, cuts, barred = rules
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
        if not closed:
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


class _TiledPart(NamedTuple):
    """A part of a layer, from its corner."""

    blocks: list[BlockPlacement]
    owner: np.ndarray
    """int64[X, Y]: which of them fills a cell, -1 for none."""
    left: list[Cell]
    """Cells that are left open."""


_MOST_LAYERS = 1 << 14
"""Parts of layers that are remembered of a kit: some 50 MB."""


@lru_cache(maxsize=4)
def _known_layers(kit: Kit) -> dict[bytes, _TiledPart]:
    """What was found for parts of layers, of this design or of others: the solver answers the same
    whenever it is asked. Random designs of one kit share more than half of their parts."""
    return {}


class _Layers:
    """Tiles a building layer by layer and remembers layers it has seen."""

    def __init__(
        self, wanted: np.ndarray, kit: Kit, clock: Clock, shades: np.ndarray | None = None
    ) -> None:
        self.wanted, self.kit, self.clock, self.shades = wanted, kit, clock, shades
        self.known = _known_layers(kit)
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
            # A heap is that of a whole layer.
            for box, mask in boxed_parts_of(layer, whole=bool(heaps)):
                self._part(box, mask, below, seams, z, heaps[z] if heaps else None, owner, chosen)
        return chosen

    def _part(
        self,
        box: tuple[slice, ...],
        mask: np.ndarray,
        below: np.ndarray,
        seams: tuple[np.ndarray, ...],
        z: int,
        heap: dict[int, int] | None,
        owner: np.ndarray,
        chosen: list[BlockPlacement],
    ) -> None:
        """Add the blocks of one part of a layer, and whose its cells are.

        Args:
            box: of its cells; ``mask`` (bool[X, Y]) says which of them are in it.
        """
        (x0, x1), (y0, y1) = ((side.start, side.stop) for side in box[:2])
        under = below[x0:x1, y0:y1] & mask
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
        found = self.known.get(key)
        if found is None:
            before, self.timed_out = self.timed_out, False
            blocks, open_ = self._solve(mask[:, :, None], under, near, heap, tint)
            whose = owners(blocks, self.kit, (*mask.shape, 1))[:, :, 0]
            found = _TiledPart(blocks, whose, open_)
            if not self.timed_out:
                if len(self.known) >= _MOST_LAYERS:
                    del self.known[next(iter(self.known))]
                self.known[key] = found
            self.timed_out |= before
        whose = owner[x0:x1, y0:y1]
        np.copyto(whose, found.owner + len(chosen), where=found.owner >= 0)
        self.left += [(x + x0, y + y0, z) for x, y, _ in found.left]
        for block in found.blocks:
            x, y, _ = block.origin
            chosen.append(BlockPlacement(block.kind, block.turn, (x + x0, y + y0, z)))

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
    chosen, left = list[BlockPlacement](), list[Cell]()
    bonded = kit.flat and not kit.limited
    if bonded:
        chosen, left = layers.run(), layers.left
    elif kit.flat:
        # What one would lay without a limit, in bond, where the heap has enough for it.
        free = _Layers(wanted, kit, Clock(_FREE_SHARE * seconds), shades)
        chosen = free.run()
        bonded = not free.left and not free.timed_out and _has(kit, chosen)
    if not bonded:
        found = find_candidates(wanted, kit, shades=shades)
        cost, must = standing_cost(found), np.flatnonzero(wanted)
        rules = CoverRules(heap_of(kit), open_cost=COSTS.open_cell)
        answer, picked, open_, short = cover(
            found, cost, must, kit=kit, rules=rules, seconds=clock.left
        )
        layers.timed_out = answer.status == "time"
        if kit.limited and len(open_) and not layers.timed_out:
            # A few open cells cost less than large blocks that the heap lacks.
            rules = rules._replace(closed=True)
            whole = cover(found, cost, must, kit=kit, rules=rules, seconds=clock.left)
            if whole[0].x is not None:
                _, picked, _, short = whole
        chosen, left = found.blocks(kit, picked), to_cells(open_, wanted.shape)
        if kit.flat and chosen and not left and not short and clock.left > 0:
            used = Counter((block.kind, block.origin[2]) for block in chosen)
            again = layers.run(
                [
                    {k: used[kind.name, z] for k, kind in enumerate(kit.kinds)}
                    for z in range(wanted.shape[2])
                ]
            )
            if not layers.left:
                chosen = again
    made = Tiling(from_below(chosen), wanted, missing=tuple(sorted(left)), shades=shades)
    return _judged(made, kit, layers.timed_out, short, seconds)


def _has(kit: Kit, blocks: Iterable[BlockPlacement]) -> bool:
    """Whether a heap has so many blocks of every kind."""
    used = Counter(block.kind for block in blocks)
    return all(used[kit.kinds[k].name] <= count for k, count in heap_of(kit).items())


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
        lowest = min(made.missing, key=lambda cell: cell[2])
        reason = (
            f"no blocks of kit `{kit.name}` fill {len(made.missing)} cells exactly, "
            f"the first at {lowest}, level {lowest[2]}"
        )
        return replace(made, status="refused", reason=reason)
    return made
