"""The search tree of one decision, and what a search needs to know about the world."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import groupby
from typing import Any, NamedTuple, Protocol

import numpy as np


class ActionValues(NamedTuple):
    """The legal actions of one state and their prior values."""

    actions: np.ndarray
    """int64[A, 3]."""
    values: np.ndarray
    """float64[A]: Q(s, a)."""
    group: np.ndarray
    """int64[A]: actions with the same number lead to the same structure."""

    def distinct(self) -> ActionValues:
        """The action of largest value of every group."""
        order = np.argsort(-self.values, kind="stable")
        _, first = np.unique(self.group[order], return_index=True)
        keep = np.sort(order[first])
        return ActionValues(self.actions[keep], self.values[keep], self.group[keep])


class StepResult(NamedTuple):
    """Outcome of one simulated action per state."""

    states: Any
    """The successor states, in the model's own form."""
    reward: np.ndarray
    """float64[B]."""
    terminal: np.ndarray
    """bool[B]."""


class SearchModel(Protocol):
    """A batched model of the world: snapshots, exact steps and value estimates.

    ``states`` is whatever the model uses for a batch of snapshots; the search only passes it on.
    """

    discount: float

    def take(self, states: Any, rows: np.ndarray) -> Any:
        """Independent copies of some rows."""
        ...

    def join(self, states: list[Any]) -> Any:
        """One batch made of several."""
        ...

    def step(self, states: Any, actions: np.ndarray) -> StepResult:
        """Successors of ``states`` (left unchanged) under ``actions`` int64[B, 3]."""
        ...

    def action_values(self, states: Any) -> list[ActionValues]:
        """Legal actions and Q-values of every row."""
        ...

    def legal(self, states: Any) -> list[ActionValues]:
        """The same with values of 0, without looking at any estimate."""
        ...

    def random_actions(self, states: Any, rng: np.random.Generator) -> np.ndarray:
        """A uniform legal action for every row: int64[B, 3]."""
        ...

    def best(self, states: Any) -> tuple[np.ndarray, np.ndarray]:
        """Largest Q of every row and its action: float64[B], int64[B, 3]."""
        ...


def _nothing() -> np.ndarray:
    return np.empty(0)


@dataclass
class TreeNode:
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
    children: dict[int, TreeNode] = field(default_factory=dict[int, "TreeNode"])
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
    order: np.ndarray = field(default_factory=_nothing)
    """See :attr:`tried`."""

    def open(self, legal: ActionValues) -> None:
        """Learn which actions there are."""
        self.legal = legal
        self.estimates = np.array(legal.values, np.float64)
        self.counts = np.zeros(len(legal.values), np.int64)
        self.simulated = np.zeros(len(legal.values), np.int64)

    def note(self, child: TreeNode) -> None:
        """Take over the statistics of a child that has changed."""
        self.estimates[child.key] = child.value
        self.counts[child.key] = child.visits
        self.simulated[child.key] = child.visits - (child.prior is not None)

    @property
    def value(self) -> float:
        """Estimate of the return from taking the action that led here: ``total / visits``."""
        return self.total / self.visits

    @property
    def tried(self) -> np.ndarray:
        """int64[C]: keys of the children, the first one tried first."""
        if len(self.order) != len(self.children):
            self.order = np.fromiter(self.children, np.int64, len(self.children))
        return self.order

    @property
    def fully_expanded(self) -> bool:
        return self.legal is not None and len(self.children) == len(self.legal.values)

    @property
    def actions(self) -> ActionValues:
        """``legal`` of a node that has been opened."""
        assert self.legal is not None
        return self.legal


def gather(model: SearchModel, nodes: list[TreeNode]) -> Any:
    """The states of ``nodes`` as one batch; neighbours in one batch are taken together."""
    places = [node.state for node in nodes if node.state is not None]
    assert len(places) == len(nodes)
    parts: list[Any] = []
    for _, run in groupby(places, key=lambda place: id(place[0])):
        batch, rows = zip(*run, strict=True)
        parts.append(model.take(batch[0], np.array(rows)))
    return model.join(parts)


def back_up(
    path: list[TreeNode], child: TreeNode, value: float, discount: float, rule: str
) -> None:
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
