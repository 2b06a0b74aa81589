"""Node features of a batch of states as plain arrays (paper section 2.1, appendix A.2)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from learn2assemble.constants import HALF
from learn2assemble.kernels import kernel
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
    all_nodes: np.ndarray,
    all_ids: np.ndarray,
    counts: np.ndarray,
) -> None:
    """Write the graph of one row into arrays of all rows, see :class:`Graph`.

    Args:
        counts: int64[3, B]: targets, placed blocks, nodes.
    """
    nodes, object_id = all_nodes[row], all_ids[row]
    n = 0
    for side in range(frames.shape[0]):
        c, s, tx, ty = frames[side, 0], frames[side, 1], frames[side, 2], frames[side, 3]
        for k in range(state.num_vertices[row, side]):
            x, y = state.vertices[row, side, k, 0], -HALF
            nodes[n, 0] = c * x - s * y + tx
            nodes[n, 1] = s * x + c * y + ty
            nodes[n, 2] = state.vertices[row, side, k, 1]
            nodes[n, 3] = 1.0
            nodes[n, 4] = 1.0
            object_id[n] = -1 - side
            n += 1
    placed = state.num_placed[row]
    counts[0, row], counts[1, row], counts[2, row] = n, placed, n + state.num_blocks[row]
    for k in range(state.num_blocks[row]):
        for axis in range(3):
            nodes[n, axis] = state.position[row, k, axis]
        nodes[n, 3] = 1.0 if k < placed else -1.0
        nodes[n, 4] = -1.0
        object_id[n] = state.object_id[row, k]
        n += 1
    for k in range(n, nodes.shape[0]):
        for f in range(nodes.shape[1]):
            nodes[k, f] = np.float32(0)
        object_id[k] = -1


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
