"""The full-width one-step look-ahead with the exact model: a policy without any learning.

With the discrete reward it takes the smallest positive gain of coverage, which keeps most gains
for later, with the scaled one the largest reward; where nothing gains, the lowest valid placement
that stays within the footprint of the structure. It knows which placements are valid and what
they bring, which the paper's agent does not.
"""

from __future__ import annotations

import numpy as np

from learn2assemble.graph.features import Graph, node_offset
from learn2assemble.graph.placements import Placements, distinct_placements
from learn2assemble.simulator import Simulator
from learn2assemble.world.blocks import EDGE
from learn2assemble.world.sides import to_world
from learn2assemble.world.state import State

LAST = 1e6
"""Added to the cost of placements that gain nothing."""


def lookahead_actions(simulator: Simulator, state: State) -> np.ndarray:
    """One action for every row: int64[B, 3] (local indices)."""
    graph = simulator.observe(state)
    placements = distinct_placements(graph, simulator.ways)
    outcomes = simulator.outcomes(state, graph, placements, by_hand=True)
    positive = outcomes.valid & (outcomes.reward > 0)
    # The discrete reward counts gains, so small ones first; the scaled one adds them up discounted.
    best = outcomes.gain if simulator.task.reward == "discrete" else -outcomes.reward
    cost = np.where(positive, best, np.inf)
    wanting = ~positive.any(1) | simulator.task.has_arm
    for row in np.flatnonzero(wanting).tolist():
        support = LAST + _support_cost(simulator, state, placements, row)
        cost[row] = np.where(
            positive[row], cost[row], np.where(outcomes.valid[row], support, np.inf)
        )
    if simulator.task.has_arm:
        _try_in_order(simulator, state, graph, placements, cost)
    # A row without any valid placement takes the first one, which is legal and fails.
    chosen = cost.argmin(1)
    return placements.action[np.arange(len(chosen)), chosen] - node_offset(graph)


def _try_in_order(
    simulator: Simulator, state: State, graph: Graph, placements: Placements, cost: np.ndarray
) -> None:
    """Rule out, cheapest first, what the arm cannot do, up to the first placement it can."""
    for row in range(len(cost)):
        for number in np.argsort(cost[row], kind="stable").tolist():
            if not np.isfinite(cost[row, number]):
                break
            action = placements.action[row, number] - node_offset(graph)[row]
            if simulator.step(state.take(np.array([row])), action[None]).verdict[0] == 0:
                break
            cost[row, number] = np.inf


def _support_cost(
    simulator: Simulator, state: State, placements: Placements, row: int
) -> np.ndarray:
    """Distance of every placement from the target vertices in plan, then its height: float64[P]."""
    corners = []
    for side, frame in enumerate(simulator.frames):
        outline = state.vertices[row, side, : state.num_vertices[row, side]]
        corners.append(to_world(frame, outline[:, 0], np.zeros(len(outline)), outline[:, 1]))
    points = np.concatenate(corners)[:, :2]
    low, high = points.min(0) - EDGE / 2, points.max(0) + EDGE / 2
    at = placements.cells[row, placements.members[row]]
    beyond = np.maximum(low - at[..., :2], 0) + np.maximum(at[..., :2] - high, 0)
    cost = (100 * beyond.sum(-1) + at[..., 2]) * (placements.members[row] >= 0)
    return cost.sum(-1)
