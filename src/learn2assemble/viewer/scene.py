"""A plan as geometry, and its flat drawings as marks: what the page and the picture both draw.

World frame, z up [m]. Number 0 is the first block, number ``n`` the block of step ``n``; the
same numbers stand on the blocks in every drawing and in the table of steps.

In SVG colours and states of marks are CSS classes, so the page's style sheet and script decide how
a block looks; without a script the finished structure shows. :mod:`~.picture` paints the same ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from html import escape
from typing import NamedTuple

import numpy as np

from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.planning.plan import FirstBlock, Plan, Step
from learn2assemble.viewer.words import percent, shares

_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
_TOLERANCE = 0.002
"""Blocks this close to each other [m] count as touching; a robot places within a millimetre."""


@dataclass(frozen=True)
class Placed:
    """One block of the structure."""

    number: int
    """0 for the first block, else the step that places it."""
    waiting: int | None
    """Index of its waiting place; None for the first block."""
    position: np.ndarray
    """float64[3]: centre [m, world]."""
    quaternion: np.ndarray
    """float64[4]: unit orientation (w, x, y, z)."""
    outside: bool
    """Stands outside every outline: a support."""

    @property
    def rotation(self) -> np.ndarray:
        """R_world_block, float64[3, 3]."""
        return quaternion_matrix(self.quaternion)

    def corners(self, edge: float) -> np.ndarray:
        """float64[8, 3] [m, world]."""
        return self.position + (edge / 2 * _CORNERS) @ self.rotation.T


@dataclass(frozen=True)
class Elevation:
    """One side of the target. Its local frame: x right, y away from the viewer, z up."""

    name: str
    frame: np.ndarray
    """float64[4]: (cos, sin, t_x, t_y) of p_world = R_z p_local + t."""
    outline: np.ndarray
    """float64[V, 2]: local (x, z) [m] in the face plane."""

    def to_local(self, points: np.ndarray) -> np.ndarray:
        """World points to local points, ``float64[..., 3]`` [m]."""
        c, s, tx, ty = self.frame
        x, y = points[..., 0] - tx, points[..., 1] - ty
        return np.stack([c * x + s * y, c * y - s * x, points[..., 2]], -1)

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """Local points to world points, ``float64[..., 3]`` [m]."""
        c, s, tx, ty = self.frame
        x, y = points[..., 0], points[..., 1]
        return np.stack([c * x - s * y + tx, s * x + c * y + ty, points[..., 2]], -1)

    def face(self, edge: float) -> np.ndarray:
        """The outline in the face plane ``y = -edge / 2``: float64[V, 3] [m, world]."""
        x, z = self.outline.T
        return self.to_world(np.stack([x, np.full_like(x, -edge / 2), z], -1))


@dataclass(frozen=True)
class Seen:
    """A block as one side sees it: its shadow on the face plane and how deep it stands."""

    number: int
    polygon: np.ndarray
    """float64[K, 2]: convex, local (x, z) [m]."""
    centre: np.ndarray
    """float64[2]: local (x, z) [m]."""
    layer: str
    """``front`` of the face plane, in the ``face`` row of blocks, or ``behind`` it."""


@dataclass(frozen=True)
class Scene:
    """Everything that is drawn of one plan."""

    edge: float
    """Edge of a block [m]."""
    blocks: tuple[Placed, ...]
    """In order of placement, the first block first."""
    elevations: tuple[Elevation, ...]
    waiting: np.ndarray
    """float64[W, 3]: where the blocks wait in the drawings [m, world]."""
    first: int | None
    """Row of ``waiting`` that is the first block itself, which never waits."""
    rearranged: bool
    """The plan's waiting places cannot be drawn as they are, so a tray is drawn instead."""

    @property
    def num_steps(self) -> int:
        """Blocks placed after the first."""
        return max((block.number for block in self.blocks), default=0)

    def seen_from(self, side: int) -> tuple[Seen, ...]:
        """What side ``side`` sees, farthest first (painter's order)."""
        elevation, seen = self.elevations[side], []
        for block in self.blocks:
            x, y, z = elevation.to_local(block.position)
            layer = "face" if abs(y) < self.edge / 2 else "front" if y < 0 else "behind"
            corners = elevation.to_local(block.corners(self.edge))[:, [0, 2]]
            seen.append((-y, Seen(block.number, hull(corners), np.array([x, z]), layer)))
        return tuple(item for _, item in sorted(seen, key=lambda pair: pair[0]))


