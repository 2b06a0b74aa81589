"""The placement network: Q-values of distinct placements from relations (our own method, D23).

Where the published network embeds every node and reads Q(i, j, k) off a pair of them, this one
embeds every cell that could be filled. A cell looks at the edges of each outline and at the placed
blocks around it in the viewer's frame of that side, so its embedding depends neither on where the
structure stands, nor on which of its sides comes first, nor on how large the target is. A
placement is the sum over the cells it fills; like placements are one placement. With a gripper,
every cell also knows the grip it would be placed with, and where an arm builds, a placement knows
what is around the hand, seen by the hand, and where in the world it is.
"""

from __future__ import annotations

from typing import NamedTuple

from learn2assemble.errors import extra
from learn2assemble.tasks.graph.batch import NUM_SUMMARY, CellTensors, GraphTensors, cell_tensors
from learn2assemble.tasks.graph.relations import AROUND, EDGE_FEATURES, OFFSETS, PLACE_FEATURES
from learn2assemble.tasks.networks.config import NetworkConfig
from learn2assemble.tasks.networks.qnetwork import NEGATIVE
from learn2assemble.tasks.world.blocks import RELATIONS, get_action_spec

with extra("torch", "learn"):
    import torch
    from torch import nn
    from torch.nn import functional as F

REACH_OF_ARM = 0.5
"""Positions in the world are divided by this [m]."""


class PlacementValues(NamedTuple):
    """Q-values of the distinct placements of a batch of graphs."""

    q: torch.Tensor
    """float[B, P]; -1e9 beyond the placements of a row."""
    reward: torch.Tensor
    """float[B, P]: the part of Q that learning fits to the immediate reward."""
    cells: CellTensors

    def best(self, graph: GraphTensors) -> tuple[torch.Tensor, torch.Tensor]:
        """Largest Q and the node action that has it: float[B], int64[B, 3]."""
        value, index = self.q.max(1)
        return value, self.cells.action[torch.arange(len(index), device=index.device), index]

    def select(self, action: torch.Tensor) -> torch.Tensor:
        """Q of node actions int64[B, 3]: float[B]."""
        return self.q.gather(1, self.cells.locate(action)[:, None])[:, 0]


