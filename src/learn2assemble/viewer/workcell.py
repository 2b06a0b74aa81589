"""The workcell of a record as triangles: table, outlines, arm and blocks.

Every thing in one colour that moves as one is a *body*. Bodies, in order: what stands still and
is never shaded (outlines, waiting places), the frame that shows where a block goes, the table,
the parts of the arm, the cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.font_manager import get_font

from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.robot.shape import Mesh, box
from learn2assemble.viewer.arm import Labels
from learn2assemble.viewer.playback import Playback, split
from learn2assemble.viewer.renderer import BLOCK, GROUND, LIT, PLAIN, Triangles

_FONTS = {False: "DejaVuSans.ttf", True: "DejaVuSans-Bold.ttf"}


@lru_cache(maxsize=512)
def lettering(text: str, size: float, bold: bool = False) -> tuple[np.ndarray, int]:
    """A line of text: how much ink, float32[h, w] from 0 to 1, and the row of its base line.

    Args:
        size: height of the font [px].
    """
    font = get_font(str(Path(matplotlib.get_data_path(), "fonts", "ttf", _FONTS[bold])))
    font.set_size(size, 72)
    font.set_text(text, 0.0)
    font.draw_glyphs_to_bitmap(antialiased=True)
    ink = np.asarray(font.get_image(), np.float32) / 255
    return ink, ink.shape[0] - round(font.get_descent() / 64)


def write(
    image: np.ndarray, text: str, x: float, y: float, size: float, colour: np.ndarray,
    bold: bool = False, align: str = "left",
) -> float:  # fmt: skip
    """Write a line of text with its base line at row ``y``; what does not fit is cut off.

    Args:
        image: uint8[h, w, 3], changed in place.
        x: left end, right end or middle [px], as ``align`` says.
        colour: 0 to 255.

    Returns:
        Where it ends [px].
    """
    if not text.strip():
        return x
    ink, base = lettering(text, size, bold)
    shift = {"left": 0.0, "right": ink.shape[1], "middle": ink.shape[1] / 2}[align]
    left, top = round(x - shift), round(y) - base
    cut = ink[max(-top, 0) :, max(-left, 0) :]
    part = image[max(top, 0) : top + ink.shape[0], max(left, 0) : left + ink.shape[1]]
    cut = cut[: part.shape[0], : part.shape[1], None]
    part[:] = np.round(part + cut * (colour - part)).astype(np.uint8)
    return left + ink.shape[1]


def fill_box(
    image: np.ndarray, x0: float, y0: float, x1: float, y1: float, colour: np.ndarray
) -> None:
    """Fill a rectangle; pixels that it covers in part along x are blended."""
    top, bottom = round(y0), round(y1)
    first = int(np.floor(x0))
    columns = np.arange(first, int(np.ceil(x1)))
    share = np.clip(np.minimum(columns + 1, x1) - np.maximum(columns, x0), 0, 1)[:, None]
    part = image[top:bottom, first : first + len(columns)]
    part[:] = np.round(part + share[: part.shape[1]] * (colour - part)).astype(np.uint8)


def rgb(colour: str) -> np.ndarray:
    """``"#0b7285"`` as float32[3], 0 to 255."""
    return np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)], np.float32)


_FACES = (
    ((0, -1, 0), (1, 0, 0), (0, 0, 1)), ((0, 1, 0), (-1, 0, 0), (0, 0, 1)),
    ((1, 0, 0), (0, 1, 0), (0, 0, 1)), ((-1, 0, 0), (0, -1, 0), (0, 0, 1)),
    ((0, 0, 1), (1, 0, 0), (0, 1, 0)), ((0, 0, -1), (1, 0, 0), (0, -1, 0)),
)  # fmt: skip
"""Of every face of a cube: outward, right and up as seen from outside."""


class Workcell(NamedTuple):
    """Triangles and which body is what."""

    triangles: Triangles
    outline: int
    """Body of the target outlines; likewise the next four."""
    places: int
    goal: int
    table: int
    arm: int
    """First of the arm's parts."""
    cells: int
    """First of the cells."""
    count: int


class _Collector:
    """Triangles of all bodies, one after the other."""

    def __init__(self) -> None:
        self.rows: list[tuple[np.ndarray, ...]] = []
        self.vertices = self.bodies = 0

    def body(self) -> int:
        self.bodies += 1
        return self.bodies - 1

    def add(self, body: int, mesh: Mesh, kind: int, marks: np.ndarray | None = None) -> None:
        v, f = len(mesh.vertices), len(mesh.faces)
        self.rows.append((
            mesh.vertices, mesh.normals, np.zeros((v, 2)) if marks is None else marks,
            np.full(v, body), mesh.faces + self.vertices, np.full(f, kind),
        ))  # fmt: skip
        self.vertices += v

    def triangles(self) -> Triangles:
        columns = [np.concatenate(column) for column in zip(*self.rows, strict=True)]
        kinds = (np.float32, np.float32, np.float32, np.int32, np.int32, np.uint8)
        return Triangles(*(c.astype(k) for c, k in zip(columns, kinds, strict=True)))


