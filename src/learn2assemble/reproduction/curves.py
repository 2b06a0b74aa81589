"""Learning curves from the logs of runs (the paper's appendix figures 3 and 5), and what agents
reach over the size of targets, with the time of their decisions."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from learn2assemble.errors import InputError, look_up
from learn2assemble.evaluation.episodes import episode_generators
from learn2assemble.networks.agent import agent_files, one_thread
from learn2assemble.planning.world_model import lookahead_actions
from learn2assemble.reproduction.cells import make_cell_policy, row_cells
from learn2assemble.reproduction.report import load_table
from learn2assemble.reproduction.tables import Condition, Row, get_table
from learn2assemble.simulator import Simulator

QUANTITIES = ("R", "f", "success")
"""Of the latest 300 training episodes, exploration included."""
LEVELS = (3.21, 3.47)
"""The paper's R at epsilon 0.05 without search and with budget 10, on two-sided-3x3-20-24."""
POINTS = 240
"""Grid of samples a curve is drawn on."""
WINDOW = 9
"""Points a curve is averaged over."""
_COLUMNS = ("samples", "seconds", *QUANTITIES)


@dataclass(frozen=True)
class Figure:
    """Curves that belong together: label and stem of the runs of each."""

    name: str
    title: str
    lines: tuple[tuple[str, str], ...]
    note: str = ""


@dataclass(frozen=True)
class Curve:
    """Mean and range over the seeds of one line."""

    label: str
    seeds: int
    samples: np.ndarray
    """float64[P]."""
    mean: dict[str, np.ndarray]
    """float64[P] of every quantity."""
    low: dict[str, np.ndarray]
    high: dict[str, np.ndarray]


@dataclass(frozen=True)
class Reached:
    """What it took the seeds of a line to reach a return."""

    label: str
    level: float
    seeds: int
    reached: int
    """Seeds that came there; for the quartiles the others never do."""
    samples: tuple[float, float, float]
    """First quartile, median and third quartile over the seeds; infinite where too few did."""
    seconds: tuple[float, float, float]
    """The same in wall time of the machines that trained."""


_ALL = (
    Figure("architectures", "Architectures (appendix figure 3a; full graph)",
           (("MHA", "mha-full"), ("SHA", "sha-full"), ("S2V", "s2v-full"))),
    Figure("connectivity", "Connectivity (appendix figure 3b; bars, one side)",
           (("partially connected", "bars-partial"), ("fully connected", "bars-full"))),
    Figure("algorithms", "Learning algorithms (appendix figure 5)",
           (("DQN", "dqn"), ("ε-MCTS", "eps-mcts"), ("Q-MCTS", "q-mcts")),
           "Q-MCTS and ε-MCTS search while they collect: their curves are of the search."),
)  # fmt: skip
FIGURES: dict[str, Figure] = {figure.name: figure for figure in _ALL}


def get_figure(name: str) -> Figure:
    """The figure called ``name``.

    Raises:
        UnknownNameError: naming the nearest one.
    """
    return look_up("figure", name, FIGURES)


def load_curves(figure: Figure, runs: Path) -> list[Curve]:
    """Curves of the lines that have runs below ``runs`` (folders with a ``log.jsonl``).

    Raises:
        InputError: where there are none at all, or a log is damaged.
    """
    names = sorted(file.parent.name for file in runs.glob("*/log.jsonl"))
    curves = []
    for label, stem in figure.lines:
        logs = [read_stages(runs, name) for name in Row(label, stem).pick(names)]
        logs = [log for log in logs if len(log["samples"]) >= 2]
        if logs:
            curves.append(_average(label, logs))
    if not curves:
        wanted = ", ".join(f"{stem}-s0" for _, stem in figure.lines)
        raise InputError("--runs", str(runs), f"a folder with runs such as {wanted}")
    return curves


