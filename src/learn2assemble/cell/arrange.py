"""The order in which arms build: what stands at every step, what their tools reach, and which steps
keep their order whoever does them.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.cell.pieces import middle_of
from learn2assemble.cell.structure import Structure
from learn2assemble.cell.workcell import DOWN, Direction, Job, Offset, Progress, StepOf
from learn2assemble.cell.world import (
    RETURNED,
    STANDING,
    WorkcellBlocks,
    moves,
    named,
    rows_of,
    supply_of,
)
from learn2assemble.kinematics.cell import KinematicCell
from learn2assemble.progress import Counting
from learn2assemble.robot.moves import Attempt

BESIDE, HAND, LEVEL = 0.5, 0.1, 1e-3
"""No lower block comes down beside a higher one at less than this share of the difference in
height, as far as a hand reaches [m]; what ends so little above the bottom of another is lower [m].
"""
FINGERS = 0.03
"""What fingers hold and is nearer to each other comes one after the other as was found: they are as
thick, and open as far [m]."""

Waits = dict[StepOf, set[StepOf]]
"""By step, those that come before it."""


class Hands(NamedTuple):
    """Who may bring blocks."""

    job: Job
    cell: KinematicCell


@dataclass(frozen=True)
class Arranged:
    """An order the arm can carry out, or why there is none."""

    steps: tuple[StepOf, ...]
    stuck: dict[int, str]
    """By piece, why it cannot be placed or taken away; empty where the order is complete."""
    by_hand: frozenset[StepOf] = frozenset()
    """Steps that the arm cannot do."""


def segments(steps: Sequence[StepOf]) -> list[list[StepOf]]:
    """The steps cut where a block is taken away: only steps of one part change places."""
    return [list(group) for _, group in itertools.groupby(steps, key=lambda step: step.remove)]


def priorities(job: Job, leans: bool) -> list[Callable[[int], tuple[float, ...]]]:
    """Which block comes first where several could; tried one after the other.

    Args:
        leans: the blocks lean on one another, and what stands is a matter of the whole order.
    """
    place = {step.block: n for n, step in enumerate(job.steps) if not step.remove}

    def level(k: int) -> float:
        return round(float(job.pieces[k].extent[0][2]), 4)

    def away(k: int) -> float:
        return round(float(np.linalg.norm(job.pieces[k].target[:2] - job.base)), 4)

    def as_planned(k: int) -> tuple[float, ...]:
        return (float(place[k]),)

    if leans:
        return [as_planned]
    return [
        lambda k: (level(k), -away(k)),
        lambda k: (level(k), float(place[k])),
        lambda k: (level(k), away(k)),
        as_planned,
    ]


def arrange(
    arms: Sequence[Hands], structure: Structure, progress: Progress = lambda text: None
) -> Arranged:
    """The first order in which one of the arms reaches everything; else the one that comes
    farthest.

    Args:
        arms: of one cell, who build the same pieces; the first one says what comes first where
            several blocks could.
        structure: of these.
    """
    job = arms[0].job
    best: Arranged | None = None
    for key in priorities(job, structure.leans):
        found = _arrange(arms, structure, key, progress)
        if best is None or len(found.steps) > len(best.steps):
            best = found
        if not found.stuck or job.arm.suction is not None:
            break
    assert best is not None
    return best


def _arrange(
    arms: Sequence[Hands],
    structure: Structure,
    key: Callable[[int], Any],
    progress: Progress,
) -> Arranged:
    job, worlds = arms[0].job, [WorkcellBlocks(one.job) for one in arms]
    standing = set(job.there)
    order: list[StepOf] = []
    by_hand: set[StepOf] = set()
    found = Counting("steps in an order that the arm can do", len(job.steps), progress)
    # Where a structure stands already, blocks come and go in any order that is proven, and what may
    # go does so first: the plan's order is one for hands that have room everywhere.
    for part in [[*job.steps]] if job.standing else segments(job.steps):
        left = [step for step in part if step.remove]
        left += sorted((s for s in part if not s.remove), key=lambda step: key(step.block))
        while left:
            stuck: dict[int, str] = {}
            for step in left:
                if not step.remove and not structure.below[step.block] <= standing:
                    continue
                # What is to go is not drawn out from below others, and what comes finds its place
                # free.
                held = structure.above if step.remove else structure.overlaps
                if job.standing and held[step.block] & standing:
                    stuck.setdefault(step.block, "others are in the way")
                    continue
                after = standing - {step.block} if step.remove else standing | {step.block}
                if not structure.stands(frozenset(after)):
                    stuck.setdefault(step.block, "it would fall")
                    continue
                why = _tried(arms, worlds, step, structure.ways_in(step.block, standing))
                if why is None:
                    break
                if job.hands and job.pieces[step.block].prop:
                    by_hand.add(step)
                    break
                stuck[step.block] = why
            else:
                missing = {s.block: "what it stands on is missing" for s in left if not s.remove}
                return Arranged(tuple(order), missing | stuck, frozenset(by_hand))
            left.remove(step)
            order.append(step)
            standing = after
            for world in worlds:
                world.pose[step.block] = world.target(step.block)
                world.state[step.block] = RETURNED if step.remove else STANDING
            found.add()
    return Arranged(tuple(order), {}, frozenset(by_hand))


def _tried(
    arms: Sequence[Hands],
    worlds: Sequence[WorkcellBlocks],
    step: StepOf,
    into: Sequence[Direction],
) -> str | None:
    """Why none of the arms can do a step, as the first one has it; None if one of them can."""
    reasons = list[str]()
    for one, world in zip(arms, worlds, strict=True):
        why = try_step(world, one.cell, step, into)
        if why is None:
            return None
        reasons.append(why)
    return reasons[0]


def try_step(
    world: WorkcellBlocks,
    cell: KinematicCell,
    step: StepOf,
    into: Sequence[Direction] = (DOWN,),
    press: tuple[float, float] | None = None,
) -> str | None:
    """Why the arm cannot do a step in a world where everything is as planned; None if it can.

    Args:
        into: unit vectors along which the block may come to its place.
        press: see :func:`moves`.
    """
    k = step.block
    before = world.pose[k].copy()
    try:
        why, supplied = "", False
        for at, goal in ends_of(world, step):
            supplied = True
            if at is not None:
                world.pose[k] = at
            rows = rows_of(world, world.pose, k, group=step.group)
            for move in moves(world, rows, k, goal, (DOWN,) if step.remove else into, press):
                found = cell.attempt(rows.scene, move)
                if found.reached:
                    return None
                why = why or named(describe(found), rows, world)
        return why or ("the tool cannot hold it" if supplied else "no supply")
    finally:
        world.pose[k] = before


def where_pressed(
    structure: Structure, world: WorkcellBlocks, step: StepOf, standing: Set[int]
) -> tuple[float, float] | None:
    """Where the block of a step is pressed home, x and y [m]; None: it is not.

    Args:
        standing: what is in its place by then, in the structure or beside.
    """
    there = np.array(step.to) if step.group else world.beside[step.block]
    near = {k for k in standing if (world.beside[k] == there).all()} - {step.block, *step.group}
    at = structure.press_at(step.block, step.group, near)
    if at is None:
        return None
    moved = world.pieces[step.block].pose[:2] + there[:2]
    place = moved if step.group else world.target(step.block)[:2]
    return float(place[0] + at[0]), float(place[1] + at[1])


def ends_of(world: WorkcellBlocks, step: StepOf) -> Iterator[tuple[np.ndarray | None, np.ndarray]]:
    """Where the block of a step may come from, None for where it stands, and where it goes."""
    k = step.block
    if step.group:
        yield None, world.pieces[k].pose + np.array([*step.to, 0.0, 0.0, 0.0, 0.0])
        return
    # An order is one of places: a magazine that is empty is filled by what goes, or by somebody.
    for source in supply_of(world, k) or world.magazines(k):
        at = world.presented(k, source)
        yield (None, at) if step.remove else (at, world.target(k))


def describe(found: Attempt) -> str:
    """Outcome, stage and reason of an attempt that failed, in words."""
    return f"{found.outcome.label} ({found.stage}): {found.detail}"


def from_end_to_end(job: Job) -> np.ndarray:
    """float64[2]: unit vector across the line between two arms, along which they are in each
    other's way least: from the end of the structure from which the first one builds to the other
    one; the same for both."""
    out = job.base - middle_of(job.pieces)
    along = np.array([-out[1], out[0]])
    along = along / max(float(np.linalg.norm(along)), 1e-9)
    return -along if along[np.argmax(np.abs(along))] < 0 else along


def put_beside(world: WorkcellBlocks, steps: Sequence[StepOf]) -> None:
    """Blocks are to be built beside, where steps say so."""
    for step in steps:
        if step.beside is not None and not step.group:
            world.beside[step.block] = step.beside


def steps_before(job: Job, structure: Structure, steps: Sequence[StepOf]) -> Waits:
    """By step, those that come before it, whoever does them, as a hand could not reach past what
    they leave. Blocks that lean are placed as they are planned.

    Args:
        job: with all steps, of bricks that clutch, and where a structure stands already, in the
            order that was found.
        steps: those that are asked about.
    """
    if job.standing or structure.studs() is not None:
        return _as_found(job)
    if structure.leans:
        return {}
    lower = lower_beside(job)
    return {
        step: {one for one in steps if one.block in lower[step.block]}
        for step in steps
        if not step.remove and step.block in lower
    }


def _as_found(job: Job) -> Waits:
    """By step, the earlier ones that are near: where bricks are held by fingers between others,
    and how far what stands bears a press, hangs on what is there already. What is taken away goes
    before lower blocks near it come or go. What is built beside comes as was found, part by part
    where these are built on one spot of the table."""
    world, beside = WorkcellBlocks(job), 0.0 if job.arm.suction else FINGERS
    put_beside(world, job.steps)
    parts, owner = list[np.ndarray](), list[int]()
    for number, step in enumerate(job.steps):
        for k in (step.block, *step.group):
            shift = np.array(step.to) if step.group else world.beside[k]
            parts.append(np.array(job.pieces[k].extent) + shift)
            owner.append(number)
    low, high = np.array(parts).reshape(-1, 2, 3).transpose(1, 0, 2)
    gap = np.maximum(low[:, None, :2] - high[None, :, :2], low[None, :, :2] - high[:, None, :2])
    rise = high[:, None, 2] - high[None, :, 2]
    gone = np.array([job.steps[number].remove for number in owner], bool)
    rise = np.where(gone[:, None] | gone, np.abs(rise), rise)
    near = gap.max(2) < np.maximum(np.minimum(BESIDE * rise, HAND), beside)
    near |= _on_one_spot(job)[np.ix_(owner, owner)]
    found: Waits = {}
    for one, other in np.argwhere(near).tolist():
        if owner[other] < owner[one]:
            found.setdefault(job.steps[owner[one]], set()).add(job.steps[owner[other]])
    return found


def _spots(step: StepOf) -> list[Offset]:
    """Where on the table a step builds beside, or takes what was built there, as how far that is
    from its place."""
    beside = [] if step.beside is None else [step.beside]
    return beside + [step.whence] * bool(step.group)


def _on_one_spot(job: Job) -> np.ndarray:
    """bool[s, s]: whether two steps are of parts that are built beside on one spot of the table, or
    on two that a hand does not fit between."""
    at = {spot: n for n, spot in enumerate({spot for step in job.steps for spot in _spots(step)})}
    lies = np.zeros((len(job.steps), len(at)), bool)
    low, high = np.full((len(at), 2), np.inf), np.full((len(at), 2), -np.inf)
    for number, step in enumerate(job.steps):
        for spot in _spots(step):
            lies[number, at[spot]] = True
            ends = np.array([job.pieces[k].extent for k in (step.block, *step.group)])[..., :2]
            low[at[spot]] = np.minimum(low[at[spot]], ends[:, 0].min(0) + spot[:2])
            high[at[spot]] = np.maximum(high[at[spot]], ends[:, 1].max(0) + spot[:2])
    near = (np.maximum(low[:, None] - high, low - high[:, None]) < HAND).all(2)
    return (lies.astype(int) @ near @ lies.T) > 0


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
