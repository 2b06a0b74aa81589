"""Designs of cells as an environment: put down one block after another until all is filled."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded

from learn2assemble.errors import InputError
from learn2assemble.planning.agent.designs import Solved, make_design
from learn2assemble.planning.agent.features import NUM_FEATURES, NUM_SUMMARY, describe
from learn2assemble.planning.agent.world import World
from learn2assemble.tasks import DESIGN_TASKS, DesignTask

_MOST = 100.0
"""No feature is larger."""


class DesignEnv(gymnasium.Env[dict[str, Any], np.int64]):
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

    metadata: ClassVar[dict[str, Any]] = {"render_modes": [], "render_fps": 2}

    def __init__(self, task: DesignTask | str, render_mode: str | None = None) -> None:
        if render_mode is not None:
            raise InputError("render_mode", render_mode, "none")
        self.task = DESIGN_TASKS[task] if isinstance(task, str) else task
        self.render_mode = None
        most = self.task.max_candidates
        self.observation_space = spaces.Dict({
            "candidates": spaces.Box(-_MOST, _MOST, (most, NUM_FEATURES), np.float32),
            "summary": spaces.Box(-_MOST, _MOST, (NUM_SUMMARY,), np.float32),
            "mask": spaces.MultiBinary(most),
        })  # fmt: skip
        self.action_space = spaces.Discrete(most)
        self.world: World | None = None
        """What has been built; copy it before you change it."""
        self.solved: Solved | None = None
        """The design with the solution that was found for it."""
        self._offered = np.empty(0, np.int64)
        self._fallen: set[int] = set()
        self._ended = False

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
        if self.world is None or self._ended:
            raise ResetNeeded("call reset() before step()")
        if not self.action_space.contains(np.int64(action)):
            raise InputError("action", action, f"0 to {self.task.max_candidates - 1}")
        before, stood = self.world.open, False
        if action < len(self._offered):
            candidate = int(self._offered[action])
            stood = self.world.place(candidate, program=True)
            self._fallen = set() if stood else self._fallen | {candidate}
        reward = (before - self.world.open) / int(self.world.site.wanted.sum())
        observation = self._observe()
        self._ended = not len(self._offered)
        return observation, reward + self.world.complete, self._ended, False, self._info(stood)

    def action_masks(self) -> np.ndarray:
        """bool[max_candidates]: the actions that are offered."""
        return np.arange(self.task.max_candidates) < len(self._offered)

    def _observe(self) -> dict[str, Any]:
        assert self.world is not None
        legal = self.world.legal()
        legal = legal[~np.isin(legal, list(self._fallen))]
        lowest = np.argsort(self.world.site.found.origin[legal, 2], kind="stable")
        self._offered = legal[lowest[: self.task.max_candidates]]
        rows, summary = describe(self.world, self._offered)
        padded = np.zeros((self.task.max_candidates, NUM_FEATURES), np.float32)
        padded[: len(rows)] = rows
        return {
            "candidates": padded,
            "summary": summary,
            "mask": self.action_masks().astype(np.int8),
        }

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
