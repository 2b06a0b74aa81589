"""A small renderer: triangles with shadows into an image, on the processor, without any GL.

Visibility is kept for 2 x 2 samples per pixel. Depths are inverse distances along the view axis,
so that they are linear in the picture and larger is nearer. Why there is one: docs/architecture.md.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from learn2assemble.kernels import kernel
from learn2assemble.kinematics.shape import Mesh, box

SAMPLES = 2
"""Samples per pixel along each axis."""
SHADOW_SIZE = 768
"""Places along a side of the map of shadows."""
LIT, PLAIN, BLOCK, GROUND = 0, 1, 2, 3
"""Kinds of triangles: shaded; in its colour as it is; shaded, with a rim; shaded, but with nothing
below that it could cast a shadow on."""
_WIDE = 12
"""Rows with more samples are cut to what lies inside the triangle before they are walked."""


def project(world: np.ndarray, camera: Camera) -> np.ndarray:
    """float32[..., 3]: samples right and down, and inverse distance, of world points."""
    seen = (world - camera.position) @ camera.axes.T
    inverse = 1 / seen[..., 2:]
    picture = SAMPLES * (camera.centre + camera.focal * seen[..., :2] * inverse)
    return np.concatenate([picture, inverse], -1).astype(np.float32)


@kernel(inline="always", error_model="numpy")
def _span(low: float, high: float, limit: int) -> tuple[int, int]:
    """First and last sample whose centre lies between ``low`` and ``high``."""
    return max(int(np.ceil(low - 0.5)), 0), min(int(np.floor(high - 0.5)), limit - 1)


@kernel(inline="always", error_model="numpy")
def _inner(u: float, v: float, u_step: float, v_step: float, count: int) -> tuple[int, int]:
    """First and last of ``count`` samples in a row whose weights are all positive, and one more
    on either side against rounding."""
    low, high = np.float32(0), np.float32(count - 1)
    w, w_step = np.float32(1.0) - u - v, -u_step - v_step
    for value, step in ((u, u_step), (v, v_step), (w, w_step)):
        if step > 0:
            low = max(low, -value / step)
        elif step < 0:
            high = min(high, -value / step)
        elif value < 0:
            return 0, -1
    return max(int(low) - 1, 0), min(int(high) + 1, count - 1)


@kernel(inline="always", error_model="numpy")
def _area(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Twice the signed area of a triangle in the picture."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@kernel(error_model="numpy")
def _cover(
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    area: float,
    nearest: np.ndarray,
    marks: np.ndarray,
    mark: int,
) -> None:
    """Enter a triangle where it is nearer than anything before it, and ``mark`` it there.

    Args:
        a, b, c: float32[3]: its corners, right, down and near.
        area: see :func:`_area`; of either sign.
    """
    ax, ay, az = a[0], a[1], a[2]
    bx, by, bz = b[0], b[1], b[2]
    cx, cy, cz = c[0], c[1], c[2]
    height, width = nearest.shape
    x0, x1 = _span(min(ax, bx, cx), max(ax, bx, cx), width)
    y0, y1 = _span(min(ay, by, cy), max(ay, by, cy), height)
    over = np.float32(1.0 / area)
    u_step, v_step = (by - cy) * over, (cy - ay) * over
    px = np.float32(x0 + 0.5)
    for y in range(y0, y1 + 1):
        py = np.float32(y + 0.5)
        u = ((cx - bx) * (py - by) - (cy - by) * (px - bx)) * over
        v = ((ax - cx) * (py - cy) - (ay - cy) * (px - cx)) * over
        first, last = 0, x1 - x0
        if last > _WIDE:
            first, last = _inner(u, v, u_step, v_step, last + 1)
            u += np.float32(first) * u_step
            v += np.float32(first) * v_step
        for x in range(x0 + first, x0 + last + 1):
            w = np.float32(1.0) - u - v
            if u >= 0 and v >= 0 and w >= 0:
                near = u * az + v * bz + w * cz
                if near > nearest[y, x]:
                    nearest[y, x], marks[y, x] = near, mark
            u += u_step
            v += v_step


@kernel(error_model="numpy")
def fill(
    screen: np.ndarray,
    faces: np.ndarray,
    wanted: np.ndarray,
    towards: float,
    nearest: np.ndarray,
    seen: np.ndarray,
) -> None:
    """Which triangle each sample sees, and how near it is.

    Args:
        wanted: bool[f]; others are left out, as are those that are turned away.
        towards: sign of the area of a triangle that is turned to the viewer.
    """
    for f in range(faces.shape[0]):
        if wanted[f]:
            a, b, c = screen[faces[f, 0]], screen[faces[f, 1]], screen[faces[f, 2]]
            area = _area(a, b, c)
            if towards * area >= 1e-6:
                _cover(a, b, c, area, nearest, seen, f)


def blend_sheet(
    corners: np.ndarray, colour: np.ndarray, share: float, depth: np.ndarray, image: np.ndarray
) -> None:
    """A transparent triangle over a finished picture, hidden where something is nearer.

    Args:
        corners: float[3, 3], projected: samples right and down, inverse distance.
        colour: float32[3], 0 to 255.
        share: opacity.
        depth: of the picture's samples; changed nowhere.
    """
    height, width = image.shape[:2]
    x0, y0 = np.clip(corners[:, :2].min(0) // SAMPLES, 0, (width, height)).astype(int).tolist()
    x1, y1 = np.clip(corners[:, :2].max(0) // SAMPLES + 1, 0, (width, height)).astype(int).tolist()
    a, b, c = (corners - [SAMPLES * x0, SAMPLES * y0, 0]).astype(np.float32)
    if (area := _area(a, b, c)) == 0 or x0 >= x1 or y0 >= y1:
        return
    nearest = depth[SAMPLES * y0 : SAMPLES * y1, SAMPLES * x0 : SAMPLES * x1].copy()
    seen = np.full(nearest.shape, -1, np.int32)
    _cover(a, b, c, area, nearest, seen, 0)
    hits = (seen == 0).reshape(y1 - y0, SAMPLES, x1 - x0, SAMPLES).mean((1, 3))
    part = image[y0:y1, x0:x1]
    part[:] = part + share * hits[..., None] * (colour - part) + 0.5


AMBIENT, UPWARD, DIRECT = 0.6, 0.08, 0.42
"""Light from everywhere, more of it from above, and from the sun."""
BIAS = 0.002
"""What lies this much deeper than the map of shadows says is not in the shade [m]."""
VALUES = 9
"""What is interpolated over a triangle: 1, the normal, where it lies in the map of shadows and how
near to the sun, and the place on the face of a block; all of them times the inverse distance,
which makes them linear in the picture."""


@kernel(error_model="numpy")
def slopes(
    screen: np.ndarray,
    world: np.ndarray,
    normals: np.ndarray,
    faces: np.ndarray,
    body: np.ndarray,
    shown: np.ndarray,
    marks: np.ndarray,
    axes: np.ndarray,
    low: np.ndarray,
    scale: float,
    out: np.ndarray,
) -> None:
    """The values of each triangle that is turned to the camera, as linear functions.

    Args:
        out: float32[f, 2 + 3 * VALUES], filled: the first corner in the picture, then every value
            there and its change per sample to the right and down.
    """
    value = np.empty((3, VALUES))
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        bx, by = screen[j, 0] - screen[i, 0], screen[j, 1] - screen[i, 1]
        cx, cy = screen[k, 0] - screen[i, 0], screen[k, 1] - screen[i, 1]
        area = bx * cy - by * cx
        if area > -1e-6 or not shown[body[i]]:
            continue
        for corner in range(3):
            v = faces[f, corner]
            x, y, z = world[v, 0], world[v, 1], world[v, 2]
            value[corner, 0] = 1.0
            for n in range(3):
                value[corner, 1 + n] = normals[v, n]
                value[corner, 4 + n] = axes[n, 0] * x + axes[n, 1] * y + axes[n, 2] * z
            value[corner, 4] = (value[corner, 4] - low[0]) * scale - 0.5
            value[corner, 5] = (value[corner, 5] - low[1]) * scale - 0.5
            value[corner, 7], value[corner, 8] = marks[v, 0], marks[v, 1]
            for n in range(VALUES):
                value[corner, n] *= screen[v, 2]
        out[f, 0], out[f, 1] = screen[i, 0], screen[i, 1]
        for n in range(VALUES):
            b, c = value[1, n] - value[0, n], value[2, n] - value[0, n]
            out[f, 2 + 3 * n] = value[0, n]
            out[f, 3 + 3 * n] = (b * cy - c * by) / area
            out[f, 4 + 3 * n] = (c * bx - b * cx) / area


@kernel(error_model="numpy")
def shade(
    seen: np.ndarray,
    slope: np.ndarray,
    body_of: np.ndarray,
    kind: np.ndarray,
    colour: np.ndarray,
    rim_colour: np.ndarray,
    sky: np.ndarray,
    sun: np.ndarray,
    shadow: np.ndarray,
    focal: float,
    image: np.ndarray,
) -> None:
    """Fill ``image``; a pixel whose four samples see one triangle is shaded once."""
    # One long function: calls with arrays cost more here than what they would do.
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            f = seen[2 * y, 2 * x]
            same = (
                seen[2 * y, 2 * x + 1] == f
                and seen[2 * y + 1, 2 * x] == f
                and seen[2 * y + 1, 2 * x + 1] == f
            )
            if same and f < 0:
                for channel in range(3):
                    image[y, x, channel] = sky[channel]
                continue
            red = green = blue = 0.0
            for n in range(1 if same else 4):
                sx, sy = 2 * x + 1.0, 2 * y + 1.0
                if not same:
                    sx, sy = 2 * x + (n & 1) + 0.5, 2 * y + (n >> 1) + 0.5
                    f = seen[2 * y + (n >> 1), 2 * x + (n & 1)]
                    if f < 0:
                        red, green, blue = red + sky[0], green + sky[1], blue + sky[2]
                        continue
                b = body_of[f]
                if kind[f] == PLAIN:
                    red, green, blue = red + colour[b, 0], green + colour[b, 1], blue + colour[b, 2]
                    continue
                sx -= slope[f, 0]
                sy -= slope[f, 1]
                near = slope[f, 2] + slope[f, 3] * sx + slope[f, 4] * sy
                nx = slope[f, 5] + slope[f, 6] * sx + slope[f, 7] * sy
                ny = slope[f, 8] + slope[f, 9] * sx + slope[f, 10] * sy
                nz = slope[f, 11] + slope[f, 12] * sx + slope[f, 13] * sy
                length = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz + 1e-12)
                facing = (nx * sun[0] + ny * sun[1] + nz * sun[2]) * length
                light = AMBIENT + UPWARD * nz * length
                whole = 1.0 / near
                if facing > 0:
                    right = (slope[f, 14] + slope[f, 15] * sx + slope[f, 16] * sy) * whole
                    up = (slope[f, 17] + slope[f, 18] * sx + slope[f, 19] * sy) * whole
                    high = (slope[f, 20] + slope[f, 21] * sx + slope[f, 22] * sy) * whole
                    high += BIAS * (3.0 - 2.0 * facing)
                    i, j = int(right), int(up)
                    lit = 1.0
                    if right > 0 and up > 0 and i < SHADOW_SIZE - 1 and j < SHADOW_SIZE - 1:
                        # Between the four nearest places of the map.
                        s, t, lit = right - i, up - j, 0.0
                        if high >= shadow[j, i]:
                            lit += (1.0 - s) * (1.0 - t)
                        if high >= shadow[j, i + 1]:
                            lit += s * (1.0 - t)
                        if high >= shadow[j + 1, i]:
                            lit += (1.0 - s) * t
                        if high >= shadow[j + 1, i + 1]:
                            lit += s * t
                    light += DIRECT * facing * lit
                r, g, h = colour[b, 0] * light, colour[b, 1] * light, colour[b, 2] * light
                if kind[f] == BLOCK:
                    u = (slope[f, 23] + slope[f, 24] * sx + slope[f, 25] * sy) * whole
                    v = (slope[f, 26] + slope[f, 27] * sx + slope[f, 28] * sy) * whole
                    blur = 20.0 / (near * focal)  # about a pixel, as a share of a block's edge
                    edge = min(u, v, 1.0 - u, 1.0 - v)
                    rim = min(max((0.022 + blur / 2 - edge) / blur, 0.0), 1.0)
                    r += rim * (rim_colour[0] - r)
                    g += rim * (rim_colour[1] - g)
                    h += rim * (rim_colour[2] - h)
                red, green, blue = red + r, green + g, blue + h
            share = 1.0 if same else 0.25
            image[y, x, 0] = np.uint8(min(red * share + 0.5, 255.0))
            image[y, x, 1] = np.uint8(min(green * share + 0.5, 255.0))
            image[y, x, 2] = np.uint8(min(blue * share + 0.5, 255.0))


class Camera(NamedTuple):
    """A pinhole camera."""

    position: np.ndarray
    """float64[3] [m, world]."""
    axes: np.ndarray
    """float64[3, 3]: rows right, down and forward, world frame."""
    focal: float
    """Focal length [px]."""
    centre: np.ndarray
    """float64[2]: where the view axis meets the picture [px]."""


class Light(NamedTuple):
    """Sunlight and the square in which it casts shadows."""

    axes: np.ndarray
    """float64[3, 3]: rows right, up and towards the sun, world frame."""
    low: np.ndarray
    """float64[2]: lower corner of the square, along right and up [m]."""
    size: float
    """Side of the square [m]."""


def view_axes(back: np.ndarray) -> np.ndarray:
    """float64[3, 3]: right, down and forward of a level camera that looks against ``back``, a unit
    vector."""
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, back), -back])


def sunlight(sun: np.ndarray, points: np.ndarray, margin: float) -> Light:
    """Light from the direction ``sun``, float64[3], whose shadows reach ``margin`` [m] beyond
    ``points``, float64[n, 3] [m, world]."""
    right, down, away = view_axes(sun / np.linalg.norm(sun))
    axes = np.stack([right, -down, -away])
    seen = points @ axes[:2].T
    low, high = seen.min(0) - margin, seen.max(0) + margin
    return Light(axes, low, float((high - low).max()))


class Triangles(NamedTuple):
    """All triangles of a scene, on bodies that move."""

    vertices: np.ndarray
    """float32[v, 3]: in the frame of their body [m]."""
    normals: np.ndarray
    """float32[v, 3]."""
    marks: np.ndarray
    """float32[v, 2]: place on the face of a block, 0 to 1."""
    body: np.ndarray
    """int32[v]."""
    faces: np.ndarray
    """int32[f, 3]."""
    kind: np.ndarray
    """uint8[f]."""


class Bodies:
    """Collects the triangles of a scene, on bodies that are numbered as they come."""

    def __init__(self) -> None:
        self._rows: list[tuple[np.ndarray, ...]] = []
        self._vertices = 0

    def add(self, body: int, mesh: Mesh, kind: int, marks: np.ndarray | None = None) -> None:
        """Add a mesh in the frame of its body; ``marks`` as in :class:`Triangles`."""
        v, f = len(mesh.vertices), len(mesh.faces)
        marks = np.zeros((v, 2)) if marks is None else marks
        body_of, faces = np.full(v, body), mesh.faces + self._vertices
        self._rows.append((mesh.vertices, mesh.normals, marks, body_of, faces, np.full(f, kind)))
        self._vertices += v

    def add_bars(
        self, body: int, ends: Iterable[tuple[np.ndarray, np.ndarray]], radius: float
    ) -> None:
        """Add thin square bars between two points each, float64[3] [m], which are not shaded."""
        for a, b in ends:
            length = float(np.linalg.norm(b - a))
            along = (b - a) / max(length, 1e-9)
            side = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
            side /= np.linalg.norm(side)
            turn = np.stack([along, side, np.cross(along, side)], 1)
            bar = box(np.array([length / 2 + radius, radius, radius]))
            place = bar.vertices @ turn.T + (a + b) / 2
            self.add(body, Mesh(place, bar.normals @ turn.T, bar.faces), PLAIN)

    def triangles(self) -> Triangles:
        """All of them."""
        columns = [np.concatenate(column) for column in zip(*self._rows, strict=True)]
        kinds = (np.float32, np.float32, np.float32, np.int32, np.int32, np.uint8)
        return Triangles(*(c.astype(k) for c, k in zip(columns, kinds, strict=True)))


def around(corners: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The ends of the sides of a polygon float64[n, 3]."""
    return zip(corners, np.roll(corners, -1, 0), strict=True)


