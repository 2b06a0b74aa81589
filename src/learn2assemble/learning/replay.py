"""Replay memory: a ring of transitions as plain arrays (protocol 10.1)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.graph.features import Graph

GRAPH_FIELDS = ("position", "object_id", "num_targets", "num_placed", "num_nodes")


class Batch(NamedTuple):
    """Transitions drawn from the memory."""

    graph: Graph
    action: np.ndarray
    """int64[B, 3]: node indices of block and reference, relative action."""
    reward: np.ndarray
    """float32[B]."""
    absorbing: np.ndarray
    """bool[B]: nothing follows."""
    next_graph: Graph
    valid: np.ndarray
    """bool[B, M, Na]: placements (reference, action) that static physics allows, before."""


class Replay:
    """A ring of ``size`` transitions of graphs with ``num_nodes`` nodes and ``blocks`` blocks."""

    def __init__(self, size: int, num_nodes: int, blocks: int, num_actions: int) -> None:
        self.size, self.length, self.cursor = size, 0, 0
        self.arrays: dict[str, np.ndarray] = {
            "action": np.zeros((size, 3), np.int64),
            "reward": np.zeros(size, np.float32),
            "absorbing": np.zeros(size, np.bool_),
            "valid": np.zeros((size, blocks, num_actions), np.bool_),
        }
        for prefix in ("", "next_"):
            self.arrays[prefix + "position"] = np.zeros((size, num_nodes, 3), np.float32)
            self.arrays[prefix + "object_id"] = np.zeros((size, num_nodes), np.int16)
            for name in GRAPH_FIELDS[2:]:
                self.arrays[prefix + name] = np.zeros(size, np.int16)

    def add(self, batch: Batch) -> None:
        """Append transitions, overwriting the oldest."""
        count = len(batch.reward)
        where = (self.cursor + np.arange(count)) % self.size
        for prefix, graph in (("", batch.graph), ("next_", batch.next_graph)):
            values = (graph.nodes[..., :3], *graph[1:])
            for name, value in zip(GRAPH_FIELDS, values, strict=True):
                self.arrays[prefix + name][where] = value
        for name in ("action", "reward", "absorbing", "valid"):
            self.arrays[name][where] = getattr(batch, name)
        self.cursor = int((self.cursor + count) % self.size)
        self.length = min(self.length + count, self.size)

    def sample(self, count: int, rng: np.random.Generator) -> Batch:
        """``count`` transitions, uniformly with replacement."""
        rows = rng.integers(0, self.length, count)
        a = self.arrays
        return Batch(
            self._graph("", rows), a["action"][rows], a["reward"][rows], a["absorbing"][rows],
            self._graph("next_", rows), a["valid"][rows],
        )  # fmt: skip

    def _graph(self, prefix: str, rows: np.ndarray) -> Graph:
        position, object_id, targets, placed, used = (
            self.arrays[prefix + name][rows] for name in GRAPH_FIELDS
        )
        index = np.arange(position.shape[1])
        in_use = index < used[:, None]
        nodes = np.zeros((*position.shape[:2], 5), np.float32)
        nodes[..., :3] = position
        nodes[..., 3] = np.where(index < (targets + placed)[:, None], 1, -1) * in_use
        nodes[..., 4] = np.where(index < targets[:, None], 1, -1) * in_use
        counts = (targets.astype(np.int64), placed.astype(np.int64), used.astype(np.int64))
        return Graph(nodes, object_id.astype(np.int32), *counts)

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
