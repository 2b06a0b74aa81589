"""How a finished building would fall, and tilings that rule it out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from learn2assemble.assembly.kit import Kit
from learn2assemble.planning.programs import INF, Clock, Entry, Model, solve
from learn2assemble.planning.step_proof import Stack
from learn2assemble.planning.tiling import (
    TIME_OPTION,
    Candidates,
    Tiling,
    bond_cost,
    components,
    cover,
    find_candidates,
    from_below,
    glued,
    heap_of,
    owners,
    placement_cells,
    seams_below,
)

if TYPE_CHECKING:
    from learn2assemble.physics.rigid_blocks import System

_SPARSER, _SPARSE = 6, 4
"""How often a mechanism is looked for that opens fewer joints, and how few are enough."""
_GLUED = 1e6
"""Price of parting a pair of blocks that a motion found before has parted."""


def find_mechanisms(
    stack: Stack, owner: np.ndarray, most: int = 12, seconds: float = INF,
    moving: np.ndarray | None = None,
) -> list[tuple[np.ndarray, np.ndarray]]:  # fmt: skip
    """Ways in which a stack falls down, as the joints that would have to be glued.

    A mechanism is a virtual motion of the blocks, each along z and tilting about x and y, that
    presses nothing into anything and lowers the centre of mass. It exists exactly where no bed
    forces balance the blocks (Farkas). Of all of them a linear program takes one that opens the
    vertical joints least. **Cut:** any tiling of the same cells in which no block bridges one of
    the joints that open can move in the same way, so it falls, too.

    Args:
        owner: int64[X, Y, Z]: which block fills each cell, -1 for none.
        most: how many mechanisms without a common joint are looked for.
        moving: bool[n], blocks that may move; all by default.

    Returns:
        bool[X - 1, Y, Z] and bool[X, Y - 1, Z] for each: joints that open.
    """
    places, sides = _joints(owner)
    n, m, unit = len(stack), len(sides), stack.pitch
    axis, at = np.repeat([0, 1], [len(cells) for cells in places]), np.concatenate(places)[:, :2]
    size = stack.cell
    foot = (
        at + np.stack([1 - axis / 2, 0.5 + axis / 2], -1) - np.array(owner.shape[:2]) / 2
    ) * size
    model = Model()
    free = np.full(3 * n, INF) if moving is None else np.where(np.repeat(moving, 3), INF, 0.0)
    motion = model.columns(np.zeros(3 * n), free, lower=-free).reshape(n, 3)
    jumps = model.columns(np.zeros(6 * m)).reshape(2, 3 * m)

    def along_z(row: np.ndarray, block: np.ndarray, xy: np.ndarray, sign: float) -> list[Entry]:
        """Velocity of points of blocks."""
        lever = (xy - stack.centre[block, :2]) / unit
        arms = (np.ones(len(row)), lever[:, 0], lever[:, 1])
        return [(row, motion[block, k], sign * arm) for k, arm in enumerate(arms)]

    point, bears = np.arange(len(stack.point)), np.flatnonzero(stack.lower >= 0)
    model.rows(
        np.zeros(len(point)), INF, *along_z(point, stack.upper, stack.point[:, :2], 1.0),
        *along_z(bears, stack.lower[bears], stack.point[bears, :2], -1.0),
    )  # fmt: skip
    model.rows(1.0, 1.0, (0, motion[:, 0], -stack.weight / stack.weight.mean()))
    number = 3 * np.arange(m)
    model.rows(
        np.zeros(3 * m), 0.0,
        *((np.arange(3 * m), jump, sign) for jump, sign in zip(jumps, (-1.0, 1.0), strict=True)),
        *along_z(number, sides[:, 0], foot, 1.0), *along_z(number, sides[:, 1], foot, -1.0),
        *((number + k, motion[sides[:, side], k], sign)
          for k in (1, 2) for side, sign in ((0, 1.0), (1, -1.0))),
    )  # fmt: skip
    program, clock = model.program(), Clock(seconds)

    def part(price: np.ndarray, closed: np.ndarray) -> np.ndarray | None:
        opens = np.tile(np.repeat(~closed, 3), 2)
        upper = np.concatenate([free, np.where(opens, INF, 0.0)])
        cost = np.concatenate([np.zeros(3 * n), np.tile(np.repeat(price, 3), 2)])
        answer = solve(replace(program, cost=cost, upper=upper), clock.left)
        if answer.x is None:
            return None
        gap = np.abs(answer.x[jumps[0]] - answer.x[jumps[1]])
        return gap.reshape(-1, 3).max(1)

    return [_edges(owner, places, opened) for opened in _partings(part, np.ones(m), most, 1e-7)]


def _partings(
    part: Callable[[np.ndarray, np.ndarray], np.ndarray | None], size: np.ndarray, most: int,
    rounding: float,
) -> list[np.ndarray]:  # fmt: skip
    """bool[m] for each of up to ``most`` motions without a common joint: which joints it opens.

    Args:
        part: how far each joint opens in the cheapest motion, from the prices of opening them and
            which of them stay closed (bool[m]); None where there is no motion.
        size: float64[m], prices to begin with.
        rounding: what counts as closed, in the widest opening.
    """
    closed, found = np.zeros(len(size), bool), []
    while len(found) < most:
        price, opened = size, None
        for _ in range(1 + _SPARSER):
            gap = part(price, closed)
            if gap is None:
                break
            widest = float(gap.max(initial=0.0))
            now = gap > max(rounding * widest, 1e-7)
            if opened is None or size[now].sum() < size[opened].sum():
                opened = now
            if size[opened].sum() <= _SPARSE:
                break
            # Joints that hardly open cost more: the next motion does without them.
            price = size / (gap / widest + 1e-3)
        if opened is None:
            break
        found.append(opened)
        if not opened.any():
            break
        closed |= opened
    return found


def _joints(owner: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Where two blocks stand side by side: the cells of the lower ones of pairs in x and in y
    (int64[., 3] each), and the blocks of all pairs (int64[m, 2])."""
    places, sides = [], []
    for low, high in ((owner[:-1], owner[1:]), (owner[:, :-1], owner[:, 1:])):
        places.append(np.argwhere((low >= 0) & (high >= 0) & (low != high)))
        sides.append(np.stack([cells[tuple(places[-1].T)] for cells in (low, high)], 1))
    return places, np.concatenate(sides)


