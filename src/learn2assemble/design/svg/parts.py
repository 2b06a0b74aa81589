"""What an SVG drawing paints, part by part, and the regions that are left of it."""

from __future__ import annotations

import difflib
import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from learn2assemble.design.drawings import (
    FINE,
    MAX_VERTICES,
    SIDES,
    Drawing,
    DrawnShape,
    Layer,
    to_drawing,
)
from learn2assemble.design.svg.paths import Curve, LengthContext, Matrix
from learn2assemble.errors import InputError
from learn2assemble.files import FARTHEST

PAPER = 250
"""Red, green and blue from which a colour is that of paper."""
OPAQUE = 0.98
"""Opacity from which nothing shows through."""


@dataclass(frozen=True, eq=False)
class PaintedPart:
    """What one element paints.

    Args:
        curves: its outline in coordinates of the drawing, y down.
        alpha: opacity of what is filled; 0 where nothing is.
        clips: regions it is confined to, each painted by parts of its own.
        cuts: parts that hide it, and nothing else.
    """

    curves: tuple[Curve, ...]
    even_odd: bool
    colour: tuple[int, int, int] = (0, 0, 0)
    alpha: float = 1.0
    stroked: bool = False
    layer: str | None = None
    clips: tuple[tuple[PaintedPart, ...], ...] = ()
    cuts: tuple[PaintedPart, ...] = ()

    @property
    def paper(self) -> bool:
        """Whether it hides what is below it."""
        return self.alpha >= OPAQUE and min(self.colour) >= PAPER

    @property
    def inked(self) -> bool:
        """Whether what it fills is seen on paper."""
        return 255 - self.alpha * (255 - min(self.colour)) < PAPER

    @property
    def seen(self) -> bool:
        """Whether it changes anything."""
        return self.paper or self.inked or self.stroked


@dataclass(frozen=True)
class Page:
    """The view of the whole drawing.

    Args:
        matrix: from units of the view box to those of the drawing, which are as high as they.
        frame: size of the view box.
        window: x, y, width, height of what is visible; None where only a window would say.
        metres: length of a unit [m]; None where the file does not say.
    """

    matrix: Matrix
    frame: LengthContext
    window: tuple[float, float, float, float] | None
    metres: float | None


def counted(found: Counter[str]) -> str:
    """Numbers of things in words."""
    plural = {
        "foreign object": "foreign objects",
        "reference to another file": "references to other files",
        "transform of the whole": "transforms of the whole",
        "transform with a percentage": "transforms with a percentage",
        "text in a clip path": "texts in clip paths",
    }

    def word(name: str, number: int) -> str:
        thing, error, rest = name.partition(" with an error")
        return name if number == 1 else plural.get(name, f"{thing}s{error}{rest}")

    return ", ".join(f"{n} {word(name, n)}" for name, n in sorted(found.items()) if n > 0)


def paint(parts: list[PaintedPart], page: Page, not_read: Counter[str], source: str) -> Drawing:
    """The drawing that parts make; closed outlines are material where nothing is filled."""
    parts = [part for part in parts if part.seen]
    outlines = not any(part.inked for part in parts)
    convert = _Converted(parts, page, source)
    layers: dict[str | None, Layer] = {}
    lines: dict[str | None, list[tuple[PaintedPart, list[np.ndarray]]]] = {}
    outside = 0
    for part in parts:
        shape = convert.shape(part)
        if outlines and part.stroked:
            closed = [c for curve in part.curves if (c := convert.outline(curve)) is not None]
            lines.setdefault(part.layer, []).append((part, closed))
            not_read["stroke"] += len(closed) < len(part.curves)
            continue
        not_read["stroke"] += part.stroked
        if part.paper or part.inked:
            layers.setdefault(part.layer, Layer()).filled.append(shape)
            outside += part.inked and convert.is_outside(shape)
    for name, drawn in lines.items():
        for _, group in itertools.groupby(drawn, lambda item: list(map(id, item[0].clips))):
            items = list(group)
            contours = [contour for _, closed in items for contour in closed]
            if contours:
                clips = convert.shape(items[0][0]).clips
                shape = DrawnShape(contours, True, clips=clips, order=convert.number)
                layers.setdefault(name, Layer()).filled.append(shape)
    layers = _named(layers)
    said = _said(not_read, outside)
    if not any(shape.contours for layer in layers.values() for shape in layer.filled):
        got = "no closed outline" + (f"; {said}" if said else "")
        expected = "a filled path, rect, circle or polygon, or closed outlines"
        raise InputError(source, got, expected)
    drawing = to_drawing(layers, page.metres, source)
    return replace(drawing, not_read=said)


