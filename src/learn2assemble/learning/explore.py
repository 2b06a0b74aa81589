"""Choosing actions while collecting: epsilon-greedy on the Q-network (protocol 11.5)."""

from __future__ import annotations

import numpy as np
import torch

from learn2assemble.graph.batch import to_tensors
from learn2assemble.graph.features import Graph
from learn2assemble.networks.qnetwork import QNetwork


def greedy_actions(network: QNetwork, graph: Graph, device: str) -> np.ndarray:
    """Legal node action with the largest Q of every row: int64[B, 3]."""
    with torch.inference_mode():
        tensors = to_tensors(graph, device)
        _, action = network(tensors).best(tensors)
    return action.cpu().numpy()


def random_actions(graph: Graph, num_actions: int, rng: np.random.Generator) -> np.ndarray:
    """A uniform legal node action for every row: int64[B, 3]."""
    first = graph.num_targets + graph.num_placed
    draw = rng.random((len(first), 3))
    block = first + draw[:, 0] * (graph.num_nodes - first)
    reference = graph.num_targets + draw[:, 1] * graph.num_placed
    return np.stack([block, reference, draw[:, 2] * num_actions], -1).astype(np.int64)


def epsilon_greedy(
    network: QNetwork, graph: Graph, epsilon: float, rng: np.random.Generator, device: str
) -> tuple[np.ndarray, np.ndarray]:
    """Node actions int64[B, 3], uniform with probability ``epsilon``, and which are greedy."""
    action = random_actions(graph, network.config.num_actions, rng)
    greedy = rng.random(len(action)) >= epsilon
    if greedy.any():
        rows = np.flatnonzero(greedy)
        action[rows] = greedy_actions(network, graph.take(rows), device)
    return action, greedy


def to_local(graph: Graph, action: np.ndarray) -> np.ndarray:
    """Node indices to indices within the unplaced and the placed blocks: int64[B, 3]."""
    offset = np.stack(
        [graph.num_targets + graph.num_placed, graph.num_targets, 0 * graph.num_placed], -1
    )
    return action - offset
