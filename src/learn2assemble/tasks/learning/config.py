"""Training configurations by name: ``paper`` (as published), ``published`` (the same learners on
our schedule) and ``relational`` (our own method)."""

from __future__ import annotations

import dataclasses
import functools
import math
import typing
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from learn2assemble.errors import InputError, check_fields, check_instance, check_name, check_types
from learn2assemble.registry import Registry
from learn2assemble.tasks.checkers import checker_names
from learn2assemble.tasks.networks.config import NetworkConfig
from learn2assemble.tasks.search.config import SearchConfig, training_search
from learn2assemble.tasks.task import Task

LARGEST = {
    "num_envs": 10**5,
    "batch_size": 10**5,
    "replay_size": 10**7,
    "steps_per_round": 10**6,
    "updates_per_round": 10**6,
    "search_budget": 10**5,
    "num_samples": 10**12,
    "initial_samples": 10**12,
    "epsilon_samples": 10**12,
    "target_period": 10**12,
}
"""Whole numbers from 1; beyond these no training would fit into any machine's memory or time."""


_ONCE = (("steps", 1), ("target_rate", 0.0))
"""What agents were trained with when these were settings; all others are refused."""


@dataclass(frozen=True)
class TrainConfig:
    """Everything that defines a training besides the task and the seed.

    Args:
        method: the learner: ``dqn``, or a search before every step of training, ``q-mcts`` and
            ``eps-mcts``, whose values regularise the loss.
        network: the Q-network.
        num_samples: environment steps of the whole training; it ends with the first step of all
            worlds that reaches them.
        num_envs: worlds stepped at once.
        steps_per_round: steps of every world between two phases of learning.
        updates_per_round: gradient steps of one phase of learning.
        batch_size: transitions a gradient step.
        learning_rate: of Adam at the start.
        final_learning_rate: at the end; cosine in between (equal values: constant).
        replay_size: transitions kept.
        initial_samples: steps before the first gradient step.
        epsilon_final: exploration rate in the end; it starts at 1.
        epsilon_samples: steps until then, linearly.
        target_period: gradient steps between two copies to the target network.
        double: choose the next action by the online network, value it by the target network.
        dense_weight: weight of the loss that fits the reward part of Q, and Q itself where the
            episode would end, to the one-step model's outcome of *every* placement of a sampled
            state; needs the encoder ``relational``. 0: only the action taken (paper). D6.
        augment: mirror the structure and exchange its sides at random; for cubes and the published
            encoders. D7.
        search_budget: expansions of a search in training, one step each; not used by ``dqn``.
        search_weight: w_CE, weight of the search term in the loss, that of the TD term being
            1 - w_CE; not used by ``dqn``.
        physics: name of what checks placements in training, see
            :func:`learn2assemble.tasks.checkers.resolve_checker`; empty: the task's own.
    """

    method: str = "dqn"
    network: NetworkConfig = field(default_factory=NetworkConfig)
    num_samples: int = 300_000
    num_envs: int = 32
    steps_per_round: int = 1
    updates_per_round: int = 2
    batch_size: int = 128
    learning_rate: float = 5e-4
    final_learning_rate: float = 5e-4
    replay_size: int = 60_000
    initial_samples: int = 1000
    epsilon_final: float = 0.05
    epsilon_samples: int = 40_000
    target_period: int = 300
    double: bool = True
    dense_weight: float = 0.0
    augment: bool = False
    search_budget: int = 5
    search_weight: float = 0.5
    physics: str = ""

    def __post_init__(self) -> None:
        check_types(self)
        check_instance("network", self.network, NetworkConfig, "a NetworkConfig")
        check_name("method", self.method, METHODS)
        if self.physics:
            check_name("physics", self.physics, dict.fromkeys(checker_names()))
        relational, encoder = self.network.values_placements, self.network.encoder
        check_fields(
            self,
            *(
                (name, 1 <= getattr(self, name) <= most, f"a whole number from 1 to {most}")
                for name, most in LARGEST.items()
            ),
            *(
                (name, 0 < getattr(self, name) < 1, "a rate between 0 and 1")
                for name in ("learning_rate", "final_learning_rate")
            ),
            ("search_weight", 0 <= self.search_weight <= 1, "a share between 0 and 1"),
            ("epsilon_final", 0 <= self.epsilon_final <= 1, "0 <= epsilon <= 1"),
            ("dense_weight", 0 <= self.dense_weight < math.inf, "a weight of at least 0"),
            ("dense_weight", relational or not self.dense_weight, "0 unless encoder is relational"),
            ("augment", not (self.augment and relational), f"false for the encoder {encoder}"),
        )

    def to_dict(self) -> dict[str, Any]:
        return dataclasses.asdict(self)

    @staticmethod
    def from_dict(values: dict[str, Any]) -> TrainConfig:
        """Inverse of :meth:`to_dict`; unknown keys raise :class:`UnknownNameError`."""
        values = {k: v for k, v in values.items() if (k, v) not in _ONCE}
        network = dict(values.pop("network", {}))
        for kind, given in ((TrainConfig, values), (NetworkConfig, network)):
            for key in given:
                check_name(f"{kind.__name__} field", key, kind.__dataclass_fields__)
        return TrainConfig(network=NetworkConfig(**network), **values)


