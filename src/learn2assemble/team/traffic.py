"""Two arms that share a site: who may move now, so that they keep their distance and neither waits
for the other for ever.

An attempt is announced as *legs*, each with the space it sweeps. While an arm is on a leg, all of
what is left of that is its own: nothing depends on when something will happen, and an arm that is
stopped leaves the other one safe. What it is seen to have passed is free again, as no arm goes back
on a leg without asking. An arm may begin a leg if that is clear of what the other arm is on, and if
both can come to the end of what they announced afterwards, one leg at a time. That is so before
every leg, so one of the two can always go on.

An arm whose block comes after the one that the other arm moves may fetch it meanwhile: it announces
a route *behind* that of the other arm, and waits until that has let go of its block where it was to
place it, or is over; before it crosses, or as far across as it is in nobody's way.

Where bricks clutch, no arm presses on what stands, or draws at it, while the other one does the
same to it; what is built beside is another structure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from learn2assemble.cell.workcell import Offset
from learn2assemble.handling.execution import PAUSE, Coordinator
from learn2assemble.kinematics.capsules import Capsules, capsules_of
from learn2assemble.kinematics.sweeps import Sweep, clear, sweep
from learn2assemble.plants.plant import (
    Commands,
    Guard,
    Guards,
    Motion,
    Plant,
    Played,
    Readings,
    Report,
    Stop,
    WrappedPlant,
    standing,
)
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.moves import Failure, Outcome

APART, PLANNED = 0.015, 0.02
"""So far the arms keep from each other as they are told to move, which they stray from by 2.4 mm
each at most, and as their ways are planned [m]."""
STANDS = 5e-4
"""An arm whose joints are told to move by no more stands [rad]: no point of it moves by half of
what it may stray."""
EVERY = 5
"""Of the samples of a motion so many are taken together: the arm is within half a millimetre of the
straight line between two that are left."""
IN_THE_WAY = "the other arm is in the way"
NOT_PLACED = "the block that comes before it was not placed"
BEHIND = ("cross", "place")
"""Stages that begin only when the block that they are behind is placed, but for a part of the way
across."""
HALTS = 0.9, 0.8, 0.7, 0.6, 0.5, 0.4
"""Shares of a straight part of the way across after which an arm may wait for the other one."""
FLOWING = (*HALTS, 0.3, 0.2, 0.1)
"""The same of an arm that goes on where it may, without a stop."""
SHORT = 0.15
"""No joint turns by more on a part that has no halt [rad]."""
PLACED = 0.005
"""An arm lets go of its block in its place where it is so near to where it was to have it there
[m]."""


class Leg(NamedTuple):
    """A part of what was announced."""

    stage: str
    swept: Sweep


class Route(NamedTuple):
    """What an arm announces."""

    block: str
    """Name of the block that it moves."""
    held: Capsules
    """Of it, in the hand."""
    legs: tuple[Leg, ...]
    goal: Sweep
    """The block in its place."""
    there: Sweep | None = None
    """The arm with the block in its place."""
    along: tuple[str, ...] = ()
    """Names of the blocks that it brings along."""
    loads: Mapping[str, Offset] = MappingProxyType({})
    """Stages in which it presses a brick home on what stands, or draws one off; and how far from
    the place of the structure that is built [m]."""

    @property
    def waits(self) -> int:
        """Number of the first leg that begins only when what it is behind is over."""
        legs = enumerate(self.legs)
        return next((n for n, leg in legs if leg.stage in BEHIND), len(self.legs))


@dataclass
class Lane:
    """What is known of one arm."""

    arm: Arm
    here: Sweep
    """Where it stands, or what is left of the leg it is on."""
    halted: bool = False
    """Whether it was stopped, somewhere on the leg it was on."""
    moving: bool = False
    """Whether it is on a leg."""
    route: Route | None = None
    ahead: tuple[Leg, ...] = ()
    """What is left of its route."""
    stage: str = ""
    """Of the leg it is on, or was."""
    on_route: bool = True
    """Whether it does as it has announced; after a failure it does not."""
    holding: bool = False
    asked: bool = False
    """Whether the other arm could not set out because this one stands there with nothing to do."""
    refused: int = -1
    """Count of changes at which it was told to wait."""
    behind: Route | None = None
    """Of the other arm: before its block is placed this one does not cross."""
    after: Route | None = None
    """Of the other arm: its own block comes after that one, whether that is placed or not."""
    placed: bool = False
    """Whether it has let go of its block in its place."""
    loading: Offset | None = None
    """Where it presses on what stands, or draws at that, as :attr:`Route.loads`; None: it does not.
    The other arm does not load the same meanwhile, as states are proven under one of these loads
    alone."""
    left: tuple[str, ...] = ()
    """Names of the blocks that it moved when it was stopped."""
    in_vain: bool = False
    """Whether that is over and its block is not in its place."""
    halt: tuple[np.ndarray, np.ndarray] | None = None
    """Joints at which it waits on a part of the way across, and those at the end of that [rad]."""
    tries: tuple[Motion, bool, Sweep] | None = None
    """The motion that it was told to wait with, whether it holds something, and what it sweeps."""
    capsules: Capsules = field(init=False)

    def __post_init__(self) -> None:
        self.capsules = capsules_of(self.arm)

    @property
    def stays(self) -> Sweep:
        """Where it will be when it is done with the leg it is on: at its end, or, where it was
        stopped, anywhere on what was left of it."""
        return self.here if self.halted else self.here.end

    def swept(self, joints: np.ndarray) -> Sweep:
        """The space it takes up on straight connections of joints float64[k, n] [rad], with what it
        holds."""
        held = self.route.held if self.holding and self.route is not None else None
        capsules = self.capsules if held is None else self.capsules.add(held)
        return sweep(self.arm, capsules, joints)


class Traffic:
    """Which of two arms may move.

    Args:
        arms: both, at home.
    """

    def __init__(self, arms: tuple[Arm, Arm]) -> None:
        self.lanes: tuple[Lane, ...] = tuple(
            Lane(arm, sweep(arm, capsules_of(arm), arm.home[None])) for arm in arms
        )
        self.changes: int = 0
        """How often something changed for either."""
        self._known: dict[tuple[int, int, float], tuple[bool, Sweep, Sweep]] = {}

    def other(self, who: int) -> Lane:
        """The other arm."""
        return self.lanes[1 - who]

    # ------------------------------------------------------------ announcing

    def fits(self, who: int, route: Route, behind: bool = False) -> bool:
        """Whether an arm that stands may set out on a route.

        Args:
            behind: it waits before it crosses until what the other arm has announced is over, whose
                block then stands where it is to stand.
        """
        lane, other = self.lanes[who], self.other(who)
        if other.halted and other.loading in route.loads.values():
            return False
        if behind and other.route is not None:
            own = route.waits
            if not all(
                self._clear(leg.swept, other.route.goal, PLANNED) for leg in route.legs[:own]
            ):
                return False
            return self._complete(lane.here.end, route.legs, other.stays, other.ahead, own)
        if other.route is not None:
            legs = (other.here, *(leg.swept for leg in other.ahead))
            if not all(self._clear(one, route.goal, PLANNED) for one in legs):
                return False
            if not all(self._clear(leg.swept, other.route.goal, PLANNED) for leg in route.legs):
                return False
        return self._complete(lane.here.end, route.legs, other.stays, other.ahead)

    def announce(self, who: int, route: Route, behind: bool = False) -> bool:
        """As :meth:`fits`; if so, the route is known from now on."""
        if not self.fits(who, route, behind):
            return False
        lane = self.lanes[who]
        lane.route, lane.ahead, lane.on_route, lane.stage = route, route.legs, True, ""
        other, lane.halt = self.other(who), None
        lane.after, lane.in_vain = other.route if behind else None, False
        lane.behind = None if other.placed else lane.after
        self.changes += 1
        return True

    def begins(self, who: int, route: Route) -> None:
        """An arm sets out on a route while the other one stands, whatever that means for later."""
        lane = self.lanes[who]
        lane.route, lane.ahead, lane.on_route, lane.stage = route, route.legs, True, ""
        self.changes += 1

    def holds(self, who: int, joints: np.ndarray) -> None:
        """An arm stands at joints float64[n] [rad] and holds its block in its place, where that
        belongs to the structure."""
        self.over(who)
        self.stands(who, joints, False)

    def lets_go(self, who: int) -> None:
        """An arm has let go of what it held; where that is its block in its place, whoever waits
        for it may go on."""
        lane, other = self.lanes[who], self.other(who)
        there, here = None if lane.route is None else lane.route.there, lane.here.end
        if there is not None and there.lines.shape == here.lines.shape:
            off = np.linalg.norm(there.lines - here.lines, axis=3).max()
            lane.placed = lane.placed or bool(off < PLACED)
        if lane.placed and other.behind is lane.route:
            other.behind = None
            self.changes += 1
        if lane.loading is not None:
            lane.loading = None
            self.changes += 1

    def over(self, who: int, placed: bool = True) -> None:
        """What an arm announced is over.

        Args:
            placed: whether its block is where it was to be.
        """
        lane = self.lanes[who]
        self._over(who, placed)
        lane.route, lane.ahead, lane.on_route, lane.holding = None, (), True, False
        lane.loading = None
        self.changes += 1

    def leaves_route(self, who: int) -> None:
        """An arm gives up what it announced: what would have come of it is in nobody's way, nor
        does it have to be possible any more."""
        lane = self.lanes[who]
        lane.ahead, lane.on_route = (), False
        self.changes += 1

    def stopped(self, who: int) -> None:
        """An arm does not move any more; it is somewhere on the leg it was on, with what it
        holds."""
        lane = self.lanes[who]
        self._over(who, placed=False)
        if lane.route is not None:
            lane.left = lane.route.block, *lane.route.along
        lane.route, lane.ahead, lane.on_route, lane.moving = None, (), False, False
        lane.halted = True
        self.changes += 1

    def _over(self, who: int, placed: bool) -> None:
        """Whoever waits for it may go on."""
        lane, other = self.lanes[who], self.other(who)
        lane.behind, lane.after, lane.in_vain, lane.placed = None, None, False, False
        if lane.route is not None and other.behind is lane.route:
            other.behind, other.in_vain = None, not placed

    # ------------------------------------------------------------ moving

    def enter(self, who: int, motion: Motion) -> bool:
        """Whether a motion may begin; if so, what it sweeps belongs to the arm until it
        :meth:`stands`."""
        lane, other = self.lanes[who], self.other(who)
        if lane.refused == self.changes:
            return False
        loads = None if lane.route is None else lane.route.loads.get(motion.stage)
        halt = lane.halt
        if halt is not None and np.abs(motion.joints[-1] - halt[0]).max() > STANDS:
            halt = None
        waits = halt is None and lane.behind and motion.stage in BEHIND
        if (loads is not None and loads == other.loading) or waits:
            lane.refused = self.changes
            return False
        swept = self._of(lane, motion)
        ahead, on_route = lane.ahead, lane.on_route
        stages = [leg.stage for leg in ahead]
        if motion.stage in stages:
            k = stages.index(motion.stage)
            ahead = ahead[k + 1 :] if halt is None else (self._rest(lane, *halt), *ahead[k + 1 :])
        elif motion.stage != lane.stage:
            ahead, on_route = (), False
        if not self._may(who, swept, ahead, on_route):
            lane.refused = self.changes
            return False
        lane.here, lane.ahead, lane.on_route, lane.stage = swept, ahead, on_route, motion.stage
        lane.moving, lane.tries, lane.loading = True, None, loads
        self.changes += 1
        return True

    def rerouted(self, who: int, stage: str, way: np.ndarray) -> None:
        """A stage that an arm has announced goes by other corners float64[k, n] [rad]."""
        lane = self.lanes[who]
        stages = [leg.stage for leg in lane.ahead]
        if not lane.on_route or stage not in stages:
            return
        k, count = stages.index(stage), stages.count(stage)
        legs = (Leg(stage, lane.swept(np.array(part))) for part in pairwise(way))
        lane.ahead = *lane.ahead[:k], *legs, *lane.ahead[k + count :]
        self.changes += 1

    def halt(
        self, who: int, start: np.ndarray, end: np.ndarray, shares: Sequence[float] = HALTS
    ) -> float:
        """How far an arm with something in its hand may go now on a straight part of the way
        across, from joints float64[n] to others [rad], and wait there: one of the shares, 1 where
        it need not wait, 0 where it may not go so far."""
        lane = self.lanes[who]
        stages = [leg.stage for leg in lane.ahead]
        if not lane.on_route or BEHIND[0] not in stages:
            return 1.0
        after = lane.ahead[stages.index(BEHIND[0]) + 1 :]
        whole = lane.swept(np.stack([start, end]))
        if lane.behind is None and self._may(who, whole, after, True):
            return 1.0
        for share in shares:
            there = start + share * (end - start)
            legs = self._rest(lane, there, end), *after
            if self._may(who, lane.swept(np.stack([start, there])), legs, True):
                return share
        return 0.0

    def goes_on(self, who: int, now: np.ndarray, there: np.ndarray, end: np.ndarray) -> bool:
        """Whether an arm that is at joints float64[n] on a straight part of the way across, and
        comes to rest on that, may go to others, or to the end of that [rad]; if so, what it sweeps
        is its own."""
        lane = self.lanes[who]
        if lane.in_vain or (there is end and lane.behind is not None):
            return False
        # The first one is what is left of this part, where it has begun.
        after = lane.ahead[[leg.stage for leg in lane.ahead].index(BEHIND[0]) + 1 :]
        ahead = after if there is end else (self._rest(lane, there, end), *after)
        swept = lane.swept(np.stack([now, there]))
        if not self._may(who, swept, ahead, True):
            return False
        lane.here, lane.ahead, lane.stage = swept, ahead, BEHIND[0]
        lane.moving, lane.tries = True, None
        self.changes += 1
        return True

    @staticmethod
    def _rest(lane: Lane, there: np.ndarray, end: np.ndarray) -> Leg:
        """What is left of a part of the way across."""
        return Leg(BEHIND[0], lane.swept(np.stack([there, end])))

    def _may(self, who: int, swept: Sweep, ahead: tuple[Leg, ...], on_route: bool) -> bool:
        """Whether an arm may sweep a space, with these legs ahead of it then."""
        lane, other = self.lanes[who], self.other(who)
        if not clear(swept, other.here, APART):
            return False
        comes = None if other.placed or (other.after and other.after is lane.route) else other.route
        # A way may have been found again since it was announced.
        if comes is not None and not clear(swept, comes.goal, APART):
            return False
        first, second = self._waits(who, ahead), self._waits(1 - who, other.ahead)
        return not on_route or self._complete(
            swept.end, ahead, other.stays, other.ahead, first, second
        )

    def passes(self, who: int, joints: np.ndarray) -> None:
        """An arm on a leg is at joints float64[n] [rad]: what it has passed is free."""
        lane = self.lanes[who]
        if lane.moving:
            left = lane.here.from_near(lane.swept(joints[None]))
            if len(left.lines) < len(lane.here.lines):
                lane.here = left
                self.changes += 1

    def stands(self, who: int, joints: np.ndarray, holding: bool) -> None:
        """An arm stands at joints float64[n] [rad]."""
        lane = self.lanes[who]
        lane.holding, lane.moving = holding, False
        # What was drawn off is free; what is pressed home is so until the hand lets go.
        lane.loading = lane.loading if lane.stage == "place" else None
        lane.here = lane.swept(joints[None])
        self.changes += 1

    def stuck(self, who: int) -> bool:
        """Whether an arm that was told to wait would wait for ever; of two that wait for each other
        that gives way whose block comes after the other one, else one that is on its route."""
        lane, other = self.lanes[who], self.other(who)
        if lane.refused != self.changes:
            return False
        if other.route is None:
            return True
        if other.refused != self.changes or (other.behind and other.behind is lane.route):
            return False  # Where the first one gave way, what comes after it would be in vain, too.
        return bool(lane.behind) or lane.on_route or not other.on_route

    def _of(self, lane: Lane, motion: Motion) -> Sweep:
        """What a motion sweeps; remembered while an arm waits with it."""
        if lane.tries is None or lane.tries[0] is not motion or lane.tries[1] != lane.holding:
            joints = np.vstack([motion.joints[:-1:EVERY], motion.joints[-1:]])
            lane.tries = motion, lane.holding, lane.swept(joints)
        return lane.tries[2]

    # ------------------------------------------------------------ what follows

    def _waits(self, who: int, ahead: Sequence[Leg]) -> int | None:
        """The first of the legs ahead of an arm that comes when the other arm has done all of its
        own; None: it does not wait."""
        if self.lanes[who].behind is None:
            return None
        return next((n for n, leg in enumerate(ahead) if leg.stage in BEHIND), len(ahead))

    def _complete(
        self,
        here: Sweep,
        legs: Sequence[Leg],
        there: Sweep,
        others: Sequence[Leg],
        first: int | None = None,
        second: int | None = None,
    ) -> bool:
        """Whether two arms that stand can do all that is ahead of them, one leg at a time in some
        order.

        Args:
            here: where the one stands,
            legs: and what is ahead of it.
            there: where the other one stands, or may,
            others: and what is ahead of it.
            first: this leg of the one and all after it come when the other one is done.
            second: the same of the other one.
        """
        mine = [here, *(leg.swept.end for leg in legs)]
        theirs = [there, *(leg.swept.end for leg in others)]
        reached = np.zeros((len(mine), len(theirs)), bool)
        reached[0, 0] = True
        for i in range(len(mine)):
            for j in range(len(theirs)):
                waits = first is not None and i > first and j < len(theirs) - 1
                if i and reached[i - 1, j] and not waits:
                    reached[i, j] |= self._clear(legs[i - 1].swept, theirs[j], PLANNED)
                waits = second is not None and j > second and i < len(mine) - 1
                if j and reached[i, j - 1] and not reached[i, j] and not waits:
                    reached[i, j] = self._clear(others[j - 1].swept, mine[i], PLANNED)
        return bool(reached[-1, -1])

    def _clear(self, one: Sweep, other: Sweep, margin: float) -> bool:
        """As :func:`~learn2assemble.kinematics.sweeps.clear`, remembered."""
        key = id(one.lines), id(other.lines), margin
        if key not in self._known:
            if len(self._known) > 5000:
                self._known.clear()
            # Both are kept, so that their addresses stay theirs.
            self._known[key] = clear(one, other, margin), one, other
        return self._known[key][0]


class ArmInTraffic(WrappedPlant, Coordinator):
    """A plant that moves when it may.

    Args:
        plant: of the arm.
        traffic: who may.
        who: number of the arm.
        other: plant of the other arm, which tells where that is.
        piecewise: whether motions are told the plant piece by piece.
    """

    traffic: Traffic
    who: int
    other: Plant

    def __init__(
        self, plant: Plant, traffic: Traffic, who: int, other: Plant, piecewise: bool = False
    ) -> None:
        super().__init__(plant)
        self.traffic, self.who, self.other = traffic, who, other
        self.piecewise = piecewise
        self.flowing: np.ndarray | None = None
        """float64[n]: joints to which it may go on [rad]; None: it is not on such a way."""
        self.waited: float = 0.0
        """For the other arm, all in all [s]."""

    def rerouted(self, stage: str, way: np.ndarray) -> None:
        """See :class:`~learn2assemble.handling.execution.Coordinator`."""
        self.traffic.rerouted(self.who, stage, way)

    def halt(self, start: np.ndarray, end: np.ndarray) -> np.ndarray | None:
        """See :class:`~learn2assemble.handling.execution.Coordinator`: nearer to its place while
        it waits for the other arm."""
        lane, traffic = self.traffic.lanes[self.who], self.traffic
        known = lane.halt is not None and np.array_equal(lane.halt[1], end)
        if known or not lane.holding or lane.in_vain or np.abs(end - start).max() < SHORT:
            return None
        self._look_past()
        lane.halt, shares = None, FLOWING if self.piecewise else HALTS
        share = traffic.halt(self.who, start, end, shares)
        if share == 1.0:
            return None
        there = start + share * (end - start)
        if share and not self.piecewise:
            lane.halt = there, end
            return there
        if share and traffic.goes_on(self.who, start, there, end):
            self.flowing = there
            return there
        lane.refused = traffic.changes
        if traffic.stuck(self.who):
            return None
        self._look_past()
        self.waited += PAUSE
        return start

    def farther(self, now: np.ndarray, there: np.ndarray, end: np.ndarray) -> np.ndarray | None:
        """See :class:`~learn2assemble.handling.execution.Coordinator`."""
        self._look_past()
        # So near to the end it stands: there would be no end of going on by a part of what is left.
        near = np.abs(end - there).max() <= STANDS
        for share in (1.0, *(() if near else FLOWING)):
            farther = end if share == 1.0 else there + share * (end - there)
            if self.traffic.goes_on(self.who, now, farther, end):
                self.flowing = farther
                return farther
        return None

    def _look_past(self) -> None:
        """See what the other arm has passed."""
        if self.traffic.other(self.who).moving:
            self.traffic.passes(1 - self.who, self.other.sense().joints)

    def sense(self) -> Readings:
        """What is sensed, but what the other arm moves, or moved when it was stopped."""
        found, other = self.plant.sense(), self.traffic.other(self.who)
        names = other.left if other.route is None else (other.route.block, *other.route.along)
        return found._replace(blocks=tuple(b for b in found.blocks if b.block not in names))

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`; the arm stands until it may move.

        Raises:
            Failure: where it would wait for ever.
        """
        lane, moves = self.traffic.lanes[self.who], bool(len(motion.joints))
        moves = moves and bool((np.ptp(motion.joints, axis=0) > STANDS).any())
        kept = (Guard(hold="kept"),) if any(one.hold == "kept" for one in guards) else ()
        waited: list[Report] = []
        if self.flowing is not None and motion.stage == BEHIND[0]:
            # What it sweeps is its own already.
            report = self.plant.execute(motion, commands, guards)
            if report.stop != Stop.END or np.abs(report.joints - self.flowing).max() < STANDS:
                self.flowing = None
                self.traffic.stands(self.who, report.joints, lane.holding)
            return report
        while moves:
            if lane.in_vain and motion.stage in BEHIND:
                lane.in_vain = False  # As below.
                self.traffic.leaves_route(self.who)
                raise Failure(Outcome.UNREACHABLE, motion.stage, NOT_PLACED)
            if self.traffic.enter(self.who, motion):
                break
            if self.traffic.stuck(self.who):
                lane.behind = None  # It takes its block back.
                self.traffic.leaves_route(self.who)
                raise Failure(Outcome.UNREACHABLE, motion.stage, IN_THE_WAY)
            report = self.plant.execute(standing(motion.stage, motion.joints[0], PAUSE), (), kept)
            self._look_past()
            waited.append(report)
            self.waited += report.seconds
            if report.stop != Stop.END:
                return _joined(waited, done=0.0)
        report = self.plant.execute(motion, commands, guards)
        holding = lane.holding or report.stop == Stop.HELD
        for told in commands:
            if told.vacuum is False or (told.width is not None and not told.force):
                holding = False
        if lane.holding and not holding and motion.stage == "release":
            self.traffic.lets_go(self.who)
        if moves or holding != lane.holding:
            self.traffic.stands(self.who, report.joints, holding)
        return _joined([*waited, report], done=report.done)


def _joined(reports: Sequence[Report], done: float) -> Report:
    """What came of motions one after the other, as if they were one."""
    last, played = reports[-1], [one.played for one in reports if one.played is not None]
    whole = last.played
    if len(played) > 1:
        whole = Played(*(np.concatenate(parts) for parts in zip(*played, strict=True)))
    seconds = sum(one.seconds for one in reports)
    return last._replace(done=done, seconds=seconds, played=whole)
