"""The search-regularised part of the loss of Q-MCTS and epsilon-MCTS (protocol 10.4)."""

from __future__ import annotations

import torch

from learn2assemble.learning.replay import Searched
from learn2assemble.networks.qnetwork import NEGATIVE, QFactors


def search_cross_entropy(factors: QFactors, searched: Searched) -> torch.Tensor:
    """``-(1/B) sum_s sum_e softmax_e(Q_S(s, a_e)) log softmax_e(Q(s, a_e))``, a scalar.

    The softmax runs over the explored actions e of each state at temperature 1; the stored search
    values Q_S are constants. States without a search add 0 and still count in the divisor B.
    """
    device = factors.context.device
    actions = torch.from_numpy(searched.action).to(device)
    count = torch.from_numpy(searched.count).to(device)
    explored = torch.arange(actions.shape[1], device=device) < count[:, None]
    q = torch.stack([factors.select(action) for action in actions.unbind(1)], 1)
    stored = torch.from_numpy(searched.value).to(device)
    # A finite stand-in for minus infinity keeps rows without any search free of NaN.
    log_policy = q.masked_fill(~explored, NEGATIVE).log_softmax(1)
    goal = stored.masked_fill(~explored, NEGATIVE).softmax(1)
    terms = torch.where(explored, goal * log_policy, 0.0)
    return -terms.sum() / len(terms)
