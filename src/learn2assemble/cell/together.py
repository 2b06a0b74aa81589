"""Two arms build together: each looks, chooses and carries out as it does alone, and tells the
other one what it is about to place and what came of it.

The block an arm takes next is one whose support stands, whether or not the block that the other arm
moves is there yet, and on whose way the arms keep their distance (:mod:`.traffic`).
"""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from learn2assemble.cell.building import Building, Prepared
from learn2assemble.cell.carry_out import setup_of
from learn2assemble.cell.crew import Member
from learn2assemble.cell.pair import Pair, gather, lower_beside
from learn2assemble.cell.report import Attempted, Witness, Worked, carried_out, words_of
from learn2assemble.cell.state import Action, Done
from learn2assemble.cell.traffic import ArmInTraffic, Route, Traffic, route_of
from learn2assemble.cell.workcell import Progress, Workcell
from learn2assemble.cell.world import STANDING, STOCK, rows_of
from learn2assemble.motion.plant import Plant, PlantError, Readings, standing
from learn2assemble.motion.record import RATE, BuildRecord
from learn2assemble.motion.recorder import StepMotion
from learn2assemble.motion.setup import Setup, open_plant
from learn2assemble.planning.plan import Plan
from learn2assemble.progress import Detail
from learn2assemble.robot.moves import Outcome
from learn2assemble.simulation.execution import EMPTY, Execution, straight_motion
from learn2assemble.simulation.model import Failure, lean_table, rigid_objects
from learn2assemble.simulation.ways import WorldChecker, free_way

LOOK_AGAIN = 0.1
"""An arm that has nothing to do looks again after this time [s]."""
AT_HOME = 1e-3
"""An arm that is so near to its home is there [rad]."""
PATIENCE, SOON = 600, 20
"""So often, before it counts as stuck while the other arm is at work, and where that has ended."""


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

    def sense(self) -> Readings:
        """What is sensed now, with the first arm."""
        ...


Cell = TypeVar("Cell", bound=SharedCell)


def build_together(
    plan: Plan,
    members: Sequence[Member],
    workcell: Workcell,
    *,
    joint: float = 1e-4,
    progress: Progress = lambda text: None,
    opened: Callable[[Setup], Any] | None = None,
) -> Plan:
    """A complete plan of dry blocks, carried out by two arms in one simulated cell.

    Args:
        members: the arms, see :func:`~.team.set_up_team`.
        workcell: how they build.
        joint: width of a vertical joint [m].
        opened: see :class:`Together`; by default the simulated cell.

    Raises:
        InputError: as :func:`gather`.
    """
    started = time.perf_counter()
    both = Together(gather(plan, members, workcell, joint), opened or simulated)
    reason = both.run(progress)
    took = time.perf_counter() - started
    turns = sorted(both.turns, key=lambda turn: turn.end)
    tried = [Attempted(turn.arm, turn.done) for turn in turns]
    built = carried_out(plan, both.worked, reason, took, both.plant, tried)
    return replace(built, robot_s=round(both.seconds, 2))


def simulated(setup: Setup) -> Any:
    """The simulated cell that is described, with all its arms."""
    return open_plant("sim://", setup)


def _worker(
    found: Prepared, workcell: Workcell, name: str, plant: Plant, witness: Witness
) -> Worked:
    """An arm before it begins."""
    words = words_of(found.job, workcell)
    return Worked(Building(found, workcell, plant, words, witness=witness), workcell, witness, name)


def _nothing() -> None:
    """What is called where nobody has asked for more."""


@dataclass
class Turn:
    """An attempt in the time line of a build by two arms."""

    arm: int
    done: Done
    begin: float
    """[s]"""
    end: float
    """[s]"""


