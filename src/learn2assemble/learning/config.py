"""Training configurations by name: ``paper`` (as published), ``published`` (the same learners on
our schedule), ``fast`` and ``refine`` (ours)."""

from __future__ import annotations

import dataclasses
import math
import typing
from dataclasses import dataclass, field
from typing import Any

from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.networks.config import NetworkConfig


@dataclass(frozen=True)
class TrainConfig:
    """Everything that defines a training besides the task and the seed (protocol 10.1).

    Args:
        method: the learner: ``dqn``, or a search before every step of training, ``q-mcts`` and
            ``eps-mcts`` (protocol 11.5), whose values regularise the loss (protocol 10.4).
        network: the Q-network.
        num_samples: environment steps of the whole training.
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
        steps: n of n-step targets; they end before the first exploratory action.
        target_rate: where positive, the target network follows the online one by this share after
            every gradient step instead of being copied, and the agent is the target network: an
            average of the recent weights.
        double: choose the next action by the online network, value it by the target network.
        terminal_weight: weight of the loss that fits Q to the reward of *every* placement of a
            sampled state that would end the episode (invalid, filled, or out of blocks): there
            the reward is the exact Q. 0: only the action taken (paper). D6.
        share_cell: give the target of the action taken to all (block, reference, relation) that
            put a like block into the same cell. D6.
        reward_weight: weight of the loss that fits the reward head to the reward of *every*
            placement of a sampled state, from the one-step model. D6.
        gain_weight: weight of the loss that fits the gain head to the change of coverage, in units
            of ``GAIN_UNIT``, of every placement of a sampled state. D6.
        exact_next: in targets, replace the predicted reward term of every next placement by the
            known reward, and its Q by the reward where the episode would end. D6.
        imagined: further actions of every sampled state that get a TD target of their own, with
            reward and successor from the one-step model: the one the network would take now,
            then random valid ones. D6.
        augment: mirror the structure and exchange its sides at random. D7.
        search_budget: expansions of a search in training, one step each; not used by ``dqn``.
        search_weight: w_CE, weight of the search term in the loss, that of the TD term being
            1 - w_CE; not used by ``dqn``.
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
    steps: int = 1
    target_rate: float = 0.0
    double: bool = True
    terminal_weight: float = 0.0
    share_cell: bool = False
    reward_weight: float = 0.0
    gain_weight: float = 0.0
    exact_next: bool = False
    imagined: int = 0
    augment: bool = False
    search_budget: int = 5
    search_weight: float = 0.5

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise UnknownNameError("method", self.method, METHODS)
        for name in ("num_samples", "num_envs", "steps_per_round", "updates_per_round",
                     "batch_size", "replay_size", "initial_samples", "epsilon_samples",
                     "target_period", "steps", "search_budget"):  # fmt: skip
            if getattr(self, name) < 1:
                raise InputError(name, getattr(self, name), "a positive whole number")
        for name in ("learning_rate", "final_learning_rate"):
            if not 0 < getattr(self, name) < 1:
                raise InputError(name, getattr(self, name), "a rate between 0 and 1")
        if not 0 <= self.target_rate <= 1:
            raise InputError("target_rate", self.target_rate, "a share between 0 and 1")
        if not 0 <= self.search_weight <= 1:
            raise InputError("search_weight", self.search_weight, "a share between 0 and 1")
        if not 0 <= self.epsilon_final <= 1:
            raise InputError("epsilon_final", self.epsilon_final, "0 <= epsilon <= 1")
        for name in ("terminal_weight", "reward_weight", "gain_weight"):
            if not 0 <= getattr(self, name) < math.inf:
                raise InputError(name, getattr(self, name), "a weight of at least 0")
        if self.reward_weight and not self.network.reward_head:
            raise InputError("reward_weight", self.reward_weight, "0, or network.reward_head")
        if self.exact_next and not self.network.reward_head:
            raise InputError("exact_next", self.exact_next, "false, or network.reward_head")
        if self.gain_weight and not self.network.gain_head:
            raise InputError("gain_weight", self.gain_weight, "0, or network.gain_head")
        if self.imagined < 0:
            raise InputError("imagined", self.imagined, "a whole number of at least 0")

    @property
    def uses_model(self) -> bool:
        """Whether training looks at placements that were not made (deviation D6)."""
        weights = (self.terminal_weight, self.reward_weight, self.gain_weight, self.imagined)
        return self.exact_next or max(weights) > 0

    @property
    def searches(self) -> bool:
        """Whether a search chooses the actions of training."""
        return self.method != "dqn"

    def to_dict(self) -> dict[str, Any]:
        return dataclasses.asdict(self)

    @staticmethod
    def from_dict(values: dict[str, Any]) -> TrainConfig:
        """Inverse of :meth:`to_dict`; unknown keys raise :class:`UnknownNameError`."""
        values = dict(values)
        network = values.pop("network", {})
        return _build(TrainConfig, {**values, "network": _build(NetworkConfig, network)})


def _build(cls: type, values: dict[str, Any]) -> Any:
    names = {f.name for f in dataclasses.fields(cls)}
    for key in values:
        if key not in names:
            raise UnknownNameError(f"{cls.__name__} field", key, names)
    return cls(**values)


def override(config: TrainConfig, assignments: list[str]) -> TrainConfig:
    """Apply ``key=value`` or ``network.key=value`` assignments.

    Raises:
        InputError: for a malformed assignment or a value of the wrong type.
        UnknownNameError: for a key that does not exist.
    """
    for text in assignments:
        key, sign, value = text.partition("=")
        if not sign:
            raise InputError("--set", text, "KEY=VALUE")
        owner: Any = config
        if key.startswith("network."):
            key, owner = key.removeprefix("network."), config.network
        hints = typing.get_type_hints(type(owner))
        if key not in hints or key == "network":
            raise UnknownNameError("--set", key, hints)
        changed = dataclasses.replace(owner, **{key: _parse(key, value, getattr(owner, key))})
        config = changed if owner is config else dataclasses.replace(config, network=changed)
    return config


def _parse(key: str, text: str, current: Any) -> Any:
    try:
        if isinstance(current, bool):
            return {"true": True, "false": False}[text.lower()]
        return type(current)(text)
    except (ValueError, KeyError):
        raise InputError(f"--set {key}", text, f"a value like {current!r}") from None


METHODS = ("dqn", "q-mcts", "eps-mcts")

_FAST_NETWORK = NetworkConfig(heads=2, position_scale=0.1, rotary=True, reward_head=True)

CONFIGS: dict[str, TrainConfig] = {
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
    # The published learners and network on the schedule of "fast": --set method=q-mcts or eps-mcts.
    "published": TrainConfig(
        num_samples=240_000,
        learning_rate=2e-3,
        final_learning_rate=1e-4,
        epsilon_samples=25_000,
        batch_size=32,
        updates_per_round=4,
        augment=True,
    ),
    "fast": TrainConfig(
        network=_FAST_NETWORK,
        num_samples=450_000,
        learning_rate=2e-3,
        final_learning_rate=1e-4,
        epsilon_samples=25_000,
        batch_size=32,
        updates_per_round=4,
        terminal_weight=1.0,
        share_cell=True,
        reward_weight=1.0,
        augment=True,
    ),
    # A second stage from the weights of the first (--init): the reward of thin slivers of an
    # outline is what the first stage leaves inaccurate.
    "refine": TrainConfig(
        network=_FAST_NETWORK,
        num_samples=140_000,
        learning_rate=1e-3,
        final_learning_rate=3e-5,
        initial_samples=16_000,
        epsilon_samples=1,
        batch_size=32,
        updates_per_round=4,
        terminal_weight=1.0,
        share_cell=True,
        reward_weight=4.0,
        augment=True,
    ),
}


def get_config(name: str) -> TrainConfig:
    """The configuration called ``name``.

    Raises:
        UnknownNameError: naming the nearest one.
    """
    if name not in CONFIGS:
        raise UnknownNameError("config", name, CONFIGS)
    return CONFIGS[name]