def box_edges(low: Sequence[float], high: Sequence[float]) -> list[tuple[np.ndarray, np.ndarray]]:
    """The ends of the edges of a box that have a length."""
    corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
    pairs = itertools.combinations(corners, 2)
    return [(a, b) for a, b in pairs if np.count_nonzero(a != b) == 1]


class Buffers:
    """Memory of one picture size, used again for every frame."""

    def __init__(self, triangles: Triangles, width: int, height: int) -> None:
        self.depth: NDArray[np.float32] = np.empty((height * SAMPLES, width * SAMPLES), np.float32)
        self.seen: NDArray[np.int32] = np.empty((height * SAMPLES, width * SAMPLES), np.int32)
        self.shadow: NDArray[np.float32] = np.empty((SHADOW_SIZE, SHADOW_SIZE), np.float32)
        self.shading: NDArray[np.int32] = np.empty((SHADOW_SIZE, SHADOW_SIZE), np.int32)
        self.casts: NDArray[np.bool_] = ~np.isin(triangles.kind, (PLAIN, GROUND))
        self.slope: NDArray[np.float32] = np.zeros(
            (len(triangles.faces), 2 + 3 * VALUES), np.float32
        )
        self.owner: np.ndarray = triangles.body[triangles.faces[:, 0]]
        self.image: NDArray[np.uint8] = np.empty((height, width, 3), np.uint8)


