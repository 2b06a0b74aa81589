"""Building on a lattice as environments: put down one block after another, until a random design
is filled or fixed goals are met."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded

from learn2assemble.errors import InputError
from learn2assemble.planning.agent import features as design_features
from learn2assemble.planning.agent.designs import Solved, make_design
from learn2assemble.planning.agent.world import World
from learn2assemble.planning.goals import features as goal_features
from learn2assemble.planning.goals.search import Search
from learn2assemble.planning.goals.tasks import fixed_goals
from learn2assemble.planning.goals.world import bears, legal, make_yard, put, relax
from learn2assemble.tasks import DESIGN_TASKS, GOAL_TASKS, DesignTask, GoalTask

_MOST, _BLOCK_COST = 100.0, 0.05
"""No feature is larger; what every block of a structure for goals costs."""


class _CandidateEnv(gymnasium.Env[dict[str, Any], np.int64]):
    """Actions are numbers of the candidates offered; observations their features.

    Observations are ``candidates`` (one row each, zeros after the last), ``summary`` and ``mask``.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": [], "render_fps": 2}

    def __init__(
        self, most: int, num_features: int, num_summary: int, render_mode: str | None
    ) -> None:
        if render_mode is not None:
            raise InputError("render_mode", render_mode, "none")
        self.render_mode = None
        self.observation_space = spaces.Dict({
            "candidates": spaces.Box(-_MOST, _MOST, (most, num_features), np.float32),
            "summary": spaces.Box(-_MOST, _MOST, (num_summary,), np.float32),
            "mask": spaces.MultiBinary(most),
        })  # fmt: skip
        self.action_space = spaces.Discrete(most)
        self.world: World | None = None
        """What has been built; copy it before you change it."""
        self._most = most
        self._offered = np.empty(0, np.int64)
        self._fallen: set[int] = set()
        self._ended = False

    def action_masks(self) -> np.ndarray:
        """bool[max_candidates]: the actions that are offered."""
        return np.arange(self._most) < len(self._offered)

    def _begun(self, action: np.int64 | int) -> World:
        """The world to act on, after the checks that every step makes."""
        if self.world is None or self._ended:
            raise ResetNeeded("call reset() before step()")
        if not self.action_space.contains(np.int64(action)):
            raise InputError("action", action, f"0 to {self._most - 1}")
        return self.world

    def _offer(self, candidates: np.ndarray, cost: np.ndarray) -> None:
        """Offer the cheapest of these candidates."""
        self._offered = candidates[np.argsort(cost, kind="stable")[: self._most]]

    def _observation(self, rows: np.ndarray, summary: np.ndarray) -> dict[str, Any]:
        padded = np.zeros((self._most, rows.shape[1]), np.float32)
        padded[: len(rows)] = np.clip(rows, -_MOST, _MOST)
        mask = self.action_masks().astype(np.int8)
        return {"candidates": padded, "summary": summary, "mask": mask}


