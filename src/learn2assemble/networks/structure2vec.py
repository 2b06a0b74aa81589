"""Message passing by neighbourhood means: Structure2Vec (paper's baseline encoder, protocol 9).

The published form runs a layer on the input ``[A_ij, x_j]`` of every ordered pair, zeroed where
``A_ij`` is 0. ``A_ij`` is 0 or 1, so where it counts the input is ``[1, x_j]`` and depends on j
alone: one vector a node, then a product with the adjacency.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import nn
from torch.nn import functional as F


class Neighbourhood(NamedTuple):
    """What all rounds share."""

    mean: torch.Tensor
    """float[B, N, N]: ``A_ij / c_i``; c_i counts the entries of *column* i, as published."""
    edges: torch.Tensor
    """float[B, N, F]: e_i, the summary of the edges of node i."""


class EdgeSummary(nn.Module):
    """``e_i = ReLU(W_2 [1/c_i sum_j A_ij ReLU(W_1 [A_ij, x_j]), c_i / max c])``, no biases.

    Args:
        features: numbers of a node's input.
        width: embedding size F; W_1 has F - 1 rows, W_2 is square.
    """

    def __init__(self, features: int, width: int) -> None:
        super().__init__()
        self.pair = nn.Linear(1 + features, width - 1, bias=False)
        self.merge = nn.Linear(width, width, bias=False)

    def forward(self, x: torch.Tensor, adjacency: torch.Tensor) -> Neighbourhood:
        """``x`` float[B, N, features] scaled node inputs, ``adjacency`` bool[B, N, N]."""
        connected = adjacency.to(x.dtype)
        count = connected.sum(1)
        mean = connected / count[..., None]
        pairs = F.relu(self.pair(torch.cat([torch.ones_like(x[..., :1]), x], -1)))
        degree = count / count.amax(1, keepdim=True)
        edges = F.relu(self.merge(torch.cat([mean @ pairs, degree[..., None]], -1)))
        return Neighbourhood(mean, edges)


class Structure2VecRound(nn.Module):
    """``m = ReLU(W [A h / c, e])``, then ``ReLU(W' [h, m])``; no biases, no residuals.

    Args:
        width: embedding size F.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.message = nn.Linear(2 * width, width, bias=False)
        self.update = nn.Linear(2 * width, width, bias=False)

    def forward(self, h: torch.Tensor, near: Neighbourhood) -> torch.Tensor:
        """``h`` float[B, N, F] to float[B, N, F]."""
        message = F.relu(self.message(torch.cat([near.mean @ h, near.edges], -1)))
        return F.relu(self.update(torch.cat([h, message], -1)))
