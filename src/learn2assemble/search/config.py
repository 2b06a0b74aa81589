"""Arguments of a search."""

from __future__ import annotations

from dataclasses import dataclass, replace

from learn2assemble.errors import InputError, UnknownNameError

TO_THE_END = 10_000
"""Rollout depth that no episode reaches: play every rollout to termination."""


EXPANSIONS = ("epsilon-greedy", "uct")


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
        expansion: rule that picks the next action to expand, see ``EXPANSIONS``.
        random_first: with probability ``epsilon`` act at random without any search (epsilon-MCTS).
    """

    budget: int = 10
    epsilon: float = 0.05
    rollout: int = 1
    prior: bool = True
    distinct: bool = False
    expansion: str = "epsilon-greedy"
    random_first: bool = False

    def __post_init__(self) -> None:
        if self.budget < 0:
            raise InputError("budget", self.budget, "a whole number of at least 0")
        if self.expansion not in EXPANSIONS:
            raise UnknownNameError("expansion", self.expansion, EXPANSIONS)
        if not 0 <= self.epsilon <= 1:
            raise InputError("epsilon", self.epsilon, "0 <= epsilon <= 1")
        if self.rollout < 1:
            raise InputError("rollout", self.rollout, "at least 1 step")


SEARCHES: dict[str, SearchConfig] = {
    "dqn-mcts": SearchConfig(),
    "q-mcts": SearchConfig(),
    "eps-mcts": SearchConfig(expansion="uct", random_first=True),
}
"""The named searches."""


def get_search(name: str) -> SearchConfig:
    """The search called ``name``.

    Raises:
        UnknownNameError: naming the nearest one.
    """
    if name not in SEARCHES:
        raise UnknownNameError("search", name, SEARCHES)
    return SEARCHES[name]


def training_search(method: str, budget: int, epsilon: float) -> SearchConfig:
    """The search of a learner during training: one step, epsilon by its schedule."""
    return replace(get_search(method), budget=budget, epsilon=epsilon)
