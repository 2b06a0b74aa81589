"""A bound of the moves that turn one structure into another; no order needs fewer."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from learn2assemble.linear_programs import Clock, Model, solve
from learn2assemble.planning.changeover import Changeover


def fewest_moves(change: Changeover, clock: Clock) -> int:
    """A number of moves that no order without help goes below.

    A move takes one block from where it is to where it comes: out of the structure, into it, or
    from one place of it to another one. Let ``R`` be :attr:`~.Changeover.going` and ``P`` what has
    to be placed, those of ``R`` among them that stand at last. Every block of ``R`` is taken away
    at least once and every one of ``P`` placed at least once, so there are at least
    ``|R| + |P| - d`` moves, where ``d`` counts those that are both the first taking of a block of
    ``R`` and the last placing of one of ``P``. Both are of one kind.

    For every ``j``, look at the moment after ``j`` blocks of ``P`` have been placed for the last
    time, and let ``X`` be what of ``R`` has been taken and ``Y`` what of ``P`` has been placed
    until then. A move that counts for ``d`` has both ends before that moment or both after it: of
    each kind there are at most ``min(|X|, |Y|) + min(|R| - |X|, |P| - |Y|)``. And as no two blocks
    overlap and none comes or goes while another lies on it,

    * with a block, ``Y`` has those of ``P`` that it lies on;
    * with a block of ``Y``, ``X`` has those of ``R`` that overlap it, that it lies on, and that lie
      on it;
    * with a block, ``X`` has those of ``R`` that lie on it.

    The integer program of the largest ``d`` under these alone bounds what any order can have; the
    bound is the largest over all ``j``. What stands is not asked, so an order may need more.

    Args:
        clock: programs that are not solved in time count with what is proven of them.
    """
    going = sorted(change.going)
    coming = sorted(change.coming(going))
    best = len(going) + len(coming) - _most(change.kind, going, coming)
    for number in range(1, len(coming)):
        if clock.left <= 0:
            break
        direct = _most_direct(change, going, coming, number, clock)
        best = max(best, len(going) + len(coming) - direct)
    return best


def _most(kind: np.ndarray, some: Iterable[int], others: Iterable[int]) -> int:
    """How many pairs of one kind there are at most."""
    count = int(kind.max()) + 1
    one, two = (np.bincount(kind[list(blocks)], minlength=count) for blocks in (some, others))
    return int(np.minimum(one, two).sum())


def _most_direct(
    change: Changeover, going: list[int], coming: list[int], number: int, clock: Clock
) -> int:
    """The most direct moves of an order, by what holds after ``number`` blocks were placed."""
    model, kind = Model(), change.kind
    taken = model.columns(np.zeros(len(going)), 1.0, integer=True)
    placed = model.columns(np.zeros(len(coming)), 1.0, integer=True)
    column = dict(zip(going, taken.tolist(), strict=True))
    other = dict(zip(coming, placed.tolist(), strict=True))
    before = change.first_gone(coming, frozenset(going))
    # Pairs of columns of which the first is not above the second.
    pairs = [(column[o], column[a]) for o in going for a in change.above[o] if a in column]
    pairs += [(other[a], other[n]) for n in coming for a in change.above[n] if a in other]
    pairs += [(other[n], column[o]) for n in coming for o in before[n]]
    if pairs:
        row, (small, large) = np.arange(len(pairs)), np.array(pairs).T
        model.rows(np.full(len(pairs), -math.inf), 0.0, (row, small, 1.0), (row, large, -1.0))
    model.rows(float(number), float(number), (0, placed, 1.0))
    for one in sorted({int(kind[b]) for b in going} & {int(kind[b]) for b in coming}):
        mine = taken[kind[going] == one]
        theirs = placed[kind[coming] == one]
        early, late = model.columns(-np.ones(2))
        for pair, some, whole in (
            (early, mine, 0),
            (early, theirs, 0),
            (late, mine, len(mine)),
            (late, theirs, len(theirs)),
        ):
            sign = 1.0 if whole else -1.0
            model.rows(-math.inf, float(whole), (0, np.array([pair]), 1.0), (0, some, sign))
    answer = solve(model.program(), clock.left)
    if answer.status == "infeasible" or not math.isfinite(answer.bound):
        return _most(kind, going, coming)
    return math.floor(-answer.bound + 1e-6)
