"""Learning curves from the logs of runs (the paper's appendix figures 3 and 5), what agents reach
over the size of targets with the time of their decisions, pictures of both, and of tables.
"""

from __future__ import annotations

import json
import textwrap
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from itertools import cycle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, MaxNLocator

from l2a_lab.cells import make_cell_policy, row_cells
from l2a_lab.measured import Figures
from l2a_lab.report import Section, load_table
from l2a_lab.tables import Condition, Row, get_table
from learn2assemble.errors import InputError
from learn2assemble.files import check_exists, write_file
from learn2assemble.tasks.evaluation.episodes import episode_generators
from learn2assemble.tasks.networks.agent import agent_files, one_thread
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.world_model import lookahead_actions
from learn2assemble.viewer.picture import ACCENT, INK, LINE, PAPER, SOFT

QUANTITIES = ("R", "f", "success")
"""Of the latest 300 training episodes, exploration included."""
LEVELS = (3.21, 3.47)
"""The paper's R at epsilon 0.05 without search and with budget 10, on two-sided-3x3-20-24."""
BAR_LEVELS = (1.94, 2.42)
"""The paper's R of full and of partial connectivity on bars-one-sided-5x5-25-27."""
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
class Curve:
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
        (("DQN", "dqn"), ("ε-MCTS", "eps-mcts"), ("Q-MCTS", "q-mcts")),
        "Q-MCTS and ε-MCTS search while they collect: their curves are of the search.",
    ),
)
FIGURES: dict[str, Curves] = {figure.name: figure for figure in _ALL}


def load_curves(figure: Curves, runs: Path) -> list[Curve]:
    """Curves of the lines that have runs below ``runs`` (folders with a ``log.jsonl``).

    Raises:
        InputError: where there are none at all, or a log is damaged.
    """
    curves = [_average(label, logs) for label, logs in _logs(figure, runs)]
    if not curves:
        check_exists(runs, "folder of runs")
        wanted = ", ".join(f"{stem}-s0" for _, stem in figure.lines)
        raise InputError("--runs", str(runs), f"a folder with runs such as {wanted}")
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


def _logs(figure: Curves, runs: Path) -> Iterator[tuple[str, list[dict[str, np.ndarray]]]]:
    """Label and logs of every line that has runs; logs of one entry say nothing."""
    names = sorted(file.parent.name for file in runs.glob("*/log.jsonl"))
    for label, stem in figure.lines:
        logs = [read_stages(runs, name) for name in Row(label, stem).pick(names)]
        logs = [log for log in logs if len(log["samples"]) >= 2]
        if logs:
            yield label, logs


