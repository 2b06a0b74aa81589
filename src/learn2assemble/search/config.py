"""Arguments of a search."""

from __future__ import annotations

from dataclasses import dataclass

from learn2assemble.errors import InputError

TO_THE_END = 10_000
"""Rollout depth that no episode reaches: play every rollout to termination."""


@dataclass(frozen=True)
class SearchConfig:
    """How DQN+MCTS searches (protocol 11.1 to 11.3).

    Args:
        budget: B, simulated expansions per decision; 0 plays the Q-policy.
        epsilon: chance of a random expansion and of a random explored child as final choice.
        rollout: eta, steps simulated per expansion, the first included; afterwards the largest
            Q is the estimate. ``TO_THE_END`` plays to termination (the paper's double star).
        prior: start every child with visit count 1 and its Q as total.
        distinct: expand only the best of several actions that lead to the same structure, such as
            like blocks put into the same cell (deviation D14).
    """

    budget: int = 10
    epsilon: float = 0.05
    rollout: int = 1
    prior: bool = True
    distinct: bool = False

    def __post_init__(self) -> None:
        if self.budget < 0:
            raise InputError("budget", self.budget, "a whole number of at least 0")
        if not 0 <= self.epsilon <= 1:
            raise InputError("epsilon", self.epsilon, "0 <= epsilon <= 1")
        if self.rollout < 1:
            raise InputError("rollout", self.rollout, "at least 1 step")