class BodyStates(NamedTuple):
    """How bodies are drawn."""

    position: np.ndarray
    """float64[b, 3] [m, world]."""
    rotation: np.ndarray
    """float64[b, 3, 3]."""
    shown: np.ndarray
    """bool[b]."""
    colour: np.ndarray
    """float32[b, 3], 0 to 255."""


def render(
    triangles: Triangles,
    buffers: Buffers,
    camera: Camera,
    light: Light,
    bodies: BodyStates,
    sky: np.ndarray,
    rim: np.ndarray,
) -> np.ndarray:
    """One picture: uint8[height, width, 3], valid until the next call with these buffers.

    Args:
        sky, rim: float32[3], colours as of bodies.
    """
    b, turn = buffers, bodies.rotation.astype(np.float32)[triangles.body]
    moved = bodies.position.astype(np.float32)[triangles.body]
    world = (turn @ triangles.vertices[..., None])[..., 0] + moved
    normals = (turn @ triangles.normals[..., None])[..., 0]
    lit = world @ light.axes.T - [*light.low, 0.0]
    lit[:, :2] *= SHADOW_SIZE / light.size
    b.shadow.fill(-1e9)
    faces, there = triangles.faces, bodies.shown[b.owner]
    # What is turned away from the sun is left out: something turned to it lies nearer.
    fill(lit.astype(np.float32), faces, there & b.casts, 1, b.shadow, b.shading)
    screen = project(world, camera)
    b.depth.fill(0.0)
    b.seen.fill(-1)
    # Down is positive in the picture, so what faces the camera has a negative area.
    fill(screen, faces, there & (screen[faces, 2] > 0).all(1), -1, b.depth, b.seen)
    slopes(
        screen,
        world,
        normals,
        faces,
        triangles.body,
        bodies.shown,
        triangles.marks,
        light.axes,
        light.low,
        SHADOW_SIZE / light.size,
        b.slope,
    )
    shade(
        b.seen,
        b.slope,
        b.owner,
        triangles.kind,
        bodies.colour,
        rim,
        sky.astype(np.uint8),
        light.axes[2],
        b.shadow,
        camera.focal,
        b.image,
    )
    return b.image
