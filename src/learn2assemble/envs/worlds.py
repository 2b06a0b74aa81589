"""What the single and the vectorised environment share: worlds in Gymnasium's words."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from learn2assemble.envs import render, spaces
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.physics.protocol import Physics, Verdict
from learn2assemble.presets import get_task
from learn2assemble.simulator import Simulator, Transition
from learn2assemble.task import Task

RENDER_MODES = ("ansi", "rgb_array")


def check_render_mode(mode: str | None) -> str | None:
    """``mode``, where it is None or a mode that exists.

    Raises:
        UnknownNameError: naming the nearest mode.
    """
    if mode is not None and mode not in RENDER_MODES:
        raise UnknownNameError("render_mode", mode, RENDER_MODES)
    return mode


class Worlds:
    """A batch of worlds of one task that takes flat actions and gives observations and infos.

    Args:
        task: the task, or the name of a preset.
        physics: ``static``, ``rigid`` or a physics.
        count: B, number of worlds.
        physics_mask: whether infos carry ``physics_mask``.

    Raises:
        UnknownNameError: for a preset or physics that does not exist.
    """

    def __init__(
        self, task: Task | str, physics: str | Physics, count: int, physics_mask: bool
    ) -> None:
        self.task = get_task(task) if isinstance(task, str) else task
        self.simulator = Simulator(self.task, physics)
        self.state = self.simulator.empty(count)
        self._physics_mask = physics_mask

    def reset(self, row: int, rng: np.random.Generator) -> None:
        """Draw a fresh problem into one world."""
        self.simulator.reset(self.state, np.array([row]), rng)

    def place(self, flat: ArrayLike) -> tuple[Transition, np.ndarray]:
        """Step every world that has not ended.

        Args:
            flat: integers[B], flat actions.

        Returns:
            what happened, and bool[B], where the action had to be clipped.

        Raises:
            InputError: for an action that is no integer of the action space.
        """
        actions, clipped = spaces.resolve_actions(self.task, self.state, self._checked(flat))
        return self.simulator.step(self.state, actions), clipped

    def observation(self) -> dict[str, np.ndarray]:
        """Observations of all worlds."""
        return spaces.observation(self.simulator.observe(self.state))

    def action_masks(self) -> np.ndarray:
        """bool[B, N * N * Na]: the legal actions."""
        return spaces.legal_mask(self.task, self.state)

    def info(self) -> dict[str, np.ndarray]:
        """What is known of the state beside the observation; arrays over the worlds.

        ``action_masks`` bool[B, N*N*Na]: legal. ``physics_mask`` bool[B, N*N*Na]: legal, free and
        stable by static physics; a help the paper's agent does not have, never applied.
        ``coverage`` and ``plane_coverage`` float64[B]: F_co and F_pl (protocol 3.4).
        """
        state = self.state
        info = {"action_masks": self.action_masks()}
        if self._physics_mask:
            stable = self.simulator.physics_mask(state)
            info["physics_mask"] = spaces.expand_mask(self.task, state, stable)
        info["coverage"] = state.complete_coverage
        info["plane_coverage"] = state.plane_coverage
        return info

    def step_info(self, transition: Transition, clipped: np.ndarray, row: int) -> dict[str, Any]:
        """What is known of the step of one world: verdict name, success, clipped action."""
        return {
            "verdict": Verdict(transition.verdict[row]).name,
            "success": bool(transition.success[row]),
            "clipped": bool(clipped[row]),
        }

    def render(self, mode: str | None, row: int) -> Any:
        """A drawing of one world: text (``ansi``), uint8[H, W, 3] (``rgb_array``) or None."""
        if mode == "ansi":
            return render.draw_text(self.state, self.simulator.frames, row, self.task.pitch)
        if mode == "rgb_array":
            return render.draw_image(self.state, row, self.simulator.depths)
        return None

    def _checked(self, flat: ArrayLike) -> np.ndarray:
        count, size = self.state.batch_size, spaces.num_flat_actions(self.task)
        expected = f"{count} integer{'s' if count > 1 else ''} in 0..{size - 1}"
        try:
            array = np.asarray(flat)
        except ValueError as error:  # ragged
            raise InputError("action", flat, expected) from error
        good = array.shape == (count,) and array.dtype.kind in "iu"
        if not good or array.min() < 0 or array.max() >= size:
            raise InputError("action", array.tolist(), expected)
        return array.astype(np.int64)
