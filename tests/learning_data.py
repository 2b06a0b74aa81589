"""What tests of learning and of the search share.

Tasks, networks, recorded transitions, turned graphs, checks; a model over written-out trees.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from safetensors import safe_open

from learn2assemble.constants import EDGE
from learn2assemble.tasks.graph.features import Graph, node_offset
from learn2assemble.tasks.graph.placements import Placements, distinct_placements
from learn2assemble.tasks.learning.config import TrainConfig
from learn2assemble.tasks.learning.replay import Batch
from learn2assemble.tasks.networks.agent import Network, make_network
from learn2assemble.tasks.networks.config import NetworkConfig
from learn2assemble.tasks.search.config import SearchConfig
from learn2assemble.tasks.search.mcts import SearchResult, search
from learn2assemble.tasks.search.tree import ActionValues, StepResult, TreeNode
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import Task
from learn2assemble.tasks.world.coverage import WORDS
from learn2assemble.tasks.world.outcomes import Outcomes
from learn2assemble.tasks.world.state import State

torch.set_num_threads(1)

TINY = Task("tiny", num_sides=1, grid=2, num_nodes=9)
TASKS = {
    1: Task("one", num_sides=1, grid=3, num_nodes=14),
    2: Task("two", num_sides=2, grid=3, num_nodes=20),
    4: Task("four", num_sides=4, grid=3, num_nodes=30),
}
SMALL = NetworkConfig(width=16, heads=2, rounds=1, position_scale=0.1, rotary=True)
RELATIONAL = NetworkConfig(encoder="relational", width=16, rounds=2)


def network(seed: int, config: NetworkConfig = SMALL) -> Network:
    torch.manual_seed(seed)
    return make_network(config)


def look_ahead(simulator: Simulator, state: State) -> tuple[Placements, Outcomes]:
    """Every distinct placement and what it would bring."""
    graph = simulator.observe(state)
    placements = distinct_placements(graph, simulator.action_spec)
    return placements, simulator.outcomes(state, graph, placements)


def random_actions(graph: Graph, num_actions: int, rng: np.random.Generator) -> np.ndarray:
    """A uniform legal node action for every row: int64[B, 3]."""
    unplaced = graph.num_nodes - graph.num_targets - graph.num_placed
    counts = np.stack([unplaced, graph.num_placed, np.full(len(unplaced), num_actions)], -1)
    return (rng.random(counts.shape) * counts).astype(np.int64) + node_offset(graph)


def advance(simulator: Simulator, state: State, steps: int, rng: np.random.Generator) -> State:
    """Worlds after up to ``steps`` valid placements, without those that have ended."""
    for _ in range(steps):
        placements, outcomes = look_ahead(simulator, state)
        graph = simulator.observe(state)
        actions = random_actions(graph, simulator.task.num_actions, rng)
        for row in range(state.batch_size):
            good = np.flatnonzero(outcomes.valid[row] & ~outcomes.terminal[row])
            if len(good):
                actions[row] = placements.action[row, rng.choice(good)]
        simulator.step(state, actions - node_offset(graph))
    return state.take(np.flatnonzero(~state.terminated))


class Recorded:
    """Transitions of a task with the worlds before and after them."""

    def __init__(self, task: Task, count: int, seed: int, steps: int = 2) -> None:
        rng = np.random.default_rng(seed)
        self.task, self.simulator = task, Simulator(task)
        self.before = advance(self.simulator, self.simulator.new(count, rng), steps, rng)
        self.after = self.before.copy()
        graph = self.simulator.observe(self.before)
        self.placements, options = look_ahead(self.simulator, self.before)
        action = random_actions(graph, task.num_actions, rng)
        self.local = action - node_offset(graph)
        self.step = self.simulator.step(self.after, self.local)
        size = len(action)
        self.batch = Batch(
            graph,
            action,
            self.step.reward.astype(np.float32),
            self.step.terminated,
            self.simulator.observe(self.after),
            np.full(size, task.discount, np.float32),
            options,
        )


def rows_of(graph: Graph, row: Any, low: int, high: int) -> list[tuple]:
    """Rounded features and object number of some nodes."""
    return [
        (*np.round(graph.nodes[row, n].astype(float), 5).tolist(), int(graph.object_id[row, n]))
        for n in range(low, high)
    ]


QUICK = TrainConfig(
    network=SMALL,
    num_samples=250,
    num_envs=5,
    initial_samples=50,
    batch_size=8,
    replay_size=130,
    epsilon_samples=120,
    target_period=7,
    updates_per_round=2,
    augment=True,
    learning_rate=1e-3,
    final_learning_rate=1e-4,
)
"""Uses every source of randomness and wraps its memory."""
OWN: dict[str, Any] = {"network": RELATIONAL, "augment": False, "dense_weight": 1.0}
"""What turns it into a training of our own method."""


def contents(file: Path) -> tuple[dict[str, Any], dict[str, torch.Tensor]]:
    """Counters and tensors of a state file, without the time it took."""
    with safe_open(file, "pt") as stream:
        counters = json.loads(stream.metadata()["counters"])
        tensors = {key: stream.get_tensor(key) for key in stream.keys()}  # noqa: SIM118
    counters.pop("seconds")
    return counters, tensors


def assert_same_training(a: Path, b: Path) -> None:
    """Bitwise: weights, optimiser, memory, worlds, counters, generator."""
    (counters_a, tensors_a), (counters_b, tensors_b) = contents(a), contents(b)
    assert counters_a == counters_b
    assert tensors_a.keys() == tensors_b.keys()
    for key, value in tensors_a.items():
        assert value.dtype == tensors_b[key].dtype, key
        assert value.numpy().tobytes() == tensors_b[key].numpy().tobytes(), key


_MIDDLE = {2: EDGE / 2, 4: EDGE}
_NEXT = {2: {0: 1, 1: 0}, 4: {0: 2, 2: 1, 1: 3, 3: 0}}
"""Which side stands where each side stood after a half turn (two sides), a quarter (four)."""


class Turn(NamedTuple):
    graph: Graph
    sides: list[int]
    """Which side each side becomes."""
    middle: float
    quarters: int

    def points(self, world: np.ndarray) -> np.ndarray:
        """Where points (x, y, z) [m] go."""
        x, y = world[..., 0], world[..., 1] - self.middle
        for _ in range(self.quarters):
            x, y = -y, x
        return np.stack([x, y + self.middle, world[..., 2]], -1)


def turned_graph(graph: Graph, num_sides: int, quarters: int) -> Turn:
    """Targets and placed blocks turned by quarter turns to the left; waiting blocks stay.

    Vertices stay listed side by side, as an observation lists them.
    """
    sides = list(range(num_sides))
    for _ in range(quarters // (4 // num_sides)):
        sides = [_NEXT[num_sides][side] for side in sides]
    nodes, object_id = graph.nodes.copy(), graph.object_id.copy()
    turn = Turn(
        graph._replace(nodes=nodes, object_id=object_id), sides, _MIDDLE[num_sides], quarters
    )
    for row, (targets, placed) in enumerate(zip(graph.num_targets, graph.num_placed, strict=True)):
        settled = slice(0, int(targets + placed))
        nodes[row, settled, :3] = turn.points(graph.nodes[row, settled, :3].astype(float))
        ids = np.array([-1 - sides[-1 - n] for n in graph.object_id[row, :targets].tolist()])
        order = np.argsort(-ids, kind="stable")
        nodes[row, :targets] = nodes[row, :targets][order]
        object_id[row, :targets] = ids[order]
    return turn


def from_pixels(pixels: np.ndarray) -> np.ndarray:
    """Inverse of :func:`learn2assemble.tasks.world.coverage.to_pixels`."""
    padded = np.zeros((*pixels.shape[:-1], 64 * WORDS), bool)
    padded[..., : pixels.shape[-1]] = pixels
    return np.packbits(padded, -1, "little").view("<u8").astype(np.uint64)


# ---------------------------------------------------------------- of the search


class Edge(NamedTuple):
    """One action: its Q-value, its reward, and where it leads (``None``: the end)."""

    q: float
    reward: float
    to: str | None


class TreeModel:
    """A :class:`SearchModel` over a written-out tree; a batch is an array of state names."""

    def __init__(self, edges: dict[str, list[Edge]], discount: float = 0.5) -> None:
        self.edges, self.discount = edges, discount
        self.groups: dict[str, list[int]] = {}
        """By state, where several of its actions lead to the same structure."""

    def take(self, states: np.ndarray, rows: np.ndarray) -> np.ndarray:
        return states[rows].copy()

    def join(self, states: list[np.ndarray]) -> np.ndarray:
        return np.concatenate(states)

    def step(self, states: np.ndarray, actions: np.ndarray) -> StepResult:
        taken = [self.edges[s][a[0] - 7] for s, a in zip(states, actions, strict=True)]
        return StepResult(
            np.array([edge.to for edge in taken], object),
            np.array([edge.reward for edge in taken], float),
            np.array([edge.to is None for edge in taken], bool),
        )

    def action_values(self, states: np.ndarray) -> list[ActionValues]:
        out = []
        for name in states:
            q = np.array([edge.q for edge in self.edges[name]])
            # Numbered from 7, so that an action is not mistaken for its place in the list.
            actions = np.stack([7 + np.arange(len(q)), 0 * q, 0 * q], -1).astype(np.int64)
            group = np.array(self.groups.get(name, range(len(q))), np.int64)
            out.append(ActionValues(actions, q, group))
        return out

    def legal(self, states: np.ndarray) -> list[ActionValues]:
        return [v._replace(values=0 * v.values) for v in self.action_values(states)]

    def random_actions(self, states: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return np.array([rng.choice(v.actions) for v in self.action_values(states)])

    def best(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = self.action_values(states)
        place = [int(np.argmax(v.values)) for v in values]
        return (
            np.array([v.values[n] for v, n in zip(values, place, strict=True)]),
            np.array([v.actions[n] for v, n in zip(values, place, strict=True)]),
        )


def root(*names: str) -> np.ndarray:
    return np.array(names or ("root",), object)


def decide(model: Any, seed: int = 0, **arguments: Any) -> SearchResult:
    """One decision at ``root``; without chance unless asked for."""
    config = SearchConfig(**{"epsilon": 0.0, **arguments})
    return search(model, root(), config, np.random.default_rng(seed))[0]


def explored(decision: SearchResult) -> dict[int, tuple[float, int]]:
    """Value and visits of every explored root action, by its place in the list."""
    return {number - 7: found for number, found in explored_actions(decision).items()}


def explored_actions(decision: SearchResult) -> dict[int, tuple[float, int]]:
    """The same by the first number of the action."""
    return {int(a[0]): (round(v, 9), n) for a, v, n in decision.explored()}


THREE = TreeModel(
    {
        "root": [Edge(0.9, 0.0, "A"), Edge(0.5, 1.0, None), Edge(0.1, 0.5, "C")],
        "A": [Edge(0.4, 0.25, None), Edge(0.2, 1.0, "A2")],
        "A2": [Edge(3.0, 0.0, None)],
        "C": [Edge(2.0, 0.1, "C2")],
        "C2": [Edge(0.7, -1.0, None), Edge(0.6, 0.3, None)],
    }
)


def random_tree(seed: int, discount: float = 0.8, width: int = 3, depth: int = 4) -> TreeModel:
    """A tree of up to ``width`` actions a state, with values that never tie."""
    rng = np.random.default_rng(seed)
    edges: dict[str, list[Edge]] = {}

    def grow(name: str, level: int) -> None:
        edges[name] = []
        for number in range(int(rng.integers(1, width + 1))):
            to = None if level == depth or rng.random() < 0.3 else f"{name}.{number}"
            edges[name].append(Edge(float(rng.normal()), float(rng.normal()), to))
            if to is not None:
                grow(to, level + 1)

    grow("root", 1)
    return TreeModel(edges, discount)


def greedy_return(model: TreeModel, state: str, action: int, steps: int) -> float:
    """Return of ``action`` and greedy play, bootstrapped after ``steps`` steps."""
    edge = model.edges[state][action]
    if edge.to is None:
        return edge.reward
    q = [e.q for e in model.edges[edge.to]]
    if steps == 1:
        return edge.reward + model.discount * max(q)
    follow = greedy_return(model, edge.to, int(np.argmax(q)), steps - 1)
    return edge.reward + model.discount * follow


def best_return(model: TreeModel, state: str) -> tuple[float, int]:
    """Largest return by exhaustive enumeration, and the action that starts it."""
    values = []
    for edge in model.edges[state]:
        later = 0.0 if edge.to is None else model.discount * best_return(model, edge.to)[0]
        values.append(edge.reward + later)
    return max(values), int(np.argmax(values))


def size(node: TreeNode) -> int:
    return sum(1 + size(child) for child in node.children.values())
