"""Brush strokes of the picture: filled shapes, outlines, numbers and text on matplotlib axes."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.patches import PathPatch, Polygon
from matplotlib.path import Path as Curve
from matplotlib.textpath import TextPath

from learn2assemble.errors import InputError

PAPER, INK, SOFT, LINE, TABLE = "#fbfaf8", "#1f2429", "#5a636d", "#dcd8d0", "#eeeae2"
ACCENT, GOOD, RIM = "#0b7285", "#17663c", "#4a3b26"
COLOURS = {
    "first": "#e0764a", "wall": "#ecca90", "current": "#63b0f2", "support": "#aeb9c4",
}  # fmt: skip
"""Colours of blocks, the same as in the page's style sheet."""


def fill(
    axes: Axes, points: np.ndarray, colour: Any, *, alpha: float = 1, edge: Any = "none",
    width: float = 0.0,
) -> None:  # fmt: skip
    axes.add_patch(
        Polygon(
            points,
            closed=True,
            facecolor=colour,
            edgecolor=edge,
            linewidth=width,
            alpha=alpha,
            joinstyle="round",
            zorder=2,
        )
    )


def draw_outline(axes: Axes, points: np.ndarray, width: float = 2.0, alpha: float = 1) -> None:
    axes.add_patch(
        Polygon(
            points,
            closed=True,
            fill=False,
            edgecolor=ACCENT,
            linewidth=width,
            alpha=alpha,
            joinstyle="round",
            zorder=2,
        )
    )


def fill_area(
    axes: Axes, area: Any, to_picture: Callable[[np.ndarray], np.ndarray], colour: str, alpha: float
) -> None:
    """Fill a plane area, holes and all, after mapping its points (n, 2) into the picture."""
    for part in getattr(area, "geoms", [area]):
        if part.is_empty or part.geom_type != "Polygon":
            continue
        rings = [np.asarray(r.coords) for r in (part.exterior, *part.interiors)]
        curve = Curve.make_compound_path(*[Curve(to_picture(r), closed=True) for r in rings])
        axes.add_patch(PathPatch(curve, facecolor=colour, edgecolor="none", alpha=alpha, zorder=2))


def number_on(axes: Axes, number: int, corners: np.ndarray) -> None:
    """The number of a block, lying in its face."""
    path = TextPath((0, 0), str(number), size=0.37, prop=FontProperties(weight="bold"))
    box = path.get_extents()
    vertices = path.vertices - [(box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2] + [0.5, 0.5]
    basis = np.array([corners[1] - corners[0], corners[3] - corners[0]])
    placed = Curve(corners[0] + vertices @ basis, path.codes)
    axes.add_patch(PathPatch(placed, facecolor=INK, edgecolor="none", alpha=0.82, zorder=2))


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
        try:
            figure.savefig(path, format="png", dpi=dpi, metadata={"Software": None})
        except OSError as error:
            raise InputError("picture", str(path), f"a writable file ({error.strerror})") from None
