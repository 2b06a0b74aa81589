"""Learning curves as a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from learn2assemble.viewer.paint import ACCENT, INK, LINE, PAPER, SOFT, save

_COLOURS = (ACCENT, "#d9480f", "#5f3dc4", "#2b8a3e")
_DPI = 130
TITLES = {
    "R": "discounted return R", "f": "share ended by an invalid action f",
    "success": "share filled",
}  # fmt: skip


class Line(NamedTuple):
    """One curve with the range it stands for."""

    label: str
    samples: np.ndarray
    """float64[P]."""
    mean: Mapping[str, np.ndarray]
    """float64[P] of every quantity; likewise the next two."""
    low: Mapping[str, np.ndarray]
    high: Mapping[str, np.ndarray]


def write_curves(title: str, lines: Sequence[Line], note: str, path: Path) -> None:
    """Draw R large and f and success beside it, over samples, into a PNG.

    Raises:
        InputError: where ``path`` cannot be written.
    """
    figure = Figure(figsize=(11.5, 5.0), dpi=_DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)
    figure.text(0.05, 0.94, title, fontsize=14, fontweight="bold", color=INK, va="center")
    figure.text(0.05, 0.035, note, fontsize=8, color=SOFT, va="center")
    grid = figure.add_gridspec(
        2, 2, width_ratios=(2, 1), left=0.06, right=0.98, top=0.86, bottom=0.14, wspace=0.16,
        hspace=0.42,
    )  # fmt: skip
    places = {"R": grid[:, 0], "f": grid[0, 1], "success": grid[1, 1]}
    for quantity, place in places.items():
        axes = figure.add_subplot(place)
        _panel(axes, quantity, lines)
        if quantity == "R":
            axes.legend(loc="lower right", frameon=False, fontsize=10, labelcolor=INK)
            axes.set_xlabel("training samples", fontsize=9, color=SOFT)
    save(figure, path, _DPI)


def _panel(axes: Axes, quantity: str, lines: Sequence[Line]) -> None:
    for line, colour in zip(lines, _COLOURS, strict=False):
        axes.plot(line.samples, line.mean[quantity], color=colour, linewidth=1.8, label=line.label)
        axes.fill_between(
            line.samples, line.low[quantity], line.high[quantity], color=colour, alpha=0.15,
            linewidth=0,
        )  # fmt: skip
    axes.set_title(TITLES[quantity], fontsize=10, color=INK, loc="left")
    axes.set_facecolor(PAPER)
    axes.set_xlim(left=0)
    if quantity != "R":
        axes.set_ylim(-0.02, 1.02)
    axes.grid(color=LINE, linewidth=0.7)
    axes.set_axisbelow(True)
    axes.tick_params(colors=SOFT, labelsize=8.5, length=0)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.xaxis.set_major_formatter(FuncFormatter(_thousands))
    for side in axes.spines.values():
        side.set_visible(False)


def _thousands(value: float, _position: int | None = None) -> str:
    return f"{value / 1000:g}k" if value else "0"
