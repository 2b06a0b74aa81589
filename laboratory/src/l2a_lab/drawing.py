"""Curves drawn into pictures."""

# pyright: reportUnknownMemberType=false
# (matplotlib names no types of its options)
from __future__ import annotations

import warnings
from collections.abc import Sequence
from io import BytesIO
from itertools import cycle
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from l2a_lab.curves import LEARNING, LearningCurve
from learn2assemble.files import write_file
from learn2assemble.viewer.picture import ACCENT, INK, LINE, PAPER, SOFT

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


def write_curves(
    title: str,
    lines: Sequence[LearningCurve],
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


def _panel(axes: Axes, quantity: str, lines: Sequence[LearningCurve]) -> None:
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
