"""Learning curves from the logs of runs (the paper's appendix figures 3 and 5), what agents reach
over the size of targets with the time of their decisions, pictures of both, and of tables.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from l2a_lab.cell_jobs import row_cells
from l2a_lab.cells import make_cell_policy
from l2a_lab.measured import Figures, table_lines
from l2a_lab.numbers import load_table
from l2a_lab.runs import STAGE, Run, read_runs
from l2a_lab.table import Condition, Row
from l2a_lab.tables import get_table
from learn2assemble.errors import InputError
from learn2assemble.tasks.evaluation.episodes import episode_generators
from learn2assemble.tasks.networks.agent import agent_files, one_thread
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.world_model import lookahead_actions

QUANTITIES = ("R", "f", "success")
"""Of the latest 300 training episodes, exploration included."""
LEVELS = (3.21, 3.47)
"""The paper's R at epsilon 0.05 without search and with budget 10, on two-sided-3x3-20-24."""
BAR_LEVELS = (1.94, 2.42)
"""The paper's R of full and of partial connectivity on bars-one-sided-5x5-25-27."""
ROBOT_LEVELS = {"two": (2.16,), "four": (2.67,), "objects": (1.25,), "one": (2.71,)}
"""The paper's R with a robot without search, on the task of training: two sides, four, several
objects, one side."""
POINTS = 240
"""Grid of samples a curve is drawn on."""
WINDOW = 9
"""Points a curve is averaged over."""
_COLUMNS = ("samples", "seconds", *QUANTITIES)


@dataclass(frozen=True)
class Curves:
    """Curves that belong together.

    Args:
        name: as in ``l2a-lab curves NAME``.
        title: one line.
        lines: label and stem of the runs of each.
        note: a sentence printed below.
        levels: of R, for :func:`time_to`; returns the paper reports.
    """

    name: str
    title: str
    lines: tuple[tuple[str, str], ...]
    note: str = ""
    levels: tuple[float, ...] = LEVELS


@dataclass(frozen=True)
class LearningCurve:
    """Mean and range over the seeds of one line."""

    label: str
    seeds: int
    """0 where agents are not seeds of one training."""
    samples: np.ndarray
    """float64[P]: what it is drawn over."""
    mean: Mapping[str, np.ndarray]
    """float64[P] of every quantity, NaN where not measured; likewise the next two."""
    low: Mapping[str, np.ndarray]
    high: Mapping[str, np.ndarray]

    @property
    def legend(self) -> str:
        """The label with the number of agents."""
        agents = "1 agent" if self.seeds == 1 else f"{self.seeds} agents"
        return f"{self.label} ({agents})" if self.seeds else self.label


class Reached(NamedTuple):
    """What it took the seeds of a line to reach a return."""

    label: str
    level: float
    seeds: int
    reached: int
    """Seeds that came there; for the quartiles the others never do."""
    samples: tuple[float, ...]
    """First quartile, median and third quartile over the seeds; infinite where too few did."""
    seconds: tuple[float, ...]
    """The same in wall time of the machines that trained."""


_ALL = (
    Curves(
        "architectures",
        "Architectures (appendix figure 3a; full graph)",
        (("MHA", "mha-full"), ("SHA", "sha-full"), ("S2V", "s2v-full")),
    ),
    Curves(
        "connectivity",
        "Connectivity (appendix figure 3b; bars, one side)",
        (("partially connected", "bars-partial"), ("fully connected", "bars-full")),
        levels=BAR_LEVELS,
    ),
    Curves(
        "algorithms",
        "Learning algorithms (appendix figure 5)",
        (
            ("DQN, paper's schedule", "dqn-paper"),
            ("DQN", "dqn"),
            ("ε-MCTS", "eps-mcts"),
            ("Q-MCTS", "q-mcts"),
        ),
        "Q-MCTS and ε-MCTS search while they collect: their curves are of the search.",
    ),
    Curves(
        "robot-two-sided",
        "Two sides with a robot (kinematic cell)",
        (
            ("DQN, paper's schedule", "robot-two-sided-paper"),
            ("DQN, our schedule", "robot-two-sided"),
            ("ours", "relational-two-sided"),
            ("ours, blocks anywhere", "relational-anywhere"),
        ),
        levels=ROBOT_LEVELS["two"],
    ),
    Curves(
        "robot-four-sided",
        "Four sides with a robot (kinematic cell)",
        (
            ("DQN, paper's schedule", "robot-four-sided-paper"),
            ("DQN, our schedule", "robot-four-sided"),
            ("ours", "relational-four-sided"),
        ),
        levels=ROBOT_LEVELS["four"],
    ),
    Curves(
        "robot-objects",
        "Several objects with a robot (kinematic cell)",
        (
            ("DQN, paper's schedule", "robot-objects-paper"),
            ("DQN, our schedule", "robot-objects"),
            ("ours", "relational-robot-objects"),
        ),
        "The paper's training took place in the authors' fast mode.",
        levels=ROBOT_LEVELS["objects"],
    ),
    Curves(
        "robot-one-sided",
        "One side with a robot (kinematic cell)",
        (
            ("DQN, paper's schedule", "robot-one-sided-paper"),
            ("DQN, our schedule", "robot-one-sided"),
            ("ours", "relational-one-sided"),
        ),
        levels=ROBOT_LEVELS["one"],
    ),
)
FIGURES: dict[str, Curves] = {figure.name: figure for figure in _ALL}
WITH_ROBOT = tuple(figure for figure in _ALL if figure.name.startswith("robot-"))


