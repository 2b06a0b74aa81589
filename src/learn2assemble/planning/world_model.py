"""The search's model of the world: exact simulator steps, values from a Q-network.

The full-width one-step look-ahead with the exact model: a policy without any learning.

With the discrete reward it takes the smallest positive gain of coverage, which keeps most gains
for later, with the scaled one the largest reward; where nothing gains, the lowest valid placement
that stays within the footprint of the structure. It knows which placements are valid and what
they bring, which the paper's agent does not.
"""

from __future__ import annotations

import numpy as np
import torch

from learn2assemble.graph.batch import GraphTensors, to_tensors
from learn2assemble.graph.features import Graph, node_offset
from learn2assemble.graph.placements import Placements, action_keys, distinct_placements
from learn2assemble.networks.agent import Network, fitted
from learn2assemble.networks.placement import PlacementValues
from learn2assemble.networks.qnetwork import QFactors
from learn2assemble.search.tree import ActionValues, StepResult
from learn2assemble.simulator import Simulator
from learn2assemble.tasks import check_actions
from learn2assemble.world.blocks import EDGE, ActionSpec
from learn2assemble.world.layouts import to_world
from learn2assemble.world.state import State

PART = 64
"""Graphs a forward pass on the CPU: measured 1.6 times as fast as 512 at once (N = 30)."""


class WorldModel:
    """Implements :class:`learn2assemble.search.tree.SearchModel` on states of a simulator.

    Args:
        simulator: steps copies of states exactly, so a search never disturbs the real world.
        network: estimates values; it may have been trained at another pitch.
        device: where the network is.
    """

    def __init__(self, simulator: Simulator, network: Network, device: str = "cpu") -> None:
        task, config = simulator.task, network.config
        check_actions(config.num_actions, config.action_mode, task)
        self.simulator, self.device = simulator, device
        self.network = fitted(network, task.pitch, task.sight)
        self.discount = simulator.task.discount

    def take(self, states: State, rows: np.ndarray) -> State:
        return states.take(rows)

    def join(self, states: list[State]) -> State:
        if len(states) == 1:
            return states[0]
        return State(*[np.concatenate(fields) for fields in zip(*states, strict=True)])

    def step(self, states: State, actions: np.ndarray) -> StepResult:
        after = states.copy()
        transition = self.simulator.step(after, actions)
        return StepResult(after, transition.reward, transition.terminated)

    def action_values(self, states: State) -> list[ActionValues]:
        graph = self.simulator.observe(states)
        with torch.inference_mode():
            found = [self.network(part) for part in self._parts(graph)]
        out: list[ActionValues] = []
        for number, values in enumerate(found):
            part = graph.take(np.arange(len(graph.num_nodes))[number * PART : (number + 1) * PART])
            pairs = isinstance(values, QFactors)
            spec = self.simulator.action_spec
            out += _of_pairs(part, values, spec) if pairs else _of_placements(part, values)
        return out

    def legal(self, states: State) -> list[ActionValues]:
        graph, num_actions = self.simulator.observe(states), self.simulator.task.num_actions
        sizes = zip(states.num_unplaced, states.num_placed, strict=True)
        return [
            _all_actions(graph, row, np.zeros((*size, num_actions)), self.simulator.action_spec)
            for row, size in enumerate(sizes)
        ]

    def random_actions(self, states: State, rng: np.random.Generator) -> np.ndarray:
        return self.simulator.random_actions(states, rng)

    def best(self, states: State) -> tuple[np.ndarray, np.ndarray]:
        graph = self.simulator.observe(states)
        with torch.inference_mode():
            found = [self.network(part).best(part) for part in self._parts(graph)]
            value, action = (torch.cat(column) for column in zip(*found, strict=True))
        return value.cpu().numpy().astype(np.float64), action.cpu().numpy() - node_offset(graph)

    def _parts(self, graph: Graph) -> list[GraphTensors]:
        """The graph as tensors, in parts whose activations stay in the cache of a CPU."""
        tensors = to_tensors(graph, self.device)
        if len(tensors.nodes) <= PART:
            return [tensors]
        return [GraphTensors(*part) for part in zip(*[t.split(PART) for t in tensors], strict=True)]


def _of_placements(graph: Graph, values: PlacementValues) -> list[ActionValues]:
    q = values.q.cpu().numpy().astype(np.float64)
    placements, offset = values.cells.placements, node_offset(graph)
    out = []
    for row, count in enumerate(placements.count):
        actions = placements.action[row, :count] - offset[row]
        out.append(ActionValues(actions, q[row, :count], placements.key[row, :count]))
    return out


def _of_pairs(graph: Graph, values: QFactors, spec: ActionSpec) -> list[ActionValues]:
    block, reference, context = (t.cpu().numpy().astype(np.float64) for t in values)
    out = []
    for row in range(len(graph.num_nodes)):
        first = int(graph.num_targets[row])
        split, end = first + int(graph.num_placed[row]), int(graph.num_nodes[row])
        q = block[row, split:end, None] + reference[row, None, first:split] + context[row]
        out.append(_all_actions(graph, row, q, spec))
    return out


def _all_actions(graph: Graph, row: int, values: np.ndarray, spec: ActionSpec) -> ActionValues:
    """All actions of a row in the order of float64[unplaced, placed, Na] ``values``."""
    actions = np.indices(values.shape).reshape(3, -1).T
    keys = action_keys(graph, row, spec)
    return ActionValues(actions, values.ravel(), keys.ravel())


LAST = 1e6
"""Added to the cost of placements that gain nothing."""


def lookahead_actions(simulator: Simulator, state: State) -> np.ndarray:
    """One action for every row: int64[B, 3] (local indices)."""
    graph = simulator.observe(state)
    placements = distinct_placements(graph, simulator.action_spec)
    outcomes = simulator.outcomes(state, graph, placements, without_arm=True)
    positive = outcomes.valid & (outcomes.reward > 0)
    # The discrete reward counts gains, so small ones first; the scaled one adds them up discounted.
    best = outcomes.gain if simulator.task.reward == "discrete" else -outcomes.reward
    cost = np.where(positive, best, np.inf)
    wanting = ~positive.any(1) | simulator.task.has_arm
    for row in np.flatnonzero(wanting).tolist():
        support = placement_cost(simulator, state, placements, row)
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


def placement_cost(
    simulator: Simulator, state: State, placements: Placements, row: int
) -> np.ndarray:
    """What placements cost that gain nothing, float64[P]: by the distance from the target vertices
    in plan, then by height; more than any gain."""
    corners = []
    for side, frame in enumerate(simulator.frames):
        outline = state.vertices[row, side, : state.num_vertices[row, side]]
        corners.append(to_world(frame, outline[:, 0], np.zeros(len(outline)), outline[:, 1]))
    points = np.concatenate(corners)[:, :2]
    low, high = points.min(0) - EDGE / 2, points.max(0) + EDGE / 2
    at = placements.cells[row, placements.members[row]]
    beyond = np.maximum(low - at[..., :2], 0) + np.maximum(at[..., :2] - high, 0)
    cost = (100 * beyond.sum(-1) + at[..., 2]) * (placements.members[row] >= 0)
    return LAST + cost.sum(-1)
