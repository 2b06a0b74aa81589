"""Searches by name: the published ones and ours. Adding one is one line."""

from __future__ import annotations

from dataclasses import replace

from learn2assemble.errors import look_up
from learn2assemble.search.config import TO_THE_END, GumbelConfig, SearchConfig

SEARCHES: dict[str, SearchConfig] = {
    # Published (protocol 11.5). The first two are one search with differently trained agents.
    "dqn-mcts": SearchConfig(),
    "q-mcts": SearchConfig(),
    "eps-mcts": SearchConfig(expansion="uct", random_first=True),
    # Plain UCT (protocol 13.20): nothing learned takes part in it.
    "uct": SearchConfig(
        budget=1000, expansion="uct", prior=False, repeats=True, rollout=TO_THE_END,
        rollout_policy="random",
    ),
    # Ours.
    "distinct": SearchConfig(distinct=True),
    "widening": SearchConfig(
        distinct=True, expansion="uct", widening=0.8, exploration=0.2, backup="max"
    ),
    "gumbel": SearchConfig(
        distinct=True, expansion="gumbel", repeats=True, final="gumbel", backup="max",
        gumbel=GumbelConfig(considered=8),
    ),
}  # fmt: skip


def get_search(name: str) -> SearchConfig:
    """The search called ``name``.

    Raises:
        UnknownNameError: naming the nearest one.
    """
    return look_up("search", name, SEARCHES)


def training_search(method: str, budget: int, epsilon: float) -> SearchConfig:
    """The search of a learner during training: one step, epsilon by its schedule."""
    return replace(get_search(method), budget=budget, epsilon=epsilon)
