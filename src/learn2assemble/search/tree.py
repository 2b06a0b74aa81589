"""The search tree of one decision (protocol 11)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from learn2assemble.search.model import ActionValues


@dataclass
class Node:
    """A state reached in the search, and the action that led to it."""

    state: Any
    """Snapshot (a batch of one); ``None`` for an end."""
    reward: float = 0.0
    """Reward of the action that led here."""
    terminal: bool = False
    legal: ActionValues | None = None
    """Filled when the node is first expanded."""
    children: dict[int, Node] = field(default_factory=dict)
    """By the number of the action in ``legal``."""
    visits: int = 0
    total: float = 0.0

    @property
    def value(self) -> float:
        """Mean of the returns from taking the action that led here."""
        return self.total / self.visits

    @property
    def fully_expanded(self) -> bool:
        return self.legal is not None and len(self.children) == len(self.legal.values)


def epsilon_greedy_expansions(
    values: np.ndarray, tried: set[int], count: int, epsilon: float, rng: np.random.Generator
) -> list[int]:
    """Numbers of the next ``count`` untried actions to expand (protocol 11.2).

    Each draw is a uniform action with probability ``epsilon``, else the best by Q; one that has
    been tried is rejected for good and the draw repeated. The rule does not look at simulated
    results, so a whole budget can be chosen at once and simulated in one batch.
    """
    order = np.argsort(-values, kind="stable")
    open_actions = np.ones(len(values), bool)
    chosen: list[int] = []
    tried = set(tried)
    cursor = 0
    while len(chosen) < count and len(tried) < len(values):
        if rng.random() < epsilon:
            pick = int(rng.choice(np.flatnonzero(open_actions)))
        else:
            while not open_actions[order[cursor]]:
                cursor += 1
            pick = int(order[cursor])
        if pick in tried:
            open_actions[pick] = False
        else:
            tried.add(pick)
            chosen.append(pick)
    return chosen


def best_child(node: Node, rng: np.random.Generator) -> int:
    """Number of the child with the largest mean value; ties at random (protocol 11.3)."""
    keys = list(node.children)
    values = np.array([node.children[key].value for key in keys])
    ties = np.flatnonzero(values >= values.max() - 1e-12)
    return keys[int(ties[0] if len(ties) == 1 else rng.choice(ties))]
