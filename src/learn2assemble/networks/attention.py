"""One round of message passing by attention (paper equations 2 to 4, protocol 9)."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import nn
from torch.nn import functional as F

ROTARY = tuple((axis, period) for period in (0.1, 0.2, 0.05, 0.4) for axis in (0, 2, 1))
"""Axis and period [m] of each rotated pair of query and key entries, in order of use.

Multiples of the block edge tell lattice neighbours apart, the edge itself where an outline cuts."""


class Rotation(NamedTuple):
    """Cosine and sine of every node's phases: float[B, 1, N, pairs]."""

    cos: torch.Tensor
    sin: torch.Tensor

    @staticmethod
    def of(position: torch.Tensor, head_size: int) -> Rotation:
        """Phases of positions float[B, N, 3] [m] for heads of ``head_size`` entries."""
        pairs = ROTARY[: head_size // 2]
        waves = position.new_tensor([2 * math.pi / period for _, period in pairs])
        phase = position[..., [axis for axis, _ in pairs]] * waves
        return Rotation(phase.cos()[:, None], phase.sin()[:, None])

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        """Rotate float[B, H, N, D]; entries beyond the pairs pass unchanged."""
        pairs = self.cos.shape[-1]
        a, b = x[..., :pairs], x[..., pairs : 2 * pairs]
        turned = [a * self.cos - b * self.sin, a * self.sin + b * self.cos, x[..., 2 * pairs :]]
        return torch.cat(turned, -1)


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

    def forward(
        self, x: torch.Tensor, adjacency: torch.Tensor, rotation: Rotation | None = None
    ) -> torch.Tensor:
        """``x`` float[B, N, F], ``adjacency`` bool[B, 1, N, N] to float[B, N, F].

        ``rotation`` makes the score of i and j depend on their offset (deviation D5).
        """
        batch, nodes, width = x.shape
        qkv = self.query_key_value(x).view(batch, nodes, 3, self.heads, self.head_size)
        q, k, v = qkv.permute(2, 0, 3, 1, 4)
        if rotation is not None:
            q, k = rotation(q), rotation(k)
        message = F.scaled_dot_product_attention(q, k, v, attn_mask=adjacency)
        x = x + self.merge(message.transpose(1, 2).reshape(batch, nodes, width))
        return x if self.feed_forward is None else x + self.feed_forward(x)
