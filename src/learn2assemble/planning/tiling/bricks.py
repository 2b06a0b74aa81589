"""Cells of a design filled with bricks that clutch: one connected piece is looked for.

Each layer is covered from a corner by the brick that links most bricks below and above it; then
parts that hang together with nothing else are covered anew, with their neighbours in the layer,
until everything is one piece or all of it is in pieces that stand on the ground. What falls is
covered anew where it moves first.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

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
from learn2assemble.statics.holding_check import stands_by_joints

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
        design: in cells as large as a brick of one stud.
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
        inside = binary_erosion(wanted, np.ones((3, 3, 3), bool), iterations=shell)
        wanted &= np.logical_not(inside)
    tiler = _Tiler(wanted, kit, np.random.default_rng(seed))
    tiler.fill()
    tiler.join(clock)
    progress(f"{len(tiler.bricks)} bricks in {tiler.pieces()} pieces")
    assembly = _standing(tiler, design, kit, clock)
    planned = time.perf_counter() - started
    plan = plan_bricks(assembly, help_, clock, progress)
    if (not plan.complete and plan.status != "refused") or "hang on" in (plan.reason or ""):
        hands = Supports(holds=max(help_.holds, 1), hands=True)
        more = plan_bricks(assembly, hands, clock, progress)
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


def _standing(tiler: _Tiler, design: CellDesign, kit: Kit, clock: Clock) -> Assembly:
    """The bricks as an assembly, covered anew where they move first as long as they fall."""
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
    return best


class _Tiler:
    """Bricks in cells, layer by layer.

    Args:
        wanted: bool[X, Y, Z].
        kit: whose bricks they are.
        rng: for what is as good.
    """

    def __init__(self, wanted: np.ndarray, kit: Kit, rng: np.random.Generator) -> None:
        if kit.limited:
            raise InputError("kit", kit.name, "bricks without counts, for designs of cells")
        layers = brick_layers(kit)
        extents = [(np.max(kind.cells, 0) + 1).tolist() for kind in kit.kinds]
        sizes = {(a, b) for x, y, z in extents if z == layers for a, b in ((x, y), (y, x))}
        if (1, 1) not in sizes:
            raise InputError("kit", kit.name, "a kit with the brick 1x1, for designs of cells")
        self.sizes, self.rng, self.wanted = sorted(sizes), rng, wanted
        self.owner = np.full(wanted.shape, -1)
        """The brick of every cell, or -1."""
        self.bricks: dict[int, tuple[int, int, int, int, int]] = {}
        """x, y, z of the smallest corner, and extents along x and y."""
        self._next = 0

    def fill(self) -> None:
        """Cover everything, from below."""
        for z in range(self.wanted.shape[2]):
            self._cover(z, self.wanted[:, :, z].copy(), _CHANCES[0])

    def again(self, bricks: list[int]) -> None:
        """Cover some bricks anew, with what touches them in their layer."""
        for z in sorted({self.bricks[b][2] for b in bricks if b in self.bricks}):
            here = np.isin(self.owner[:, :, z], bricks)
            wide = here.copy()
            wide[1:] |= here[:-1]
            wide[:-1] |= here[1:]
            wide[:, 1:] |= here[:, :-1]
            wide[:, :-1] |= here[:, 1:]
            touched = np.unique(self.owner[:, :, z][wide])
            touched = touched[touched >= 0]
            free = np.isin(self.owner[:, :, z], touched)
            for b in touched.tolist():
                del self.bricks[b]
            self.owner[:, :, z][free] = -1
            self._cover(z, free, _CHANCES[1])

    def _cover(self, z: int, free: np.ndarray, chance: float) -> None:
        below = self.owner[:, :, z - 1] if z else None
        above = self.owner[:, :, z + 1] if z + 1 < self.wanted.shape[2] else None
        flip = self.rng.random(2) < 0.5
        cells = np.argwhere(free)
        keys = [-c if f else c for c, f in zip(cells.T, flip, strict=True)]
        order = np.lexsort(keys if self.rng.random() < 0.5 else keys[::-1])
        for x, y in cells[order].tolist():
            if not free[x, y]:
                continue
            best, chosen = -np.inf, (x, y, 1, 1)
            for a, b in self.sizes:
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
            self.owner[i : i + a, j : j + b, z] = self._next
            self.bricks[self._next] = (i, j, z, a, b)
            self._next += 1

    def labels(self) -> tuple[int, dict[int, int], int]:
        """How many pieces there are that do not stand on the ground beside the largest one, the
        piece of every brick, and which is the largest."""
        names = np.array(sorted(self.bricks))
        low, high = self.owner[:, :, :-1], self.owner[:, :, 1:]
        both = (low >= 0) & (high >= 0)
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
        return any(self.bricks[b][2] == 0 for b, one in label.items() if one == piece)

    def assembly(self, design: CellDesign, kit: Kit) -> Assembly:
        """The bricks where they stand."""
        layers = brick_layers(kit)
        made = []
        for number, (x, y, z, a, b) in enumerate(self.bricks.values(), 1):
            colour = None
            if design.colours is not None:
                near = design.colours[x : x + a, y : y + b, z].reshape(-1, 3)
                some, many = np.unique(near, axis=0, return_counts=True)
                red, green, blue = some[many.argmax()].tolist()
                colour = red, green, blue
            low, size = (x, y, layers * z), (a, b, layers)
            made.append(Brick(low, size, f"brick {number}", colour))
        across, along = (-n * kit.pitch[0] / 2 for n in self.wanted.shape[:2])
        model = BrickModel(tuple(made), name=design.name, offset=(across, along))
        return assembly_of(model, kit, design.source)
