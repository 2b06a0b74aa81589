"""From a standing structure to another one with its own blocks, every state of which stands.

A beam search over what may be taken or placed next (:mod:`.changeover`) that keeps the orders with
the fewest moves; states are proven as of any order (:mod:`.forward`). Without help: nothing is held
and no prop comes.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from learn2assemble.linear_programs import Clock
from learn2assemble.planning.forward import Forward
from learn2assemble.planning.rebuilding.changeover import Changeover
from learn2assemble.planning.sequence import Doing
from learn2assemble.progress import Detail, Pace
from learn2assemble.statics.states import State

WIDTHS = (4, 16, 64)
"""Orders that are kept after every step; the next width is tried while the bound is not met."""
Progress = Callable[[str], None]


@dataclass(frozen=True)
class Rebuilt:
    """An order of taking and placing.

    Attributes:
        steps: in order; a block is moved directly where its taking comes right before a placing of
            its kind.
        moves: how many blocks are carried from one place to another.
        going: blocks that had to be taken away.
        complete: whether it ends in the new structure.
        stuck: where it does not, blocks that could neither be taken nor placed.
    """

    steps: tuple[Doing, ...]
    moves: int
    going: frozenset[int]
    complete: bool
    stuck: tuple[int, ...] = ()


def count_moves(steps: tuple[Doing, ...], kind: np.ndarray) -> int:
    """Moves of an order: takings and placings, less the blocks that go straight to a new place."""
    moves, hand = 0, -1
    for action, block, *_ in steps:
        direct = action == "place" and hand == kind[block]
        moves += not direct
        hand = int(kind[block]) if action == "remove" else -1
    return moves


def find_rebuilding(
    change: Changeover,
    rules: Forward,
    bound: Callable[[float], int],
    clock: Clock,
    progress: Progress = lambda text: None,
) -> Rebuilt:
    """The order with the fewest moves that is found.

    Blocks that could stay and fall while others are away are taken away, too, where nothing else
    is found.

    Args:
        rules: that prove states of the same blocks.
        bound: of the moves, given how many an order has that is known; an order that needs no more
            is not improved.
    """
    going, best = change.going, Rebuilt((), 0, change.going, False)
    while True:
        falling: set[int] = set()
        for width in WIDTHS:
            if best.complete and (clock.left <= 0 or best.moves <= bound(best.moves)):
                break
            found = _Beam(change, rules, going, width, clock, progress).run(falling)
            if (found.complete and (not best.complete or found.moves < best.moves)) or (
                not best.complete and len(found.steps) >= len(best.steps)
            ):
                best = found
        more = change.with_those_on(falling) - going
        if best.complete or clock.left <= 0 or not more:
            return best
        going |= more


@dataclass(frozen=True, order=True)
class _PartialOrder:
    """An order so far: what is left to do, and how it came there."""

    rank: tuple[int, int, int]
    """Moves that it takes at least to the end; what stands in the way of what comes; a number."""
    moves: int
    going: frozenset[int] = field(compare=False)
    """Still to be taken away."""
    coming: frozenset[int] = field(compare=False)
    hand: int = field(compare=False)
    """Kind of the block that was taken last, or -1."""
    before: _PartialOrder | None = field(compare=False, default=None)
    step: Doing | None = field(compare=False, default=None)

    def steps(self) -> tuple[Doing, ...]:
        found, at = list[Doing](), self
        while at.before is not None and at.step is not None:
            found.append(at.step)
            at = at.before
        return tuple(found[::-1])


class _Beam:
    """One search with a width."""

    def __init__(
        self,
        change: Changeover,
        rules: Forward,
        going: frozenset[int],
        width: int,
        clock: Clock,
        progress: Progress,
    ) -> None:
        self.change, self.rules, self.width = change, rules, width
        self.clock, self.progress = clock, progress
        self.going, self.coming = going, change.coming(going)
        self.kind = change.kind
        self._first_gone = change.first_gone(self.coming, going)
        self._base = {n: {b for b in self.coming if n in change.above[b]} for n in self.coming}
        self._gone = {n: self._all_gone(n) for n in self.coming}
        self._stay = frozenset(np.flatnonzero(change.old).tolist()) - going
        self._supply = np.maximum(self._count(self.coming) - self._count(going), 0)
        """Of each kind, what is missing in the old structure."""

    def _count(self, blocks: frozenset[int]) -> np.ndarray:
        """How many blocks of each kind."""
        return np.bincount(self.kind[list(blocks)], minlength=int(self.kind.max()) + 1)

    def _all_gone(self, block: int) -> frozenset[int]:
        """What has to be gone before a block comes, with what lies on it, and for what it lies on,
        too."""
        queue, found, seen = [block], set[int](), set[int]()
        while queue:
            n = queue.pop()
            if n in seen:
                continue
            seen.add(n)
            found |= self._first_gone[n]
            queue += self._base[n] - seen
        return self.change.with_those_on(found) & self.going

    def run(self, falling: set[int]) -> Rebuilt:
        """The best order of a beam.

        Args:
            falling: filled with blocks that stay and that fell.
        """
        first = self._ranked(0, self.going, self.coming, -1, None, None)
        level, last = [first], first
        total, pace = len(self.going) + len(self.coming), Pace()
        for number in range(total):
            level = self._next(level, falling)
            if not level or self.clock.left <= 0:
                return Rebuilt(last.steps(), last.moves, self.going, False, self._stuck(last))
            last = level[0]
            told = pace.about(total - number - 1)
            self.progress(Detail(f"{number + 1} of {total} blocks taken or placed{told}"))
        return Rebuilt(last.steps(), last.moves, self.going, True)

    def _stuck(self, last: _PartialOrder) -> tuple[int, ...]:
        return tuple(sorted(last.going | last.coming))

    def _next(self, level: list[_PartialOrder], falling: set[int]) -> list[_PartialOrder]:
        """The best of what may come behind some orders, every state of it proven."""
        options = [option for order in level for option in self._options(order)]
        heapq.heapify(options)
        kept: list[_PartialOrder] = []
        seen: set[tuple[frozenset[int], frozenset[int], int]] = set()
        while options and len(kept) < self.width and self.clock.left > 0:
            option = heapq.heappop(options)
            key = option.going, option.coming, option.hand
            if key not in seen:
                seen.add(key)
                if self._proven(option, falling):
                    kept.append(option)
        return kept

    def _options(self, order: _PartialOrder) -> Iterator[_PartialOrder]:
        change, there = self.change, self._there(order)
        taken, placed = self.going - order.going, self.coming - order.coming
        heap = self._supply + self._count(taken) - self._count(placed)
        for n in order.coming:
            free = not self._first_gone[n] & order.going and not self._base[n] & order.coming
            free = free and not (change.overlaps[n] | change.above[n]) & there
            if free and heap[self.kind[n]] > 0:
                direct = order.hand == self.kind[n]
                left = order.coming - {n}
                yield self._ranked(
                    order.moves + (not direct), order.going, left, -1, order, Doing("place", n)
                )
        for o in order.going:
            if not change.above[o] & there:
                left, hand = order.going - {o}, int(self.kind[o])
                yield self._ranked(
                    order.moves + 1, left, order.coming, hand, order, Doing("remove", o)
                )

    def _there(self, order: _PartialOrder) -> frozenset[int]:
        return self._stay | order.going | (self.coming - order.coming)

    def _ranked(
        self,
        moves: int,
        going: frozenset[int],
        coming: frozenset[int],
        hand: int,
        before: _PartialOrder | None,
        step: Doing | None,
    ) -> _PartialOrder:
        """An order with the moves that it takes at least."""
        ours, theirs = self._count(going), self._count(coming)
        walls = [len(self._gone[n] & going) for n in coming]
        pairs = int(np.minimum(ours, theirs).sum())
        if hand >= 0 and theirs[hand] > 0 and (not walls or min(walls) == 0):
            ours[hand] += 1
            pairs = int(np.minimum(ours, theirs).sum())
        if walls:
            pairs = min(pairs, len(going) + (hand >= 0) - max(min(walls) - 1, 0))
        least = moves + len(going) + len(coming) - pairs
        last = step.block if step is not None else 0
        return _PartialOrder((least, sum(walls), last), moves, going, coming, hand, before, step)

    def _proven(self, order: _PartialOrder, falling: set[int]) -> bool:
        assert order.step is not None
        action, block, *_ = order.step
        present = np.zeros(len(self.change.blocks), bool)
        present[list(self._there(order))] = True
        state = State(present, np.zeros(len(present), bool))
        others = present.copy()
        others[block] = False
        if not self.rules.site.ways.free(block, others, sliding=False):
            return False
        new = [block] if action == "place" else self.rules.on(block, state)
        if self.rules.stands(state, new):
            return True
        falling |= set(self.rules.laws[-1].moving(state)) & self._stay
        return False
