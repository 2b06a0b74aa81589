"""The DQN loss (protocol 10.3) and its two optional extensions (deviation D6)."""

from __future__ import annotations

import numpy as np
import torch
from torch.nn import functional as F

from learn2assemble.graph.batch import to_tensors
from learn2assemble.learning.config import TrainConfig
from learn2assemble.learning.replay import Batch
from learn2assemble.networks.qnetwork import QFactors, QNetwork
from learn2assemble.world.actions import DIRECTIONS
from learn2assemble.world.blocks import EDGE

INVALID_VALUE = -1.0
"""Exact Q of an invalid placement: reward -1, then nothing."""


def td_targets(
    online: QNetwork, target: QNetwork, batch: Batch, discount: float, double: bool, device: str
) -> torch.Tensor:
    """``y = r + gamma (1 - absorbing) max Q_T(s', .)`` over legal actions: float[B]."""
    graph = to_tensors(batch.next_graph, device)
    reward = torch.from_numpy(batch.reward).to(device)
    alive = torch.from_numpy(~batch.absorbing).to(device)
    with torch.no_grad():
        factors: QFactors = target(graph)
        if double:
            _, action = online(graph).best(graph)
            value = factors.select(action)
        else:
            value, _ = factors.best(graph)
    return reward + discount * torch.where(alive, value, 0.0)


def same_cell(batch: Batch, tolerance: float = 1e-3) -> np.ndarray:
    """Which (reference, relation) lead to the cell of the action taken: bool[B, M, 5]."""
    graph, blocks = batch.graph, batch.valid.shape[1]
    rows = np.arange(len(batch.reward))
    index = graph.num_targets[:, None] + np.arange(blocks)
    index = np.minimum(index, graph.nodes.shape[1] - 1)
    placed = graph.nodes[rows[:, None], index, :3]
    taken = graph.nodes[rows, batch.action[:, 1], :3] + EDGE * DIRECTIONS[batch.action[:, 2]]
    cells = placed[:, :, None] + EDGE * DIRECTIONS
    near = np.abs(cells - taken[:, None, None]).max(-1) < tolerance
    return near & (np.arange(blocks) < graph.num_placed[:, None])[..., None]


def dqn_loss(
    online: QNetwork,
    target: QNetwork,
    batch: Batch,
    config: TrainConfig,
    discount: float,
    rng: np.random.Generator,
    device: str,
) -> tuple[torch.Tensor, dict[str, float]]:
    """Loss of one batch and numbers to log.

    The TD part is the smooth L1 of the paper. ``share_cell`` spreads it over equivalent actions,
    ``invalid_weight`` adds the mean smooth L1 to -1 over all invalid placements of each state.
    """
    y = td_targets(online, target, batch, discount, config.double, device)
    graph = to_tensors(batch.graph, device)
    action = torch.from_numpy(batch.action).to(device)
    factors: QFactors = online(graph)
    value = factors.select(action)
    if not config.share_cell and not config.invalid_weight:
        loss = F.smooth_l1_loss(value, y)
        return loss, {"loss": float(loss.detach()), "q": float(value.detach().mean())}

    # Q of one random unplaced block at every (reference, relation): float[B, M, Na].
    blocks = batch.valid.shape[1]
    graph_np = batch.graph
    first = graph_np.num_targets + graph_np.num_placed
    block = first + (rng.random(len(y)) * (graph_np.num_nodes - first)).astype(np.int64)
    rows = torch.arange(len(y), device=device)
    index = graph_np.num_targets[:, None] + np.arange(blocks)
    used = np.arange(blocks) < graph_np.num_placed[:, None]
    index = torch.from_numpy(np.minimum(index, graph_np.nodes.shape[1] - 1)).to(device)
    q = (
        factors.block[rows, torch.from_numpy(block).to(device)][:, None]
        + factors.reference[rows[:, None], index]
        + factors.context[:, None]
    )
    if config.share_cell:
        same = torch.from_numpy(same_cell(batch)).to(device)
        error = F.smooth_l1_loss(q, y[:, None, None].expand_as(q), reduction="none")
        td = ((error * same).sum((1, 2)) / same.sum((1, 2)).clamp(min=1)).mean()
        td = 0.5 * (td + F.smooth_l1_loss(value, y))
    else:
        td = F.smooth_l1_loss(value, y)
    loss = td
    logs = {"td": float(td.detach()), "q": float(value.detach().mean())}
    if config.invalid_weight:
        invalid = torch.from_numpy(used[..., None] & ~batch.valid).to(device)
        error = F.smooth_l1_loss(q, torch.full_like(q, INVALID_VALUE), reduction="none")
        extra = (error * invalid).sum() / invalid.sum().clamp(min=1)
        logs["invalid"] = float(extra.detach())
        loss = loss + config.invalid_weight * extra
    return loss, {"loss": float(loss.detach()), **logs}
