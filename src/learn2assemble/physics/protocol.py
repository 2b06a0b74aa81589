"""What a physics must do, and its verdicts."""

from __future__ import annotations

from enum import IntEnum
from typing import Protocol

import numpy as np

from learn2assemble.geometry import boxes
from learn2assemble.world.state import State


class Verdict(IntEnum):
    """Outcome of one placement. Only STABLE is valid."""

    STABLE = boxes.STABLE
    OVERLAP = boxes.OVERLAP
    BELOW_GROUND = boxes.BELOW_GROUND
    FLOATING = boxes.FLOATING
    UNDECIDED = boxes.UNDECIDED
    """Internal: the compiled rule cannot tell; never returned by :meth:`Physics.settle`."""
    UNSTABLE = boxes.UNSTABLE
    """In contact, but not in equilibrium (static) or moving too much (rigid)."""


class Physics(Protocol):
    """Decides whether the object placed last stays, and where everything comes to rest."""

    name: str
    moves_blocks: bool
    """Whether :meth:`settle` changes poses, so that coverage must be recomputed."""

    def settle(self, state: State, rows: np.ndarray) -> np.ndarray:
        """Judge the last placed object of each row in ``rows`` (int64[R]).

        May update ``position`` and ``quaternion`` of placed blocks in place.

        Returns:
            int8[R] of :class:`Verdict`.
        """
        ...
