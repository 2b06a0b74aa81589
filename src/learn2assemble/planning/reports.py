"""What a plan tells besides its steps: parts of its schema (``docs/plan.md``)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from learn2assemble.values import Range

Count = Annotated[int, Range(0, 1e6)]
Metre = Annotated[float, Range(-1e3, 1e3)]
Seconds = Annotated[float, Range(0, 1e9)]


@dataclass(frozen=True)
class RebuildReport:
    """From a structure that stands already: how its blocks become those of the new one, by hand; an
    arm that carries it out has an order of its own and puts every block that goes in a magazine."""

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
class ArmFailure:
    """An attempt of the arm that failed."""

    attempt: Count
    outcome: str
    detail: str
    replanned: bool


@dataclass(frozen=True)
class ArmReport:
    """What the arm did."""

    name: str
    pitch: Metre
    """Horizontal distance of neighbouring blocks."""
    attempts: Count
    failures: tuple[ArmFailure, ...]
    seconds: Seconds | None = None
    """How long the arm took; None where nothing moved it."""
    tool: str = "gripper"
    """What it held blocks with."""
    base: tuple[Metre, Metre, Metre, Annotated[float, Range(-100, 100)]] | None = None
    """x, y, z of its base [m], and the direction it faces [rad from x]."""
    places: Count | None = None
    """Poses at which blocks wait for it: magazines, and places of single blocks."""
    attempts_per_step: Annotated[float, Range(0, 1e6)] | None = None
    """Attempts over blocks placed and props taken away; 1 where nothing failed."""
    error_mean: Metre | None = None
    """Mean distance of the blocks from their places at the end [m] ..."""
    error_worst: Metre | None = None
    """... and the largest."""
    belief_error: Metre | None = None
    """Largest distance of a block from where it was believed to be at the end, where a simulation
    can tell [m]."""
    overlap: Annotated[float, Range(-1e3, 1e3)] | None = None
    """By which two blocks overlap at most at the end [m]; not above 0: they do not."""
    error_on_table: Metre | None = None
    """Largest distance of a block from its place on the table as it really is, where a simulation
    has one that is higher, lower or leans [m]."""
    planed_props: Count = 0
    """Props whose top has to be a little lower than that of their kind, so that they come out from
    below what they carry ..."""
    planed_off: Metre = 0.0
    """... and by how much [m]."""
    motion_fault: str | None = None
    """Why no robot is to be given the recorded motion, if it is not sound; the build is as it is
    told."""

    @property
    def planed_words(self) -> str:
        """What has to be done to some props before an arm builds with them; empty for none."""
        count, off = self.planed_props, 1e3 * self.planed_off
        if not count:
            return ""
        which = "prop is" if count == 1 else "props are"
        its = "its kind: plane its top" if count == 1 else "their kind: plane their tops"
        back = "it comes out again" if count == 1 else "they come out again"
        return f"{count} {which} {off:g} mm lower than {its}, so that {back}"


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
    did: ArmReport | None = None
    """Where it has built: what it did; errors are those of the blocks that it placed last, the
    overlap is that of all."""
