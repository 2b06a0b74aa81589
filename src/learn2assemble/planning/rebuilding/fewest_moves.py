"""A bound of the moves that turn one structure into another; no order needs fewer."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from learn2assemble.linear_programs import Clock, Model, solve
from learn2assemble.planning.rebuilding.changeover import Changeover

_MOMENTS = 12
"""Of an order, looked at together before all of them are."""


def fewest_moves(change: Changeover, clock: Clock, known: float = math.inf) -> int:
    """A number of moves that no order without help goes below.

    A move takes one block from where it is to where it comes: out of the structure, into it, or
    from one place of it to another one. Let ``R`` be :attr:`~.Changeover.going` and ``P`` what has
    to be placed, those of ``R`` among them that stand at last. Every block of ``R`` is taken away
    at least once and every one of ``P`` placed at least once, so there are at least
    ``|R| + |P| - d`` moves, where ``d`` counts those that are both the first taking of a block of
    ``R`` and the last placing of one of ``P``. Both are of one kind.

    Look at the moments after ``j`` blocks of ``P`` have been placed for the last time, for some or
    all ``j``. For each let ``X`` be what of ``R`` has been taken until then, and ``Y`` what of
    ``P`` has been placed for the last time. A move that counts for ``d`` has both ends between the
    same two moments: there are at most as many of a kind as ``X`` grows by in between, and as
    ``Y`` does. Both never shrink, and as no two blocks overlap and none comes or goes while another
    lies on it,

    * with a block, ``Y`` has those of ``P`` that it lies on;
    * with a block of ``Y``, ``X`` has those of ``R`` that overlap it, that it lies on, and that lie
      on it;
    * with a block, ``X`` has those of ``R`` that lie on it.

    The integer program of the largest ``d`` under these alone bounds what any order can have. More
    moments bound it better, and with all of them at most one move counts between two. What stands
    is not asked, so an order may need more.

    Args:
        clock: programs that are not solved in time count with what is proven of them.
        known: moves of an order that there is. Where it is met, nothing better can be found.
    """
    going = sorted(change.going)
    coming = sorted(change.coming(going))
    best = len(going) + len(coming) - _most(change.kind, going, coming)
    last = len(coming) - 1
    # One moment takes little and some tell much; where many take too long, what is proven tells.
    some = [[number] for number in range(1, last + 1)]
    some += [_evenly(last, count) for count in (_MOMENTS, last) if 1 < count <= last]
    for numbers in some:
        if clock.left <= 0 or best >= known:
            break
        direct = _most_direct(change, going, coming, numbers, clock)
        best = max(best, len(going) + len(coming) - direct)
    return best


def _evenly(last: int, count: int) -> list[int]:
    """So many whole numbers from 1 to ``last``, evenly."""
    return np.unique(np.rint(np.linspace(0, last + 1, count + 2)[1:-1]).astype(int)).tolist()


def _most(kind: np.ndarray, some: Iterable[int], others: Iterable[int]) -> int:
    """How many pairs of one kind there are at most."""
    count = int(kind.max()) + 1
    one, two = (np.bincount(kind[list(blocks)], minlength=count) for blocks in (some, others))
    return int(np.minimum(one, two).sum())


def _most_direct(
    change: Changeover, going: list[int], coming: list[int], numbers: list[int], clock: Clock
) -> int:
    """The most direct moves of an order, by what holds after each of some ``numbers`` of blocks,
    ascending, were placed."""
    model, kind = Model(), change.kind
    before = change.first_gone(coming, frozenset(going))
    taken, placed = list[np.ndarray](), list[np.ndarray]()
    # Pairs of columns of which the first is not above the second.
    pairs: list[tuple[int, int]] = []
    for moment, number in enumerate(numbers):
        taken.append(model.columns(np.zeros(len(going)), 1.0, integer=True))
        placed.append(model.columns(np.zeros(len(coming)), 1.0, integer=True))
        column: dict[int, int] = dict(zip(going, taken[-1].tolist(), strict=True))
        other: dict[int, int] = dict(zip(coming, placed[-1].tolist(), strict=True))
        pairs += [(column[o], column[a]) for o in going for a in change.above[o] if a in column]
        pairs += [(other[a], other[n]) for n in coming for a in change.above[n] if a in other]
        pairs += [(other[n], column[o]) for n in coming for o in before[n]]
        if moment:
            for some in (taken, placed):
                pairs += zip(some[-2].tolist(), some[-1].tolist(), strict=True)
        model.rows(float(number), float(number), (0, placed[-1], 1.0))
    if pairs:
        row, (small, large) = np.arange(len(pairs)), np.array(pairs).T
        model.rows(np.full(len(pairs), -math.inf), 0.0, (row, small, 1.0), (row, large, -1.0))
    for one in sorted({int(kind[b]) for b in going} & {int(kind[b]) for b in coming}):
        between = model.columns(-np.ones(len(numbers) + 1))
        for columns, blocks in ((taken, going), (placed, coming)):
            mine = kind[blocks] == one
            states = [some[mine] for some in columns]
            for k, pair in enumerate(between):
                grown = [(0, np.array([pair]), 1.0)]
                grown += [(0, states[k], -1.0)] if k < len(states) else []
                grown += [(0, states[k - 1], 1.0)] if k else []
                whole = 0.0 if k < len(states) else float(mine.sum())
                model.rows(-math.inf, whole, *grown)
    answer = solve(model.program(), clock.left)
    if answer.status == "infeasible" or not math.isfinite(answer.bound):
        return _most(kind, going, coming)
    return math.floor(-answer.bound + 1e-6)
