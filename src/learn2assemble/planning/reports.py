"""What a plan tells besides its steps: parts of its schema (``docs/plan.md``)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from learn2assemble.values import Range

Count = Annotated[int, Range(0, 1e6)]
Metre = Annotated[float, Range(-1e3, 1e3)]


@dataclass(frozen=True)
class RebuildReport:
    """From a structure that stands already: how its blocks become those of the new one."""

    moves: Count
    """Blocks that are carried from one place to another. A block that is taken away right before
    one of its kind is placed is carried there: one move."""
    moves_bound: Count
    """No order without help has fewer moves."""
    kept: Count
    """Blocks that stay where they are."""
    taken: Count
    """Blocks that are taken away, those among them that come back to the same place."""
    placed: Count
    """Blocks that are placed."""
    supplied: Count = 0
    """Of :attr:`placed`, those that the old structure has not."""


@dataclass(frozen=True)
class BuilderArm:
    """One of several arms that build."""

    name: str
    """As steps call it."""
    arm: str
    """What it is."""
    tool: str
    base: tuple[Metre, Metre, Metre, Annotated[float, Range(-100, 100)]]
    """x, y, z of its base [m], and the direction it faces [rad from x]."""
    reaches: Count
    """How many of the blocks of the structure it reaches."""
