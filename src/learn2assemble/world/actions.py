"""Placements: which unplaced block, against which placed block, in which way (protocol 5).

With R rotations, action ``k`` is relation ``k div R`` after ``k mod R`` quarter turns of the
object about the vertical axis through the chosen block: 5 actions for R = 1, 20 for R = 4.
"""

from __future__ import annotations

import numpy as np
from numba import njit

RELATIONS = ("top", "left", "right", "front", "behind")
"""Names of the five relative placements, in the order of the action index."""

DIRECTIONS = np.array([[0, 0, 1], [-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0]], np.float64)
"""float64[5, 3]: unit direction of each relation in the reference block's frame."""

ROTATIONS = (1, 4)
"""Numbers of quarter turns a task may offer: none, or all of them."""


@njit(cache=True, inline="always")
def quarter_turn(x, y, turns):
    """``(x, y)`` after ``turns`` (0..3) quarter turns to the left, seen from above; exact."""
    if turns == 1:
        return -y, x
    if turns == 2:
        return -x, -y
    if turns == 3:
        return y, -x
    return x, y
