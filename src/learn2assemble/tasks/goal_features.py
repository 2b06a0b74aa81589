"""What an environment of goals shows of a state: a row of numbers for every legal candidate, and a
summary of the whole."""

from __future__ import annotations

import numpy as np

from learn2assemble.kernels import kernel
from learn2assemble.planning.goals.world import GoalProblem, Relaxed, unmet
from learn2assemble.planning.tiling.world import LatticeWorld

NUM_FEATURES, NUM_SUMMARY = 22, 9
_FAR = 8.0
"""Lengths are in so many cells, counts of blocks in as many blocks."""


def describe(
    problem: GoalProblem,
    world: LatticeWorld,
    relaxed: Relaxed,
    children: np.ndarray,
    ballast: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Features of candidates, float32[m, NUM_FEATURES], and of the state, float32[NUM_SUMMARY].

    Args:
        relaxed: the relaxed plan of the state.
        children: int64[m], legal candidates.
        ballast: float64[m]: how well each lies where weight is asked for.
    """
    site, found, shape = problem.site, problem.site.found, problem.goals.shape
    extent = found.extents[found.way[children]]
    origin, size = found.origin[children], found.size()[children]
    part = found.take(children)
    row = np.repeat(np.arange(len(children)), size)
    planned = np.zeros(site.wanted.size, bool)
    used = np.flatnonzero(relaxed.used)
    planned[found.take(used).cell] = True
    above = np.append(planned[1:], False)
    above[shape[2] - 1 :: shape[2]] = False
    goals = unmet(problem, world)
    wanted = np.zeros(site.wanted.size, bool)
    wanted[goals] = True
    column = wanted.reshape(shape).any(2).repeat(shape[2])

    def share(mask: np.ndarray) -> np.ndarray:
        return np.bincount(row, mask[part.cell], len(children)) / size

    centre = problem.centre[children]
    at = np.stack(np.unravel_index(goals, shape), -1) if len(goals) else np.zeros((1, 3), int)
    away = np.abs(centre[:, None] - at[None, :, :2] - 0.5).sum(-1)
    nearest = away.argmin(1)
    carried = (site.rests[children] - world.waits[children]) / np.diff(problem.bed_start)[children]
    carried[origin[:, 2] == 0] = 1.0
    lean, lever = _levers(problem, world, children, centre)
    kinds = site.kind[children]
    heap = world.heap[kinds].astype(float)
    needed = np.bincount(site.kind[used], minlength=len(world.heap))[kinds]
    limited = heap >= 0
    rows = [
        relaxed.used[children],
        np.minimum(relaxed.cost[children] - 1, 20) / _FAR,
        size / _FAR,
        extent[:, :2].max(1) / _FAR,
        extent[:, :2].min(1) / _FAR,
        origin[:, 2] / _FAR,
        share(wanted) * size / 4,
        carried,
        away.min(1) / _FAR,
        (at[nearest, 2] - origin[:, 2]) / _FAR,
        share(column),
        share(planned),
        share(above),
        lean,
        lever,
        np.where(limited, np.minimum(heap, 10) / 10, 1.0),
        limited,
        np.where(limited, np.minimum(needed / np.maximum(heap, 1), 4), 0.0),
        ballast,
        ballast > 0,
        ballast >= ballast.max() if len(ballast) else ballast,
        np.clip(relaxed.detour[children], 0, 6) / 3,
    ]
    state = [
        relaxed.blocks / _FAR,
        len(goals) / _FAR,
        len(world.placed) / _FAR,
        not len(goals),
        (ballast > 0).any(),
        len(children) / 200,
        (world.heap >= 0).mean(),
        min(shape[:2]) > 1,
        sum(load.mass for load in problem.goals.loads)
        / max(world.proof.stack.weight.sum(), 0.1)
        / 4,
    ]
    return (
        np.stack(rows, 1).astype(np.float32),
        np.minimum(np.array(state), 10).astype(np.float32),
    )


def _levers(
    problem: GoalProblem, world: LatticeWorld, children: np.ndarray, centre: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """How far the block below each candidate leans (0 to 1, from the middle of its support to its
    edge), and how far out on that side the candidate would lie [cells / 8], negative behind."""
    stack, force = world.proof.stack, world.proof.force
    lean, lever = np.zeros(len(children)), np.zeros(len(children))
    if not len(stack):
        return lean, lever
    count = np.maximum(np.bincount(stack.upper, minlength=len(stack)), 1)
    total = np.maximum(np.bincount(stack.upper, force, len(stack)), 1e-12)
    middle, press, half = (np.zeros((len(stack), 2)) for _ in range(3))
    for axis in range(2):
        place = stack.point[:, axis] / problem.goals.kit.pitch[axis] + problem.goals.shape[axis] / 2
        middle[:, axis] = np.bincount(stack.upper, place, len(stack)) / count
        press[:, axis] = np.bincount(stack.upper, place * force, len(stack)) / total
        np.maximum.at(half[:, axis], stack.upper, np.abs(place - middle[stack.upper, axis]))
    tip = press - middle
    length = np.linalg.norm(tip, axis=1)
    relative = (np.abs(tip) / np.maximum(half, 0.25)).max(1)
    _lean(
        children,
        problem.bed_start,
        problem.bed,
        world.owner,
        problem.goals.shape[2],
        (relative, length, middle, tip),
        centre,
        (lean, lever),
    )
    return lean, lever


@kernel
def _lean(
    children: np.ndarray,
    bed_start: np.ndarray,
    bed: np.ndarray,
    owner: np.ndarray,
    levels: int,
    blocks: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    centre: np.ndarray,
    out: tuple[np.ndarray, np.ndarray],
) -> None:
    relative, length, middle, tip = blocks
    lean, lever = out
    for n in range(len(children)):
        base = -1
        for j in range(bed_start[children[n]], bed_start[children[n] + 1]):
            below = owner[bed[j] - 1] if bed[j] % levels > 0 else -1
            if below < 0:
                continue
            # Of several that lean as much, the first one placed.
            more = base < 0 or relative[below] > relative[base]
            if more or (relative[below] == relative[base] and below < base):
                base = below
        if base < 0:
            continue
        lean[n] = min(relative[base], 1.0)
        if length[base] > 1e-6:
            out_x, out_y = centre[n, 0] - middle[base, 0], centre[n, 1] - middle[base, 1]
            along = out_x * tip[base, 0] + out_y * tip[base, 1]
            lever[n] = along / length[base] / _FAR
