"""The benchmark: tasks, fixed problems, what a score is, and how one problem is played.

All tasks are played through their Gymnasium environments, those of the paper with one action for
every distinct placement. A *score* is the return of a problem as a share of a bound that no policy
exceeds; the bound may be out of reach.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from learn2assemble.envs.assembly import AssemblyEnv
from learn2assemble.envs.designs import BLOCK_COST, DesignEnv
from learn2assemble.errors import InputError, is_whole, look_up
from learn2assemble.tasks.evaluation.bounds import quick_bound
from learn2assemble.tasks.evaluation.episodes import EVALUATION_STREAM
from learn2assemble.tasks.task import DESIGN_TASKS, GOAL_TASKS

SUITE_VERSION = 2
"""Raised with every change of tasks, problems, rules or scores: entries of two do not compare."""
SECONDS, MOST_ACTIONS = 60.0, 2000
"""Budget of a problem: time a policy may think [s, wall clock], and actions. Beyond either it is
asked no more, and what has been built counts."""
Choose = Callable[[Mapping[str, Any], Mapping[str, Any]], int]
"""A policy: an observation and what ``info`` says, to the number of an action. One that has a
method ``begin(env)`` is given the environment of every problem, to look ahead in copies of it; it
knows the model then, unless its attribute ``knows`` says ``"observation"``."""
SUITE: dict[str, int] = {
    "two-sided-3x3-20-24": 50,
    "two-sided-5x5-40-44": 50,
    "robot-two-sided-3x3-10-14": 20,
    "designs-lintels-60-held-out": 20,
    "designs-lintels-60-heap-held-out": 20,
    "designs-lintels-400-heap-held-out": 20,
    "goals-bridge": 1,
    "goals-cantilever": 1,
    "goals-table": 1,
}
"""How many problems each task has; the goals are fixed."""


class Played(NamedTuple):
    """A problem that was played."""

    actions: list[int]
    score: float
    success: bool


@dataclass(frozen=True)
class SuiteTask:
    """A task of the suite.

    Args:
        name: of :data:`SUITE`.
    """

    name: str

    def __post_init__(self) -> None:
        look_up("task of the benchmark", self.name, SUITE)

    def make(self) -> gymnasium.Env[Any, Any]:
        """Its environment."""
        from learn2assemble.envs import env_id

        compact = self.name not in DESIGN_TASKS and self.name not in GOAL_TASKS
        how: dict[str, Any] = {"actions": "placements"} if compact else {}
        return gymnasium.make(env_id(self.name), **how).unwrapped

    def seed(self, problem: int) -> int:
        """What the environment is reset with: from the stream of evaluations, never of training.

        Raises:
            InputError: for a problem that it does not have.
        """
        if not is_whole(problem, 0, SUITE[self.name] - 1):
            raise InputError("problem", problem, f"0 to {SUITE[self.name] - 1} of {self.name}")
        words = np.random.SeedSequence([EVALUATION_STREAM, SUITE_VERSION, problem])
        return int(words.generate_state(1, np.uint64)[0])

    def play(self, env: gymnasium.Env[Any, Any], problem: int, policy: Choose) -> Played:
        """Play one problem.

        Raises:
            InputError: for an action outside the action space.
        """
        observation, info = env.reset(seed=self.seed(problem))
        most, discount = _terms(env)
        actions: list[int] = []
        total, factor, thought, ended = 0.0, 1.0, 0.0, False
        if (begin := getattr(policy, "begin", None)) is not None:
            started = time.perf_counter()
            begin(env)
            thought = time.perf_counter() - started
        while not ended and thought < SECONDS and len(actions) < MOST_ACTIONS:
            started = time.perf_counter()
            try:
                action = policy(observation, info)
            except StopIteration:  # A recording that ends here.
                break
            thought += time.perf_counter() - started
            if not is_whole(action, 0):
                raise InputError("action of the policy", action, "a whole number of at least 0")
            observation, reward, ended, _, info = env.step(np.int64(action))
            total += factor * float(reward)
            factor *= discount
            actions.append(int(action))
        return Played(actions, total / most, bool(info.get("success", False)))


def _terms(env: gymnasium.Env[Any, Any]) -> tuple[float, float]:
    """The bound of the return of a fresh problem, and the discount of returns."""
    if isinstance(env, AssemblyEnv):
        return float(quick_bound(env.task, env.state)[0]), env.task.discount
    # The share that is filled, and the end; a structure for goals has one block at least.
    return (2.0 if isinstance(env, DesignEnv) else 2.0 - BLOCK_COST), 1.0