def override(config: TrainConfig, assignments: list[str]) -> TrainConfig:
    """Apply ``key=value`` or ``network.key=value`` assignments.

    Raises:
        InputError: for a malformed assignment or a value of the wrong type.
        UnknownNameError: for a key that does not exist.
    """
    changes: dict[str, dict[str, Any]] = {"": {}, "network.": {}}
    for text in assignments:
        key, sign, value = text.partition("=")
        if not sign:
            raise InputError("settings", text, "KEY=VALUE")
        part = "network." if key.startswith("network.") else ""
        key, owner = key.removeprefix(part), config.network if part else config
        hints = typing.get_type_hints(type(owner))
        check_name("settings", key, hints.keys() - {"network"})
        changes[part][key] = _parse(key, value, getattr(owner, key))
    # All at once: what is valid together need not be valid one after the other.
    network = dataclasses.replace(config.network, **changes["network."])
    return dataclasses.replace(config, network=network, **changes[""])


def _parse(key: str, text: str, current: Any) -> Any:
    try:
        if isinstance(current, bool):
            return {"true": True, "false": False}[text.lower()]
        return type(current)(text)
    except (ValueError, KeyError):
        raise InputError(f"settings: {key}", text, f"a value like {current!r}") from None


@dataclass(frozen=True)
class Learner:
    """A method of learning.

    Args:
        search: the search that chooses the actions of training, from the number of expansions and
            the exploration rate; ``None``: epsilon-greedy on Q.
        loss: loss of one batch and numbers to log; arguments and result as those of
            :func:`learn2assemble.tasks.learning.trainer.q_loss`, which is the default.
    """

    search: Callable[[int, float], SearchConfig] | None = None
    loss: Callable[..., tuple[Any, dict[str, float]]] | None = None


METHODS: Registry[Learner] = Registry(
    "method",
    {
        "dqn": Learner(),
        "q-mcts": Learner(functools.partial(training_search, "q-mcts")),
        "eps-mcts": Learner(functools.partial(training_search, "eps-mcts")),
    },
)


def register_learner(name: str, learner: Learner) -> None:
    """Make a method of learning known as ``method`` of :class:`TrainConfig`.

    Raises:
        InputError: for a name that is taken, and a search or loss that is no function.
    """
    if not isinstance(learner, Learner):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise InputError("learner", learner, "a Learner")
    check_fields(
        learner,
        (
            "search",
            learner.search is None or callable(learner.search),
            "a function of budget and epsilon that returns a SearchConfig, or None",
        ),
        ("loss", learner.loss is None or callable(learner.loss), "a function like q_loss, or None"),
    )
    METHODS.register(name, learner)


_RELATIONAL = TrainConfig(
    network=NetworkConfig(encoder="relational", rounds=2),
    num_samples=100_000,
    learning_rate=1e-3,
    final_learning_rate=3e-5,
    epsilon_samples=20_000,
    batch_size=32,
    updates_per_round=4,
    dense_weight=1.0,
)
"""Our own method."""

CONFIGS: Registry[TrainConfig] = Registry(
    "config",
    {
        "paper": TrainConfig(
            network=NetworkConfig(feed_forward="wide"),
            num_samples=500_000,
            num_envs=4,
            steps_per_round=25,
            updates_per_round=25,
            batch_size=32,
            learning_rate=1e-4,
            final_learning_rate=1e-4,
            replay_size=30_000,
            epsilon_samples=100_000,
            target_period=1250,
            double=False,
        ),
        # The published learners and networks with a quarter of the gradient steps (deviation D8).
        "published": TrainConfig(
            num_samples=240_000,
            learning_rate=2e-3,
            final_learning_rate=1e-4,
            epsilon_samples=25_000,
            batch_size=32,
            updates_per_round=4,
            augment=True,
        ),
        "relational": _RELATIONAL,
        # Objects of several cells have ten times as many placements.
        "relational-objects": dataclasses.replace(
            _RELATIONAL,
            num_samples=60_000,
            replay_size=20_000,
            epsilon_samples=15_000,
            batch_size=16,
        ),
    },
)


def fit_to(config: TrainConfig, task: Task) -> TrainConfig:
    """The configuration with what the task decides: its actions and lattice, whether there is a
    hand to look around, and no symmetries that only cubes without a robot have."""
    network = dataclasses.replace(
        config.network,
        num_actions=task.num_actions,
        action_mode=task.action_mode,
        pitch=task.pitch,
        sight=task.sight,
        hand=task.has_arm and config.network.encoder == "relational",
    )
    augment = config.augment and task.objects == "cubes" and task.touching
    return dataclasses.replace(config, network=network, augment=augment)
