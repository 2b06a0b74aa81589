"""Replay memory: a ring of transitions as plain arrays (protocol 10.1)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.graph.features import Graph
from learn2assemble.world.prospects import Prospects

_COUNTS = ("num_targets", "num_placed", "num_nodes")


class Searched(NamedTuple):
    """What the searches before the actions found at their roots (protocol 10.4)."""

    action: np.ndarray
    """int64[B, E, 3]: explored root actions as node indices; zeros beyond ``count``."""
    value: np.ndarray
    """float32[B, E]: Q_S, their mean values when they were collected."""
    count: np.ndarray
    """int64[B]: explored actions; 0 where no search took place."""


class Batch(NamedTuple):
    """Transitions, and what other actions would have brought."""

    graph: Graph
    action: np.ndarray
    """int64[B, 3]: node indices of block and reference, relative action."""
    reward: np.ndarray
    """float32[B]: discounted over the steps up to ``next_graph`` (one, unless n-step)."""
    terminal: np.ndarray
    """bool[B]: nothing follows."""
    next_graph: Graph
    discount: np.ndarray
    """float32[B]: of what follows ``next_graph``; gamma to the number of steps."""
    greedy: np.ndarray
    """bool[B]: the action was the network's own choice, not exploration."""
    prospects: Prospects | None
    """Outcome of every placement in ``graph``; ``None`` where the learner does not use it."""
    next_prospects: Prospects | None
    """The same in ``next_graph``; meaningless where ``next_known`` is false."""
    next_known: np.ndarray
    """bool[B]: the memory holds the prospects of ``next_graph``."""
    searched: Searched | None = None
    """``None`` for learners without search."""


