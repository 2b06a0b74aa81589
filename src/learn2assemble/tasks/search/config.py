"""Arguments of a search; every variant is the same function with other arguments.

Searches by name: the published ones, ours, and those that are registered from outside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from learn2assemble.errors import InputError, check_fields, check_instance, check_name, check_types
from learn2assemble.registry import Registry

TO_THE_END = NO_LIMIT = 10_000
"""Rollout depth and tree depth that no episode reaches."""
NAMES: dict[str, tuple[str, ...]] = {
    "expansion": ("epsilon-greedy", "uct", "gumbel"),
    "rollout_policy": ("greedy", "random"),
    "final": ("best-mean", "most-visits", "gumbel"),
    "backup": ("mean", "max"),
}
"""What fields of a search can be called."""


@dataclass(frozen=True)
class GumbelConfig:
    """Root selection of Danihelka et al. 2022, "Policy improvement by planning with Gumbel".

    Args:
        considered: actions the sequential halving starts with, at most.
        temperature: the logits are Q / temperature.
        value_scale, visit_offset: sigma(q) = (visit_offset + max visits) * value_scale * q for q
            scaled to 0..1 over the actions of the node.
        noise: draw Gumbel noise; without it the search is deterministic, which suits small budgets.
    """

    considered: int = 8
    temperature: float = 1.0
    value_scale: float = 1.0
    visit_offset: float = 50.0
    noise: bool = False

    def __post_init__(self) -> None:
        check_types(self)
        check_fields(
            self,
            ("considered", self.considered >= 1, "at least 1 action"),
            ("temperature", 0 < self.temperature < math.inf, "a positive number"),
            ("value_scale", 0 < self.value_scale < math.inf, "a positive number"),
            ("visit_offset", 0 <= self.visit_offset < math.inf, "a number of at least 0"),
        )


@dataclass(frozen=True)
class SearchConfig:
    """How a search expands, simulates and decides.

    Args:
        budget: B, simulations per decision; 0 plays the Q-policy.
        epsilon: chance of a random expansion (epsilon-greedy), of a random step in a greedy
            rollout and of a random explored child as final choice.
        rollout: eta, steps simulated per expansion, the first included; afterwards the largest
            Q is the estimate. ``TO_THE_END`` plays to termination (the paper's double star).
        prior: start every child with visit count 1 and its Q as total.
        distinct: expand only the best of several actions that lead to the same structure, such as
            like blocks put into the same cell (deviation D14).
        expansion: how the next action of a node is picked. ``epsilon-greedy``: untried ones by Q,
            some at random. ``uct``: largest ``mean + c sqrt(ln n(node) / n(child))``;
            untried ones by Q with the prior, at random without. ``gumbel``: sequential
            halving at the root, the completed policy below
            (:mod:`~learn2assemble.tasks.search.mcts`).
        exploration: c of ``uct``.
        repeats: a walk may enter an explored child before its siblings have been tried, and the
            end of a walk may be simulated again; without it every edge is simulated once.
        widening: a node that n walks have left holds at most ``ceil((n + 1) ** widening)``
            children; 1: every action is tried before a walk goes deeper.
        depth: levels of the tree at most.
        rollout_policy: ``greedy`` (epsilon-greedy on Q) or uniformly ``random``.
        backup: ``mean`` of the returns through a node, or ``max``: reward and the largest
            value among what was tried below and Q of what was not.
        final: ``best-mean``, ``most-visits`` (ties by mean) or ``gumbel`` (the survivor).
        random_first: with probability ``epsilon`` act at random without any search (epsilon-MCTS).
        gumbel: settings of that rule.
    """

    budget: int = 10
    epsilon: float = 0.05
    rollout: int = 1
    prior: bool = True
    distinct: bool = False
    expansion: str = "epsilon-greedy"
    exploration: float = 2.0
    repeats: bool = False
    widening: float = 1.0
    depth: int = NO_LIMIT
    rollout_policy: str = "greedy"
    backup: str = "mean"
    final: str = "best-mean"
    random_first: bool = False
    gumbel: GumbelConfig = field(default_factory=GumbelConfig)

    def __post_init__(self) -> None:
        check_types(self)
        check_instance("gumbel", self.gumbel, GumbelConfig, "a GumbelConfig")
        check_fields(
            self,
            ("budget", self.budget >= 0, "a whole number of at least 0"),
            ("epsilon", 0 <= self.epsilon <= 1, "0 <= epsilon <= 1"),
            ("rollout", self.rollout >= 1, "at least 1 step"),
            ("exploration", 0 <= self.exploration < math.inf, "a number of at least 0"),
            ("widening", 0 < self.widening <= 1, "0 < widening <= 1"),
            ("depth", self.depth >= 1, "at least 1 level"),
        )
        for name, valid in NAMES.items():
            check_name(name, getattr(self, name), valid)
        if self.final == "gumbel" and self.expansion != "gumbel":
            raise InputError("final", self.final, "best-mean or most-visits, or expansion gumbel")

    @property
    def uses_q(self) -> bool:
        """Whether the choice among untried actions looks at Q."""
        return self.budget == 0 or self.prior or self.expansion != "uct" or self.backup == "max"


SEARCHES: Registry[SearchConfig] = Registry(
    "search",
    {
        # Published. The first three are one search; tables name it after the agents' training.
        "mcts": SearchConfig(),
        "dqn-mcts": SearchConfig(),
        "q-mcts": SearchConfig(),
        "eps-mcts": SearchConfig(expansion="uct", random_first=True),
        # Plain UCT: nothing learned takes part in it.
        "uct": SearchConfig(
            budget=1000,
            expansion="uct",
            prior=False,
            repeats=True,
            rollout=TO_THE_END,
            rollout_policy="random",
        ),
        # Ours.
        "distinct": SearchConfig(distinct=True),
        "widening": SearchConfig(
            distinct=True, expansion="uct", widening=0.8, exploration=0.2, backup="max"
        ),
        "gumbel": SearchConfig(
            distinct=True,
            expansion="gumbel",
            repeats=True,
            final="gumbel",
            backup="max",
            gumbel=GumbelConfig(considered=8),
        ),
    },
)


def register_search(name: str, search: SearchConfig) -> None:
    """Make a search known by name, in :data:`SEARCHES`, to every command that takes one.

    Raises:
        InputError: for a name that is taken.
    """
    if not isinstance(search, SearchConfig):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise InputError("search", search, "a SearchConfig")
    SEARCHES.register(name, search)


def training_search(method: str, budget: int, epsilon: float) -> SearchConfig:
    """The search of a learner during training: one step, epsilon by its schedule."""
    return replace(SEARCHES[method], budget=budget, epsilon=epsilon)
