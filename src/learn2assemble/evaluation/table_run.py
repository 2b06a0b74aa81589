"""Measure the cells of a table that are missing or stale, on all cores."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from learn2assemble.evaluation.cells import BOUND, Cell, measurable, measure
from learn2assemble.evaluation.results_store import agent_hash, is_current, write_result
from learn2assemble.evaluation.table_spec import AGENT, Row, Table, agent_seed


@dataclass(frozen=True)
class Job:
    """A cell to measure."""

    cell: Cell
    agent_file: str | None
    agent_hash: str | None
    episodes: int

    @property
    def cost(self) -> float:
        """Rough share of the time, to start long jobs first."""
        search = self.cell.search
        work = 1.0 if search is None else 1.0 + search.budget * min(search.rollout, 10)
        slow = 2.0 if self.cell.physics != "static" else 1.0
        return work * slow * self.cell.task.num_nodes**2 * self.episodes


def row_cells(table: Table, row: Row, column: int, agents: list[str]) -> list[Cell]:
    """The cells of one row in one column, for all conditions and the given agents."""
    task = table.columns[column].preset
    played = row.columns is None or column in row.columns
    if task is None or not row.known or not played:
        return []
    names = agents if row.policy == AGENT else [""]
    cells = [
        Cell(task, row.policy, name, row.search_config(condition.epsilon), condition.epsilon,
             condition.physics, agent_seed(name))
        for condition in table.conditions for name in names
    ]  # fmt: skip
    return [cell for cell in cells if measurable(cell)]


def jobs(
    table: Table, agents: dict[str, Path], episodes: int, max_agents: int | None = None
) -> list[Job]:
    """Everything a table is made of, every cell once.

    Args:
        agents: name and weights of the agents there are.
        max_agents: at most so many of a row, the lowest numbers.
    """
    cells: dict[str, Cell] = {}
    for row in table.rows:
        names = row.pick(agents)[:max_agents]
        for column in range(len(table.columns)):
            for cell in row_cells(table, row, column, names):
                cells[cell.path] = cell
    for cell in list(cells.values()):
        bound = Cell(cell.task, BOUND, seed=cell.seed)
        if measurable(bound):
            cells.setdefault(bound.path, bound)
    hashes = {name: agent_hash(agents[name]) for name in {c.agent for c in cells.values()} if name}
    return [
        Job(cell, str(agents[cell.agent]) if cell.agent else None, hashes.get(cell.agent), episodes)
        for cell in cells.values()
    ]


def stale(root: Path, wanted: list[Job]) -> list[Job]:
    """Those without a current result below ``root``, the longest first."""
    left = [j for j in wanted if not is_current(root, j.cell, j.agent_hash, j.episodes)]
    return sorted(left, key=lambda job: -job.cost)


def run_jobs(
    root: Path, todo: list[Job], workers: int, progress: Callable[[Job], None] | None = None
) -> None:
    """Measure and write every job; those done before an interruption stay.

    Args:
        workers: processes; 1 works in this one.
        progress: called after each.
    """
    for job, data in _results(todo, min(workers, len(todo))):
        write_result(root, job.cell, job.agent_hash, data)
        if progress is not None:
            progress(job)


def _results(todo: list[Job], workers: int) -> Iterator[tuple[Job, dict[str, Any]]]:
    if workers <= 1:
        # One thread: small batches lose more by sharing than they gain.
        torch.set_num_threads(1)
        yield from map(_do, todo)
        return
    with multiprocessing.get_context("spawn").Pool(workers, _begin) as pool:
        yield from pool.imap_unordered(_do, todo)


def _begin() -> None:
    torch.set_num_threads(1)
    # The parent answers Ctrl-C and ends its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _do(job: Job) -> tuple[Job, dict[str, Any]]:
    return job, measure(job.cell, job.agent_file, job.episodes)
