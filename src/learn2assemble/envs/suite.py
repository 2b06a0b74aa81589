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
from learn2assemble.envs.hidden import HiddenEnv
from learn2assemble.envs.pictures import pictures_of
from learn2assemble.errors import InputError, UnknownNameError, is_whole, look_up
from learn2assemble.tasks.evaluation.bounds import quick_bound
from learn2assemble.tasks.evaluation.episodes import EVALUATION_STREAM
from learn2assemble.tasks.task import PRESETS

SUITE_VERSION = 3
"""Raised with every change of tasks, problems, rules or scores: entries of two do not compare."""
PROBLEM_VERSION = 2
"""Version of the suite since which problems of the same number are the same."""
SECONDS, MOST_ACTIONS = 60.0, 2000
"""Budget of a problem: time a policy may think [s, wall clock], and actions. Beyond either it is
asked no more, and what has been built counts."""
Choose = Callable[[Mapping[str, Any], Mapping[str, Any]], int]
"""A policy: an observation and what ``info`` says, to the number of an action. One that has a
method ``begin(env)`` is given the environment of every problem, to look ahead in copies of it; it
knows the model then, unless its attribute ``knows`` says ``"observation"``. Where something is
hidden, the environment that it is given has other hidden numbers. One whose attribute
``observations`` says ``"picture"`` sees what :mod:`learn2assemble.envs.pictures` shows."""
SUITE: dict[str, int] = {
    "two-sided-3x3-20-24": 50,
    "two-sided-5x5-40-44": 50,
    "robot-two-sided-3x3-10-14": 20,
    "designs-lintels-60-held-out": 20,
    "designs-lintels-60-heap-held-out": 20,
    "designs-lintels-400-heap-held-out": 20,
    "hidden-designs-20": 20,
    "goals-bridge": 1,
    "goals-cantilever": 1,
    "goals-table": 1,
}
"""How many problems each task has; the goals are fixed."""


_OBSERVATIONS = ("state", "picture")


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

        how: dict[str, Any] = {"actions": "placements"} if self.name in PRESETS else {}
        return gymnasium.make(env_id(self.name), **how).unwrapped

    def seed(self, problem: int) -> int:
        """What the environment is reset with: from the stream of evaluations, never of training.

        Raises:
            InputError: for a problem that it does not have.
        """
        if not is_whole(problem, 0, SUITE[self.name] - 1):
            raise InputError("problem", problem, f"0 to {SUITE[self.name] - 1} of {self.name}")
        words = np.random.SeedSequence([EVALUATION_STREAM, PROBLEM_VERSION, problem])
        return int(words.generate_state(1, np.uint64)[0])

    def play(self, env: gymnasium.Env[Any, Any], problem: int, policy: Choose) -> Played:
        """Play one problem.

        Raises:
            InputError: for an action outside the action space, and where there are no pictures.
            UnknownNameError: for observations that are none.
        """
        observation, info = env.reset(seed=self.seed(problem))
        pictures = pictures_of(env) if _wants_pictures(policy) else None
        most, discount = _terms(env)
        actions: list[int] = []
        total, factor, thought, ended = 0.0, 1.0, 0.0, False
        if (begin := getattr(policy, "begin", None)) is not None:
            started = time.perf_counter()
            begin(env.imagined() if isinstance(env, HiddenEnv) else env)
            thought = time.perf_counter() - started
        while not ended and thought < SECONDS and len(actions) < MOST_ACTIONS:
            started = time.perf_counter()
            try:
                action = policy(observation if pictures is None else pictures.observe(), info)
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


def _wants_pictures(policy: Choose) -> bool:
    """Whether a policy sees pictures in place of states."""
    wanted = getattr(policy, "observations", "state")
    if wanted not in _OBSERVATIONS:
        raise UnknownNameError("observations of the policy", wanted, _OBSERVATIONS)
    return wanted == "picture"


def _terms(env: gymnasium.Env[Any, Any]) -> tuple[float, float]:
    """The bound of the return of a fresh problem, and the discount of returns."""
    if isinstance(env, AssemblyEnv):
        return float(quick_bound(env.task, env.state)[0]), env.task.discount
    if isinstance(env, HiddenEnv):
        return 1.0, 1.0
    # The share that is filled, and the end; a structure for goals has one block at least.
    return (2.0 if isinstance(env, DesignEnv) else 2.0 - BLOCK_COST), 1.0
