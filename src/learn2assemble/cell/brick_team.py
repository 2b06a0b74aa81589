"""The order in which two arms press bricks home: every step is one that one of them can do, and
what stands bears it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.cell.bricks import BrickStructure
from learn2assemble.cell.crew import Member
from learn2assemble.cell.pair import jobs_of
from learn2assemble.cell.reach import cells_of
from learn2assemble.cell.taking_apart import Hands, arrange_bricks, plan_in_order
from learn2assemble.cell.team import told_of
from learn2assemble.cell.workcell import Progress, StepOf, Workcell
from learn2assemble.planning.brick_plan import plan_for_arm, with_hands
from learn2assemble.planning.plan import Plan
from learn2assemble.robot.kinematic import KinematicCell


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
        members: the arms, of :func:`~.team.set_up_team`.
        workcell: how they build.

    Raises:
        InputError: for blocks that are no bricks on one lattice.
    """
    plan = replace(plan_for_arm(assembly), arms=told_of(members))
    if not plan.complete or plan.assembly is None:
        return plan, ()
    jobs = jobs_of(plan, members, workcell, 0.0)
    hands = [Hands(job, KinematicCell(job.arm, cells_of(job))) for job in jobs]
    order = arrange_bricks(hands, BrickStructure(jobs[0]), progress)
    if not order.stuck:
        return plan_in_order(plan, order.steps), order.steps
    number, why = next(iter(order.stuck.items()))
    blocks = [jobs[0].pieces[k].id for k in order.stuck]
    listed = ", ".join(blocks[:3]) + (f" and {len(blocks) - 3} more" if blocks[3:] else "")
    reason, advice = f"{jobs[0].pieces[number].id}: {why}", with_hands(assembly)
    refused = replace(
        plan,
        status="refused",
        reason=f"neither arm can place {listed}: {reason}" + (f"; {advice}" if advice else ""),
        steps=(),
        coverage=0.0,
        blocks=replace(plan.blocks, used=0),
        assembly=replace(plan.assembly, steps=(), not_built=()),
    )
    return refused, ()
