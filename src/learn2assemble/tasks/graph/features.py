"""Node features of a batch of states as plain arrays (paper section 2.1, appendix A.2)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from learn2assemble.kernels import kernel
from learn2assemble.tasks.world.rules import observe_row
from learn2assemble.tasks.world.state import State

NUM_FEATURES = 5
POSITION = slice(0, 3)


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
def graph_row(
    state: State,
    row: int,
    frames: np.ndarray,
    nodes: np.ndarray,
    object_id: np.ndarray,
    counts: np.ndarray,
) -> None:
    """Write the graph of one row into arrays of all rows.

    Args:
        counts: int64[3, B]: targets, placed blocks, nodes.
    """
    counts[0, row] = state.num_vertices[row].sum()
    counts[1, row] = state.num_placed[row]
    counts[2, row] = observe_row(state, row, frames, nodes[row], object_id[row])


@kernel
def _build(
    state: State,
    frames: np.ndarray,
    nodes: np.ndarray,
    object_id: np.ndarray,
    counts: np.ndarray,
) -> None:
    for row in range(len(nodes)):
        graph_row(state, row, frames, nodes, object_id, counts)


def empty_graph(batch: int, num_nodes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Arrays for :func:`graph_row`: nodes, object numbers and counts, which make a graph."""
    return (
        np.empty((batch, num_nodes, NUM_FEATURES), np.float32),
        np.empty((batch, num_nodes), np.int32),
        np.empty((3, batch), np.int64),
    )


def build_graph(state: State, frames: np.ndarray, num_nodes: int) -> Graph:
    """Graphs of all rows, padded to ``num_nodes`` nodes.

    Args:
        frames: float64[S, 4] of :func:`learn2assemble.tasks.world.layouts.side_frames`.
    """
    nodes, object_id, counts = empty_graph(state.batch_size, num_nodes)
    _build(state, frames, nodes, object_id, counts)
    return Graph(nodes, object_id, counts[0], counts[1], counts[2])


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
        index = np.arange(int(graph.nodes.shape[1]))
    used = index < graph.num_nodes[:, None]
    pairs = used[:, :, None] & used[:, None, :]
    if kind == "partial":
        settled = index < (graph.num_targets + graph.num_placed)[:, None]
        same = graph.object_id[:, :, None] == graph.object_id[:, None, :]
        pairs = pairs & (settled[:, :, None] | settled[:, None, :] | same)
    return pairs
