r"""The best discounted return of a problem with cubes, proven, and a plan that earns it.

Discrete reward (protocol 6.3), one or two sides, fresh problems. The state is the list of tower
heights :math:`h` of :mod:`learn2assemble.evaluation.towers`; how many blocks stand tells the time.
With :math:`c(h)` the mask pixels shown,

.. math::  V(h) = \max_n\ [c(h + e_n) > c(h)] + \gamma V(h + e_n),

and :math:`V = 0` where the episode has ended. All heights are swept once.

**Proven**, for physics that moves no blocks. On the lattice only a block in a face plane can raise
the plane cover (``tests/test_exact.py`` tries all others). Take any sequence of blocks and delete
those outside the towers: every gain stays and comes no later, and success comes no earlier, since
less is covered. What is lost is only how a place was reached. A block outside touches one place at
most, and two that touch each other belong to the same or to neighbouring places, so a place none
of whose neighbours stands takes a detour of three blocks or more. ``upper`` lets such a place be
used for the price of three steps, paid once: a relaxation, hence a bound on every play.

**Carried by proof.** ``feasible`` is what ``actions`` earn in the simulator, replayed step by
step. They may stop before the episode ends: the blocks that are left can be stacked without loss.

**Heuristic.** Beyond ``max_structures`` the plan comes from a beam search and ``upper`` is
:func:`~learn2assemble.evaluation.towers.tower_bound`, proven too, but possibly out of reach.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from learn2assemble.errors import Learn2AssembleError
from learn2assemble.evaluation.towers import (
    Towers,
    find_towers,
    gains,
    has_ended,
    is_in_reach,
    merge_chains,
    tower_bound,
    tower_chains,
)
from learn2assemble.simulator import Simulator
from learn2assemble.world.actions import DIRECTIONS
from learn2assemble.world.state import State

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
