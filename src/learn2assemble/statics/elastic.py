r"""Bed forces of many blocks at once, shared out as elastic beds share them.

Of all forces :math:`N \ge 0` that balance blocks, :math:`A N = b`, those nearest to given ones,

.. math:: \min_{N \ge 0} \sum_p \frac{(N_p - M_p)^2}{2 s_p} \quad \text{s.t.} \quad A N = b ,

with :math:`s_p` the area that belongs to a point, are :math:`N = \max(0, M + s A^T \lambda)`, where
the motion :math:`\lambda` of the blocks minimises

.. math:: \sum_p \frac{\max(0, M_p + s_p (A^T \lambda)_p)^2}{2 s_p} - b^T \lambda ,

a convex function that is quadratic as long as no force changes between zero and more. Newton's
method needs one sparse factorisation a step. Where no forces exist, :math:`\lambda` grows towards a
motion that nothing holds back: all forces together are at most :math:`F`, so that
:math:`b^T \lambda > F \max_p (A^T \lambda)_p` is a proof that there are none.

A linear program needs much longer, and its forces stand in few corners of few beds. Those found
here are spread, so that the next load is mostly balanced by :func:`.step_proof.Proof.settle` alone.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from learn2assemble.kernels import kernel
from learn2assemble.linear_programs import LinearProgram

STEPS = 30
"""Of Newton's method; where forces exist, mostly fewer than ten."""
ROUNDING = 1e-10
"""Largest imbalance, in units of the largest load."""
LEAK, LEAST_LEAK, MOST_LEAK = 1e-3, 1e-9, 1e-1
"""How much a point without force still resists, as a share of one with force: at first, at least
and at most. Without it, a block that lifts off would move without bounds."""
HALVINGS = 8


def balance(
    program: LinearProgram, share: np.ndarray, near: np.ndarray
) -> np.ndarray | bool | None:
    """The forces float64[n] >= 0 nearest to ``near`` that meet the equations of ``program``.

    Args:
        program: of :meth:`.step_proof.Proof.program`: three equations for every block, the forces
            along z first, in which every force counts once.
        share: float64[n], positive: how readily each force changes.
        near: float64[n].

    Returns:
        forces; False where it is proven that there are none; None where neither was found.
    """
    n, m = len(program.cost), len(program.row_lower)
    load = program.row_lower
    if n == 0:
        return None
    arms = program.start, program.index, program.value
    rows = _by_row(*arms, m)
    pattern = _pattern(*arms[:2], *rows[:2], m)
    share = share / share.mean()
    # No block bears more than everything weighs.
    most = m / 3 * float(load[::3].sum())
    motion, pull, force = np.zeros(m), np.zeros(n), np.maximum(near, 0.0)
    left = load - _times(*arms, force, m)
    value, leak = 0.5 * float((force**2 / share).sum()), LEAK
    for _ in range(STEPS):
        worst = float(np.abs(left).max())
        if worst <= ROUNDING * float(np.abs(load).max()):
            return force
        soft = np.where(near + share * pull >= 0, share, leak * share)
        start, index, entries = _stiffness(*arms, *rows, *pattern, soft)
        change = splu(
            sp.csc_array((entries, index, start), (m, m)),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        ).solve(left)
        slope, along, step = float(left @ change), _turned(*arms, change), 1.0
        if not np.isfinite(slope) or slope <= 0:
            return None
        for _ in range(HALVINGS):
            there = np.maximum(near + share * (pull + step * along), 0.0)
            after = 0.5 * float((there**2 / share).sum()) - float(load @ (motion + step * change))
            other = load - _times(*arms, there, m)
            # Close to the end the value is too coarse to tell.
            if after <= value - 1e-4 * step * slope or np.abs(other).max() <= 0.5 * worst:
                break
            step /= 2
        else:
            if leak >= MOST_LEAK:
                return None
            leak = min(100 * leak, MOST_LEAK)
            continue
        leak = max(0.1 * leak, LEAST_LEAK) if step == 1 else min(3 * leak, MOST_LEAK)
        motion, pull = motion + step * change, pull + step * along
        force, value, left = there, after, other
        if float(load @ motion) > most * max(float(pull.max()), 0.0):
            return False
    return None