def read_stages(runs: Path, name: str) -> dict[str, np.ndarray]:
    """The logs of all stages of a training (:mod:`l2a_lab.recipes`) as one.

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


def load_scaled(root: Path, times: dict[str, dict[str, float]]) -> list[Curve]:
    """The rows with numbers below ``root`` over the grid, one agent's or a mean over agents, of
    the quantities ``SCALING``.

    Args:
        times: what :func:`decision_time` has measured, by :func:`timed_names`.

    Raises:
        InputError: where there are none.
    """
    table = get_table(SIZES)
    grid = np.array([column.preset.grid for column in table.columns], float)
    out: list[Curve] = []
    for row, entries in zip(table.rows, load_table(table, root).entries, strict=True):
        found = [entry.results.get(Condition(0.0)) for entry in entries]
        if any(found):
            values = {
                key: np.array([np.nan if s is None else getattr(s, key) for s in found], float)
                for key in ("success", "share", "f")
            }
            measured = [times.get(_timed_name(row, c.task), {}) for c in table.columns]
            values["ms"] = np.array([entry.get("ms", np.nan) for entry in measured])
            out.append(Curve(row.name, 0, grid, values, values, values))
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


_COLOURS = (ACCENT, "#d9480f", "#5f3dc4", "#2b8a3e", "#e67700", INK, "#868e96", "#c2255c")
_DPI = 130
TITLES = {
    "R": "discounted return R",
    "f": "share ended by an invalid action f",
    "success": "share filled",
    "share": "share of the bound on R",
    "ms": "processor time of a decision [ms]",
}
_EMPTY = {"R": 0.16, "success": 0.36}
"""How high the large panel is empty at its right, where the legend goes."""
LEARNING = ("R", "f", "success")
"""Panels of learning curves: the first one is large."""
SCALING = ("success", "share", "f", "ms")
"""The same over the size of targets."""


def write_curves(
    title: str,
    lines: Sequence[Curve],
    note: str,
    path: Path,
    panels: Sequence[str] = LEARNING,
    axis: str = "training samples",
) -> None:
    """Draw curves of the first of ``panels`` large and of the others beside it into a PNG.

    Raises:
        InputError: where ``path`` cannot be written.
    """
    figure = Figure(figsize=(11.5, 5.0), dpi=_DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)
    figure.text(0.05, 0.94, title, fontsize=14, fontweight="bold", color=INK, va="center")
    figure.text(0.05, 0.035, note, fontsize=8, color=SOFT, va="center")
    first, *others = panels
    grid = figure.add_gridspec(
        len(others),
        2,
        width_ratios=(2, 1),
        left=0.06,
        right=0.98,
        top=0.86,
        bottom=0.14,
        wspace=0.16,
        hspace=0.6,
    )
    places = {first: grid[:, 0]} | {name: grid[n, 1] for n, name in enumerate(others)}
    for quantity, place in places.items():
        axes = figure.add_subplot(place)
        _panel(axes, quantity, lines)
        if quantity == first:
            axes.legend(
                loc="center right",
                bbox_to_anchor=(1, _EMPTY[quantity]),
                frameon=False,
                fontsize=9,
                labelcolor=INK,
            )
            axes.set_xlabel(axis, fontsize=9, color=SOFT)
    save(figure, path, _DPI)


def _panel(axes: Axes, quantity: str, lines: Sequence[Curve]) -> None:
    for line, colour in zip(lines, cycle(_COLOURS), strict=False):
        marker = "o" if len(line.samples) < 20 else None
        axes.plot(
            line.samples,
            line.mean[quantity],
            color=colour,
            linewidth=1.8,
            label=line.legend,
            marker=marker,
            markersize=3.5,
        )
        axes.fill_between(
            line.samples,
            line.low[quantity],
            line.high[quantity],
            color=colour,
            alpha=0.15,
            linewidth=0,
        )
    axes.set_title(TITLES[quantity], fontsize=10, color=INK, loc="left")
    axes.set_facecolor(PAPER)
    axes.set_xlim(left=0, right=max(float(line.samples[-1]) for line in lines) * 1.02)
    if quantity == "ms":
        axes.set_yscale("log")
    elif quantity == "share":
        axes.set_ylim(top=1.01)
    elif quantity != "R":
        axes.set_ylim(-0.02, 1.02)
    axes.grid(color=LINE, linewidth=0.7)
    axes.set_axisbelow(True)
    axes.tick_params(colors=SOFT, labelsize=8.5, length=0)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.xaxis.set_major_formatter(FuncFormatter(_thousands))
    for side in axes.spines.values():
        side.set_visible(False)


def _thousands(value: float, _position: int | None = None) -> str:
    return f"{value / 1000:g}k" if value >= 1000 else f"{value:g}"


_TABLE_DPI = 120
_SIDE, _ROW, _HEAD, _GAP, _LINE = 0.35, 0.27, 0.62, 0.42, 0.19
"""Border, height of a row, of a section's head, space between sections, line of notes [inch]."""
_LETTER, _PAD = 0.083, 0.16
"""Width of a letter and space beside a column [inch] at the size of the numbers."""
_SIZE = 9.5
_TINTS = {"own": "#e3f1f2", "reference": "#f1eee7"}
"""Background of rows by kind; published methods have none."""


