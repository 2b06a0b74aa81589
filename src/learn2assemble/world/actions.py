"""Placements: which unplaced block, against which placed block, in which way (protocol 5).

An action ``k`` is relation ``k div R`` in way ``k mod R``. Without a robot the way is a number of
quarter turns of the object about the vertical axis through the chosen block: 5 actions for R = 1,
20 for R = 4. With a robot it is a pair of gripper attitudes.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit

from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.world.blocks import EDGE

RELATIONS = ("top", "left", "right", "front", "behind")
"""Names of the five relative placements, in the order of the action index."""

DIRECTIONS = np.array([[0, 0, 1], [-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0]], np.float64)
"""float64[5, 3]: unit direction of each relation in the reference block's frame."""

ROTATIONS = (1, 4)
"""Numbers of ways a task may offer in each relation."""

ATTITUDES = {
    "turns": (((0, 0), (0, 1), (0, 2), (0, 3)), False),
    "grips": (((0, 0), (0, 3), (3, 0), (3, 3)), True),
}
"""What the ways are: the quarter turns of the hand over the place where it picks and over the one
where it places, and whether it is a gripper. ``turns`` turn the object in a hand that nothing is in
the way of; any number of them may fill the same cells. ``grips`` are the (grasp, place) yaws AA,
AB, BA, BB: two of them fill the same cells and are different actions all the same, as the fingers
stand elsewhere."""


class Ways(NamedTuple):
    """What actions mean, beside the relation: a :attr:`Task.ways`."""

    pitch: float
    """Horizontal distance of the centres of neighbouring cells [m]."""
    turns: np.ndarray
    """int64[R]: quarter turns the object makes in each way."""
    grips: np.ndarray
    """int64[R]: ways with different numbers are different even where the cells are the same."""
    hands: np.ndarray
    """int64[R, 2]: quarter turns of the hand where it picks and where it places; the object turns
    by their difference."""
    level: bool
    """The object's lowest cell comes to the level of the reference, not the chosen cell."""

    @property
    def num_grips(self) -> int:
        return int(self.grips.max()) + 1


@lru_cache
def get_ways(attitudes: str = "turns", rotations: int = 1, pitch: float = EDGE) -> Ways:
    """The ways of a task.

    Args:
        attitudes: a name of :data:`ATTITUDES`.
        rotations: R, how many there are in each relation.
        pitch: horizontal distance of the centres of neighbouring cells [m].

    Raises:
        UnknownNameError: for other attitudes.
        InputError: for another number of ways.
    """
    if attitudes not in ATTITUDES:
        raise UnknownNameError("attitudes", attitudes, ATTITUDES)
    pairs, gripped = ATTITUDES[attitudes]
    if rotations not in ROTATIONS:
        raise InputError("rotations", rotations, "1 or 4")
    grips = np.arange(rotations) if gripped else np.zeros(rotations, np.int64)
    hands = np.array(pairs[:rotations])
    return Ways(float(pitch), (hands[:, 1] - hands[:, 0]) % 4, grips, hands, gripped)


def step_sizes(pitch: float) -> np.ndarray:
    """float64[3]: from a cell to its neighbours along x, y and z [m]."""
    return np.array([pitch, pitch, EDGE])


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