class DesignEnv(_CandidateEnv):
    """Build random designs with a known solution.

    An action is the number of a candidate among those offered; legal ones come from below. A block
    that would not stand is not put down, and not offered again until another has been. Observations
    are ``candidates`` (features, one row each, zeros after the last), ``summary`` and ``mask``.

    The reward is the share of wanted cells newly filled, and 1 more for the finished design: the
    share is a potential, so it pays the same by whatever way, and half of every return is for the
    end. An episode ends with the finished design, or when nothing that is offered can stand.

    ``info``: ``family``, ``blocks`` of the known solution, ``coverage``, ``open`` and ``stranded``
    cells (of which no candidate is left), ``success``, ``stood`` (of the last action).

    Args:
        task: of :data:`learn2assemble.tasks.DESIGN_TASKS`, by name or as such.
    """

    def __init__(self, task: DesignTask | str, render_mode: str | None = None) -> None:
        self.task = DESIGN_TASKS[task] if isinstance(task, str) else task
        super().__init__(
            self.task.max_candidates,
            design_features.NUM_FEATURES,
            design_features.NUM_SUMMARY,
            render_mode,
        )
        self.solved: Solved | None = None
        """The design with the solution that was found for it."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Draw a fresh design; ``seed`` restarts the random numbers. There are no options."""
        super().reset(seed=seed)
        self.solved = make_design(self.task, self.np_random)
        self.world, self._fallen, self._ended = World(self.solved.site), set(), False
        return self._observe(), self._info(True)

    def step(
        self, action: np.int64 | int
    ) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Put down one block.

        Raises:
            InputError: for an action outside the action space.
            ResetNeeded: before the first reset and after the end of an episode.
        """
        world = self._begun(action)
        before, stood = world.open, False
        if action < len(self._offered):
            candidate = int(self._offered[action])
            stood = world.place(candidate, program=True)
            self._fallen = set() if stood else self._fallen | {candidate}
        reward = (before - world.open) / int(world.site.wanted.sum())
        observation = self._observe()
        self._ended = not len(self._offered)
        return observation, reward + world.complete, self._ended, False, self._info(stood)

    def _observe(self) -> dict[str, Any]:
        assert self.world is not None
        candidates = self.world.legal()
        candidates = candidates[~np.isin(candidates, list(self._fallen))]
        self._offer(candidates, self.world.site.found.origin[candidates, 2])
        return self._observation(*design_features.describe(self.world, self._offered))

    def _info(self, stood: bool) -> dict[str, Any]:
        assert self.world is not None
        assert self.solved is not None
        total = int(self.world.site.wanted.sum())
        return {
            "action_masks": self.action_masks().astype(np.int8),
            "family": self.solved.family,
            "blocks": len(self.solved.order),
            "coverage": 1 - self.world.open / total,
            "open": self.world.open,
            "stranded": len(self.world.stranded()),
            "success": self.world.complete,
            "stood": stood,
        }


class GoalsEnv(_CandidateEnv):
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

    def __init__(self, task: GoalTask | str, render_mode: str | None = None) -> None:
        self.task = GOAL_TASKS[task] if isinstance(task, str) else task
        self.yard = make_yard(fixed_goals(self.task.goals))
        self._look = Search(self.yard, None)
        super().__init__(
            self.task.max_candidates,
            goal_features.NUM_FEATURES,
            goal_features.NUM_SUMMARY,
            render_mode,
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin with nothing. There are no options, and nothing is random."""
        super().reset(seed=seed)
        self.world, self._ended = World(self.yard.site), False
        self._relaxed = relax(self.yard, self.world)
        self._start = self._relaxed.blocks
        self._fallen = set()
        return self._observe(), self._info(True)

    def step(
        self, action: np.int64 | int
    ) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Put down one block.

        Raises:
            InputError: for an action outside the action space.
            ResetNeeded: before the first reset and after the end of an episode.
        """
        world = self._begun(action)
        grown, reward = None, 0.0
        if action < len(self._offered):
            grown = put(world, int(self._offered[action]))
            self._fallen.add(int(self._offered[action]))
        if grown is not None:
            before, self.world, self._fallen = self._relaxed.blocks, grown, set()
            self._relaxed = relax(self.yard, grown, self._relaxed.price)
            if np.isfinite(self._relaxed.blocks):
                reward = (before - self._relaxed.blocks) / self._start
            reward += self._success() - _BLOCK_COST
        observation = self._observe()
        lost = not np.isfinite(self._relaxed.blocks) or not len(self._offered)
        self._ended = bool(lost or self._success())
        return observation, float(reward), self._ended, False, self._info(grown is not None)

    def _success(self) -> bool:
        assert self.world is not None
        return self._relaxed.blocks == 0 and bears(self.yard, self.world)

    def _observe(self) -> dict[str, Any]:
        assert self.world is not None
        children = legal(self.yard, self.world)
        children = children[~np.isin(children, list(self._fallen))]
        detour = self._relaxed.detour[children] - self._relaxed.used[children]
        self._offer(children, detour)
        helps, _ = self._look.advice(self.world, self._relaxed, self._offered)
        return self._observation(
            *goal_features.describe(self.yard, self.world, self._relaxed, self._offered, helps)
        )

    def _info(self, stood: bool) -> dict[str, Any]:
        assert self.world is not None
        return {
            "action_masks": self.action_masks().astype(np.int8),
            "blocks": len(self.world.placed), "missing": self._relaxed.blocks,
            "success": self._success(), "stood": stood,
        }  # fmt: skip
