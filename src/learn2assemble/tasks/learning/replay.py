"""Replay memory: a ring of transitions as plain arrays, and the symmetries applied to them.

Without a robot, mirror images and exchanged sides are equivalent (deviation D7). They act on
targets and placed blocks only: where blocks wait changes nothing about what is valid or covered.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from learn2assemble.constants import EDGE
from learn2assemble.tasks.graph.features import Graph
from learn2assemble.tasks.world.outcomes import Outcomes

_COUNTS = ("num_targets", "num_placed", "num_nodes")


class Searched(NamedTuple):
    """What the searches before the actions found at their roots."""

    action: np.ndarray
    """int64[B, E, 3]: explored root actions as node indices; zeros beyond ``count``."""
    value: np.ndarray
    """float32[B, E]: Q_S, their mean values when they were collected."""
    count: np.ndarray  # pyright: ignore[reportIncompatibleMethodOverride]
    """int64[B]: explored actions; 0 where no search took place."""


class Batch(NamedTuple):
    """Transitions, and what other actions would have brought."""

    graph: Graph
    action: np.ndarray
    """int64[B, 3]: node indices of block and reference, relative action."""
    reward: np.ndarray
    """float32[B]."""
    terminal: np.ndarray
    """bool[B]: nothing follows."""
    next_graph: Graph
    discount: np.ndarray
    """float32[B]: gamma, of what follows ``next_graph``."""
    outcomes: Outcomes | None = None
    """Outcome of every distinct placement of ``graph``, in the order of
    :func:`learn2assemble.tasks.graph.placements.distinct_placements`; ``None`` where not used."""
    searched: Searched | None = None
    """``None`` for learners without search."""


class Replay:
    """A ring of ``size`` transitions.

    Args:
        num_nodes: N, nodes of a graph.
        outcomes: whether transitions carry :class:`Outcomes`.
        explored: E, root actions a search explores at most; 0 for learners without search.
    """

    def __init__(
        self, size: int, num_nodes: int, *, outcomes: bool = False, explored: int = 0
    ) -> None:
        self.size = size
        self.length: int = 0
        self.cursor: int = 0
        columns: dict[str, tuple[Any, ...]] = {
            "action": (np.int64, 3),
            "reward": (np.float32,),
            "terminal": (np.bool_,),
            "discount": (np.float32,),
        }
        for prefix in ("", "next_"):
            columns[f"{prefix}position"] = np.float32, num_nodes, 3
            columns[f"{prefix}object_id"] = np.int16, num_nodes
            columns |= {prefix + name: (np.int16,) for name in _COUNTS}
        if outcomes:
            columns |= {"outcome.reward": (np.float16, 64), "outcome.flags": (np.uint8, 64)}
        if explored:
            columns |= {
                "searched.action": (np.int16, explored, 3),
                "searched.value": (np.float32, explored),
                "searched.count": (np.int16,),
            }
        self.arrays: dict[str, np.ndarray] = {
            name: np.zeros((size, *shape), kind) for name, (kind, *shape) in columns.items()
        }

    def add(self, batch: Batch) -> None:
        """Append transitions, overwriting the oldest."""
        count = len(batch.reward)
        where = (self.cursor + np.arange(count)) % self.size
        for name, values in _columns(batch).items():
            if name.startswith("outcome."):
                while values.shape[1] > self.arrays[name].shape[1]:
                    self.arrays[name] = np.tile(self.arrays[name], 2)
                self.arrays[name][where, : values.shape[1]] = values
            else:
                self.arrays[name][where] = values
        self.cursor = int((self.cursor + count) % self.size)
        self.length = min(self.length + count, self.size)

    def sample(self, count: int, rng: np.random.Generator) -> Batch:
        """``count`` transitions, uniformly with replacement."""
        rows = rng.integers(0, self.length, count)
        a = self.arrays
        outcomes = searched = None
        if "outcome.flags" in a:
            values, flags = a["outcome.reward"][rows].astype(np.float32), a["outcome.flags"][rows]
            # The gain is not kept: learning does not use it.
            outcomes = Outcomes(values, (flags & 1) > 0, (flags & 2) > 0, np.zeros_like(values))
        if "searched.count" in a:
            action, value, explored = (a[f"searched.{name}"][rows] for name in Searched._fields)
            searched = Searched(action.astype(np.int64), value, explored.astype(np.int64))
        return Batch(
            self._graph("", rows),
            a["action"][rows],
            a["reward"][rows],
            a["terminal"][rows],
            self._graph("next_", rows),
            a["discount"][rows],
            outcomes,
            searched,
        )

    def _graph(self, prefix: str, rows: np.ndarray) -> Graph:
        position = self.arrays[f"{prefix}position"][rows]
        object_id = self.arrays[f"{prefix}object_id"][rows].astype(np.int32)
        targets, placed, used = (self.arrays[prefix + n][rows].astype(np.int64) for n in _COUNTS)
        index = np.arange(int(position.shape[1]))
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


def _columns(batch: Batch) -> dict[str, np.ndarray]:
    """What is kept of transitions, by the names of the arrays."""
    names = ("action", "reward", "terminal", "discount")
    out = {name: getattr(batch, name) for name in names}
    for prefix, graph in (("", batch.graph), ("next_", batch.next_graph)):
        out[f"{prefix}position"] = graph.nodes[..., :3]
        out |= {prefix + name: getattr(graph, name) for name in ("object_id", *_COUNTS)}
    if batch.outcomes is not None:
        reward, terminal, valid, _ = batch.outcomes
        out |= {"outcome.reward": reward, "outcome.flags": terminal + 2 * valid}
    if batch.searched is not None:
        out |= {f"searched.{name}": value for name, value in batch.searched._asdict().items()}
    return out


MIRROR, MIRRORED_SIDES = np.array([0, 2, 1, 3, 4]), np.array([0, 1, 3, 2])
"""Relative actions and sides under x -> -x: left and right exchange."""
EXCHANGE, EXCHANGED_SIDES = np.array([0, 1, 2, 4, 3]), np.array([1, 0, 2, 3])
"""The same under y -> c - y: front and behind exchange."""
_MIDDLE = {2: EDGE, 4: 2 * EDGE}
"""c for the structures that exchange maps onto themselves."""


def random_symmetry(batch: Batch, num_sides: int, rng: np.random.Generator) -> Batch:
    """Apply to every transition its own random symmetry of a structure with ``num_sides`` sides."""
    count = len(batch.reward)
    mirror = rng.random(count) < 0.5
    exchange = (rng.random(count) < 0.5) & (num_sides in _MIDDLE)
    middle = _MIDDLE.get(num_sides, 0.0)
    searched = batch.searched

    def act(action: np.ndarray) -> np.ndarray:
        action = action.copy()
        for chosen, permutation in ((mirror, MIRROR), (exchange, EXCHANGE)):
            action[chosen, ..., 2] = permutation[action[chosen, ..., 2]]
        return action

    def turn(graph: Graph) -> Graph:
        nodes = graph.nodes.copy()
        settled = np.arange(int(nodes.shape[1])) < (graph.num_targets + graph.num_placed)[:, None]
        x, y = nodes[..., 0], nodes[..., 1]
        nodes[..., 0] = np.where(settled & mirror[:, None], -x, x)
        nodes[..., 1] = np.where(settled & exchange[:, None], middle - y, y)
        object_id = graph.object_id.copy()
        vertex = np.arange(int(nodes.shape[1])) < graph.num_targets[:, None]
        for chosen, permutation in ((mirror, MIRRORED_SIDES), (exchange, EXCHANGED_SIDES)):
            turned = vertex & chosen[:, None]
            object_id[turned] = -1 - permutation[-1 - object_id[turned]]
        return graph._replace(nodes=nodes, object_id=object_id)

    return batch._replace(
        graph=turn(batch.graph),
        next_graph=turn(batch.next_graph),
        action=act(batch.action),
        searched=searched and searched._replace(action=act(searched.action)),
    )
