"""The builder in the benchmark: ``--policy builder:NAME`` and ``--policy builder-with-search:NAME``
of ``l2a benchmark run``, in the environments of random designs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np

from l2a_lab.builder.network import load_builder
from l2a_lab.builder.search import build
from learn2assemble.envs.candidate_policies import PLANNING
from learn2assemble.envs.designs import DesignEnv
from learn2assemble.envs.suite import SECONDS
from learn2assemble.errors import InputError
from learn2assemble.planning.tiling.world import LatticeWorld


class GreedyBuilder:
    """What the network scores highest of all that is offered: it sees the observation alone.

    Args:
        name: of a builder, or its file.
    """

    knows = "observation"

    def __init__(self, name: str) -> None:
        self.builder = load_builder(name)

    def begin(self, env: gymnasium.Env[Any, Any]) -> None:
        """A new problem.

        Raises:
            InputError: for another task than of designs, whose features are others.
        """
        if not isinstance(env, DesignEnv):
            name = getattr(getattr(env, "task", None), "name", "?")
            raise InputError("task", name, "a task of random designs: designs-*")

    def __call__(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> int:
        offered = observation["candidates"][: int(info["action_masks"].sum())]
        return int(np.argmax(self.builder.scores(offered, observation["summary"])))


class SearchingBuilder(GreedyBuilder):
    """The same with its search, which takes out again what leads to a dead end: it plans in a copy
    of the site, and then puts down what it found; behind that, as :class:`GreedyBuilder`."""

    knows = "model"

    def begin(self, env: gymnasium.Env[Any, Any]) -> None:
        """A new problem, which is planned at once."""
        super().begin(env)
        assert isinstance(env, DesignEnv)
        assert env.world is not None
        self.env = env
        found = build(LatticeWorld(env.world.site), self.builder, seconds=PLANNING * SECONDS)
        self.planned: list[int] = found.world.placed[::-1]

    def __call__(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> int:
        while self.planned:
            numbers = np.flatnonzero(self.env.offered == self.planned.pop())
            if len(numbers):
                return int(numbers[0])
        return super().__call__(observation, info)
