"""One round of message passing by attention (paper equations 2 to 4, protocol 9)."""

from __future__ import annotations

import math

import torch
from torch import nn
from torch.nn import functional as F


class AttentionRound(nn.Module):
    """``x + MHA(x)``, then ``x + FF(x)``; no normalisation, no dropout, no attention biases.

    Args:
        width: embedding size.
        heads: number of heads.
        feed_forward: ``light``, ``wide`` or ``none``.
    """

    def __init__(self, width: int, heads: int, feed_forward: str) -> None:
        super().__init__()
        self.heads, self.head_size = heads, width // heads
        self.query_key_value = nn.Linear(width, 3 * width, bias=False)
        self.merge = nn.Linear(width, width, bias=False)
        # Published initialisation: U(+-1/sqrt(s)), s the last dimension of the per-head tensors.
        bound = 1 / math.sqrt(self.head_size)
        nn.init.uniform_(self.query_key_value.weight, -bound, bound)
        bound = 1 / math.sqrt(width)
        nn.init.uniform_(self.merge.weight, -bound, bound)
        self.feed_forward: nn.Module | None = None
        if feed_forward == "light":
            self.feed_forward = nn.Sequential(nn.Linear(width, width), nn.ReLU())
        elif feed_forward == "wide":
            self.feed_forward = nn.Sequential(
                nn.Linear(width, 8 * width), nn.ReLU(), nn.Linear(8 * width, width)
            )

    def forward(self, x: torch.Tensor, adjacency: torch.Tensor) -> torch.Tensor:
        """``x`` float[B, N, F], ``adjacency`` bool[B, 1, N, N] to float[B, N, F]."""
        batch, nodes, width = x.shape
        qkv = self.query_key_value(x).view(batch, nodes, 3, self.heads, self.head_size)
        q, k, v = qkv.permute(2, 0, 3, 1, 4)
        message = F.scaled_dot_product_attention(q, k, v, attn_mask=adjacency)
        x = x + self.merge(message.transpose(1, 2).reshape(batch, nodes, width))
        return x if self.feed_forward is None else x + self.feed_forward(x)
