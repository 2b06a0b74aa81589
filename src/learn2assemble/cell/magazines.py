"""Where magazines go for what a layout gives no source for."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from learn2assemble.cell.arrange import try_step
from learn2assemble.cell.pieces import QUARTER, Pose, Turn, middle_of, turn_key
from learn2assemble.cell.site import Site, Source, outline, rests_of, table_of
from learn2assemble.cell.workcell import Job, Progress, StepOf
from learn2assemble.cell.world import (
    LOOSE,
    RETURNED,
    STANDING,
    Rows,
    WorkcellBlocks,
    moves,
    rows_of,
)
from learn2assemble.errors import InputError
from learn2assemble.kinematics.cell import KinematicCell
from learn2assemble.progress import Detail, counted, silent
from learn2assemble.robot.bodies import Shape
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.moves import Move, Scene, turned, turns

FARTHEST = 0.85
"""Of a magazine from the base [m]."""
FOLDED = 0.35
"""Nearer to the base an arm has to fold so far that there is no steady way down [m]."""
CLEAR, APART = 0.06, 0.01
"""Between magazines and the structure, and between two of them [m]."""
OWN_SIDE, BEYOND = 0.1, 4.0
"""Of two arms, each has its magazines so far on its own side of the middle [m], or pays for what
is missing of it so many times."""
HAND_CLEAR, HAND_SIDE = 0.14, 0.25
"""Between magazines and the structure, and on its own side of the middle, where bricks are held by
fingers this way and that, whose hand is wide [m]."""
ASIDE = 1.0
"""Of two arms that build bricks, each pays so many times for what a magazine is to the right of the
middle: with all of its magazines to its left no way between two of them leads past what is built,
and the other arm, which faces it, comes from the opposite corner."""
OVERHEAD = 0.5
"""Blocks may wait below obstacles that begin above this [m]."""
GRID, MOST_TRIED = 0.04, 150
"""Between places that are tried for a magazine [m], and how many are."""
MOST_WAYS = 12
"""Moves with which a magazine is tried."""


def removals(job: Job, shape: Shape | None = None) -> Iterator[tuple[WorkcellBlocks, StepOf]]:
    """Worlds in which a block, perhaps one of a shape, is to be taken away, everything else as the
    plan has it then."""
    world = WorkcellBlocks(replace(job, sources=tuple(s for s in job.sources if s.magazine)))
    for step in job.steps:
        k = step.block
        if step.remove and shape in (None, job.pieces[k].shape):
            yield world, step
        world.pose[k] = world.target(k)
        world.state[k] = RETURNED if step.remove else STANDING


def takes_away(job: Job) -> bool:
    """Whether the arm can take hold of every block that is to be taken away, and come out with it;
    true of a tool that only comes from above, for which other bases change nothing."""
    if job.arm.suction is None or len(job.arm.suction.cups) == 1 or job.hands:
        return True
    cell = KinematicCell(job.arm)
    for world, step in removals(job):
        rows = rows_of(world, world.pose, step.block)
        ways = moves(world, rows, step.block, world.target(step.block))
        if not any(_picked(cell, rows.scene, move) for move in ways):
            return False
    return True


def gone(job: Job) -> list[int]:
    """The pieces that are taken away of what stands before the first step."""
    return [step.block for step in job.steps if step.remove and step.block in job.standing]


def supplied(
    job: Job,
    given: Sequence[Source],
    site: Site,
    others: Sequence[Any] = (),
    across: np.ndarray | None = None,
    progress: Progress = silent,
) -> Job:
    """The job with magazines for what the layout gives no source for.

    Args:
        others: shapely areas that are taken already.
        across: float64[2], the base of an arm that builds, too, from the other side [m]: each has
            its magazines on its own side, and none inside what is built, where it would bend over
            the other one's way, if there is room elsewhere.
        progress: told of the kinds of blocks that have a place.

    Raises:
        InputError: where there is no room.
    """
    import shapely

    needed = Counter(job.pieces[step.block].shape for step in job.steps if not step.remove)
    for step in job.steps:
        needed[job.pieces[step.block].shape] += 0  # What only goes has to go somewhere, too.
    # What a user has given too few of runs empty, and the build waits for more. Pallets and
    # positions take nothing back: what goes needs a magazine, which has no blocks but these.
    lying = {source.shape for source in given if not source.magazine}
    known = {source.shape for source in given} - {job.pieces[k].shape for k in gone(job)}
    known |= {source.shape for source in given if source.magazine}
    missing = [shape for shape, _ in needed.most_common() if shape not in known]
    finished = replace(job, sources=())
    cell = KinematicCell(job.arm)
    clear = HAND_CLEAR if job.assembly.holds else CLEAR
    structure = shapely.union_all([p.face() for p in job.pieces if not p.sunk])
    # Where it is best to look for places, and where there may be some yet.
    sides: list[tuple[Any, np.ndarray | None]] = [(structure.buffer(clear), None)]
    if across is not None:
        sides.insert(0, (structure.convex_hull.buffer(clear), across))
    taken = [*others, *(source.area.buffer(APART) for source in given)]
    taken += [outline(o).buffer(2 * APART) for o in job.obstacles if o.bottom < OVERHEAD]
    taken.append(shapely.Point(*job.base).buffer(0.16))
    table = table_of(site, job.pieces)
    made: list[Source] = []
    progress(Detail("looking for places where blocks wait"))
    for shape in counted(missing, "kinds of blocks with a place to wait", progress):
        found = (
            _magazine_places(
                finished, cell, shape, shapely.union_all([kept, *taken]), table, side, b
            )
            for kept, side in sides
            for b in (True, False)
        )
        place = next(itertools.chain.from_iterable(found), None)
        if place is None:
            of_shape = [piece for piece in job.pieces if piece.shape == shape]
            if job.hands and all(piece.prop for piece in of_shape):
                continue
            got = f"no room for a magazine of kind {of_shape[0].name} within reach"
            raise InputError("supply", got, "a layout with places for it (`layout=`)")
        count = 0 if shape in lying else None
        source = Source(shape, place, count, True, rests=rests_of(job.pieces, shape))
        made.append(source)
        taken.append(source.area.buffer(APART))
    return replace(job, sources=(*given, *made))


def _magazine_places(
    job: Job,
    cell: KinematicCell,
    shape: Shape,
    blocked: Any,
    table: Any,
    across: np.ndarray | None,
    back: bool,
) -> Iterator[Pose]:
    """Poses at which blocks of a shape can be taken with the finished structure there, however
    they wait, and if ``back`` those that are taken away from it can be put; those on the side of
    the arm first where another one's base is ``across``."""
    import shapely

    world = WorkcellBlocks(replace(job, sources=()))
    kept = {*job.there, *(s.block for s in job.steps)} - {s.block for s in job.steps if s.remove}
    for k in kept:
        world.pose[k], world.state[k] = world.target(k), STANDING
    rests = rests_of(job.pieces, shape)
    size = max(float(np.linalg.norm(p.half)) for p in job.pieces if p.shape == shape)
    top = max(float(p.target[2]) for p in job.pieces) + size
    scenes = [(yaw, _waiting(world, shape, rests, yaw, top)) for yaw in (0.0, QUARTER)]
    steps = np.arange(-25, 26) * GRID
    middle = middle_of(job.pieces)
    grid = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2) + middle
    away = np.linalg.norm(grid - job.base, axis=1)
    grid = grid[(away > FOLDED) & (away < FARTHEST)]
    # Near the structure, and rather between it and the arm than behind it.
    cost = np.linalg.norm(grid - middle, axis=1) + 0.3 * np.linalg.norm(grid - job.base, axis=1)
    if across is not None:
        way = (across - job.base) / max(float(np.linalg.norm(across - job.base)), 1e-9)
        own = HAND_SIDE if job.assembly.holds else OWN_SIDE
        cost += BEYOND * np.maximum((grid - (job.base + across) / 2) @ way + own, 0.0)
        if job.assembly.holds:
            cost += ASIDE * np.maximum((grid - middle) @ np.array([way[1], -way[0]]), 0.0)
    mine = slice(-len(shape), None)
    tried = 0
    for x, y in grid[np.argsort(cost, kind="stable")].tolist():
        for yaw, waiting in scenes:
            pose = Pose(round(x, 4), round(y, 4), yaw)
            source = Source(shape, pose, None, True, rests=rests)
            face = source.area
            if not shapely.contains(table, face) or shapely.intersects(face, blocked):
                continue
            fits = True
            for rows, ways in waiting:
                moved = rows.scene.position.copy()
                moved[mine, :2] += x, y
                scene = rows.scene._replace(position=moved)
                fits = fits and any(_picked(cell, scene, move) for move in ways)
            there = replace(job, sources=(source,))
            if fits and not (
                back and any(try_step(w, cell, step) for w, step in removals(there, shape))
            ):
                yield pose
            tried += 1
            if tried >= MOST_TRIED:
                return


