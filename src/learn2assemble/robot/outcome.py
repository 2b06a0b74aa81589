"""What can become of a pick and place."""

from __future__ import annotations

from enum import IntEnum


class Outcome(IntEnum):
    """Typed outcome, the same at every fidelity of the arm. Only REACHED is a success."""

    REACHED = 0
    UNREACHABLE = 1
    """A pose of the hand is out of reach, or no free path leads to it."""
    GRASP_COLLISION = 2
    """Hand, arm or held object would touch something while picking up."""
    PLACE_COLLISION = 3
    """The same while placing, releasing or retreating; also an occupied cell."""
    GRASP_LOST = 4
    """The object slipped out of the fingers before it was placed."""
    DISTURBED_STRUCTURE = 5
    """An earlier block was moved too far."""
    UNSTABLE = 6
    """The object does not stand where it was put."""
    DROPPED = 7
    """The object fell elsewhere."""
