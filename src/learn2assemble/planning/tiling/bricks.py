"""Cells of a design filled with bricks that clutch: one connected piece is looked for.

The cells are cut into slabs, each a brick or a plate high (:func:`slabs_of`). Each slab is covered
from a corner by the brick that links most bricks below and above it; then parts that hang together
with nothing else are covered anew, with their neighbours in the slab, until everything is one piece
or all of it is in pieces that stand on the ground. What falls is covered anew where it moves first.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.ndimage import binary_erosion
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
from learn2assemble.statics.holding_check import JointAnswer, stands_by_joints

_LINK, _LOOSE, _CHANCES = 3.0, 100.0, (0.5, 4.0)
"""What a brick linked above or below is worth, in cells; what it costs to link none; how much
chance is added, at first and where something is covered anew."""
_TRIES, _REPAIRS = 4000, 60
"""Layers covered anew at most: for one piece, and for one that stands."""
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
        wanted &= ~_inside(wanted, shell, brick_layers(kit) if kit.plates else 1)
    tiler = _Tiler(wanted, kit, np.random.default_rng(seed))
    tiler.fill()
    tiler.join(clock)
    progress(f"{len(tiler.bricks)} bricks in {tiler.pieces()} pieces")
    assembly, found = _standing(tiler, design, kit, clock)
    planned = time.perf_counter() - started
    plan = plan_bricks(assembly, help_, clock, progress, found)
    if (not plan.complete and plan.status != "refused") or "hang on" in (plan.reason or ""):
        hands = Supports(holds=max(help_.holds, 1), hands=True)
        more = plan_bricks(assembly, hands, clock, progress, found)
        plan = more if more.complete else plan
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
        volume_error=round(float(design.volume_error), 6),
        not_read=design.not_read,
        note=design.note or plan.design.note,
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
    share = found.need.share
    limit = clock.left * (1 - _SHARE)
    for _ in range(_REPAIRS):
        if found.need.stands or clock.left < limit:
            break
        moving = found.balance.holding().moving
        kept = tiler.bricks.copy(), tiler.owner.copy()
        names = list(tiler.bricks)
        tiler.again([names[k] for k in moving])
        tiler.join(clock)
        made = tiler.assembly(design, kit)
        new = stands_by_joints(made)
        if new.need.share <= share:
            best, found, share = made, new, new.need.share
        else:
            tiler.bricks, tiler.owner = kept
    return best, found


class Slab(NamedTuple):
    """Cells that bricks of one height fill, from one level."""

    low: int
    high: int
    """Their lowest level, and that above the highest."""
    cells: np.ndarray
    """bool[X, Y]."""


class _Placed(NamedTuple):
    """A brick: cells from its smallest corner, and extents along x and y."""

    x: int
    y: int
    a: int
    b: int
    slab: int
    """Index of its slab."""


def slabs_of(wanted: np.ndarray, layers: int) -> list[Slab]:
    """Every cell in one slab, ``layers`` levels high where that many are filled, else one; from
    below.

    Bricks are in layers that go through the whole design, so that they bond; of the levels at which
    these may begin the one is taken that leaves the fewest parts of columns, then the fewest slabs.
    Plates fill what is left of a column below and above. A column that is high enough for a brick
    but meets no such layer has a brick where it begins, so nowhere are as many plates in one column
    as make a brick.

    Args:
        wanted: bool[X, Y, Z].
        layers: height of a brick [cells]; 1: all slabs are of one level.
    """
    return _slabs(_cut(wanted, layers, _first_layer(wanted, layers)))


def _first_layer(wanted: np.ndarray, layers: int) -> int:
    """The level at which layers of bricks begin, see :func:`slabs_of`."""

    def worth(first: int) -> tuple[int, int]:
        slabs = _slabs(_cut(wanted, layers, first))
        return sum(int(slab.cells.sum()) for slab in slabs), len(slabs)

    return min(range(layers), key=worth)


def _inside(wanted: np.ndarray, thick: int, layers: int) -> np.ndarray:
    """bool[X, Y, Z]: cells that are more than ``thick`` cells, up and down so many bricks, from
    outside, in layers as high as bricks: nobody sees finer steps there, and plates would hang."""
    around = 2 * thick + 1
    deep = binary_erosion(wanted, np.ones((around, around, 2 * thick * layers + 1), bool))
    found = np.zeros_like(wanted)
    for low in range(_first_layer(wanted, layers), wanted.shape[2] - layers + 1, layers):
        found[:, :, low : low + layers] = deep[:, :, low : low + layers].all(2, keepdims=True)
    return found


def _slabs(heights: np.ndarray) -> list[Slab]:
    """The slabs of a cut, from below, the highest first."""
    found = []
    for low in range(heights.shape[2]):
        for height in np.unique(heights[:, :, low])[::-1].tolist():
            if height:
                found.append(Slab(low, low + height, heights[:, :, low] == height))
    return found


def _cut(wanted: np.ndarray, layers: int, first: int) -> np.ndarray:
    """int64[X, Y, Z]: height of the part of a column that begins at a cell, 0 where none does.

    Args:
        first: level at which a layer of bricks begins; others follow above.
    """
    depth = wanted.shape[2]
    found = wanted.astype(np.int64)
    free = wanted.copy()

    def fill(low: int) -> None:
        where = np.logical_and.reduce(free[:, :, low : low + layers], axis=2)
        found[:, :, low : low + layers][where] = [layers] + [0] * (layers - 1)
        free[:, :, low : low + layers][where] = False

    if layers == 1:
        return found
    for low in range(first, depth - layers + 1, layers):
        fill(low)
    # Columns that meet no layer of bricks; what bricks leave of others is lower than one.
    for low in range(depth - layers + 1):
        fill(low)
    return found


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
            height: sorted({s for x, y, z in extents if z == height for s in ((x, y), (y, x))})
            for height in {self.layers * (slab.high - slab.low) for slab in self.slabs}
        }
        """Extents along x and y, by height [layers]."""
        for height, sizes in self.sizes.items():
            if (1, 1) not in sizes:
                one = "brick 1x1" if height == layers else "plate 1x1"
                raise InputError("kit", kit.name, f"a kit with the {one}, for designs of cells")
        self.rng, self.wanted = rng, wanted
        self.owner = np.full(wanted.shape, -1)
        """The brick of every cell, or -1."""
        self.bricks: dict[int, _Placed] = {}
        self._next = 0

    def fill(self) -> None:
        """Cover everything, from below."""
        for number, slab in enumerate(self.slabs):
            self._cover(number, slab.cells.copy(), _CHANCES[0])

    def again(self, bricks: list[int]) -> None:
        """Cover some bricks anew, with what touches them in their slab."""
        for number in sorted({self.bricks[b].slab for b in bricks if b in self.bricks}):
            low, high, cells = self.slabs[number]
            owner = np.where(cells, self.owner[:, :, low], -1)
            here = np.isin(owner, bricks)
            wide = here.copy()
            wide[1:] |= here[:-1]
            wide[:-1] |= here[1:]
            wide[:, 1:] |= here[:, :-1]
            wide[:, :-1] |= here[:, 1:]
            touched = np.unique(owner[wide])
            touched = touched[touched >= 0]
            free = np.isin(owner, touched)
            for b in touched.tolist():
                del self.bricks[b]
            self.owner[:, :, low:high][free] = -1
            self._cover(number, free, _CHANCES[1])

    def _cover(self, slab: int, free: np.ndarray, chance: float) -> None:
        low, high, _ = self.slabs[slab]
        sizes = self.sizes[self.layers * (high - low)]
        below = self.owner[:, :, low - 1] if low else None
        above = self.owner[:, :, high] if high < self.wanted.shape[2] else None
        flip = self.rng.random(2) < 0.5
        cells = np.argwhere(free)
        keys = [-c if f else c for c, f in zip(cells.T, flip, strict=True)]
        order = np.lexsort(keys if self.rng.random() < 0.5 else keys[::-1])
        for x, y in cells[order].tolist():
            if not free[x, y]:
                continue
            best, chosen = -np.inf, (x, y, 1, 1)
            for a, b in sizes:
                i, j = x - (a - 1 if flip[0] else 0), y - (b - 1 if flip[1] else 0)
                if i < 0 or j < 0 or not free[i : i + a, j : j + b].all():
                    continue
                if i + a > free.shape[0] or j + b > free.shape[1]:
                    continue
                worth = a * b + chance * self.rng.random()
                links = 0
                for other in (below, above):
                    if other is not None:
                        near = set(other[i : i + a, j : j + b].reshape(-1).tolist()) - {-1}
                        links += len(near)
                worth += _LINK * links if links else -_LOOSE
                if worth > best:
                    best, chosen = worth, (i, j, a, b)
            i, j, a, b = chosen
            free[i : i + a, j : j + b] = False
            self.owner[i : i + a, j : j + b, low:high] = self._next
            self.bricks[self._next] = _Placed(i, j, a, b, slab)
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
            if all(self._grounded(label, piece) for piece in set(label.values())) and (
                self.rng.random() < 0.01
            ):
                return
            kept = self.bricks.copy(), self.owner.copy()
            self.again([loose[int(self.rng.integers(len(loose)))]])
            now = self.labels()
            if now[0] <= count:
                count, label, largest = now
            else:
                self.bricks, self.owner = kept

    def _grounded(self, label: dict[int, int], piece: int) -> bool:
        return any(
            self.slabs[self.bricks[b].slab].low == 0 for b, one in label.items() if one == piece
        )

    def assembly(self, design: CellDesign, kit: Kit) -> Assembly:
        """The bricks where they stand."""
        made = []
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
