"""From an exact plan to a build by an arm: set up, find an order, carry it out, report."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from learn2assemble.acting.building import Building, Prepared
from learn2assemble.acting.journal import Kept
from learn2assemble.acting.report import (
    Witness,
    Worked,
    arm_report,
    carried_out,
    none_placed,
    words_of,
)
from learn2assemble.cell.arrange import Hands, arrange
from learn2assemble.cell.bricks import BrickStructure
from learn2assemble.cell.reach import set_up, with_other_tools
from learn2assemble.cell.structure import Structure
from learn2assemble.cell.taking_apart import arrange_bricks, plan_in_order
from learn2assemble.cell.workcell import Job, Progress, StepOf, Workcell, job_of
from learn2assemble.cell.world import OBSTACLE_DENSITY, WorkcellBlocks
from learn2assemble.errors import InputError, listed
from learn2assemble.geometry.rotations import yaw_quaternion
from learn2assemble.kinematics.cell import KinematicCell
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.brick_plan import with_hands
from learn2assemble.planning.plan import Plan, Status
from learn2assemble.plants.plant import Plant, PlantError
from learn2assemble.plants.safety import Safety, check_home, guarded
from learn2assemble.plants.setup import BlockKind, Setup, open_plant
from learn2assemble.progress import Detail
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.bodies import Part
from learn2assemble.sensing.eyes import SeeingPlant, Sort
from learn2assemble.sensing.pictures import pictures_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from learn2assemble.assembly.kit import Kit
    from learn2assemble.cell.pieces import Piece
    from learn2assemble.sensing.camera import DepthCamera

# ---------------------------------------------------------------- the whole of it

MOST_STEPS, _SECONDS = 120, 20.0
"""Of a plan for which other tools are tried, and after so long no further one is [s]."""
FINGER_ROOMS = (0.011, 0.02, 0.03, 0.036)
"""Gaps between blocks that are tried where fingers have no room [m]."""


def wider(kit: Kit, gap: float) -> Kit:
    """The kit with vertical joints of this width [m]: blocks as they are, farther apart."""
    dx, dy, dz = kit.pitch
    room = gap - kit.joint_gap
    return replace(kit, pitch=(dx + room, dy + room, dz), joint_gap=gap)


def prepare(
    plan: Plan, workcell: Workcell, joint: float, progress: Progress = lambda text: None
) -> Prepared:
    """The job, what rests on what, an order, and the cell that found it.

    Raises:
        InputError: for what cannot be held or reached, and for a layout that does not work.
    """
    job = job_of(plan, workcell.arm, joint, workcell.hands)
    if job.standing and job.assembly.holds:
        got = "bricks that stand before the first step"
        raise InputError("design", got, "none that clutch, for an arm")
    progress("looking where the arm stands and where blocks wait")
    job = set_up(job, workcell.arm, workcell.tool, workcell.site, progress)
    check_home(job.arm, workcell.site.safety)
    progress("looking for an order that the arm can do")
    cell = KinematicCell(job.arm)
    hands = [Hands(job, cell)]
    if job.assembly.holds:
        bricks = BrickStructure(job)
        return Prepared(job, bricks, arrange_bricks(hands, bricks, progress), cell)
    structure = Structure(job)
    return Prepared(job, structure, arrange(hands, structure, progress), cell)


def carry_out(
    plan: Plan,
    workcell: Workcell,
    *,
    joint: float = 1e-4,
    progress: Progress = lambda text: None,
    found: Prepared | None = None,
    plant: Plant | None = None,
) -> Plan:
    """A complete exact plan, carried out by an arm.

    Args:
        joint: width of a vertical joint [m].
        found: of :func:`prepare`, where that has been called.
        plant: that carries it out; by default a simulation of the workcell. It is not closed.

    Raises:
        InputError: for what cannot be held or reached, and for a layout that does not work.
    """
    if not plan.complete or plan.assembly is None:
        return plan
    started = time.perf_counter()
    found = found or prepare(plan, workcell, joint, progress)
    job, order = found.job, found.order
    if order.stuck:
        return _refused(plan, found, workcell, advise(plan, workcell, joint, progress))
    if plan.assembly.holds:
        plan = plan_in_order(plan, order.steps)
    begins = "moving the blocks" if workcell.physics == "kinematic" else "starting the simulation"
    progress(begins if plant is None else "looking at the cell")
    setup = setup_of(job, workcell, found.structure)
    plant = plant or cast("Plant", simulated(setup))
    seen = through_cameras(plant, setup, job.pieces, workcell.site.cameras)
    kept = Kept.of(seen)
    words, witness = words_of(job, workcell), Witness(plant)
    seen = guarded(seen, job.arm, workcell.site.safety)
    try:
        building = Building(found, workcell, seen, words, key_of(plan, workcell), kept, witness)
    except PlantError as error:
        return _none_placed(plan, job, workcell, str(error), "incomplete")
    reason = building.run(progress)
    took = time.perf_counter() - started
    return carried_out(plan, [Worked(building, workcell, witness)], reason, took, plant)


def _refused(plan: Plan, found: Prepared, workcell: Workcell, advice: str) -> Plan:
    """What comes of a plan of which the arm cannot do every step, in whatever order."""
    job, order = found.job, found.order
    number, why = next(iter(order.stuck.items()))
    blocks = [job.pieces[k].id for k in order.stuck]
    gone = any(step.block == number and step.remove for step in job.steps)
    what = (
        "take away"
        if gone and (number in job.standing or StepOf(number) in order.steps)
        else "place"
    )
    which = f"{blocks[0]}: " if blocks[1:] else ""
    reason = f"the arm cannot {what} {listed(blocks)}: {which}{why}"
    reason = f"{reason}; {advice}" if advice else reason
    return _none_placed(plan, job, workcell, reason)


def _none_placed(
    plan: Plan, job: Job, workcell: Workcell, reason: str, status: Status = "refused"
) -> Plan:
    """What comes of a plan of which the arm has placed nothing."""
    return replace(none_placed(plan, reason, status), arm=arm_report(job, workcell, None))


def advise(plan: Plan, workcell: Workcell, joint: float, progress: Progress) -> str:
    """With what a plan that the arm cannot carry out is built, in one clause; empty where nothing
    was found. All of it is tried: every other tool of the arm, on plans of up to
    :data:`MOST_STEPS` steps; of bricks that clutch, hands.

    Args:
        plan, joint: as a build with another tool would begin with them.
    """
    assert plan.assembly is not None
    hands = with_hands(plan.assembly) if plan.assembly.holds else ""
    if len(plan.steps) > MOST_STEPS:
        return hands
    # Of the processor: on a busy machine as much is tried.
    tried, clock = list[str](), Clock(_SECONDS, time.process_time)
    others = with_other_tools(get_arm(workcell.arm, workcell.tool), plan.assembly.joint.studs)
    for tool in others:
        if clock.left <= 0:
            return hands
        progress(f"trying whether the arm does it with the tool {tool}")
        with suppress(InputError):  # It holds not every block, or there is no room for magazines.
            other = replace(workcell, tool=tool)
            if not prepare(plan, other, joint, _told_of(tool, progress)).order.stuck:
                return f"with `tool={tool}` there is an order in which the arm does every step"
        tried.append(tool)
    none = f"no other tool of the arm does: {', '.join(tried)}" if tried else ""
    return "; ".join(filter(None, (none, hands)))


def _told_of(tool: str, progress: Progress) -> Progress:
    """What is told while another tool is tried: never more than how far that has come."""
    return lambda text: progress(Detail(f"trying the tool {tool}: {text}"))


def simulated(setup: Setup) -> Any:
    """The simulated cell that is described, with all its arms."""
    return open_plant("sim://", setup)


def setup_of(job: Job, workcell: Workcell, structure: Structure | None = None) -> Setup:
    """The cell of a job as a plant gets to know it.

    Args:
        structure: what is pressed on what, where bricks clutch.
    """
    world = WorkcellBlocks(job)
    seen = [k for k in world.visible() if not world.pieces[k].fixed]
    own = [piece for piece in job.pieces if not piece.fixed]
    kinds = {piece.id: BlockKind(piece.shape, piece.density) for piece in own}
    stay = [piece for piece in job.pieces if piece.fixed and not piece.sunk]
    fixed = [(BlockKind(piece.shape, OBSTACLE_DENSITY), piece.pose) for piece in stay]
    for obstacle in job.obstacles:
        x, y, z = obstacle.size
        part = Part((0.0, 0.0, 0.0), (x / 2, y / 2, z / 2))
        pose = np.array([*obstacle.middle, *yaw_quaternion(obstacle.yaw)])
        fixed.append((BlockKind((part,), OBSTACLE_DENSITY), pose))
    return Setup(
        job.arm,
        kinds,
        {world.names[k]: world.pose[k].copy() for k in seen},
        tuple(fixed),
        job.assembly.friction,
        studs=None if structure is None else structure.studs(),
        simulated=workcell.simulated,
    )


def carry_out_cells(
    plan: Plan,
    kit: Kit,
    workcell: Workcell,
    progress: Progress,
    plan_again: Callable[[Kit], Plan],
) -> Plan:
    """As :func:`carry_out`, with the blocks farther apart where fingers have no room otherwise.

    Args:
        kit: of the plan.
        plan_again: plans the same cells with another kit.
    """
    if not plan.complete:
        return plan
    found = prepare(plan, workcell, kit.joint_gap, progress)
    first, gap = plan, kit.joint_gap
    for room in FINGER_ROOMS:
        if not found.order.stuck or found.job.arm.suction is not None or room <= kit.joint_gap:
            continue
        progress(f"fingers have no room between the blocks: trying {1e3 * room:g} mm")
        other = plan_again(wider(kit, room))
        if other.complete:
            again = prepare(other, workcell, room, progress)
            if len(again.order.steps) > len(found.order.steps):
                plan, found, gap = other, again, room
    if found.order.stuck:
        return _refused(plan, found, workcell, advise(first, workcell, kit.joint_gap, progress))
    return carry_out(plan, workcell, joint=gap, progress=progress, found=found)


def key_of(plan: Plan, workcell: Workcell) -> str:
    """What a build must have in common with the one it goes on from."""
    steps = [(s.block, s.action, s.kind, s.position) for s in plan.steps]
    # A magazine that ran empty may have been filled again, and what stopped a motion may be allowed
    # now; boxes that are kept out are part of the cell.
    filled = tuple(replace(magazine, count=None) for magazine in workcell.site.magazines)
    rules = Safety(keep_out=workcell.site.safety.keep_out)
    site = replace(workcell.site, magazines=filled, safety=rules, source="")
    told = (
        steps,
        workcell.arm,
        workcell.tool,
        site,
        workcell.physics,
        workcell.seed,
        workcell.simulated.noise,
        workcell.touch,
    )
    return hashlib.sha256(repr(told).encode()).hexdigest()[:24]


def through_cameras(
    plant: Plant, setup: Setup, pieces: Sequence[Piece], cameras: Sequence[DepthCamera]
) -> Plant:
    """A plant whose blocks are seen by cameras; the plant itself where there are none, or where
    something else is said to see blocks.

    Args:
        plant: a simulated cell shows itself to the cameras; of others ``setup.around.pictures``
            takes the pictures.
        setup: the cell as it is meant to be.
        pieces: blocks of the plan.
        cameras: of the layout.

    Raises:
        InputError: where nothing takes pictures.
    """
    pictures = setup.around.pictures
    if not cameras or setup.around.look is not None:
        return plant
    if pictures is None:
        pictures = pictures_of(plant, setup, cameras)
    if pictures is None:
        raise no_pictures(cameras)
    sorts = {piece.id: Sort(piece.shape, tuple(piece.turns())) for piece in pieces}
    fixed = [(kind.shape, pose) for kind, pose in setup.fixed]
    return SeeingPlant(plant, setup.arm, cameras, pictures, sorts, setup.waiting, fixed)


def no_pictures(cameras: Sequence[DepthCamera]) -> InputError:
    """Nothing takes pictures with the cameras of a layout."""
    names = ", ".join(camera.name for camera in cameras)
    expected = "what takes their pictures (`Surroundings(pictures=...)`), or a layout without"
    return InputError("cameras", names, expected)
