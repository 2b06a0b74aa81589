"""What two arms that build together ask of the cell they share, what they tell each other, and what
one takes to be so meanwhile."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence, Set
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import numpy as np

from learn2assemble.cell.building import Building
from learn2assemble.cell.traffic import Leg, Route
from learn2assemble.cell.world import STANDING, STOCK
from learn2assemble.motion.plant import Plant, Readings
from learn2assemble.robot.capsules import WIDEST, capsules_of, in_hand, solid_capsules
from learn2assemble.robot.sweeps import still, sweep
from learn2assemble.simulation.execution import Execution
from learn2assemble.simulation.model import Order, part_of


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


class Assumed(NamedTuple):
    """A block of the other arm that is taken to stand already, and what was known before."""

    block: int
    pose: np.ndarray
    """float64[7]: where it was."""
    joints: frozenset[tuple[int, int]]
    """Joints of studs that are taken to be home."""


def assume(building: Building, block: int) -> Assumed:
    """An arm takes a block of the other one, from its magazine, to stand in its place."""
    world = building.world
    joints = building.known.structure.made_by(block, world) - world.home
    before = Assumed(block, world.pose[block].copy(), frozenset(joints))
    world.pose[block], world.state[block] = world.target(block), STANDING
    world.home |= joints
    return before


def forget(building: Building, assumed: Assumed) -> None:
    """It does not any more."""
    world = building.world
    world.pose[assumed.block], world.state[assumed.block] = assumed.pose, STOCK
    world.home -= assumed.joints


def tell(mine: Building, other: Building, changed: Set[int]) -> None:
    """An arm tells the other one what came of an attempt.

    Args:
        mine: of the arm that tells.
        other: of the arm that is told.
        changed: the pieces that are otherwise now.
    """
    while len(other.world.pieces) < len(mine.world.pieces):
        other.recording.replace(mine.recording.like[len(other.recording.like)])
        other.names.add(mine.world.names[-1])
    for k in changed:
        other.world.state[k] = mine.world.state[k]
        other.world.pose[k], other.world.spread[k] = mine.world.pose[k], mine.world.spread[k]
        name = mine.world.names[k]
        if name in mine.sight.belief.known:
            other.sight.belief.known[name] = mine.sight.belief.known[name]
        fails = other.known.fails
        other.known.fails = Counter({key: n for key, n in fails.items() if key[0] != k})
    other.world.beside[:], other.world.home = mine.world.beside, set(mine.world.home)
    other.known.refused.clear()
    other.recording.sync()


def route_of(
    run: Execution, block: str, along: Sequence[str] = (), widest: float = WIDEST
) -> Route:
    """What an attempt that is about to begin announces.

    Args:
        run: the attempt.
        block: name of what it moves, ...
        along: ... and of what it brings along.
        widest: half of what of a block is in one capsule at most [m]; the finer, the nearer it may
            come to the other arm.
    """
    arm, order, plan = run.rig.arm, run.order, run.course.plan
    own, objects = capsules_of(arm), order.objects.shape[order.target]
    parts = [part_of(box) for box in objects]
    held = in_hand(arm, solid_capsules(parts, *order.in_hand(plan.move.grasp), widest))
    both = own.add(held)
    goal = still(solid_capsules(parts, *order.in_world(plan.move.grasp, plan.move.place)))
    empty = [("approach", way) for way in pairwise(run.course.there)]
    legs = [Leg(stage, sweep(arm, own, np.array(way))) for stage, way in empty]
    pick, place, leave = (one.joints for one in (plan.pick, plan.place, plan.leave))
    legs.append(Leg("pick", sweep(arm, own, pick[::-1])))
    legs.append(Leg("lift", sweep(arm, both, pick)))
    legs += [Leg("cross", sweep(arm, both, np.array(way))) for way in pairwise(run.course.across)]
    legs.append(Leg("place", sweep(arm, both, place[::-1])))
    legs.append(Leg("retreat", sweep(arm, own, leave)))
    legs += [Leg("home", sweep(arm, own, np.array(way))) for way in pairwise(run.course.home)]
    # The way down goes on below the place, the farther the harder it is pressed there.
    there = sweep(arm, both, place[np.abs(plan.place.rise).argmin()][None])
    return Route(block, held, tuple(legs), goal, there, tuple(along), _loads(order))


def _loads(order: Order) -> frozenset[str]:
    """See :attr:`Route.loads`."""
    own = set(order.scene.members(order.move.cell).tolist())
    joints = () if order.scene.studs is None else order.scene.studs.joints
    outer = [one for one in joints if (one.upper in own) != (one.lower in own)]
    return frozenset("lift" if one.home else "place" for one in outer)
