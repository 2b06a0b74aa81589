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

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from learn2assemble.linear_programs import LinearProgram

STEPS = 30
"""Of Newton's method; where forces exist, mostly fewer than ten."""
ROUNDING = 1e-10
"""Largest imbalance, in units of the largest load."""
LEAK, LEAST_LEAK, MOST_LEAK = 1e-3, 1e-9, 1e-1
"""How much a point without force still resists, as a share of one with force: at first, at least
and at most. Without it, a block that lifts off would move without bounds."""
HALVINGS = 8
DENSE = 120
"""Equations of up to forty blocks are solved as a full matrix, far faster than as a sparse one."""


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
    arms: Any = sp.csc_array((program.value, program.index, program.start), (m, n))
    if m <= DENSE:
        arms = arms.toarray()
    solve = _dense(arms) if m <= DENSE else _sparse(arms)
    turned = arms.T
    share = share / share.mean()
    # No block bears more than everything weighs.
    most = m / 3 * float(load[::3].sum())
    motion, pull, force = np.zeros(m), np.zeros(n), np.maximum(near, 0.0)
    left = load - arms @ force
    value, leak = 0.5 * float((force**2 / share).sum()), LEAK
    for _ in range(STEPS):
        worst = float(np.abs(left).max())
        if worst <= ROUNDING * float(np.abs(load).max()):
            return force
        soft = np.where(near + share * pull >= 0, share, leak * share)
        change = solve(soft, left)
        slope, along, step = float(left @ change), turned @ change, 1.0
        if not np.isfinite(slope) or slope <= 0:
            return None
        for _ in range(HALVINGS):
            there = np.maximum(near + share * (pull + step * along), 0.0)
            after = 0.5 * float((there**2 / share).sum()) - float(load @ (motion + step * change))
            other = load - arms @ there
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


Solver = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""The motion float64[m] that stiffnesses float64[n] of points answer loads float64[m] with."""


def _dense(arms: np.ndarray) -> Solver:
    def solve(soft: np.ndarray, load: np.ndarray) -> np.ndarray:
        matrix = (arms * soft) @ arms.T
        matrix[np.diag_indices(len(matrix))] += _damping(matrix)
        try:
            return np.linalg.solve(matrix, load)
        except np.linalg.LinAlgError:
            return np.full(len(load), np.nan)

    return solve


def _sparse(arms: Any) -> Solver:
    turned, unit = arms.T.tocsr(), sp.eye_array(arms.shape[0])

    def solve(soft: np.ndarray, load: np.ndarray) -> np.ndarray:
        matrix = arms @ sp.diags_array(soft) @ turned
        return splu(
            (matrix + _damping(matrix) * unit).tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        ).solve(load)

    return solve


def _damping(matrix: Any) -> float:
    """What keeps a block that no force holds from moving without bounds."""
    return 1e-11 * float(matrix.diagonal().max()) + 1e-14
