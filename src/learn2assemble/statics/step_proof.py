r"""Whether a stack of lattice blocks stands on its bed faces: a local proof and a program.

Only horizontal joints carry force, so nothing depends on how tight the vertical ones are. A state
is *proven* where normal forces :math:`N_p \ge 0` at the corners of the contact patches balance
every block :math:`b` of weight :math:`w_b` and centre :math:`c_b`:

.. math::

    \sum_{p \text{ below } b} N_p\,(1, x_p, y_p) - \sum_{p \text{ above } b} N_p\,(1, x_p, y_p)
        = w_b\,(1, c_{bx}, c_{by}) .

Such forces need no friction, hence hold for every coefficient of friction: forces that balance
mean that no motion lowers the centre of mass, and friction can only take energy away.

**Sideways acceleration.** Where gravity is joined by a horizontal acceleration ``a`` along ``d``,
let every force point along :math:`(a d, 1)`: the same equations with :math:`x` replaced by
:math:`x - a z d` for points and centres. A solution is a proof for every friction of at least
``a``; tilting the table by :math:`\arctan a` is the same load. Such forces are one family among
all that friction allows, so the acceleration found is a lower bound of what the stack withstands.

**Local proof.** A new block's load is passed down, block by block (:mod:`.local_proof`): its bed
faces answer with the smallest change of their forces that balances it and stays non-negative (a
linear pressure where nothing is at zero yet). Only what lies below is touched. Where that fails,
blocks that cannot answer are balanced together with those near them, and where that fails, too,
forces are looked for under many blocks at once (:mod:`.elastic`, and a linear program where that
finds no answer): first under what lies below with the loads of all else held, then under all
blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from learn2assemble.assembly.blocks import Block
from learn2assemble.assembly.contacts import Contacts
from learn2assemble.kernels import kernel
from learn2assemble.linear_programs import INF, LinearProgram, solve
from learn2assemble.statics.elastic import balance
from learn2assemble.statics.local_proof import StackLoad, settle

GROUND = -1
EDGE_INSET = 1e-3
"""Support polygons are smaller than bed faces by this share of the pitch on every side, besides
half the joint gap: what is balanced right on an edge is not called standing."""
TOLERANCE = 1e-7
"""Largest imbalance of a proof, in weights of the heaviest block (and of the pitch)."""


_Array = np.ndarray
StackArrays = tuple[_Array, _Array, _Array, _Array, _Array, _Array, _Array, _Array]
"""Weights, centres, points, blocks above and below them, shares, starts and ranks of a stack."""


@dataclass(frozen=True)
class Stack:
    """Blocks and the corners of the bed joints between them."""

    weight: np.ndarray
    """float64[n] [kg]."""
    centre: np.ndarray
    """float64[n, 3] [m]."""
    point: np.ndarray
    """float64[P, 3] [m], sorted by ``upper``."""
    upper: np.ndarray
    """int64[P]: the block that rests on the point."""
    lower: np.ndarray
    """int64[P]: the block that bears it, -1 for the table."""
    share: np.ndarray
    """float64[P]: area that belongs to the point [m2]."""
    start: np.ndarray
    """int64[n + 1]: block b rests on the points ``start[b]:start[b + 1]``."""
    rank: np.ndarray
    """int64[n]: every block has a larger rank than those it rests on."""
    cell: np.ndarray
    """float64[2]: width and depth of a lattice cell [m]."""

    @property
    def arrays(self) -> StackArrays:
        """Its fields without the size of a cell."""
        one = self.weight, self.centre, self.point, self.upper
        return (*one, self.lower, self.share, self.start, self.rank)

    @cached_property
    def pitch(self) -> float:
        """Unit of length of the solver [m]."""
        return float(self.cell.min())

    @cached_property
    def above(self) -> tuple[np.ndarray, np.ndarray]:
        """int64: points that rest on each block, at ``start[b]:start[b + 1]``; int64[n + 1]."""
        return _above(self.lower, len(self))

    @cached_property
    def order(self) -> np.ndarray:
        """int64: all blocks that are in no ring and rest on none, each before what bears it."""
        return self._ordered[0]

    @cached_property
    def turn(self) -> np.ndarray:
        """int64[n]: where each block is in :attr:`order`, -1 where it is not."""
        return self._ordered[1]

    @cached_property
    def _ordered(self) -> tuple[np.ndarray, np.ndarray]:
        return _order(self.rank)

    def __len__(self) -> int:
        return len(self.weight)

    @cached_property
    def bases(self) -> list[np.ndarray]:
        """For each block, int64: those it rests on, sorted, without the table."""
        return [
            found[found >= 0] for found in map(np.unique, np.split(self.lower, self.start[1:-1]))
        ]

    @cached_property
    def tops(self) -> list[np.ndarray]:
        """For each block, int64: those that rest on it, sorted."""
        points, start = self.above
        return [np.unique(found) for found in np.split(self.upper[points], start[1:-1])]

    def part(self, blocks: np.ndarray) -> Stack:
        """The blocks with the given indices (int64[k], ascending), what is below them as ground."""
        number = np.full(len(self) + 1, GROUND)
        number[blocks] = np.arange(len(blocks))
        points = np.flatnonzero(number[self.upper] >= 0)
        upper = number[self.upper[points]]
        return replace(
            self,
            weight=self.weight[blocks],
            centre=self.centre[blocks],
            point=self.point[points],
            upper=upper,
            lower=number[self.lower[points]],
            share=self.share[points],
            start=np.searchsorted(upper, np.arange(len(blocks) + 1)),
            rank=self.rank[blocks],
        )

    def below(self, block: int) -> np.ndarray:
        """Blocks that ``block`` rests on, sorted, without the table."""
        return self.bases[block]


def stack_of_contacts(blocks: Sequence[Block], contacts: Contacts) -> Stack:
    """Blocks of any shape and their level joints, supports as part of the table.

    Args:
        contacts: of these blocks, all with vertical normals.
    """
    up = contacts.normal[:, 2] > 0
    support = np.array([block.support for block in blocks] + [True])
    upper, lower = np.where(up, contacts.b, contacts.a), np.where(up, contacts.a, contacts.b)
    lower = np.where(support[lower], GROUND, lower)
    size = np.diff(contacts.start)
    order = np.lexsort((np.arange(len(upper)), upper))
    order = order[~support[upper[order]]]
    starts: list[int] = contacts.start.tolist()
    listed: list[int] = order.tolist()
    corners = [np.arange(starts[k], starts[k + 1]) for k in listed]
    index = np.concatenate([*corners, np.empty(0, np.int64)])
    tops = np.repeat(upper[order], size[order])
    width = float(np.median([np.ptp(block.vertices, axis=0)[:2].min() for block in blocks]))
    stack = Stack(
        np.array([block.mass for block in blocks]),
        np.array([block.centroid for block in blocks]),
        contacts.points[index],
        tops,
        np.repeat(lower[order], size[order]),
        np.repeat(contacts.area[order] / np.maximum(size[order], 1), size[order]),
        np.searchsorted(tops, np.arange(len(blocks) + 1)),
        np.zeros(len(blocks), np.int64),
        np.full(2, width),
    )
    stack.rank[:] = ranks(stack)
    return stack


def find_ring(stack: Stack) -> list[int]:
    """Blocks that carry one another in a ring, so that none can come first; empty without one."""
    ringed = np.flatnonzero(stack.rank < 0)
    if not len(ringed):
        return []
    # Whatever is in no ring itself but rests on one has a way down that ends in it.
    way, at = list[int](), int(ringed[0])
    while at not in way:
        way.append(at)
        at = int(next(b for b in stack.below(at) if stack.rank[b] < 0))
    return way[way.index(at) :]


def ranks(stack: Stack) -> np.ndarray:
    """int64[n]: longest way down to the table; -1 for blocks that rest on one another in a ring."""
    rank = np.full(len(stack), -1)
    below = [stack.below(block) for block in range(len(stack))]
    above: list[list[int]] = [[] for _ in range(len(stack))]
    for block, bases in enumerate(below):
        carry: list[int] = bases.tolist()
        for base in carry:
            above[base].append(block)
    left = np.array([len(bases) for bases in below])
    ready: list[int] = np.flatnonzero(left == 0).tolist()
    rank[ready] = 0
    for block in ready:
        for top in above[block]:
            left[top] -= 1
            rank[top] = max(rank[top], rank[block] + 1)
            if left[top] == 0:
                ready.append(top)
    rank[left > 0] = -1
    return rank


# ---------------------------------------------------------------- states


class Proof:
    """Forces that prove a growing stack under one load.

    Args:
        acceleration: (ax, ay), sideways [g].
    """

    def __init__(self, stack: Stack, acceleration: tuple[float, float] = (0.0, 0.0)) -> None:
        self.stack = stack
        ax, ay = map(float, acceleration)
        px, py = _sheared(stack.point, ax, ay)
        cx, cy = _sheared(stack.centre, ax, ay)
        self.load: StackLoad = StackLoad(
            px=px,
            py=py,
            cx=cx,
            cy=cy,
            weight=stack.weight,
            share=stack.share,
            start=stack.start,
            upper=stack.upper,
            lower=stack.lower,
            above=stack.above[0],
            above_start=stack.above[1],
            order=stack.order,
            turn=stack.turn,
            unit=stack.pitch,
        )
        self.force: NDArray[np.float64] = np.zeros(len(stack.point))

    def settle(self, dirty: np.ndarray, placed: np.ndarray, mends: bool = False) -> bool:
        """Balance locally what is ``dirty`` (bool[n]) where ``placed`` stands; False: unchanged.

        Args:
            mends: balance a block that cannot answer on its own together with others near it.
        """
        before = self.force.copy()
        sound = settle(self.load, self.force, placed, dirty.copy(), mends)
        if not sound:
            self.force = before
        return bool(sound)

    def program(
        self, placed: np.ndarray, changing: np.ndarray, seconds: float = INF
    ) -> bool | None:
        """Forces under the blocks ``changing`` (bool[n]), all found at once.

        All other blocks keep their forces. Returns whether there are any, None where time ran
        out; where there are, they are taken.
        """
        free, _, program = self._equations(placed, changing)
        unit = self.stack.weight[changing & placed].max()
        found = balance(program, self.stack.share[free], self.force[free] / unit)
        if found is None:
            answer = solve(program, seconds)
            if answer.status == "time":
                return None
            found = False if answer.x is None else np.maximum(answer.x, 0.0)
        if isinstance(found, bool):
            return found
        self.force[~self._live(placed)] = 0.0
        self.force[free] = found * unit
        return True

    def held(self, placed: np.ndarray, seconds: float = INF) -> list[int]:
        """Blocks that the least forces and moments would hold, were ``placed`` to stand."""
        free, blocks, program = self._equations(placed, placed)
        n, m = len(free), len(program.row_lower)
        rows = np.arange(m)
        held = LinearProgram(
            np.concatenate([np.zeros(n), np.ones(2 * m)]),
            np.zeros(n + 2 * m),
            np.full(n + 2 * m, INF),
            program.row_lower,
            program.row_upper,
            np.concatenate([program.start, program.start[-1] + 1 + np.arange(2 * m)]),
            np.concatenate([program.index, rows, rows]),
            np.concatenate([program.value, np.ones(m), -np.ones(m)]),
        )
        answer = solve(held, seconds)
        if answer.x is None:
            return []
        force = answer.x[n : n + m] + answer.x[n + m :]
        return blocks[force.reshape(-1, 3).max(1) > 1e-6].tolist()

    def _live(self, placed: np.ndarray) -> np.ndarray:
        """bool[P]: points between blocks that are there."""
        s = self.stack
        return placed[s.upper] & ((s.lower < 0) | placed[np.maximum(s.lower, 0)])

    def _equations(
        self, placed: np.ndarray, changing: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, LinearProgram]:
        """Free points, changing blocks, and their balance in units of the heaviest of them."""
        s, live = self.stack, self._live(placed)
        free = np.flatnonzero(live & changing[s.upper])
        blocks = np.flatnonzero(changing & placed)
        row = np.full(len(s), -1)
        row[blocks] = np.arange(len(blocks))
        held = np.flatnonzero(live & ~changing[s.upper] & (s.lower >= 0))
        held = held[row[s.lower[held]] >= 0]
        load = np.zeros((len(s), 3))
        load[:, 0] = s.weight
        for k, lever in enumerate(self._levers(held, s.lower[held])):
            np.add.at(load[:, k], s.lower[held], self.force[held] * lever)
        right = load[blocks].reshape(-1) / s.weight[blocks].max()
        base = np.maximum(s.lower[free], 0)
        bears = (s.lower[free] >= 0) & (row[base] >= 0)
        own = np.stack(self._levers(free, s.upper[free]), 1)
        other = -np.stack(self._levers(free, base), 1)
        rows = np.concatenate(
            [3 * row[s.upper[free], None] + np.arange(3), 3 * row[base, None] + np.arange(3)], 1
        )
        values = np.concatenate([own, np.where(bears[:, None], other, 0.0)], 1)
        keep = values != 0
        start = np.concatenate([[0], np.cumsum(keep.sum(1))])
        n = len(free)
        program = LinearProgram(
            np.zeros(n), np.zeros(n), np.full(n, INF), right, right, start, rows[keep], values[keep]
        )
        return free, blocks, program

    def _levers(self, points: np.ndarray, block: np.ndarray) -> tuple[np.ndarray, ...]:
        """1 and the two lever arms of points about the centres of blocks [pitch]."""
        unit = self.stack.pitch
        return (
            np.ones(len(points)),
            (self.load.px[points] - self.load.cx[block]) / unit,
            (self.load.py[points] - self.load.cy[block]) / unit,
        )


def changed(stack: Stack, before: np.ndarray, placed: np.ndarray) -> np.ndarray:
    """bool[n]: blocks to balance again where ``placed`` (bool[n]) stands in place of ``before``."""
    gone = np.flatnonzero(before & ~placed)
    dirty = placed & ~before
    for block in gone.tolist():
        dirty[stack.tops[block]] = True
        dirty[stack.below(block)] = True
    return dirty & placed


def lies_below(stack: Stack, blocks: Iterable[int], placed: np.ndarray) -> np.ndarray:
    """bool[n]: ``blocks`` and all placed blocks that carry them."""
    return _reached(
        stack, [*blocks], lambda top: [b for b in stack.below(top).tolist() if placed[b]]
    )


def lies_above(stack: Stack, blocks: Iterable[int]) -> np.ndarray:
    """bool[n]: ``blocks`` and all that rest on them, directly or not."""
    return _reached(stack, [*blocks], lambda base: stack.tops[base].tolist())


def _reached(stack: Stack, queue: list[int], near: Callable[[int], Iterable[int]]) -> np.ndarray:
    found = np.zeros(len(stack), bool)
    found[queue] = True
    for block in queue:
        for other in near(block):
            if not found[other]:
                found[other] = True
                queue.append(other)
    return found


# ---------------------------------------------------------------- compiled
# A stack grows by one block at a time, and each has a proof of its own: with arrays of a few dozen
# points, calls of numpy would take longer than what they do.


@kernel
def _sheared(place: np.ndarray, ax: float, ay: float) -> tuple[np.ndarray, np.ndarray]:
    """float64[k] twice: x and y of places float64[k, 3] that an acceleration moves by height."""
    x, y = np.empty(len(place)), np.empty(len(place))
    for k in range(len(place)):
        x[k] = place[k, 0] - ax * place[k, 2]
        y[k] = place[k, 1] - ay * place[k, 2]
    return x, y


@kernel
def _above(lower: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """See :attr:`Stack.above`."""
    start = np.zeros(count + 1, np.int64)
    for a in lower:
        if a >= 0:
            start[a + 1] += 1
    for b in range(count):
        start[b + 1] += start[b]
    points, filled = np.empty(start[count], np.int64), start.copy()
    for p, a in enumerate(lower):
        if a >= 0:
            points[filled[a]] = p
            filled[a] += 1
    return points, start


@kernel
def _order(rank: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """See :attr:`Stack.order` and :attr:`Stack.turn`."""
    order = np.argsort(-rank, kind="mergesort")
    order = order[rank[order] >= 0]
    turn = np.full(len(rank), -1)
    turn[order] = np.arange(len(order))
    return order, turn


@kernel
def load_at_rest(stack: StackArrays, unit: float) -> StackLoad:
    """The load of a :class:`Stack` with these arrays and no acceleration, within a kernel."""
    weight, centre, point, upper, lower, share, start, rank = stack
    px, py = _sheared(point, 0.0, 0.0)
    cx, cy = _sheared(centre, 0.0, 0.0)
    above, above_start = _above(lower, len(weight))
    order, turn = _order(rank)
    return StackLoad(
        px, py, cx, cy, weight, share, start, upper, lower, above, above_start, order, turn, unit
    )
