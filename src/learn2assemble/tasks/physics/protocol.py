"""What a physics must do, and its verdicts."""

from __future__ import annotations

from enum import IntEnum
from typing import Protocol

import numpy as np

from learn2assemble.tasks.physics import support
from learn2assemble.tasks.world.state import State

ARM = 16
"""Verdicts above are outcomes of an arm: this and the number of the outcome."""


class PlacementVerdict(IntEnum):
    """Outcome of one placement. Only STABLE is valid."""

    STABLE = support.STABLE
    OVERLAP = support.OVERLAP
    BELOW_GROUND = support.BELOW_GROUND
    FLOATING = support.FLOATING
    UNDECIDED = support.UNDECIDED
    """Internal: the compiled rule cannot tell; never returned by :meth:`Physics.settle`."""
    UNSTABLE = support.UNSTABLE
    """In contact, but not in equilibrium (static) or moving too much (rigid)."""
    UNREACHABLE = ARM + 1
    """This and the following: what became of the arm's attempt, see
    :class:`learn2assemble.robot.moves.Outcome`."""
    GRASP_COLLISION = ARM + 2
    PLACE_COLLISION = ARM + 3
    GRASP_LOST = ARM + 4
    DISTURBED_STRUCTURE = ARM + 5
    TOPPLED = ARM + 6
    DROPPED = ARM + 7


class Physics(Protocol):
    """Decides whether the object placed last stays, and where everything comes to rest."""

    name: str
    moves_blocks: bool
    """Whether :meth:`settle` changes poses, so that coverage must be recomputed."""

    def prepare(self, state: State, rows: np.ndarray, actions: np.ndarray) -> None:
        """Look at ``rows`` before the objects of ``actions`` (int64[B, 3], see
        :meth:`Simulator.step`) are put at their places; :meth:`settle` follows."""
        ...

    def settle(self, state: State, rows: np.ndarray) -> np.ndarray:
        """Judge the last placed object of each row in ``rows`` (int64[R]).

        May update ``position`` and ``quaternion`` of placed blocks in place.

        Returns:
            int8[R] of :class:`PlacementVerdict`.
        """
        ...
