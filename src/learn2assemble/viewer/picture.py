"""The progress of a build as one picture: some moments in 3-D, the elevations and the coverage.

In 3-D the viewer stands at the front left and above (parallel projection); picture coordinates are
``(right, up)`` in metres.
"""

from __future__ import annotations

import heapq
import textwrap
import warnings
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.patches import PathPatch, Polygon
from matplotlib.path import Path as Curve
from matplotlib.textpath import TextPath
from shapely.geometry import Polygon as Area
from shapely.geometry import box
from shapely.ops import unary_union

from learn2assemble.files import write_file
from learn2assemble.planning.plan import Plan
from learn2assemble.viewer.scene import (
    Mark,
    Placed,
    Scene,
    chart_marks,
    drawing_limits,
    elevation_marks,
    hull,
    kind,
    read_scene,
)
from learn2assemble.viewer.words import percent, placement, shares

TO_VIEWER = np.array([-0.52, -1.0, 0.62]) / np.linalg.norm([-0.52, -1.0, 0.62])
"""float64[3]: unit direction from the structure to the viewer, world frame."""
_RIGHT = np.cross([0.0, 0.0, 1.0], TO_VIEWER) / np.linalg.norm(TO_VIEWER[:2])
_UP = np.cross(TO_VIEWER, _RIGHT)
_SUN = np.array([-0.35, -0.8, 1.0])
"""Direction to the light."""
_SHADE = np.array([-0.55, -0.12])
"""Shadows fall to the right, where the viewer sees them; a drawing may light them apart."""
_FACES = (
    (0, 1, (1, 1), (2, 1)),
    (0, -1, (1, -1), (2, 1)),
    (1, 1, (0, -1), (2, 1)),
    (1, -1, (0, 1), (2, 1)),
    (2, 1, (0, 1), (1, 1)),
    (2, -1, (0, 1), (1, -1)),
)
"""Every face of a cube: outward axis and sign, then its right and up axes as seen from outside."""


class Face(NamedTuple):
    """A visible face of a block."""

    corners: np.ndarray
    """float64[4, 2]: in the picture; lower left, lower right, upper right, upper left."""
    normal: np.ndarray
    """float64[3]: outward, world frame."""
    light: float
    """0 to 1, how bright it is."""


def project(points: np.ndarray) -> np.ndarray:
    """World points ``float64[..., 3]`` to picture points ``float64[..., 2]`` [m]."""
    return np.stack([points @ _RIGHT, points @ _UP], -1)


def shadow(points: np.ndarray) -> np.ndarray:
    """Where the light casts world points onto the table: ``float64[..., 2]``, world (x, y) [m]."""
    return points[..., :2] - points[..., 2:] * _SHADE


def visible_faces(block: Placed, edge: float) -> list[Face]:
    """The faces of a cube that are turned to the viewer."""
    faces, rotation, half = [], block.rotation, edge / 2
    for axis, sign, (right, right_sign), (up, up_sign) in _FACES:
        normal = sign * rotation[:, axis]
        if normal @ TO_VIEWER <= 1e-9:
            continue
        u, v = right_sign * rotation[:, right], up_sign * rotation[:, up]
        square = [normal - u - v, normal + u - v, normal + u + v, normal - u + v]
        corners = project(block.position + half * np.array(square))
        light = 0.7 + 0.3 * max(float(normal @ _SUN) / _SUN[2], 0.0)
        faces.append(Face(corners, normal, min(light, 1.0)))
    return faces


def numbered_face(faces: list[Face], block: Placed, others: np.ndarray, edge: float) -> Face | None:
    """The upright face that shows best and has no other block against it.

    Args:
        faces: of :func:`visible_faces`.
        others: float64[n, 3], centres of the blocks that stand [m, world].
    """
    best: Face | None = None
    for face in faces:
        neighbour = np.abs(others - block.position - edge * face.normal).max(-1, initial=0.0)
        free = not bool((neighbour < 0.6 * edge).any())
        upright = abs(face.normal[2]) < 0.7
        if upright and free and (best is None or face.normal @ TO_VIEWER > best.normal @ TO_VIEWER):
            best = face
    return best


