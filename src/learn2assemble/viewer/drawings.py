"""Flat drawings of a plan, elevations and the coverage chart, as marks that SVG and PNG both draw.

In SVG colours and states are CSS classes, so the page's style sheet and script decide how a block
looks; without a script the finished structure shows. :mod:`~.picture` paints the same marks.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from html import escape
from typing import NamedTuple

import numpy as np

from learn2assemble.planning.plan import Plan
from learn2assemble.viewer.scene import Placed, Scene, Seen
from learn2assemble.viewer.words import percent, shares

_CHART = (420.0, 174.0)
"""Width of all steps and height of a full share in the SVG chart [px]."""
_LETTERS = 13 / _CHART[1]
"""Height of the chart's letters, in shares."""


class Mark(NamedTuple):
    """One shape of a drawing, x right and y up."""

    shape: str
    """``polygon``, ``line``, ``dot`` or ``text``."""
    points: np.ndarray
    """float64[n, 2]; of a text the middle of its height at its anchor."""
    style: str
    """CSS classes; the first one says what it is."""
    step: int | None = None
    """The step it belongs to."""
    text: str = ""
    size: float = 0.0
    """Height of the font, in units of y."""


def kind(block: Placed) -> str:
    """``first``, ``support`` or ``wall``: the colour of a block in every drawing."""
    if block.number == 0:
        return "first"
    return "support" if block.outside else "wall"


def drawing_limits(scene: Scene) -> tuple[float, float, float]:
    """Left, right and top [m] that hold every elevation, so that all have the same scale."""
    points = [elevation.outline for elevation in scene.elevations]
    points += [s.polygon for i in range(len(points)) for s in scene.seen_from(i)]
    every = np.concatenate(points)
    return float(every[:, 0].min()), float(every[:, 0].max()), float(every[:, 1].max())


def elevation_marks(scene: Scene, side: int) -> Iterator[Mark]:
    """One side with its outline and the blocks seen on it, numbered by step, in painter's order.

    Units: metres in the local frame of the side.
    """
    left, right, _ = drawing_limits(scene)
    outline, views = scene.elevations[side].outline, scene.seen_from(side)
    kinds, pad = {block.number: kind(block) for block in scene.blocks}, 0.24 * scene.edge
    yield Mark("polygon", outline, "target-fill")
    yield Mark("line", np.array([[left - pad, 0.0], [right + pad, 0.0]]), "ground")
    for seen in views:
        style = f"block {kinds[seen.number]} {seen.layer}"
        yield Mark("polygon", seen.polygon, style, seen.number)
    yield Mark("polygon", outline, "target-line")
    for seen in _labelled(views, scene.edge):
        style, size = f"label {kinds[seen.number]}", 0.38 * scene.edge
        yield Mark("text", seen.centre[None], style, seen.number, str(seen.number), size)


def chart_marks(plan: Plan) -> Iterator[Mark]:
    """Coverage (y) after every step (x), with the share that is needed."""
    values, plane = shares(plan), shares(plan, plane=True)
    last, threshold = len(plan.steps), plan.design.success_threshold

    def line(style: str, *points: tuple[float, float]) -> Mark:
        return Mark("line", np.array(points, float), style)

    def text(style: str, x: float, y: float, words: str) -> Mark:
        return Mark("text", np.array([[x, y]]), style, text=words, size=_LETTERS)

    for share in (0, 0.25, 0.5, 0.75, 1):
        yield line("rule", (0, share), (last, share))
        yield text("tick end", -0.02 * last, share, f"{share:.0%}")
    for number in range(0, last + 1, max(1, -(-last // 10))):
        yield text("tick middle", number, -0.1, str(number))
    yield text("tick middle", last / 2, -0.2, "step")
    yield line("threshold", (0, threshold), (last, threshold))
    yield text("threshold-text", 0.015 * last, threshold - 0.06, f"{percent(threshold)} needed")
    yield line("cursor", (0, 0), (0, 1))
    if any(abs(a - b) > 1e-9 for a, b in zip(values, plane, strict=True)):
        yield line("plane", *enumerate(plane))
    yield line("curve", *enumerate(values))
    for number, share in enumerate(values):
        yield Mark("dot", np.array([[number, share]]), "dot", number,
                   f"Step {number}: {percent(share)}")  # fmt: skip


def elevation_svg(scene: Scene, side: int) -> str:
    """One side as SVG text, in millimetres."""
    left, right, top = drawing_limits(scene)
    pad = 0.24 * scene.edge
    seen = [s for s in scene.seen_from(side) if s.layer != "behind"]
    words = f"{scene.elevations[side].name}: the outline and {len(seen)} blocks seen on this side"
    box = (left - pad, -0.16 * scene.edge, right + pad, top + pad)
    return _svg("elevation", elevation_marks(scene, side), (1000, 1000), box, words)


def chart_svg(plan: Plan) -> str:
    """The coverage chart as SVG text; empty for a plan without steps."""
    last = len(plan.steps)
    if not last:
        return ""
    end = percent(plan.steps[-1].coverage)
    words = f"Coverage after each of {last} steps, {end} at the end"
    scale = (_CHART[0] / last, _CHART[1])
    box = (-46 / scale[0], -0.25, last + 14 / scale[0], 1.09)
    return _svg("chart", chart_marks(plan), scale, box, words)


def _svg(
    name: str, marks: Iterable[Mark], scale: tuple[float, float],
    box: tuple[float, float, float, float], words: str,
) -> str:  # fmt: skip
    """Marks as SVG text: ``scale`` units of SVG for one of the drawing, ``box`` what is shown."""
    (x0, y0, x1, y1), (across, up) = box, scale
    view = f"{x0 * across:.1f} {-y1 * up:.1f} {(x1 - x0) * across:.1f} {(y1 - y0) * up:.1f}"
    return (
        f'<svg class="{name}" viewBox="{view}" role="img" aria-label="{escape(words)}">'
        + "".join(_element(mark, mark.points * [across, -up], mark.size * up) for mark in marks)
        + "</svg>"
    )


def _element(mark: Mark, points: np.ndarray, size: float) -> str:
    step = "" if mark.step is None else f' data-step="{mark.step}"'
    head, (x, y) = f'class="{mark.style}"{step}', points[0]
    if mark.shape == "text":
        place = f'x="{x:.1f}" y="{y + 0.36 * size:.1f}" font-size="{size:.1f}"'
        return f"<text {head} {place}>{escape(mark.text)}</text>"
    if mark.shape == "dot":
        title = f"<title>{escape(mark.text)}</title>"
        return f'<circle {head} cx="{x:.1f}" cy="{y:.1f}" r="4">{title}</circle>'
    if mark.shape == "line" and len(points) == 2:
        (x1, y1), (x2, y2) = points
        return f'<line {head} x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"/>'
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points.tolist())
    return f'<{"polygon" if mark.shape == "polygon" else "polyline"} {head} points="{path}"/>'


def _labelled(views: tuple[Seen, ...], edge: float) -> list[Seen]:
    """The blocks whose number is not behind another one."""
    front = [seen for seen in views if seen.layer != "behind"]
    return [
        seen
        for i, seen in enumerate(front)
        if all(np.abs(seen.centre - nearer.centre).max() > edge / 2 for nearer in front[i + 1 :])
    ]
