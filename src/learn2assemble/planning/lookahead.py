"""The full-width one-step look-ahead with the exact model: a policy without any learning.

It takes the smallest positive gain of coverage, which keeps most gains for later; where nothing
gains, the lowest valid placement that stays within the footprint of the structure. It knows which
placements are valid and what they bring, which the paper's agent does not.
"""

from __future__ import annotations

import numpy as np

from learn2assemble.simulator import Simulator
from learn2assemble.world.actions import DIRECTIONS
from learn2assemble.world.blocks import EDGE
from learn2assemble.world.sides import to_world
from learn2assemble.world.state import State


def lookahead_actions(simulator: Simulator, state: State) -> np.ndarray:
    """One action for every row: int64[B, 3] (local indices)."""
    prospects = simulator.prospects(state)
    actions = np.zeros((state.batch_size, 3), np.int64)
    for row in range(state.batch_size):
        valid, gain = prospects.valid[row], prospects.gain[row]
        positive = valid & (prospects.reward[row] > 0)
        if positive.any():
            cost = np.where(positive, gain, np.inf)
        else:
            cost = np.where(valid, _support_cost(simulator, state, row), np.inf)
        actions[row, 1:] = np.unravel_index(int(cost.argmin()), cost.shape)
    return actions


def _support_cost(simulator: Simulator, state: State, row: int) -> np.ndarray:
    """Distance of every cell from the target vertices in plan, then its height: float64[M, 5]."""
    cells = state.position[row][:, None] + EDGE * DIRECTIONS
    corners = []
    for side, frame in enumerate(simulator.frames):
        outline = state.vertices[row, side, : state.num_vertices[row, side]]
        corners.append(to_world(frame, outline[:, 0], np.zeros(len(outline)), outline[:, 1]))
    points = np.concatenate(corners)[:, :2]
    low, high = points.min(0) - EDGE / 2, points.max(0) + EDGE / 2
    beyond = np.maximum(low - cells[..., :2], 0) + np.maximum(cells[..., :2] - high, 0)
    return 100 * beyond.sum(-1) + cells[..., 2]
