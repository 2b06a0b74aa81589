"""Linear and integer programs for HiGHS, which trusts its input: every matrix is checked first.

.. math:: \\min c^T x \\quad \\text{s.t.} \\quad r_l \\le A x \\le r_u, \\quad x_l \\le x \\le x_u
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import highspy
import numpy as np

from learn2assemble.compiling import TOLD, compiling_seconds
from learn2assemble.errors import Learn2AssembleError
from learn2assemble.progress import EVERY, Detail, Progress, silent

INF = math.inf


@dataclass(frozen=True)
class LinearProgram:
    """Columns of a sparse program. Every array is checked when it is built."""

    cost: np.ndarray
    """float64[n], finite."""
    lower: np.ndarray
    upper: np.ndarray
    """float64[n]: bounds of the columns."""
    row_lower: np.ndarray
    row_upper: np.ndarray
    """float64[m]: bounds of the rows."""
    start: np.ndarray
    """int[n + 1]: column k has the entries ``start[k]:start[k + 1]``."""
    index: np.ndarray
    """int[e]: rows of the entries, each at most once a column."""
    value: np.ndarray
    """float64[e], finite."""
    integer: bool | np.ndarray = False
    """Which columns are integers: all, none, or bool[n]."""

    def __post_init__(self) -> None:
        n, m, e = len(self.cost), len(self.row_lower), len(self.index)
        start, index = np.asarray(self.start), np.asarray(self.index)
        sound = (
            len(self.lower) == len(self.upper) == n
            and len(self.row_upper) == m
            and len(self.value) == e
            and len(start) == n + 1
            and start[0] == 0
            and start[-1] == e
            and bool((np.diff(start) >= 0).all())
            and (e == 0 or (index.min() >= 0 and index.max() < m))
            and bool(np.isfinite(self.cost).all() and np.isfinite(self.value).all())
            and np.shape(self.integer) in ((), (n,))
            and bool((self.lower <= self.upper).all() and (self.row_lower <= self.row_upper).all())
        )
        if sound and e:
            key = np.repeat(np.arange(n), np.diff(start)) * np.int64(m) + index
            sound = len(np.unique(key)) == e
        if not sound:
            raise Learn2AssembleError("program: malformed matrix, bounds or costs")


@dataclass(frozen=True)
class Answer:
    """What a solver found."""

    status: str
    """``"optimal"``, ``"infeasible"`` or ``"time"`` (then ``x`` is the best found, if any)."""
    x: np.ndarray | None
    """float64[n]."""
    objective: float
    bound: float
    """No solution is better than this."""


Entry = tuple[np.ndarray | int, np.ndarray, np.ndarray | float]
"""Rows, columns and values of one shape."""


class Model:
    """A program in the making: columns, and rows with their entries."""

    def __init__(self) -> None:
        self._columns: list[np.ndarray] = []
        self._rows: list[np.ndarray] = []
        self._entries: list[tuple[np.ndarray, ...]] = []
        self._count = self._height = 0

    def columns(
        self,
        cost: np.ndarray,
        upper: np.ndarray | float = INF,
        *,
        lower: np.ndarray | float = 0.0,
        integer: bool = False,
    ) -> np.ndarray:
        """Add columns; int64[n], their numbers."""
        self._columns.append(np.stack(np.broadcast_arrays(cost, lower, upper, integer)))
        self._count += len(cost)
        return np.arange(self._count - len(cost), self._count)

    def rows(self, lower: np.ndarray | float, upper: np.ndarray | float, *entries: Entry) -> None:
        """Add rows; one where both bounds are numbers.

        Args:
            entries: their first row is 0; values of 0 are left out.
        """
        for entry in entries:
            parts = [np.asarray(part) for part in entry]
            shape = np.broadcast(*parts).shape
            row, column, value = (
                (part if part.shape == shape else np.broadcast_to(part, shape)).reshape(-1)
                for part in parts
            )
            live = value != 0
            self._entries.append((self._height + row[live], column[live], value[live]))
        self._rows.append(np.stack(np.broadcast_arrays(np.atleast_1d(lower), upper)))
        self._height += self._rows[-1].shape[1]

    def program(self) -> LinearProgram:
        """What was added, as a program."""
        cost, lower, upper, integer = np.concatenate(self._columns, 1)
        row_lower, row_upper = np.concatenate(self._rows, 1)
        row, column, value = map(np.concatenate, zip(*self._entries, strict=True))
        order = np.lexsort((row, column))
        start = np.searchsorted(column[order], np.arange(len(cost) + 1))
        return LinearProgram(
            cost,
            lower,
            upper,
            row_lower,
            row_upper,
            start,
            row[order],
            value[order],
            integer.astype(bool),
        )


def solve(
    program: LinearProgram, seconds: float = INF, *, method: str = "choose", gap: float = 0.0
) -> Answer:
    """The optimum of ``program``, on one thread and the same every time.

    Args:
        seconds: wall-clock limit.
        gap: relative gap to the optimum at which an integer program stops.
        method: of HiGHS for linear programs: ``"choose"``, ``"simplex"`` or ``"ipm"``.

    Raises:
        Learn2AssembleError: where the solver fails.
    """
    n = len(program.cost)
    mixed = bool(np.any(program.integer))
    if n == 0:
        fits = bool(((program.row_lower <= 0) & (program.row_upper >= 0)).all())
        return Answer("optimal" if fits else "infeasible", np.empty(0) if fits else None, 0.0, 0.0)
    if seconds <= 0:
        return Answer("time", None, INF, -INF)
    solver = _pose(program, method)
    solver.setOptionValue("mip_rel_gap", float(gap))
    answer = _run(solver, seconds, mixed)
    if answer is None and method != "ipm" and not mixed:
        # On the border of feasibility the simplex method may give up.
        return solve(program, seconds, method="ipm")
    if answer is None:
        raise Learn2AssembleError(f"program: the solver stopped with {solver.getModelStatus()}")
    return answer


class Repeated:
    """A linear program that is asked again and again with other costs and upper bounds.

    Each answer begins where the last one ended.
    """

    def __init__(self, program: LinearProgram) -> None:
        self.program = program
        self._solver = _pose(program, "choose")
        self._columns = np.arange(len(program.cost), dtype=np.int32)

    def solve(self, cost: np.ndarray, upper: np.ndarray, seconds: float = INF) -> Answer:
        """The optimum for ``cost`` and ``upper`` (float64[n], the first finite).

        Args:
            seconds: wall-clock limit.
        """
        if seconds <= 0:
            return Answer("time", None, INF, -INF)
        program = replace(self.program, cost=cost, upper=upper)
        columns = self._columns
        self._solver.changeColsCost(len(columns), columns, program.cost)
        self._solver.changeColsBounds(len(columns), columns, program.lower, program.upper)
        return _run(self._solver, seconds, False) or solve(program, seconds)


def pass_columns(
    solver: highspy.Highs,
    cost: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    rows: tuple[np.ndarray, np.ndarray],
    matrix: tuple[np.ndarray, np.ndarray, np.ndarray],
    integer: bool | np.ndarray = False,
    sense: highspy.ObjSense = highspy.ObjSense.kMinimize,
) -> highspy.HighsStatus:
    """Hand a solver a program as arrays, which nothing checks; what it says of it.

    Args:
        bounds: of the columns, lower and upper.
        rows: their bounds, lower and upper.
        matrix: start, index and value of :class:`LinearProgram`.
        integer: which columns are integers.
    """
    n, m, e, form = len(cost), len(rows[0]), len(matrix[2]), int(highspy.MatrixFormat.kColwise)
    start, index = (np.ascontiguousarray(part, np.int32) for part in matrix[:2])
    reals = (cost, *bounds, *rows, matrix[2])
    cost, low, high, least, most, value = (np.ascontiguousarray(part, float) for part in reals)
    kinds = np.broadcast_to(integer, n).astype(np.int32)
    # Arrays, not a HighsLp: its fields are lists, which take a millisecond to fill.
    return solver.passModel(
        n, m, e, form, int(sense), 0.0, cost, low, high, least, most, start, index, value, kinds
    )


def _pose(program: LinearProgram, method: str) -> highspy.Highs:
    """A solver that has the program, on one thread and with the same answer every time."""
    solver = highspy.Highs()
    solver.setOptionValue("output_flag", False)
    solver.setOptionValue("threads", 1)
    solver.setOptionValue("random_seed", 0)
    solver.setOptionValue("mip_abs_gap", 1e-6)
    solver.setOptionValue("solver", method)
    status = pass_columns(
        solver,
        program.cost,
        (program.lower, program.upper),
        (program.row_lower, program.row_upper),
        (program.start, program.index, program.value),
        program.integer,
    )
    if status == highspy.HighsStatus.kError:
        raise Learn2AssembleError("program: the solver refused the matrix")
    return solver


def _run(solver: highspy.Highs, seconds: float, mixed: bool) -> Answer | None:
    """What a solver finds; None where it gives up."""
    if math.isfinite(seconds):  # Its clock goes on from one run to the next.
        solver.setOptionValue("time_limit", solver.getRunTime() + float(seconds))
    solver.run()
    found, info = solver.getModelStatus(), solver.getInfo()
    known = highspy.HighsModelStatus
    if found == known.kInfeasible:
        return Answer("infeasible", None, INF, INF)
    feasible = info.primal_solution_status == int(highspy.SolutionStatus.kSolutionStatusFeasible)
    x = np.array(solver.getSolution().col_value) if feasible else None
    objective = float(info.objective_function_value) if feasible else INF
    if found == known.kOptimal:
        return Answer("optimal", x, objective, objective)
    if found in (known.kTimeLimit, known.kIterationLimit, known.kSolutionLimit):
        bound = float(info.mip_dual_bound) if mixed else -INF
        return Answer("time", x, objective, bound)
    return None


class Clock:
    """How much of a limit of seconds is left. Time in which kernels are compiled does not count.

    Args:
        timer: that tells the seconds: of a clock, or of the processor.
        progress: told how far a phase has come.
    """

    def __init__(
        self,
        seconds: float,
        timer: Callable[[], float] = time.monotonic,
        progress: Progress = silent,
    ) -> None:
        self.limit: float = float(seconds)
        self.timer = timer
        self.progress = progress
        self._start = self._told = timer()
        self._compiling = compiling_seconds(timer)
        self._told_compiling = 0.0

    def tell(self, what: str) -> None:
        """Say how far a phase has come and what time is left, but not too often."""
        now = self.timer()
        if now - self._told >= EVERY:
            self._told = now
            compiled = self._compiled
            if compiled > self._told_compiling + TOLD:
                self._told_compiling = compiled
                what = (
                    f"{what} (compiled {compiled:.0f} s once for this machine; no limit counts it)"
                )
            self.progress(Detail(what, self.left))

    @property
    def spent(self) -> float:
        """Seconds since the start."""
        return self.timer() - self._start - self._compiled

    @property
    def _compiled(self) -> float:
        """Seconds of compiling since the start."""
        return compiling_seconds(self.timer) - self._compiling

    @property
    def left(self) -> float:
        """Seconds left, not below 0."""
        return max(0.0, self.limit - self.spent)
