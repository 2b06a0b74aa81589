"""The search tree of one decision (protocol 11)."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import numpy as np

from learn2assemble.search.model import ActionValues, SearchModel


def _nothing() -> np.ndarray:
    return np.empty(0)


@dataclass
class Node:
    """A state reached in the search, and the action that led to it."""

    state: tuple[Any, int] | None
    """A batch of snapshots and the row of this one; ``None`` for an end."""
    reward: float = 0.0
    """Reward of the action that led here."""
    terminal: bool = False
    legal: ActionValues | None = None
    """Filled by :meth:`open` when a walk first comes here."""
    key: int = -1
    """Number of this node among the actions of its parent."""
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
    estimates: np.ndarray = field(default_factory=_nothing)
    """float64[A]: value of every action: of the child where tried, else Q (completed Q-values)."""
    counts: np.ndarray = field(default_factory=_nothing)
    """int64[A]: visits of every child, 0 where there is none."""
    simulated: np.ndarray = field(default_factory=_nothing)
    """int64[A]: the same without visits that are only a prior."""

    def open(self, legal: ActionValues) -> None:
        """Learn which actions there are."""
        self.legal = legal
        self.estimates = np.array(legal.values, np.float64)
        self.counts = np.zeros(len(legal.values), np.int64)
        self.simulated = np.zeros(len(legal.values), np.int64)

    def note(self, child: Node) -> None:
        """Take over the statistics of a child that has changed."""
        self.estimates[child.key] = child.value
        self.counts[child.key] = child.visits
        self.simulated[child.key] = child.visits - (child.prior is not None)

    @property
    def value(self) -> float:
        """Estimate of the return from taking the action that led here: ``total / visits``."""
        return self.total / self.visits

    @property
    def fully_expanded(self) -> bool:
        return self.legal is not None and len(self.children) == len(self.legal.values)

    @property
    def actions(self) -> ActionValues:
        """``legal`` of a node that has been opened."""
        assert self.legal is not None
        return self.legal


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
    path[-1].note(child)
    done = child.done
    for node, parent in zip(reversed(path), [*reversed(path[:-1]), None], strict=True):
        node.visits += 1
        node.below += 1
        done = done and node.fully_expanded and all(c.done for c in node.children.values())
        node.done = done
        if parent is None:
            node.total += value
            return
        value = node.reward + discount * value
        node.total += value
        if rule == "max":
            best = node.reward + discount * float(node.estimates.max())
            mean = best if node.prior is None else (node.prior + best) / 2
            node.total = mean * node.visits
        parent.note(node)
