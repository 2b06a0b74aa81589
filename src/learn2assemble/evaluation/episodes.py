"""Whole evaluation episodes and the paper's metrics (protocol 12.1)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from learn2assemble.networks.build import Network
from learn2assemble.physics.protocol import Physics
from learn2assemble.planning.legacy import LegacyModel
from learn2assemble.planning.world_model import WorldModel
from learn2assemble.search.config import SearchConfig
from learn2assemble.search.mcts import search
from learn2assemble.search.model import SearchModel
from learn2assemble.simulator import Simulator
from learn2assemble.task import Task
from learn2assemble.world.state import State

EVALUATION_STREAM = 2
"""First word of every evaluation seed; training uses another (``trainer.TRAINING_STREAM``)."""
BATCH = 50
"""Episodes played side by side."""

Policy = Callable[[State, np.random.Generator], np.ndarray]
"""Actions int64[B, 3] (local indices) for every row of a state."""


@dataclass(frozen=True)
class Metrics:
    """Means over episodes; ``R_ci95`` is the half width of the 95 % interval of R."""

    R: float
    R_ci95: float
    a: float
    """Actions an episode."""
    f: float
    """Share of episodes ended by an invalid action."""
    b: float
    """Share that ran out of blocks without success."""
    success: float
    coverage: float
    """Mean final F_co."""
    episodes: int
    seconds: float
    physics: str

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def greedy_policy(model: WorldModel, epsilon: float) -> Policy:
    """The Q-policy, with a uniform legal action at the rate ``epsilon`` (protocol 11.5, DQN)."""

    def act(state: State, rng: np.random.Generator) -> np.ndarray:
        _, actions = model.best(state)
        for row in np.flatnonzero(rng.random(len(actions)) < epsilon):
            shape = (state.num_unplaced[row], state.num_placed[row], 5)
            actions[row] = [int(rng.integers(n)) for n in shape]
        return actions

    return act


def search_policy(model: SearchModel, config: SearchConfig) -> Policy:
    """A search before every action (protocol 11.5)."""

    def act(state: State, rng: np.random.Generator) -> np.ndarray:
        return np.stack([decision.action for decision in search(model, state, config, rng)])

    return act


def make_policy(
    task: Task,
    network: Network,
    config: SearchConfig | None,
    epsilon: float,
    *,
    legacy: bool = False,
) -> Policy:
    """The policy of an agent: plain Q without ``config``, with search otherwise.

    The search always looks ahead with static physics, whatever judges the episode; with
    ``legacy`` it does so in copies with the published restore faults (protocol 11.6).
    """
    model = WorldModel(Simulator(task), network)
    if config is None or config.budget == 0:
        return greedy_policy(model, epsilon)
    return search_policy(LegacyModel(model, np.random.default_rng(0)) if legacy else model, config)


def episode_generators(seed: int) -> tuple[np.random.Generator, np.random.Generator]:
    """Generators of the problems and of the policy of an evaluation."""
    root = np.random.SeedSequence([EVALUATION_STREAM, seed])
    problems, policy = (np.random.default_rng(s) for s in root.spawn(2))
    return problems, policy


def run_episodes(
    task: Task,
    policy: Policy,
    episodes: int,
    seed: int,
    physics: Physics | None = None,
    progress: Callable[[int], None] | None = None,
) -> Metrics:
    """Play ``episodes`` fresh problems of ``task`` to their end.

    Args:
        seed: of problems and policy; the same seed gives the same problems to every policy.
        physics: the judge of the episodes; static by default.
        progress: called with the number of episodes finished.
    """
    started = time.perf_counter()
    simulator = Simulator(task, physics)
    problem_rng, policy_rng = episode_generators(seed)
    parts = []
    for start in range(0, episodes, BATCH):
        state = simulator.new(min(BATCH, episodes - start), problem_rng)
        parts.append(_play(simulator, state, policy, policy_rng))
        if progress is not None:
            progress(start + state.batch_size)
    returns, actions, failed, success, coverage = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    spread = float(returns.std(ddof=1)) if episodes > 1 else 0.0
    return Metrics(
        R=float(returns.mean()),
        R_ci95=1.96 * spread / math.sqrt(episodes),
        a=float(actions.mean()),
        f=float(failed.mean()),
        b=float((~failed & ~success).mean()),
        success=float(success.mean()),
        coverage=float(coverage.mean()),
        episodes=episodes,
        seconds=time.perf_counter() - started,
        physics=simulator.physics.name,
    )


def _play(
    simulator: Simulator, state: State, policy: Policy, rng: np.random.Generator
) -> tuple[np.ndarray, ...]:
    """Returns, number of actions, failure, success and final F_co of every row."""
    batch = state.batch_size
    returns, count = np.zeros(batch), np.zeros(batch, np.int64)
    failed, success = np.zeros(batch, np.bool_), np.zeros(batch, np.bool_)
    coverage = np.zeros(batch)
    rows, discount = np.arange(batch), 1.0
    while len(rows):
        step = simulator.step(state, policy(state, rng))
        returns[rows] += discount * step.reward
        discount *= simulator.task.discount
        count[rows] += 1
        failed[rows] = step.verdict != 0
        success[rows] = step.success
        coverage[rows] = state.complete_coverage
        going = np.flatnonzero(~step.terminated)
        rows, state = rows[going], state.take(going)
    return returns, count, failed, success, coverage
