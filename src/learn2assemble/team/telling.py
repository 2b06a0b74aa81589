"""What two arms that build together ask of the cell they share, what they tell each other, and what
one takes to be so meanwhile; and what is kept of such a build: a file that is appended to after
every attempt of either.

Every line of that is all that both know then, with what the one that has ended its attempt did. The
other one may be in the middle of its own: where the build is gone on with, that never happened.
What it had in its hand has been taken out of it, what a magazine had presented goes back there, and
in a simulation it stands again where its last attempt has ended.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence, Set
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from learn2assemble.acting.building import Building
from learn2assemble.acting.carry_out import key_of
from learn2assemble.acting.journal import append_state, last_joints, packed, read_states
from learn2assemble.acting.state import Done
from learn2assemble.cell.workcell import Offset, Workcell
from learn2assemble.cell.world import STANDING, STOCK
from learn2assemble.handling.execution import Execution
from learn2assemble.kinematics.capsules import WIDEST, capsules_of, in_hand, solid_capsules
from learn2assemble.kinematics.sweeps import clear, still, sweep
from learn2assemble.planning.plan import Plan
from learn2assemble.plants.plant import Plant, Readings
from learn2assemble.robot.arm import Arm
from learn2assemble.simulation.objects import Order, part_of
from learn2assemble.team.pair import Pair
from learn2assemble.team.traffic import APART, Leg, Route

HERE = (0.0, 0.0, 0.0)
"""In the place of the structure that is built, not beside it [m]."""


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
    def piecewise(self) -> bool:
        """Whether a motion may be told piece by piece, each beginning with the velocity with which
        the one before has ended."""
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
    """Blocks of the other arm that are taken to stand already, and what was known before."""

    blocks: tuple[int, ...]
    pose: np.ndarray
    """float64[k, 7]: where each was."""
    states: tuple[int, ...]
    beside: np.ndarray
    """float64[k, 3]: how far from its place each was to be [m]."""
    joints: frozenset[tuple[int, int]]
    """Joints of studs that are taken to be home."""


def assume(building: Building, blocks: Sequence[int], to: Offset | None = None) -> Assumed:
    """An arm takes what the other one moves to stand in its place.

    Args:
        blocks: one that comes from its magazine, or those that come together.
        to: how far from their places these come.
    """
    world, some = building.world, list(blocks)
    states = tuple(world.state[k] for k in some)
    pose, beside = world.pose[some].copy(), world.beside[some].copy()
    if to is not None:
        world.beside[some] = to
    for k in some:
        world.pose[k], world.state[k] = world.target(k), STANDING
    made_by = building.known.structure.made_by
    joints = set[tuple[int, int]]().union(*(made_by(k, world) for k in some)) - world.home
    world.home |= joints
    return Assumed(tuple(some), pose, states, beside, frozenset(joints))


def forget(building: Building, assumed: Assumed) -> None:
    """It does not any more."""
    world, some = building.world, list(assumed.blocks)
    world.pose[some], world.beside[some] = assumed.pose, assumed.beside
    for k, state in zip(some, assumed.states, strict=True):
        world.state[k] = state
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
        other.names.update(mine.world.names)  # The new block has the name that is new.
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
    run: Execution,
    block: str,
    along: Sequence[str] = (),
    widest: float = WIDEST,
    spots: tuple[Offset, Offset] = (HERE, HERE),
) -> Route:
    """What an attempt that is about to begin announces.

    Args:
        run: the attempt.
        block: name of what it moves, ...
        along: ... and of what it brings along.
        widest: half of what of a block is in one capsule at most [m]; the finer, the nearer it may
            come to the other arm.
        spots: how far from the place of the structure it is taken, and brought [m].
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
    return Route(block, held, tuple(legs), goal, there, tuple(along), _loads(order, spots))


def spots_of(building: Building, k: int, to: Offset | None) -> tuple[Offset, Offset]:
    """How far from the place of the structure a block is, and shall be [m].

    Args:
        to: where it shall be, of what is brought from where it was built beside.
    """
    x, y, z = building.world.beside[k].tolist()
    return (x, y, z), to or (x, y, z)


def comes_next(building: Building, moved: Set[int]) -> set[int]:
    """Which brick an arm as a rule fetches next, when some blocks are in their places; dry blocks
    are not looked for."""
    studs = building.known.structure.studs() is not None
    step = building.known.next_after(moved) if studs else None
    return set() if step is None else {step.block}


