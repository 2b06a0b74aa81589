"""What two arms that build together ask of the cell they share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from learn2assemble.motion.plant import Plant, Readings


class Turns(Protocol):
    """Lets work of several arms run side by side on one clock."""

    def run(self, jobs: Sequence[Callable[[], None]]) -> Any:
        """Until all of them are done."""
        ...


class SharedCell(Protocol):
    """Plants of several arms in one world."""

    @property
    def plants(self) -> Sequence[Plant]:
        """One of each arm."""
        ...

    @property
    def clock(self) -> Turns:
        """The time they share."""
        ...

    def loosen(self) -> None:
        """Of a simulation: from now on everything may move, not only what an arm comes near."""
        ...

    def sense(self) -> Readings:
        """What is sensed now, with the first arm."""
        ...
