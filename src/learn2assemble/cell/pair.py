"""What two arms begin with: the blocks that each can place, in an order in which they are seldom in
each other's way, and what of the other one each has to keep clear of.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence, Set
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from learn2assemble.cell.arrange import Arranged, Structure, try_step, where_pressed
from learn2assemble.cell.bricks import BrickStructure
from learn2assemble.cell.building import Prepared
from learn2assemble.cell.crew import Member
from learn2assemble.cell.pieces import with_rests
from learn2assemble.cell.reach import cells_of, with_home
from learn2assemble.cell.site import Obstacle
from learn2assemble.cell.workcell import ROOMS, Job, StepOf, Workcell, job_of
from learn2assemble.cell.world import RETURNED, STANDING, WorkcellBlocks
from learn2assemble.errors import InputError
from learn2assemble.planning.plan import Plan
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.kinematic import KinematicCell

BASE = (0.3, 0.3, 0.5)
"""Size of the box that the base of the other arm is for the ways of blocks [m]."""
BESIDE, HAND, LEVEL = 0.5, 0.1, 1e-3
"""No lower block comes down beside a higher one at less than this share of the difference in
height, as far as a hand reaches [m]; what ends so little above the bottom of another is lower [m].
"""
FINGERS = 0.03
"""Bricks that are nearer to each other come one after the other as was found: fingers are as thick,
and open as far [m]."""
HOMES = (0.25, 0.3, 0.35)
"""So far in front of its base the tool waits, the preferred one first [m]."""


Waits = dict[StepOf, set[StepOf]]
"""By step, those that come before it."""


class Pair(NamedTuple):
    """What two arms begin with."""

    found: tuple[Prepared, Prepared]
    workcells: tuple[Workcell, Workcell]
    """Of each; all that belongs to the cell is that of the first one."""
    names: tuple[str, str]


def gather(
    plan: Plan,
    members: Sequence[Member],
    workcell: Workcell,
    joint: float = 1e-4,
    order: Sequence[StepOf] | None = None,
) -> Pair:
    """Two arms with magazines of their own, and for each the steps that it could do.

    Args:
        plan: complete.
        members: the arms, see :func:`~.team.set_up_team`.
        workcell: how they build; which arm and tool, and what its base is, does not matter.
        joint: width of a vertical joint [m].
        order: of bricks that clutch, as :func:`~.brick_team.bricks_by_team` has found it.

    Raises:
        InputError: for a block that neither can place when its turn in the plan has come.
    """
    first, second = jobs_of(plan, members, workcell, joint)
    if order is not None:
        first, second = (replace(job, steps=tuple(order)) for job in (first, second))
    structure = BrickStructure(first) if first.assembly.holds else Structure(first)
    jobs = [first, second]
    kinematic = [KinematicCell(job.arm, cells_of(job)) for job in jobs]
    can = [possible(job, structure, cell) for job, cell in zip(jobs, kinematic, strict=True)]
    found, cells = list[Prepared](), list[Workcell]()
    for number, (job, cell) in enumerate(zip(jobs, kinematic, strict=True)):
        (steps, stuck), (others, _) = can[number], can[1 - number]
        order = shared_out(job, structure, steps, set(others), number)
        found.append(Prepared(job, structure, Arranged(order, stuck), cell))
        cells.append(workcell_of(workcell, job))
    reached = {step for one in found for step in one.order.steps}
    left = [step for step in first.steps if step not in reached]
    if left:
        piece = first.pieces[left[0].block]
        why = found[0].order.stuck[left[0].block]
        raise InputError("arms", f"{piece.id}, which neither can place: {why}", "all within reach")
    one, other = (member.name for member in members)
    return Pair((found[0], found[1]), (cells[0], cells[1]), (one, other))


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
    if alike.standing:
        raise InputError("design", "blocks that stand before the first step", "none, for two arms")
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
    jobs = [replace(job, arm=back(job)) for job in jobs]
    first, second = (
        replace(job, obstacles=(*job.obstacles, *occupied(other)))
        for job, other in zip(jobs, reversed(jobs), strict=True)
    )
    return first, second


def possible(
    job: Job, structure: Structure, cell: KinematicCell
) -> tuple[list[StepOf], dict[int, str]]:
    """The steps of a plan that an arm could do, each when its turn has come; by block, why it could
    not do the others."""
    world, standing = WorkcellBlocks(job), set[int]()
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
            world.beside[k] = 0.0
            world.pose[k] = world.target(k)
        if step.group:
            world.beside[step.block] = 0.0
        world.pose[step.block] = world.target(step.block)
        world.state[step.block] = RETURNED if step.remove else STANDING
    return steps, stuck


def put_beside(world: WorkcellBlocks, steps: Sequence[StepOf]) -> None:
    """Blocks are to be built beside, where steps say so."""
    for step in steps:
        if step.beside is not None:
            world.beside[step.block] = step.beside


def back(job: Job) -> Arm:
    """The arm with a home that leaves the site to the other one: above its own edge of it."""
    x, y = (-job.base / max(float(np.linalg.norm(job.base)), 1e-9)).tolist()
    places = itertools.product(HOMES, (0.25, 0.15))
    return with_home(job.arm, (x, y), max(piece.top for piece in job.pieces), places)


def occupied(job: Job) -> list[Obstacle]:
    """What the other arm must not touch of one: where it stands, and where its blocks wait."""
    x, y = job.base.tolist()
    found = [Obstacle((x, y), BASE, float(job.arm.base_yaw), 0.0, "the other arm", True)]
    for source in job.sources:
        a, b, c, d = source.area.bounds
        tall = max(
            float(piece.corners(piece.waiting(source.pose))[:, 2].max())
            for piece in job.pieces
            if source.presents(piece)
        )
        size = (c - a, d - b, tall)
        middle = (a + c) / 2, (b + d) / 2
        found.append(Obstacle(middle, size, 0.0, 0.0, "the other arm's supply", True))
    return found


def shared_out(
    job: Job, structure: Structure, steps: Sequence[StepOf], others: Set[StepOf], number: int
) -> tuple[StepOf, ...]:
    """The steps as an arm prefers them: level by level, what the other arm cannot do before the
    rest, so that neither has much left when the other one is done; and from its end of the
    structure, so that the other arm, which begins at the other end, is far away. As they are where
    blocks lean or are taken away.

    Args:
        others: what the other arm can do.
    """
    if structure.leans or any(step.remove for step in steps):
        return tuple(steps)
    where = np.array([piece.target for piece in job.pieces])
    # Across the line between the arms they are in each other's way least.
    along = np.array([-job.base[1], job.base[0]])
    along = along / max(float(np.linalg.norm(along)), 1e-9)
    if along[np.argmax(np.abs(along))] < 0:
        along = -along
    way = -1.0 if number else 1.0

    def key(step: StepOf) -> tuple[float, bool, float]:
        level = round(float(job.pieces[step.block].extent[0][2]), 4)
        return level, step in others, round(way * float(where[step.block, :2] @ along), 6)

    return tuple(sorted(steps, key=key))


def steps_before(job: Job, structure: Structure, steps: Sequence[StepOf]) -> Waits:
    """By step, those that come before it, whoever does them, as a hand could not reach past what
    they leave. Blocks that lean are placed as they are planned.

    Args:
        job: with all steps, of bricks that clutch in the order that was found.
        steps: those that are asked about.
    """
    if structure.leans:
        return {}
    if structure.studs() is not None:
        return _as_found(job)
    lower = lower_beside(job)
    return {
        step: {one for one in steps if one.block in lower[step.block]}
        for step in steps
        if not step.remove and step.block in lower
    }


def _as_found(job: Job) -> Waits:
    """By step, the earlier ones that are near: where bricks are held by fingers between others,
    and how far what stands bears a press, hangs on what is there already. Of what is built beside
    one part comes after the other, as their places on the table may be the same."""
    world = WorkcellBlocks(job)
    put_beside(world, job.steps)
    bounds = list[tuple[np.ndarray, np.ndarray]]()
    for step in job.steps:
        taken = [step.block, *step.group]
        shift = np.zeros((len(taken), 1, 3)) if step.group else world.beside[taken][:, None]
        ends = np.array([job.pieces[k].extent for k in taken]) + shift
        bounds.append((ends[:, 0], ends[:, 1]))
    found: Waits = {}
    for n, (step, (low, high)) in enumerate(zip(job.steps, bounds, strict=True)):
        for one, (under, over) in zip(job.steps[:n], bounds[:n], strict=True):
            gap = np.maximum(low[:, None] - over[None], under[None] - high[:, None])[..., :2].max(2)
            rise = np.minimum(BESIDE * (high[:, None, 2] - over[None, :, 2]), HAND)
            if (gap < np.maximum(rise, FINGERS)).any() or (_apart(step) and _apart(one)):
                found.setdefault(step, set()).add(one)
    return found


def _apart(step: StepOf) -> bool:
    """Whether a step is of a part that is built beside."""
    return step.beside is not None or bool(step.group)


def lower_beside(job: Job) -> dict[int, set[int]]:
    """By piece, the lower ones so near beside it that hand and arm could not bring them past it.

    An arm alone builds level by level; one that finds the other one in its way there would go on
    higher up, and around gaps that nobody can fill any more.
    """
    ends = np.array([piece.extent for piece in job.pieces])
    low, high = ends[:, 0], ends[:, 1]
    apart = np.maximum(low[:, None, :2] - high[None, :, :2], low[None, :, :2] - high[:, None, :2])
    higher = np.minimum(BESIDE * (high[:, None, 2] - high[None, :, 2]), HAND)
    lower = high[None, :, 2] <= low[:, None, 2] + LEVEL
    found = lower & (apart < higher[:, :, None]).all(2)
    return {k: set(np.flatnonzero(row).tolist()) for k, row in enumerate(found) if row.any()}
