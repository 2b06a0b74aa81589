"""The loss: TD (protocol 10.3), the search term (10.4), extensions by a model (deviation D6)."""

from __future__ import annotations

import numpy as np
import torch
from torch.nn import functional as F

from learn2assemble.graph.batch import GraphTensors, to_tensors
from learn2assemble.graph.features import PLACED_FLAG, POSITION, Graph
from learn2assemble.learning.config import TrainConfig
from learn2assemble.learning.replay import Batch
from learn2assemble.learning.search_term import search_cross_entropy
from learn2assemble.networks.qnetwork import NEGATIVE, QFactors, QNetwork
from learn2assemble.world.actions import DIRECTIONS
from learn2assemble.world.blocks import EDGE

GAIN_UNIT = 0.1
"""Change of coverage that counts as one in the loss of the gain head."""


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

    The TD part is the paper's smooth L1; where the batch carries searches, it is weighed against
    the cross-entropy to their values (:mod:`~learn2assemble.learning.search_term`). ``imagined`` adds
    actions that were not taken, ``share_cell`` spreads the target over equivalent actions,
    ``terminal_weight`` adds the mean smooth L1 of Q to the reward over all placements that would
    end the episode, ``reward_weight`` that of the reward head to the rewards of all placements.
    """
    graph = to_tensors(batch.graph, device)
    embeddings = online.embeddings(graph)
    factors = online.values(embeddings)
    y = td_targets(online, target, batch, config, device)
    value = factors.select(torch.from_numpy(batch.action).to(device))
    td = F.smooth_l1_loss(value, y)
    if config.imagined:
        extra = imagined_error(target, batch, factors, graph, config.imagined, discount, rng)
        td = (td + extra) / (1 + config.imagined)
    logs = {"q": float(value.detach().mean())}
    block = _random_block(batch.graph, rng)
    if config.share_cell or config.terminal_weight:
        q = _all_placements(factors, batch, block, device)
    if config.share_cell:
        same = torch.from_numpy(same_cell(batch, q.shape[1])).to(device)
        error = F.smooth_l1_loss(q, y[:, None, None].expand_as(q), reduction="none")
        td = 0.5 * td + 0.5 * ((error * same).sum((1, 2)) / same.sum((1, 2))).mean()
    loss = td
    if batch.searched is not None:
        ce = search_cross_entropy(factors, batch.searched)
        logs["search"] = float(ce.detach())
        loss = (1 - config.search_weight) * td + config.search_weight * ce
    prospects = batch.prospects
    if prospects is not None:
        reward = torch.from_numpy(prospects.reward).to(device)
        used = (np.arange(reward.shape[1]) < batch.graph.num_placed[:, None])[..., None]
    if config.terminal_weight:
        assert prospects is not None
        # Invalid placements are many, those that finish the structure few: a final one counts
        # like one action of the batch at most.
        ends = used & prospects.terminal
        invalid = _mean_error(q, reward, ends & ~prospects.valid)
        final = _mean_error(q, reward, ends & prospects.valid, at_least=len(y))
        logs |= {"invalid": float(invalid.detach()), "final": float(final.detach())}
        loss = loss + config.terminal_weight * (invalid + final)
    if config.reward_weight:
        predicted = _all_placements(online.rewards(embeddings), batch, block, device)
        extra = _mean_error(predicted, reward, np.broadcast_to(used, reward.shape))
        logs["reward"] = float(extra.detach())
        loss = loss + config.reward_weight * extra
    if config.gain_weight:
        assert prospects is not None
        predicted = _all_placements(online.gains(embeddings), batch, block, device)
        gain = torch.from_numpy(prospects.gain).to(device) / GAIN_UNIT
        extra = _mean_error(predicted, gain, np.broadcast_to(used, gain.shape))
        logs["gain"] = float(extra.detach())
        loss = loss + config.gain_weight * extra
    return loss, {"loss": float(loss.detach()), "td": float(td.detach()), **logs}


def td_targets(
    online: QNetwork, target: QNetwork, batch: Batch, config: TrainConfig, device: str
) -> torch.Tensor:
    """``y = r + gamma (1 - terminal) max Q_T(s', .)`` over legal actions: float[B].

    For joined steps r is their discounted sum and gamma the discount after them.
    """
    graph = to_tensors(batch.next_graph, device)
    reward = torch.from_numpy(batch.reward).to(device)
    alive = torch.from_numpy(~batch.terminal).to(device)
    with torch.no_grad():
        if config.exact_next:
            value = _exact_next(online, target, batch, graph)
        elif config.double:
            _, action = online(graph).best(graph)
            value = target(graph).select(action)
        else:
            value, _ = target(graph).best(graph)
    discount = torch.from_numpy(batch.discount).to(device)
    return reward + discount * torch.where(alive, value, 0.0)


def _exact_next(
    online: QNetwork, target: QNetwork, batch: Batch, graph: GraphTensors
) -> torch.Tensor:
    """Value of the next states, double Q, with the model's rewards in place of predicted ones."""
    mine, theirs = (_corrected(network, batch, graph) for network in (online, target))
    return theirs.gather(1, mine.argmax(1, keepdim=True))[:, 0]


def _corrected(network: QNetwork, batch: Batch, graph: GraphTensors) -> torch.Tensor:
    """Q of the best unplaced block at every next placement, corrected: float[B, M * Na]."""
    assert batch.next_prospects is not None
    device, prospects = graph.nodes.device, batch.next_prospects
    embeddings = network.embeddings(graph)
    q, predicted = network.values(embeddings), network.rewards(embeddings)
    best, block = q.block.masked_fill(~graph.unplaced[..., None], NEGATIVE).max(1, keepdim=True)
    reward = torch.from_numpy(prospects.reward).to(device)
    index = torch.from_numpy(_placed_index(batch.next_graph, reward.shape[1])).to(device)
    rows = torch.arange(len(index), device=device)[:, None]
    value = best + q.reference[rows, index] + q.context[:, None]
    guess = predicted.block.gather(1, block) + predicted.reference[rows, index]
    exact = value - guess - predicted.context[:, None] + reward
    exact = torch.where(torch.from_numpy(prospects.terminal).to(device), reward, exact)
    known = torch.from_numpy(batch.next_known).to(device)[:, None, None]
    value = torch.where(known, exact, value)
    used = np.arange(reward.shape[1]) < batch.next_graph.num_placed[:, None]
    legal = torch.from_numpy(used).to(device)[..., None]
    return value.masked_fill(~legal, NEGATIVE).flatten(1)


def imagined_error(
    target: QNetwork,
    batch: Batch,
    factors: QFactors,
    graph: GraphTensors,
    count: int,
    discount: float,
    rng: np.random.Generator,
) -> torch.Tensor:
    """Sum over ``count`` actions that were not taken of the mean smooth L1 to their TD targets.

    The first is the network's own choice, so overestimated actions are corrected without having
    to be played; the others are random valid placements.
    """
    assert batch.prospects is not None
    prospects, rows = batch.prospects, np.arange(len(batch.action))
    with torch.no_grad():
        actions = [factors.best(graph)[1].cpu().numpy()]
    for _ in range(count - 1):
        actions.append(_random_valid(batch, rng))
    graphs, rewards, terminals = [], [], []
    for action in actions:
        where = (rows, action[:, 1] - batch.graph.num_targets, action[:, 2])
        graphs.append(successor(batch.graph, action))
        rewards.append(prospects.reward[where])
        terminals.append(prospects.terminal[where])
    joined = Graph(*[np.concatenate(fields) for fields in zip(*graphs, strict=True)])
    tensors = to_tensors(joined, graph.nodes.device)
    with torch.no_grad():
        value, _ = target(tensors).best(tensors)
    alive = torch.from_numpy(~np.concatenate(terminals)).to(value.device)
    reward = torch.from_numpy(np.concatenate(rewards)).to(value.device)
    y = (reward + discount * torch.where(alive, value, 0.0)).split(len(rows))
    chosen = [factors.select(torch.from_numpy(a).to(value.device)) for a in actions]
    return torch.stack([F.smooth_l1_loss(q, t) for q, t in zip(chosen, y, strict=True)]).sum()


def _random_valid(batch: Batch, rng: np.random.Generator) -> np.ndarray:
    """A uniformly drawn valid placement of a random block, node actions int64[B, 3]."""
    assert batch.prospects is not None
    valid = batch.prospects.valid.reshape(len(batch.action), -1)
    # The largest of independent draws, among the valid entries, is uniform over them.
    pick = (rng.random(valid.shape) * valid).argmax(1)
    reference, relation = np.divmod(pick, batch.prospects.valid.shape[2])
    block = _random_block(batch.graph, rng)
    return np.stack([block, batch.graph.num_targets + reference, relation], -1)


def successor(graph: Graph, action: np.ndarray) -> Graph:
    """The graph after placing single cubes upright: node actions int64[B, 3].

    The block changes places with the first unplaced node, which becomes the last placed one; the
    order among unplaced nodes carries no meaning (protocol 4).
    """
    rows, block = np.arange(len(action)), action[:, 0]
    first = graph.num_targets + graph.num_placed
    nodes, object_id = graph.nodes.copy(), graph.object_id.copy()
    nodes[rows, block], object_id[rows, block] = nodes[rows, first], object_id[rows, first]
    reference = nodes[rows, action[:, 1], POSITION]
    nodes[rows, first] = graph.nodes[rows, block]
    nodes[rows, first, POSITION] = reference + EDGE * DIRECTIONS[action[:, 2]]
    nodes[rows, first, PLACED_FLAG] = 1.0
    object_id[rows, first] = graph.object_id[rows, block]
    return graph._replace(nodes=nodes, object_id=object_id, num_placed=graph.num_placed + 1)


def same_cell(batch: Batch, blocks: int, tolerance: float = 1e-3) -> np.ndarray:
    """Which (reference, relation) lead to the cell of the action taken: bool[B, M, 5]."""
    graph, rows = batch.graph, np.arange(len(batch.reward))
    placed = graph.nodes[rows[:, None], _placed_index(graph, blocks), POSITION]
    reference = graph.nodes[rows, batch.action[:, 1], POSITION]
    taken = reference + EDGE * DIRECTIONS[batch.action[:, 2]]
    cells = placed[:, :, None] + EDGE * DIRECTIONS
    near = np.abs(cells - taken[:, None, None]).max(-1) < tolerance
    return near & (np.arange(blocks) < graph.num_placed[:, None])[..., None]


def _all_placements(
    factors: QFactors, batch: Batch, block: np.ndarray, device: str
) -> torch.Tensor:
    """Value of unplaced node ``block`` at every (reference, relation): float[B, M, Na]."""
    graph = batch.graph
    blocks = int(graph.num_placed.max())
    if batch.prospects is not None:
        blocks = batch.prospects.valid.shape[1]
    rows = torch.arange(len(block), device=device)
    index = torch.from_numpy(_placed_index(graph, blocks)).to(device)
    return (
        factors.block[rows, torch.from_numpy(block).to(device)][:, None]
        + factors.reference[rows[:, None], index]
        + factors.context[:, None]
    )


def _mean_error(
    value: torch.Tensor, target: torch.Tensor, where: np.ndarray, at_least: int = 1
) -> torch.Tensor:
    """Mean smooth L1 over the entries of float[B, M, Na] that ``where`` selects.

    The divisor is at least ``at_least``, so few entries do not weigh more than many.
    """
    weight = torch.from_numpy(np.ascontiguousarray(where)).to(value.device)
    error = F.smooth_l1_loss(value, target, reduction="none")
    return (error * weight).sum() / weight.sum().clamp(min=at_least)


def _random_block(graph: Graph, rng: np.random.Generator) -> np.ndarray:
    """Node index of a uniformly drawn unplaced block of every graph: int64[B]."""
    first = graph.num_targets + graph.num_placed
    return first + (rng.random(len(first)) * (graph.num_nodes - first)).astype(np.int64)


def _placed_index(graph: Graph, blocks: int) -> np.ndarray:
    """Node index of placed block 0..blocks-1, clipped to the graph: int64[B, blocks]."""
    index = graph.num_targets[:, None] + np.arange(blocks)
    return np.minimum(index, graph.nodes.shape[1] - 1)