def write_table(title: str, blocks: Sequence[Section], notes: Sequence[str], path: Path) -> None:
    """Draw sections below each other, with notes at the foot, into a PNG.

    Raises:
        InputError: where ``path`` cannot be written.
    """
    widths = _widths(blocks)
    width = max(sum(widths) + 2 * _SIDE, 8.0)
    words = [line for note in notes for line in _wrap(note, width - 2 * _SIDE)]
    heights = [_HEAD + 0.3 + _ROW * len(block.rows) + _GAP for block in blocks]
    height = 0.75 + sum(heights) + _LINE * len(words) + 0.25
    figure = Figure(figsize=(width, height), dpi=_TABLE_DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)
    axes.axis("off")
    write(axes, _SIDE, 0.42, title, fontsize=15, fontweight="bold")
    top = 0.75
    for block, extent in zip(blocks, heights, strict=True):
        _draw(axes, block, widths, top)
        top += extent
    for number, line in enumerate(words):
        write(axes, _SIDE, top + _LINE * number, line, fontsize=8, color=SOFT)
    save(figure, path, _TABLE_DPI)


def _widths(blocks: Sequence[Section]) -> list[float]:
    """Width of every column [inch], the same in all blocks."""
    out = []
    for number in range(len(blocks[0].columns)):
        cells = [row[number] for block in blocks for row in (block.columns, *block.rows)]
        out.append(_LETTER * max(map(len, cells)) + 2 * _PAD)
    start = 0
    for name, count in blocks[0].groups:
        short = _LETTER * len(name) + _PAD - sum(out[start : start + count])
        if short > 0 and count:
            out[start + count - 1] += short
        start += count
    return out


def _draw(axes: Axes, block: Section, widths: Sequence[float], top: float) -> None:
    right = [_SIDE + sum(widths[: n + 1]) for n in range(len(widths))]
    write(axes, _SIDE, top + 0.12, block.title, fontsize=11.5, fontweight="bold", color=ACCENT)
    start = 0
    for name, count in block.groups:
        low, high = right[start] - widths[start] + _PAD, right[start + count - 1] - _PAD / 2
        if name:
            write(axes, (low + high) / 2, top + 0.4, name, fontsize=_SIZE, ha="center", color=SOFT)
            axes.plot([low, high], [top + 0.53] * 2, color=LINE, linewidth=1)
        start += count
    head = top + _HEAD + 0.06
    _line(axes, block.columns, widths, right, head, color=SOFT)
    axes.plot([_SIDE, right[-1]], [head + 0.17] * 2, color=INK, linewidth=0.9)
    for number, (row, kind) in enumerate(zip(block.rows, block.kinds, strict=True)):
        y = head + 0.32 + _ROW * number
        if kind in _TINTS:
            box = Rectangle((_SIDE, y - _ROW / 2), right[-1] - _SIDE, _ROW, color=_TINTS[kind])
            axes.add_patch(box)
        _line(axes, row, widths, right, y, color=INK)
    bottom = head + 0.32 + _ROW * (len(block.rows) - 0.5)
    axes.plot([_SIDE, right[-1]], [bottom] * 2, color=INK, linewidth=0.9)


def _line(
    axes: Axes,
    cells: Sequence[str],
    widths: Sequence[float],
    right: Sequence[float],
    y: float,
    color: str,
) -> None:
    for number, (cell, edge) in enumerate(zip(cells, right, strict=True)):
        if number == 0:
            write(axes, edge - widths[0] + _PAD / 2, y, cell, fontsize=_SIZE, color=color)
        else:
            write(axes, edge - _PAD / 2, y, cell, fontsize=_SIZE, ha="right", color=color)


def _wrap(text: str, width: float) -> list[str]:
    return textwrap.wrap(text, max(40, int(width / 0.066))) or [""]


def write(axes: Axes, x: float, y: float, words: str, **style: Any) -> None:
    """Text as it stands: a dollar sign in a design's name is no formula."""
    style = {"va": "center", "color": INK, **style}
    axes.text(x, y, words, parse_math=False, **style)


def save(figure: Figure, path: Path, dpi: int) -> None:
    """Write a figure as PNG.

    Raises:
        InputError: where ``path`` cannot be written.
    """
    with warnings.catch_warnings():
        # A name in a script the font lacks shows boxes; that is no reason to fail or to warn.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        content = BytesIO()
        figure.savefig(content, format="png", dpi=dpi, metadata={"Software": None})
    write_file(path, content.getvalue(), "picture")
