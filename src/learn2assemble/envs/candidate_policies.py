"""Baselines of the tasks of candidates, random designs and goals; all know the model."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, Generic, TypeVar, cast

import gymnasium
import numpy as np

from learn2assemble.envs.designs import DesignEnv, GoalsEnv
from learn2assemble.envs.suite import SECONDS
from learn2assemble.errors import InputError
from learn2assemble.planning.goals.program import MOST, plan_program
from learn2assemble.planning.goals.search import search
from learn2assemble.planning.tiling.exact import plan_exact

LOOKS = 32
"""So many candidates of a design are looked at."""
PLANNING = 0.8
"""Share of the time of a problem that is for planning."""
SEARCHING, PROGRAM = 10.0, 25.0
"""Seconds, at most, for the search in front of the exact program of goals, and for the program,
which may end some seconds late."""


Env = TypeVar("Env", bound=DesignEnv | GoalsEnv)


class OnCandidates(Generic[Env]):
    """Chooses candidates of a task of random designs or of goals.

    Raises:
        InputError: for another task.
    """

    knows = "model"
    env: Env

    def begin(self, env: gymnasium.Env[Any, Any]) -> None:
        """A new problem."""
        if not isinstance(env, DesignEnv | GoalsEnv):
            name = getattr(getattr(env, "task", None), "name", "?")
            raise InputError("task", name, "a task of candidates: designs-* or goals-*")
        self.env = cast("Env", env)


def lowest(env: DesignEnv) -> np.ndarray:
    """int64[k]: numbers of what is offered, lowest first, and of one level the largest."""
    assert env.world is not None
    found, offered = env.world.site.found, env.offered
    return np.lexsort((-found.size()[offered], found.origin[offered, 2]))


class DesignLookahead(OnCandidates[DesignEnv]):
    """One step ahead: of the :data:`LOOKS` lowest and largest candidates that would stand, the one
    that leaves the fewest cells which nothing can fill any more."""

    def __call__(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> int:
        order, world = lowest(self.env), self.env.world
        assert world is not None
        best: tuple[int, int] | None = None
        for place, number in enumerate(order[:LOOKS].tolist()):
            after = world.copy()
            if after.place(int(self.env.offered[number]), program=True):
                best = min(best or (world.open, 0), (len(after.stranded()), place))
        return int(order[0 if best is None else best[1]])


class GoalsLookahead(OnCandidates[GoalsEnv]):
    """One step ahead: of all that is offered and would stand, what brings the largest reward at
    once; of several, what is offered first, the cheapest way to a goal."""

    def __call__(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> int:
        return int(np.argmax([self._brings(k) for k in range(len(self.env.offered))]))

    def _brings(self, number: int) -> float:
        # A step puts new values into the environment and changes none: a flat copy is enough.
        _, reward, _, _, told = copy.copy(self.env).step(number)
        return reward if told["stood"] and np.isfinite(told["missing"]) else -np.inf


class ExactPlanner(OnCandidates[DesignEnv | GoalsEnv]):
    """Builds as the exact planner plans a design for its kit and heap, or the structure for goals
    with the fewest blocks that it finds; where that is none in time, what is lowest and largest, or
    the cheapest way to a goal."""

    def begin(self, env: gymnasium.Env[Any, Any]) -> None:
        """A new problem, which is planned at once."""
        super().begin(env)
        mine = self.env
        planned = _plan_design(mine) if isinstance(mine, DesignEnv) else _plan_goals(mine)
        self.planned: list[int] = planned[::-1]

    def __call__(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> int:
        while self.planned:
            numbers = np.flatnonzero(self.env.offered == self.planned.pop())
            if len(numbers):
                return int(numbers[0])
        return int(lowest(self.env)[0]) if isinstance(self.env, DesignEnv) else 0


def _plan_design(env: DesignEnv) -> list[int]:
    """Candidates in the order of building; none where no plan is found in time."""
    assert env.world is not None
    site = env.world.site
    made, ordering = plan_exact(
        site.wanted, site.kit, props_allowed=False, seconds=PLANNING * SECONDS
    )
    if ordering is None or ordering.status != "complete":
        return []
    placements = [made.placements[step.block] for step in ordering.steps]
    return site.candidates(placements).tolist()


def _plan_goals(env: GoalsEnv) -> list[int]:
    """The same of the structure that the search finds, or of one with fewer blocks where the exact
    program finds one in time."""
    found = search(env.problem, seconds=SEARCHING)
    most = found.blocks - 1 if found.blocks else MOST
    fewer = plan_program(env.problem, seconds=PROGRAM, most=most)
    return env.problem.site.candidates(fewer.placements or found.placements).tolist()
