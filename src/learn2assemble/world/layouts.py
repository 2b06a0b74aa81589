"""Where the sides of a structure stand, and where unplaced objects wait.

Side ``i`` is the image of side 1 under ``p_world = R_z(angle) p_local + t``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.world.blocks import EDGE, HALF

_ANGLES = {1: (0,), 2: (0, 180), 3: (0, 180, 90), 4: (0, 180, 90, -90)}


def side_frames(num_sides: int, spacing: float = EDGE, aisle: int = 0) -> np.ndarray:
    """Frames of the sides as rows ``(cos, sin, t_x, t_y)``: ``float64[S, 4]``.

    Two sides are two parallel walls with ``aisle`` empty rows of cells between them, touching
    without; three and four are faces of a footprint of 3x3 cells centred at ``(0, spacing)``.
    ``spacing`` [m] is the block pitch.

    Raises:
        InputError: for a number of sides outside 1..4.
    """
    if num_sides not in _ANGLES:
        raise InputError("num_sides", num_sides, "1, 2, 3 or 4")
    d = spacing
    offsets = {
        1: ((0, 0),),
        2: ((0, 0), (0, d * (1 + aisle))),
        3: ((0, 0), (0, 2 * d), (d, d)),
        4: ((0, 0), (0, 2 * d), (d, d), (-d, d)),
    }[num_sides]
    quarter = {0: (1, 0), 180: (-1, 0), 90: (0, 1), -90: (0, -1)}
    rows = [(*quarter[a], *t) for a, t in zip(_ANGLES[num_sides], offsets, strict=True)]
    return np.asarray(rows, np.float64)


def to_world(frame: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Local coordinates of a side [m] to world points ``float64[..., 3]``."""
    c, s, tx, ty = frame
    return np.stack([c * x - s * y + tx, s * x + c * y + ty, z + 0 * x], -1)


def sobol(count: int) -> np.ndarray:
    """The first ``count`` one-dimensional Sobol numbers in Gray-code order, starting at 0.5."""
    value, out = 0, np.empty(count)
    for k in range(count):
        lowest_zero = (~k & (k + 1)).bit_length()
        value ^= 1 << (53 - lowest_zero)
        out[k] = value / 2.0**53
    return out


def _line(count: int, share: float = 1.0) -> np.ndarray:
    x = (2 * sobol(count) - 1) * 20.5 * EDGE * share
    return np.stack([x, np.full(count, -EDGE), np.zeros(count)], -1)


def _short_line(count: int) -> np.ndarray:
    return _line(count, 0.25)


def _six(count: int) -> np.ndarray:
    """x of places in rows of six that an arm standing to the left can reach [m]."""
    return (2 * sobol(6)[np.arange(count) % 6] - 1) * 7.6875 * EDGE - 1.5375 * EDGE


def _rows(count: int) -> np.ndarray:
    y = -0.2 - 0.125 * (np.arange(count) // 6)
    return np.stack([_six(count), y, np.full(count, HALF)], -1)


def _slanted_rows(count: int) -> np.ndarray:
    number = np.arange(count) // 6
    x, y = _six(count) - 0.025 * number, -0.15 - 0.1 * number
    return np.stack([x, y, np.full(count, HALF)], -1)


def _around(count: int) -> np.ndarray:
    """Rows of five, in turn before and behind two walls with an aisle, the nearest first."""
    k = np.arange(count)
    row, behind = k // 10, (k // 5) % 2 == 1
    y = np.where(behind, 0.26, -0.14) + 0.09 * row * np.where(behind, 1, -1)
    return np.stack([0.09 * (k % 5) - 0.27, y, np.full(count, HALF)], -1)


def _columns(count: int) -> np.ndarray:
    # The published code counts heights from the table here, not from the centres of cells.
    return np.stack([_six(count), np.full(count, -0.15), np.zeros(count)], -1)


OBJECTS_APART = 0.07
"""Least distance of the cells of two waiting objects, and of none to the wall [m]."""
CUBES_APART = 0.095
"""Least distance of two cubes that wait at random places: room for the fingers [m]."""

LAYOUTS = {
    "line": (_line, 0.0),
    "rows": (_rows, 0.0),
    "field": (_line, OBJECTS_APART),
    "narrow-field": (_short_line, OBJECTS_APART),
    "slanted-rows": (_slanted_rows, 0.0),
    "around": (_around, 0.0),
    "columns": (_columns, OBJECTS_APART),
    "random": (_rows, CUBES_APART),
}
"""Positions of the k-th object, and how far apart the cells of objects are kept [m]."""
RANDOM = "random"
"""The layout whose places are drawn anew for every problem."""


class Waiting(NamedTuple):
    """Where objects wait."""

    position: np.ndarray
    """float64[n, 3]: origin of the k-th waiting object [m], before it is moved apart."""
    apart: float
    """An object steps back by one edge in y until its cells are at least this far from those of
    every earlier one, and in front of the wall [m]; 0: it never does."""
    random: bool = False
    """Cubes wait at random places on both sides of the structure instead, ``apart`` from each
    other."""


def waiting_places(layout: str, count: int) -> Waiting:
    """Where up to ``count`` objects wait.

    ``line`` spreads cubes on a line in front of side 1 (no-robot environments), ``rows`` in rows
    of six (the one-sided robot cell and its twin). ``field`` (bars) and ``narrow-field`` (objects)
    start on a line, too, and move objects of several cells apart. With a robot, ``slanted-rows``
    are rows of six each a little to the left of the one before, ``columns`` (objects) start at six
    places of one row, ``around`` (ours) keeps to what an arm can reach beside walls five cells
    wide, and ``random`` scatters cubes before and behind the structure. The published
    code drops some of these for ten simulation steps and draws again where something moved;
    waiting objects are positions only here, so nothing can move (D18).

    Raises:
        UnknownNameError: for a layout that does not exist.
    """
    if layout not in LAYOUTS:
        raise UnknownNameError("layout", layout, LAYOUTS)
    place, apart = LAYOUTS[layout]
    return Waiting(place(count), apart, layout == RANDOM)
