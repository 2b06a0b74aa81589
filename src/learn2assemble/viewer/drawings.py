"""Line drawings of a plan as SVG text: elevations and the coverage chart.

Lengths are millimetres, x right, y down (SVG). Colours and states are CSS classes, so the page's
style sheet and script decide how a block looks; without a script the finished structure shows.
"""

from __future__ import annotations

from html import escape

import numpy as np

from learn2assemble.planning.plan import Plan
from learn2assemble.viewer.scene import Placed, Scene, Seen
from learn2assemble.viewer.words import percent, shares

_MARGIN = 12.0
_CHART_WIDTH, _CHART_HEIGHT = 480, 230
_LEFT, _RIGHT, _TOP, _BOTTOM = 46, 14, 16, 40


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


def elevation_svg(scene: Scene, side: int) -> str:
    """One side with its outline and the blocks seen on it, numbered by step."""
    left, right, top = (1000 * value for value in drawing_limits(scene))
    elevation, kinds = scene.elevations[side], {b.number: kind(b) for b in scene.blocks}
    width, height = right - left + 2 * _MARGIN, top + _MARGIN + 8
    outline = _points(elevation.outline)
    parts = [
        f'<svg class="elevation" viewBox="{left - _MARGIN:.1f} {-top - _MARGIN:.1f} '
        f'{width:.1f} {height:.1f}" role="img" aria-label="{escape(_describe(scene, side))}">',
        f'<polygon class="target-fill" points="{outline}"/>',
        f'<line class="ground" x1="{left - _MARGIN:.1f}" x2="{right + _MARGIN:.1f}" '
        'y1="0" y2="0"/>',
    ]
    views = scene.seen_from(side)
    for seen in views:
        parts.append(
            f'<polygon class="block {kinds[seen.number]} {seen.layer}" '
            f'data-step="{seen.number}" points="{_points(seen.polygon)}"/>'
        )
    parts.append(f'<polygon class="target-line" points="{outline}"/>')
    size = 380 * scene.edge
    for seen in _labelled(views, scene.edge):
        x, z = 1000 * seen.centre
        parts.append(
            f'<text class="label {kinds[seen.number]}" data-step="{seen.number}" x="{x:.1f}" '
            f'y="{-z + 0.36 * size:.1f}" font-size="{size:.1f}">{seen.number}</text>'
        )
    return "".join(parts) + "</svg>"


def _labelled(views: tuple[Seen, ...], edge: float) -> list[Seen]:
    """The blocks whose number is not behind another one."""
    front = [seen for seen in views if seen.layer != "behind"]
    return [
        seen
        for i, seen in enumerate(front)
        if all(np.abs(seen.centre - nearer.centre).max() > edge / 2 for nearer in front[i + 1 :])
    ]


def chart_svg(plan: Plan) -> str:
    """Coverage after every step, with the share that is needed; empty for a plan without steps."""
    steps = plan.steps
    if not steps:
        return ""
    threshold = plan.design.success_threshold
    complete, plane = shares(plan), shares(plan, plane=True)
    parts = [
        f'<svg class="chart" viewBox="0 0 {_CHART_WIDTH} {_CHART_HEIGHT}" role="img" '
        f'aria-label="Coverage after each of {len(steps)} steps, '
        f'{escape(percent(complete[-1]))} at the end">'
    ]
    for share in (0, 0.25, 0.5, 0.75, 1):
        y = _chart_y(share)
        parts.append(
            f'<line class="rule" x1="{_LEFT}" x2="{_CHART_WIDTH - _RIGHT}" y1="{y:.1f}" '
            f'y2="{y:.1f}"/><text class="tick end" x="{_LEFT - 8}" y="{y + 4:.1f}">'
            f"{share:.0%}</text>"
        )
    every = max(1, -(-len(steps) // 12))
    for number in range(0, len(steps) + 1, every):
        parts.append(
            f'<text class="tick middle" x="{_chart_x(number, len(steps)):.1f}" '
            f'y="{_CHART_HEIGHT - _BOTTOM + 18}">{number}</text>'
        )
    parts.append(
        f'<text class="tick middle" x="{(_LEFT + _CHART_WIDTH - _RIGHT) / 2:.1f}" '
        f'y="{_CHART_HEIGHT - 4}">step</text>'
    )
    y = _chart_y(threshold)
    parts.append(
        f'<line class="threshold" x1="{_LEFT}" x2="{_CHART_WIDTH - _RIGHT}" y1="{y:.1f}" '
        f'y2="{y:.1f}"/><text class="threshold-text" x="{_LEFT + 6}" y="{y + 15:.1f}">'
        f"{escape(percent(threshold))} needed</text>"
    )
    parts.append(
        f'<line class="cursor" x1="{_LEFT}" x2="{_LEFT}" y1="{_TOP}" '
        f'y2="{_CHART_HEIGHT - _BOTTOM}"/>'
    )
    if any(abs(a - b) > 1e-9 for a, b in zip(complete, plane, strict=True)):
        parts.append(f'<polyline class="plane" points="{_curve(plane)}"/>')
    parts.append(f'<polyline class="curve" points="{_curve(complete)}"/>')
    for number, share in enumerate(complete):
        parts.append(
            f'<circle class="dot" data-step="{number}" cx="{_chart_x(number, len(steps)):.1f}" '
            f'cy="{_chart_y(share):.1f}" r="4"><title>Step {number}: '
            f"{escape(percent(share))}</title></circle>"
        )
    return "".join(parts) + "</svg>"


def _describe(scene: Scene, side: int) -> str:
    seen = [s.number for s in scene.seen_from(side) if s.layer != "behind"]
    return f"{scene.elevations[side].name}: the outline and {len(seen)} blocks seen on this side"


def _points(xz: np.ndarray) -> str:
    return " ".join(f"{1000 * x:.1f},{-1000 * z:.1f}" for x, z in xz.tolist())


def _curve(values: list[float]) -> str:
    last = len(values) - 1
    return " ".join(f"{_chart_x(i, last):.1f},{_chart_y(v):.1f}" for i, v in enumerate(values))


def _chart_x(number: int, last: int) -> float:
    return _LEFT + number * (_CHART_WIDTH - _LEFT - _RIGHT) / last


def _chart_y(share: float) -> float:
    share = min(max(share, -0.05), 1.0)
    return _TOP + (1 - share) * (_CHART_HEIGHT - _TOP - _BOTTOM)