def time_to(figure: Figure, runs: Path, levels: tuple[float, ...] = LEVELS) -> list[Reached]:
    """When the lines of a figure first reach each of ``levels`` in R.

    R is that of the latest 300 training episodes, so at the exploration rate of that time, 0.05
    once it has come down, averaged over ``WINDOW`` entries of the log.

    Raises:
        InputError: see :func:`read_log`.
    """
    names = sorted(file.parent.name for file in runs.glob("*/log.jsonl"))
    out: list[Reached] = []
    for label, stem in figure.lines:
        logs = [read_stages(runs, name) for name in Row(label, stem).pick(names)]
        logs = [log for log in logs if len(log["samples"]) >= 2]
        for level in levels if logs else ():
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


def read_stages(runs: Path, name: str) -> dict[str, np.ndarray]:
    """The logs of all stages of a training (:mod:`learn2assemble.reproduction.recipes`) as one.

    Raises:
        InputError: see :func:`read_log`.
    """
    folders = [*sorted(runs.glob(f"{name}.stage*")), runs / name]
    logs = [read_log(folder / "log.jsonl") for folder in folders]
    for key in ("samples", "seconds"):
        before = 0.0
        for log in logs:
            log[key] += before
            before = log[key][-1] if len(log[key]) else before
    return {key: np.concatenate([log[key] for log in logs]) for key in logs[0]}


def read_log(file: Path) -> dict[str, np.ndarray]:
    """Samples, seconds and quantities of a ``log.jsonl``, from the first finished episode on.

    Raises:
        InputError: for a line that is none of a log.
    """
    rows = []
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
        try:
            data = json.loads(line)
            if "R" in data:
                rows.append([float(data[key]) for key in _COLUMNS])
        except (ValueError, KeyError, TypeError):
            raise InputError(f"{file}, line {number}", line[:60], "a line of a log") from None
    table = np.array(rows, float).reshape(-1, len(_COLUMNS))
    return dict(zip(_COLUMNS, table.T.copy(), strict=True))


def _average(label: str, logs: list[dict[str, np.ndarray]]) -> Curve:
    """Mean, lowest and highest over seeds, on the samples that all of them have."""
    first = max(log["samples"][0] for log in logs)
    last = min(log["samples"][-1] for log in logs)
    samples = np.linspace(first, max(first, last), POINTS)
    mean, low, high = {}, {}, {}
    for key in QUANTITIES:
        lines = np.array([_smooth(np.interp(samples, g["samples"], g[key])) for g in logs])
        mean[key], low[key], high[key] = lines.mean(0), lines.min(0), lines.max(0)
    return Curve(label, len(logs), samples, mean, low, high)


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


@dataclass(frozen=True)
class Scaled:
    """One row of the table over the size of targets."""

    label: str
    grid: np.ndarray
    """float64[G]."""
    values: dict[str, np.ndarray]
    """float64[G] of ``share``, ``f``, ``success`` and ``ms``; NaN where not measured."""


def load_scaled(root: Path, times: dict[str, dict[str, float]]) -> list[Scaled]:
    """The rows with numbers below ``root``, one agent's or a mean over agents.

    Args:
        times: what :func:`decision_time` has measured, by :func:`timed_names`.

    Raises:
        InputError: where there are none.
    """
    table = get_table(SIZES)
    grid = np.array([column.preset.grid for column in table.columns if column.preset], float)
    out: list[Scaled] = []
    for row, entries in zip(table.rows, load_table(table, root).entries, strict=True):
        found = [entry.results.get(Condition(0.0)) for entry in entries]
        if not any(found):
            continue
        values = {
            key: np.array([np.nan if s is None else getattr(s, key) for s in found], float)
            for key in ("share", "f", "success")
        }
        measured = [times.get(_timed_name(row, c.task), {}) for c in table.columns]
        values["ms"] = np.array([entry.get("ms", np.nan) for entry in measured])
        out.append(Scaled(row.name, grid, values))
    if not out:
        raise InputError("results", str(root), f"a folder with cells of the table {SIZES}")
    return out


def timed_names() -> list[str]:
    """Names of the measurements of :func:`decision_time`."""
    table = get_table(SIZES)
    return [_timed_name(row, column.task) for row in table.rows for column in table.columns]


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
