"""Which triangle is seen where: projection and depth buffers as compiled functions.

Visibility is kept for 2 x 2 samples per pixel. Depths are inverse distances along the view axis,
so that they are linear in the picture and larger is nearer.
"""

from __future__ import annotations

import numpy as np
from numba import njit

SAMPLES = 2
"""Samples per pixel along each axis."""
SHADOW_SIZE = 768
"""Places along a side of the map of shadows."""
LIT, PLAIN, BLOCK, GROUND = 0, 1, 2, 3
"""Kinds of triangles: shaded; in its colour as it is; shaded, with a rim and a number; shaded, but
with nothing below that it could cast a shadow on."""
_WIDE = 12
"""Rows with more samples are cut to what lies inside the triangle before they are walked."""


@njit(cache=True, error_model="numpy")
def place(vertices, normals, body, position, rotation, world, turned):
    for i in range(vertices.shape[0]):
        b = body[i]
        for k in range(3):
            x, y, z = rotation[b, k, 0], rotation[b, k, 1], rotation[b, k, 2]
            world[i, k] = (
                position[b, k] + x * vertices[i, 0] + y * vertices[i, 1] + z * vertices[i, 2]
            )
            turned[i, k] = x * normals[i, 0] + y * normals[i, 1] + z * normals[i, 2]


@njit(cache=True, error_model="numpy")
def project(world, eye, axes, focal, centre, screen):
    """Samples right and down, and inverse distance."""
    for i in range(world.shape[0]):
        x, y, z = world[i, 0] - eye[0], world[i, 1] - eye[1], world[i, 2] - eye[2]
        inverse = 1.0 / (axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z)
        right = axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z
        down = axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z
        screen[i, 0] = SAMPLES * (centre[0] + focal * right * inverse)
        screen[i, 1] = SAMPLES * (centre[1] + focal * down * inverse)
        screen[i, 2] = inverse


@njit(cache=True, error_model="numpy")
def project_light(world, axes, low, size, screen):
    scale = SHADOW_SIZE / size
    for i in range(world.shape[0]):
        x, y, z = world[i, 0], world[i, 1], world[i, 2]
        screen[i, 0] = (axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z - low[0]) * scale
        screen[i, 1] = (axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z - low[1]) * scale
        screen[i, 2] = axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z


@njit(cache=True, inline="always", error_model="numpy")
def _span(low, high, limit):
    """First and last sample whose centre lies between ``low`` and ``high``."""
    return max(int(np.ceil(low - 0.5)), 0), min(int(np.floor(high - 0.5)), limit - 1)


@njit(cache=True, inline="always", error_model="numpy")
def _inner(u, v, u_step, v_step, count):
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


@njit(cache=True, inline="always", error_model="numpy")
def _area(a, b, c):
    """Twice the signed area of a triangle in the picture."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@njit(cache=True, error_model="numpy")
def _cover(a, b, c, area, nearest, marks, mark):
    """Enter a triangle where it is nearer than anything before it; ``marks`` it, unless negative.

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
                    nearest[y, x] = near
                    if mark >= 0:
                        marks[y, x] = mark
            u += u_step
            v += v_step


@njit(cache=True, error_model="numpy")
def fill(screen, faces, body, shown, depth, seen):
    """Which triangle each sample sees; triangles turned away are left out."""
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        if not shown[body[i]]:
            continue
        # Down is positive in the picture, so what faces the camera has a negative area.
        area = _area(screen[i], screen[j], screen[k])
        if area > -1e-6 or screen[i, 2] <= 0 or screen[j, 2] <= 0 or screen[k, 2] <= 0:
            continue
        _cover(screen[i], screen[j], screen[k], area, depth, seen, f)


@njit(cache=True, error_model="numpy")
def fill_shadow(screen, faces, kind, body, shown, height_of):
    """How near to the sun the nearest thing is, for every place of the map.

    Surfaces turned away from the sun are left out: one turned to it lies nearer.
    """
    unused = np.empty((1, 1), np.int32)
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        if kind[f] == PLAIN or kind[f] == GROUND or not shown[body[i]]:
            continue
        area = _area(screen[i], screen[j], screen[k])
        if area < 1e-6:
            continue
        _cover(screen[i], screen[j], screen[k], area, height_of, unused, -1)


@njit(cache=True, error_model="numpy")
def blend_film(corners, colour, share, depth, image):
    """A thin transparent triangle over a finished picture, hidden where something is nearer.

    Args:
        corners: float64[3, 3], projected: samples right and down, inverse distance.
        colour: float32[3], 0 to 255.
        share: opacity.
        depth: of the picture's samples; changed nowhere.
    """
    a, b, c = corners[0], corners[1], corners[2]
    area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    if abs(area) < 1e-6:
        return
    over = 1.0 / area
    height, width = image.shape[:2]
    x0, x1 = _span(min(a[0], b[0], c[0]), max(a[0], b[0], c[0]), depth.shape[1])
    y0, y1 = _span(min(a[1], b[1], c[1]), max(a[1], b[1], c[1]), depth.shape[0])
    for y in range(y0 // SAMPLES, min(y1 // SAMPLES + 1, height)):
        for x in range(x0 // SAMPLES, min(x1 // SAMPLES + 1, width)):
            hits = 0
            for n in range(SAMPLES * SAMPLES):
                i, j = SAMPLES * x + n % SAMPLES, SAMPLES * y + n // SAMPLES
                px, py = i + 0.5, j + 0.5
                u = ((c[0] - b[0]) * (py - b[1]) - (c[1] - b[1]) * (px - b[0])) * over
                v = ((a[0] - c[0]) * (py - c[1]) - (a[1] - c[1]) * (px - c[0])) * over
                w = 1.0 - u - v
                near = u * a[2] + v * b[2] + w * c[2]
                if u >= 0 and v >= 0 and w >= 0 and near > depth[j, i]:
                    hits += 1
            part = share * hits / (SAMPLES * SAMPLES)
            for channel in range(3):
                old = image[y, x, channel]
                image[y, x, channel] = np.uint8(old + part * (colour[channel] - old) + 0.5)
