"""The search's model of the world: exact simulator steps, values from a Q-network.

The full-width one-step look-ahead with the exact model: a policy without any learning.

With the discrete reward it takes the smallest positive gain of coverage, which keeps most gains
for later, with the scaled one the largest reward; where nothing gains, the lowest valid placement
that stays within the footprint of the structure. It knows which placements are valid and what
they bring, which the paper's agent does not.
"""

from __future__ import annotations

from itertools import islice
from typing import NamedTuple

import numpy as np

from learn2assemble.constants import EDGE
from learn2assemble.errors import extra
from learn2assemble.tasks.graph.batch import GraphTensors, to_tensors
from learn2assemble.tasks.graph.features import Graph, node_offset
from learn2assemble.tasks.graph.placements import Placements, action_keys, distinct_placements
from learn2assemble.tasks.networks.agent import Network, Values, fitted
from learn2assemble.tasks.networks.qnetwork import QFactors
from learn2assemble.tasks.search.tree import ActionValues, StepResult
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import check_actions
from learn2assemble.tasks.world.blocks import ActionSpec
from learn2assemble.tasks.world.layouts import to_world
from learn2assemble.tasks.world.state import State

with extra("torch", "learn"):
    import torch

PART = 64
"""Graphs a forward pass on the CPU: measured 1.6 times as fast as 512 at once (N = 30)."""
MEMORY = 2048
"""Graphs at most whose values are kept: a search goes on where it has been, and the child it
chooses is its next root."""


class _Kept(NamedTuple):
    """Values of one row of a batch that was evaluated."""

    values: tuple[np.ndarray, ...]
    """Those of :class:`QFactors`, or Q, action, key and number of all placements."""
    row: int


class WorldModel:
    """Implements :class:`learn2assemble.tasks.search.tree.SearchModel` on states of a simulator.

    Args:
        simulator: steps copies of states exactly, so a search never disturbs the real world.
        network: estimates values; it may have been trained at another pitch.
        device: where the network is.
        sight: how far our network sees [cells]; by default as far as the task says.
    """

    def __init__(
        self, simulator: Simulator, network: Network, device: str = "cpu", sight: int | None = None
    ) -> None:
        task, config = simulator.task, network.config
        check_actions(config.num_actions, config.action_mode, task)
        self.simulator = simulator
        self.device = device
        self.network: Network = fitted(network, task.pitch, task.sight if sight is None else sight)
        self.discount: float = simulator.task.discount
        self._kept: dict[bytes, _Kept] = {}

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
        graph, spec = self.simulator.observe(states), self.simulator.action_spec
        names, offset = self._names(graph), node_offset(graph)
        new = [row for row, name in enumerate(names) if name not in self._kept]
        if new:
            self._evaluate(graph.take(np.array(new)), [names[row] for row in new])
        out: list[ActionValues] = []
        for row, name in enumerate(names):
            values, at = self._kept[name]
            if self.network.config.values_placements:
                q, action, key, count = (field[at] for field in values)
                some = slice(int(count))
                out.append(
                    ActionValues(action[some] - offset[row], q[some].astype(float), key[some])
                )
            else:
                block, reference, context = (field[at].astype(np.float64) for field in values)
                split, end = int(offset[row, 0]), int(graph.num_nodes[row])
                pairs = block[split:end, None] + reference[None, offset[row, 1] : split]
                out.append(_all_actions(graph, row, pairs + context, spec))
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
        found = self._evaluate(graph, self._names(graph))
        value, action = (torch.cat(column).cpu().numpy() for column in zip(*found, strict=True))
        return value.astype(np.float64), action - node_offset(graph)

    def _names(self, graph: Graph) -> list[bytes]:
        """What the values of every graph are kept under. Where they are too many the older half
        makes room; a network that learns has new values every time."""
        most = 0 if self.network.training else MEMORY
        if (count := len(self._kept)) > most:
            self._kept = dict(islice(self._kept.items(), count - most // 2, None))
        return [
            graph.nodes[row, :used].tobytes() + graph.object_id[row, :used].tobytes()
            for row, used in enumerate(graph.num_nodes)
        ]

    def _evaluate(
        self, graph: Graph, names: list[bytes]
    ) -> list[tuple[torch.Tensor, torch.Tensor]]:
        """Largest Q and its node action, in parts whose activations stay in the cache of a CPU;
        keeps all values."""
        tensors = to_tensors(graph, self.device)
        found = list[tuple[torch.Tensor, torch.Tensor]]()
        with torch.inference_mode():
            for start in range(0, len(names), PART):
                part = GraphTensors(*[t[start : start + PART] for t in tensors])
                values = self.network(part)
                found.append(values.best(part))
                kept = _to_keep(values)
                for row, name in enumerate(names[start : start + PART]):
                    self._kept[name] = _Kept(kept, row)
        return found


def _to_keep(values: Values) -> tuple[np.ndarray, ...]:
    if isinstance(values, QFactors):
        return tuple(field.cpu().numpy() for field in values)
    placements = values.cells.placements
    return values.q.cpu().numpy(), placements.action, placements.key, placements.count


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
    corners = list[np.ndarray]()
    for side, frame in enumerate(simulator.frames):
        outline = state.vertices[row, side, : state.num_vertices[row, side]]
        corners.append(to_world(frame, outline[:, 0], np.zeros(len(outline)), outline[:, 1]))
    points = np.concatenate(corners)[:, :2]
    low, high = points.min(0) - EDGE / 2, points.max(0) + EDGE / 2
    at = placements.cells[row, placements.members[row]]
    beyond = np.maximum(low - at[..., :2], 0) + np.maximum(at[..., :2] - high, 0)
    cost = (100 * beyond.sum(-1) + at[..., 2]) * (placements.members[row] >= 0)
    return LAST + cost.sum(-1)