class Together(Generic[Cell]):
    """A build by two arms.

    Args:
        crew: of :func:`gather`.
        opened: opens the cell that is described, with the plants of both arms; of a simulation
            :class:`~learn2assemble.simulation.plant.DynamicPlant`.
    """

    def __init__(self, crew: Pair, opened: Callable[[Setup], Cell]) -> None:
        first, second = (one.job.arm for one in crew.found)
        job = crew.found[0].job
        own = replace(job, obstacles=tuple(one for one in job.obstacles if not one.arm))
        setup = setup_of(own, crew.workcells[0])._replace(others=(second,))
        self.plant, self.traffic = opened(setup), Traffic((first, second))
        self.arms = tuple(
            ArmInTraffic(self.plant.plants[who], self.traffic, who) for who in range(2)
        )
        self.worked = tuple(
            _worker(*one, Witness(self.plant)) for one in zip(*crew, self.arms, strict=True)
        )
        self.buildings = tuple(one.building for one in self.worked)
        for who, building in enumerate(self.buildings):
            building.attempts.announce = self._announcer(who)
        self.begun = 0.0
        """When [s of the plant's clock]."""
        self.turns: list[Turn] = []
        self.tried: tuple[dict[int, Route], dict[int, Route]] = ({}, {})
        """What each arm would have announced for blocks whose way the other one was in."""
        self.behind: tuple[set[int], set[int]] = (set(), set())
        """Blocks that each arm could not even fetch before those that the other one moves."""
        self.after: list[Route | None] = [None, None]
        """Of the other arm, where an arm fetches a block that comes after that."""
        self.assumes = [False, False]
        """Whether an arm takes the block of the other one to stand already, while it chooses."""
        self.under = lower_beside(job) if not crew.found[0].structure.leans else {}
        """By piece, those that come before it, see :func:`lower_beside`; as planned where blocks
        lean."""
        self.moves = [0, 0]
        """The piece that each arm moves, or was the last to."""
        self.picks: list[int | None] = [None, None]
        """The piece of the attempt that each arm begins, before it says so: where readings are not
        exact, it takes time to see what a magazine presents."""
        self.lost: set[int] = set()
        """Blocks that an arm moved when its plant ended that."""
        self.working = [True, True]
        self.reasons: list[str | None] = [None, None]

    @property
    def seconds(self) -> float:
        """Of the arms, from the beginning until the last block was placed [s]."""
        return max((turn.end for turn in self.turns), default=self.begun) - self.begun

    @property
    def records(self) -> tuple[BuildRecord, ...]:
        """What each arm did, on the clock of both."""
        return tuple(building.recording.record() for building in self.buildings)

    @property
    def complete(self) -> bool:
        """Whether everything stands."""
        known = [building.known for building in self.buildings]
        return all(one.satisfied(step) for one in known for step in one.order)

    def run(self, progress: Progress = lambda text: None) -> str | None:
        """Until everything is done; why not, in words, where it cannot be."""
        self.begun = self.plant.sense().time
        self.plant.clock.run([lambda who=who: self._work(who, progress) for who in range(2)])
        if self.complete:
            return None
        return next((why for why in self.reasons if why), "neither arm can go on")

    # ------------------------------------------------------------ one arm

    def _work(self, who: int, progress: Progress) -> None:
        """What one arm does, attempt by attempt."""
        route = None
        try:
            self.reasons[who] = self._attempts(who, progress)
        except PlantError as error:
            self.reasons[who], route = str(error), self.traffic.lanes[who].route
            self.traffic.stopped(who)
        finally:
            self.working[who] = False
        if route is not None:
            # Whatever became of it, nobody else is to place it.
            self.lost.add(self.moves[who])

    def _attempts(self, who: int, progress: Progress) -> str | None:
        building, known = self.buildings[who], self.buildings[who].known
        building._look()
        most, idle = 2 * len(known.order) + 20, 0
        while len(known.done) < most:
            known.elsewhere, known.later = self._elsewhere(who), self._later(who)
            action = known.choose()
            if action is None:
                return None
            if not isinstance(action, Action) and self._fetch(who, progress):
                idle = 0
                continue
            if isinstance(action, Action):
                if self._act(who, action, progress):
                    idle = 0
                    continue
                if action.block in known.postponed or action.block in known.refused:
                    continue
            # Perhaps what the other arm does changes that.
            why = action if isinstance(action, str) else "no attempt could begin"
            if idle > (PATIENCE if self.working[1 - who] else SOON):
                return why
            idle += 1
            if self.traffic.lanes[who].asked:
                self._go_home(who)
            self._wait(who)
            tried = self.tried[who]
            known.postponed = {k for k in tried if not self.traffic.fits(who, tried[k])}
        return f"given up after {most} attempts"

    def _act(self, who: int, action: Action, progress: Progress) -> bool:
        """One attempt; False where it did not begin."""
        building, world = self.buildings[who], self.buildings[who].world
        before, begin = list(world.state), building.plant.sense().time
        if self.assumes[who]:
            before[self.moves[1 - who]] = STOCK
        building.stood = self._stood(who, begin)
        self.picks[who] = action.block
        try:
            acted = building.act(action)
        finally:
            self.picks[who] = None
        self.traffic.over(who, acted and building.world.state[self.moves[who]] == STANDING)
        if not acted:
            return False
        last, end = building.known.done[-1], building.plant.sense().time
        self.turns.append(Turn(who, last, begin, end))
        self._changed(who)
        self._tell(who, {k for k, state in enumerate(before) if world.state[k] != state})
        left = sum(not building.known.satisfied(step) for step in building.known.order)
        text = f"{self.worked[who].name}: {last.what} {world.pieces[action.block].id}: "
        text += f"{last.outcome}{': ' + last.detail if last.detail else ''}, {left} steps left"
        progress(Detail(text) if last.outcome == Outcome.REACHED.label else text)
        return True

    def _fetch(self, who: int, progress: Progress) -> bool:
        """An attempt with a block that comes after the one that the other arm moves, which is taken
        to stand already while that is chosen; False where there is none."""
        building, known, first = self.buildings[who], self.buildings[who].known, self.moves[1 - who]
        route, world, tried = self.traffic.other(who).route, building.world, self.behind[who]
        if route is None or first in self.lost or world.state[first] != STOCK:
            return False
        if world.spread.any():
            # Where it is to stand is not exactly where it will.
            return False
        hidden, kept = world.pose[first].copy(), (known.postponed, known.refused)

        def restore() -> None:
            if not self.assumes[who]:
                return
            self.assumes[who] = False
            known.elsewhere, (known.postponed, known.refused) = self._elsewhere(who), kept
            world.pose[first], world.state[first] = hidden, STOCK

        building.chosen = restore
        try:
            while self.traffic.other(who).route is route:
                self.assumes[who] = True
                world.pose[first], world.state[first] = world.target(first), STANDING
                known.elsewhere, known.postponed = set(self.lost), set(tried)
                known.refused, known.later = {}, self._later(who)
                action, fails = known.choose(), known.fails.copy()
                if not isinstance(action, Action) or action.what != "place":
                    return False
                self.after[who] = route
                if self._act(who, action, progress):
                    return True
                # That it cannot be placed so says nothing of how it can be placed later.
                known.fails = fails
                tried.add(action.block)
            return False
        finally:
            restore()
            building.chosen, self.after[who] = _nothing, None

    def _stood(self, who: int, now: float) -> float:
        """So long an arm has stood [s]: its record is on the clock of both, and tells what it did
        before.

        Args:
            now: time of the plant [s].
        """
        building = self.buildings[who]
        told = building.recording.recorder.now if building.recording.recorder.steps else 0.0
        gone = 0.0 if building.gone is None else len(building.gone.joints) / RATE
        return max(now - self.begun - told - gone, 0.0)

    def _go_home(self, who: int) -> None:
        """Out of the way of the other arm, where there is a free way."""
        building, lane = self.buildings[who], self.traffic.lanes[who]
        lane.asked, arm = False, building.job.arm
        self._changed(who)
        waits = next((s.block for s in building.known.order if not building.known.satisfied(s)), 0)
        attempts, scene = (
            building.attempts,
            rows_of(building.world, building.world.pose, waits).scene,
        )
        if attempts.planner is None or np.abs(building.joints - arm.home).max() < AT_HOME:
            return
        objects, poses, names = rigid_objects(scene)
        world = attempts.planner.world(objects)
        lean_table(world.plan, scene.table)
        checker = WorldChecker(arm, world, poses, names)
        try:
            for leg in itertools.pairwise(free_way(checker, building.joints, arm.home, "home")):
                told = straight_motion(np.array(leg), attempts.planner.limits, "home")
                stood = self._stood(who, building.plant.sense().time)
                report = building.plant.execute(told, (), (EMPTY,))
                if report.played is not None:
                    moved = StepMotion(*report.played[1:]).after(stood, building.joints)
                    building.gone = moved if building.gone is None else building.gone.then(moved)
                building.joints = report.joints
        except Failure:
            return  # It stands where it is, and the other one finds another block.

    def _wait(self, who: int) -> None:
        """Stand for a while."""
        building = self.buildings[who]
        building.plant.execute(standing("home", building.joints, LOOK_AGAIN))

    def _elsewhere(self, who: int) -> set[int]:
        """The block that the other arm moves or has chosen, and what an arm that was stopped has
        left."""
        found, chosen = set(self.lost), self.picks[1 - who]
        if self.traffic.other(who).route is not None:
            found.add(self.moves[1 - who])
        return found if chosen is None else found | {chosen}

    def _later(self, who: int) -> set[int]:
        """Blocks beside which lower ones are still to come."""
        known = self.buildings[who].known
        left = {step.block for step in known.order if not known.satisfied(step)}
        return {k for k, lower in self.under.items() if lower & left}

    def _announcer(self, who: int) -> Callable[[Execution, str], bool]:
        """What an arm says before it moves, see :attr:`~.attempt.Attempts.announce`."""

        def announce(run: Execution, block: str) -> bool:
            building, route = self.buildings[who], route_of(run, block)
            k = building.world.names.index(block)
            after = self.after[who]
            behind = after is not None and self.traffic.other(who).route is after
            if self.traffic.announce(who, route, behind):
                self.moves[who] = k
                return True
            if after is not None:
                return False
            building.known.postponed.add(k)
            self.tried[who][k] = route
            other = self.traffic.other(who)
            if other.route is None:
                other.asked = True
            return False

        return announce

    def _tell(self, who: int, changed: set[int]) -> None:
        """Tell the other arm what came of an attempt."""
        mine, other = self.buildings[who], self.buildings[1 - who]
        if self.assumes[1 - who]:
            other.chosen()
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
        other.known.refused.clear()
        self._changed(1 - who)
        other.recording.sync()

    def _changed(self, who: int) -> None:
        """What an arm has tried before it may try again, as things are otherwise now."""
        self.tried[who].clear()
        self.behind[who].clear()
        self.buildings[who].known.postponed.clear()
