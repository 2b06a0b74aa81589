"""The environment of one world."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded

from learn2assemble.envs import spaces
from learn2assemble.envs.worlds import RENDER_MODES, Worlds, check_render_mode
from learn2assemble.physics.protocol import Physics
from learn2assemble.tasks import Task


class AssemblyEnv(gymnasium.Env[dict[str, Any], np.int64]):
    """Place blocks until the target elevations are filled.

    Actions are flat indices of (i, j, k), observations graphs; see
    :mod:`learn2assemble.envs.spaces`. Illegal i and j are clipped like in the published code, and
    ``info["clipped"]`` says so. An episode ends with an invalid placement, the filled target or
    the last block; it is never truncated.

    ``info``: ``action_masks``, ``physics_mask``, ``coverage``, ``plane_coverage``
    (:meth:`Worlds.info`), and after a step ``verdict`` (name of a
    :class:`~learn2assemble.physics.protocol.Verdict`), ``success`` and ``clipped``.

    Args:
        task: the task, or the name of a preset.
        physics: ``static``, ``rigid`` or a physics.
        physics_mask: whether infos carry ``physics_mask``.
        render_mode: None, ``ansi`` or ``rgb_array``.

    Raises:
        UnknownNameError: for a preset, physics or render mode that does not exist.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": list(RENDER_MODES), "render_fps": 2}

    def __init__(
        self,
        task: Task | str,
        physics: str | Physics = "static",
        physics_mask: bool = True,
        render_mode: str | None = None,
    ) -> None:
        self._worlds = Worlds(task, physics, 1, physics_mask)
        self.task = self._worlds.task
        self.render_mode = check_render_mode(render_mode)
        self.observation_space = spaces.observation_space(self.task)
        self.action_space = spaces.action_space(self.task)
        self._started = False
        self._ended = False

    @property
    def simulator(self):
        """The simulator, for search and planning."""
        return self._worlds.simulator

    @property
    def state(self):
        """The world as a batch of one; copy it before you change it."""
        return self._worlds.state

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Draw a fresh problem; ``seed`` restarts the random numbers. There are no options."""
        super().reset(seed=seed)
        self._worlds.reset(0, self.np_random)
        self._started, self._ended = True, False
        return self._observation(), self._info()

    def step(
        self, action: np.int64 | int
    ) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Place one block.

        Raises:
            InputError: for an action outside the action space.
            ResetNeeded: before the first reset and after the end of an episode.
        """
        self._require_reset()
        if self._ended:
            raise ResetNeeded("the episode has ended: call reset() before step()")
        transition, clipped = self._worlds.place(np.asarray(action)[None])
        self._ended = bool(transition.terminated[0])
        info = self._info() | self._worlds.step_info(transition, clipped, 0)
        return self._observation(), float(transition.reward[0]), self._ended, False, info

    def action_masks(self) -> np.ndarray:
        """bool[N * N * Na]: the legal actions, as maskable algorithms ask for them."""
        self._require_reset()
        return self._worlds.action_masks()[0]

    def render(self) -> Any:
        """The elevations in the render mode of the constructor; None without one.

        Raises:
            ResetNeeded: before the first reset.
        """
        self._require_reset()
        return self._worlds.render(self.render_mode, 0)

    def _observation(self) -> dict[str, Any]:
        return {key: value[0] for key, value in self._worlds.observation().items()}

    def _info(self) -> dict[str, Any]:
        info: dict[str, Any] = {key: value[0] for key, value in self._worlds.info().items()}
        for key in ("coverage", "plane_coverage"):
            info[key] = float(info[key])
        return info

    def _require_reset(self) -> None:
        if not self._started:
            raise ResetNeeded("call reset() first")
