"""The search tree of one decision (protocol 11)."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import numpy as np

from learn2assemble.search.model import ActionValues, SearchModel


@dataclass
class Node:
    """A state reached in the search, and the action that led to it."""

    state: tuple[Any, int] | None
    """A batch of snapshots and the row of this one; ``None`` for an end."""
    reward: float = 0.0
    """Reward of the action that led here."""
    terminal: bool = False
    legal: ActionValues | None = None
    """Filled when a walk first comes here."""
    children: dict[int, Node] = field(default_factory=dict)
    """By the number of the action in ``legal``."""
    visits: int = 0
    total: float = 0.0
    prior: float | None = None
    """Q of the action that led here, where it counts as a first visit."""
    below: int = 0
    """Simulations that went on from here."""
    done: bool = False
    """Whether nothing below is left to try."""
    noise: np.ndarray | None = None
    """float64[A]: Gumbel noise of a root."""

    @property
    def value(self) -> float:
        """Estimate of the return from taking the action that led here: ``total / visits``."""
        return self.total / self.visits

    @property
    def fully_expanded(self) -> bool:
        return self.legal is not None and len(self.children) == len(self.legal.values)

    @property
    def simulations(self) -> int:
        """Visits without the one that is only the prior."""
        return self.visits - (self.prior is not None)

    @property
    def actions(self) -> ActionValues:
        """``legal`` of a node that has been visited."""
        assert self.legal is not None
        return self.legal

    def estimates(self) -> np.ndarray:
        """The value of every action: that of the child where tried, else Q (completed Q-values)."""
        out = self.actions.values.copy()
        for key, child in self.children.items():
            out[key] = child.value
        return out

    def simulation_counts(self) -> np.ndarray:
        """Simulations of every action: int64[A]."""
        out = np.zeros(len(self.actions.values), np.int64)
        for key, child in self.children.items():
            out[key] = child.simulations
        return out


def gather(model: SearchModel, nodes: list[Node]) -> Any:
    """The states of ``nodes`` as one batch; neighbours in one batch are taken together."""
    places = [node.state for node in nodes if node.state is not None]
    assert len(places) == len(nodes)
    parts = []
    for _, run in groupby(places, key=lambda place: id(place[0])):
        batch, rows = zip(*run, strict=True)
        parts.append(model.take(batch[0], np.array(rows)))
    return model.join(parts)


def back_up(path: list[Node], child: Node, value: float, discount: float, rule: str) -> None:
    """Add the return ``value`` of ``child`` to it and to every node of ``path`` above it.

    With the rule ``max`` a node above is worth its reward and the discounted largest estimate
    below, averaged with the prior where there is one.
    """
    child.visits += 1
    child.total += value
    for node in reversed(path):
        value = node.reward + discount * value if node is not path[0] else value
        node.visits += 1
        node.below += 1
        node.total += value
        if rule == "max" and node is not path[0]:
            best = node.reward + discount * float(node.estimates().max())
            mean = best if node.prior is None else (node.prior + best) / 2
            node.total = mean * node.visits
    for node in reversed(path):
        if not child.done:
            break
        node.done = node.fully_expanded and all(c.done for c in node.children.values())
        child = node
