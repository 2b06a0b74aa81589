"""The lattice of blocks on one elevation and the camera pixels each cell fills.

Cell ``(column k, level n)`` is centred at local ``x = p k``, ``z = 0.025 + 0.05 n`` [m], in the
plane of the elevation (``y = 0``); the pitch p is 0.05 where blocks touch. Pixel sets come from the
same ray casting as the world's own coverage (protocol 3.4, 3.5), so counts agree with the simulator
exactly.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from learn2assemble.geometry.bits import ROWS, WORDS
from learn2assemble.geometry.camera import CAMERA_Z
from learn2assemble.geometry.coverage import FILTERS, DepthFilter, add_box, clear_to_ground
from learn2assemble.world.blocks import EDGE, HALF

MAX_COLUMN = 7
"""Columns run from -MAX_COLUMN to MAX_COLUMN: faces up to |x| = 0.375 m where blocks touch, inside
the view."""
NUM_COLUMNS = 2 * MAX_COLUMN + 1
NUM_LEVELS = 12
"""Levels run from 0 to NUM_LEVELS - 1: faces up to z = 0.6 m, inside the view."""


class Cell(NamedTuple):
    """One place of the lattice on an elevation."""

    column: int
    """k: the face spans x = p k ± 0.025 m as the viewer sees it, p the pitch."""
    level: int
    """n: the face spans z = 0.05 n .. 0.05 (n + 1) m."""


class Terms(NamedTuple):
    """On which lattice a design is built, and how cameras count what covers it."""

    pitch: float = EDGE
    """Horizontal distance of the centres of neighbouring blocks [m]."""
    aisle: int = 0
    """Empty rows of cells between two walls."""
    cover_filter: str = "narrow"
    """A name of :data:`~learn2assemble.geometry.coverage.FILTERS`."""
    from_first: bool = True
    """Coverage counts what the first block leaves open; else all of the outlines."""
    of_coverable: bool = False
    """A design's threshold is a share of what such blocks can cover; else of everything."""
    margin: float = 0.0
    """How much smaller than it is every block is taken to be, on each side [m]."""

    @property
    def depths(self) -> DepthFilter:
        """The camera."""
        depths = FILTERS[self.cover_filter]
        return depths._replace(margin=depths.margin + self.margin)


TOUCHING = Terms()
"""Blocks that touch, as a hand of god can put them."""


def count_pixels(image: np.ndarray) -> int:
    """Number of pixels in a pixel set ``uint64[...]`` of any shape."""
    return int(np.bitwise_count(image).sum())


def _frozen(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array


@lru_cache(maxsize=4)
def table_pixels(terms: Terms = TOUCHING) -> tuple[np.ndarray, np.ndarray]:
    """``(covered, occluded)`` of the empty table: ``uint64[ROWS, WORDS]`` each, read-only."""
    covered, occluded = np.zeros((2, ROWS, WORDS), np.uint64)
    clear_to_ground(covered, occluded, terms.depths)
    return _frozen(covered), _frozen(occluded)


@lru_cache(maxsize=4)
def cell_pixels(terms: Terms = TOUCHING) -> np.ndarray:
    """Pixels each cell fills that the table does not: ``uint64[NUM_COLUMNS, NUM_LEVELS, ...]``.

    Complete filter of protocol 3.4; index ``k + MAX_COLUMN`` is column ``k``. Read-only. Two
    neighbouring cells may both fill a pixel that sees their common edge.
    """
    table, _ = table_pixels(terms)
    cells = np.zeros((NUM_COLUMNS, NUM_LEVELS, ROWS, WORDS), np.uint64)
    unused = np.zeros((ROWS, WORDS), np.uint64)
    for index in range(NUM_COLUMNS):
        for level in range(NUM_LEVELS):
            x, z = terms.pitch * (index - MAX_COLUMN), HALF + EDGE * level
            add_box(cells[index, level], unused, x, 0.0, z, HALF, terms.depths)
    return _frozen(cells & ~table)


@lru_cache(maxsize=4)
def face_pixels(terms: Terms = TOUCHING) -> np.ndarray:
    """As :func:`cell_pixels`, but every pixel belongs to one cell: the one whose face it sees.

    The other one shows it only its flank, so it loses to the cell nearer to the optical axis; the
    row of pixels exactly on that axis, at the edge of levels 4 and 5, goes to the lower cell.
    """
    faces = cell_pixels(terms).copy()
    taken = np.zeros((ROWS, WORDS), np.uint64)
    columns = sorted(range(NUM_COLUMNS), key=lambda index: abs(index - MAX_COLUMN))
    levels = sorted(range(NUM_LEVELS), key=lambda n: round(abs(HALF + EDGE * n - CAMERA_Z), 6))
    for index, level in product(columns, levels):
        faces[index, level] &= ~taken
        taken |= faces[index, level]
    return _frozen(faces)


@lru_cache(maxsize=4)
def tower_pixels(terms: Terms = TOUCHING) -> np.ndarray:
    """Pixels of a tower of ``h`` blocks in each column: ``uint64[NUM_COLUMNS, NUM_LEVELS + 1, …]``.

    Read-only; ``h = 0`` is the empty set.
    """
    towers = np.zeros((NUM_COLUMNS, NUM_LEVELS + 1, ROWS, WORDS), np.uint64)
    towers[:, 1:] = np.bitwise_or.accumulate(cell_pixels(terms), axis=1)
    return _frozen(towers)
