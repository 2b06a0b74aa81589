"""Goals without a drawing as an environment: put down one block after another until all are met."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded

from learn2assemble.errors import InputError
from learn2assemble.planning.agent.world import World
from learn2assemble.planning.goals.features import NUM_FEATURES, NUM_SUMMARY, describe
from learn2assemble.planning.goals.search import Search
from learn2assemble.planning.goals.tasks import fixed_goals
from learn2assemble.planning.goals.world import bears, legal, make_yard, put, relax
from learn2assemble.tasks import GOAL_TASKS, GoalTask

_MOST, _LAST = 100.0, 0.05
"""No feature is larger; what every block costs."""


class GoalsEnv(gymnasium.Env[dict[str, Any], np.int64]):
    """Invent a structure that meets fixed goals.

    An action is the number of a candidate among those offered, the cheapest ways to a goal first. A
    block that would not stand is not put down, and not offered again until another has been.
    Observations are ``candidates`` (features, one row each, zeros after the last), ``summary`` and
    ``mask``.

    The reward is the share of the relaxed plan that a block saves (a potential), less 0.05 for
    every block, and 1 where all goals are met and all loads are borne, which ends the episode. It
    also ends where a goal is out of reach or nothing that is offered can stand.

    ``info``: ``blocks``, ``missing`` (of the relaxed plan), ``success``, ``stood``.

    Args:
        task: of :data:`learn2assemble.tasks.GOAL_TASKS`, by name or as such.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": [], "render_fps": 2}

    def __init__(self, task: GoalTask | str, render_mode: str | None = None) -> None:
        if render_mode is not None:
            raise InputError("render_mode", render_mode, "none")
        self.task = GOAL_TASKS[task] if isinstance(task, str) else task
        self.render_mode = None
        self.yard = make_yard(fixed_goals(self.task.goals))
        self._look = Search(self.yard, None)
        most = self.task.max_candidates
        self.observation_space = spaces.Dict({
            "candidates": spaces.Box(-_MOST, _MOST, (most, NUM_FEATURES), np.float32),
            "summary": spaces.Box(-_MOST, _MOST, (NUM_SUMMARY,), np.float32),
            "mask": spaces.MultiBinary(most),
        })  # fmt: skip
        self.action_space = spaces.Discrete(most)
        self.world: World | None = None
        """What has been built; copy it before you change it."""
        self._ended = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin with nothing. There are no options, and nothing is random."""
        super().reset(seed=seed)
        self.world, self._ended = World(self.yard.site), False
        self._relaxed = relax(self.yard, self.world)
        self._start = self._relaxed.blocks
        self._fallen: set[int] = set()
        return self._observe(), self._info(True)

    def step(
        self, action: np.int64 | int
    ) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Put down one block.

        Raises:
            InputError: for an action outside the action space.
            ResetNeeded: before the first reset and after the end of an episode.
        """
        if self.world is None or self._ended:
            raise ResetNeeded("call reset() before step()")
        if not self.action_space.contains(np.int64(action)):
            raise InputError("action", action, f"0 to {self.task.max_candidates - 1}")
        grown, reward = None, 0.0
        if action < len(self._offered):
            grown = put(self.world, int(self._offered[action]))
            self._fallen.add(int(self._offered[action]))
        if grown is not None:
            before, self.world, self._fallen = self._relaxed.blocks, grown, set()
            self._relaxed = relax(self.yard, grown, self._relaxed.price)
            if np.isfinite(self._relaxed.blocks):
                reward = (before - self._relaxed.blocks) / self._start
            reward += self._success() - _LAST
        observation = self._observe()
        lost = not np.isfinite(self._relaxed.blocks) or not len(self._offered)
        self._ended = bool(lost or self._success())
        return observation, float(reward), self._ended, False, self._info(grown is not None)

    def action_masks(self) -> np.ndarray:
        """bool[max_candidates]: the actions that are offered."""
        return np.arange(self.task.max_candidates) < len(self._offered)

    def _success(self) -> bool:
        assert self.world is not None
        return self._relaxed.blocks == 0 and bears(self.yard, self.world)

    def _observe(self) -> dict[str, Any]:
        assert self.world is not None
        children = legal(self.yard, self.world)
        children = children[~np.isin(children, list(self._fallen))]
        detour = self._relaxed.detour[children] - self._relaxed.used[children]
        most = self.task.max_candidates
        self._offered = children[np.argsort(detour, kind="stable")[:most]]
        padded = np.zeros((most, NUM_FEATURES), np.float32)
        helps, _ = self._look.advice(self.world, self._relaxed, self._offered)
        rows, summary = describe(self.yard, self.world, self._relaxed, self._offered, helps)
        padded[: len(rows)] = np.clip(rows, -_MOST, _MOST)
        mask = self.action_masks().astype(np.int8)
        return {"candidates": padded, "summary": summary, "mask": mask}

    def _info(self, stood: bool) -> dict[str, Any]:
        assert self.world is not None
        return {
            "action_masks": self.action_masks().astype(np.int8),
            "blocks": len(self.world.placed), "missing": self._relaxed.blocks,
            "success": self._success(), "stood": stood,
        }  # fmt: skip