class Replay:
    """A ring of ``size`` transitions.

    Args:
        num_nodes: N, nodes of a graph.
        blocks: M, placed blocks of a graph at most.
        num_actions: Na.
        worlds: transitions of one :meth:`add`; the same world follows itself at this distance.
        prospects: whether transitions carry :class:`Prospects`.
        explored: E, root actions a search explores at most; 0 for learners without search.
    """

    def __init__(
        self,
        size: int,
        num_nodes: int,
        blocks: int,
        num_actions: int,
        *,
        worlds: int,
        prospects: bool,
        explored: int = 0,
    ) -> None:
        self.size, self.length, self.cursor = size, 0, 0
        self.worlds, self.prospects, self.explored = worlds, prospects, explored
        self.arrays: dict[str, np.ndarray] = {
            "action": np.zeros((size, 3), np.int64),
            "reward": np.zeros(size, np.float32),
            "terminal": np.zeros(size, np.bool_),
            "discount": np.zeros(size, np.float32),
            "greedy": np.zeros(size, np.bool_),
        }
        for prefix in ("", "next_"):
            self.arrays[f"{prefix}position"] = np.zeros((size, num_nodes, 3), np.float32)
            self.arrays[f"{prefix}object_id"] = np.zeros((size, num_nodes), np.int16)
            for name in _COUNTS:
                self.arrays[prefix + name] = np.zeros(size, np.int16)
        if prospects:
            shape = (size, blocks, num_actions)
            self.arrays["prospects.reward"] = np.zeros(shape, np.float16)
            self.arrays["prospects.terminal"] = np.zeros(shape, np.bool_)
            self.arrays["prospects.valid"] = np.zeros(shape, np.bool_)
            self.arrays["prospects.gain"] = np.zeros(shape, np.float16)
        if explored:
            self.arrays["searched.action"] = np.zeros((size, explored, 3), np.int16)
            self.arrays["searched.value"] = np.zeros((size, explored), np.float32)
            self.arrays["searched.count"] = np.zeros(size, np.int16)

    def add(self, batch: Batch) -> None:
        """Append transitions, overwriting the oldest."""
        count = len(batch.reward)
        where = (self.cursor + np.arange(count)) % self.size
        for prefix, graph in (("", batch.graph), ("next_", batch.next_graph)):
            self.arrays[f"{prefix}position"][where] = graph.nodes[..., :3]
            self.arrays[f"{prefix}object_id"][where] = graph.object_id
            for name in _COUNTS:
                self.arrays[prefix + name][where] = getattr(graph, name)
        for name in ("action", "reward", "terminal", "discount", "greedy"):
            self.arrays[name][where] = getattr(batch, name)
        if self.prospects:
            assert batch.prospects is not None
            for name, value in batch.prospects._asdict().items():
                self.arrays[f"prospects.{name}"][where] = value
        if self.explored:
            assert batch.searched is not None
            for name, value in batch.searched._asdict().items():
                self.arrays[f"searched.{name}"][where] = value
        self.cursor = int((self.cursor + count) % self.size)
        self.length = min(self.length + count, self.size)

    def sample(self, count: int, rng: np.random.Generator, steps: int = 1) -> Batch:
        """``count`` transitions, uniformly with replacement.

        With ``steps`` > 1 each is joined with up to ``steps - 1`` that followed it in its world,
        as long as these were greedy: exploration must not lower the value of what came before.
        """
        rows = rng.integers(0, self.length, count)
        a = self.arrays
        last, reward, discount = self._follow(rows, steps)
        # The successor of a transition is where the next one of the same world starts.
        after = (last + self.worlds) % self.size
        known = ((self.cursor - 1 - last) % self.size >= self.worlds) & ~a["terminal"][last]
        return Batch(
            self._graph("", rows), a["action"][rows], reward, a["terminal"][last],
            self._graph("next_", last), discount, a["greedy"][rows],
            self._prospects(rows), self._prospects(after), known & self.prospects,
            self._searched(rows),
        )  # fmt: skip

    def _prospects(self, rows: np.ndarray) -> Prospects | None:
        if not self.prospects:
            return None
        values = {name: self.arrays[f"prospects.{name}"][rows] for name in Prospects._fields}
        return Prospects(**{
            name: value.astype(np.float32) if value.dtype == np.float16 else value
            for name, value in values.items()
        })  # fmt: skip

    def _searched(self, rows: np.ndarray) -> Searched | None:
        if not self.explored:
            return None
        action, value, count = (self.arrays[f"searched.{n}"][rows] for n in Searched._fields)
        return Searched(action.astype(np.int64), value, count.astype(np.int64))

    def _follow(self, rows: np.ndarray, steps: int) -> tuple[np.ndarray, ...]:
        """Last joined transition, discounted reward up to it and discount after it."""
        a, last = self.arrays, rows.copy()
        reward, discount = a["reward"][rows].copy(), a["discount"][rows].copy()
        newer = (self.cursor - 1 - rows) % self.size
        going = np.ones(len(rows), np.bool_)
        for ahead in range(1, steps):
            following = (rows + ahead * self.worlds) % self.size
            going &= ~a["terminal"][last] & (ahead * self.worlds <= newer) & a["greedy"][following]
            reward += np.where(going, discount * a["reward"][following], 0.0)
            discount *= np.where(going, a["discount"][following], 1.0)
            last = np.where(going, following, last)
        return last, reward, discount

    def _graph(self, prefix: str, rows: np.ndarray) -> Graph:
        position = self.arrays[f"{prefix}position"][rows]
        object_id = self.arrays[f"{prefix}object_id"][rows].astype(np.int32)
        targets, placed, used = (self.arrays[prefix + n][rows].astype(np.int64) for n in _COUNTS)
        index = np.arange(position.shape[1])
        in_use = index < used[:, None]
        nodes = np.zeros((*position.shape[:2], 5), np.float32)
        nodes[..., :3] = position
        nodes[..., 3] = np.where(index < (targets + placed)[:, None], 1, -1) * in_use
        nodes[..., 4] = np.where(index < targets[:, None], 1, -1) * in_use
        return Graph(nodes, object_id, targets, placed, used)

    def state(self) -> dict[str, np.ndarray]:
        """The part in use, for a checkpoint."""
        return {f"replay.{k}": v[: self.length] for k, v in self.arrays.items()}

    def load(self, arrays: dict[str, np.ndarray], cursor: int) -> None:
        """Inverse of :meth:`state`."""
        for name, mine in self.arrays.items():
            values = arrays[f"replay.{name}"]
            self.length = len(values)
            mine[: self.length] = values
        self.cursor = cursor
