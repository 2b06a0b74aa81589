"""The colour of every pixel: sunlight with soft shadows, rims and numbers of blocks."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from learn2assemble.viewer.raster import BLOCK, PLAIN, SHADOW_SIZE

NUMBER_SIZE = 32
"""Texels along a side of the picture of a number."""


AMBIENT, UPWARD, DIRECT = 0.6, 0.08, 0.42
"""Light from everywhere, more of it from above, and from the sun."""
BIAS = 0.002
"""What lies this much deeper than the map of shadows says is not in the shade [m]."""
VALUES = 9
"""What is interpolated over a triangle: 1, the normal, where it lies in the map of shadows and how
near to the sun, and the place on the face of a block; all of them times the inverse distance,
which makes them linear in the picture."""


@njit(cache=True, error_model="numpy")
def slopes(screen, world, normals, faces, body, shown, marks, axes, low, scale, out):
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


@njit(cache=True, error_model="numpy")
def shade(
    seen, slope, body_of, kind, number, colour, numbers, rim_colour, sky, sun, shadow, focal, image
):
    """Fill ``image``; a pixel whose four samples see one triangle is shaded once."""
    # One long function: calls with arrays cost more here than what they would do.
    last = NUMBER_SIZE - 1.001
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
                    u = min(max(u * NUMBER_SIZE - 0.5, 0.0), last)
                    v = min(max((1.0 - v) * NUMBER_SIZE - 0.5, 0.0), last)
                    i, j, k = int(u), int(v), number[f]
                    s, t = u - i, v - j
                    ink = 0.85 * (
                        (1 - t) * ((1 - s) * numbers[k, j, i] + s * numbers[k, j, i + 1])
                        + t * ((1 - s) * numbers[k, j + 1, i] + s * numbers[k, j + 1, i + 1])
                    )
                    r = (r + rim * (rim_colour[0] - r)) * (1.0 - ink) + 33.0 * ink
                    g = (g + rim * (rim_colour[1] - g)) * (1.0 - ink) + 33.0 * ink
                    h = (h + rim * (rim_colour[2] - h)) * (1.0 - ink) + 33.0 * ink
                red, green, blue = red + r, green + g, blue + h
            share = 1.0 if same else 0.25
            image[y, x, 0] = np.uint8(min(red * share + 0.5, 255.0))
            image[y, x, 1] = np.uint8(min(green * share + 0.5, 255.0))
            image[y, x, 2] = np.uint8(min(blue * share + 0.5, 255.0))
