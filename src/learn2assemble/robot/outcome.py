"""What an attempt of the arm comes to, the same for every cell (kinematic, dynamic, published)."""

from __future__ import annotations

from enum import IntEnum


class Outcome(IntEnum):
    """Result of one pick and place; stored as int8. Everything but ``REACHED`` is a failure."""

    REACHED = 0
    """The block stands where it should and nothing else moved."""
    UNREACHABLE = 1
    """No joint configuration for a pose on the way (:class:`~.inverse.IKFailure` says why)."""
    GRASP_COLLISION = 2
    """Something is touched while approaching, grasping or lifting."""
    PLACE_COLLISION = 3
    """Something is touched by arm or held object on the way, while placing or retreating."""
    GRASP_LOST = 4
    """The fingers closed on nothing, or the block slipped out before it was lifted."""
    DISTURBED_STRUCTURE = 5
    """A block that was there before has moved."""
    UNSTABLE = 6
    """The placed object did not stay where it was released."""
    DROPPED = 7
    """The block left the hand between lifting and release."""

    @property
    def label(self) -> str:
        """The name as it is shown, e.g. ``"grasp-collision"``."""
        return self.name.lower().replace("_", "-")
