"""Two arms build together: each looks, chooses and carries out as it does alone, and tells the
other one what it is about to place and what came of it.

The block an arm takes next is one whose support stands, whether or not the block that the other arm
moves is there yet, and on whose way the arms keep their distance (:mod:`.traffic`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Generic, TypeVar

import numpy as np

from learn2assemble.acting.building import PAUSED, Building, Prepared
from learn2assemble.acting.carry_out import setup_of
from learn2assemble.acting.report import Attempted, Witness, Worked, carried_out, words_of
from learn2assemble.acting.state import Action
from learn2assemble.cell.arrange import put_beside, steps_before
from learn2assemble.cell.workcell import Offset, Progress, Workcell
from learn2assemble.cell.world import STANDING, STOCK, rows_of
from learn2assemble.handling.execution import EMPTY, Execution
from learn2assemble.motion.record import RATE, BuildRecord
from learn2assemble.motion.recorder import StepMotion
from learn2assemble.planning.plan import Plan
from learn2assemble.plants.plant import Plant, PlantError, standing
from learn2assemble.plants.setup import Setup
from learn2assemble.progress import Detail
from learn2assemble.robot.moves import Failure
from learn2assemble.team.pair import Pair
from learn2assemble.team.telling import (
    Assumed,
    SharedCell,
    SharedJournal,
    Turn,
    assume,
    comes_next,
    forget,
    route_of,
    spots_of,
    take_up,
    tell,
)
from learn2assemble.team.traffic import BEHIND, ArmInTraffic, Route, Traffic

LOOK_AGAIN = 0.1
"""An arm that has nothing to do looks again after this time [s]."""
AT_HOME = 1e-3
"""An arm that is so near to its home is there [rad]."""
PATIENCE, SOON = 600, 20
"""So often, before it counts as stuck while the other arm is at work, and where that has ended."""
Cell = TypeVar("Cell", bound=SharedCell)


def built_by(
    both: Together[Any], plan: Plan, progress: Progress, started: float
) -> tuple[Plan, str | None]:
    """What comes of a plan that two arms carry out, and why that is not all of it.

    Args:
        started: when they were asked to, on the clock of the machine [s].
    """
    reason = both.run(progress)
    took = time.perf_counter() - started
    tried = [Attempted(one.arm, one.done) for one in sorted(both.turns, key=lambda one: one.end)]
    built = carried_out(plan, both.worked, reason, took, both.plant, tried)
    return replace(built, robot_s=round(both.seconds, 2)), reason


def _other(before: Sequence[int], now: Sequence[int]) -> set[int]:
    """Pieces that are in another state now, or new."""
    return {k for k, state in enumerate(now) if list(before[k : k + 1]) != [state]}


def _nothing() -> None:
    """What is called where nobody has asked for more."""


class Together(Generic[Cell]):
    """A build by two arms.

    Args:
        crew: of :func:`gather`.
        opened: opens the cell that is described, with the plants of both arms; of a simulation
            :class:`~learn2assemble.simulation.plant.DynamicPlant`.
        journal: what is kept of it; where there is something, the build goes on from that.
        through: by number and plant of an arm, what that is driven through; by default what keeps
            the rules of the layout.

    Raises:
        InputError: for a journal of another build, or one that cannot be used.
    """

    traffic: Traffic
    journal: SharedJournal | None

    building_of: type[Building] = Building

    def __init__(
        self,
        crew: Pair,
        opened: Callable[[Setup], Cell],
        journal: SharedJournal | None = None,
        through: Callable[[int, Plant], Plant] | None = None,
    ) -> None:
        first, second = (one.job.arm for one in crew.found)
        job = crew.found[0].job
        own = replace(job, obstacles=tuple(one for one in job.obstacles if not one.aside))
        structure = crew.found[0].structure
        setup = setup_of(own, crew.workcells[0], structure)._replace(others=(second,))
        self.plant, self.traffic = opened(setup), Traffic((first, second))
        self.journal, kept = journal, list[dict[str, Any]]()
        if journal is not None:
            kept = journal.read(self.plant, (first, second))
        # What is slowed down for a rule of the layout is told whole.
        piecewise = through is None and crew.workcells[0].site.safety.speed is None
        piecewise = piecewise and self.plant.piecewise
        through = through or crew.guarded
        mine, other = (through(*one) for one in enumerate(self.plant.plants))
        self.arms: tuple[ArmInTraffic, ArmInTraffic] = (
            ArmInTraffic(mine, self.traffic, 0, other, piecewise),
            ArmInTraffic(other, self.traffic, 1, mine, piecewise),
        )
        self.worked: tuple[Worked, ...] = tuple(
            self._worker(*one, Witness(self.plant)) for one in zip(*crew, self.arms, strict=True)
        )
        self.buildings: tuple[Building, ...] = tuple(one.building for one in self.worked)
        for who, building in enumerate(self.buildings):
            building.attempts.announce = self._announcer(who)
            if building.known.structure.studs() is not None:
                # Dry blocks are not pressed home for so long that a halt pays.
                building.attempts.coordinator = self.arms[who]
            put_beside(building.world, job.steps)
            found = crew.found[who]
            building.known.waits = steps_before(found.job, structure, found.order.steps)
        self.begun: float = 0.0
        """When [s of the plant's clock]."""
        self.turns: list[Turn] = []
        self.tried: tuple[dict[int, Route], dict[int, Route]] = ({}, {})
        """What each arm would have announced for blocks whose way the other one was in."""
        self.behind: tuple[set[int], set[int]] = (set(), set())
        """Blocks that each arm could not even fetch before those that the other one moves."""
        self.after: list[Route | None] = [None, None]
        """Of the other arm, where an arm fetches a block that comes after that."""
        self.assumes: list[Assumed | None] = [None, None]
        """While an arm takes the block of the other one to stand already, which."""
        self.moves: list[int] = [0, 0]
        """The piece that each arm moves, or was the last to, ..."""
        self.along: list[tuple[int, ...]] = [(), ()]
        """... and what that brings along."""
        self.to: list[Offset | None] = [None, None]
        """How far from their places these are to come; None: a block that comes alone."""
        self.picks: list[int | None] = [None, None]
        """The piece of the attempt that each arm begins, before it says so: where readings are not
        exact, it takes time to see what a magazine presents."""
        self.lost: set[int] = set()
        """Blocks that an arm moved when its plant ended that."""
        self.working: list[bool] = [True, True]
        self.reasons: list[str | None] = [None, None]
        self.stops: list[PlantError] = []
        """Why plants have ended what an arm did."""
        self.go_on: Callable[[int, Action], bool] = lambda who, action: True
        """Asked before an attempt of an arm; where it says no, the build pauses."""
        self.paused: bool = False
        self._allowed: tuple[set[tuple[int, str]], ...] = (set(), set())
        """What each arm may begin next: block, and what is done with it."""
        self._resumed = bool(kept)
        if kept:
            self._take_up(kept)

    def _worker(
        self, found: Prepared, workcell: Workcell, name: str, plant: Plant, witness: Witness
    ) -> Worked:
        """An arm before it begins."""
        words = words_of(found.job, workcell)
        building = self.building_of(found, workcell, plant, words, witness=witness)
        return Worked(building, workcell, witness, name)

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
        if not self._resumed:
            self.begun = self.plant.sense().time
        self.plant.clock.run([lambda who=who: self._work(who, progress) for who in range(2)])
        if self.complete:
            return None
        # Where an arm was stopped, that is why the other one could not go on.
        if self.stops:
            return str(self.stops[0])
        return next((why for why in self.reasons if why), "neither arm can go on")

    # ------------------------------------------------------------ one arm

    def _work(self, who: int, progress: Progress) -> None:
        """What one arm does, attempt by attempt."""
        try:
            self.reasons[who] = self._attempts(who, progress)
        except BaseException as error:
            # Whatever ended it, the other arm does not wait for it, nor place what it moved.
            if self.traffic.lanes[who].route is not None:
                self.lost |= {self.moves[who], *self.along[who]}
            self.traffic.stopped(who)
            if not isinstance(error, PlantError):
                raise
            self.stops.append(PlantError(error.stop, f"{self.worked[who].name}: {error.why}"))
            self.reasons[who] = str(self.stops[-1])
        finally:
            self.working[who] = False
            self.buildings[1 - who].sight.carried = set()

    def _attempts(self, who: int, progress: Progress) -> str | None:
        building, known = self.buildings[who], self.buildings[who].known
        building.look()
        most, idle = 2 * len(known.order) + 20, 0
        while len(known.done) < most:
            known.elsewhere = self._elsewhere(who)
            action = known.choose()
            if action is None:
                return None
            if self.paused:
                return PAUSED
            if not isinstance(action, Action) and self._fetch(who, progress):
                idle = 0
                continue
            if isinstance(action, Action):
                # What has to be put right first is chosen though the other arm is in its way.
                again = action.block in known.postponed
                if self._act(who, action, progress):
                    idle = 0
                    continue
                if not again and action.block in known.postponed | set(known.refused):
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
        if not self._may(who, action):
            return False
        building, world = self.buildings[who], self.buildings[who].world
        before, begin = list(world.state), building.plant.sense().time
        assumed = self.assumes[who]
        if assumed is not None:
            for k, state in zip(assumed.blocks, assumed.states, strict=True):
                before[k] = state
        elif self._expects(who):
            # Whatever comes of it, its ways are to be free.
            self._assume(who)
            building.chosen = lambda: self._forget(who)
        moves = self.traffic.other(who).route is not None and self.working[1 - who]
        building.sight.carried = {self.moves[1 - who], *self.along[1 - who]} if moves else set()
        taken = {action.block, *action.group, self.moves[1 - who], *self.along[1 - who]}
        building.between = comes_next(self.buildings[1 - who], taken) if moves else set()
        building.stood = self._stood(who, begin)
        self.picks[who], self.along[who] = action.block, action.group
        self.to[who] = action.to if action.group else None
        count = len(building.known.done)
        try:
            acted = building.act(action)
        except PlantError:
            self.picks[who] = None
            self._forget(who)
            if len(building.known.done) > count:
                # It was ended, and what came of it is known as far as that can be.
                self._over(who, before, begin, self.arms[1 - who].sense().time)
            raise
        self.picks[who] = None
        if self.after[who] is None:
            self._forget(who)
            building.chosen = _nothing
        self.traffic.over(who, acted and building.world.state[self.moves[who]] == STANDING)
        if not acted:
            # A block that lay somewhere may have been replaced.
            if changed := _other(before, world.state):
                self._tell(who, changed)
            return False
        self._over(who, before, begin, building.plant.sense().time)
        last = building.known.done[-1]
        left = sum(not building.known.satisfied(step) for step in building.known.order)
        text = f"{self.worked[who].name}: {last.what} {world.pieces[action.block].id}: "
        text += f"{last.outcome}{': ' + last.detail if last.detail else ''}, "
        text += f"{left} step{'s' * (left != 1)} left{building.pace.about(left)}"
        progress(Detail(text))
        return True

    def _may(self, who: int, action: Action) -> bool:
        """Whether an arm may begin something; it is asked once until it has done something."""
        key = action.block, action.what
        if key not in self._allowed[who] and not self.paused:
            self.paused = not self.go_on(who, action)
            self._allowed[who].add(key)
        return not self.paused

    def steps_begun(self, who: int) -> int:
        """How many steps are done, or under way by the other arm than this one."""
        known = [building.known for building in self.buildings]
        done = {step for one in known for step in one.planned if one.satisfied(step)}
        moves = self.traffic.other(who).route is not None or self.picks[1 - who] is not None
        return len(done) + moves

    def _over(self, who: int, before: list[int], begin: float, end: float) -> None:
        """An attempt is over.

        Args:
            before: states of all pieces before it.
            begin: when it began [s], ...
            end: ... and ended.
        """
        building = self.buildings[who]
        turn = Turn(who, building.known.done[-1], begin, end)
        self.turns.append(turn)
        self._allowed[who].clear()
        self._changed(who)
        brought = {self.moves[who], *self.along[who]} if self.along[who] else set[int]()
        self._tell(who, _other(before, building.world.state) | brought)
        if self.journal is not None:
            self.journal.append(turn, self.begun, self.buildings, self.plant, self.picks)

    def _take_up(self, kept: list[dict[str, Any]]) -> None:
        """Go on from what is kept of the build."""
        self.turns, self.begun = take_up(kept, self.buildings), kept[-1]["begun"]
        for who, building in enumerate(self.buildings):
            self.traffic.stands(who, building.joints, False)
            building.look()
            taken = building.presented()
            for k in taken:
                building.hand_back(k)
            self._tell(who, set(taken))

    def _fetch(self, who: int, progress: Progress) -> bool:
        """An attempt with a block that comes after the one that the other arm moves, which is taken
        to stand already while that is chosen; False where there is none."""
        building, known = self.buildings[who], self.buildings[who].known
        other, tried = self.traffic.other(who), self.behind[who]
        route = other.route
        if other.in_vain or not other.on_route:
            # It is about to put its block back: what is fetched behind that is put back, too, and
            # so on.
            return False
        if not self._expects(who) or building.world.spread.any():
            # Nothing comes, or where it is to stand is not exactly where it will.
            return False
        kept = known.postponed, known.refused

        def restore() -> None:
            if self.assumes[who] is not None:
                self._forget(who)
                known.elsewhere, (known.postponed, known.refused) = self._elsewhere(who), kept

        building.chosen = restore
        try:
            while self.traffic.other(who).route is route:
                self._assume(who)
                known.elsewhere, known.postponed = set(self.lost), set(tried)
                known.refused = {}
                action, fails = known.choose(), known.fails.copy()
                if not isinstance(action, Action) or action.what not in ("place", "attach"):
                    return False
                if self.moves[1 - who] in (action.block, *action.group):
                    # It is lifted off its table when what it brings along is there.
                    tried.add(action.block)
                    continue
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

    def _expects(self, who: int) -> bool:
        """Whether the other arm is about to place a block that comes from its magazine, or several
        that it has lifted off where they were built."""
        first, other = self.moves[1 - who], self.traffic.other(who)
        if other.route is None or first in self.lost:
            return False
        if self.along[1 - who]:
            return other.on_route and other.holding and other.stage in BEHIND
        return self.buildings[who].world.state[first] == STOCK

    def _assume(self, who: int) -> None:
        """An arm takes what the other one moves to stand already."""
        if self.assumes[who] is None:
            blocks = self.moves[1 - who], *self.along[1 - who]
            self.assumes[who] = assume(self.buildings[who], blocks, self.to[1 - who])

    def _forget(self, who: int) -> None:
        """It does not any more."""
        assumed, self.assumes[who] = self.assumes[who], None
        if assumed is not None:
            forget(self.buildings[who], assumed)

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
        scene = rows_of(building.world, building.world.pose, waits).scene
        if np.abs(building.joints - arm.home).max() < AT_HOME:
            return
        try:
            for told in building.attempts.way_home(scene, building.joints):
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
        """The blocks that the other arm moves or has chosen, and what an arm that was stopped has
        left."""
        found, chosen = set(self.lost), self.picks[1 - who]
        if self.traffic.other(who).route is not None:
            found |= {self.moves[1 - who], *self.along[1 - who]}
        return found if chosen is None else found | {chosen}

    def _announcer(self, who: int) -> Callable[[Execution, str], bool]:
        """What an arm says before it moves, see :attr:`~.attempt.Attempts.announce`."""

        def announce(run: Execution, block: str) -> bool:
            building = self.buildings[who]
            along = [building.world.names[n] for n in self.along[who]]
            k = building.world.names.index(block)
            route = route_of(run, block, along, spots=spots_of(building, k, self.to[who]))
            after = self.after[who]
            behind = after is not None and self.traffic.other(who).route is after
            if self.traffic.announce(who, route, behind):
                self.moves[who] = k
                self.buildings[1 - who].sight.carried |= {k, *self.along[who]}
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
        if self.assumes[1 - who] is not None:
            other.chosen()
        tell(mine, other, changed)
        self._changed(1 - who)

    def _changed(self, who: int) -> None:
        """What an arm has tried before it may try again, as things are otherwise now."""
        self.tried[who].clear()
        self.behind[who].clear()
        self.buildings[who].known.postponed.clear()
