"""The Q-network: encoder and a read-out in O(N) (paper equations 1 to 5, protocol 9).

The published read-out is ``Q(i, j, :) = W_o ReLU([p, h_i, h_j]) + b`` with p the pooled embedding.
Its single linear layer comes after the ReLU, so the same function is a sum of three terms, one per
input, and Q over all (i, j, k) never has to be formed to know its maximum.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import nn
from torch.nn import functional as F

from learn2assemble.graph.batch import GraphTensors
from learn2assemble.graph.features import NUM_FEATURES, POSITION
from learn2assemble.networks.attention import AttentionRound, Rotation
from learn2assemble.networks.config import NetworkConfig
from learn2assemble.networks.structure2vec import EdgeSummary, Structure2VecRound

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
        self.embed = nn.Linear(NUM_FEATURES, width, bias=False)
        nn.init.xavier_uniform_(self.embed.weight, gain=math.sqrt(2))
        self.edges: EdgeSummary | None = None
        if config.encoder == "s2v":
            self.edges = EdgeSummary(NUM_FEATURES, width)
        self.rounds = nn.ModuleList(_round(config) for _ in range(config.rounds))
        self.pool = nn.Linear(width, width, bias=False)
        # Columns: pooled graph, block to place, reference block.
        self.readout = nn.Linear(3 * width, config.num_actions)
        self.reward_readout: nn.Linear | None = None
        if config.reward_head:
            self.reward_readout = nn.Linear(3 * width, config.num_actions)
        self.gain_readout: nn.Linear | None = None
        if config.gain_head:
            self.gain_readout = nn.Linear(3 * width, config.num_actions)
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
            near = self.edges(x, adjacency)
            for layer in self.rounds:
                h = layer(h, near)
            return h
        rotation = None
        if self.config.rotary:
            head_size = self.config.width // self.config.heads
            rotation = Rotation.of(graph.nodes[..., POSITION], head_size)
        for layer in self.rounds:
            h = layer(h, adjacency[:, None], rotation)
        return h

    def forward(self, graph: GraphTensors) -> QFactors:
        """Q-values of every action in factored form (equation 5)."""
        return self.values(self.embeddings(graph))

    def embeddings(self, graph: GraphTensors) -> tuple[torch.Tensor, torch.Tensor]:
        """What the read-out sees: ReLU of every node float[B, N, F] and of the pool float[B, F]."""
        h = self.encode(graph)
        used = graph.used[..., None]
        mean = (h * used).sum(1) / used.sum(1)
        return F.relu(h), F.relu(self.pool(mean))

    def values(self, embeddings: tuple[torch.Tensor, torch.Tensor]) -> QFactors:
        """Q from embeddings."""
        weight, bias = self.readout.weight, self.readout.bias
        if self.reward_readout is not None:
            weight, bias = weight + self.reward_readout.weight, bias + self.reward_readout.bias
        return _factors(embeddings, weight, bias)

    def rewards(self, embeddings: tuple[torch.Tensor, torch.Tensor]) -> QFactors:
        """The reward term of Q alone; needs ``reward_head``."""
        assert self.reward_readout is not None
        return _factors(embeddings, self.reward_readout.weight, self.reward_readout.bias)

    def gains(self, embeddings: tuple[torch.Tensor, torch.Tensor]) -> QFactors:
        """Predicted change of coverage of every action; needs ``gain_head``."""
        assert self.gain_readout is not None
        return _factors(embeddings, self.gain_readout.weight, self.gain_readout.bias)


def _round(config: NetworkConfig) -> nn.Module:
    if config.encoder == "s2v":
        return Structure2VecRound(config.width)
    return AttentionRound(config.width, config.heads, config.feed_forward)


def _factors(
    embeddings: tuple[torch.Tensor, torch.Tensor], weight: torch.Tensor, bias: torch.Tensor
) -> QFactors:
    nodes, pooled = embeddings
    context, block, reference = weight.chunk(3, 1)
    return QFactors(
        F.linear(nodes, block), F.linear(nodes, reference), F.linear(pooled, context, bias)
    )
