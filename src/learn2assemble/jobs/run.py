"""A plan carried out by robots: attempt by attempt, looked at before and after.

The plan says what is built and by which arms; where things are is sensed. Before anything moves
each robot has to be the arm of the plan, ready, at home and with an empty hand. Two robots share
their cell as two simulated arms do: who may move is decided here, and what one of them does the
other one is told.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from learn2assemble.acting.building import Building, Prepared
from learn2assemble.acting.carry_out import (
    key_of,
    no_pictures,
    prepare,
    setup_of,
    through_cameras,
)
from learn2assemble.acting.journal import Kept
from learn2assemble.acting.report import Witness, Worked, carried_out, words_of
from learn2assemble.acting.state import Action
from learn2assemble.cell.site import Site, read_site
from learn2assemble.cell.site_arms import SiteArm
from learn2assemble.cell.workcell import StepOf, Workcell
from learn2assemble.errors import InputError, check_name
from learn2assemble.jobs.driven import Link, Timed, check_robot, take_away
from learn2assemble.planning.plan import Plan, load_plan
from learn2assemble.plants.plant import Plant, PlantError, Stop
from learn2assemble.plants.remote import RemotePlant, in_process
from learn2assemble.plants.robots import Robots
from learn2assemble.plants.safety import Guarded, check_share
from learn2assemble.plants.setup import WALL, Setup, Surroundings, check_address, open_plant
from learn2assemble.plants.trust import Placements, Trusted
from learn2assemble.team.crew import Member
from learn2assemble.team.in_turn import two_arms
from learn2assemble.team.members import set_up_team
from learn2assemble.team.pair import bricks_by_team
from learn2assemble.team.together import built_by

SIMULATION = "sim://"
T = TypeVar("T")


class Ran(NamedTuple):
    """What came of a run."""

    plan: Plan
    """The plan as far as it was carried out."""
    stop: Stop
    """Why it ended: :attr:`~learn2assemble.plants.plant.Stop.END` where nothing went wrong with a
    robot, also where the run was paused or the arms can go on with nothing."""
    reason: str | None
    """In words; None where everything is done."""
    blocks: int
    """That robots placed or took away in this run."""
    seconds: float
    """How long they took for that [s of their clock]."""
    links: tuple[Link, ...]
    """How each was driven, in the order of the arms of the plan."""

    @property
    def link(self) -> Link:
        """Of the robot, or the first one."""
        return self.links[0]

    @property
    def complete(self) -> bool:
        """Whether everything is done."""
        return self.reason is None

    @property
    def seconds_a_block(self) -> float | None:
        """Of the clock of the robots [s]."""
        return round(self.seconds / self.blocks, 2) if self.blocks else None


class _RunOrder(NamedTuple):
    """What is asked of a run, whoever carries it out."""

    plan: Plan
    site: Site
    file: Path | None
    speed: float
    confirm: Callable[[int, str], bool]
    around: Surroundings
    progress: Callable[[str], None]

    def check_seen(self, robots: Sequence[str | Plant]) -> None:
        """Refuse cameras whose pictures nobody takes.

        Raises:
            InputError: for these.
        """
        around, cameras = self.around, self.site.cameras
        sees = around.trust_placements or around.look is not None or around.pictures is not None
        far = any(isinstance(one, str) and not one.startswith(SIMULATION) for one in robots)
        if cameras and not sees and far:
            raise no_pictures(cameras)


def run(
    plan: Plan | str | Path,
    robot: str | Plant | Sequence[str | Plant] = SIMULATION,
    *,
    layout: str | Path | Site | None = None,
    state: str | Path | None = None,
    speed: float = 1.0,
    confirm: Callable[[int, str], bool] = lambda done, what: True,
    around: Surroundings | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Ran:
    """Carry out a plan with a robot, or with two, or go on with it.

    Args:
        plan: that arms can carry out, complete, as :func:`~learn2assemble.jobs.build.build` with
            ``arm=`` makes it; or its folder.
        robot: address of the controller, as ``ur://192.168.0.2``, or a plant; ``sim://`` simulates,
            also two arms together. Of a plan of two arms, else, one of these for each, in their
            order; each controller is driven by a process of its own. A plant that is given is not
            closed.
        layout: the workcell, see ``docs/layouts.md``; by default the one that is chosen for the
            bases of the plan. Its sections ``program`` and ``safety`` hold for the robots.
        state: file that is appended to after every attempt; where it exists, the run goes on from
            it, and from what is sensed.
        speed: share of the planned speed, 0.001 to 1.
        confirm: asked before every attempt, with the number of steps that are done or under way
            and with what comes next in words; where it says no, the run pauses.
        around: what sees blocks, what serves the cell, and how long silence may last. With two
            robots ``look`` tells times by its ``clock``.
        progress: is told how far it has come.

    Raises:
        InputError: for a plan that no arm has carried out, a layout that does not work, another
            arm or a wrong address, and a file of another run.
        MissingExtraError: without the extra of the controller, or ``robot``.
    """
    robots = _each(robot)
    for one in robots:
        if isinstance(one, str):
            check_address(one)
        elif not callable(getattr(one, "execute", None)):
            raise InputError("robot", one, "an address, as sim:// or ur://HOST, or a plant")
    if not isinstance(plan, Plan):
        plan = load_plan(plan)
    count = len(plan.arms) or int(plan.arm is not None)
    if not count or plan.assembly is None or not plan.complete:
        got = f"{plan.status}, {count or 'no'} arm{'s' * (count != 1)}"
        raise InputError("plan", got, "a complete plan of an arm, or of two (`arm=`)")
    check_share(speed)
    if len(robots) != count and robots != [SIMULATION]:
        arms = ", ".join(one.name for one in plan.arms) or "one arm"
        several = f"{len(robots)} robot{'s' * (len(robots) != 1)}"
        raise InputError("robot", several, f"one for each arm of the plan: {arms}")
    if count == 1 and plan.arm is None:
        raise InputError("plan", "one arm of two", "a complete plan of an arm, or of two (`arm=`)")
    if count > 1 and len(robots) > 1 and SIMULATION in robots:
        raise InputError("robot", f"{SIMULATION} as one of two", "it alone, for both arms")
    site = layout if isinstance(layout, Site) else Site()
    if isinstance(layout, str | Path):
        site = read_site(Path(layout))
    file = None if state is None else Path(state)
    around = around or Surroundings(program=site.program)
    order = _RunOrder(plan, site, file, speed, confirm, around, progress)
    if count > 1:
        return _run_two(order, robots)
    (one,) = robots
    return _run_one(order, one)


def _each(robot: str | Plant | Sequence[str | Plant]) -> list[str | Plant]:
    """One or several, as a list."""
    if isinstance(robot, str) or not isinstance(robot, Sequence):
        return [robot]
    return [*robot]


# ---------------------------------------------------------------- one robot


def _run_one(order: _RunOrder, robot: str | Plant) -> Ran:
    plan, site = order.plan, order.site
    assert plan.arm is not None
    if site.base is None:
        site = replace(site, base=plan.arm.base)
    by_hand = any(step.by_hand for step in plan.steps)
    workcell = Workcell(plan.arm.name, plan.arm.tool, site=site, log=order.file, hands=by_hand)
    order.progress("planning the order of the arm")
    found = prepare(plan, workcell, 1e-4, order.progress)
    job = found.job
    if found.order.stuck:
        number, why = next(iter(found.order.stuck.items()))
        raise InputError("plan", f"{job.pieces[number].id}: {why}", "blocks that the arm can place")
    order.check_seen([robot])
    setup = setup_of(job, workcell, found.structure)._replace(around=order.around)
    order.progress(f"connecting to {robot}" if isinstance(robot, str) else "connecting")
    plant: Plant | None = None
    try:
        plant = open_plant(robot, setup) if isinstance(robot, str) else robot
        return _by_one(order, found, workcell, plant, setup)
    except PlantError as error:
        return Ran(plan, error.stop, str(error), 0, 0.0, (Link(),))
    finally:
        if plant is not None and isinstance(robot, str):
            plant.close()


def _by_one(
    order: _RunOrder, found: Prepared, workcell: Workcell, plant: Plant, setup: Setup
) -> Ran:
    """The run with a plant that is there."""
    started, job = time.perf_counter(), found.job
    if setup.around.trust_placements:
        seeing: Plant = Trusted(plant, setup)
    else:
        seeing = through_cameras(plant, setup, job.pieces, workcell.site.cameras)
    timed = Timed(seeing)
    driven = Guarded(timed, job.arm, workcell.site.safety, order.speed)
    check_robot(driven, setup, bool(workcell.log and workcell.log.exists()))
    words, witness, key = words_of(job, workcell), Witness(plant), key_of(order.plan, workcell)
    building = Building(found, workcell, driven, words, key, Kept.of(seeing), witness)
    known = building.known
    if setup.around.trust_placements:
        take_away(driven, setup, building)

    def satisfied() -> int:
        return sum(known.satisfied(step) for step in known.planned)

    def go_on(action: Action) -> bool:
        what = f"{action.what} {building.world.pieces[action.block].id}"
        return order.confirm(satisfied(), what)

    before, begun = _by_robots([building]), timed.last
    reason = building.run(order.progress, go_on)
    took = time.perf_counter() - started
    done = carried_out(order.plan, [Worked(building, workcell, witness)], reason, took, plant)
    seconds, placed = max(timed.last - begun, 0.0), _by_robots([building]) - before
    links = (timed.link(plant),)
    return Ran(done, building.stopped, reason, placed, round(seconds, 2), links)


def _by_robots(buildings: Sequence[Building]) -> int:
    """How many steps are done that robots do."""
    known = [building.known for building in buildings]
    return len(
        {
            step
            for one in known
            for step in one.planned
            if step not in one.by_hand and not step.group and one.satisfied(step)
        }
    )


# ---------------------------------------------------------------- two robots


def _run_two(order: _RunOrder, robots: Sequence[str | Plant]) -> Ran:
    plan, site = order.plan, order.site
    assert plan.assembly is not None
    far = list(robots) != [SIMULATION]
    if far and any(step.action == "hold" for step in plan.steps):
        # What a hand presses with is less than a robot tells from noise.
        raise InputError("robot", ", ".join(map(str, robots)), f"{SIMULATION}: steps hold a block")
    if site.cameras and order.around.look is None and not order.around.trust_placements:
        raise InputError("layout", "cameras", "none, for several arms")
    order.progress("looking where the arms stand and where blocks wait")
    members = set_up_team(plan.assembly, _arms(plan, site), replace(site, arms=()), order.progress)
    first = members[0].job.arm
    workcell = Workcell(first.name, first.tool_name, site=site, log=order.file, hands=True)
    steps: tuple[StepOf, ...] | None = None
    if plan.assembly.holds:
        plan, steps = bricks_by_team(plan.assembly, members, workcell, order.progress)
        if not plan.complete:
            raise InputError("plan", plan.reason, "blocks that the arms can place")
    cell = _CellOfTwo(order._replace(plan=plan), members, robots if far else ())
    try:
        both = two_arms(
            plan,
            members,
            workcell,
            progress=order.progress,
            order=steps,
            opened=cell.opened,
            through=cell.through,
        )
        names = [one.name for one in members]

        def go_on(who: int, action: Action) -> bool:
            block = both.buildings[who].world.pieces[action.block].id
            return order.confirm(both.steps_begun(who), f"{action.what} {block} ({names[who]})")

        both.go_on = go_on
        if order.around.trust_placements:
            take_away(cell.driven[0], cell.setups[0], both.buildings[0])
        started, before = time.perf_counter(), _by_robots(both.buildings)
        count, begun = len(both.turns), both.plant.sense().time
        done, reason = built_by(both, plan, order.progress, started)
        ends = [turn.end for turn in both.turns[count:]]
        stop = both.stops[0].stop if reason and both.stops else Stop.END
        seconds, placed = max(ends, default=begun) - begun, _by_robots(both.buildings) - before
        return Ran(done, stop, reason, placed, round(seconds, 2), cell.links())
    except PlantError as error:
        return Ran(plan, error.stop, str(error), 0, 0.0, (Link(), Link()))
    finally:
        cell.close()


def _arms(plan: Plan, site: Site) -> list[SiteArm]:
    """The arms of a plan, where the layout has them or where they stood."""
    known = {one.name: one for one in site.arms}
    found = list[SiteArm]()
    for told in plan.arms:
        if known:
            check_name("arm of the plan, in the layout", told.name, known)
        one = known.get(told.name, SiteArm(told.name, told.arm))
        if one.arm != told.arm:
            raise InputError(f"arm {told.name} of the layout", one.arm, f"{told.arm}, as planned")
        found.append(one._replace(tool=told.tool, base=one.base or told.base))
    return found


class _CellOfTwo:
    """The cell of two arms, as a run drives it.

    Args:
        order: what is asked.
        members: the arms.
        robots: what drives each; none: a simulation has both.
    """

    def __init__(
        self, order: _RunOrder, members: Sequence[Member], robots: Sequence[str | Plant]
    ) -> None:
        self.order, self.robots = order, robots
        self.names: list[str] = [one.name for one in members]
        self.setups: list[Setup] = []
        """Of each arm alone."""
        self.driven: list[Timed] = []
        self.own: list[RemotePlant] = []
        """Plants that were opened for the run."""
        self.known: Placements | None = None
        self.cell: Any = None

    def opened(self, setup: Setup) -> Any:
        """See :class:`~learn2assemble.team.together.Together`: all robots are there, and ready."""
        around, setup = self.order.around, setup._replace(around=self.order.around)
        arms = (setup.arm, *setup.others)
        self.setups = [setup._replace(arm=arm, others=()) for arm in arms]
        self.known = Placements(setup) if around.trust_placements else None
        if not self.robots:
            self.cell = open_plant(SIMULATION, setup)
        else:
            plants = [self._told(who, self._open, who) for who in range(len(arms))]
            self.cell = Robots(plants, around, self.known)
        resumed = bool(self.order.file and self.order.file.exists())
        for who, plant in enumerate(self.cell.plants):
            (_, stack), own, name = self._stack(who, plant), self.setups[who], self.names[who]
            self._told(who, check_robot, stack, own, resumed, name)
        return self.cell

    def _told(self, who: int, method: Callable[..., T], *given: Any) -> T:
        """What a method returns; an error of a plant says of which arm that is."""
        try:
            return method(*given)
        except PlantError as error:
            raise PlantError(error.stop, f"{self.names[who]}: {error.why}") from None

    def through(self, who: int, plant: Plant) -> Plant:
        """See :class:`~learn2assemble.team.together.Together`."""
        timed, driven = self._stack(who, plant)
        self.driven.append(timed)
        return driven

    def _stack(self, who: int, plant: Plant) -> tuple[Timed, Plant]:
        """What tells how a robot does what it is told, and through what its arm is driven."""
        own = self.setups[who]
        seeing = plant if self.known is None else Trusted(plant, own, self.known)
        timed = Timed(seeing)
        return timed, Guarded(timed, own.arm, self.order.site.safety, self.order.speed)

    def _open(self, who: int) -> Plant:
        """The plant of a robot; behind an address in a process of its own, so that it is watched
        whatever this one is busy with."""
        robot, setup = self.robots[who], self.setups[who]
        if not isinstance(robot, str):
            return robot
        self.order.progress(f"connecting to {robot}")
        bare = setup.around._replace(look=None, pictures=None, serve=None, clock=WALL)
        plant = in_process(partial(open_plant, robot), setup._replace(around=bare))
        self.own.append(plant)
        return plant

    def links(self) -> tuple[Link, ...]:
        """How each robot was driven."""
        both = zip(self.driven, self.cell.plants, strict=True)
        return tuple(timed.link(plant) for timed, plant in both)

    def close(self) -> None:
        """Give back what was opened."""
        for plant in self.own:
            plant.close()