# ---------------------------------------------------------------- compiled
# Matrices of a few blocks are made many times a second: their products take less time than the
# making of sparse arrays. Sums run in the order in which products of sparse arrays add up.


@kernel
def _by_row(
    start: np.ndarray, index: np.ndarray, value: np.ndarray, m: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns and values of the entries of every row, from left to right: those of row i at
    ``start[i]:start[i + 1]``, which comes first."""
    first = np.zeros(m + 1, np.int64)
    for i in index:
        first[i + 1] += 1
    for i in range(m):
        first[i + 1] += first[i]
    column, entry, filled = np.empty(len(index), np.int64), np.empty(len(index)), first.copy()
    for k in range(len(start) - 1):
        for j in range(start[k], start[k + 1]):
            at = filled[index[j]]
            column[at], entry[at] = k, value[j]
            filled[index[j]] += 1
    return first, column, entry


@kernel
def _pattern(
    start: np.ndarray, index: np.ndarray, first: np.ndarray, column: np.ndarray, m: int
) -> tuple[np.ndarray, np.ndarray]:
    """Which entries of ``A A^T`` are not 0 whatever the values are, and its diagonal: rows of
    column i, ascending, at ``start[i]:start[i + 1]``, which comes first."""
    size = m
    for i in range(m):
        for j in range(first[i], first[i + 1]):
            size += start[column[j] + 1] - start[column[j]]
    begin, row, count = np.zeros(m + 1, np.int64), np.empty(size, np.int64), 0
    seen = np.full(m, -1)
    for i in range(m):
        row[count], seen[i] = i, i
        count += 1
        for j in range(first[i], first[i + 1]):
            for e in range(start[column[j]], start[column[j] + 1]):
                if seen[index[e]] != i:
                    row[count], seen[index[e]] = index[e], i
                    count += 1
        row[begin[i] : count].sort()
        begin[i + 1] = count
    return begin, row[:count]


@kernel
def _stiffness(
    start: np.ndarray,
    index: np.ndarray,
    value: np.ndarray,
    first: np.ndarray,
    column: np.ndarray,
    entry: np.ndarray,
    begin: np.ndarray,
    row: np.ndarray,
    soft: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``A diag(soft) A^T`` by columns (int32[m + 1], int32[e], float64[e]), with a little more on
    the diagonal, so that it can be factorised; entries that cancel are left out.

    Args:
        start, index, value: columns of A.
        first, column, entry: its rows, see :func:`_by_row`.
        begin, row: see :func:`_pattern`.
    """
    m = len(begin) - 1
    total, out, largest = np.zeros(m), np.empty(len(row)), 0.0
    for i in range(m):
        for j in range(first[i], first[i + 1]):
            k = column[j]
            for e in range(start[k], start[k + 1]):
                total[index[e]] += entry[j] * (soft[k] * value[e])
        largest = total[i] if i == 0 else max(largest, total[i])
        for j in range(begin[i], begin[i + 1]):
            out[j], total[row[j]] = total[row[j]], 0.0
    damp = 1e-11 * largest + 1e-14
    starts, rows, count = np.zeros(m + 1, np.int32), np.empty(len(row), np.int32), 0
    for i in range(m):
        for j in range(begin[i], begin[i + 1]):
            much = out[j] + damp if row[j] == i else out[j]
            if much != 0.0:
                rows[count], out[count] = row[j], much
                count += 1
        starts[i + 1] = count
    return starts, rows[:count], out[:count]


@kernel
def _times(
    start: np.ndarray, index: np.ndarray, value: np.ndarray, x: np.ndarray, m: int
) -> np.ndarray:
    """``A x``, float64[m]."""
    out = np.zeros(m)
    for k in range(len(x)):
        for j in range(start[k], start[k + 1]):
            out[index[j]] += value[j] * x[k]
    return out


@kernel
def _turned(start: np.ndarray, index: np.ndarray, value: np.ndarray, y: np.ndarray) -> np.ndarray:
    """``A^T y``, float64[n]."""
    out = np.zeros(len(start) - 1)
    for k in range(len(out)):
        for j in range(start[k], start[k + 1]):
            out[k] += value[j] * y[index[j]]
    return out