def _said(not_read: Counter[str], outside: int) -> str | None:
    """What is not read, in one line."""
    said = list[str]()
    if words := counted(not_read):
        can = any(not_read[name] for name in ("text", "stroke", "text in a clip path"))
        said.append(f"not read: {words}" + (": convert them to paths" if can else ""))
    if outside:
        said.append(f"outside the page: {outside} shape{'s' * (outside > 1)}")
    return "; ".join(said) or None


def _named(layers: dict[str | None, Layer]) -> dict[str | None, Layer]:
    """Layers that are sides; groups of any other names are one drawing where none is a side."""
    inked = {
        name: layer for name, layer in layers.items() if not all(s.paper for s in layer.filled)
    }
    if any((name or "").casefold() in SIDES for name in inked):
        return inked
    near = [n for n in inked if n and difflib.get_close_matches(n.casefold(), SIDES, 1, 0.85)]
    if len(inked) > 1 and near:
        return inked  # Somebody mistyped a side; whoever reads the names says so.
    filled = [shape for layer in layers.values() for shape in layer.filled]
    return {None: Layer(sorted(filled, key=lambda shape: shape.order))}


class _Converted:
    """Parts as shapes: curves as lines, z up.

    Args:
        parts: all of them.
        page: its size says how fine lines are.
        source: the file, as messages call it.
    """

    def __init__(self, parts: Sequence[PaintedPart], page: Page, source: str) -> None:
        self.page, self.source = page, source
        points = [curve.points for part in parts for curve in part.curves]
        span = float(np.ptp(np.concatenate(points), axis=0).max()) if points else 1.0
        if page.window:
            span = min(span, max(page.window[2:]))
        curves = sum(len(curve.cubics) for part in parts for curve in part.curves)
        self.tolerance = max(FINE * span, 1e-300)
        self.most = int(np.clip(MAX_VERTICES // 2 // max(curves, 1), 4, 48))
        self.known: dict[int, tuple[DrawnShape, ...]] = {}
        self.number = 0

    def _points(self, curve: Curve) -> np.ndarray:
        if not np.abs(curve.points).max() <= FARTHEST:
            got = "coordinates that are not numbers or beyond 1e9"
            raise InputError(self.source, got, "a drawing")
        return curve.flat(self.tolerance, self.most) * (1, -1)

    def shape(self, part: PaintedPart) -> DrawnShape:
        """A part as a shape."""
        flat = [self._points(curve) for curve in part.curves]
        contours = [points for points in flat if _has_extent(points)]
        clips = tuple(map(self._region, part.clips))
        self.number += 1
        return DrawnShape(
            contours,
            part.even_odd,
            part.paper,
            part.colour,
            clips,
            self._region(part.cuts),
            self.number,
        )

    def _region(self, parts: tuple[PaintedPart, ...]) -> tuple[DrawnShape, ...]:
        """The same of a clip path; what several share stays one."""
        if not parts:
            return ()
        if id(parts) not in self.known:
            self.known[id(parts)] = tuple(map(self.shape, parts))
        return self.known[id(parts)]

    def outline(self, curve: Curve) -> np.ndarray | None:
        """A subpath as a closed outline; None where it is open, or a line."""
        points = self._points(curve)
        if not _has_extent(points):
            return None
        near = 1e-3 * np.ptp(points, axis=0).max()
        return points if curve.closed or np.abs(points[0] - points[-1]).max() <= near else None

    def is_outside(self, shape: DrawnShape) -> bool:
        """Whether nothing of a shape is on the page."""
        if not self.page.window or not shape.contours:
            return False
        x, y, wide, high = self.page.window
        points = np.concatenate(shape.contours)
        low, top = points.min(0), points.max(0)
        return bool(low[0] >= x + wide or top[0] <= x or low[1] >= -y or top[1] <= -y - high)


def _has_extent(points: np.ndarray) -> bool:
    return len(points) >= 3 and bool(np.ptp(points, axis=0).max() > 0)
