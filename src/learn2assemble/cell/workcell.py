"""An arm carries out a plan: any blocks at any pose, tight joints, props placed and taken away.

First the order is chosen with the kinematic cell: among the blocks whose support stands, those of
the lowest level and farthest from the arm first, the first one that the arm can pick up and put
down; every state is proven to stand as in the plan. Then a plant carries it out, and the arm looks
where everything is; small deviations are corrected in the next placements, large ones are repaired:
what stands wrongly is taken up and placed again, after what stands on it has been taken away.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from learn2assemble.assembly.cuts import ground_of
from learn2assemble.cell.pieces import ON_TABLE, Piece, pieces_of
from learn2assemble.cell.site import Obstacle, Site, Source
from learn2assemble.errors import InputError
from learn2assemble.plants.setup import Disturbance, Noise, Simulated
from learn2assemble.robot.arm import Arm, get_arm

if TYPE_CHECKING:
    from learn2assemble.assembly.blocks import Assembly
    from learn2assemble.planning.plan import Plan

Progress = Callable[[str], None]
STANDS = 0.003
"""A block farther from its place than this is placed again [m] ..."""
STRAYED = 0.0015
"""... and so is one that is for certain farther than this from it and from where it would be put
now [m] ..."""
LEANS = math.radians(2.0)
"""... and so is one that leans or is turned by more [rad]."""
TRIES = 3
"""Attempts at one step before others come first."""


ROOMS = 0.0015, 0.0
"""Room for the hand beside others where it presses, if there is so much; else none [m]."""
Offset = tuple[float, float, float]
"""[m]"""


class StepOf(NamedTuple):
    """A step of the order."""

    block: int
    """Index of the piece."""
    remove: bool = False
    beside: Offset | None = None
    """How far from its place it is put: it is part of a piece of the structure that is built
    beside, on the table."""
    group: tuple[int, ...] = ()
    """The other blocks of such a piece, which it brings along: to their places, or to a larger
    piece that is built beside, too."""
    whence: Offset = (0.0, 0.0, 0.0)
    """How far from their places these were built."""

    @property
    def to(self) -> Offset:
        """How far from its place it is put."""
        return self.beside or (0.0, 0.0, 0.0)

    @property
    def plain(self) -> StepOf:
        """The step of a plan, which does not know where its blocks are built."""
        return StepOf(self.block, self.remove)


@dataclass(frozen=True)
class Workcell:
    """How an arm builds."""

    arm: str
    tool: str = "suction"
    site: Site = dataclasses.field(default_factory=Site)
    physics: str = "dynamic"
    seed: int = 0
    noise: Noise | tuple[float, float] = (0.0, 0.0)
    """Of readings in a simulation: a :class:`Noise`, or its first two fields."""
    disturbance: Disturbance | None = None
    """What goes otherwise than planned in a simulation."""
    touch: bool = True
    """Whether the arm learns from what its tool touches where it holds a block."""
    hands: bool = False
    """Props that the arm cannot place or take away are placed and taken away by hand."""
    log: Path | None = None
    """What is appended to after every attempt; where it exists, the build goes on from it."""

    @property
    def simulated(self) -> Simulated:
        """The simulated plant that belongs to it."""
        disturbance = self.disturbance or Disturbance()
        noise = self.noise if isinstance(self.noise, Noise) else Noise(*self.noise)
        return Simulated(self.physics, self.seed, noise, disturbance)

    @property
    def strays(self) -> bool:
        """Whether blocks of its simulation may end elsewhere than they are told to."""
        told = self.simulated
        chance = told.noise != Noise() or told.disturbance != Disturbance()
        return told.physics != "kinematic" or chance or bool(self.site.cameras)


@dataclass(frozen=True, eq=False)
class Job:
    """What is to be built, by whom and from what."""

    pieces: tuple[Piece, ...]
    steps: tuple[StepOf, ...]
    """As the exact plan orders them."""
    assembly: Assembly
    arm: Arm
    sources: tuple[Source, ...]
    obstacles: tuple[Obstacle, ...] = ()
    friction: float = 0.5
    """For which states are proven that the plan does not have: the least that was asked for."""
    joint: float = 1e-4
    """Width of a vertical joint [m]."""
    hands: bool = False
    """Props that the arm cannot place or take away are placed and taken away by hand."""
    standing: tuple[int, ...] = ()
    """Pieces that stand before the first step, from below, supports aside."""

    @property
    def there(self) -> tuple[int, ...]:
        """All that stands before the first step, supports too."""
        return *(k for k, piece in enumerate(self.pieces) if piece.fixed), *self.standing

    @property
    def first(self) -> tuple[StepOf, ...]:
        """The steps that would have placed what stands before the first one and stays, and do so
        again where it does not stand any more."""
        removed = {step.block for step in self.steps if step.remove}
        return tuple(StepOf(k) for k in self.standing if k not in removed)

    @property
    def base(self) -> np.ndarray:
        """float64[2] of the arm [m]."""
        return self.arm.base_position[:2]


def job_of(plan: Plan, arm: str, joint: float, hands: bool = False, holding: bool = False) -> Job:
    """What a complete plan asks of an arm.

    Args:
        hands: whether props may be placed and taken away by hand.
        holding: whether blocks may be held; these steps are not part of the job.

    Raises:
        InputError: for steps that hold a block, for supports beside the table, and for blocks of
            too many convex parts.
    """
    assert plan.assembly is not None
    least = plan.margin_friction
    holds = sum(step.action == "hold" for step in plan.steps)
    if holds and not holding:
        expected = "a plan without holds; one arm has one hand"
        raise InputError("steps that hold a block", holds, expected)
    moved = [step for step in plan.steps if step.action in ("place", "remove")]
    steps = tuple(StepOf(step.block, step.action == "remove") for step in moved)
    check_ground(plan.assembly)
    pieces, first = pieces_of(plan.assembly), plan.assembly.at_first
    standing = [k for k, there in enumerate(first) if there and not pieces[k].fixed]
    return Job(
        pieces,
        steps,
        plan.assembly,
        get_arm(arm),
        (),
        friction=plan.assembly.friction if least is None else least,
        joint=joint,
        hands=hands,
        standing=tuple(sorted(standing, key=lambda k: float(pieces[k].extent[0][2]))),
    )


def check_ground(assembly: Assembly) -> None:
    """Refuse supports alone, and what an arm's table, z = 0, does not carry: supports above it, and
    props that stand lower, where supports begin below it.

    Raises:
        InputError: saying which.
    """
    if all(block.support for block in assembly.blocks):
        raise InputError("design", "supports alone", "a block that comes, for an arm")
    ground = ground_of(assembly.blocks)
    what = "supports whose lowest point is" if ground > ON_TABLE else ""
    if ground < -ON_TABLE:
        props = (float(b.vertices[:, 2].min()) for b in assembly.blocks if b.prop)
        what = "props that stand" if min(props, default=0.0) < -ON_TABLE else ""
    if what:
        got = f"{what} at z = {ground:g} m"
        raise InputError("design", got, "what stands on the table, z = 0, for an arm")


Direction = tuple[float, float, float]
"""A unit vector."""
DOWN: Direction = (0.0, 0.0, -1.0)
"""The way on which blocks come to their places, if nothing leans."""
