"""The packing bound of a state: lattice, inventory and bound on the scaled return.

All cells lie at the first block plus whole block edges, because placements are relative and turns
are quarter turns (protocol 5, 7). See :mod:`learn2assemble.evaluation.packing` for what is proven.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from learn2assemble.evaluation.packing import (
    MAX_NODES,
    Inventory,
    Lattice,
    discounted_bound,
    most_pixels,
    turned,
)
from learn2assemble.geometry.bits import ROWS, WORDS, to_pixels
from learn2assemble.geometry.coverage import add_box
from learn2assemble.world.blocks import EDGE, HALF
from learn2assemble.world.design_pixels import MAX_COLUMN, NUM_LEVELS
from learn2assemble.world.sides import to_world
from learn2assemble.world.state import State

FRONT = 2
"""Cells in front of a face plane whose hiding is counted: as far as the published shapes reach."""


def object_return_bound(
    state: State,
    row: int,
    frames: np.ndarray,
    discount: float,
    threshold: float,
    rotations: int = 4,
    max_nodes: int = MAX_NODES,
) -> float:
    """Upper bound on the discounted scaled return from a state (proven, see the module).

    Args:
        frames: float64[S, 4], the sides (:func:`learn2assemble.world.sides.side_frames`).
        threshold: Delta.
        rotations: 4 where objects may be turned about z (20 actions), 1 where not (5 actions).
        max_nodes: see :data:`learn2assemble.evaluation.packing.MAX_NODES`.
    """
    lattice, inventory = state_lattice(state, row, frames), state_inventory(state, row, rotations)
    most = most_pixels(lattice, inventory, rotations, max_nodes)
    span = int(state.mask_pixels[row] - state.initial_pixels[row])
    return discounted_bound(most, span, discount, threshold)


def state_lattice(state: State, row: int, frames: np.ndarray) -> Lattice:
    """Cells in and in front of the face planes, with the mask pixels still open on every side."""
    cells, images = _cell_images(tuple(map(tuple, frames.tolist())))
    open_pixels = state.mask[row] & ~state.covered[row]
    reached = (images[0] & open_pixels).any((-1, -2, -3))
    wanted = to_pixels(open_pixels)
    covered, hidden = (to_pixels(image[reached])[:, wanted] for image in images)
    placed = state.position[row, : state.num_placed[row]]
    taken = np.rint((placed - [0, 0, HALF]) / EDGE).astype(np.int64)
    return Lattice(cells[reached], covered, hidden, taken)


@lru_cache(maxsize=4)
def _cell_images(frames: tuple[tuple[float, ...], ...]) -> tuple[np.ndarray, np.ndarray]:
    """Cells int64[C, 3] and their (covered, occluded) images uint64[2, C, S, ROWS, WORDS]."""
    columns = EDGE * np.arange(-MAX_COLUMN, MAX_COLUMN + 1)
    depths = EDGE * np.arange(-FRONT, 1)
    x, y, z = np.meshgrid(columns, depths, EDGE * np.arange(NUM_LEVELS), indexing="ij")
    points = [to_world(np.array(frame), x, y, z).reshape(-1, 3) for frame in frames]
    cells = np.unique(np.rint(np.concatenate(points) / EDGE).astype(np.int64), axis=0)
    images = np.zeros((2, len(cells), len(frames), ROWS, WORDS), np.uint64)
    for n, cell in enumerate(cells):
        for side, (c, s, tx, ty) in enumerate(frames):
            wx, wy = EDGE * cell[0] - tx, EDGE * cell[1] - ty
            covered, occluded = images[:, n, side]
            add_box(
                covered, occluded, c * wx + s * wy, c * wy - s * wx, HALF + EDGE * cell[2], HALF
            )
    return cells, images


def state_inventory(state: State, row: int, rotations: int = 4) -> Inventory:
    """The unplaced objects; with ``rotations`` those equal after quarter turns count as one shape.

    Their waiting positions show their shapes (protocol 1.4).
    """
    waiting = slice(int(state.num_placed[row]), int(state.num_blocks[row]))
    position, number = state.position[row, waiting], state.object_id[row, waiting]
    counts: dict[tuple, int] = {}
    for name in np.unique(number):
        cells = position[number == name]
        shape = np.rint((cells - cells[0]) / EDGE).astype(np.int64)
        key = min(_key(turned(shape, turns)) for turns in range(rotations))
        counts[key] = counts.get(key, 0) + 1
    return Inventory([np.array(key) for key in counts], list(counts.values()))


def _key(shape: np.ndarray) -> tuple:
    return tuple(sorted(map(tuple, (shape - shape.min(0)).tolist())))
