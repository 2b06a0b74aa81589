"""The numbers of a table, read from result files, beside the published ones.

The published numbers are in ``published.csv``, typed once from the paper.
"""

from __future__ import annotations

import csv
import functools
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from l2a_lab.bounds import has_bound
from l2a_lab.cell_jobs import row_cells
from l2a_lab.cells import BOUND, Cell, CellResult, measured_agents, read_result
from l2a_lab.table import Column, Condition, Row, Table

FILE = Path(__file__).with_name("published.csv")


EPISODES = 500
"""Episodes behind a published number: five agents, 100 each."""


@dataclass(frozen=True)
class Published:
    """One published cell; ``None`` where the paper gives no number."""

    R: float | None
    R_ci95: float | None
    a: float | None
    b: float | None
    f: float | None


@functools.cache
def _lines() -> tuple[dict[str, str], ...]:
    with FILE.open(encoding="utf-8") as stream:
        return tuple(csv.DictReader(stream))


def published(table: Table, row: Row, column: Column) -> Published | None:
    """The published cell of a row and a column; ``None`` where there is none.

    Raises:
        LookupError: where the fields of table, row and column pick more than one line.
    """
    if not (table.paper and row.paper and column.paper):
        return None
    wanted = {**table.paper, **row.paper, **column.paper}
    found = [line for line in _lines() if all(line[key] == v for key, v in wanted.items())]
    if len(found) > 1:
        raise LookupError(f"table {table.name}: {len(found)} published lines fit {wanted}")
    if not found:
        return None
    names = ("R", "R_ci95", "a_mean", "b", "f")
    return Published(*[float(found[0][name]) if found[0][name] else None for name in names])


NOT_AVAILABLE, NOT_TRAINED, NOT_MEASURED = "not available", "not trained", "not measured"


@dataclass(frozen=True)
class Summary:
    """Means over agents (each a mean over its episodes) of one row, column and condition."""

    R: float
    R_ci95: float
    """Half width of the 95 % interval: Student's over agents, of one agent normal over problems.

    Agents that played different problems are compared by how far they stay below the upper bounds
    of these, where there are any: so the luck of the draw counts once, among the problems."""
    R_ci95_problems: float
    """The same over problems, of the mean of the agents on each."""
    a: float
    b: float
    f: float
    success: float
    agents: int
    episodes: int
    """Of all agents together."""
    problems: int
    """Different ones that were played."""
    R_other: float | None
    """R at the table's other discount."""
    share: float | None
    """Mean return over the mean upper bound of the same problems; at epsilon 0 only."""
    difference: tuple[float, float] | None = None
    """R less that of the table's reference, problem by problem, and half its 95 % interval."""

    @property
    def over_agents(self) -> bool:
        return self.agents >= 2


@dataclass(frozen=True)
class TableEntry:
    """One row in one column."""

    row: Row
    column: Column
    paper: Published | None
    state: str
    """Empty where there are results, else the reason why not."""
    results: dict[Condition, Summary]

    @property
    def title(self) -> str:
        """The task, with a star where the agents were trained on it."""
        return f"{self.column.name}{'*' if self.column.star else ''}"


@dataclass(frozen=True)
class TableData:
    """A table with its numbers: ``entries[row][column]``."""

    table: Table
    entries: tuple[tuple[TableEntry, ...], ...]
    problems: tuple[int, int]
    """Fewest and most problems of a cell; (0, 0) without results."""
    quick: bool
    left_out: tuple[str, ...]
    """CellResult files of the table that are absent."""


def load_table(table: Table, root: Path, quick: bool = False) -> TableData:
    """Read the numbers of ``table`` from the result files below ``root`` and nothing else."""
    missing: set[str] = set()
    found = [
        [_results(table, row, number, root, missing) for number in range(len(table.columns))]
        for row in table.rows
    ]
    reference = found[table.reference] if table.reference is not None else None
    entries = tuple(
        tuple(
            _entry(table, row, number, root, results, reference[number] if reference else None)
            for number, results in enumerate(line)
        )
        for row, line in zip(table.rows, found, strict=True)
    )
    played = [
        summary.problems for line in entries for entry in line for summary in entry.results.values()
    ]
    span = (min(played), max(played)) if played else (0, 0)
    return TableData(table, entries, span, quick, tuple(sorted(missing)))


Results = dict[Condition, list[CellResult]]
"""Of one row in one column; of all its agents."""


