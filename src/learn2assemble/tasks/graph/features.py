"""Node features of a batch of states as plain arrays (paper section 2.1, appendix A.2)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from learn2assemble.kernels import kernel
from learn2assemble.tasks.world.rules import observe_row
from learn2assemble.tasks.world.state import State

NUM_FEATURES = 5
POSITION = slice(0, 3)
PLACED_FLAG, TARGET_FLAG = 3, 4


class Graph(NamedTuple):
    """A batch of graphs with up to N nodes: targets first, then placed, then unplaced blocks."""

    nodes: np.ndarray
    """float32[B, N, 5]: x, y, z [m, world], placed flag, target flag (+-1); zeros are padding."""
    object_id: np.ndarray
    """int32[B, N]: nodes with the same number >= 0 are cells of one object; vertices of side s have
    -1 - s, padding -1."""
    num_targets: np.ndarray
    """int64[B]."""
    num_placed: np.ndarray
    """int64[B]."""
    num_nodes: np.ndarray
    """int64[B]: nodes in use."""

    def take(self, rows: np.ndarray) -> Graph:
        return Graph(*[field[rows] for field in self])


@kernel
def _build(state, frames, nodes, object_id, num_nodes):
    for row in range(len(num_nodes)):
        num_nodes[row] = observe_row(state, row, frames, nodes[row], object_id[row])


def build_graph(state: State, frames: np.ndarray, num_nodes: int) -> Graph:
    """Graphs of all rows, padded to ``num_nodes`` nodes.

    Args:
        frames: float64[S, 4] of :func:`learn2assemble.tasks.world.layouts.side_frames`.
    """
    batch = state.batch_size
    nodes = np.empty((batch, num_nodes, NUM_FEATURES), np.float32)
    object_id = np.empty((batch, num_nodes), np.int32)
    used = np.empty(batch, np.int64)
    _build(state, frames, nodes, object_id, used)
    return Graph(nodes, object_id, state.num_targets, state.num_placed.copy(), used)


def node_offset(graph: Graph) -> np.ndarray:
    """Node index of the first unplaced and of the first placed block, and 0: int64[B, 3].

    Added to the numbers of an action within its groups, it gives the node action.
    """
    first = graph.num_targets + graph.num_placed
    return np.stack([first, graph.num_targets, 0 * first], -1)


def connectivity(graph: Any, kind: str = "partial", index: Any = None) -> Any:
    """Adjacency bool[B, N, N]; row i lists the nodes that node i attends to.

    ``full``: everyone. ``partial``: targets and placed blocks attend to everyone, an unplaced
    block to targets, placed blocks, itself and the cells of its own object.

    Args:
        graph: a :class:`Graph`, or the same as tensors.
        index: int64[N], 0 to N - 1, as such a tensor.
    """
    if index is None:
        index = np.arange(graph.nodes.shape[1])
    used = index < graph.num_nodes[:, None]
    pairs = used[:, :, None] & used[:, None, :]
    if kind == "partial":
        settled = index < (graph.num_targets + graph.num_placed)[:, None]
        same = graph.object_id[:, :, None] == graph.object_id[:, None, :]
        pairs = pairs & (settled[:, :, None] | settled[:, None, :] | same)
    return pairs
