"""Where the sides of a structure stand (protocol 1.2).

Side ``i`` is the image of side 1 under ``p_world = R_z(angle) p_local + t``.
"""

from __future__ import annotations

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.world.blocks import EDGE

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
