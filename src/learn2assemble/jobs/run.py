"""A plan carried out by a robot: attempt by attempt, looked at before and after.

The plan says what is built and by which arm; where things are is sensed. Before anything moves the
robot has to be the arm of the plan, ready, at home and with an empty hand.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.cell.building import Building, Kept, Prepared
from learn2assemble.cell.cameras import no_pictures, through_cameras
from learn2assemble.cell.carry_out import key_of, prepare, setup_of
from learn2assemble.cell.report import Witness, Worked, carried_out, words_of
from learn2assemble.cell.site import Site, read_site
from learn2assemble.cell.state import Action
from learn2assemble.cell.workcell import Workcell
from learn2assemble.cell.world import MISSING
from learn2assemble.errors import InputError
from learn2assemble.motion.plant import (
    Guard,
    Motion,
    Plant,
    PlantError,
    Readings,
    Report,
    Request,
    Stop,
    ToolCommand,
    WrappedPlant,
    standing,
)
from learn2assemble.motion.safety import Guarded
from learn2assemble.motion.setup import Setup, Surroundings, check_address, open_plant
from learn2assemble.motion.trust import Trusted
from learn2assemble.planning.plan import Plan, load_plan
from learn2assemble.values import rounded

SIMULATION = "sim://"
IN_HAND = "hand"
"""Name of a block nobody knows, which is in the hand when a run begins."""
AT_HOME = 0.05
"""No joint may be farther from where a build begins [rad]."""


class Link(NamedTuple):
    """How a controller was driven."""

    motions: int = 0
    """That were sent."""
    moving: float = 0.0
    """What they were to take together [s of the plant's clock]."""
    overhead: float = 0.0
    """What a motion took longer than that, on average [s of the plant's clock]."""
    latency: float = 0.0
    """Until the plant said what it senses, on average [s of this machine]."""
    rate: float | None = None
    """New states in a second, where the plant tells."""


class Ran(NamedTuple):
    """What came of a run."""

    plan: Plan
    """The plan as far as it was carried out."""
    stop: Stop
    """Why it ended: :attr:`~learn2assemble.motion.plant.Stop.END` where nothing went wrong with the
    robot, also where the run was paused or the arm can go on with nothing."""
    reason: str | None
    """In words; None where everything is done."""
    blocks: int
    """That the robot placed or took away in this run."""
    seconds: float
    """How long the robot took for that [s of its clock]."""
    link: Link

    @property
    def complete(self) -> bool:
        """Whether everything is done."""
        return self.reason is None

    @property
    def seconds_a_block(self) -> float | None:
        """Of the robot's clock [s]."""
        return round(self.seconds / self.blocks, 2) if self.blocks else None


class _Timed(WrappedPlant):
    """A plant, and how long it takes.

    Args:
        plant: the one behind it.
    """

    def __init__(self, plant: Plant) -> None:
        super().__init__(plant)
        self.motions = self.looks = 0
        self.moving = self.took = self.waited = 0.0
        self.first = self.last = -1.0

    def sense(self) -> Readings:
        """See :class:`~learn2assemble.motion.plant.Plant`."""
        begun = time.perf_counter()
        found = self.plant.sense()
        self.waited, self.looks = self.waited + time.perf_counter() - begun, self.looks + 1
        self.first = found.time if self.first < 0 else self.first
        self.last = found.time
        return found

    def execute(
        self,
        motion: Motion,
        commands: Sequence[ToolCommand] = (),
        guards: Sequence[Guard] = (),
    ) -> Report:
        """See :class:`~learn2assemble.motion.plant.Plant`."""
        report = self.plant.execute(motion, commands, guards)
        if report.stop is Stop.END and motion.seconds:
            self.motions += 1
            self.moving += motion.seconds
            self.took += report.seconds
        return report

    def link(self, plant: Plant) -> Link:
        """The figures; the plant may know more."""
        count, rate = max(self.motions, 1), _of(plant, "rate")
        return Link(
            self.motions,
            round(self.moving, 2),
            round((self.took - self.moving) / count, 4),
            round(self.waited / max(self.looks, 1), 5),
            None if rate is None else rate(),
        )


def run(
    plan: Plan | str | Path,
    robot: str | Plant = SIMULATION,
    *,
    layout: str | Path | Site | None = None,
    state: str | Path | None = None,
    speed: float = 1.0,
    confirm: Callable[[int, str], bool] = lambda done, what: True,
    around: Surroundings | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Ran:
    """Carry out a plan with a robot, or go on with it.

    Args:
        plan: that an arm can carry out, complete, as :func:`~learn2assemble.jobs.build.build` with
            ``arm=`` makes it; or its folder.
        robot: address of the controller, as ``ur://192.168.0.2``, or a plant; ``sim://`` simulates.
            A plant that is given is not closed.
        layout: the workcell, see ``docs/layouts.md``; by default the one that is chosen for the
            base of the plan. Its sections ``program`` and ``safety`` hold for the robot.
        state: file that is appended to after every attempt; where it exists, the run goes on from
            it, and from what is sensed.
        speed: share of the planned speed, above 0 and up to 1.
        confirm: asked before every attempt, with the number of steps that are done and with what
            comes next in words; where it says no, the run pauses.
        around: what sees blocks, what serves the cell, and how long silence may last.
        progress: is told how far it has come.

    Raises:
        InputError: for a plan that no arm has carried out, a layout that does not work, another
            arm or a wrong address, and a file of another run.
        MissingExtraError: without the extra of the controller, or ``robot``.
    """
    if isinstance(robot, str):
        check_address(robot)
    if not isinstance(plan, Plan):
        plan = load_plan(plan)
    if plan.arm is None or plan.assembly is None or not plan.complete:
        who = f"by {len(plan.arms)} arms" if plan.arms else "without an arm"
        got = f"{plan.status}, {who if plan.arm is None else plan.arm.name}"
        raise InputError("plan", got, "a complete plan of an arm (`arm=`)")
    if not 0 < speed <= 1:
        raise InputError("speed", speed, "a share, above 0 and at most 1")
    site = layout if isinstance(layout, Site) else Site()
    if isinstance(layout, str | Path):
        site = read_site(Path(layout))
    if site.base is None:
        site = replace(site, base=plan.arm.base)
    file = None if state is None else Path(state)
    by_hand = any(step.by_hand for step in plan.steps)
    workcell = Workcell(plan.arm.name, plan.arm.tool, site=site, log=file, hands=by_hand)
    progress("planning the order of the arm")
    found = prepare(plan, workcell, 1e-4, progress)
    job = found.job
    if found.order.stuck:
        number, why = next(iter(found.order.stuck.items()))
        raise InputError("plan", f"{job.pieces[number].id}: {why}", "blocks that the arm can place")
    around = around or Surroundings(program=site.program)
    sees = around.trust_placements or around.look is not None or around.pictures is not None
    if site.cameras and not sees and isinstance(robot, str) and not robot.startswith(SIMULATION):
        raise no_pictures(site.cameras)
    setup = setup_of(job, workcell, found.structure)._replace(around=around)
    progress(f"connecting to {robot}" if isinstance(robot, str) else "connecting")
    nothing = Ran(plan, Stop.END, None, 0, 0.0, Link())
    plant: Plant | None = None
    try:
        plant = open_plant(robot, setup) if isinstance(robot, str) else robot
        return _run(plan, found, workcell, plant, setup, speed, confirm, progress)
    except PlantError as error:
        return nothing._replace(stop=error.stop, reason=str(error))
    finally:
        if plant is not None and isinstance(robot, str):
            plant.close()


def _of(plant: Plant, name: str) -> Callable[..., Any] | None:
    """What some plants can do besides; None where this one cannot."""
    return getattr(plant, name, None)


def _run(
    plan: Plan,
    found: Prepared,
    workcell: Workcell,
    plant: Plant,
    setup: Setup,
    speed: float,
    confirm: Callable[[int, str], bool],
    progress: Callable[[str], None],
) -> Ran:
    """The run with a plant that is there."""
    started, job = time.perf_counter(), found.job
    if setup.around.trust_placements:
        seeing: Plant = Trusted(plant, setup)
    else:
        seeing = through_cameras(plant, setup, job.pieces, workcell.site.cameras)
    timed = _Timed(Guarded(seeing, job.arm, workcell.site.safety, speed))
    _check_robot(timed, setup, bool(workcell.log and workcell.log.exists()))
    save, restore = _of(seeing, "state"), _of(seeing, "restore")
    kept = None if save is None or restore is None else Kept(save, restore)
    words, witness = words_of(job, workcell), Witness(plant)
    building = Building(found, workcell, timed, words, key_of(plan, workcell), kept, witness)
    known = building.known
    if setup.around.trust_placements:
        _take_away(timed, setup, building)

    def satisfied() -> int:
        return sum(known.satisfied(step) for step in known.planned)

    def go_on(action: Action) -> bool:
        return confirm(satisfied(), f"{action.what} {building.world.pieces[action.block].id}")

    def by_robot() -> int:
        own = (s for s in known.planned if s not in known.by_hand and not s.group)
        return sum(known.satisfied(step) for step in own)

    before, begun = by_robot(), timed.last
    reason = building.run(progress, go_on)
    took = time.perf_counter() - started
    done = carried_out(plan, [Worked(building, workcell, witness)], reason, took, plant)
    seconds, placed = max(timed.last - begun, 0.0), by_robot() - before
    return Ran(done, building.stopped, reason, placed, round(seconds, 2), timed.link(plant))


def _check_robot(plant: Plant, setup: Setup, resumed: bool) -> None:
    """Whether this is the robot of the plan, and may begin.

    Args:
        resumed: it may stand anywhere, as an interruption has left it.

    Raises:
        PlantError: where it is not.
    """
    arm, now = setup.arm, plant.sense()
    if now.arm != arm.name or now.joints.shape != arm.home.shape:
        got = f"{now.arm!r} with {len(now.joints)} joints"
        raise PlantError(Stop.REFUSED, f"the robot is {got}, the plan is for {arm.name}")
    if now.state == "stopped":
        raise PlantError(Stop.PROTECTIVE, "the robot is stopped; clear that first")
    if now.state == "moving":
        raise PlantError(Stop.REFUSED, "the robot is moving already")
    if not arm.inside_limits(now.joints):
        raise PlantError(Stop.REFUSED, f"joints {_list(now.joints)} are beyond their limits")
    off = np.abs(now.joints - arm.home)
    if not resumed and off.max() > AT_HOME:
        worst = int(off.argmax())
        why = f"the arm is not at home: {arm.joints[worst]} is {off[worst]:.2f} rad away"
        raise PlantError(Stop.REFUSED, f"{why}; home is {_list(arm.home)}")
    if now.tool.vacuum or (now.tool.grip or 0.0) > 0:
        _empty_hand(plant, setup, now)


def _empty_hand(plant: Plant, setup: Setup, now: Readings) -> None:
    """What an interruption has left in the hand is taken out of it by a person, where it stands."""
    why = "the hand holds something: take it out, and run again"
    if setup.around.serve is None:
        raise PlantError(Stop.REFUSED, why)
    plant.request(Request("remove", IN_HAND, IN_HAND, np.array([0.0, 0, 0, 1, 0, 0, 0])))
    told = ToolCommand(vacuum=False)
    if setup.arm.suction is None:
        told = ToolCommand(width=setup.arm.gripper.max_width, speed=setup.arm.gripper.speed)
    plant.execute(standing("release", now.joints, 0.5), (told,))
    tool = plant.sense().tool
    if tool.vacuum or (tool.grip or 0.0) > 0:
        raise PlantError(Stop.REFUSED, why)


def _take_away(plant: Plant, setup: Setup, building: Building) -> None:
    """Where nothing sees blocks, a person takes away those that an interruption has left anywhere,
    perhaps in their places.

    Raises:
        PlantError: where there is nobody who could.
    """
    world = building.world
    missing = [k for k, state in enumerate(world.state) if state == MISSING]
    if missing and setup.around.serve is None:
        names = ", ".join(world.names[k] for k in missing)
        raise PlantError(Stop.REFUSED, f"nobody can say where {names} is; take it away")
    for k in missing:
        plant.request(Request("remove", world.names[k], world.pieces[k].id, world.target(k)))


def _list(joints: np.ndarray) -> str:
    return f"[{', '.join(f'{rounded(value, 3):.3f}' for value in joints)}]"
