"""Joints of studs in a scene: which cells they join, what they hold, and which are pressed home."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

GROUND = -1
Point = tuple[float, float]


def stud_axes(low: np.ndarray, high: np.ndarray, pitch: float) -> np.ndarray:
    """float64[n, 2]: where the studs of a brick are, whose top is between two corners float64[2],
    row by row [m].

    Args:
        pitch: distance of studs [m].
    """
    counts = np.maximum(np.rint((high - low) / pitch), 1)
    first = (high + low) / 2 - pitch * (counts - 1) / 2
    rows = int(counts[1])
    number = np.arange(int(counts[0]) * rows)
    return first + pitch * np.stack([number // rows, number % rows], 1)


class StudJoint(NamedTuple):
    """Two cells that clutch once the upper one is pressed home on the lower one.

    Directions are those of the lattice, which are those of the world.
    """

    lower: int
    """Cell of the scene, or GROUND."""
    upper: int
    at: tuple[float, float, float]
    """Centre of the upper cell from that of the lower one; above the ground where it is in the
    world [m]."""
    pull: float
    """Of all contact points together [N]."""
    middle: Point
    """Of these pulls, from the centre of the upper cell [m]."""
    hull: tuple[Point, ...]
    """Corners of the hull of the contact points, counter-clockwise, from there [m]."""
    face: tuple[Point, Point]
    """Smallest and largest corner of where the two faces meet, from there [m]."""
    home: bool

    def leaves(self, cells: Collection[int]) -> bool:
        """Whether it joins one of some cells to another one."""
        return (self.upper in cells) != (self.lower in cells)


class Studs(NamedTuple):
    """The joints of a scene."""

    joints: tuple[StudJoint, ...]
    press: float
    """With which a brick is pressed home [N]."""
