"""The published Q-network: encoder and read-out (paper equations 1 to 5).

The encoder is attention (equations 2 to 4) or Structure2Vec. Structure2Vec runs a layer on
``[A_ij, x_j]`` of every ordered pair, zeroed where ``A_ij`` is 0; where it counts, ``A_ij`` is 1,
so it is computed once a node, then multiplied by the adjacency.

The read-out is ``Q(i, j, :) = W_o ReLU([p, h_i, h_j]) + b`` with p the pooled embedding. Its single
linear layer comes after the ReLU, so it is a sum of three terms, one per input, and the maximum
over all (i, j, k) is found in O(N).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from learn2assemble.errors import extra
from learn2assemble.tasks.graph.batch import GraphTensors
from learn2assemble.tasks.graph.features import NUM_FEATURES, POSITION
from learn2assemble.tasks.networks.config import NetworkConfig

with extra("torch", "learn"):
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
        self.heads = heads
        self.head_size: int = width // heads
        self.query_key_value: nn.Linear = nn.Linear(width, 3 * width, bias=False)
        self.merge: nn.Linear = nn.Linear(width, width, bias=False)
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
        self, x: torch.Tensor, scores: torch.Tensor, rotation: Rotation | None = None
    ) -> torch.Tensor:
        """``x`` float[B, N, F], ``scores`` float[B H, N, N] of :func:`barred` to float[B, N, F].

        ``rotation`` makes the score of i and j depend on their offset (deviation D5).
        """
        batch, nodes, width = x.shape
        qkv = self.query_key_value(x).view(batch, nodes, 3, self.heads, self.head_size)
        qkv = qkv.permute(2, 0, 3, 1, 4)
        if rotation is not None:
            qkv = torch.stack([rotation(qkv[0]), rotation(qkv[1]), qkv[2]])
        # Written out: on a processor and graphs this small PyTorch's own takes twice the time.
        q, k, v = qkv.reshape(3, batch * self.heads, nodes, self.head_size).unbind(0)
        score = torch.baddbmm(scores, q, k.transpose(1, 2), alpha=1 / math.sqrt(self.head_size))
        message = torch.bmm(score.softmax(-1), v).view(batch, self.heads, nodes, self.head_size)
        x = x + self.merge(message.transpose(1, 2).reshape(batch, nodes, width))
        return x if self.feed_forward is None else x + self.feed_forward(x)


def barred(adjacency: torch.Tensor, heads: int, like: torch.Tensor) -> torch.Tensor:
    """What is added to attention scores: 0 where bool[B, N, N] ``adjacency`` holds, else minus
    infinity, once a head: float[B H, N, N] of the type of ``like``."""
    scores = like.new_zeros(adjacency.shape).masked_fill_(~adjacency, -math.inf)
    return scores[:, None].expand(-1, heads, -1, -1).reshape(-1, *adjacency.shape[1:])


class EdgeSummary(nn.Module):
    """``e_i = ReLU(W_2 [1/c_i sum_j A_ij ReLU(W_1 [A_ij, x_j]), c_i / max c])``, no biases.

    Args:
        features: numbers of a node's input.
        width: embedding size F; W_1 has F - 1 rows, W_2 is square.
    """

    def __init__(self, features: int, width: int) -> None:
        super().__init__()
        self.pair: nn.Linear = nn.Linear(1 + features, width - 1, bias=False)
        self.merge: nn.Linear = nn.Linear(width, width, bias=False)

    def forward(self, x: torch.Tensor, adjacency: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """What all rounds share: ``A_ij / c_i`` float[B, N, N], and the summaries e_i of the edges
        float[B, N, F]; c_i counts the entries of *column* i, as published.

        ``x`` float[B, N, features] scaled node inputs, ``adjacency`` bool[B, N, N].
        """
        connected = adjacency.to(x.dtype)
        count = connected.sum(1)
        mean = connected / count[..., None]
        pairs = F.relu(self.pair(torch.cat([torch.ones_like(x[..., :1]), x], -1)))
        degree = count / count.amax(1, keepdim=True)
        return mean, F.relu(self.merge(torch.cat([mean @ pairs, degree[..., None]], -1)))


class Structure2VecRound(nn.Module):
    """``m = ReLU(W [A h / c, e])``, then ``ReLU(W' [h, m])``; no biases, no residuals.

    Args:
        width: embedding size F.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.message: nn.Linear = nn.Linear(2 * width, width, bias=False)
        self.update: nn.Linear = nn.Linear(2 * width, width, bias=False)

    def forward(self, h: torch.Tensor, mean: torch.Tensor, edges: torch.Tensor) -> torch.Tensor:
        """``h`` float[B, N, F] to float[B, N, F]; the others from :class:`EdgeSummary`."""
        message = F.relu(self.message(torch.cat([mean @ h, edges], -1)))
        return F.relu(self.update(torch.cat([h, message], -1)))


NEGATIVE = -1e9


class QFactors(NamedTuple):
    """``Q(i, j, k) = block[i, k] + reference[j, k] + context[k]`` for every graph of a batch."""

    block: torch.Tensor
    """float[B, N, Na]: the term of the block to place."""
    reference: torch.Tensor
    """float[B, N, Na]: the term of the placed reference block."""
    context: torch.Tensor
    """float[B, Na]: the term of the whole graph."""

    def select(self, action: torch.Tensor) -> torch.Tensor:
        """Q of node actions int64[B, 3]: float[B]."""
        row = torch.arange(len(action), device=action.device)
        i, j, k = action.unbind(-1)
        return self.block[row, i, k] + self.reference[row, j, k] + self.context[row, k]

    def best(self, graph: GraphTensors) -> tuple[torch.Tensor, torch.Tensor]:
        """Largest Q over the legal actions and the node action that has it: float[B], int64[B, 3].

        Rows without a legal action have a value near -1e9.
        """
        block = self.block.masked_fill(~graph.unplaced[..., None], NEGATIVE)
        reference = self.reference.masked_fill(~graph.placed[..., None], NEGATIVE)
        best_block, i = block.max(1)
        best_reference, j = reference.max(1)
        value, k = (best_block + best_reference + self.context).max(-1)
        i, j = i.gather(1, k[:, None])[:, 0], j.gather(1, k[:, None])[:, 0]
        return value, torch.stack([i, j, k], -1)

    def dense(self) -> torch.Tensor:
        """Q of every pair: float[B, N, N, Na], legal or not."""
        return self.block[:, :, None] + self.reference[:, None] + self.context[:, None, None]


class QNetwork(nn.Module):
    """Encoder (attention or Structure2Vec) and read-out; runs on any number of nodes.

    Args:
        config: the architecture.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.embed: nn.Linear = nn.Linear(NUM_FEATURES, width, bias=False)
        nn.init.xavier_uniform_(self.embed.weight, gain=math.sqrt(2))
        self.edges: EdgeSummary | None = None
        if config.encoder == "s2v":
            self.edges = EdgeSummary(NUM_FEATURES, width)
        self.rounds: nn.ModuleList = nn.ModuleList(_round(config) for _ in range(config.rounds))
        self.pool: nn.Linear = nn.Linear(width, width, bias=False)
        # Columns: pooled graph, block to place, reference block.
        self.readout: nn.Linear = nn.Linear(3 * width, config.num_actions)
        self.scale: torch.Tensor
        scale = torch.ones(NUM_FEATURES)
        scale[POSITION] = 1 / config.position_scale
        self.register_buffer("scale", scale, persistent=False)

    def encode(self, graph: GraphTensors) -> torch.Tensor:
        """Node embeddings float[B, N, F] (equations 1 and 2)."""
        x = graph.nodes * self.scale
        h = F.relu(self.embed(x))
        adjacency = graph.adjacency(self.config.connectivity)
        if self.edges is not None:
            shared = self.edges(x, adjacency)
            for layer in self.rounds:
                h = layer(h, *shared)
            return h
        rotation = None
        if self.config.rotary:
            head_size = self.config.width // self.config.heads
            rotation = Rotation.of(graph.nodes[..., POSITION], head_size)
        scores = barred(adjacency, self.config.heads, h)
        for layer in self.rounds:
            h = layer(h, scores, rotation)
        return h

    def forward(self, graph: GraphTensors) -> QFactors:
        """Q-values of every action in factored form (equation 5)."""
        h = self.encode(graph)
        used = graph.used[..., None]
        pooled = F.relu(self.pool((h * used).sum(1) / used.sum(1)))
        context, block, reference = self.readout.weight.chunk(3, 1)
        nodes = F.relu(h)
        return QFactors(
            F.linear(nodes, block),
            F.linear(nodes, reference),
            F.linear(pooled, context, self.readout.bias),
        )


def _round(config: NetworkConfig) -> nn.Module:
    if config.encoder == "s2v":
        return Structure2VecRound(config.width)
    return AttentionRound(config.width, config.heads, config.feed_forward)
