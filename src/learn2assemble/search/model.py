"""What a search needs to know about the world it searches."""

from __future__ import annotations

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

    def batch_size(self, states: Any) -> int: ...

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

    def random_actions(self, states: Any, rng: np.random.Generator) -> np.ndarray:
        """A uniform legal action for every row: int64[B, 3]."""
        ...

    def best(self, states: Any) -> tuple[np.ndarray, np.ndarray]:
        """Largest Q of every row and its action: float64[B], int64[B, 3]."""
        ...
