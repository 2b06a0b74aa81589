"""The search's model of the world: exact simulator steps, values from a Q-network."""

from __future__ import annotations

import numpy as np
import torch

from learn2assemble.graph.batch import to_tensors
from learn2assemble.networks.qnetwork import QNetwork
from learn2assemble.search.model import ActionValues, StepResult
from learn2assemble.simulator import Simulator
from learn2assemble.task import check_actions
from learn2assemble.world.actions import DIRECTIONS
from learn2assemble.world.blocks import EDGE
from learn2assemble.world.state import State


class WorldModel:
    """Implements :class:`learn2assemble.search.model.SearchModel` on states of a simulator.

    Args:
        simulator: steps copies of states exactly, so a search never disturbs the real world.
        network: estimates values.
        device: where the network is.
    """

    def __init__(self, simulator: Simulator, network: QNetwork, device: str = "cpu") -> None:
        check_actions(network.config.num_actions, simulator.task)
        self.simulator, self.network, self.device = simulator, network, device
        self.discount = simulator.task.discount

    def batch_size(self, states: State) -> int:
        return states.batch_size

    def take(self, states: State, rows: np.ndarray) -> State:
        return states.take(rows)

    def join(self, states: list[State]) -> State:
        if len(states) == 1:
            return states[0]
        if all(state is states[0] for state in states):
            return states[0].take(np.zeros(len(states), np.int64))
        return State(*[np.concatenate(fields) for fields in zip(*states, strict=True)])

    def step(self, states: State, actions: np.ndarray) -> StepResult:
        after = states.copy()
        transition = self.simulator.step(after, actions)
        return StepResult(after, transition.reward, transition.terminated)

    def action_values(self, states: State) -> list[ActionValues]:
        graph = self.simulator.observe(states)
        with torch.inference_mode():
            factors = self.network(to_tensors(graph, self.device))
        block, reference, context = (t.cpu().numpy().astype(np.float64) for t in factors)
        out = []
        for row in range(states.batch_size):
            first = int(graph.num_targets[row])
            split, end = first + int(graph.num_placed[row]), int(graph.num_nodes[row])
            values = block[row, split:end, None] + reference[row, None, first:split] + context[row]
            actions = np.indices(values.shape).reshape(3, -1).T
            cells = np.broadcast_to(_cells(states, row), values.shape)
            out.append(ActionValues(actions, values.ravel(), cells.ravel()))
        return out

    def random_actions(self, states: State, rng: np.random.Generator) -> np.ndarray:
        relations = np.full(states.batch_size, self.simulator.task.num_actions)
        counts = np.stack([states.num_unplaced, states.num_placed, relations], -1)
        return (rng.random(counts.shape) * counts).astype(np.int64)

    def best(self, states: State) -> tuple[np.ndarray, np.ndarray]:
        graph = self.simulator.observe(states)
        with torch.inference_mode():
            tensors = to_tensors(graph, self.device)
            value, action = self.network(tensors).best(tensors)
        offset = np.stack(
            [graph.num_targets + graph.num_placed, graph.num_targets, 0 * graph.num_placed], -1
        )
        return value.cpu().numpy().astype(np.float64), action.cpu().numpy() - offset


def _cells(states: State, row: int) -> np.ndarray:
    """Number of the cell that every (reference, relation) leads to: int64[P, 5]."""
    placed = states.position[row, : states.num_placed[row]]
    # Centres in units of 5 mm: finer than a lattice cell, coarser than what settling moves.
    index = np.rint((placed[:, None] + EDGE * DIRECTIONS) * (10 / EDGE)).astype(np.int64) + 4096
    keys = (index[..., 0] << 40) + (index[..., 1] << 20) + index[..., 2]
    return np.unique(keys, return_inverse=True)[1].reshape(keys.shape)
