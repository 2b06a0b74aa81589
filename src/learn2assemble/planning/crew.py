"""Who builds: whose hand may bring which block, and hold it while the next one comes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, Protocol

from learn2assemble.assembly.blocks import Block
from learn2assemble.assembly.hands import Hand
from learn2assemble.statics.states import State


class Bringing(NamedTuple):
    """A way in which a block is brought to its place, and could be held there."""

    arm: str | None = None
    """Which arm does it, where there are several."""
    hand: Hand | None = None
    """What its hand can give; by default the hand bears any load."""


ANYHOW = Bringing()
NOBODY = "no arm can bring"
"""What a reason says before the blocks for which nobody has a grip."""


class Crew(Protocol):
    """Who builds some blocks."""

    def grips(self, block: int, state: State) -> Iterator[Bringing]:
        """Ways in which a block that is missing can be brought to its place among what is there,
        by those who hold nothing now; the best one first, none where it cannot come."""
        ...

    def takes(self, block: int, state: State) -> Iterator[Bringing]:
        """Ways in which a block that is there can be taken away, as :meth:`grips`."""
        ...


class Anybody:
    """As many hands as are needed, alike, to which every block may come.

    Args:
        hands: what a hand can give each block; by default, of all, it bears any load.
    """

    def __init__(self, hands: Sequence[Hand] = ()) -> None:
        self.hands = hands

    def grips(self, block: int, state: State) -> Iterator[Bringing]:
        yield Bringing(None, self.hands[block]) if block < len(self.hands) else ANYHOW

    def takes(self, block: int, state: State) -> Iterator[Bringing]:
        yield ANYHOW


CrewOf = Callable[[Sequence[Block]], Crew]
"""Who builds some blocks: those that are given, then posts."""


def anybody(blocks: Sequence[Block]) -> Crew:
    """Hands that bear any load."""
    return Anybody()


def alike(hand: Callable[[Block], Hand]) -> CrewOf:
    """Hands of which each can give a block the same."""
    return lambda blocks: Anybody([hand(block) for block in blocks])
