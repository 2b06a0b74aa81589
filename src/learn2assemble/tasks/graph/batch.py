"""Graphs as tensors, and for the placement network their cells and relations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.constants import EDGE
from learn2assemble.errors import extra
from learn2assemble.tasks.graph.features import Graph, connectivity
from learn2assemble.tasks.graph.placements import Placements, distinct_placements, locate
from learn2assemble.tasks.graph.relations import look_around, relate
from learn2assemble.tasks.world.blocks import ActionSpec

with extra("torch", "learn"):
    import torch


class GraphTensors(NamedTuple):
    """:class:`Graph` on a device, with the same fields. Masks are derived from the three counts."""

    nodes: torch.Tensor
    object_id: torch.Tensor
    num_targets: torch.Tensor
    num_placed: torch.Tensor
    num_nodes: torch.Tensor

    @property
    def used(self) -> torch.Tensor:
        """bool[B, N]: nodes that are not padding."""
        return self._index() < self.num_nodes[:, None]

    @property
    def placed(self) -> torch.Tensor:
        """bool[B, N]: placed blocks, the legal references."""
        index = self._index()
        first = self.num_targets[:, None]
        return (index >= first) & (index < first + self.num_placed[:, None])

    @property
    def unplaced(self) -> torch.Tensor:
        """bool[B, N]: unplaced blocks, the legal blocks to place."""
        index = self._index()
        first = (self.num_targets + self.num_placed)[:, None]
        return (index >= first) & (index < self.num_nodes[:, None])

    def adjacency(self, kind: str) -> torch.Tensor:
        """bool[B, N, N] of :func:`learn2assemble.tasks.graph.features.connectivity`.

        Rows of padding attend to themselves only, so that their softmax is defined.
        """
        alone = torch.eye(self.nodes.shape[1], dtype=torch.bool, device=self.nodes.device)
        return connectivity(self, kind, self._index()) | alone

    def _index(self) -> torch.Tensor:
        return torch.arange(self.nodes.shape[1], device=self.nodes.device)


def tensor_of(array: np.ndarray) -> torch.Tensor:
    """A tensor that shares the memory of an array."""
    return torch.from_numpy(array)  # pyright: ignore[reportUnknownMemberType]


def to_tensors(graph: Graph, device: torch.device | str = "cpu") -> GraphTensors:
    """Copy a graph to ``device``."""
    fields = [tensor_of(field) for field in graph]
    return GraphTensors(*[t.to(device, non_blocking=True) for t in fields])


NUM_SUMMARY = 4
"""Numbers that describe a whole graph, see :class:`CellTensors`."""


class CellTensors(NamedTuple):
    """``n`` cells in all ``B`` graphs, ``K`` a graph at most, ``P`` placements a graph at most,
    ``m`` cells of all placements."""

    row: torch.Tensor
    """int64[n]: graph of each cell."""
    used: torch.Tensor
    """bool[B, K]: where the n cells belong in a padded array, row by row."""
    edges: torch.Tensor
    """float32[n, S, E, F] of :mod:`learn2assemble.tasks.graph.relations`."""
    edge_used: torch.Tensor
    """bool[n, S, E]."""
    offsets: torch.Tensor
    """int64[n, S, M]."""
    summary: torch.Tensor
    """float32[B, 4]: unplaced and placed blocks, area of the outlines and its inverse."""
    cell: torch.Tensor
    """int64[m]: number of each cell of each placement among the n."""
    part_of: torch.Tensor
    """int64[m]: placement it belongs to, counted over the ``legal`` ones, row by row."""
    lever: torch.Tensor
    """float32[m, 3]: its offset from the centre of the placement [edges]."""
    legal: torch.Tensor
    """bool[B, P]."""
    action: torch.Tensor
    """int64[B, P, 3]: node action of each placement."""
    grip: torch.Tensor
    """int64[p]: grip of each of the ``p`` legal placements, see :class:`ActionSpec`."""
    hands: tuple[torch.Tensor, torch.Tensor] | None
    """int64[p, L], float32[p, 6]: :class:`Hands` of the legal placements, if asked for."""
    placements: Placements
    graph: Graph
    action_spec: ActionSpec

    def locate(self, action: torch.Tensor) -> torch.Tensor:
        """Number of the placement with the result of each node action int64[B, 3]: int64[B]."""
        found = locate(self.placements, self.graph, action.cpu().numpy(), self.action_spec)
        return tensor_of(found).to(action.device)


def cell_tensors(
    graph: GraphTensors, spec: ActionSpec, hand: bool = False, sight: int = 0
) -> CellTensors:
    """Enumerate placements and relate their cells to the graph, on the device of ``graph``.

    Args:
        spec: what the actions mean, :attr:`Task.action_spec`.
        hand: whether to look around the hand, too.
        sight: how many cells away blocks are seen, see :func:`relate`.
    """
    plain = Graph(*[t.cpu().numpy() for t in graph])
    placements = distinct_placements(plain, spec)
    relations = relate(plain, placements, spec.pitch, sight)
    device = graph.nodes.device
    used = np.arange(int(placements.cells.shape[1])) < placements.num_cells[:, None]
    row = used.nonzero()[0]
    unplaced = plain.num_nodes - plain.num_targets - plain.num_placed
    area = np.maximum(relations.area, 0.1)
    summary = np.stack([unplaced / 20, plain.num_placed / 20, area / 10, 1 / area], -1)
    legal = placements.used
    way = placements.action[..., 2][legal] % len(spec.turns)
    cell, part_of, lever = _parts(placements, np.cumsum(placements.num_cells))

    def put(array: np.ndarray) -> torch.Tensor:
        return tensor_of(np.ascontiguousarray(array)).to(device)

    hands = None
    if hand:
        found = look_around(plain, placements, spec)
        hands = put(found.around[legal]), put(found.place[legal])
    return CellTensors(
        put(row),
        put(used),
        put(relations.edges[used]),
        put(relations.edge_used[row]),
        put(relations.offsets[used]),
        put(summary.astype(np.float32)),
        put(cell),
        put(part_of),
        put(lever),
        put(legal),
        put(placements.action),
        put(spec.grips[way]),
        hands,
        placements,
        plain,
        spec,
    )


def _parts(placements: Placements, ends: np.ndarray) -> tuple[np.ndarray, ...]:
    """Cells of all placements one after the other; ``ends`` are those of the rows' cells."""
    legal = placements.used
    row = legal.nonzero()[0]
    members = placements.members[legal]
    present = members >= 0
    at = placements.cells[row[:, None], members] * present[..., None]
    lever = (at - (at.sum(1) / present.sum(1, keepdims=True))[:, None]) / EDGE
    flat = members + (ends - placements.num_cells)[row][:, None]
    return flat[present], present.nonzero()[0], lever[present].astype(np.float32)