def _waiting(
    world: WorkcellBlocks, shape: Shape, rests: Sequence[Turn], yaw: float, top: float
) -> list[tuple[Rows, list[Move]]]:
    """Scenes in which a block waits at the origin in each of the ways it may, and the moves with
    which it can be lifted above everything."""
    found = list[tuple[Rows, list[Move]]]()
    for rest in rests:
        number = next(
            k for k, p in enumerate(world.pieces) if p.shape == shape and turn_key(p.rest) == rest
        )
        moving, pose = world.add(number), world.pieces[number].waiting(Pose(0.0, 0.0, yaw))
        world.state[moving], world.pose[moving] = LOOSE, pose
        rows = rows_of(world, world.pose, moving)
        ways: dict[Attitude, Move] = {}
        for piece in world.job.pieces:
            if piece.shape == shape and turn_key(piece.rest) == rest:
                goal = np.array([0.0, 0.0, top, *piece.pose[3:]])
                for move in moves(world, rows, moving, goal):
                    ways.setdefault(move.grasp, move)
            if len(ways) >= MOST_WAYS:
                break
        found.append((rows, list(ways.values())))
        world.state[moving] = RETURNED
    return found


def _picked(cell: KinematicCell, scene: Scene, move: Move) -> bool:
    """Whether the first half of a move is possible, whichever way the hand is turned."""
    ways = (0.0, *turns(cell.arm, move))
    return any(cell.pick(scene, turned(scene, move, turn)).reached for turn in ways)
