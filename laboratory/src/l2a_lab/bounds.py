r"""Upper bounds on the return of problems, for physics that moves no blocks.

**Towers**: cubes on one or two sides, discrete reward. A structure is the list of tower heights
:math:`h` (int64[n]) in the face planes. It grows by one block on a tower, or on the table beside
one. What it shows is a sum over towers and pairs of neighbours, because a ray meets the cubes of
two places of a side at most. With :math:`c(h)` the mask pixels shown, all heights are swept once
for

.. math::  V(h) = \max_n\ [c(h + e_n) > c(h)] + \gamma V(h + e_n),

and :math:`V = 0` where the episode has ended. On the lattice only a block in a face plane can raise
the plane cover (``test_exact.py`` tries all others). Delete the blocks outside the towers from any
sequence: every gain stays and comes no later, and success comes no earlier. What is lost is only
how a place was reached. A block outside touches one place at most, and two that touch each
other belong to the same or to neighbouring places, so a place none of whose neighbours stands takes
a detour of three blocks or more; it may be used for the price of three steps, paid once. Where
there are too many structures, :func:`tower_bound` takes the place of the sweep.

**Quick**: cubes on any number of sides, see :mod:`learn2assemble.tasks.evaluation.bounds`.

**Packing**: objects of several cells, scaled reward, see :mod:`l2a_lab.object_bounds`.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from l2a_lab.object_bounds import object_return_bound
from learn2assemble.constants import EDGE
from learn2assemble.errors import InputError
from learn2assemble.kernels import kernel
from learn2assemble.tasks.evaluation.bounds import (
    MAX_COLUMN,
    NUM_LEVELS,
    cell_pixels,
    return_bound,
)
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import Task
from learn2assemble.tasks.world.coverage import ROWS, WORDS
from learn2assemble.tasks.world.layouts import to_world
from learn2assemble.tasks.world.rules import DISCRETE, reward_and_success
from learn2assemble.tasks.world.state import State

MAX_STRUCTURES = 1_000_000
"""Structures swept at most: 8 bytes and about 0.7 us each, in up to three sweeps."""
DETOUR = 3
"""Blocks outside the face planes it takes at least to get around an empty place."""
ROUNDING = 1e-12
"""Returns that differ by less are equal."""


def has_bound(task: Task) -> bool:
    """Whether a bound is known: cubes with the discrete, anything with the scaled reward, where
    blocks touch."""
    return task.touching and (task.reward == "scaled" or task.objects == "cubes")


def best_returns(simulator: Simulator, count: int, rng: np.random.Generator) -> np.ndarray:
    """Upper bound on the return of each of ``count`` fresh problems, float64[count].

    Problems are those of the evaluation episodes of the same generator.
    """
    task, state = simulator.task, simulator.new(count, rng)
    if task.reward == "scaled":
        return np.array(
            [
                object_return_bound(
                    state,
                    row,
                    simulator.frames,
                    task.discount,
                    task.success_threshold,
                    task.rotations,
                )
                for row in range(count)
            ]
        )
    if task.num_sides <= 2:
        return np.array([best_return(simulator, state, row) for row in range(count)])
    return return_bound(state, task.discount)


@lru_cache(maxsize=1)
def tower_pixels() -> np.ndarray:
    """Pixels of a tower of ``h`` blocks in each column: ``uint64[2 MAX_COLUMN + 1, NUM_LEVELS + 1,
    ROWS, WORDS]``, read-only; ``h = 0`` is the empty set."""
    cells = cell_pixels()
    towers = np.zeros((len(cells), NUM_LEVELS + 1, ROWS, WORDS), np.uint64)
    towers[:, 1:] = np.bitwise_or.accumulate(cells, axis=1)
    towers.setflags(write=False)
    return towers


# ---------------------------------------------------------------- cubes


class Towers(NamedTuple):
    """``n`` places in the face planes; ``H`` is the greatest height looked at."""

    place: np.ndarray
    """int64[n, 2]: x, y [block edges, world], side by side, each from left to right as seen."""
    cap: np.ndarray
    """int64[n]: blocks above this show no open pixels, or there are not so many; at least 1, as any
    place may be passed."""
    low: np.ndarray
    """int64[n]: height at the start, 1 for the first block's tower, else 0."""
    beside: np.ndarray
    """int64[n, 3]: neighbouring places, -1 where there is none."""
    own: np.ndarray
    """int64[n, H + 1]: open mask pixels that a tower of that height shows."""
    shared: np.ndarray
    """int64[n, H + 1, H + 1]: of these, shown by the place before it (second index) as well."""
    counts: np.ndarray
    """int64[4]: A, c0, c_co at the start, number of blocks."""
    threshold: float
    """Delta."""


