"""The solvers of the program of :mod:`.program`: one that is kept warm, and one of cones."""

from __future__ import annotations

from typing import Any

import clarabel  # pyright: ignore[reportMissingTypeStubs]
import highspy
import numpy as np
import scipy.sparse as sp

from learn2assemble.linear_programs import INF, Clock

_conic: Any = clarabel
"""A compiled module without types."""
STATUS = highspy.HighsModelStatus
OPTIONS = (
    ("output_flag", False),
    ("threads", 1),
    ("random_seed", 0),
    # Both cost a third of the time here, and change no answer.
    ("simplex_scale_strategy", 0),
    ("dual_simplex_cost_perturbation_multiplier", 0.0),
    ("simplex_dual_edge_weight_strategy", 0),
    ("simplex_iteration_limit", 20_000),
)
CAREFUL = (
    ("simplex_scale_strategy", 2),
    ("dual_simplex_cost_perturbation_multiplier", 1.0),
    ("simplex_dual_edge_weight_strategy", -1),
    ("simplex_iteration_limit", 2**31 - 1),
)
DECIDED = (STATUS.kOptimal, STATUS.kInfeasible, STATUS.kUnboundedOrInfeasible)
_FEW = 30
"""Blocks up to which making a program smaller first costs more than it saves."""


def new_solver(blocks: int) -> Any:
    """A solver for the program of so many blocks."""
    solver: Any = highspy.Highs()
    for option, value in OPTIONS:
        solver.setOptionValue(option, value)
    if blocks <= _FEW:
        solver.setOptionValue("presolve", "off")
    return solver


def run_within(solver: Any, clock: Clock | None) -> Any:
    """The status of a program that was run in what is left of a clock, or at leisure."""
    if clock is None:
        solver.setOptionValue("time_limit", INF)
    elif clock.left <= 0:
        return STATUS.kTimeLimit
    else:  # Its own clock goes on from one run to the next.
        solver.setOptionValue("time_limit", solver.getRunTime() + clock.left)
    solver.run()
    return solver.getModelStatus()


def _settings() -> Any:
    """Of the solver of cones."""
    settings = _conic.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.direct_solve_method = "qdldl"
    return settings


def by_cones(
    balance: Any, load: np.ndarray, lower: np.ndarray, upper: np.ndarray, seconds: float = INF
) -> np.ndarray | None:
    """The columns float64[n] within bounds, the last one the least, that balance a load, by
    interior points, which many blocks cost less; None where it is stuck, or takes longer.

    Args:
        balance: [rows, n].
    """
    count = len(lower)
    signs, bound, cones = [balance], [load], [_conic.ZeroConeT(len(load))]
    for limit, sign in ((lower, -1.0), (upper, 1.0)):
        some = np.flatnonzero(np.isfinite(limit))
        signs.append(sign * sp.csr_matrix(sp.identity(count))[some])
        bound.append(sign * limit[some])
        cones.append(_conic.NonnegativeConeT(len(some)))
    cost = np.zeros(count)
    cost[-1] = 1.0
    energy = sp.csc_matrix((count, count))
    matrix = sp.csc_matrix(sp.vstack(signs))
    settings = _settings()
    settings.time_limit = seconds
    answer = _conic.DefaultSolver(
        energy, cost, matrix, np.concatenate(bound), cones, settings
    ).solve()
    if answer.status != _conic.SolverStatus.Solved:
        return None
    return np.array(answer.x)


def nearest(
    balance: Any, load: np.ndarray, lower: np.ndarray, stiff: np.ndarray
) -> np.ndarray | None:
    """The columns float64[n] above their bounds that balance a load with the least elastic energy;
    None where none do, or it is stuck.

    Args:
        balance: [rows, n].
        stiff: float64[n], of the columns.
    """
    unit = float(np.median(stiff))
    some = np.flatnonzero(np.isfinite(lower))
    keep = sp.csr_matrix(sp.diags(-np.ones(len(lower))))[some]
    matrix = sp.csc_matrix(sp.vstack([balance, keep]))
    bound = np.concatenate([load, -lower[some]]) / unit
    cones = [_conic.ZeroConeT(len(load)), _conic.NonnegativeConeT(len(some))]
    energy = sp.csc_matrix(sp.diags(unit / stiff))
    answer = _conic.DefaultSolver(
        energy, np.zeros(len(lower)), matrix, bound, cones, _settings()
    ).solve()
    if answer.status != _conic.SolverStatus.Solved:
        return None
    return unit * np.array(answer.x)
