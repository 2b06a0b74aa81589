"""Baselines of the tasks with hidden errors; all know what an observation says, and the sizes of
errors that the documents tell, no more.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.boxes import box_block
from learn2assemble.constants import GRAVITY
from learn2assemble.envs import hidden
from learn2assemble.envs.hidden import MOST, STEP, HiddenActions, HiddenEnv
from learn2assemble.errors import InputError
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.given import plan_assembly
from learn2assemble.statics.sideways import Sideways
from learn2assemble.statics.step_proof import Proof
from learn2assemble.tasks.hidden_errors import BIAS, FRICTION, LOOK, SPEED, TURN
from learn2assemble.tasks.hidden_world import (
    JOINT,
    TOLERANCE,
    GivenBlocks,
    HiddenWorld,
    corner_distance,
    exact_numbers,
    overlap,
)

PLANNING = 20.0
"""Seconds for an order."""
_FIRST, _EVERY = 2, 4
"""So many placements that have been seen tell how far the hand is off, roughly; until then each is
looked at, then every so many."""
_TRIES = 3
"""Times that a block does not go in before another one is tried."""
_REACH = 4
"""Steps of the correction, to all sides, among which one is chosen with which a block fits."""
_DENSITY = 800.0
_MILLI = 1e3


class BelievedBlocks(NamedTuple):
    """An observation in numbers; lengths [m], angles [rad]."""

    design: GivenBlocks
    stands: np.ndarray
    """bool[n]."""
    commanded: np.ndarray
    """float64[n, 3]: correction with which each was put down."""
    seen: np.ndarray
    """bool[n]."""
    measured: np.ndarray
    """float64[n, 3]: where each was seen, less its place."""
    extent: np.ndarray
    """float64[n, 2]: length and width as seen, else as told."""
    hand: np.ndarray
    """float64[3]: the correction."""
    moves: float
    """That are left."""
    factor: float
    """By which errors are scaled, from how exact a look is."""


def read_observation(observation: Mapping[str, Any]) -> BelievedBlocks:
    """What an observation of a task with hidden errors says."""
    rows = np.asarray(observation["blocks"], float)
    rows = rows[rows[:, hidden.THERE] > 0]
    moves, _, noise, *_ = np.asarray(observation["clock"], float).tolist()
    size = rows[:, hidden.SIZE]
    design = GivenBlocks("", rows[:, hidden.MIDDLE], size, _DENSITY, ())
    return BelievedBlocks(
        design,
        rows[:, hidden.STANDS] > 0,
        rows[:, hidden.COMMANDED] / _MILLI,
        rows[:, hidden.SEEN] > 0,
        rows[:, hidden.MEASURED] / _MILLI,
        size[:, :2] + rows[:, hidden.EXTENT] / _MILLI,
        np.asarray(observation["hand"], float) / _MILLI,
        moves,
        noise / (_MILLI * LOOK[0]),
    )


class OnHidden:
    """Chooses actions of a task with hidden errors.

    Raises:
        InputError: for another task.
    """

    knows = "observation"

    def begin(self, env: gymnasium.Env[Any, Any]) -> None:
        """A new problem, of which nothing is known yet."""
        if not isinstance(env, HiddenEnv):
            name = getattr(getattr(env, "task", None), "name", "?")
            raise InputError("task", name, "a task with hidden errors: hidden-designs-*")
        self.names: HiddenActions = env.actions
        self.order: list[int] = []
        self.failed: dict[int, int] = {}
        """How often blocks did not go in."""
        self.samples: dict[int, np.ndarray] = {}
        """By how much the placement of each block that was seen was off: float64[3]."""
        self.earlier: list[np.ndarray] = []
        """The same of placements that are no more."""
        self.last = -1


class RepairingPlanner(OnHidden):
    """The exact planner with repair: builds in its order, looks at what it has built, takes by how
    much the hand was off into account, and takes up and puts back what is not in its place.

    Args:
        looks: whether it looks; without looks it cannot know what to repair.
    """

    def __init__(self, looks: bool = True) -> None:
        self.looks: bool = looks

    def __call__(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> int:
        now = read_observation(observation)
        if not self.order:
            self.order: list[int] = plan_order(now.design)
        allowed = np.asarray(info["action_masks"]) > 0
        self._remember(now, info)
        bias = self._bias(now)
        if self.looks:
            if self._wants_look(now, info):
                return self._say(self.names.look)
            if (block := self._misplaced(now, allowed)) is not None:
                return self._say(self.names.take + block)
        waiting = [b for b in self.order if allowed[b]]
        if not waiting:
            return self._say(self.names.done)
        block = self.next_block(now, waiting)
        wanted = (fitting(now, block, bias) if self.looks else np.zeros(3)) - bias
        number = self._towards(now, wanted)
        return self._say(block if number is None else number)

    def next_block(self, now: BelievedBlocks, waiting: list[int]) -> int:
        """Which of the blocks that may be put down is: the first in the order, but one that did not
        go in several times waits for the others."""
        return min(waiting, key=lambda b: self.failed.get(b, 0) // _TRIES)

    def _say(self, number: int) -> int:
        self.last = number
        return number

    def _remember(self, now: BelievedBlocks, info: Mapping[str, Any]) -> None:
        """Count what did not go in, and how far off what was seen is."""
        if info["verdict"] == "collides":
            self.failed[self.last] = self.failed.get(self.last, 0) + 1
        for block in [b for b in self.samples if not now.seen[b]]:
            self.earlier.append(self.samples.pop(block))
        for block in np.flatnonzero(now.seen).tolist():
            if block not in self.samples:
                self.samples[block] = now.measured[block] - now.commanded[block]

    def _bias(self, now: BelievedBlocks) -> np.ndarray:
        """float64[3]: by how much the hand is off, most likely: with an eye to how far it can be,
        and how far single placements go astray."""
        found = [*self.samples.values(), *self.earlier]
        if not found:
            return np.zeros(3)
        slip = SPEED**2 / (FRICTION * GRAVITY)
        scatter = np.array([slip, slip, TURN]) ** 2 + LOOK[:3] ** 2
        return np.sum(found, 0) / (len(found) + scatter / BIAS**2)

    def _wants_look(self, now: BelievedBlocks, info: Mapping[str, Any]) -> bool:
        unseen = int((now.stands & ~now.seen).sum())
        if not unseen or now.moves < 1 or not now.factor:
            return False
        known = len(self.samples) + len(self.earlier)
        enough = 1 if known < _FIRST else _EVERY
        stuck = info["verdict"] == "collides"
        return bool(unseen >= enough or stuck or now.stands.all())

    def _misplaced(self, now: BelievedBlocks, allowed: np.ndarray) -> int | None:
        """What to take up next for a block that is not in its place, where there is time."""
        on = now.design.rests_on
        for block in np.flatnonzero(now.seen).tolist():
            if corner_distance(now.measured[block], now.design.size[block, :2]) <= TOLERANCE:
                continue
            above = {block}
            while more := {k for b in above for k in np.flatnonzero(on[:, b]).tolist()} - above:
                above |= more
            above = [k for k in above if now.stands[k]]
            missing = int((~now.stands).sum())
            if 2 * len(above) + missing + 2 > now.moves:
                continue
            free = [k for k in above if allowed[self.names.take + k]]
            if free:
                return free[0]
        return None

    def _towards(self, now: BelievedBlocks, wanted: np.ndarray) -> int | None:
        """A change of the correction towards one; None where it is as near as steps allow."""
        steps = np.round((np.clip(wanted * _MILLI, -MOST, MOST) - now.hand * _MILLI) / STEP)
        axis = int(np.argmax(np.abs(steps)))
        if not steps[axis]:
            return None
        return self.names.adjust + 2 * axis + int(steps[axis] > 0)


class PlannerWithoutLooks(RepairingPlanner):
    """The exact planner as if nothing could go wrong."""

    def __init__(self) -> None:
        super().__init__(looks=False)


class HiddenLookahead(OnHidden):
    """One step ahead, without looks: of what may be put down, what leaves a state that withstands
    the largest sideways acceleration, were all blocks where they were put."""

    def __call__(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> int:
        now = read_observation(observation)
        waiting = np.flatnonzero(np.asarray(info["action_masks"])[: len(now.design)]).tolist()
        if not waiting:
            return self.names.done
        world = HiddenWorld(now.design, exact_numbers(len(now.design)))
        for block in np.flatnonzero(now.stands).tolist():
            world.put(block, np.append(now.design.middle[block, :2], 0.0) + now.commanded[block])
        return max(waiting, key=lambda block: sturdiness(world, block))


def sturdiness(world: HiddenWorld, block: int) -> float:
    """Sideways acceleration [g] that a state withstands once a block is put to its place."""
    after = world.copy()
    after.put(block, np.append(world.design.middle[block, :2], 0.0))
    _, _, stack = after.stack()
    every, upright = np.ones(len(stack), bool), Proof(stack)
    if not upright.settle(every, every, mends=True):
        return -1.0
    sideways = Sideways(stack, world.numbers.friction)
    sideways.drop()
    sideways.search(every, upright.force, Clock(PLANNING))
    return sideways.radius


def plan_order(design: GivenBlocks) -> list[int]:
    """Blocks in the order of the exact planner; from below where it finds none."""
    low, high = design.middle - design.size / 2, design.middle + design.size / 2
    blocks = [
        box_block(str(k), low[k].tolist(), high[k].tolist(), density=design.density)
        for k in range(len(design))
    ]
    plan = plan_assembly(Assembly(tuple(blocks)), supports="none", seconds=PLANNING)
    steps = plan.assembly.steps if plan.assembly is not None else ()
    order = [int(step.place) for step in steps if step.place is not None]
    return order + [k for k in range(len(design)) if k not in order]


def fitting(now: BelievedBlocks, block: int, bias: np.ndarray) -> np.ndarray:
    """float64[3]: where to put a block, less its place, for it to keep farthest from those beside
    it, seen or not, and not to leave its place."""
    design = now.design
    place = np.append(design.middle[block, :2], 0.0)
    beside = list[tuple[np.ndarray, np.ndarray]]()
    for other in np.flatnonzero(design.beside[block]).tolist():
        off = np.zeros(3)
        if now.seen[other]:
            off = now.measured[other]
        elif now.stands[other]:
            off = now.commanded[other] + bias
        at = np.append(design.middle[other, :2], 0.0) + off
        if overlap(place, design.size[block, :2], at, now.extent[other]) > -3 * JOINT:
            beside.append((at, now.extent[other]))
    best, chosen = -np.inf, np.zeros(3)
    steps = np.arange(-_REACH, _REACH + 1) * STEP[0] / _MILLI if beside else np.zeros(1)
    for x in steps.tolist():
        for y in steps.tolist():
            off = np.array([x, y, 0.0])
            room = [-overlap(place + off, design.size[block, :2], *one) for one in beside]
            value = min([*room, JOINT, TOLERANCE - np.hypot(x, y)]) - 0.05 * np.hypot(x, y)
            if value > best:
                best, chosen = value, off
    return chosen