def painters_order(positions: np.ndarray, edge: float) -> list[int]:
    """Indices of equal cubes so that each is drawn after all it hides.

    Comparing centre depths is wrong for cubes off a common lattice, so every pair that overlaps
    in the picture is compared along the axis that separates it, and the pairs are sorted
    topologically. Cubes are taken as aligned with the axes.

    Args:
        positions: float64[n, 3], centres [m, world].
        edge: [m].
    """
    count = len(positions)
    if not count:
        return []
    apart = positions[:, None] - positions[None]
    axis = np.argmax(np.abs(apart), -1)
    along = np.take_along_axis(apart, axis[..., None], -1)[..., 0]
    nearer = (along * TO_VIEWER[axis] > 0) & _overlap_in_picture(apart, edge)
    blockers = nearer.sum(1)
    depth = positions @ TO_VIEWER
    ready = [(depth[i], i) for i in range(count) if not blockers[i]]
    heapq.heapify(ready)
    order: list[int] = []
    while ready:
        _, first = heapq.heappop(ready)
        order.append(first)
        for i in np.flatnonzero(nearer[:, first]).tolist():
            blockers[i] -= 1
            if not blockers[i]:
                heapq.heappush(ready, (depth[i], i))
    missing = set(range(count)).difference(order)  # Only cubes that interpenetrate get here.
    return order + sorted(missing, key=lambda i: depth[i])


def _overlap_in_picture(apart: np.ndarray, edge: float) -> np.ndarray:
    """Whether two cubes this far apart share picture points: their difference meets the ray."""
    enter = (-edge - np.sign(TO_VIEWER) * apart) / np.abs(TO_VIEWER)
    leave = (edge - np.sign(TO_VIEWER) * apart) / np.abs(TO_VIEWER)
    return enter.max(-1) < leave.min(-1) - 1e-9


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
    style = {"linewidth": width, "alpha": alpha, "joinstyle": "round", "zorder": 2}
    axes.add_patch(Polygon(points, closed=True, facecolor=colour, edgecolor=edge, **style))


def draw_outline(axes: Axes, points: np.ndarray, width: float = 2.0, alpha: float = 1) -> None:
    fill(axes, points, "none", alpha=alpha, edge=ACCENT, width=width)


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
        content = BytesIO()
        figure.savefig(content, format="png", dpi=dpi, metadata={"Software": None})
    write_file(path, content.getvalue(), "picture")


WIDTH = 1600
"""Width of the picture [px]."""
MAX_MOMENTS = 8
_DPI = 100
_HEAD, _MOMENT_CAPTION, _FOOT = 118, 62, 330
"""Heights of the title, of the text under a moment and of the last row [px]."""
_SIDE = 56
"""Empty border at the left and right [px]."""


def write_progress(plan: Plan, path: Path) -> None:
    """Write the picture of a plan to ``path`` (PNG, 1600 px wide).

    Raises:
        InputError: for a path that cannot be written.
    """
    save(draw_progress(plan, read_scene(plan)), path, _DPI)


def moments(num_steps: int) -> list[int]:
    """The steps that are shown, from the first block (0) to the last step."""
    count = min(MAX_MOMENTS, num_steps + 1)
    return np.unique(np.linspace(0, num_steps, count).round().astype(int)).tolist()