class PlacementNetwork(nn.Module):
    """Relational encoder of cells and read-out of placements.

    Args:
        config: its ``width``, ``rounds``, ``num_actions``, ``action_mode``, ``pitch``, ``sight``
            and ``hand`` count.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.edge: nn.Linear = nn.Linear(EDGE_FEATURES, width)
        self.neighbour: nn.EmbeddingBag = _table(OFFSETS, width)
        self.side: nn.Module = _two_layers(3 * width, width)
        self.summary: nn.Linear = nn.Linear(NUM_SUMMARY, width)
        self.pools: nn.ModuleList = nn.ModuleList(
            nn.Linear(2 * width, width) for _ in range(config.rounds)
        )
        self.rounds: nn.ModuleList = nn.ModuleList(
            _two_layers(2 * width, width) for _ in range(config.rounds)
        )
        self.member: nn.Linear = nn.Linear(width, width)
        self.lever: nn.Linear = nn.Linear(3, width, bias=False)
        self.context: nn.Linear = nn.Linear(width, width, bias=False)
        self.readout: nn.Sequential = nn.Sequential(
            nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 2)
        )
        grips = get_action_spec(config.action_mode, config.num_actions // len(RELATIONS)).num_grips
        self.grip: nn.Embedding | None = nn.Embedding(grips, width) if grips > 1 else None
        self.hand: Hand | None = Hand(width, grips) if config.hand else None

    def forward(self, graph: GraphTensors) -> PlacementValues:
        """Q-values of every distinct placement."""
        config = self.config
        spec = get_action_spec(
            config.action_mode, config.num_actions // len(RELATIONS), config.pitch
        )
        cells = cell_tensors(graph, spec, config.hand, config.sight)
        x, context = self.encode(cells)
        parts = F.embedding(cells.cell, self.member(x)) + self.lever(cells.lever)
        if self.grip is not None:
            parts = parts + self.grip(cells.grip)[cells.part_of]
        parts = F.relu(parts)
        row = cells.legal.nonzero()[:, 0]
        placed = self.context(context)[row].index_add(0, cells.part_of, parts)
        if self.hand is not None:
            placed = placed + self.hand(cells)
        values = x.new_full((*cells.legal.shape, 2), NEGATIVE)
        values[cells.legal] = self.readout(placed)
        reward, rest = values.unbind(-1)
        q = torch.where(cells.legal, reward + rest, NEGATIVE)
        return PlacementValues(q, reward, cells)

    def encode(self, cells: CellTensors) -> tuple[torch.Tensor, torch.Tensor]:
        """Embeddings of all cells float[n, F] and of the graphs float[B, F]."""
        message = F.relu(self.edge(cells.edges)) * cells.edge_used[..., None]
        seen = torch.cat([message.sum(2), message.amax(2)], -1)
        sides, blocks = cells.offsets.shape[1:]
        near = F.relu(_sums(self.neighbour, cells.offsets.view(-1, blocks)))
        first, last = _linears(self.side)
        hidden = F.relu(first(torch.cat([seen, near.view(len(seen), sides, -1)], -1)))
        # The sum over the sides of what the last layer makes of them.
        x = F.relu(F.linear(hidden.sum(1), last.weight, sides * last.bias))
        context = self.summary(cells.summary)
        place = cells.used.flatten().nonzero()[:, 0]
        for pool, layers in zip(self.pools, self.rounds, strict=True):
            first, last = _linears(layers)
            grid = x.new_zeros(cells.used.numel(), x.shape[1]).index_copy(0, place, x)
            grid = grid.view(*cells.used.shape, -1)
            # Never below 0: a padded row and the same row alone must have the same maximum.
            largest = grid.amax(1).clamp(min=0)
            context = F.relu(context + pool(torch.cat([grid.sum(1) / 10, largest], -1)))
            # The first layer on [x, context]: what it makes of the context once a graph.
            of_cell, of_graph = first.weight.chunk(2, 1)
            graph = F.linear(context, of_graph, first.bias)
            x = x + last(F.relu(F.linear(x, of_cell) + graph[cells.row]))
        return F.relu(x), context


class Hand(nn.Module):
    """Embeds what the hand meets at every placement.

    Args:
        width: F.
        grips: how many there are.
    """

    def __init__(self, width: int, grips: int) -> None:
        super().__init__()
        self.around: nn.EmbeddingBag = _table(AROUND, width)
        self.place: nn.Linear = nn.Linear(PLACE_FEATURES, width)
        self.grip: nn.Embedding = nn.Embedding(grips, width)
        self.out: nn.Module = _two_layers(width, width)

    def forward(self, cells: CellTensors) -> torch.Tensor:
        """float[p, F] of the legal placements."""
        assert cells.hands is not None
        around, place = cells.hands
        place = self.place(place / REACH_OF_ARM)
        return self.out(F.relu(_sums(self.around, around) + place + self.grip(cells.grip)))


def _table(numbers: int, width: int) -> nn.EmbeddingBag:
    """Embeddings of so many numbers, and of one more, which is 0 and stays so."""
    table = nn.EmbeddingBag(numbers + 1, width, mode="sum", padding_idx=numbers)
    nn.init.normal_(table.weight, std=0.1)
    with torch.no_grad():
        table.weight[numbers] = 0
    return table


def _two_layers(inputs: int, width: int) -> nn.Module:
    return nn.Sequential(nn.Linear(inputs, 2 * width), nn.ReLU(), nn.Linear(2 * width, width))


def _linears(two_layers: nn.Module) -> tuple[nn.Linear, nn.Linear]:
    first, _, last = two_layers.children()
    assert isinstance(first, nn.Linear)
    assert isinstance(last, nn.Linear)
    return first, last


def _sums(table: nn.EmbeddingBag, numbers: torch.Tensor) -> torch.Tensor:
    """Sum of the rows of ``table`` with each row of ``numbers``; its last row is 0 and stays so.

    The same as ``table(numbers)``, but PyTorch is ten times as slow with ``padding_idx``.
    """
    rows = F.pad(table.weight[:-1], (0, 0, 0, 1))
    return F.embedding_bag(numbers, rows, mode="sum")
