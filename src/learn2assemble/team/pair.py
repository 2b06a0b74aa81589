"""What two arms begin with: the blocks that each can place, in an order in which they are seldom in
each other's way, and what of the other one each has to keep clear of.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence, Set
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from learn2assemble.acting.building import Prepared
from learn2assemble.acting.report import none_placed
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.cell.arrange import (
    Arranged,
    Hands,
    arrange,
    from_end_to_end,
    put_beside,
    try_step,
    where_pressed,
)
from learn2assemble.cell.bricks import BrickStructure
from learn2assemble.cell.pieces import middle_of, with_rests
from learn2assemble.cell.reach import with_home, with_other_tools
from learn2assemble.cell.structure import Structure
from learn2assemble.cell.taking_apart import arrange_bricks, plan_in_order
from learn2assemble.cell.workcell import ROOMS, Job, Progress, StepOf, Workcell, job_of
from learn2assemble.cell.world import RETURNED, STANDING, WorkcellBlocks
from learn2assemble.errors import InputError, listed
from learn2assemble.kinematics.cell import KinematicCell
from learn2assemble.planning.brick_plan import plan_for_arm, with_hands
from learn2assemble.planning.plan import Plan, Step
from learn2assemble.plants.plant import Plant
from learn2assemble.plants.safety import check_home, guarded
from learn2assemble.progress import silent
from learn2assemble.robot.arm import Arm
from learn2assemble.team.crew import Member
from learn2assemble.team.members import set_up_team, site_arm_of, told_of

HOMES = (0.25, 0.3, 0.35)
"""So far in front of its base the tool waits, the preferred one first [m]."""


class Pair(NamedTuple):
    """What two arms begin with."""

    found: tuple[Prepared, Prepared]
    workcells: tuple[Workcell, Workcell]
    """Of each; all that belongs to the cell is that of the first one."""
    names: tuple[str, str]

    def guarded(self, who: int, plant: Plant) -> Plant:
        """The plant of an arm, which is told nothing that breaks the rules of the layout."""
        return guarded(plant, self.found[who].job.arm, self.workcells[who].site.safety)


def gather(
    plan: Plan,
    members: Sequence[Member],
    workcell: Workcell,
    joint: float = 1e-4,
    order: Sequence[StepOf] | None = None,
    progress: Progress = lambda text: None,
) -> Pair:
    """Two arms with magazines of their own, and for each the steps that it could do.

    Args:
        plan: complete.
        members: the arms, see :func:`~.members.set_up_team`.
        workcell: how they build; which arm and tool, and what its base is, does not matter.
        joint: width of a vertical joint [m].
        order: of bricks that clutch, as :func:`bricks_by_team` has found it.
        progress: told how far it has come where an order is looked for, as something stands
            already.

    Raises:
        InputError: for a block that neither can place, or take away, when its turn in the plan has
            come.
    """
    jobs = jobs_of(plan, members, workcell, joint)
    kinematic = [KinematicCell(job.arm) for job in jobs]
    structure: Structure | None = None
    if jobs[0].standing:
        structure = Structure(jobs[0])
        hands = [Hands(*one) for one in zip(jobs, kinematic, strict=True)]
        found_order = arrange(hands, structure, progress)
        if found_order.stuck:
            raise _neither(jobs[0], found_order)
        order = found_order.steps
    if order is not None:
        first, second = (replace(job, steps=tuple(order)) for job in jobs)
        jobs = first, second
    first = jobs[0]
    if structure is None:
        structure = BrickStructure(first) if first.assembly.holds else Structure(first)
    can = [possible(job, structure, cell) for job, cell in zip(jobs, kinematic, strict=True)]
    found, cells = list[Prepared](), list[Workcell]()
    for number, (job, cell) in enumerate(zip(jobs, kinematic, strict=True)):
        (steps, stuck), (others, _) = can[number], can[1 - number]
        own = shared_out(job, structure, steps, set(others), number)
        found.append(Prepared(job, structure, Arranged(own, stuck), cell))
        cells.append(workcell_of(workcell, job))
    reached = {step for one in found for step in one.order.steps}
    left = [step for step in first.steps if step not in reached]
    if left:
        raise _neither(first, Arranged(tuple(left), {left[0].block: can[0][1][left[0].block]}))
    one, other = (member.name for member in members)
    return Pair((found[0], found[1]), (cells[0], cells[1]), (one, other))


def _neither(job: Job, found: Arranged) -> InputError:
    """What is said of a block that neither arm can place, or take away."""
    number, why = next(iter(found.stuck.items()))
    gone = StepOf(number, True) in job.steps and number in job.standing
    what = "take away" if gone else "place"
    got = f"{job.pieces[number].id}, which neither can {what}: {why}"
    return InputError("arms", got, "all within reach")


def workcell_of(workcell: Workcell, job: Job) -> Workcell:
    """That of one of the arms; what is kept of the build is kept of both at once."""
    return replace(workcell, arm=job.arm.name, tool=job.arm.tool_name, log=None)


def jobs_of(
    plan: Plan,
    members: Sequence[Member],
    workcell: Workcell,
    joint: float,
    holding: bool = False,
) -> tuple[Job, Job]:
    """What two arms have to do, each with what of the other one it keeps clear of.

    Args:
        holding: whether the plan may have steps that hold a block.
    """
    alike = job_of(plan, workcell.arm, joint, workcell.hands, holding)
    if alike.standing and (holding or alike.assembly.holds):
        got = "blocks that stand before the first step"
        what = "bricks that clutch" if alike.assembly.holds else "arms that hold"
        raise InputError("design", got, f"none, with {what}")
    jobs = [
        replace(
            alike,
            pieces=with_rests(alike.pieces, member.job.arm, member.rests),
            arm=member.job.arm,
            sources=member.job.sources,
            obstacles=member.job.obstacles,
        )
        for member in members
    ]
    first, second = (replace(job, arm=back(job)) for job in jobs)
    for job in (first, second):
        check_home(job.arm, workcell.site.safety)
    return first, second


def possible(
    job: Job, structure: Structure, cell: KinematicCell
) -> tuple[list[StepOf], dict[int, str]]:
    """The steps of a plan that an arm could do, each when its turn has come; by block, why it could
    not do the others."""
    world, standing = WorkcellBlocks(job), set(job.there)
    steps, stuck = list[StepOf](), dict[int, str]()
    put_beside(world, job.steps)
    for step in job.steps:
        into = structure.ways_in(step.block, standing)
        press, why = where_pressed(structure, world, step, standing), None
        for cell.apart in (0.0,) if press is None else ROOMS:
            why = try_step(world, cell, step, into, press)
            if why is None:
                break
        if why is None:
            steps.append(step)
        else:
            stuck[step.block] = why
        standing = standing - {step.block} if step.remove else standing | {step.block}
        for k in step.group:
            world.beside[k] = step.to
            world.pose[k] = world.target(k)
        if step.group:
            world.beside[step.block] = step.to
        world.pose[step.block] = world.target(step.block)
        world.state[step.block] = RETURNED if step.remove else STANDING
    return steps, stuck


def back(job: Job) -> Arm:
    """The arm with a home that leaves the site to the other one: above its own edge of it."""
    way = middle_of(job.pieces) - job.base
    x, y = (way / max(float(np.linalg.norm(way)), 1e-9)).tolist()
    places = itertools.product(HOMES, (0.25, 0.15))
    return with_home(job.arm, (x, y), max(piece.top for piece in job.pieces), places)


def shared_out(
    job: Job, structure: Structure, steps: Sequence[StepOf], others: Set[StepOf], number: int
) -> tuple[StepOf, ...]:
    """The steps as an arm prefers them: level by level, what the other arm cannot do before the
    rest, so that neither has much left when the other one is done; and from its end of the
    structure, so that the other arm, which begins at the other end, is far away. What is built
    beside comes first on its own side, and last nearer to the other arm. What stood before goes
    first, from above. As they are where blocks lean or props are taken away.

    Args:
        others: what the other arm can do.
    """
    if structure.leans or any(s.remove and s.block not in job.standing for s in steps):
        return tuple(steps)
    where = np.array([piece.target for piece in job.pieces])
    along, middle = from_end_to_end(job), middle_of(job.pieces)
    way = -1.0 if number else 1.0

    def beside(step: StepOf) -> float:
        """1 for what is built beside, or taken from there, nearer to the other arm, -1 where that
        is nearer to this one; 0 for everything else."""
        spot = step.whence if step.group else step.beside
        if spot is None:
            return 0.0
        there = where[step.block, :2] + spot[:2] - middle
        return 1.0 if there @ (job.base - middle) < 0 else -1.0

    def key(step: StepOf) -> tuple[bool, float, float, bool, float]:
        level = round(float(job.pieces[step.block].extent[0][2]), 4)
        end = round(way * float(where[step.block, :2] @ along), 6)
        return not step.remove, beside(step), -level if step.remove else level, step in others, end

    return tuple(sorted(steps, key=key))


def bricks_by_team(
    assembly: Assembly,
    members: Sequence[Member],
    workcell: Workcell,
    progress: Progress = lambda text: None,
) -> tuple[Plan, tuple[StepOf, ...]]:
    """The plan of bricks for two arms, and its steps with what is built beside; nothing is carried
    out.

    Args:
        assembly: bricks on a lattice of studs whose joints clutch; steps are not looked at.
        members: the arms, of :func:`~.members.set_up_team`.
        workcell: how they build.

    Raises:
        InputError: for blocks that are no bricks on one lattice.
    """
    plan = replace(plan_for_arm(assembly), arms=told_of(members))
    if not plan.complete or plan.assembly is None:
        return plan, ()
    jobs, order = _arranged(plan, members, workcell, progress)
    if not order.stuck:
        return plan_in_order(plan, order.steps), order.steps
    number, why = next(iter(order.stuck.items()))
    blocks = [jobs[0].pieces[k].id for k in order.stuck]
    reason = f"{jobs[0].pieces[number].id}: {why}"
    advice = _with_another_tool(plan, members, workcell, progress) or with_hands(assembly)
    reason = f"neither arm can place {listed(blocks)}: {reason}"
    return none_placed(plan, f"{reason}; {advice}" if advice else reason), ()


def shared_by_team(
    plan: Plan, members: Sequence[Member], workcell: Workcell, order: Sequence[StepOf]
) -> Plan:
    """The plan of bricks with who brings which, in turns where both can, and with what shows that
    it stands; nothing is carried out.

    Args:
        plan: complete.
        members: the arms, of :func:`~.members.set_up_team`.
        workcell: how they build.
        order: as :func:`bricks_by_team` has found it.

    Raises:
        InputError: for a brick that neither can bring.
    """
    pair = gather(plan, members, workcell, 0.0, order)
    can = [{step.block for step in one.order.steps if not step.group} for one in pair.found]
    made, standing, turn = list[Step](), set[int](), 0
    for step in plan.steps:
        standing.add(step.block)
        who = turn if step.block in can[turn] else 1 - turn
        shown = pair.found[0].structure.proof(frozenset(standing))
        proven = step if shown is None else step.with_proof(*shown)
        made.append(replace(proven, arm=pair.names[who]))
        turn = 1 - who
    return replace(plan, steps=tuple(made))


def _arranged(
    plan: Plan, members: Sequence[Member], workcell: Workcell, progress: Progress
) -> tuple[tuple[Job, Job], Arranged]:
    """What arms have to do, and the order in which they press bricks together."""
    jobs = jobs_of(plan, members, workcell, 0.0)
    hands = [Hands(job, KinematicCell(job.arm)) for job in jobs]
    return jobs, arrange_bricks(hands, BrickStructure(jobs[0]), progress)


def _with_another_tool(
    plan: Plan, members: Sequence[Member], workcell: Workcell, progress: Progress
) -> str:
    """With which other tool arms press all bricks together, in one clause; empty where that is not
    found."""
    assembly = plan.assembly
    assert assembly is not None
    for tool in with_other_tools(members[0].job.arm, assembly.joint.studs):
        progress(f"trying whether the arms do it with the tool {tool}")
        with suppress(InputError):  # An arm has none, or there is no room for magazines.
            arms = [site_arm_of(member)._replace(tool=tool) for member in members]
            others = set_up_team(assembly, arms, workcell.site)
            if not _arranged(plan, others, workcell, silent)[1].stuck:
                return f"with `tool={tool}` there is an order in which the arms do every step"
    return ""