def draw_progress(plan: Plan, scene: Scene) -> Figure:
    """The figure, laid out in pixels from the top left."""
    shown = moments(scene.num_steps)
    columns = len(shown) if len(shown) <= 4 else -(-len(shown) // 2)
    columns_drawn = max(columns, 3)
    rows = -(-len(shown) // columns)
    frame = _Frame(scene)
    cell = (WIDTH - 2 * _SIDE) / columns_drawn
    drawn = cell * frame.height / frame.width
    height = round(_HEAD + rows * (drawn + _MOMENT_CAPTION) + _FOOT)
    figure = Figure(figsize=(WIDTH / _DPI, height / _DPI), dpi=_DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)

    def panel(x: float, y: float, width: float, tall: float) -> Axes:
        axes = figure.add_axes(
            (x / WIDTH, 1 - (y + tall) / height, width / WIDTH, tall / height), facecolor="none"
        )
        axes.set_axis_off()
        return axes

    _draw_head(panel(_SIDE, 0, WIDTH - 2 * _SIDE, _HEAD), plan)
    for place, number in enumerate(shown):
        row, column = divmod(place, columns)
        x, y = _SIDE + column * cell, _HEAD + row * (drawn + _MOMENT_CAPTION)
        axes = panel(x, y, cell, drawn)
        frame.fit(axes)
        _draw_moment(axes, scene, number)
        _draw_caption(panel(x, y + drawn, cell, _MOMENT_CAPTION), plan, number)
    top = height - _FOOT
    _draw_foot(panel, plan, scene, top)
    return figure


class _Frame:
    """The part of the isometric picture that every moment shows."""

    def __init__(self, scene: Scene) -> None:
        points = [side.face(scene.edge) for side in scene.elevations]
        points += [block.corners(scene.edge) for block in scene.blocks]
        points.append(np.c_[table(scene), np.zeros(len(table(scene)))])
        seen = project(np.concatenate(points))
        pad = 0.12 * scene.edge
        self.low, self.high = seen.min(0) - pad, seen.max(0) + pad
        self.width, self.height = self.high - self.low

    def fit(self, axes: Axes) -> None:
        axes.set_xlim(self.low[0], self.high[0])
        axes.set_ylim(self.low[1], self.high[1])


def table(scene: Scene) -> np.ndarray:
    """Outline of the table under the structure: float64[n, 2], world (x, y) [m]."""
    edge = scene.edge
    points = [side.face(edge)[:, :2] for side in scene.elevations]
    points += [block.corners(edge)[:, :2] for block in scene.blocks]
    every = np.concatenate(points)
    (x0, y0), (x1, y1) = every.min(0), every.max(0)
    return np.asarray(box(x0, y0, x1, y1).buffer(1.1 * edge).exterior.coords)


def _draw_moment(axes: Axes, scene: Scene, number: int) -> None:
    edge = scene.edge
    standing = [block for block in scene.blocks if block.number <= number]
    ground = table(scene)
    fill(axes, project(np.c_[ground, np.zeros(len(ground))]), TABLE)
    shades = [Area(hull(shadow(block.corners(edge)))) for block in standing]
    fill_area(axes, unary_union(shades).intersection(Area(ground)), _on_table, "#8d8474", 0.32)
    faces = [(project(side.face(edge)), side_normal(side.frame)) for side in scene.elevations]
    for outline, _ in faces:
        fill(axes, outline, ACCENT, alpha=0.11)
    for outline, normal in faces:
        if normal @ TO_VIEWER <= 0:
            draw_outline(axes, outline, alpha=0.75)
    positions = np.array([block.position for block in standing]).reshape(-1, 3)
    for index in painters_order(positions, edge):
        block = standing[index]
        _draw_block(axes, block, edge, positions, block.number == number > 0)
    for outline, normal in faces:
        if normal @ TO_VIEWER > 0:
            draw_outline(axes, outline)


def side_normal(frame: np.ndarray) -> np.ndarray:
    """Outward direction of a side in the world: float64[3] (local -y)."""
    cos, sin = frame[:2]
    return np.array([sin, -cos, 0.0])


def _draw_block(
    axes: Axes, block: Placed, edge: float, standing: np.ndarray, current: bool
) -> None:
    colour = np.array(to_rgb(COLOURS["current" if current else kind(block)]))
    faces = visible_faces(block, edge)
    for face in faces:
        fill(axes, face.corners, colour * face.light, edge=RIM, width=0.9)
    face = numbered_face(faces, block, standing, edge)
    if face is not None:
        number_on(axes, block.number, face.corners)


def _draw_head(axes: Axes, plan: Plan) -> None:
    name = textwrap.shorten(" ".join(plan.design.name.split()), 72, placeholder=" …")
    write(axes, 0, 0.62, name, size=25, weight="bold")
    parts = [
        plan.status.capitalize(),
        f"{plan.blocks.used} of {plan.blocks.available} blocks",
        f"{percent(plan.coverage)} of the target covered",
    ]
    if plan.verified_by:
        parts.append(f"verified by {plan.verified_by}")
    if plan.reason:
        parts[1:] = [plan.reason]
    line = textwrap.shorten(" · ".join(parts), 150, placeholder=" …")
    write(axes, 0, 0.28, line, size=14, color=SOFT)


def _draw_caption(axes: Axes, plan: Plan, number: int) -> None:
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    share = shares(plan)[number]
    words = placement(plan.steps[number - 1]) if number else "the first block"
    head = f"Step {number}" if number else "Start"
    write(axes, 0.08, 0.86, head, size=13, weight="bold")
    write(axes, 0.92, 0.86, percent(share), size=13, weight="bold", ha="right", color=ACCENT)
    write(axes, 0.08, 0.28, words, size=11, color=SOFT)
    axes.plot([0.08, 0.92], [0.58, 0.58], color=LINE, lw=4, solid_capstyle="round")
    if share > 0.005:
        end = 0.08 + 0.84 * min(share, 1)
        axes.plot([0.08, end], [0.58, 0.58], color=ACCENT, lw=4, solid_capstyle="round")


def _draw_foot(panel: Any, plan: Plan, scene: Scene, top: float) -> None:
    """Elevations side by side, then the coverage chart."""
    sides = len(scene.elevations)
    chart = bool(plan.steps)
    chart_width = 430 if chart else 0
    room = WIDTH - 2 * _SIDE - chart_width
    width = min(room / sides, 440)
    left, right, high = drawing_limits(scene)
    tall = float(
        np.clip((width - 36) * (high + 0.5 * scene.edge) / (right - left), 160, _FOOT - 100)
    )
    for side in range(sides):
        axes = panel(_SIDE + side * width, top + 58, width - 36, tall)
        _draw_elevation(axes, scene, side)
        title = panel(_SIDE + side * width, top + 18, width - 36, 34)
        name = textwrap.shorten(scene.elevations[side].name, int(width / 11), placeholder=" …")
        write(title, 0, 0.5, f"Side {side + 1}", size=13, weight="bold")
        write(title, 72 / (width - 36), 0.5, name, size=12.5, color=SOFT)
    if chart:
        edge = WIDTH - _SIDE - chart_width
        write(panel(edge + 46, top + 18, 300, 34), 0, 0.5, "Coverage", size=13, weight="bold")
        _draw_chart(panel(edge + 46, top + 64, chart_width - 56, tall - 22), plan)


def _draw_elevation(axes: Axes, scene: Scene, side: int) -> None:
    left, right, high = drawing_limits(scene)
    pad = 0.2 * scene.edge
    axes.set_xlim(left - pad, right + pad)
    axes.set_ylim(-0.06 * scene.edge, high + pad)
    axes.set_aspect("equal", anchor="SW")
    for mark in elevation_marks(scene, side):
        _paint(axes, mark)


def _draw_chart(axes: Axes, plan: Plan) -> None:
    last = len(plan.steps)
    axes.set_xlim(-0.01 * last, 1.03 * last)
    axes.set_ylim(-0.02, 1.06)
    for mark in chart_marks(plan):
        _paint(axes, mark)


_LINES = {
    "ground": {"color": SOFT, "lw": 1.4}, "rule": {"color": LINE, "lw": 1},
    "threshold": {"color": GOOD, "lw": 1.4, "dashes": (5, 3)},
    "plane": {"color": SOFT, "lw": 1.2, "dashes": (1, 2)},
    "curve": {"color": ACCENT, "lw": 2.2, "solid_joinstyle": "round"},
}  # fmt: skip


def _paint(axes: Axes, mark: Mark) -> None:
    """A mark as the style sheet of the page has it; the cursor belongs to the page alone."""
    name, *more = mark.style.split()
    x, y = mark.points[0]
    if name == "label":
        square = (
            mark.points[0] + mark.size / 0.38 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2
        )
        number_on(axes, int(mark.text), square)
    elif mark.shape == "text":
        align = {"end": "right", "middle": "center"}.get(" ".join(more), "left")
        colour = GOOD if name == "threshold-text" else SOFT
        write(axes, x, y, mark.text, size=10.5, color=colour, ha=align)
    elif mark.shape == "dot":
        axes.plot([x], [y], color=ACCENT, marker="o", ms=5.5, clip_on=False, zorder=3)
    elif name in _LINES:
        axes.plot(*mark.points.T, zorder=2, clip_on=False, **_LINES[name])
    elif name == "target-line":
        draw_outline(axes, mark.points, width=2.4)
    elif name == "target-fill":
        fill(axes, mark.points, ACCENT, alpha=0.10)
    elif "behind" in more:
        fill(axes, mark.points, "#e9e6e0", edge="#c9c4ba", width=0.7)
    elif name == "block":
        fill(axes, mark.points, COLOURS[more[0]], edge=RIM, width=1.1)


def _on_table(xy: np.ndarray) -> np.ndarray:
    return project(np.c_[xy, np.zeros(len(xy))])
