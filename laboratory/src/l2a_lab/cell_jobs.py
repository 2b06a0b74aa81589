"""What has to be measured for a table, and measuring it on all cores or machines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from l2a_lab.bounds import has_bound
from l2a_lab.cells import BOUND, Cell, agent_hash, is_current, measure, write_result
from l2a_lab.table import OWN, Row, Table
from learn2assemble.tasks.evaluation.episodes import (
    BATCH,
)
from learn2assemble.tasks.networks.agent import one_thread
from learn2assemble.workers import run_all

EPISODES = {"kinematic": 200, "dynamic": 100, "published": 100}
"""Problems of a cell by its placement checker, ..."""


OWN_EPISODES = {"kinematic": 500, "dynamic": 200, "published": 200}
"""... those of several agents of ours, ..."""


MANY_EPISODES = 1000
"""... and with any other one, which costs far less."""


SHARES = 5
"""The problems of a cell are shared among so many agents: that of seed k plays the k-th share.

An agent more brings more than more problems for the same one, and the interval over agents that
played different problems holds for both."""


PLAYED = {"static": 8e-5, "rigid": 2e-4, "kinematic": 3e-4, "published": 6e-3, "dynamic": 6e-2}
"""Seconds of a processor that an episode takes for each node, by what checks placements; ..."""
TRIED = {"static": 4e-7, "rigid": 9e-7, "kinematic": 3e-6, "published": 1.5e-5, "dynamic": 3e-6}
"""... besides, for each placement that a search tries of a decision, times nodes to the power of
2.5: a decision for each, and the network sees pairs of them, but the nearest alone."""


@dataclass(frozen=True)
class CellJob:
    """A cell to measure."""

    cell: Cell
    agent_file: str | None
    agent_hash: str | None
    episodes: int

    @property
    def seconds(self) -> float:
        """About how long it takes one process; what is slowest for a checker that is not known."""
        search, nodes, physics = self.cell.search, self.cell.task.num_nodes, self.cell.physics
        if self.cell.task.has_arm and physics in ("static", "rigid"):
            physics = "kinematic"  # They stand for it.
        tries = 0.0 if search is None else search.budget * min(search.rollout, 10)
        played = PLAYED.get(physics, max(PLAYED.values())) * nodes
        tried = TRIED.get(physics, max(TRIED.values())) * tries * nodes**2.5
        return (played + tried) * self.episodes


def row_cells(table: Table, row: Row, column: int, agents: list[str]) -> list[Cell]:
    """The cells of one row in one column, for all conditions and the given agents."""
    if not row.played_in(column):
        return []
    task = table.columns[column].preset
    names = shares(row, agents) if row.agents else {"": 0}
    return [
        Cell(
            task,
            row.policy,
            name,
            row.search_config(condition.epsilon),
            condition.epsilon,
            condition.physics,
            share=share,
            look_ahead=row.look_ahead if condition.physics == row.look_ahead else "",
        )
        for condition in table.conditions
        if row.played_at(condition)
        for name, share in names.items()
    ]


def shares(row: Row, agents: list[str]) -> dict[str, int]:
    """The share of the problems that each of ``agents`` plays; of a single one all there are."""
    return {name: row.seed(name) % SHARES if len(agents) > 1 else 0 for name in agents}


def share_size(problems: int, count: int) -> int:
    """Problems of each of ``count`` shares: at least ``problems`` together, in whole batches, so
    that the first share of an agent is the beginning of all its episodes."""
    size = -(-problems // count)
    return size if count == 1 or size < BATCH else -(-size // BATCH) * BATCH


def jobs(
    table: Table,
    agents: dict[str, Path],
    episodes: int | None = None,
    max_agents: int | None = None,
) -> list[CellJob]:
    """Everything a table is made of, every cell once.

    Args:
        agents: name and weights of the agents there are.
        episodes: of every row in every column; by default :data:`EPISODES`.
        max_agents: at most so many of a row, the lowest numbers.
    """
    cells: dict[str, Cell] = {}
    count: dict[str, int] = {}
    for row in table.rows:
        names = row.pick(agents)[:max_agents]
        number = len(set(shares(row, names).values())) or 1
        for column in range(len(table.columns)):
            for cell in row_cells(table, row, column, names):
                cells[cell.path] = cell
                several = row.kind == OWN and number > 1
                usual = OWN_EPISODES if several else EPISODES
                problems = episodes or usual.get(cell.physics, MANY_EPISODES)
                count[cell.path] = share_size(problems, number)
    for path, cell in list(cells.items()):
        if has_bound(cell.task):
            # Of as many problems as any policy plays.
            bound = Cell(cell.task, BOUND, seed=cell.seed)
            cells[bound.path] = bound
            end = (cell.share + 1) * count[path]
            count[bound.path] = max(end, count.get(bound.path, 0))
    hashes = {name: agent_hash(agents[name]) for name in {c.agent for c in cells.values()} if name}
    return [
        CellJob(
            cell,
            str(agents[cell.agent]) if cell.agent else None,
            hashes.get(cell.agent),
            count[path],
        )
        for path, cell in cells.items()
    ]


def stale(root: Path, wanted: list[CellJob]) -> list[CellJob]:
    """Those without a current result below ``root``, the longest first."""
    left = [j for j in wanted if not is_current(root, j.cell, j.agent_hash, j.episodes)]
    return sorted(left, key=lambda job: -job.seconds)


def run_jobs(
    root: Path,
    todo: list[CellJob],
    workers: int,
    progress: Callable[[CellJob], None] = lambda job: None,
    ray: str | None = None,
) -> None:
    """Measure and write every job; those done before an interruption stay.

    Args:
        workers, ray: see :func:`learn2assemble.workers.run_all`.
        progress: called after each.
    """
    with one_thread():
        for job, data in run_all(_do, todo, workers=workers, ray=ray):
            write_result(root, job.cell, job.agent_hash, data)
            progress(job)


def _do(job: CellJob) -> dict[str, Any]:
    return measure(job.cell, job.agent_file, job.episodes)
