"""Worlds as text and as pictures."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from learn2assemble.constants import EDGE, HALF
from learn2assemble.tasks.world.coverage import (
    HALF_EXTENT,
    IMAGE_SIZE,
    NARROW,
    ROWS,
    WORDS,
    DepthFilter,
    clear_to_ground,
    project,
    to_pixels,
)
from learn2assemble.tasks.world.state import State

COLOURS = {
    "background": (255, 255, 255),
    "ground": (160, 140, 120),
    "outside": (130, 150, 185),
    "target": (205, 205, 205),
    "hidden": (235, 155, 60),
    "filled": (60, 145, 75),
}
"""RGB: nothing, ground, block off the target, target still open, target covered by a block that
does not stand in its plane, target filled."""


SCALE = 3
"""Side of a rendered pixel in screen pixels."""


_REACH = int(HALF_EXTENT / EDGE)
"""Cells between the middle of an elevation and the edge of its image."""


def draw_text(state: State, frames: np.ndarray, row: int, pitch: float = EDGE) -> str:
    """The elevations of one world side by side, one character per block cell, ground below.

    ``#`` block on the target, ``x`` block in the plane but off the target, ``o`` block in front
    of the plane, ``.`` target still open.

    Args:
        pitch: horizontal distance of the centres of neighbouring cells [m].
    """
    mask, covered = to_pixels(state.mask[row]), to_pixels(state.covered[row])
    placed = state.position[row, : state.num_placed[row]]
    sides = zip(frames, mask, mask & ~covered, strict=True)
    cells = [_cells(frame, placed, target, still, pitch) for frame, target, still in sides]
    reach = max((abs(c) for side in cells for c, _ in side), default=0)
    height = max((r for side in cells for _, r in side), default=0) + 1
    columns = range(-reach, reach + 1)
    lines = [
        "   ".join("".join(side.get((c, r), " ") for c in columns) for side in cells)
        for r in reversed(range(height))
    ]
    ground = "   ".join("=" * len(columns) for _ in cells)
    head = (
        f"placed {state.num_placed[row]}/{state.num_blocks[row]}  "
        f"F_co {state.complete_coverage[row]:.4f}  F_pl {state.plane_coverage[row]:.4f}"
    )
    return "\n".join(line.rstrip() for line in [head, *lines, ground])


def draw_image(state: State, row: int, depths: DepthFilter = NARROW) -> np.ndarray:
    """The elevations of one world side by side as uint8[300, 300 S, 3]; see :data:`COLOURS`."""
    mask, covered = to_pixels(state.mask[row]), to_pixels(state.covered[row])
    occluded = to_pixels(state.occluded[row])
    image = np.empty((*mask.shape, 3), np.uint8)
    image[:] = COLOURS["background"]
    image[covered] = COLOURS["outside"]
    image[:, ground_pixels(depths)] = COLOURS["ground"]
    image[mask] = COLOURS["target"]
    image[mask & occluded] = COLOURS["hidden"]
    image[mask & covered & ~occluded] = COLOURS["filled"]
    return np.concatenate(image, 1).repeat(SCALE, 0).repeat(SCALE, 1)


@lru_cache
def ground_pixels(depths: DepthFilter) -> np.ndarray:
    """bool[100, 100]: what an elevation without blocks shows of the ground."""
    covered = np.zeros((ROWS, WORDS), np.uint64)
    clear_to_ground(covered, np.zeros_like(covered), depths)
    return to_pixels(covered)


def _cells(
    frame: np.ndarray, placed: np.ndarray, mask: np.ndarray, open_pixels: np.ndarray, pitch: float
) -> dict[tuple[int, int], str]:
    """Characters of one elevation by (column from the middle, row from the ground)."""
    cells: dict[tuple[int, int], str] = {}
    for c in range(-_REACH, _REACH + 1):
        for r in range(2 * _REACH):
            if _pixels(open_pixels, c, r, pitch).any():
                cells[c, r] = "."
    cos, sin, tx, ty = frame
    local = placed - (tx, ty, HALF)
    x, y = cos * local[:, 0] + sin * local[:, 1], cos * local[:, 1] - sin * local[:, 0]
    order = np.argsort(-y, kind="stable")  # a block in front is drawn over one behind it
    for n in order:
        if y[n] >= HALF:
            continue
        cell = round(x[n] / pitch), max(round(local[n, 2] / EDGE), 0)
        on_target = "#" if _pixels(mask, *cell, pitch).any() else "x"
        cells[cell] = on_target if y[n] > -HALF else "o"
    return cells


def _pixels(image: np.ndarray, column: int, row: int, pitch: float) -> np.ndarray:
    """The part of an image that shows the face of one cell."""
    u0, v0 = project(pitch * column - HALF, EDGE * (row + 1))
    u1, v1 = project(pitch * column + HALF, EDGE * row)
    u0, u1, v0, v1 = (min(max(round(e), 0), IMAGE_SIZE) for e in (u0, u1, v0, v1))
    return image[v0:v1, u0:u1]