def load_curves(figure: Curves, runs: Path) -> list[LearningCurve]:
    """Curves of the lines that have runs in the pack ``runs`` (:mod:`.runs`).

    Raises:
        InputError: where there are none at all, or a log is damaged.
    """
    curves = [_average(label, logs) for label, logs in _logs(figure, runs)]
    if not curves:
        wanted = ", ".join(f"{stem}-s0" for _, stem in figure.lines)
        raise InputError("--runs", str(runs), f"a file with runs such as {wanted}")
    return curves


def time_to(figure: Curves, runs: Path) -> list[Reached]:
    """When the lines of a figure first reach each of its levels in R.

    R is that of the latest 300 training episodes, so at the exploration rate of that time, 0.05
    once it has come down, averaged over ``WINDOW`` entries of the log.

    Raises:
        InputError: see :func:`read_log`.
    """
    out: list[Reached] = []
    for label, logs in _logs(figure, runs):
        for level in figure.levels:
            first = np.full((len(logs), 2), np.inf)
            for row, log in zip(first, logs, strict=True):
                above = np.flatnonzero(_smooth(log["R"]) >= level)
                if len(above):
                    row[:] = log["samples"][above[0]], log["seconds"][above[0]]
            # No interpolation, which infinite numbers do not stand.
            quartiles = np.quantile(first, (0.25, 0.5, 0.75), axis=0, method="inverted_cdf")
            samples, seconds = (tuple(column.tolist()) for column in quartiles.T)
            reached = int(np.isfinite(first[:, 0]).sum())
            out.append(Reached(label, level, len(logs), reached, samples, seconds))
    return out


def costs_told(figures: Sequence[Curves], runs: Path) -> list[str]:
    """What trainings took to the paper's returns, as a table of the documents. Minutes are those of
    the machine and of what went on beside them, so samples say more."""
    head = ["training", "agents", "samples", "minutes each", "R of the paper", "came to it"]
    rows: list[list[str]] = []
    for figure in figures:
        logs = dict(_logs(figure, runs))
        for reached in time_to(figure, runs):
            of = logs[reached.label]
            minutes = float(np.median([log["seconds"][-1] for log in of])) / 60
            samples, spent = reached.samples[1], reached.seconds[1] / 60
            came = (f"{samples:,.0f}", f"{spent:.0f}") if np.isfinite(samples) else ("–", "–")
            label = f"{figure.name}: {reached.label}" if len(figures) > 1 else reached.label
            most = max(log["samples"][-1] for log in of)
            told = [f"{len(of)}", f"{most:,.0f}", f"{minutes:.0f}", f"{reached.level}"]
            rows.append([label, *told, f"{reached.reached}", *came])
    return table_lines([*head, "after samples", "after minutes"], rows)


def hours_told(figures: Sequence[Curves], runs: Path) -> str:
    """What all trainings of some figures took together, as a sentence of the documents."""
    logs = [log for figure in figures for _, some in _logs(figure, runs) for log in some]
    hours = sum(float(log["seconds"][-1]) for log in logs) / 3600
    return (
        f"All {len(logs)} trainings took {hours:.0f} hours of one core by their logs, so one run "
        f"with two workers takes {hours / 2:.0f}."
    )


def _logs(figure: Curves, pack: Path) -> Iterator[tuple[str, list[dict[str, np.ndarray]]]]:
    """Label and logs of every line that has runs; logs of one entry say nothing."""
    runs = read_runs(pack)
    for label, stem in figure.lines:
        logs = [read_stages(runs, name) for name in Row(label, stem).pick(runs)]
        logs = [log for log in logs if len(log["samples"]) >= 2]
        if logs:
            yield label, logs


def read_stages(runs: Mapping[str, Run], name: str) -> dict[str, np.ndarray]:
    """The logs of all stages of a training (:mod:`l2a_lab.recipes`) as one.

    Raises:
        InputError: see :func:`read_log`.
    """
    stages = sorted(other for other in runs if other.startswith(name + STAGE))
    logs = [read_log(runs, stage) for stage in (*stages, name)]
    for key in ("samples", "seconds"):
        before = 0.0
        for log in logs:
            log[key] += before
            before = log[key][-1] if len(log[key]) else before
    return {key: np.concatenate([log[key] for log in logs]) for key in logs[0]}


