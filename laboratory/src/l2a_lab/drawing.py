"""Curves and tables drawn into pictures."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Sequence
from io import BytesIO
from itertools import cycle
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, MaxNLocator

from l2a_lab.curves import LEARNING, LearningCurve
from l2a_lab.report import TableSection
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


_TABLE_DPI = 120


_SIDE, _ROW, _HEAD, _GAP, _LINE = 0.35, 0.27, 0.62, 0.42, 0.19
"""Border, height of a row, of a section's head, space between sections, line of notes [inch]."""


_LETTER, _PAD = 0.083, 0.16
"""Width of a letter and space beside a column [inch] at the size of the numbers."""


_SIZE = 9.5


_TINTS = {"own": "#e3f1f2", "reference": "#f1eee7"}
"""Background of rows by kind; published methods have none."""


def write_table(
    title: str, blocks: Sequence[TableSection], notes: Sequence[str], path: Path
) -> None:
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


def _widths(blocks: Sequence[TableSection]) -> list[float]:
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


def _draw(axes: Axes, block: TableSection, widths: Sequence[float], top: float) -> None:
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
