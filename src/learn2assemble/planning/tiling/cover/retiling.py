r"""A tiling decided again, under conditions that its layers have together.

**Bond.** Where a heap is limited, which layer gets which block decides how many joints can be
bridged, so layers exchange blocks, a few layers at a time. With :math:`g_e` the number of chosen
blocks that fill both cells of an edge :math:`e` between neighbouring cells (0 or 1), a joint that
is continued in the next layer is

.. math:: u_e \ge 1 - g_e^{z} - g_e^{z+1}, \quad u_e \ge 0 ,

which is linear, so one program decides neighbouring layers. It uses exactly the blocks that these
layers have, and the layers around them stay as they are.

**Cuts.** Sets of pairs of neighbouring cells of which at least one has to be filled by one block,
see :func:`learn2assemble.planning.tiling.standing.find_mechanisms`; and sets of blocks that may
not all be there together, as no order was found in which they can be put down.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from dataclasses import replace
from itertools import chain

import numpy as np

from learn2assemble.assembly.kit import Kit, parts_of
from learn2assemble.linear_programs import INF, Clock, Model, solve
from learn2assemble.planning.tiling.cover.candidates import (
    COSTS,
    BlockPlacement,
    Candidates,
    bond_cost,
    filled_pairs,
    find_candidates,
    from_below,
    glued,
    placement_cells,
    standing_cost,
)
from learn2assemble.planning.tiling.cover.tile import (
    MORE_TIME,
    CoverRules,
    Tiling,
    cover,
    find_seams,
    heap_of,
    owners,
    seams_below,
)

MAX_CANDIDATES, MAX_EDGES, PASSES = 1500, 320, 2
"""Places of blocks in layers that are decided together and edges between their cells, more of which
take minutes; and how often all layers are gone through."""
_SECONDS = 6.0
"""Of one program; where one takes longer, the layers stay as they are from there on."""

_Layers = list[list[BlockPlacement]]


def improve_bond(tiling: Tiling, kit: Kit, clock: Clock) -> Tiling:
    """The same blocks, filling the same cells and bridging more joints, where any do.

    Blocks taller than a layer are left as they are.
    """
    wanted = tiling.wanted
    if not kit.flat:
        return tiling
    layers = [
        [block for block in tiling.placements if block.origin[2] == z]
        for z in range(wanted.shape[2])
    ]
    _improve(layers, tiling, kit, clock)
    return replace(tiling, placements=from_below(chain.from_iterable(layers)))


def _improve(layers: _Layers, tiling: Tiling, kit: Kit, clock: Clock) -> None:
    wanted = tiling.wanted
    found = find_candidates(wanted, kit, flat_only=True, shades=tiling.shades)
    price = standing_cost(found)
    size = np.bincount(found.origin[:, 2], minlength=len(layers))
    started = clock.spent
    for _ in range(PASSES):
        low, better = 0, False
        while low < len(size):
            high = low + max(1, int((np.cumsum(size[low:]) <= MAX_CANDIDATES).sum()))
            clock.tell(f"bridging joints of levels {low + 1} to {high} of {len(size)}")
            before = _continued(layers, wanted, kit, low, high)
            if before and size[low:high].sum() <= MAX_CANDIDATES and clock.left > 0:
                made = _window(layers, wanted, kit, found, price, low, high, clock)
                if made is None and clock.spent - started > _SECONDS:
                    return
                old = layers[low:high]
                layers[low:high] = made or old
                after = _continued(layers, wanted, kit, low, high)
                better |= after < before
                if after >= before:
                    layers[low:high] = old
            if high == len(size):
                break
            low += max(1, (high - low) // 2)
        if not better:
            break


def _seams(layers: _Layers, wanted: np.ndarray, kit: Kit) -> tuple[np.ndarray, np.ndarray]:
    return find_seams(owners(chain.from_iterable(layers), kit, wanted.shape))


def _continued(layers: _Layers, wanted: np.ndarray, kit: Kit, low: int, high: int) -> int:
    """Joints at, below and above the layers ``low`` to ``high`` that the next layer continues."""
    low, high = max(low - 1, 0), min(high + 1, len(layers))
    return sum(
        int((seam[:, :, low : high - 1] & seam[:, :, low + 1 : high]).sum())
        for seam in _seams(layers, wanted, kit)
    )


def _window(
    layers: _Layers,
    wanted: np.ndarray,
    kit: Kit,
    found: Candidates,
    price: np.ndarray,
    low: int,
    high: int,
    clock: Clock,
) -> _Layers | None:
    """The blocks of the layers ``low`` to ``high``, chosen together."""
    level = found.origin[:, 2]
    keep = np.flatnonzero((level >= low) & (level < high))
    part, cost = found.take(keep), price[keep]
    inside = (np.arange(len(layers)) >= low) & (np.arange(len(layers)) < high)
    must = np.flatnonzero(wanted & inside)
    row_of_cell = np.full(wanted.size, -1)
    row_of_cell[must] = np.arange(len(must))
    used = Counter(block.kind for layer in layers[low:high] for block in layer)
    limits = [k for k, kind in enumerate(kit.kinds) if used[kind.name]]
    if not set(part.kind.tolist()) >= set(limits):
        return None
    row_of_kind = np.full(len(kit.kinds), -1)
    row_of_kind[limits] = np.arange(len(limits))
    kinds = row_of_kind[part.kind]
    # Kinds that the layers do not have may not be used: their upper bound is 0.
    has = kinds >= 0
    model = Model()
    chosen = model.columns(np.where(has, cost, 0.0), np.where(has, 1.0, 0.0), integer=True)
    model.rows(
        np.ones(len(must)), 1.0, (row_of_cell[part.cell], np.repeat(chosen, part.size()), 1.0)
    )
    number = np.array([float(used[kit.kinds[k].name]) for k in limits])
    model.rows(number, number, (kinds[has], chosen[has], 1.0))
    # Edges that may be joints in two layers, and the rows of those below and above each layer.
    joints, extra = _seams(layers, wanted, kit), 0
    rows = [np.full((*joint.shape[:2], len(layers) + 1), -1) for joint in joints]
    for z in range(max(low, 1), min(high + 1, len(layers))):
        for axis, (first, second) in enumerate(
            ((wanted[:-1], wanted[1:]), (wanted[:, :-1], wanted[:, 1:]))
        ):
            edge = (first & second)[:, :, z - 1 : z + 1].all(2)
            edge &= joints[axis][:, :, z - 1] | (z - 1 >= low)
            edge &= joints[axis][:, :, z] | (z < high)
            rows[axis][edge, z] = extra + np.arange(edge.sum())
            extra += int(edge.sum())
    if extra > MAX_EDGES:
        return None
    glue = list[tuple[np.ndarray, np.ndarray, float]]()
    for axis in (0, 1):
        which, place = filled_pairs(part, axis)
        x, y, z = place.T
        for row in (rows[axis][x, y, z], rows[axis][x, y, z + 1]):
            glue.append((row[row >= 0], which[row >= 0], 1.0))
    joined = model.columns(np.full(extra, COSTS.seam), 1.0)
    model.rows(np.ones(extra), INF, (np.arange(extra), joined, 1.0), *glue)
    answer = solve(model.program(), min(_SECONDS, clock.left), gap=0.01)
    if answer.status != "optimal" or answer.x is None:
        return None
    blocks = part.blocks(kit, np.flatnonzero(answer.x[chosen] > 0.5))
    return [[block for block in blocks if block.origin[2] == z] for z in range(low, high)]


# ---------------------------------------------------------------- cuts


def mirrored(
    edges: tuple[np.ndarray, np.ndarray], wanted: np.ndarray, square: bool
) -> list[tuple[np.ndarray, np.ndarray]]:
    """A cut under all symmetries of the design, itself among them.

    Args:
        square: whether cells are as wide as deep, so that x and y may be exchanged.
    """
    found = list[tuple[np.ndarray, np.ndarray]]()
    for swap in (False, True) if square and wanted.shape[0] == wanted.shape[1] else (False,):
        for flip_x in (1, -1):
            for flip_y in (1, -1):

                def turn(a: np.ndarray, s: bool = swap, u: int = flip_x, v: int = flip_y):
                    return (a.transpose(1, 0, 2) if s else a)[::u, ::v]

                if np.array_equal(turn(wanted), wanted):
                    x, y = turn(edges[0]), turn(edges[1])
                    found.append((y, x) if swap else (x, y))
    return found


def bonded_candidates(
    tiling: Tiling, kit: Kit, tight: bool = False
) -> tuple[Candidates, np.ndarray]:
    """Every block that may be part of a tiling that stands, and what it costs (float64[n]).

    Joints of the layer below, as they are now, are worth bridging. What lies on nothing falls in
    every tiling and is left out, unless side faces may hold it (``tight``).
    """
    found = find_candidates(tiling.wanted, kit, shades=tiling.shades)
    if not tight:
        found = found.take(np.flatnonzero(np.isfinite(found.support)))
    owner = owners(tiling.placements, kit, tiling.wanted.shape)
    return found, bond_cost(found, seams_below(owner))


def find_blocks(found: Candidates, blocks: Collection[BlockPlacement], kit: Kit) -> np.ndarray:
    """int64[m]: which candidates the given blocks are; those that are none are left out."""
    at = np.array([block.origin for block in blocks])
    near = np.flatnonzero((found.origin[:, None] == at).all(2).any(1))
    there = {(block.kind, block.turn, block.origin) for block in blocks}
    made = found.blocks(kit, near)
    return near[[(one.kind, one.turn, one.origin) in there for one in made]]


class Retiling:
    """A tiling whose layers are decided again together, under conditions that cross them.

    Only parts of layers that a cut touches are decided again, by one program; the others stay as
    they were.
    """

    found: Candidates
    cost: np.ndarray

    def __init__(self, tiling: Tiling, kit: Kit, tight: bool = False) -> None:
        self.tiling = tiling
        self.kit = kit
        self.found, self.cost = bonded_candidates(tiling, kit, tight=tight)
        self.cuts: dict[bytes, np.ndarray] = {}
        self.barred: dict[frozenset[BlockPlacement], np.ndarray] = {}
        self.part: np.ndarray = self._parts()
        self.active: np.ndarray = np.zeros(self.part.max() + 1, bool)

    def _parts(self) -> np.ndarray:
        """int64[cells of the lattice]: the part of its layer each cell belongs to."""
        wanted = self.tiling.wanted
        part = np.zeros(wanted.shape, np.int64)
        if self.kit.limited or not self.kit.flat:
            return part.reshape(-1)
        number = 0
        for z in range(wanted.shape[2]):
            for mask in parts_of(wanted[:, :, z]):
                number += 1
                part[:, :, z][mask] = number
        return part.reshape(-1)

    def add(self, edges: tuple[np.ndarray, np.ndarray]) -> bool:
        """Add a cut (bool[X - 1, Y, Z], bool[X, Y - 1, Z]); whether it is a new one."""
        key = edges[0].tobytes() + edges[1].tobytes()
        if key in self.cuts:
            return False
        self.cuts[key] = np.flatnonzero(glued(self.found, edges) > 0)
        for axis, edge in enumerate(edges):
            at = np.argwhere(edge)
            self._decide(at)
            at[:, axis] += 1
            self._decide(at)
        return True

    def bar(self, blocks: Collection[BlockPlacement]) -> bool:
        """From now on these blocks are not all used together; whether that is new."""
        together = frozenset(blocks)
        if together in self.barred:
            return False
        cells = np.concatenate([placement_cells(block, self.kit) for block in together])
        self.barred[together] = find_blocks(self.found, together, self.kit)
        self._decide(cells)
        return True

    def _decide(self, cells: np.ndarray) -> None:
        """The parts of layers with these cells (int64[m, 3]) are decided again."""
        flat = np.ravel_multi_index(tuple(cells.T), self.tiling.wanted.shape)
        self.active[self.part[flat]] = True

    def solve(self, seconds: float) -> Tiling | None:
        """The cheapest tiling that meets all cuts, None where there is none.

        Its status is ``"time"`` where time ran out; then it may violate cuts.
        """
        clock, kit, old = Clock(seconds), self.kit, self.tiling
        live = self.active[self.part]
        keep = np.flatnonzero(live[self.found.cell[self.found.start[:-1]]])
        number = np.full(len(self.found), -1)
        number[keep] = np.arange(len(keep))
        cuts = [number[cut][number[cut] >= 0] for cut in self.cuts.values()]
        barred = [number[blocks] for blocks in self.barred.values()]
        must = np.flatnonzero(live & old.wanted.reshape(-1))
        full = [blocks for blocks in barred if (blocks >= 0).all()]
        answer, picked, _, _ = cover(
            self.found.take(keep),
            self.cost[keep],
            must,
            kit=kit,
            rules=CoverRules(heap_of(kit), cuts=cuts, barred=full),
            seconds=clock.left,
        )
        if answer.status == "infeasible":
            return None
        if answer.status == "time":
            reason = f"time ran out after {seconds:g} s; {MORE_TIME}"
            return replace(old, status="time", reason=reason)
        first = [placement_cells(block, kit)[0] for block in old.placements]
        again = live[np.ravel_multi_index(tuple(np.array(first).T), old.wanted.shape)]
        stays = [block for block, anew in zip(old.placements, again, strict=True) if not anew]
        blocks = [*stays, *self.found.blocks(kit, keep[picked])]
        return replace(old, placements=from_below(blocks))