def find_towers(simulator: Simulator, state: State, row: int) -> Towers:
    """The towers of a fresh problem.

    Open pixels are mask pixels not yet covered at the start. Places beyond the outermost ones with
    open pixels are left out: passing them is never shorter than staying.

    Raises:
        InputError: for more than two sides, a scaled reward, or a problem that is not fresh.
    """
    task = simulator.task
    if task.num_sides > 2:
        raise InputError("num_sides", task.num_sides, "1 or 2 for exact returns")
    if task.reward != "discrete":
        raise InputError("reward", task.reward, "'discrete' for exact returns")
    if state.num_placed[row] != 1:
        raise InputError("num_placed", int(state.num_placed[row]), "1, a fresh problem")
    seen = tower_pixels() & (state.mask[row] & ~state.covered[row])[:, None, None]
    own = np.bitwise_count(seen).sum((-1, -2), dtype=np.int64)
    useful = np.argmax(own == own[..., -1:], -1)
    x, y = _places(simulator.frames)
    start = np.rint(state.position[row, 0, :2] / EDGE).astype(np.int64)
    first = (x == start[0]) & (y == start[1])
    inside = x[(useful > 0) | first]
    kept = np.argwhere((x >= inside.min()) & (x <= inside.max()))
    side, column = kept.T
    place = np.stack([x[side, column], y[side, column]], -1)
    shared = np.zeros((len(kept), *own.shape[-1:] * 2), np.int64)
    for n in range(1, len(kept)):
        if side[n] == side[n - 1]:
            both = seen[side[n], column[n] - 1][:, None] & seen[side[n], column[n]][None]
            shared[n] = np.bitwise_count(both).sum((-1, -2))
    low = first[side, column].astype(np.int64)
    beside = np.full((len(place), 3), -1, np.int64)
    for n, here in enumerate(place):
        near = np.flatnonzero(np.abs(place - here).sum(-1) == 1)
        beside[n, : len(near)] = near
    return Towers(
        place=place,
        cap=np.minimum(np.maximum(useful[side, column], 1), low + state.num_blocks[row] - 1),
        low=low,
        beside=beside,
        own=own[side, column],
        shared=shared,
        counts=np.array(
            [
                state.mask_pixels[row],
                state.initial_pixels[row],
                state.complete_pixels[row],
                state.num_blocks[row],
            ]
        ),
        threshold=task.success_threshold,
    )


