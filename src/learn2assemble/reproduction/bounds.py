r"""Upper bounds on the return of problems with cubes (discrete reward).

**Quick.** A step is worth 1 when the plane-filtered cover grows, and a cell of the face planes can
make it grow only once. With k cells whose faces show mask pixels that the first block leaves open,
``R <= 1 + gamma + ... + gamma^(k-1)``.

**Towers**, on one or two sides. A structure is the list of tower heights :math:`h` (int64[n]) in
the face planes. It grows by one block on a tower, or on the table beside one. What it shows is a
sum over towers and pairs of neighbours, because a ray meets the cubes of two places of a side at
most. With :math:`c(h)` the mask pixels shown, all heights are swept once for

.. math::  V(h) = \max_n\ [c(h + e_n) > c(h)] + \gamma V(h + e_n),

and :math:`V = 0` where the episode has ended.

This bounds every play under physics that moves no blocks. On the lattice only a block in a face
plane can raise the plane cover (``tests/test_exact.py`` tries all others). Delete the blocks
outside the towers from any sequence: every gain stays and comes no later, and success comes no
earlier. What is lost is only how a place was reached. A block outside touches one place at most,
and two that touch each other belong to the same or to neighbouring places, so a place none of
whose neighbours stands takes a detour of three blocks or more; ``upper`` lets it be used for the
price of three steps, paid once.

``feasible`` is what ``actions`` earn in the simulator, replayed step by step. Beyond
``max_structures`` the plan comes from a beam search and ``upper`` is :func:`tower_bound`, which
may be out of reach.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from learn2assemble.errors import InputError, Learn2AssembleError
from learn2assemble.reproduction.packing import (
    MAX_COLUMN,
    cell_pixels,
    object_return_bound,
    tower_pixels,
)
from learn2assemble.simulator import Simulator
from learn2assemble.tasks import Task
from learn2assemble.world.blocks import DIRECTIONS, EDGE
from learn2assemble.world.layouts import to_world
from learn2assemble.world.rules import DISCRETE, reward_and_success
from learn2assemble.world.state import State


def open_cells(state: State) -> np.ndarray:
    """k of every row: cells of the face planes that show mask pixels not yet covered, int64[B]."""
    open_pixels = state.mask & ~state.covered
    cells = cell_pixels()
    counts = np.zeros(state.batch_size, np.int64)
    for side in range(open_pixels.shape[1]):
        # Looped over rows: the table of all cells times all rows would not fit in memory.
        for row, pixels in enumerate(open_pixels[:, side]):
            counts[row] += int(((cells & pixels) != 0).any((-1, -2)).sum())
    return counts


def return_bound(state: State, discount: float) -> np.ndarray:
    """Upper bound on the discounted return from fresh states, float64[B] (discrete reward)."""
    return (1 - discount ** open_cells(state)) / (1 - discount)


Piece = tuple[float, int, float]
"""Beginning of a chain: index (negative, so that they sort), length, discounted reward."""


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

    @property
    def num_structures(self) -> int:
        """Number of height lists from ``low`` to ``cap``."""
        return int(np.prod((self.cap - self.low + 1).astype(object)))


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
    return Towers(
        place=place,
        cap=np.minimum(np.maximum(useful[side, column], 1), low + state.num_blocks[row] - 1),
        low=low,
        beside=_neighbours(place),
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


def _neighbours(place: np.ndarray) -> np.ndarray:
    beside = np.full((len(place), 3), -1, np.int64)
    for n, p in enumerate(place):
        near = np.flatnonzero(np.abs(place - p).sum(-1) == 1)
        beside[n, : len(near)] = near
    return beside


@njit(cache=True)
def has_ended(towers, heights):
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


@njit(cache=True)
def gains(towers, heights, n):
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


@njit(cache=True)
def is_in_reach(towers, heights, n):
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
    chains = tower_chains(towers, discount)
    return merge_chains(chains, towers.low.tolist(), int(towers.counts[3]), discount)


def tower_chains(towers: Towers, discount: float) -> list[list[list[Piece]]]:
    """What is left of every tower (first index) from every height (second), cut into pieces."""
    return [
        [_pieces(own[h + 1 : cap + 1] > own[h:cap], discount) for h in range(cap + 1)]
        for own, cap in zip(towers.own, towers.cap, strict=True)
    ]


def merge_chains(
    chains: list[list[list[Piece]]], heights: Sequence[int], blocks: int, discount: float
) -> float:
    """:func:`tower_bound` from ``heights`` on; ``chains`` as of :func:`tower_chains`."""
    total, factor = 0.0, 1.0
    pieces = (piece for chain, h in zip(chains, heights, strict=True) for piece in chain[h])
    for _, length, value in sorted(pieces):
        total += factor * value
        factor *= discount**length
    left = blocks - sum(heights)
    return min(total, (1 - discount**left) / (1 - discount) if discount < 1 else float(left))


def _pieces(rewarded: np.ndarray, discount: float) -> list[Piece]:
    """A chain cut into beginnings of greatest index."""
    found, bits = [], rewarded.astype(float)
    while bits.any():
        weight = discount ** np.arange(len(bits))
        value = np.cumsum(weight * bits)
        rate = value / np.cumsum(weight)
        k = int(np.argmax(rate))
        found.append((-float(rate[k]), k + 1, float(value[k])))
        bits = bits[k + 1 :]
    return found


MAX_STRUCTURES = 1_000_000
"""Structures swept at most: 8 bytes and about 0.7 us each, in up to three sweeps."""
DETOUR = 3
"""Blocks outside the face planes it takes at least to get around an empty place."""
BEAM_WIDTH = 100
ROUNDING = 1e-12
"""Returns that differ by less are equal."""


@dataclass(frozen=True)
class ExactReturn:
    """What perfect play scores on one problem."""

    upper: float
    """No play earns more (proven)."""
    feasible: float
    """What ``actions`` earned in the simulator."""
    actions: np.ndarray
    """int64[T, 3]: unplaced block, reference, relation, as :meth:`Simulator.step` takes them."""
    structures: int
    """Structures swept; 0 where they were too many and the beam search planned."""

    @property
    def gap(self) -> float:
        return self.upper - self.feasible


def exact_return(
    simulator: Simulator, state: State, row: int = 0, max_structures: int = MAX_STRUCTURES
) -> ExactReturn:
    """Best return of the fresh problem in ``row``, discounted by the task's gamma.

    Equal ``upper`` and ``feasible`` are the exact optimum over all plays, blocks outside the face
    planes included.

    Raises:
        InputError: where :func:`find_towers` refuses the problem.
        Learn2AssembleError: where the simulator contradicts the plan (a fault of this package).
    """
    towers, discount = find_towers(simulator, state, row), simulator.task.discount
    structures = towers.num_structures
    if structures <= max_structures:
        order, upper = _sweep_all(towers, discount, structures)
    else:
        structures = 0
        order, upper = _beam(towers, discount), tower_bound(towers, discount)
    actions = _to_actions(towers, order)
    return ExactReturn(upper, replay_actions(simulator, state, row, actions), actions, structures)


def replay_actions(simulator: Simulator, state: State, row: int, actions: np.ndarray) -> float:
    """Discounted return of ``actions`` (int64[T, 3]) from ``row``, in the simulator's physics.

    Raises:
        Learn2AssembleError: where a step is invalid or comes after the end.
    """
    world, total, discount = state.take(np.array([row])), 0.0, 1.0
    for number, action in enumerate(actions):
        if world.terminated[0]:
            raise Learn2AssembleError(f"exact plan: the episode ended before step {number}")
        step = simulator.step(world, action[None])
        if step.verdict[0] != 0:
            raise Learn2AssembleError(f"exact plan: step {number} is invalid")
        total += discount * float(step.reward[0])
        discount *= simulator.task.discount
    return total


@njit(cache=True)
def _sweep(towers, discount, free, toll, beyond, values):
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


def _sweep_all(towers: Towers, discount: float, structures: int) -> tuple[list[int], float]:
    """Best order of towers to grow, and the upper bound."""
    own, none = np.empty(structures), np.empty(0)
    _sweep(towers, discount, False, 0.0, none, own)
    order = _follow(towers, discount, own)
    if tower_bound(towers, discount) <= own[0] + ROUNDING:
        return order, float(own[0])
    free = np.empty(structures)
    _sweep(towers, discount, True, 0.0, none, free)
    # Where even free reach brings nothing, no detour does.
    if free[0] > own[0] + ROUNDING:
        _sweep(towers, discount, False, discount**DETOUR, free, own)
    return order, float(own[0])


def _follow(towers: Towers, discount: float, values: np.ndarray) -> list[int]:
    """The towers that grow, one by one, along the greatest values, until nothing is to be had."""
    heights, index, order = towers.low.copy(), 0, []
    strides = np.cumprod(np.concatenate([[1], towers.cap - towers.low + 1]))
    while values[index] > 0:
        worth = np.full(len(heights), -1.0)
        for n in np.flatnonzero(heights < towers.cap):
            if is_in_reach(towers, heights, n):
                worth[n] = gains(towers, heights, n) + discount * values[index + strides[n]]
        n = int(np.argmax(worth))
        order.append(n)
        heights[n] += 1
        index += int(strides[n])
    return order


def _beam(towers: Towers, discount: float) -> list[int]:
    """A good order of towers to grow: the ``BEAM_WIDTH`` most promising structures a step."""
    chains, blocks = tower_chains(towers, discount), int(towers.counts[3])
    beam: dict[tuple[int, ...], tuple[float, tuple[int, ...]]]
    beam, best, factor = {tuple(towers.low.tolist()): (0.0, ())}, (0.0, ()), 1.0
    while beam:
        after: dict[tuple[int, ...], tuple[float, tuple[int, ...]]] = {}
        for key, (earned, order) in beam.items():
            heights = np.array(key)
            for n in np.flatnonzero(heights < towers.cap).tolist():
                if is_in_reach(towers, heights, n):
                    value = earned + factor * float(gains(towers, heights, n))
                    grown = (*key[:n], key[n] + 1, *key[n + 1 :])
                    if value > after.get(grown, (-1.0, ()))[0]:
                        after[grown] = (value, (*order, n))
        factor *= discount
        best = max([best, *after.values()], key=lambda child: child[0])
        rank = {
            key: value + factor * merge_chains(chains, key, blocks, discount)
            for key, (value, _) in after.items()
            if not has_ended(towers, np.array(key))
        }
        chosen = sorted(rank, key=lambda key: (-rank[key], key))[:BEAM_WIDTH]
        beam = {key: after[key] for key in chosen if rank[key] > best[0] + ROUNDING}
    return list(best[1])


def _to_actions(towers: Towers, order: list[int]) -> np.ndarray:
    """Placements that grow the given towers in turn: int64[T, 3]."""
    start = int(np.flatnonzero(towers.low)[0])
    heights = towers.low.copy()
    placed = [(*towers.place[start], 0)]
    actions = []
    for n in order:
        cell = np.array([*towers.place[n], heights[n]])
        offset = cell - np.array(placed)
        match = (offset[:, None] == DIRECTIONS).all(-1)
        reference, relation = np.argwhere(match)[0]
        actions.append((0, reference, relation))
        placed.append(tuple(cell))
        heights[n] += 1
    return np.array(actions, np.int64).reshape(-1, 3)


def has_bound(task: Task) -> bool:
    """Whether a bound is known: cubes with the discrete, anything with the scaled reward, where
    blocks touch."""
    return task.touching and (task.reward == "scaled" or task.objects == "cubes")


def best_returns(simulator: Simulator, count: int, rng: np.random.Generator) -> np.ndarray:
    """Upper bound on the return of each of ``count`` fresh problems, float64[count].

    Cubes on one or two sides: the optimum but for a gap that is nearly always 0 (``exact``); on
    more sides the number of cells to fill (``bounds``). Scaled reward: the packing bound, which
    knows neither balance nor support (``object_bounds``). Problems as in the evaluation episodes
    of the same generator.
    """
    task, state = simulator.task, simulator.new(count, rng)
    if task.reward == "scaled":
        return np.array([_of_objects(simulator, state, row) for row in range(count)])
    if task.num_sides <= 2:
        return np.array([exact_return(simulator, state, row).upper for row in range(count)])
    return return_bound(state, task.discount)


def _of_objects(simulator: Simulator, state: State, row: int) -> float:
    task = simulator.task
    return object_return_bound(
        state, row, simulator.frames, task.discount, task.success_threshold, task.rotations
    )