def read_log(runs: Mapping[str, Run], name: str) -> dict[str, np.ndarray]:
    """Samples, seconds and quantities of the log of a run, from the first finished episode on.

    Raises:
        InputError: for an entry that is none of a log.
    """
    rows: list[list[float]] = []
    for number, entry in enumerate(runs[name]["log"], 1):
        try:
            if "R" in entry:
                rows.append([float(entry[key]) for key in _COLUMNS])
        except (ValueError, KeyError, TypeError):
            where = f"{name}: log, entry {number}"
            raise InputError(where, str(entry)[:60], "an entry of a log") from None
    table = np.array(rows, float).reshape(-1, len(_COLUMNS))
    return dict(zip(_COLUMNS, table.T.copy(), strict=True))


def _average(label: str, logs: list[dict[str, np.ndarray]]) -> LearningCurve:
    """Mean, lowest and highest over seeds, on the samples that all of them have."""
    first = max(log["samples"][0] for log in logs)
    last = min(log["samples"][-1] for log in logs)
    samples = np.linspace(float(first), float(max(first, last)), POINTS)
    mean, low, high = (dict[str, np.ndarray]() for _ in range(3))
    for key in QUANTITIES:
        lines = np.array([_smooth(np.interp(samples, g["samples"], g[key])) for g in logs])
        mean[key], low[key], high[key] = lines.mean(0), lines.min(0), lines.max(0)
    return LearningCurve(label, len(logs), samples, mean, low, high)


def _smooth(values: np.ndarray) -> np.ndarray:
    """Running mean with shorter windows at the ends."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    index = np.arange(len(values))
    half = np.minimum(np.minimum(index, len(values) - 1 - index), WINDOW // 2)
    return (total[index + half + 1] - total[index - half]) / (2 * half + 1)


SIZES = "scaling"
"""Name of the figure over the size of targets, and of the table it is drawn from."""
TIMED_WORLDS, TIMED_SECONDS = 16, 0.5
"""Worlds that decide side by side, and processor time a measurement takes at least."""


def load_scaled(root: Path, times: dict[str, dict[str, float]]) -> list[LearningCurve]:
    """The rows with numbers below ``root`` over the grid, one agent's or a mean over agents, of
    the quantities ``SCALING``.

    Args:
        times: what :func:`decision_time` has measured, by :func:`timed_names`.

    Raises:
        InputError: where there are none.
    """
    table = get_table(SIZES)
    grid = np.array([column.preset.grid for column in table.columns], float)
    out: list[LearningCurve] = []
    for row, entries in zip(table.rows, load_table(table, root).entries, strict=True):
        found = [entry.results.get(Condition(0.0)) for entry in entries]
        if any(found):
            values = {
                key: np.array([np.nan if s is None else getattr(s, key) for s in found], float)
                for key in ("success", "share", "f")
            }
            measured = [times.get(_timed_name(row, c.task), {}) for c in table.columns]
            values["ms"] = np.array([entry.get("ms", np.nan) for entry in measured])
            out.append(LearningCurve(row.name, 0, grid, values, values, values))
    if not out:
        raise InputError("results", str(root), f"a folder with cells of the table {SIZES}")
    return out


def timed_names() -> list[str]:
    """Names of the measurements of :func:`decision_time`."""
    table = get_table(SIZES)
    return [
        _timed_name(row, column.task)
        for row in table.rows
        for number, column in enumerate(table.columns)
        if row.played_in(number)
    ]


def _timed_name(row: Row, task: str) -> str:
    return f"{row.name} / {task}"


def decision_time(name: str) -> dict[str, float]:
    """Processor time of a decision [ms] of a row in a column, both by :func:`timed_names`, of
    worlds the look-ahead has built a third of; the first agent there is by name."""
    table = get_table(SIZES)
    label, _, task = name.rpartition(" / ")
    row = next(row for row in table.rows if row.name == label)
    number = next(n for n, column in enumerate(table.columns) if column.task == task)
    files = agent_files()
    (cell,) = row_cells(table, row, number, row.pick(files)[:1])
    simulator = Simulator(cell.task)
    problems, rng = episode_generators(cell.seed)
    state = simulator.new(TIMED_WORLDS, problems)
    for _ in range(cell.task.grid**2 // 3):
        simulator.step(state, lookahead_actions(simulator, state))
    state = state.take(np.flatnonzero(~state.terminated))
    with one_thread():
        policy = make_cell_policy(cell, str(files[cell.agent]) if cell.agent else None)
        policy(state, rng)  # compiles
        rounds, started = 0, time.process_time()
        while (spent := time.process_time() - started) < TIMED_SECONDS:
            policy(state, rng)
            rounds += 1
    return {"ms": round(1000 * spent / (rounds * state.batch_size), 4)}


TIMES = Figures(
    "learn2assemble-decisions", timed_names, decision_time, lambda: {"worlds": TIMED_WORLDS}
)


LEARNING = ("R", "f", "success")
"""Panels of learning curves: the first one is large."""
SCALING = ("success", "share", "f", "ms")
"""The same over the size of targets."""
