"""A cell: one policy on one task under one condition, measured over whole episodes."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from learn2assemble.evaluation.episodes import (
    DISCOUNTS,
    Policy,
    episode_generators,
    lookahead_policy,
    make_policy,
    play_episodes,
    random_policy,
)
from learn2assemble.evaluation.perfect import best_returns, has_bound
from learn2assemble.evaluation.table_spec import AGENT, LOOK_AHEAD, RANDOM
from learn2assemble.judges import JUDGES
from learn2assemble.learning.run import provenance
from learn2assemble.networks.agent import load_agent
from learn2assemble.networks.config import NetworkConfig
from learn2assemble.networks.qnetwork import QNetwork
from learn2assemble.search.config import SearchConfig
from learn2assemble.simulator import Simulator
from learn2assemble.task import Task

BOUND = "bound"
"""The policy that does not play: upper bounds on the returns of the problems."""
DIGITS = 6
"""Decimals kept of returns and coverages."""


@dataclass(frozen=True)
class Cell:
    """What is measured.

    Args:
        task: the problems.
        policy: ``agent``, ``look-ahead``, ``untrained``, ``random`` or ``bound``.
        agent: name of the agent; empty without one.
        search: what precedes every decision.
        epsilon: chance of a random action.
        physics: judge of the episodes.
        seed: of problems and policy.
    """

    task: Task
    policy: str
    agent: str = ""
    search: SearchConfig | None = None
    epsilon: float = 0.0
    physics: str = "static"
    seed: int = 0

    @property
    def path(self) -> str:
        """Its file below the folder of results."""
        if self.policy == BOUND:
            return f"cells/{self.task.name}/{BOUND}.s{self.seed}.json"
        parts = [self.agent or self.policy, _slug(self.search), f"eps{self.epsilon:g}"]
        if self.physics != "static":
            parts.append(self.physics)
        return f"cells/{self.task.name}/{'.'.join(parts)}.json"

    def to_dict(self) -> dict[str, Any]:
        return dataclasses.asdict(self)

    @staticmethod
    def from_dict(values: dict[str, Any]) -> Cell:
        """Inverse of :meth:`to_dict`; fields that came later get their defaults.

        Raises:
            TypeError, KeyError, ValueError: for what is no cell.
        """
        search = values["search"]
        return Cell(
            **{
                **values,
                "task": Task(**values["task"]),
                "search": None if search is None else _rebuild(SearchConfig(), search),
            }
        )


def _rebuild(default: Any, values: dict[str, Any]) -> Any:
    """A configuration from its dictionary, other configurations inside it too."""
    inner = {
        name: _rebuild(getattr(default, name), value)
        for name, value in values.items()
        if dataclasses.is_dataclass(getattr(default, name, None))
    }
    return type(default)(**{**values, **inner})


def _slug(search: SearchConfig | None) -> str:
    """Budget and every setting that is not the default one, for file names."""
    if search is None:
        return "none"
    return "-".join([f"b{search.budget}", *_changes(search, SearchConfig(), "")])


def _changes(config: Any, default: Any, prefix: str) -> list[str]:
    words = []
    for f in dataclasses.fields(config):
        value, usual = getattr(config, f.name), getattr(default, f.name)
        if f.name in ("budget", "epsilon") or value == usual:
            continue
        if dataclasses.is_dataclass(usual):
            words += _changes(value, usual, f"{f.name}.")
        else:
            words.append(f"{prefix}{f.name}={value}")
    return words


def measurable(cell: Cell) -> bool:
    """Whether this version can play it."""
    if cell.policy == BOUND:
        return has_bound(cell.task)
    return cell.physics in JUDGES


def measure(cell: Cell, agent_file: str | None, episodes: int) -> dict[str, Any]:
    """Play ``episodes`` episodes; the numbers of each, with versions, hardware and seconds.

    Args:
        agent_file: weights of the agent, for cells with one.
    """
    started, cpu = time.perf_counter(), time.process_time()
    if cell.policy == BOUND:
        rng, _ = episode_generators(cell.seed)
        arrays = {"returns": _rounded(best_returns(Simulator(cell.task), episodes, rng))}
    else:
        simulator = Simulator(cell.task, cell.physics)
        played = play_episodes(simulator, _policy(cell, agent_file), episodes, cell.seed)
        arrays = {
            "returns": _rounded(played.returns),
            **{
                f"returns_at_{gamma:g}": _rounded(column)
                for gamma, column in zip(DISCOUNTS, played.returns_at.T, strict=True)
                if gamma != cell.task.discount
            },
            "actions": played.actions.tolist(),
            "failed": played.failed.astype(int).tolist(),
            "success": played.success.astype(int).tolist(),
            "coverage": _rounded(played.coverage),
        }
    times = {
        "seconds": round(time.perf_counter() - started, 2),
        "cpu_seconds": round(time.process_time() - cpu, 2),
    }
    return {**provenance("cpu"), **times, "episodes": episodes, **arrays}


def _policy(cell: Cell, agent_file: str | None) -> Policy:
    if cell.policy == LOOK_AHEAD:
        return lookahead_policy(cell.task, cell.epsilon)
    if cell.policy == RANDOM:
        return random_policy(cell.task.num_actions)
    if cell.policy == AGENT:
        assert agent_file is not None
        network = load_agent(str(Path(agent_file))).network
    else:
        # Its values are never asked for: without a prior and with rollouts to the end.
        task = cell.task
        config = NetworkConfig(
            width=8, heads=1, rounds=1, num_actions=task.num_actions, attitudes=task.attitudes
        )
        torch.manual_seed(0)
        network = QNetwork(config)
    return make_policy(cell.task, network.eval(), cell.search, cell.epsilon)


def _rounded(values: Any) -> list[float]:
    return [round(float(value), DIGITS) for value in values]
