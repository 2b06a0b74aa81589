"""Learning curves from the logs of runs (the paper's appendix figures 3 and 5)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from learn2assemble.errors import InputError, look_up
from learn2assemble.reproduction.tables import Row

QUANTITIES = ("R", "f", "success")
"""Of the latest 300 training episodes, exploration included."""
POINTS = 240
"""Grid of samples a curve is drawn on."""
WINDOW = 9
"""Points a curve is averaged over."""


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


def read_stages(runs: Path, name: str) -> dict[str, np.ndarray]:
    """The logs of all stages of a training (:mod:`learn2assemble.reproduction.recipes`) as one.

    Raises:
        InputError: see :func:`read_log`.
    """
    folders = [*sorted(runs.glob(f"{name}.stage*")), runs / name]
    logs = [read_log(folder / "log.jsonl") for folder in folders]
    before = 0.0
    for log in logs:
        log["samples"] += before
        before = log["samples"][-1] if len(log["samples"]) else before
    return {key: np.concatenate([log[key] for log in logs]) for key in logs[0]}


def read_log(file: Path) -> dict[str, np.ndarray]:
    """Samples and quantities of a ``log.jsonl``, from the first finished episode on.

    Raises:
        InputError: for a line that is none of a log.
    """
    rows = []
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
        try:
            data = json.loads(line)
            if "R" in data:
                rows.append([float(data[key]) for key in ("samples", *QUANTITIES)])
        except (ValueError, KeyError, TypeError):
            raise InputError(f"{file}, line {number}", line[:60], "a line of a log") from None
    table = np.array(rows, float).reshape(-1, 1 + len(QUANTITIES))
    return dict(zip(("samples", *QUANTITIES), table.T, strict=True))


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
