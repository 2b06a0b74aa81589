"""A search model over written-out trees, and what tests of the search read off."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch

from learn2assemble.tasks.search.config import SearchConfig
from learn2assemble.tasks.search.mcts import SearchResult, search
from learn2assemble.tasks.search.tree import ActionValues, StepResult, TreeNode

torch.set_num_threads(1)


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
