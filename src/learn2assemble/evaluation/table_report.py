"""From result files to the numbers of a table."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from learn2assemble.evaluation.cells import BOUND, Cell, measurable
from learn2assemble.evaluation.published import EPISODES, Published, published
from learn2assemble.evaluation.results_store import Result, measured_agents, read_result
from learn2assemble.evaluation.table_run import row_cells
from learn2assemble.evaluation.table_spec import AGENT, PAPER_PROTOCOL, Condition, Row, Table

STUDENT = {2: 12.706, 3: 4.303, 4: 3.182, 5: 2.776, 6: 2.571, 7: 2.447, 8: 2.365, 9: 2.306}
"""97.5 % point of Student's t for a mean over so many agents."""
NOT_AVAILABLE, NOT_TRAINED, NOT_MEASURED = "not available", "not trained", "not measured"


@dataclass(frozen=True)
class Summary:
    """Means over agents (each a mean over its episodes) of one row, column and condition."""

    R: float
    R_ci95: float
    """Half width of the 95 % interval: Student's over agents, else normal over episodes."""
    a: float
    b: float
    f: float
    success: float
    agents: int
    episodes: int
    """Of all agents together."""
    R_other: float | None
    """R at the table's other discount."""
    share: float | None
    """Mean return over the mean upper bound of the same problems; at epsilon 0 only."""

    @property
    def over_agents(self) -> bool:
        return self.agents >= 2


@dataclass(frozen=True)
class Entry:
    """One row in one column."""

    paper: Published | None
    state: str
    """Empty where there are results, else the reason why not."""
    results: dict[Condition, Summary]


@dataclass(frozen=True)
class TableData:
    """A table with its numbers: ``entries[row][column]``."""

    table: Table
    entries: tuple[tuple[Entry, ...], ...]
    episodes: tuple[int, int]
    """Fewest and most episodes an agent played; (0, 0) without results."""
    quick: bool
    left_out: tuple[str, ...]
    """Result files of the table that are absent."""


def load_table(table: Table, root: Path, quick: bool = False) -> TableData:
    """Read the numbers of ``table`` from the result files below ``root`` and nothing else."""
    played: list[int] = []
    missing: list[str] = []
    entries = []
    for row in table.rows:
        line = []
        for number, column in enumerate(table.columns):
            agents = row.pick(measured_agents(root, column.name)) if row.agents else []
            cells = row_cells(table, row, number, agents)
            results = {}
            for condition in table.conditions:
                wanted = [
                    cell for cell in cells
                    if (cell.epsilon, cell.physics) == (condition.epsilon, condition.physics)
                ]  # fmt: skip
                found = [(cell, read_result(root / cell.path)) for cell in wanted]
                missing += [cell.path for cell, result in found if result is None]
                good = [r for cell, r in found if r is not None and r.cell == cell]
                if good:
                    results[condition] = _summary(table, condition, good, root)
                    played += [r.episodes for r in good]
            paper = published(table, row, column)
            line.append(Entry(paper, _state(table, row, number, cells, results), results))
        entries.append(tuple(line))
    span = (min(played), max(played)) if played else (0, 0)
    return TableData(table, tuple(entries), span, quick, tuple(sorted(set(missing))))


def _state(
    table: Table, row: Row, number: int, cells: list[Cell], results: dict[Condition, Summary]
) -> str:
    """Why there is nothing to show; empty where there is."""
    if results:
        return ""
    if table.columns[number].preset is None:
        return NOT_AVAILABLE
    if not row.known or (row.columns is not None and number not in row.columns):
        return NOT_AVAILABLE
    if not cells:
        return NOT_TRAINED if row.policy == AGENT else NOT_AVAILABLE
    return NOT_MEASURED


def _summary(table: Table, condition: Condition, results: list[Result], root: Path) -> Summary:
    returns = [result.array("returns") for result in results]
    means = np.array([r.mean() for r in returns])
    failed = [result.array("failed") for result in results]
    success = [result.array("success") for result in results]
    other = None
    if table.other_discount is not None:
        key = f"returns_at_{table.other_discount:g}"
        other = _mean([r.array(key) for r in results if key in r.data])
    share = None
    if condition == Condition(0.0):
        share = _share(results, root)
    return Summary(
        R=float(means.mean()), R_ci95=_interval(returns, means),
        a=_mean([r.array("actions") for r in results]) or 0.0,
        b=_mean([(1 - f) * (1 - s) for f, s in zip(failed, success, strict=True)]) or 0.0,
        f=_mean(failed) or 0.0, success=_mean(success) or 0.0,
        agents=len(results), episodes=sum(r.episodes for r in results),
        R_other=other, share=share,
    )  # fmt: skip


def _mean(arrays: list[np.ndarray]) -> float | None:
    return float(np.mean([array.mean() for array in arrays])) if arrays else None


def _interval(returns: list[np.ndarray], means: np.ndarray) -> float:
    """Half width of the 95 % interval of R."""
    if len(means) >= 2:
        return STUDENT.get(len(means), 1.96) * float(means.std(ddof=1)) / math.sqrt(len(means))
    sample = returns[0]
    return 1.96 * float(sample.std(ddof=1)) / math.sqrt(len(sample)) if len(sample) > 1 else 0.0


def _share(results: list[Result], root: Path) -> float | None:
    """Mean return over mean bound of the very problems that were played."""
    reached, bounds = [], []
    for result in results:
        cell = Cell(result.cell.task, BOUND, seed=result.cell.seed)
        bound = read_result(root / cell.path) if measurable(cell) else None
        if bound is None or bound.cell != cell or bound.episodes < result.episodes:
            return None
        reached.append(result.array("returns").mean())
        bounds.append(bound.array("returns")[: result.episodes].mean())
    return float(np.sum(reached) / np.sum(bounds))


def below_paper(paper: Published | None, ours: Summary) -> bool:
    """R under the paper's 95 % interval."""
    if paper is None or paper.R is None or paper.R_ci95 is None:
        return False
    mean, lowest = ours.R, paper.R - paper.R_ci95
    return mean < lowest


def fails_more(paper: Published | None, ours: Summary) -> bool:
    """f above the paper's by more than the sampling error of both (95 %)."""
    if paper is None or paper.f is None:
        return False
    variance = paper.f * (1 - paper.f) / EPISODES + ours.f * (1 - ours.f) / ours.episodes
    return ours.f > paper.f + 1.96 * math.sqrt(variance)


def compared(condition: Condition) -> bool:
    """Whether a condition is the one of the published numbers."""
    return condition.epsilon == PAPER_PROTOCOL.epsilon and condition.physics != "rigid"