def _edges(
    owner: np.ndarray, places: list[np.ndarray], opened: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Opened joints (bool[m], those across x first) as pairs of neighbouring cells."""
    edges = np.zeros_like(owner[:-1], bool), np.zeros_like(owner[:, :-1], bool)
    for edge, at, open_ in zip(edges, places, np.split(opened, [len(places[0])]), strict=True):
        edge[tuple(at[open_].T)] = True
    return edges


def find_slides(
    system: System, owner: np.ndarray, friction: float, most: int = 4
) -> list[tuple[np.ndarray, np.ndarray]]:  # fmt: skip
    """Ways in which blocks with tight joints fall down, as the joints that would have to be glued.

    As :func:`find_mechanisms`, with motions in all six directions of every block that friction on
    side faces does not hold back either. **Cut:** any tiling of boxes of the same cells in which no
    block bridges one of these joints can move in the same way, since the same faces part.

    Args:
        system: of all blocks, in the order of ``owner``, with vertical joints of width 0.
        owner: int64[X, Y, Z]: which block fills each cell, -1 for none.
    """
    import scipy.sparse as sp

    places, sides = _joints(owner)
    pairs, which = np.unique(sides, axis=0, return_inverse=True)
    which, m = which.reshape(-1), len(pairs)
    middle = system.centre[pairs].mean(1)
    rows, columns, values = [], [], []
    for side, sign in ((0, 1.0), (1, -1.0)):
        body = pairs[:, side]
        arm = middle - system.centre[body]
        # Of a block that turns by w: its angle of a radius, and the velocity w x arm.
        turn = sign / system.radius[body]
        cross = np.cross(np.eye(3)[None], arm[:, None])
        block = np.zeros((m, 6, 6))
        block[:, :3, :3] = sign * np.eye(3)
        block[:, :3, 3:] = turn[:, None, None] * cross.transpose(0, 2, 1)
        block[:, 3:, 3:] = turn[:, None, None] * np.eye(3)
        row = 6 * np.arange(m)[:, None, None] + np.arange(6)[:, None]
        column = 6 * body[:, None, None] + np.arange(6)
        for entries, whole in ((row, rows), (column, columns), (block, values)):
            whole.append(np.broadcast_to(entries, block.shape).reshape(-1))
    index = np.concatenate(rows), np.concatenate(columns)
    jump = sp.csc_matrix((np.concatenate(values), index), (6 * m, 6 * system.count))

    def part(price: np.ndarray, closed: np.ndarray) -> np.ndarray | None:
        gap = system.least_parting(friction, jump, np.where(closed, _GLUED, price))
        held = gap is not None and (gap[closed] <= 1e-5 * gap.max(initial=0.0)).all()
        return gap if held else None

    size = np.bincount(which, minlength=m).astype(float)
    found = _partings(part, size, most, 1e-5)
    return [_edges(owner, places, opened[which]) for opened in found]


def mirrored(
    edges: tuple[np.ndarray, np.ndarray], wanted: np.ndarray, square: bool
) -> list[tuple[np.ndarray, np.ndarray]]:
    """A cut under all symmetries of the design, itself among them.

    Args:
        square: whether cells are as wide as deep, so that x and y may be exchanged.
    """
    found = []
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
    found = find_candidates(tiling.wanted, kit)
    if not tight:
        found = found.take(np.flatnonzero(np.isfinite(found.support)))
    owner = owners(tiling.placements, kit, tiling.wanted.shape)
    return found, bond_cost(found, seams_below(owner))


class Retiling:
    """A tiling whose layers are decided again together, under conditions that cross them.

    A *cut* is a set of pairs of neighbouring cells of which at least one has to be filled by one
    block, see :func:`find_mechanisms`. Only parts of layers
    that a cut touches are decided again, by one program; the others stay as they were.
    """

    def __init__(self, tiling: Tiling, kit: Kit, tight: bool = False) -> None:
        self.tiling, self.kit = tiling, kit
        self.found, self.cost = bonded_candidates(tiling, kit, tight=tight)
        self.cuts: dict[bytes, np.ndarray] = {}
        self.part = self._parts()
        self.active = np.zeros(self.part.max() + 1, bool)

    def _parts(self) -> np.ndarray:
        """int64[cells of the lattice]: the part of its layer each cell belongs to."""
        wanted = self.tiling.wanted
        part = np.zeros(wanted.shape, np.int64)
        if self.kit.limited or not self.kit.flat:
            return part.reshape(-1)
        number = 0
        for z in range(wanted.shape[2]):
            for mask in components(wanted[:, :, z]):
                number += 1
                part[:, :, z][mask] = number
        return part.reshape(-1)

    def add(self, edges: tuple[np.ndarray, np.ndarray]) -> bool:
        """Add a cut (bool[X - 1, Y, Z], bool[X, Y - 1, Z]); whether it is a new one."""
        key = edges[0].tobytes() + edges[1].tobytes()
        if key in self.cuts:
            return False
        self.cuts[key] = np.flatnonzero(glued(self.found, edges) > 0)
        shape = self.tiling.wanted.shape
        for axis, edge in enumerate(edges):
            at = np.argwhere(edge)
            self.active[self.part[np.ravel_multi_index(tuple(at.T), shape)]] = True
            at[:, axis] += 1
            self.active[self.part[np.ravel_multi_index(tuple(at.T), shape)]] = True
        return True

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
        must = np.flatnonzero(live & old.wanted.reshape(-1))
        answer, picked, _, _ = cover(
            self.found.take(keep), self.cost[keep], must, kit=kit, counts=heap_of(kit), cuts=cuts,
            seconds=clock.left,
        )  # fmt: skip
        if answer.status == "infeasible":
            return None
        if answer.status == "time":
            reason = f"time ran out after {seconds:g} s; {TIME_OPTION} gives more"
            return replace(old, status="time", reason=reason)
        first = [placement_cells(block, kit)[0] for block in old.placements]
        again = live[np.ravel_multi_index(tuple(np.array(first).T), old.wanted.shape)]
        stays = [block for block, anew in zip(old.placements, again, strict=True) if not anew]
        blocks = [*stays, *self.found.blocks(kit, keep[picked])]
        return replace(old, placements=from_below(blocks))
