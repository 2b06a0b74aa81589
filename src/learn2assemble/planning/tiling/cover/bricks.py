"""Cells of a design filled with bricks that clutch: one connected piece is looked for.

The cells are cut into slabs, each a brick or a plate high (:func:`slabs_of`). Each slab is covered
from below: cells over nothing first, the farthest out before others, the rest from a corner, by the
brick that links most bricks below and above it and is nearest to the ground (:mod:`.bearing`).
Where bricks bear on nothing, or far out on others, they are covered anew with their neighbours in
the slab as long as that helps; then parts that hang together with nothing else, until everything is
one piece or all of it is in pieces that stand on the ground. What falls is covered anew where it
moves first.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.bricks.model import Brick, BrickModel, assembly_of, brick_layers
from learn2assemble.assembly.kit import Kit
from learn2assemble.design.cells import CellDesign
from learn2assemble.errors import InputError
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.brick_plan import plan_bricks
from learn2assemble.planning.plan import CellCount, Plan
from learn2assemble.planning.sequence import Supports
from learn2assemble.planning.tiling.cover.bearing import (
    NO_WAY,
    Covering,
    best_brick,
    cost_of,
    least_ways,
    ways_of,
)
from learn2assemble.planning.tiling.cover.linked import LayerCells, NoCover, linked_cover
from learn2assemble.planning.tiling.cover.slabs import inside, slabs_of
from learn2assemble.statics.holding.check import JointAnswer, stands_by_joints
from learn2assemble.values import rounded

_CHANCES = 0.5, 8.0
"""How much chance is added to what a brick is worth [cells], at first and where something is
covered anew."""
_FAR, _AGAIN = 6.0, 60
"""What a brick costs at least that is covered anew, see :func:`.cost_of`, and how often for each of
them."""
_TRIES, _REPAIRS = 4000, 60
"""Layers covered anew at most: for one piece, and for one that stands."""
_CUTS, _LAYERS = 100, 0.1
"""Programs at most for layers in which nothing is loose, and of the time left for one."""
_SHARE = 0.4
"""Of the time, for one that stands."""


def plan_brick_cells(
    design: CellDesign,
    kit: Kit,
    help_: Supports,
    clock: Clock,
    progress: Callable[[str], None],
    *,
    shell: int | None = None,
    seed: int = 0,
) -> Plan:
    """Bricks, order and proof for cells.

    Where bricks from above alone do not do, hands help (:class:`.Supports`).

    Args:
        design: in cells one stud wide, and as high as a brick or, of a kit of ``plates``, a plate.
        kit: of bricks that clutch, without counts.
        help_: what may help.
        clock: limits it all.
        progress: called with a line of text for everything that takes long.
        shell: cells that the walls are thick where the design is to be hollow.
        seed: of the chance.

    Raises:
        InputError: for a kit with counts, or that lacks the brick of one stud.
    """
    started = time.perf_counter()
    wanted = np.array(design.wanted)
    if shell is not None:
        wanted &= ~inside(wanted, shell, brick_layers(kit) if kit.plates else 1)
    tiler = _Tiler(wanted, kit, np.random.default_rng(seed))
    tiler.fill(clock)
    tiler.join(clock)
    never = False
    if tiler.loose():
        try:
            tiler.attach(clock)
            tiler.join(clock)
        except NoCover:
            never = True
    pieces = tiler.pieces()
    progress(f"{len(tiler.bricks)} bricks in {'one piece' if pieces == 1 else f'{pieces} pieces'}")
    assembly, found = _standing(tiler, design, kit, clock)
    planned = time.perf_counter() - started
    plan = plan_bricks(assembly, help_, clock, progress, found)
    # Refused while all together stand: some hang.
    if not plan.complete and (plan.status != "refused" or found.need.stands):
        hands = Supports(holds=max(help_.holds, 1), hands=True)
        more = plan_bricks(assembly, hands, clock, progress, found)
        plan = more if more.complete else plan
    if loose := tiler.loose():
        why = (
            "no bricks of this kit link their cells to others, whichever way one fills them"
            if never
            else "their cells have too few others right over or under them"
        )
        lost = (
            f"{loose} of the bricks hang together with nothing that stands: {why}; not tried: "
            "cells of another width, thicker walls"
        )
        plan = replace(plan, reason=f"{plan.reason}; {lost}")
    x, y, z = design.wanted.shape
    cell = tuple(round(float(edge), 9) for edge in design.cell)
    told = replace(
        plan.design,
        name=design.name,
        source=design.source,
        block_edge=cell[2],
        shape=(x, y, z),
        cell=(cell[0], cell[1], cell[2]),
        iou=None if design.iou is None else round(float(design.iou), 6),
        volume_error=rounded(design.volume_error),
        not_read=design.not_read,
        note=design.note or plan.design.note,
        drawn=design.drawn or None,
    )
    count = int(wanted.sum())
    missing = count - int(round(plan.coverage * count)) if plan.complete else count
    seconds = round(time.perf_counter() - started, 3)
    return replace(
        plan,
        design=told,
        kit=kit.name,
        cells=CellCount(count, missing, 0),
        planning_s=round(planned, 3),
        proof_s=round(seconds - planned, 3),
        seconds=seconds,
    )


def _standing(
    tiler: _Tiler, design: CellDesign, kit: Kit, clock: Clock
) -> tuple[Assembly, JointAnswer]:
    """The bricks as an assembly, covered anew where they move first as long as they fall; and
    whether it stands."""
    best = tiler.assembly(design, kit)
    found = stands_by_joints(best)
    if tiler.loose():
        return best, found
    share = found.need.share
    limit = clock.left * (1 - _SHARE)
    for _ in range(_REPAIRS):
        if found.need.stands or clock.left < limit:
            break
        moving = found.balance.holding().moving
        kept = tiler.saved()
        names = list(tiler.bricks)
        tiler.again([names[k] for k in moving])
        tiler.join(clock)
        made = tiler.assembly(design, kit)
        new = stands_by_joints(made)
        if new.need.share <= share:
            best, found, share = made, new, new.need.share
        else:
            tiler.restore(kept)
    return best, found


class _Placed(NamedTuple):
    """A brick: cells from its smallest corner, and extents along x and y."""

    x: int
    y: int
    a: int
    b: int
    slab: int
    """Index of its slab."""


class _Tiler:
    """Bricks in cells, slab by slab.

    Args:
        wanted: bool[X, Y, Z].
        kit: whose bricks they are; a cell is one of its :attr:`~.kit.Kit.cell`.
        rng: for what is as good.
    """

    def __init__(self, wanted: np.ndarray, kit: Kit, rng: np.random.Generator) -> None:
        if kit.limited:
            raise InputError("kit", kit.name, "bricks without counts, for designs of cells")
        layers = brick_layers(kit)
        self.slabs = slabs_of(wanted, layers if kit.plates else 1)
        self.layers = 1 if kit.plates else layers
        """Of the kit, to a cell."""
        extents = [(np.max(kind.cells, 0) + 1).tolist() for kind in kit.kinds]
        self.sizes = {
            height: np.array(
                sorted({s for x, y, z in extents if z == height for s in ((x, y), (y, x))})
            )
            for height in {self.layers * (slab.high - slab.low) for slab in self.slabs}
        }
        """Extents along x and y, by height [layers]."""
        for height, sizes in self.sizes.items():
            if [1, 1] not in sizes.tolist():
                one = "brick 1x1" if height == layers else "plate 1x1"
                raise InputError("kit", kit.name, f"a kit with the {one}, for designs of cells")
        self.rng, self.wanted = rng, wanted
        self.owner = np.full(wanted.shape, -1)
        """The brick of every cell, or -1."""
        self.bricks: dict[int, _Placed] = {}
        self._next = 0
        self._ways, self._least = np.full((2, *wanted.shape), NO_WAY)
        """Of every cell to the ground [studs], and the least that they could be."""
        for low, high, cells in self.slabs:
            below = self._least[:, :, low - 1] if low else np.zeros(cells.shape)
            self._least[:, :, low:high][cells] = least_ways(below, cells)[cells][:, None]
        self._ground = np.zeros(wanted.shape[:2])
        self._out = [
            least_ways(np.where(wanted[:, :, low - 1], 0.0, NO_WAY), cells) if low else self._ground
            for low, _, cells in self.slabs
        ]
        """Of every slab float64[X, Y]: studs from a cell to the next one over something."""

    def fill(self, clock: Clock) -> None:
        """Cover everything, from below, each slab anew where that helps."""
        for number, slab in enumerate(self.slabs):
            self._cover(number, slab.cells.copy(), _CHANCES[0])
            self._nearer(number, clock)

    def _nearer(self, number: int, clock: Clock) -> None:
        """Cover bricks of a slab anew that are far from the ground, as long as that costs less."""
        far = [b for b, one in self.bricks.items() if one.slab == number and self._cost(b) >= _FAR]
        for _ in range(_AGAIN * len(far)):
            if not far or clock.left <= 0:
                return
            some = self._around([far[int(self.rng.integers(len(far)))]], number)
            kept = {b: self.bricks[b] for b in some}
            before, first = sum(1.0 + self._cost(b) for b in some), self._next
            self._cover(number, self._take(some, number), _CHANCES[1])
            new = {b: self._cost(b) for b in range(first, self._next)}
            if sum(1.0 + cost for cost in new.values()) <= before:
                far = [b for b in far if b not in kept] + [b for b in new if new[b] >= _FAR]
                continue
            for b in new:
                del self.bricks[b]
            for b, one in kept.items():
                self._lay(b, one)

    def again(self, bricks: list[int]) -> None:
        """Cover some bricks anew, with what touches them in their slab."""
        for number in sorted({self.bricks[b].slab for b in bricks if b in self.bricks}):
            self._cover(number, self._take(self._around(bricks, number), number), _CHANCES[1])

    def _around(self, bricks: list[int], number: int) -> list[int]:
        """Those of some bricks that are in a slab, with what touches them in it."""
        low, _, cells = self.slabs[number]
        owner = np.where(cells, self.owner[:, :, low], -1)
        here = np.isin(owner, bricks)
        wide = here.copy()
        wide[1:] |= here[:-1]
        wide[:-1] |= here[1:]
        wide[:, 1:] |= here[:, :-1]
        wide[:, :-1] |= here[:, 1:]
        touched = np.unique(owner[wide])
        return touched[touched >= 0].tolist()

    def _take(self, bricks: list[int], number: int) -> np.ndarray:
        """bool[X, Y]: the cells of bricks of a slab, which go."""
        low, high, cells = self.slabs[number]
        free = cells & np.isin(self.owner[:, :, low], bricks)
        for b in bricks:
            del self.bricks[b]
        self.owner[:, :, low:high][free] = -1
        return free

    def _lay(self, name: int, brick: _Placed) -> None:
        i, j, a, b, slab = brick
        low, high, _ = self.slabs[slab]
        here = np.s_[i : i + a, j : j + b, low:high]
        self.bricks[name] = brick
        self.owner[here] = name
        self._ways[here] = ways_of(self._ways_below(low), i, j, a, b)[..., None]

    def _ways_below(self, low: int) -> np.ndarray:
        return np.ascontiguousarray(self._ways[:, :, low - 1]) if low else self._ground

    def _cost(self, brick: int) -> float:
        x, y, a, b, slab = self.bricks[brick]
        here = np.s_[x : x + a, y : y + b, self.slabs[slab].low]
        return cost_of(self._ways[here], self._least[here])

    def _cover(self, slab: int, free: np.ndarray, chance: float) -> None:
        low, high, _ = self.slabs[slab]
        sizes = self.sizes[self.layers * (high - low)]
        nothing = np.full(free.shape, -1)
        below, above = (
            np.ascontiguousarray(self.owner[:, :, k]) if 0 <= k < self.wanted.shape[2] else nothing
            for k in (low - 1, high)
        )
        ways, least = self._ways_below(low), np.ascontiguousarray(self._least[:, :, low])
        layer = tuple(Covering(free, below, above, ways, least))
        out = self._out[slab]
        corner = self.rng.random(2) < 0.5
        cells = np.argwhere(free)
        keys = [-c if last else c for c, last in zip(cells.T, corner, strict=True)]
        keys = keys if self.rng.random() < 0.5 else keys[::-1]
        for x, y in cells[np.lexsort([*keys, -out[free]])].tolist():
            if not free[x, y]:
                continue
            where = np.empty(0, bool) if out[x, y] else corner
            tries = int(sizes.prod(1).sum()) if out[x, y] else len(sizes)
            i, j, a, b = best_brick(layer, sizes, x, y, where, chance * self.rng.random(tries))
            free[i : i + a, j : j + b] = False
            self._lay(self._next, _Placed(i, j, a, b, slab))
            self._next += 1

    def labels(self) -> tuple[int, dict[int, int], int]:
        """How many pieces there are that do not stand on the ground beside the largest one, the
        piece of every brick, and which is the largest."""
        names = np.array(sorted(self.bricks))
        low, high = self.owner[:, :, :-1], self.owner[:, :, 1:]
        both = (low >= 0) & (high >= 0) & (low != high)
        a, b = np.searchsorted(names, low[both]), np.searchsorted(names, high[both])
        n = len(names)
        graph = sp.coo_matrix((np.ones(len(a)), (a, b)), (n, n))
        count, label = connected_components(graph, directed=False)
        largest = int(np.bincount(label).argmax())
        return int(count), dict(zip(names.tolist(), label.tolist(), strict=True)), largest

    def pieces(self) -> int:
        """How many pieces there are."""
        return self.labels()[0]

    def join(self, clock: Clock) -> None:
        """Cover small pieces anew until there is one, or nothing helps."""
        count, label, largest = self.labels()
        limit = clock.left * (1 - _SHARE)
        for _ in range(_TRIES):
            if count == 1 or clock.left < limit:
                return
            loose = [b for b, piece in label.items() if piece != largest]
            if not self._loose() and self.rng.random() < 0.01:
                return
            kept = self.saved()
            self.again([loose[int(self.rng.integers(len(loose)))]])
            now = self.labels()
            if now[0] <= count:
                count, label, largest = now
            else:
                self.restore(kept)

    def attach(self, clock: Clock) -> None:
        """Cover slabs with bricks in loose pieces so that these are linked to others.

        Raises:
            NoCover: where no bricks do.
        """
        cuts: list[np.ndarray] = []
        slabs: set[int] = set()
        for _ in range(_CUTS):
            loose = self._loose()
            if not loose or clock.left <= 0:
                return
            cuts += [np.isin(self.owner, piece) for piece in loose]
            slabs |= {self.bricks[b].slab for piece in loose for b in piece}
            numbers = sorted(slabs)
            layers = [self._layer(number, cuts) for number in numbers]
            found = linked_cover(layers, _LAYERS * clock.left)
            if found is None:
                return
            for number, some in zip(numbers, found, strict=True):
                self._take([b for b, one in self.bricks.items() if one.slab == number], number)
                for one in some:
                    self._lay(self._next, _Placed(*one, number))
                    self._next += 1

    def _layer(self, number: int, cuts: list[np.ndarray]) -> LayerCells:
        low, high, cells = self.slabs[number]
        linked = np.full(cells.shape, low == 0)
        for level in {low - 1, high} & set(range(self.wanted.shape[2])):
            linked |= self.wanted[:, :, level]
        mine = np.array([cut[:, :, low] & cells for cut in cuts])
        return LayerCells(cells, linked, self.sizes[self.layers * (high - low)], mine)

    def loose(self) -> int:
        """How many bricks are in pieces that do not stand on the ground."""
        return sum(map(len, self._loose()))

    def _loose(self) -> list[list[int]]:
        """The bricks of each of these pieces."""
        _, label, _ = self.labels()
        pieces: dict[int, list[int]] = {}
        for b, piece in label.items():
            pieces.setdefault(piece, []).append(b)
        return [some for some in pieces.values() if not self._grounded(some)]

    def saved(self) -> tuple[dict[int, _Placed], np.ndarray, np.ndarray]:
        """What :meth:`restore` brings back."""
        return self.bricks.copy(), self.owner.copy(), self._ways.copy()

    def restore(self, saved: tuple[dict[int, _Placed], np.ndarray, np.ndarray]) -> None:
        """Be as when that was saved."""
        self.bricks, self.owner, self._ways = saved

    def _grounded(self, bricks: list[int]) -> bool:
        return any(self.slabs[self.bricks[b].slab].low == 0 for b in bricks)

    def assembly(self, design: CellDesign, kit: Kit) -> Assembly:
        """The bricks where they stand."""
        made = list[Brick]()
        for number, (x, y, a, b, slab) in enumerate(self.bricks.values(), 1):
            low, high, _ = self.slabs[slab]
            colour = None
            if design.colours is not None:
                near = design.colours[x : x + a, y : y + b, low:high].reshape(-1, 3)
                some, many = np.unique(near, axis=0, return_counts=True)
                red, green, blue = some[many.argmax()].tolist()
                colour = red, green, blue
            corner, size = (x, y, self.layers * low), (a, b, self.layers * (high - low))
            made.append(Brick(corner, size, f"brick {number}", colour))
        across, along = (-n * kit.pitch[0] / 2 for n in self.wanted.shape[:2])
        model = BrickModel(tuple(made), name=design.name, offset=(across, along))
        return assembly_of(model, kit, design.source)
