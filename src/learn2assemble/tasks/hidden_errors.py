"""What goes otherwise in a build with hidden errors: of the hand, the blocks, and each placement.

All are zero-mean, and one factor scales them together; 0 is a build without errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from learn2assemble.constants import GRAVITY

BIAS = np.array([1.5e-3, 1.5e-3, 4e-3])
"""Of the hand, in every placement of an episode alike: x, y [m], yaw [rad]; as all that follows
standard deviations at the factor 1."""
SIZE = 4e-4
"""Of length and width of each block [m]; heights are exact, so that courses are level."""
SPEED = 0.05
"""Of a block along x and along y when the hand lets it go [m/s]; it slides until friction has
stopped it."""
TURN = 2e-3
"""By which a block turns as it is let go [rad]."""
JOLT = 0.08
"""Sideways acceleration of all that stands while something is put down or taken up [g]."""
LOOK = np.array([2e-4, 2e-4, 1e-3, 2e-4, 2e-4])
"""Of what a look says of a block: x, y [m], yaw [rad], length, width [m]."""
FRICTION = 0.5
"""Median of the coefficient of friction; the factor 1 halves or doubles it at most."""
_CUT = 3.0
"""Deviations of sizes are cut here, in standard deviations."""


@dataclass(frozen=True, eq=False)
class HiddenNumbers:
    """What does not change in an episode, and nobody is told."""

    bias: np.ndarray
    """float64[3]: where a block is let go less where it was to be: x, y [m], yaw [rad]."""
    size: np.ndarray
    """float64[n, 2]: length along x and y less the nominal one, as the blocks are drawn [m]."""
    friction: float


class Placing(NamedTuple):
    """What happens in one placement."""

    slip: np.ndarray
    """float64[3]: where a block comes to rest less where it was let go: x, y [m], yaw [rad]."""
    jolt: np.ndarray
    """float64[2]: sideways acceleration of all that stands [g]."""


def draw_numbers(count: int, factor: float, rng: np.random.Generator) -> HiddenNumbers:
    """Of an episode with so many blocks."""
    bias = factor * BIAS * rng.standard_normal(3)
    size = factor * SIZE * np.clip(rng.standard_normal((count, 2)), -_CUT, _CUT)
    return HiddenNumbers(bias, size, float(FRICTION * 2.0 ** (factor * rng.uniform(-1, 1))))


def draw_placing(friction: float, factor: float, rng: np.random.Generator) -> Placing:
    """Of a placement, or of taking up, of which only the jolt counts.

    A block with the speed v slides v² / (2 μ g), along v.
    """
    speed = SPEED * rng.standard_normal(2)
    slide = factor * speed * np.hypot(*speed) / (2 * friction * GRAVITY)
    turn = factor * TURN * rng.standard_normal()
    angle = 2 * np.pi * rng.random()
    size = factor * JOLT * abs(rng.standard_normal())
    return Placing(np.append(slide, turn), size * np.array([np.cos(angle), np.sin(angle)]))


def draw_look(count: int, factor: float, rng: np.random.Generator) -> np.ndarray:
    """float64[n, 5]: what a look says less what is."""
    return factor * LOOK * rng.standard_normal((count, len(LOOK)))
