"""A picture of what was read of a design and of the cells that were chosen for it."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from learn2assemble.assembly.instructions.appearance import millimetres
from learn2assemble.errors import InputError
from learn2assemble.files import as_path, check_new, write_file
from learn2assemble.fonts import font_of
from learn2assemble.jobs.build import cells_of

if TYPE_CHECKING:
    from PIL import ImageDraw

    from learn2assemble.assembly.kit import Kit
    from learn2assemble.design.cells import CellDesign

SIDE, MARGIN, HEAD, FOOT = 420, 30, 96, 60
"""The longest side of the design, what is between panels, and heights above and below all [px]."""
_PAPER, _INK, _SOFT, _GRID = "#fbfaf8", "#1f2429", "#5a636d", "#dcd8d0"
_CELL, _DRAWN = "#ecca90", "#0b7285"


class View(NamedTuple):
    """A section through the design."""

    name: str
    across: int
    """The axis to the right: 0, 1, 2 for x, y, z."""
    up: int
    through: int
    """The axis it is seen along."""


VIEWS = (
    View("from the front", 0, 2, 1),
    View("from the right", 1, 2, 0),
    View("from above", 0, 1, 2),
)


def preview(
    design: str | Path | np.ndarray | CellDesign,
    path: str | Path,
    *,
    kit: str | Kit | None = None,
    overwrite: bool = False,
    **reading: Any,
) -> CellDesign:
    """Draw what was read of a design, and the cells that were chosen for it; nothing is planned.

    Args:
        design, kit, reading: see :func:`learn2assemble.build`.
        path: of the picture (PNG) to write, a new file.
        overwrite: also a file that is there, but none that is read.

    Returns:
        The cells.

    Raises:
        InputError: for what is no design of cells, a name that does not end in ``.png``, and a file
            that is there already.
    """
    path = as_path(path, "path")
    check_new(path, "preview", design, kit, overwrite=overwrite)
    check_png(path, "path")
    found = cells_of(design, kit, reading, preview)
    write_file(path, draw(found), "preview")
    return found


def check_png(path: Path, what: str) -> None:
    """Refuse another name for a picture that is a PNG.

    Raises:
        InputError: naming ``what`` it was given for.
    """
    if path.suffix.lower() != ".png":
        raise InputError(what, str(path), "a name that ends in .png")


def draw(design: CellDesign) -> bytes:
    """A PNG of three sections: cells to fill, and over them the surface that was drawn.

    Each section is through the middle of the layer with most cells to fill; all have one scale.
    """
    from PIL import Image, ImageDraw

    size = np.array(design.wanted.shape) * design.cell
    scale = SIDE / float(size.max())
    large, small = font_of(18), font_of(13)
    layers = [busiest(design.wanted, view.through) for view in VIEWS]
    below = [
        f"{view.name}: layer {layer + 1} of {design.wanted.shape[view.through]} "
        f"in {'xyz'[view.through]}"
        for view, layer in zip(VIEWS, layers, strict=True)
    ]
    # Panels are as large as what they show, and no narrower than the words below them.
    widths = [
        math.ceil(max(size[view.across] * scale, small.getlength(words)))
        for view, words in zip(VIEWS, below, strict=True)
    ]
    tall = math.ceil(max(size[view.up] for view in VIEWS) * scale)
    heads = [large.getlength(design.name), *map(small.getlength, _words(design))]
    wide = max(sum(widths) + MARGIN * len(VIEWS), math.ceil(max(heads)) + MARGIN) + MARGIN
    image = Image.new("RGB", (wide, HEAD + tall + MARGIN + FOOT), _PAPER)
    pen = ImageDraw.Draw(image)
    pen.text((MARGIN, 14), design.name, fill=_INK, font=large)
    for k, words in enumerate(_words(design)):
        pen.text((MARGIN, 42 + 20 * k), words, fill=_SOFT, font=small)
    left, bottom = MARGIN, HEAD + MARGIN + tall - 6
    for view, layer, words, width in zip(VIEWS, layers, below, widths, strict=True):
        _panel(pen, design, view, layer, (left, bottom), scale)
        pen.text((left, bottom + 6), words, fill=_INK, font=small)
        left += width + MARGIN
    bar = _round_length(float(size.max()) / 3)
    end, y = MARGIN + bar * scale, bottom + 42
    pen.line([(MARGIN, y - 5), (MARGIN, y), (end, y), (end, y - 5)], fill=_INK, width=2)
    pen.text((end + 8, y - 12), millimetres(bar), fill=_INK, font=small)
    out = io.BytesIO()
    image.save(out, "PNG")
    return out.getvalue()


def busiest(wanted: np.ndarray, axis: int) -> int:
    """The first layer across an axis with most cells of ``bool[X, Y, Z]``."""
    return int(wanted.sum(tuple(a for a in range(3) if a != axis)).argmax())


def section(triangles: np.ndarray, axis: int, at: float) -> np.ndarray:
    """Where triangles ``float64[N, 3, 3]`` meet a plane across an axis: ``float64[S, 2, 3]``."""
    distance = triangles[:, :, axis] - at
    above = distance > 0
    met = above.any(1) & ~above.all(1)
    triangles, distance, above = triangles[met], distance[met], above[met]
    first, last = above.argmax(1), above.argmin(1)
    lone = cast("np.ndarray", np.where(above.sum(1) == 1, first, last))
    rows = np.arange(len(lone))
    ends = list[np.ndarray]()
    for step in (1, 2):
        other = (lone + step) % 3
        start, end = distance[rows, lone], distance[rows, other]
        share = (start / (start - end))[:, None]
        a, b = triangles[rows, lone], triangles[rows, other]
        ends.append(a + (b - a) * share)
    return np.stack(ends, 1)


def _panel(
    pen: ImageDraw.ImageDraw,
    design: CellDesign,
    view: View,
    layer: int,
    corner: tuple[float, float],
    scale: float,
) -> None:
    """Cells and surface of a layer; ``corner`` is the lower left one [px]."""
    axes = [view.across, view.up]
    edge = np.array(design.cell)[axes] * scale

    def at(points: np.ndarray) -> list[tuple[float, float]]:
        """Places [px] of points [cells]."""
        # Rounded the same way on both sides of a line that is level or upright but for rounding.
        placed = np.floor(np.array(corner) + points * edge * (1, -1) + 0.5 + 1e-3)
        return [(float(x), float(y)) for x, y in placed]

    filled = design.wanted.take(layer, view.through)
    filled = filled if view.across < view.up else filled.T
    colours = None if design.colours is None else design.colours.take(layer, view.through)
    for i, j in np.ndindex(*filled.shape):
        (x0, y1), (x1, y0) = at(np.array([(i, j), (i + 1, j + 1)]))
        paint = _CELL if colours is None else tuple(colours[i, j].tolist())
        pen.rectangle((x0, y0, x1, y1), paint if filled[i, j] else None, _GRID)
    if design.surface is not None:
        # Beside the middle, where faces on planes of the lattice and its halves do not lie.
        lines = section(design.surface, view.through, layer + 0.5 + 1e-6)
        for line in lines[:, :, axes]:
            pen.line(at(line), fill=_DRAWN, width=3)


def _words(design: CellDesign) -> list[str]:
    """Cells, size, and how far they are what was drawn."""
    shape = " × ".join(map(str, design.wanted.shape))
    size = millimetres(*(n * e for n, e in zip(design.wanted.shape, design.cell, strict=True)))
    words = (
        f"{shape} cells of {millimetres(*design.cell)}, {int(design.wanted.sum())} to fill; {size}"
    )
    same = "" if design.iou is None else f"{design.iou:.1%} of drawing and cells in common"
    return [words, "; ".join(filter(None, (same, design.note)))]


def _round_length(longest: float) -> float:
    """1, 2 or 5 times a power of ten, at most so long [m]."""
    power = 10.0 ** np.floor(np.log10(longest))
    return float(max(k * power for k in (1, 2, 5) if k * power <= longest * (1 + 1e-9)))