def _places(frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World x and y [block edges] of every column of every side: int64[S, NUM_COLUMNS] each."""
    column = EDGE * np.arange(-MAX_COLUMN, MAX_COLUMN + 1)
    points = np.stack([to_world(f, column, 0 * column, 0 * column) for f in frames])
    index = np.rint(points[..., :2] / EDGE).astype(np.int64)
    return index[..., 0], index[..., 1]


@kernel
def has_ended(towers: Towers, heights: np.ndarray) -> bool:
    """Whether the episode is over: success, or no blocks left."""
    if heights.sum() >= towers.counts[3]:
        return True
    complete = towers.counts[2]
    for n in range(len(heights)):
        complete += towers.own[n, heights[n]]
        if n > 0:
            complete -= towers.shared[n, heights[n - 1], heights[n]]
    _, success = reward_and_success(
        towers.counts[0], towers.counts[1], 0, 0, complete, True, DISCRETE, towers.threshold
    )
    return success


@kernel
def gains(towers: Towers, heights: np.ndarray, n: int) -> bool:
    """Whether one more block on tower ``n`` shows pixels that are not yet shown."""
    h = heights[n]
    new = towers.own[n, h + 1] - towers.own[n, h]
    if n > 0:
        left = heights[n - 1]
        new -= towers.shared[n, left, h + 1] - towers.shared[n, left, h]
    if n + 1 < len(heights):
        right = heights[n + 1]
        new -= towers.shared[n + 1, h + 1, right] - towers.shared[n + 1, h, right]
    return new > 0


@kernel
def is_in_reach(towers: Towers, heights: np.ndarray, n: int) -> bool:
    """Whether tower ``n`` can take a block: it stands already, or a neighbour does."""
    if heights[n] > 0:
        return True
    for near in towers.beside[n]:  # noqa: SIM110 (compiled)
        if near >= 0 and heights[near] > 0:
            return True
    return False


def tower_bound(towers: Towers, discount: float) -> float:
    """Upper bound on the return in closed form: towers grow independently, none waits.

    The order of levels within a tower remains, so supports without pixels delay. The best order of
    independent chains under discounting is by falling index, the greatest reward rate
    ``sum gamma^i r_i / sum gamma^i`` of a chain's beginning (Gittins), and is found by sorting.
    Success and pixels shared by neighbours are left out; the number of blocks limits the rewards.
    """
    pieces: list[tuple[float, int, float]] = []
    for own, low, cap in zip(towers.own, towers.low, towers.cap, strict=True):
        bits = (own[low + 1 : cap + 1] > own[low:cap]).astype(float)
        while bits.any():
            weight = discount ** np.arange(len(bits))
            value = np.cumsum(weight * bits)
            rate = value / np.cumsum(weight)
            k = int(np.argmax(rate))
            # The index is negative, so that the greatest comes first.
            pieces.append((-float(rate[k]), k + 1, float(value[k])))
            bits = bits[k + 1 :]
    total, factor = 0.0, 1.0
    for _, length, value in sorted(pieces):
        total += factor * value
        factor *= discount**length
    left = int(towers.counts[3] - towers.low.sum())
    return min(total, (1 - discount**left) / (1 - discount) if discount < 1 else float(left))


def best_return(simulator: Simulator, state: State, row: int = 0) -> float:
    """Upper bound on the return of the fresh problem in ``row``, discounted by the task's gamma.

    It is the exact optimum but where a detour pays, which is nearly never.

    Raises:
        InputError: where :func:`find_towers` refuses the problem.
    """
    towers, discount = find_towers(simulator, state, row), simulator.task.discount
    closed = tower_bound(towers, discount)
    structures = math.prod((towers.cap - towers.low + 1).tolist())
    if structures > MAX_STRUCTURES:
        return closed
    own, free = np.empty(structures), np.empty(0)
    sweep(towers, discount, False, 0.0, free, own)
    if closed > own[0] + ROUNDING:
        free = np.empty(structures)
        sweep(towers, discount, True, 0.0, own[:0], free)
        # Where even free reach brings nothing, no detour does.
        if free[0] > own[0] + ROUNDING:
            sweep(towers, discount, False, discount**DETOUR, free, own)
    return float(own[0])


@kernel
def sweep(
    towers: Towers, discount: float, free: bool, toll: float, beyond: np.ndarray, values: np.ndarray
) -> None:
    """Fill ``values`` (float64, index in mixed radix) from the highest structure down.

    ``free``: every place is in reach. ``toll`` > 0: a place out of reach may be used for that
    factor, after which everything is in reach: ``beyond`` holds the values from there on.
    """
    count = len(towers.cap)
    heights = towers.cap.copy()
    for index in range(len(values) - 1, -1, -1):
        best = 0.0
        if not has_ended(towers, heights):
            stride = 1
            for n in range(count):
                if heights[n] < towers.cap[n]:
                    reward = 1.0 if gains(towers, heights, n) else 0.0
                    if free or is_in_reach(towers, heights, n):
                        best = max(best, reward + discount * values[index + stride])
                    elif toll > 0:
                        best = max(best, toll * (reward + discount * beyond[index + stride]))
                stride *= towers.cap[n] - towers.low[n] + 1
        values[index] = best
        n = 0
        while n < count and heights[n] == towers.low[n]:
            heights[n] = towers.cap[n]
            n += 1
        if n < count:
            heights[n] -= 1
