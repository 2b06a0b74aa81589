"""Choosing actions while collecting: epsilon-greedy, or a search first (protocol 11.5)."""

from __future__ import annotations

import numpy as np
import torch

from learn2assemble.graph.batch import to_tensors
from learn2assemble.graph.features import Graph
from learn2assemble.learning.replay import Searched
from learn2assemble.networks.qnetwork import QNetwork
from learn2assemble.search.config import SearchConfig
from learn2assemble.search.mcts import search
from learn2assemble.search.model import SearchModel
from learn2assemble.world.state import State


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


def searching(
    model: SearchModel,
    state: State,
    graph: Graph,
    config: SearchConfig,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, Searched]:
    """One search for every row: node actions int64[B, 3], which of them no draw of epsilon
    chose, and what the searches found at their roots."""
    decisions = search(model, state, config, rng)
    offset = node_offset(graph)
    action = np.stack([decision.action for decision in decisions]) + offset
    found = Searched(
        np.zeros((len(decisions), config.budget, 3), np.int64),
        np.zeros((len(decisions), config.budget), np.float32),
        np.zeros(len(decisions), np.int64),
    )
    for row, decision in enumerate(decisions):
        explored = decision.explored()
        found.count[row] = len(explored)
        for n, (local, value, _) in enumerate(explored):
            found.action[row, n], found.value[row, n] = local + offset[row], value
    return action, ~np.array([decision.random for decision in decisions]), found


def node_offset(graph: Graph) -> np.ndarray:
    """Node index of the first unplaced and of the first placed block, and 0: int64[B, 3]."""
    first = graph.num_targets + graph.num_placed
    return np.stack([first, graph.num_targets, 0 * graph.num_placed], -1)


def to_local(graph: Graph, action: np.ndarray) -> np.ndarray:
    """Node indices to indices within the unplaced and the placed blocks: int64[B, 3]."""
    return action - node_offset(graph)
