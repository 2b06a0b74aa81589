"""How a plan grows, as one picture: the structure after some of its steps."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.instructions.appearance import COLOURS, kinds_and_colours, rgb
from learn2assemble.assembly.parts import convex_parts
from learn2assemble.errors import InputError
from learn2assemble.files import write_file
from learn2assemble.kinematics.shape import Mesh
from learn2assemble.planning.plan import Plan, PlanBox
from learn2assemble.viewer import renderer
from learn2assemble.viewer.words import percent

MOMENTS, COLUMNS = 6, 3
WIDTH, HEIGHT = 480, 400
"""Of the picture of one moment [px]."""
PAPER, INK, SOFT, LINE = "#fbfaf8", "#1f2429", COLOURS["soft"], "#dcd8d0"
ACCENT, RIM = "#0b7285", "#4a3b26"
_SKY, _RIM, _TABLE = (246, 245, 242), (60, 52, 46), (232, 228, 220)
_TARGET, _OBSTACLE = (11, 114, 133), (190, 60, 50)
_VIEW = np.array([1.0, -1.6, 0.9])
_SUN = np.array([0.45, -0.55, 0.9])
_FOCAL = 2.2
"""Focal length in picture widths."""


def write_progress(
    plan: Plan, path: Path, moments: int = MOMENTS, turn: float = 0.0, title: bool = True
) -> None:
    """Write a PNG of the structure after some of its steps, the last one among them; of a plan
    without steps all blocks are shown once.

    Args:
        moments: how often it is shown at most; once: what stands in the end.
        turn: of the structure about the vertical, counter-clockwise from above [deg].
        title: whether words stand above what is shown.

    Raises:
        InputError: for a plan whose blocks are not known, and where the file cannot be written.
    """
    from PIL import Image, ImageDraw, ImageFont

    assembly = plan.assembly
    if assembly is None:
        raise InputError("plan", "no blocks", "assembly.json beside plan.json")
    steps = len(assembly.steps)
    after = np.unique(np.rint(np.linspace(0, steps, moments + 1))[1:].astype(int))
    after = after[after > 0] if steps else np.zeros(1, int)
    columns = min(COLUMNS, len(after))
    rows = -(-len(after) // columns)
    sheet = Image.new("RGB", (columns * WIDTH, rows * HEIGHT), _SKY)
    font = ImageFont.load_default(18)
    targets = [np.array(target.outline) for target in plan.design.targets]
    triangles, colour = _triangles(assembly, targets, plan.design.boxes)
    buffers = renderer.Buffers(triangles, WIDTH, HEIGHT)
    bodies = len(assembly.blocks) + 3
    place, axes = np.zeros((bodies, 3)), np.tile(np.eye(3), (bodies, 1, 1))
    points = np.concatenate([block.vertices for block in assembly.blocks])
    ends = [corner for box in plan.design.boxes for corner in (box.low, box.high)]
    seen = np.array([points.min(0), points.max(0), *ends])
    low, high = seen.min(0), seen.max(0)
    camera, light = (
        _camera(low, high, turn),
        renderer.sunlight(_turned(_SUN, turn), points, 0.1 * float((high - low).max())),
    )
    for number, step in enumerate(after.tolist()):
        shown = np.append(_standing(assembly, step), [True] * 3)
        painted = colour.copy()
        painted[:-3][_held(assembly, step)] = rgb("held")
        picture = renderer.render(
            triangles,
            buffers,
            camera,
            light,
            renderer.BodyStates(place, axes, shown, painted),
            np.array(_SKY, np.float32),
            np.array(_RIM, np.float32),
        )
        corner = (number % columns * WIDTH, number // columns * HEIGHT)
        sheet.paste(Image.fromarray(picture), corner)
        if not title:
            continue
        text = f"after step {step} of {steps}" if steps and moments > 1 else assembly.name
        if targets and step:
            text += f": {percent(plan.steps[int(step) - 1].coverage)} covered".replace(
                "\u00a0", " "
            )
        at = (corner[0] + 14, corner[1] + 12)
        ImageDraw.Draw(sheet).text(at, text, fill=_RIM, font=font)
    out = io.BytesIO()
    sheet.save(out, "PNG")
    write_file(path, out.getvalue(), "picture")


def _standing(assembly: Assembly, count: int) -> np.ndarray:
    """bool[B]: what stands after ``count`` steps."""
    there = np.array(assembly.at_first)
    for step in assembly.steps[:count]:
        there[assembly.index(step.block)] = step.action != "remove"
    return there


def _held(assembly: Assembly, count: int) -> np.ndarray:
    """bool[B]: what hands hold after ``count`` steps."""
    held = np.zeros(len(assembly.blocks), bool)
    for step in assembly.steps[:count]:
        held[assembly.index(step.block)] = step.action == "hold"
    return held


def _triangles(
    assembly: Assembly, targets: list[np.ndarray], boxes: Sequence[PlanBox] = ()
) -> tuple[renderer.Triangles, np.ndarray]:
    """One body a block, then table, outlines or goals, obstacles; colours float32[B + 3, 3]."""
    bodies, table = renderer.Bodies(), len(assembly.blocks)
    for number, block in enumerate(assembly.blocks):
        for part in convex_parts(block):
            for face in part.faces:
                _add_face(bodies, number, part.vertices[list(face)])
    points = np.concatenate([block.vertices for block in assembly.blocks])
    low, high = points.min(0), points.max(0)
    (x0, y0), (x1, y1) = low[:2] - (high - low).max(), high[:2] + (high - low).max()
    corners = np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]]) - [0, 0, 1e-4]
    _add_face(bodies, table, corners, renderer.GROUND)
    thick = 0.015 * float(np.median([np.ptp(b.vertices, axis=0).min() for b in assembly.blocks]))
    for outline in targets:
        bodies.add_bars(table + 1, renderer.around(outline), thick)
    for given in boxes:
        kind = 1 + (given.what == "obstacle")
        bodies.add_bars(table + kind, renderer.box_edges(given.low, given.high), thick)
    colours = [rgb(colour) for _, colour in kinds_and_colours(assembly)]
    return bodies.triangles(), np.array([*colours, _TABLE, _TARGET, _OBSTACLE], np.float32)


def _add_face(
    bodies: renderer.Bodies, body: int, corners: np.ndarray, kind: int | None = None
) -> None:
    """Add a convex face, float64[n, 3]; one of a block, without a kind, has a rim where it has four
    corners."""
    normal = np.cross(corners, np.roll(corners, -1, 0)).sum(0)
    length = np.linalg.norm(normal)
    if not length > 0:
        return
    kind = (renderer.BLOCK if len(corners) == 4 else renderer.LIT) if kind is None else kind
    marks = np.full((len(corners), 2), 0.5)
    fan = np.array([(0, k, k + 1) for k in range(1, len(corners) - 1)])
    if len(corners) == 4:
        corners, marks = _rim(corners)
        fan = np.array([(k, k + 1, k + 5) for k in (0, 1, 2)])
        fan = np.concatenate([fan, np.array([(k, k + 5, k + 4) for k in (0, 1, 2)])])
    normals = np.tile(normal / length, (len(corners), 1))
    bodies.add(body, Mesh(corners, normals, fan), kind, marks)


def _rim(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A face of four corners cut twice across its longer side, float64[8, 3], and the marks 0 to 1
    at which the renderer draws its rim, float64[8, 2]: as wide on the long side as on the short."""
    if np.linalg.norm(corners[1] - corners[0]) < np.linalg.norm(corners[2] - corners[1]):
        corners = np.roll(corners, -1, 0)
    long, short = np.linalg.norm(corners[1] - corners[0]), np.linalg.norm(corners[2] - corners[1])
    at = np.array([0, short / long / 2, 1 - short / long / 2, 1])[:, None]
    lower = corners[0] + at * (corners[1] - corners[0])
    upper = corners[3] + at * (corners[2] - corners[3])
    u = np.array([0, 0.5, 0.5, 1])
    marks = [np.column_stack([u, np.full(4, v)]) for v in (0.0, 1.0)]
    return np.concatenate([lower, upper]), np.concatenate(marks)


def _camera(low: np.ndarray, high: np.ndarray, turn: float) -> renderer.Camera:
    """Sees all between these corners, float64[3] each [m], turned so far [deg]."""
    centre, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    back = _turned(_VIEW, turn) / np.linalg.norm(_VIEW)
    focal = _FOCAL * WIDTH
    distance = radius * (1.15 * focal / (min(WIDTH, HEIGHT) / 2))
    middle = np.array([WIDTH / 2, HEIGHT / 2 + 14])
    return renderer.Camera(centre + distance * back, renderer.view_axes(back), focal, middle)


def _turned(direction: np.ndarray, turn: float) -> np.ndarray:
    """A direction to what does not turn, float64[3], as the structure sees it [deg]."""
    cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    return np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) @ direction