def workcell(playback: Playback, targets: Sequence[np.ndarray], labels: Labels) -> Workcell:
    """The cell of a record.

    Args:
        targets: float64[V, 3] each, outlines to be drawn [m, world].
        labels: of its cells.
    """
    record, edge = playback.record, playback.record.block_edge
    first, all_cells = record.steps[0].before, _Collector()
    outline, places, goal, table = (all_cells.body() for _ in range(4))
    for corners in targets:
        for a, b in zip(corners, np.roll(corners, -1, 0), strict=True):
            all_cells.add(outline, rod(a, b, edge / 22), PLAIN)
    halves = playback.half
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for cell, half in enumerate(halves):
        if not labels.fixed[cell] and first[cell, 2] > 0:
            at = np.column_stack([first[cell, :2] + half[:2] * square, np.full(4, edge / 90)])
            for a, b in zip(at, np.roll(at, -1, 0), strict=True):
                all_cells.add(places, rod(a, b, edge / 90), PLAIN)
    corner = 0.5 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    for i, j in ((i, i | 1 << k) for i in range(8) for k in range(3) if not i >> k & 1):
        all_cells.add(goal, rod(corner[i], corner[j], 1 / 40), PLAIN)
    all_cells.add(table, _table(playback, targets), GROUND)
    arm = all_cells.bodies
    for part in playback.shape.parts:
        all_cells.add(all_cells.body(), part.mesh, LIT)
    cells = all_cells.bodies
    for half in halves:
        block, marks = _block(half)
        all_cells.add(all_cells.body(), block, BLOCK, marks)
    return Workcell(
        all_cells.triangles(), outline, places, goal, table, arm, cells, all_cells.bodies
    )


def body_poses(model: Workcell, playback: Playback, clock: float) -> tuple[np.ndarray, np.ndarray]:
    """Where all bodies are at a time of the replay: float64[b, 3] [m] and float64[b, 3, 3]."""
    position = np.zeros((model.count, 3))
    rotation = np.tile(np.eye(3), (model.count, 1, 1))
    joints, width = playback.arm_at(clock)
    where, turned = playback.shape.frames(joints, width)
    for k, part in enumerate(playback.shape.parts):
        if part.frame >= 0:
            position[model.arm + k] = where[part.frame]
            rotation[model.arm + k] = turned[part.frame]
    cells, quaternions = playback.cells_at(clock)
    count = len(cells)
    position[model.cells : model.cells + count] = cells
    rotation[model.cells : model.cells + count] = quaternion_matrix(quaternions)
    step = playback.segment_at(clock).step
    target, quaternion = split(step.target)
    # The goal is a cube with edge 1, stretched to the block it is for.
    size = np.diag(2 * playback.half[step.cells[0]])
    position[model.goal], rotation[model.goal] = target, quaternion_matrix(quaternion) @ size
    return position, rotation


def rod(a: np.ndarray, b: np.ndarray, radius: float) -> Mesh:
    """A thin square bar from a to b, float64[3] each [m]."""
    along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
    side = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    side /= np.linalg.norm(side)
    turn = np.stack([along, side, np.cross(along, side)], 1)
    bar = box(np.array([np.linalg.norm(b - a) / 2 + radius, radius, radius]))
    return Mesh(bar.vertices @ turn.T + (a + b) / 2, bar.normals @ turn.T, bar.faces)


def _block(half: np.ndarray) -> tuple[Mesh, np.ndarray]:
    """A block whose faces know left, right, below and above: float64[24, 2] from 0 to 1."""
    vertices, normals, marks, faces = [], [], [], []
    for n, u, v in np.array(_FACES, float):
        k = len(vertices)
        for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            vertices.append(half * (n + a * u + b * v))
            normals.append(n)
            marks.append(((a + 1) / 2, (b + 1) / 2))
        faces += [(k, k + 1, k + 2), (k, k + 2, k + 3)]
    return Mesh(np.array(vertices), np.array(normals), np.array(faces, np.int32)), np.array(marks)


def _table(playback: Playback, targets: Sequence[np.ndarray]) -> Mesh:
    """The table top under all there is, its corners round."""
    edge = playback.record.block_edge
    points = [playback.record.steps[0].before[:, :2], playback.shape.chain.offset[:1, :2]]
    points += [corners[:, :2] for corners in targets]
    every = np.concatenate(points)
    low, high = every.min(0) - 2.2 * edge, every.max(0) + 2.2 * edge
    quarter = np.linspace(0, np.pi / 2, 9)
    ring = []
    for k, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        centre = np.where(np.array([sx, sy]) > 0, high, low) - edge * np.array([sx, sy])
        turn = quarter + k * np.pi / 2
        ring.append(centre + edge * np.column_stack([np.cos(turn), np.sin(turn)]))
    around = np.concatenate(ring)
    flat = np.vstack([around.mean(0), around])
    n = len(around)
    faces = np.column_stack([np.zeros(n), 1 + np.arange(n), 1 + (np.arange(n) + 1) % n])
    vertices = np.column_stack([flat, np.full(len(flat), -0.0004)])
    return Mesh(vertices, np.tile([0.0, 0.0, 1.0], (len(flat), 1)), faces.astype(np.int32))