def read_scene(plan: Plan) -> Scene:
    """The geometry of a plan."""
    edge = plan.design.block_edge
    elevations = tuple(
        Elevation(side.name, np.array(frame), np.array(side.outline, float).reshape(-1, 2))
        for side, frame in zip(plan.design.elevations, plan.design.frames, strict=True)
    )
    placed = [plan.first_block, *plan.steps] if plan.first_block else plan.steps
    blocks = tuple(
        _placed(number, step)
        for number, step in enumerate(placed, len(plan.steps) - len(placed) + 1)
    )
    waiting = np.array(plan.blocks.waiting, float).reshape(-1, 3)
    first = _first_row(plan, waiting, edge)
    rows = [row for row in range(len(waiting)) if row != first]
    drawn = waiting.copy()
    rearranged = _needs_tray(waiting[rows], blocks, edge)
    if rearranged:
        drawn[rows] = _tray(len(rows), blocks, edge)
    return Scene(edge, blocks, elevations, drawn, first, rearranged)


def _first_row(plan: Plan, waiting: np.ndarray, edge: float) -> int | None:
    """The row of ``waiting`` where the first block already stands, if it has one."""
    block = plan.first_block
    if block is None or block.block >= len(waiting) or block.block in {s.block for s in plan.steps}:
        return None
    near = np.abs(waiting[block.block] - block.position).max() < edge / 2
    return block.block if near else None


def _placed(number: int, step: Step | FirstBlock) -> Placed:
    outside = isinstance(step, Step) and step.outside
    quaternion = np.array(step.quaternion)
    quaternion /= np.linalg.norm(quaternion)
    waiting = step.block if number else None
    return Placed(number, waiting, np.array(step.position), quaternion, outside)


def _needs_tray(waiting: np.ndarray, blocks: tuple[Placed, ...], edge: float) -> bool:
    """Whether the waiting places cannot be drawn as planned.

    Without a robot they are node positions, not bodies: they may overlap, sink
    into the table or hide the structure.
    """
    if not len(waiting):
        return False
    built = np.array([block.position for block in blocks]).reshape(-1, 3)
    return bool(
        np.any(waiting[:, 2] < edge / 2 - _TOLERANCE)
        or np.any(np.ptp(waiting, axis=0) > 24 * edge)
        or _touch(waiting, waiting, edge) > len(waiting)
        or _touch(waiting, built, 2 * edge) > 0
    )


def _tray(count: int, blocks: tuple[Placed, ...], edge: float) -> np.ndarray:
    """Rows of waiting blocks in front of side 1: float64[count, 3] [m, world]."""
    built = np.array([block.position for block in blocks]).reshape(-1, 3)
    columns = max(math.ceil(math.sqrt(2.6 * count)), 1)
    pitch = 1.4 * edge
    row, column = np.divmod(np.arange(count), columns)
    in_row = np.minimum(count - row * columns, columns)
    front = built[:, 1].min() if len(built) else 0.0
    middle = (built[:, 0].min() + built[:, 0].max()) / 2 if len(built) else 0.0
    x = middle + (column - (in_row - 1) / 2) * pitch
    return np.stack([x, front - 3 * edge - row * pitch, np.full(count, edge / 2)], -1)


def _touch(these: np.ndarray, those: np.ndarray, distance: float) -> int:
    """Pairs nearer than ``distance`` [m] along every axis."""
    gap = np.abs(these[:, None] - those[None]).max(-1, initial=0.0)
    return int((gap < distance - _TOLERANCE).sum())


def hull(points: np.ndarray) -> np.ndarray:
    """Convex hull of float64[n, 2] in counter-clockwise order (monotone chain).

    Corners within a micrometre of an edge are left out.
    """
    ordered = sorted({(round(x, 6), round(y, 6)) for x, y in points.tolist()})
    if len(ordered) < 3:
        return np.array(ordered)

    def chain(items: list[tuple[float, float]]) -> list[tuple[float, float]]:
        out: list[tuple[float, float]] = []
        for p in items:
            while len(out) > 1 and _turn(out[-2], out[-1], p) <= 1e-9:
                out.pop()
            out.append(p)
        return out[:-1]

    return np.array(chain(ordered) + chain(ordered[::-1]))


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Twice the signed area of the triangle a b c: positive for a left turn."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


# ---------------------------------------------------------------- flat drawings


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