def _loads(order: Order, spots: tuple[Offset, Offset]) -> dict[str, Offset]:
    """See :attr:`Route.loads`."""
    own = set(order.scene.members(order.move.cell).tolist())
    joints = () if order.scene.studs is None else order.scene.studs.joints
    return {
        stage: spot
        for stage, spot, home in zip(("lift", "place"), spots, (True, False), strict=True)
        if any(bool(one.home) == home and one.leaves(own) for one in joints)
    }


# ---------------------------------------------------------------- what a file is told


class Turn(NamedTuple):
    """An attempt in the time line of a build by two arms."""

    arm: int
    done: Done
    begin: float
    """[s of the plant's clock]"""
    end: float
    """[s of the plant's clock]"""


def key_of_two(plan: Plan, crew: Pair, workcell: Workcell) -> str:
    """As :func:`~.carry_out.key_of`, of two arms: with who they are and where they stand."""
    arms = (one.job.arm for one in crew.found)
    told = [(one.name, one.tool_name, one.base_position.tolist(), one.base_yaw) for one in arms]
    return f"{key_of(plan, workcell)} {(crew.names, told)!r}"


class SharedJournal(NamedTuple):
    """The file of a build by two arms."""

    path: Path
    key: str
    """Of what is built."""

    def append(
        self, turn: Turn, begun: float, buildings: tuple[Building, ...], plant: Any, picks: Any
    ) -> None:
        """An attempt is over.

        Args:
            turn: the attempt.
            begun: when the build was [s of the plant's clock].
            buildings: of each arm.
            plant: the cell; a simulation is kept, too.
            picks: the piece that each arm is about to move.
        """
        state: dict[str, Any] = {
            "arm": turn.arm,
            "begin": turn.begin,
            "end": turn.end,
            "begun": begun,
            "picks": list(picks),
            "arms": [building.snapshot() for building in buildings],
        }
        recorder = buildings[turn.arm].recording.recorder
        if buildings[turn.arm].recorded and not turn.done.hand:
            state["record"] = packed(recorder.steps[-1])
        if hasattr(plant, "state"):
            state["plant"] = plant.state()
        append_state(self.path, state)

    def read(self, plant: Any, arms: Sequence[Arm]) -> list[dict[str, Any]]:
        """What the file says, oldest first; a simulation is as it was then, its arms at rest.

        Raises:
            InputError: for a file of another build, a damaged one, and one that cannot be written.
        """
        states = read_states(self.path, self.key)
        if states and "plant" in states[-1]:
            plant.restore(_at_rest(states, arms))
        return states


def _at_rest(states: list[dict[str, Any]], arms: Sequence[Arm]) -> dict[str, Any]:
    """The last state of a simulation, where arms that were in the middle of an attempt stand where
    their records end, as far as they are clear of each other there: a record does not jump.

    Args:
        states: that a file has, oldest first.
        arms: of the cell, two.
    """
    plant = states[-1]["plant"]
    if "others" not in plant:
        return plant  # Robots are where they are.
    now = [(plant["joints"], plant["width"]), *plant["others"]]
    ends = [np.array(joints) for joints, _ in now]
    for state in states:
        joints = last_joints(state.get("record"))
        ends[state["arm"]] = ends[state["arm"]] if joints is None else joints
    one, other = (sweep(a, capsules_of(a), q[None]) for a, q in zip(arms, ends, strict=True))
    if not clear(one, other, APART):
        return plant
    told = [[q.tolist(), width] for q, (_, width) in zip(ends, now, strict=True)]
    return {**plant, "joints": told[0][0], "others": told[1:]}


def take_up(states: list[dict[str, Any]], buildings: tuple[Building, ...]) -> list[Turn]:
    """Each arm knows what it knew; the attempts that are over, by when they ended.

    Args:
        states: of :meth:`SharedJournal.read`, some.
        buildings: of each arm, which have just begun.
    """
    last, turns = states[-1], list[Turn]()
    for who, building in enumerate(buildings):
        mine = [state for state in states if state["arm"] == who]
        done = [state["arms"][who]["done"] for state in mine]
        records = [state["record"] for state in mine if "record" in state]
        building.take_up(last["arms"][who], done, records)
        ends = zip(building.known.done, mine, strict=True)
        turns += [Turn(who, one, state["begin"], state["end"]) for one, state in ends]
    for building, pick in zip(buildings, last["picks"], strict=True):
        if pick is not None and building.world.state[pick] == STOCK:
            building.hand_back(pick)
    return sorted(turns, key=lambda turn: turn.end)
