"""Graphs as tensors. PyTorch begins here."""

from __future__ import annotations

from typing import NamedTuple

import torch

from learn2assemble.graph.features import Graph


class GraphTensors(NamedTuple):
    """:class:`Graph` on a device. Masks are derived from the three counts."""

    nodes: torch.Tensor
    """float32[B, N, 5]."""
    object_id: torch.Tensor
    """int32[B, N]."""
    num_targets: torch.Tensor
    """int64[B]."""
    num_placed: torch.Tensor
    """int64[B]."""
    num_nodes: torch.Tensor
    """int64[B]."""

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
        """bool[B, N, N] like :func:`learn2assemble.graph.features.connectivity`.

        Rows of padding attend to themselves only, so that their softmax is defined.
        """
        used, index = self.used, self._index()
        allowed = used[:, None, :].expand(-1, used.shape[1], -1)
        if kind == "partial":
            settled = index < (self.num_targets + self.num_placed)[:, None]
            same = self.object_id[:, :, None] == self.object_id[:, None, :]
            allowed = allowed & (settled[:, :, None] | settled[:, None, :] | same)
        return (allowed & used[:, :, None]) | torch.eye(
            used.shape[1], dtype=torch.bool, device=used.device
        )

    def to(self, device: torch.device | str) -> GraphTensors:
        return GraphTensors(*[t.to(device, non_blocking=True) for t in self])

    def _index(self) -> torch.Tensor:
        return torch.arange(self.nodes.shape[1], device=self.nodes.device)


def to_tensors(graph: Graph, device: torch.device | str = "cpu") -> GraphTensors:
    """Copy a graph to ``device``."""
    return GraphTensors(*[torch.from_numpy(field) for field in graph]).to(device)
