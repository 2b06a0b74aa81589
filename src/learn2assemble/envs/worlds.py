"""Drawings of a world's elevations without any GL: text and a small raster.

What the single and the vectorised environment share: worlds in Gymnasium's words.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from learn2assemble.envs import spaces
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.geometry.coverage import NARROW, DepthFilter, clear_to_ground
from learn2assemble.geometry.images import HALF_EXTENT, IMAGE_SIZE, ROWS, WORDS, project, to_pixels
from learn2assemble.physics.protocol import Physics, Verdict
from learn2assemble.simulator import Simulator, Transition
from learn2assemble.tasks import Task, get_task
from learn2assemble.world.blocks import EDGE, HALF
from learn2assemble.world.state import State

COLOURS = {
    "background": (255, 255, 255),
    "ground": (160, 140, 120),
    "outside": (130, 150, 185),
    "target": (205, 205, 205),
    "hidden": (235, 155, 60),
    "filled": (60, 145, 75),
}
"""RGB: nothing, ground, block off the target, target still open, target covered by a block that
does not stand in its plane, target filled."""
SCALE = 3
"""Side of a rendered pixel in screen pixels."""
_REACH = int(HALF_EXTENT / EDGE)
"""Cells between the middle of an elevation and the edge of its image."""


def draw_text(state: State, frames: np.ndarray, row: int, pitch: float = EDGE) -> str:
    """The elevations of one world side by side, one character per block cell, ground below.

    ``#`` block on the target, ``x`` block in the plane but off the target, ``o`` block in front
    of the plane, ``.`` target still open.

    Args:
        pitch: horizontal distance of the centres of neighbouring cells [m].
    """
    mask, covered = to_pixels(state.mask[row]), to_pixels(state.covered[row])
    placed = state.position[row, : state.num_placed[row]]
    sides = zip(frames, mask, mask & ~covered, strict=True)
    cells = [_cells(frame, placed, target, still, pitch) for frame, target, still in sides]
    reach = max((abs(c) for side in cells for c, _ in side), default=0)
    height = max((r for side in cells for _, r in side), default=0) + 1
    columns = range(-reach, reach + 1)
    lines = [
        "   ".join("".join(side.get((c, r), " ") for c in columns) for side in cells)
        for r in reversed(range(height))
    ]
    ground = "   ".join("=" * len(columns) for _ in cells)
    head = (
        f"placed {state.num_placed[row]}/{state.num_blocks[row]}  "
        f"F_co {state.complete_coverage[row]:.4f}  F_pl {state.plane_coverage[row]:.4f}"
    )
    return "\n".join(line.rstrip() for line in [head, *lines, ground])


def draw_image(state: State, row: int, depths: DepthFilter = NARROW) -> np.ndarray:
    """The elevations of one world side by side as uint8[300, 300 S, 3]; see :data:`COLOURS`."""
    mask, covered = to_pixels(state.mask[row]), to_pixels(state.covered[row])
    occluded = to_pixels(state.occluded[row])
    image = np.empty((*mask.shape, 3), np.uint8)
    image[:] = COLOURS["background"]
    image[covered] = COLOURS["outside"]
    image[:, _ground(depths)] = COLOURS["ground"]
    image[mask] = COLOURS["target"]
    image[mask & occluded] = COLOURS["hidden"]
    image[mask & covered & ~occluded] = COLOURS["filled"]
    return np.concatenate(image, 1).repeat(SCALE, 0).repeat(SCALE, 1)


def _ground(depths: DepthFilter) -> np.ndarray:
    covered = np.zeros((ROWS, WORDS), np.uint64)
    clear_to_ground(covered, np.zeros_like(covered), depths)
    return to_pixels(covered)


def _cells(
    frame: np.ndarray, placed: np.ndarray, mask: np.ndarray, open_pixels: np.ndarray, pitch: float
) -> dict[tuple[int, int], str]:
    """Characters of one elevation by (column from the middle, row from the ground)."""
    cells: dict[tuple[int, int], str] = {}
    for c in range(-_REACH, _REACH + 1):
        for r in range(2 * _REACH):
            if _pixels(open_pixels, c, r, pitch).any():
                cells[c, r] = "."
    cos, sin, tx, ty = frame
    local = placed - (tx, ty, HALF)
    x, y = cos * local[:, 0] + sin * local[:, 1], cos * local[:, 1] - sin * local[:, 0]
    order = np.argsort(-y, kind="stable")  # a block in front is drawn over one behind it
    for n in order:
        if y[n] >= HALF:
            continue
        cell = round(x[n] / pitch), max(round(local[n, 2] / EDGE), 0)
        on_target = "#" if _pixels(mask, *cell, pitch).any() else "x"
        cells[cell] = on_target if y[n] > -HALF else "o"
    return cells


def _pixels(image: np.ndarray, column: int, row: int, pitch: float) -> np.ndarray:
    """The part of an image that shows the face of one cell."""
    u0, v0 = project(pitch * column - HALF, EDGE * (row + 1))
    u1, v1 = project(pitch * column + HALF, EDGE * row)
    u0, u1, v0, v1 = (min(max(round(e), 0), IMAGE_SIZE) for e in (u0, u1, v0, v1))
    return image[v0:v1, u0:u1]


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

        ``action_masks`` int8[B, N*N*Na]: legal, as ``action_space.sample`` wants it.
        ``physics_mask`` int8[B, N*N*Na]: legal, free and stable by static physics; a help the
        paper's agent does not have, never applied.
        ``coverage`` and ``plane_coverage`` float64[B]: F_co and F_pl.
        """
        state = self.state
        info = {"action_masks": self.action_masks().view(np.int8)}
        if self._physics_mask:
            stable = self.simulator.physics_mask(state)
            info["physics_mask"] = spaces.expand_mask(self.task, state, stable).view(np.int8)
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
            return draw_text(self.state, self.simulator.frames, row, self.task.pitch)
        if mode == "rgb_array":
            return draw_image(self.state, row, self.simulator.depths)
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