def _results(table: Table, row: Row, number: int, root: Path, missing: set[str]) -> Results | None:
    """What has been measured; ``None`` where nothing can be. Adds absent files to ``missing``."""
    agents = row.pick(measured_agents(root, table.columns[number].name)) if row.agents else []
    cells = row_cells(table, row, number, agents)
    found: Results = {}
    for cell in cells:
        result = read_result(root / cell.path)
        if result is None:
            missing.add(cell.path)
        elif result.cell == cell:
            found.setdefault(Condition(cell.epsilon, cell.physics), []).append(result)
    return {key: _shares(results) for key, results in found.items()} if cells else None


def _shares(results: list[CellResult]) -> list[CellResult]:
    """Of agents that share the problems as much as each has played: the first share may be the
    beginning of more; shares of another size are left out."""
    size = min(result.episodes for result in results)
    return [
        result if result.episodes == size else result.head(size)
        for result in results
        if result.episodes == size or not result.cell.share
    ]


def _entry(
    table: Table,
    row: Row,
    number: int,
    root: Path,
    results: Results | None,
    reference: Results | None,
) -> TableEntry:
    column, state = table.columns[number], ""
    if results is None:
        state = NOT_TRAINED if row.agents else NOT_AVAILABLE
    elif not results:
        state = NOT_MEASURED
    summaries: dict[Condition, Summary] = {}
    for condition in table.conditions:
        good, base = (results or {}).get(condition), (reference or {}).get(condition)
        if good:
            other = None if results is reference else base
            summaries[condition] = _summary(table, condition, good, other, root)
    return TableEntry(row, column, published(table, row, column), state, summaries)


def _summary(
    table: Table,
    condition: Condition,
    results: list[CellResult],
    base: list[CellResult] | None,
    root: Path,
) -> Summary:
    def mean(name: str) -> float:
        return float(np.mean([result.array(name).mean() for result in results]))

    returns = [result.array("returns") for result in results]
    means = np.array([r.mean() for r in returns])
    bounds = _bounds(results, root)
    ran_out = [((1 - r.array("failed")) * (1 - r.array("success"))).mean() for r in results]
    problems, other = _by_problem(results), f"returns_at_{table.other_discount or 0:g}"
    return Summary(
        R=float(means.mean()),
        R_ci95=_half_width(returns, means if bounds is None else means - bounds),
        R_ci95_problems=_half_width([problems[np.isfinite(problems)]], means[:1]),
        a=mean("actions"),
        b=float(np.mean(ran_out)),
        f=mean("failed"),
        success=mean("success"),
        agents=len(results),
        episodes=sum(r.episodes for r in results),
        problems=int(np.isfinite(problems).sum()),
        R_other=mean(other) if all(other in r.data for r in results) else None,
        share=None
        if bounds is None or condition != Condition(0.0)
        else float(means.sum() / bounds.sum()),
        difference=None if base is None else paired(problems, _by_problem(base)),
    )


def _by_problem(results: list[CellResult]) -> np.ndarray:
    """float64[E]: mean return on each problem of the agents that have played it; NaN of none."""
    total, count = np.zeros((2, max(result.first + result.episodes for result in results)))
    for result in results:
        played = slice(result.first, result.first + result.episodes)
        total[played] += result.array("returns")
        count[played] += 1
    return np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0)


def paired(returns: np.ndarray, others: np.ndarray) -> tuple[float, float]:
    """Mean difference on the same problems, and half the width of its 95 % interval.

    Args:
        returns, others: float64[E] by problem; those count that both have, and neither as NaN.
    """
    count = min(len(returns), len(others))
    apart = returns[:count] - others[:count]
    apart = apart[np.isfinite(apart)]
    return float(apart.mean()), _half_width([apart], apart[:1])


def _half_width(returns: list[np.ndarray], means: np.ndarray) -> float:
    """Half width of the 95 % interval of R."""
    sample, factor = (means, student(len(means))) if len(means) >= 2 else (returns[0], 1.96)
    count = len(sample)
    return factor * float(sample.std(ddof=1)) / math.sqrt(count) if count > 1 else 0.0


def student(count: int) -> float:
    """97.5 % point of Student's t for the mean of ``count`` values, as tables print it."""
    from scipy.special import stdtrit  # pyright: ignore[reportMissingTypeStubs]

    return round(float(stdtrit(count - 1, 0.975)), 3)


def _bounds(results: list[CellResult], root: Path) -> np.ndarray | None:
    """float64[A]: mean upper bound of the very problems that each agent played."""
    means: list[float] = []
    for result in results:
        cell = Cell(result.cell.task, BOUND, seed=result.cell.seed)
        bound = read_result(root / cell.path) if has_bound(cell.task) else None
        end = result.first + result.episodes
        if bound is None or bound.cell != cell or bound.episodes < end:
            return None
        means.append(bound.array("returns")[result.first : end].mean())
    return np.array(means)
