"""Replay memory: a ring of transitions as plain arrays, and the symmetries applied to them.

Without a robot, mirror images and exchanged sides are equivalent (deviation D7). They act on
targets and placed blocks only: where blocks wait changes nothing about what is valid or covered.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.graph.features import Graph
from learn2assemble.world.blocks import EDGE
from learn2assemble.world.outcomes import Outcomes

_COUNTS = ("num_targets", "num_placed", "num_nodes")


class Searched(NamedTuple):
    """What the searches before the actions found at their roots."""

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
    outcomes: Outcomes | None = None
    """Outcome of every distinct placement of ``graph``, in the order of
    :func:`learn2assemble.graph.placements.distinct_placements`; ``None`` where not used."""
    searched: Searched | None = None
    """``None`` for learners without search."""


class Replay:
    """A ring of ``size`` transitions.

    Args:
        num_nodes: N, nodes of a graph.
        worlds: transitions of one :meth:`add`; the same world follows itself at this distance.
        outcomes: whether transitions carry :class:`Outcomes`.
        explored: E, root actions a search explores at most; 0 for learners without search.
    """

    def __init__(
        self,
        size: int,
        num_nodes: int,
        *,
        worlds: int,
        outcomes: bool = False,
        explored: int = 0,
    ) -> None:
        self.size, self.length, self.cursor = size, 0, 0
        self.worlds, self.outcomes, self.explored = worlds, outcomes, explored
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
        if outcomes:
            self.arrays["outcome.reward"] = np.zeros((size, 64), np.float16)
            self.arrays["outcome.flags"] = np.zeros((size, 64), np.uint8)
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
        if self.outcomes:
            assert batch.outcomes is not None
            self._store_outcomes(where, batch.outcomes)
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
        return Batch(
            self._graph("", rows), a["action"][rows], reward, a["terminal"][last],
            self._graph("next_", last), discount, a["greedy"][rows],
            self._outcomes(rows), self._searched(rows),
        )  # fmt: skip

    def _store_outcomes(self, where: np.ndarray, outcomes: Outcomes) -> None:
        count = outcomes.reward.shape[1]
        while count > self.arrays["outcome.reward"].shape[1]:
            for name in ("outcome.reward", "outcome.flags"):
                self.arrays[name] = np.tile(self.arrays[name], 2)
        self.arrays["outcome.reward"][where, :count] = outcomes.reward
        self.arrays["outcome.flags"][where, :count] = outcomes.terminal + 2 * outcomes.valid

    def _outcomes(self, rows: np.ndarray) -> Outcomes | None:
        if not self.outcomes:
            return None
        reward = self.arrays["outcome.reward"][rows].astype(np.float32)
        flags = self.arrays["outcome.flags"][rows]
        # The gain is not kept: learning does not use it.
        return Outcomes(reward, (flags & 1) > 0, (flags & 2) > 0, np.zeros_like(reward))

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
        for name in self.arrays:
            values = arrays[f"replay.{name}"]
            self.length = len(values)
            # Arrays of outcomes may have grown since.
            self.arrays[name] = np.zeros((self.size, *values.shape[1:]), values.dtype)
            self.arrays[name][: self.length] = values
        self.cursor = cursor


MIRROR = np.array([0, 2, 1, 3, 4])
"""Relative actions under x -> -x: left and right exchange."""
EXCHANGE = np.array([0, 1, 2, 4, 3])
"""Relative actions under y -> c - y: front and behind exchange."""
_MIRRORED_SIDES, _EXCHANGED_SIDES = np.array([0, 1, 3, 2]), np.array([1, 0, 2, 3])
"""Which side each side becomes."""
_MIDDLE = {2: EDGE, 4: 2 * EDGE}
"""c for the structures that exchange maps onto themselves."""


def random_symmetry(batch: Batch, num_sides: int, rng: np.random.Generator) -> Batch:
    """Apply to every transition its own random symmetry of a structure with ``num_sides`` sides."""
    count = len(batch.reward)
    mirror = rng.random(count) < 0.5
    exchange = (rng.random(count) < 0.5) & (num_sides in _MIDDLE)
    middle = _MIDDLE.get(num_sides, 0.0)
    action = batch.action.copy()
    for chosen, permutation in ((mirror, MIRROR), (exchange, EXCHANGE)):
        action[chosen, 2] = permutation[action[chosen, 2]]

    searched = batch.searched
    if searched is not None:
        explored = searched.action.copy()
        for chosen, permutation in ((mirror, MIRROR), (exchange, EXCHANGE)):
            explored[chosen, :, 2] = permutation[explored[chosen, :, 2]]
        searched = searched._replace(action=explored)

    def turn(graph: Graph) -> Graph:
        nodes = graph.nodes.copy()
        settled = np.arange(nodes.shape[1]) < (graph.num_targets + graph.num_placed)[:, None]
        x, y = nodes[..., 0], nodes[..., 1]
        nodes[..., 0] = np.where(settled & mirror[:, None], -x, x)
        nodes[..., 1] = np.where(settled & exchange[:, None], middle - y, y)
        object_id = graph.object_id.copy()
        vertex = np.arange(nodes.shape[1]) < graph.num_targets[:, None]
        for chosen, permutation in ((mirror, _MIRRORED_SIDES), (exchange, _EXCHANGED_SIDES)):
            turned = vertex & chosen[:, None]
            object_id[turned] = -1 - permutation[-1 - object_id[turned]]
        return graph._replace(nodes=nodes, object_id=object_id)

    return batch._replace(
        graph=turn(batch.graph), next_graph=turn(batch.next_graph), action=action,
        searched=searched,
    )  # fmt: skip
