"""Losses: temporal difference, cross-entropy to search values (Q-MCTS, epsilon-MCTS), and labels of
a one-step model (deviation D6)."""

from __future__ import annotations

import numpy as np
import torch
from torch.nn import functional as F

from learn2assemble.graph.batch import to_tensors
from learn2assemble.learning.config import TrainConfig
from learn2assemble.learning.replay import Batch, Searched
from learn2assemble.networks.agent import Network, Values
from learn2assemble.networks.placement import PlacementValues
from learn2assemble.networks.qnetwork import NEGATIVE
from learn2assemble.world.outcomes import Outcomes


def search_cross_entropy(values: Values, searched: Searched, taken: torch.Tensor) -> torch.Tensor:
    """``-(1/B) sum_s sum_e softmax_e(Q_S(s, a_e)) log softmax_e(Q(s, a_e))``, a scalar.

    The softmax runs over the explored actions e of each state at temperature 1; the stored search
    values Q_S are constants. States without a search add 0 and still count in the divisor B.

    Args:
        taken: int64[B, 3]: the actions taken; they stand in where fewer were explored.
    """
    device = taken.device
    actions = torch.from_numpy(searched.action).to(device)
    count = torch.from_numpy(searched.count).to(device)
    explored = torch.arange(actions.shape[1], device=device) < count[:, None]
    actions = torch.where(explored[..., None], actions, taken[:, None])
    q = torch.stack([values.select(action) for action in actions.unbind(1)], 1)
    stored = torch.from_numpy(searched.value).to(device)
    # A finite stand-in for minus infinity keeps rows without any search free of NaN.
    log_policy = q.masked_fill(~explored, NEGATIVE).log_softmax(1)
    goal = stored.masked_fill(~explored, NEGATIVE).softmax(1)
    terms = torch.where(explored, goal * log_policy, 0.0)
    return -terms.sum() / len(terms)


def q_loss(
    online: Network, target: Network, batch: Batch, config: TrainConfig, device: str
) -> tuple[torch.Tensor, dict[str, float]]:
    """Loss of one batch and numbers to log.

    The TD part is the paper's smooth L1; where the batch carries searches, it is weighed against
    the cross-entropy to their values (:mod:`~learn2assemble.learning.loss`).
    ``dense_weight`` adds :func:`dense_error`.
    """
    values = online(to_tensors(batch.graph, device))
    action = torch.from_numpy(batch.action).to(device)
    y = td_targets(online, target, batch, config, device)
    value = values.select(action)
    loss = td = F.smooth_l1_loss(value, y)
    logs = {"td": float(td.detach()), "q": float(value.detach().mean())}
    if batch.searched is not None:
        ce = search_cross_entropy(values, batch.searched, action)
        logs["search"] = float(ce.detach())
        loss = (1 - config.search_weight) * td + config.search_weight * ce
    if config.dense_weight:
        assert batch.outcomes is not None
        assert isinstance(values, PlacementValues)
        dense, parts = dense_error(values, batch.outcomes)
        logs |= parts
        loss = loss + config.dense_weight * dense
    return loss, {"loss": float(loss.detach()), **logs}


def td_targets(
    online: Network, target: Network, batch: Batch, config: TrainConfig, device: str
) -> torch.Tensor:
    """``y = r + gamma (1 - terminal) max Q_T(s', .)`` over legal actions: float[B].

    For joined steps r is their discounted sum and gamma the discount after them.
    """
    reward = torch.from_numpy(batch.reward).to(device)
    alive = torch.from_numpy(~batch.terminal).to(device)
    discount = torch.from_numpy(batch.discount).to(device)
    # Only states that go on are valued.
    rows = np.flatnonzero(~batch.terminal)
    following = reward.new_zeros(len(reward))
    if len(rows):
        graph = to_tensors(batch.next_graph.take(rows), device)
        with torch.no_grad():
            if config.double:
                _, action = online(graph).best(graph)
                following[alive] = target(graph).select(action)
            else:
                following[alive] = target(graph).best(graph)[0]
    return reward + discount * following


def dense_error(
    values: PlacementValues, outcomes: Outcomes
) -> tuple[torch.Tensor, dict[str, float]]:
    """Smooth L1 of what a one-step model tells about *every* placement of the states.

    Three means: the reward part of Q against the reward; Q against the reward where the placement
    is invalid; the same where it ends the episode otherwise (there the reward is the exact Q).
    """
    device = values.q.device
    shape = values.q.shape

    def put(a: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(a[:, : shape[1]]).to(device)

    reward, terminal, valid = put(outcomes.reward), put(outcomes.terminal), put(outcomes.valid)
    used = values.cells.legal & (terminal | valid)
    error = F.smooth_l1_loss(values.reward, reward, reduction="none") * used
    rewards = error.sum() / used.sum().clamp(min=1)
    error = F.smooth_l1_loss(values.q, reward, reduction="none")
    ends, kept = used & terminal & ~valid, used & terminal & valid
    invalid = (error * ends).sum() / ends.sum().clamp(min=1)
    # Placements that finish the structure are few: one counts like one action of the batch.
    final = (error * kept).sum() / kept.sum().clamp(min=shape[0])
    parts = {"reward": rewards, "invalid": invalid, "final": final}
    return rewards + invalid + final, {k: float(v.detach()) for k, v in parts.items()}
