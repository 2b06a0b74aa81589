"""What every robot cell reports of a move."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.robot.outcome import Outcome
from learn2assemble.robot.scene import Scene


class Attempt(NamedTuple):
    """What became of a move."""

    outcome: Outcome
    stage: str = ""
    """Where it failed; empty for a success."""
    detail: str = ""
    """Why, in one line."""
    pick: np.ndarray | None = None
    """float64[k, n]: joint positions over the picked cell, from the contact upwards [rad]."""
    place: np.ndarray | None = None
    """The same over the target."""
    after: Scene | None = None
    """Where everything is then, where that was simulated, also after a failure; the moved object
    listed as :func:`learn2assemble.robot.scene.put_down` does."""
    by_link: bool = False
    """A link of the arm, not its hand, was in the way."""

    @property
    def reached(self) -> bool:
        return self.outcome == Outcome.REACHED
