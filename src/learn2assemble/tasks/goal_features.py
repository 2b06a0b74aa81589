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
    goals, stack = unmet(problem, world), world.proof.stack
    loads, (dx, dy, _) = problem.goals.loads, problem.goals.kit.pitch
    rows = _rows(
        children,
        ballast,
        (shape[0], shape[1], shape[2]),
        (site.kind, found.start, found.cell, found.origin, found.way, found.extents),
        (problem.centre, problem.bed_start, problem.bed),
        (relaxed.used, relaxed.cost, relaxed.detour),
        (site.rests, world.waits, world.heap, world.owner),
        goals,
        _levers(
            stack.point,
            stack.upper,
            world.proof.force,
            len(stack),
            (shape[0], shape[1]),
            (float(dx), float(dy)),
        ),
    )
    state = [
        relaxed.blocks / _FAR,
        len(goals) / _FAR,
        len(world.placed) / _FAR,
        not len(goals),
        (ballast > 0).any(),
        len(children) / 200,
        (world.heap >= 0).mean(),
        min(shape[:2]) > 1,
        sum(load.mass for load in loads) / max(stack.weight.sum(), 0.1) / 4,
    ]
    return rows, np.minimum(np.array(state), 10).astype(np.float32)


@kernel
def _rows(
    children: np.ndarray,
    ballast: np.ndarray,
    shape: tuple[int, int, int],
    place: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    beds: tuple[np.ndarray, np.ndarray, np.ndarray],
    relaxed: tuple[np.ndarray, np.ndarray, np.ndarray],
    state: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    goals: np.ndarray,
    blocks: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
) -> np.ndarray:
    """float32[m, NUM_FEATURES]; the arguments are what :func:`describe` knows, in its words."""
    kind, start, cell, origin, way, extents = place
    centre, bed_start, bed = beds
    used, cost, detour = relaxed
    rests, waits, heap, owner = state
    size_y, size_z = shape[1], shape[2]
    cells = shape[0] * size_y * size_z
    planned, wanted = np.zeros(cells, np.bool_), np.zeros(cells, np.bool_)
    column = np.zeros(shape[0] * size_y, np.bool_)
    needed = np.zeros(len(heap), np.int64)
    for k in range(len(used)):
        if used[k]:
            needed[kind[k]] += 1
            for j in range(start[k], start[k + 1]):
                planned[cell[j]] = True
    # Without a goal that is missing, distances are those from the corner.
    at = np.zeros((max(len(goals), 1), 3), np.int64)
    for i, c in enumerate(goals):
        wanted[c] = column[c // size_z] = True
        at[i, 0], at[i, 1], at[i, 2] = c // size_z // size_y, c // size_z % size_y, c % size_z
    most = ballast.max() if len(ballast) else 0.0
    rows = np.empty((len(children), NUM_FEATURES), np.float32)
    for n, k in enumerate(children):
        row, size, x, y = rows[n], start[k + 1] - start[k], centre[k, 0], centre[k, 1]
        fills = columns = plans = above = 0
        for j in range(start[k], start[k + 1]):
            c = cell[j]
            fills += wanted[c]
            columns += column[c // size_z]
            plans += planned[c]
            above += c % size_z < size_z - 1 and planned[c + 1]
        nearest, away = 0, np.inf
        for i in range(len(at)):
            far = abs(x - at[i, 0] - 0.5) + abs(y - at[i, 1] - 0.5)
            if far < away:
                nearest, away = i, far
        level = origin[k, 2]
        carried = (rests[k] - waits[k]) / (bed_start[k + 1] - bed_start[k])
        wide, deep = extents[way[k], 0], extents[way[k], 1]
        left = heap[kind[k]]
        row[0] = used[k]
        row[1] = min(cost[k] - 1, 20.0) / _FAR
        row[2] = size / _FAR
        row[3], row[4] = max(wide, deep) / _FAR, min(wide, deep) / _FAR
        row[5] = level / _FAR
        row[6] = fills / size * size / 4
        row[7] = 1.0 if level == 0 else carried
        row[8] = away / _FAR
        row[9] = (at[nearest, 2] - level) / _FAR
        row[10], row[11], row[12] = columns / size, plans / size, above / size
        below = bed[bed_start[k] : bed_start[k + 1]]
        row[13], row[14] = _lean(below, owner, size_z, blocks, x, y)
        row[15] = min(left, 10) / 10 if left >= 0 else 1.0
        row[16] = left >= 0
        row[17] = min(needed[kind[k]] / max(left, 1), 4.0) if left >= 0 else 0.0
        row[18], row[19], row[20] = ballast[n], ballast[n] > 0, ballast[n] >= most
        row[21] = min(max(detour[k], 0.0), 6.0) / 3
    return rows


@kernel
def _levers(
    point: np.ndarray,
    upper: np.ndarray,
    force: np.ndarray,
    count: int,
    shape: tuple[int, int],
    pitch: tuple[float, float],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of every block: how far it leans as a share of the way to the edge of its support, how far in
    cells, the middle of its support (float64[n, 2]), and where to (float64[n, 2])."""
    corners, total = np.zeros(count), np.zeros(count)
    middle, press, half = np.zeros((count, 2)), np.zeros((count, 2)), np.zeros((count, 2))
    for p, b in enumerate(upper):
        corners[b] += 1.0
        total[b] += force[p]
        for axis in range(2):
            place = point[p, axis] / pitch[axis] + shape[axis] / 2
            middle[b, axis] += place
            press[b, axis] += place * force[p]
    for b in range(count):
        for axis in range(2):
            middle[b, axis] /= max(corners[b], 1.0)
            press[b, axis] /= max(total[b], 1e-12)
    for p, b in enumerate(upper):
        for axis in range(2):
            place = point[p, axis] / pitch[axis] + shape[axis] / 2
            half[b, axis] = max(half[b, axis], abs(place - middle[b, axis]))
    tip = press - middle
    relative, length = np.zeros(count), np.zeros(count)
    for b in range(count):
        length[b] = np.sqrt(tip[b, 0] * tip[b, 0] + tip[b, 1] * tip[b, 1])
        for axis in range(2):
            relative[b] = max(relative[b], abs(tip[b, axis]) / max(half[b, axis], 0.25))
    return relative, length, middle, tip


@kernel
def _lean(
    beds: np.ndarray,
    owner: np.ndarray,
    levels: int,
    blocks: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    x: float,
    y: float,
) -> tuple[float, float]:
    """How far the block below a candidate leans (0 to 1, from the middle of its support to its
    edge), and how far out on that side the candidate would lie [cells / 8], negative behind.

    Args:
        beds: int64[k]: lowest cells of the candidate.
        blocks: see :func:`_levers`.
        x, y: centroid of the candidate [cells].
    """
    relative, length, middle, tip = blocks
    base = -1
    for c in beds:
        below = owner[c - 1] if c % levels > 0 else -1
        if below < 0:
            continue
        # Of several that lean as much, the first one placed.
        more = base < 0 or relative[below] > relative[base]
        if more or (relative[below] == relative[base] and below < base):
            base = below
    if base < 0:
        return 0.0, 0.0
    lever = 0.0
    if length[base] > 1e-6:
        along = (x - middle[base, 0]) * tip[base, 0] + (y - middle[base, 1]) * tip[base, 1]
        lever = along / length[base] / _FAR
    return min(relative[base], 1.0), lever
