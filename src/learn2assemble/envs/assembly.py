"""The environments of the tasks: one world, and many worlds stepped as one batch.

Both are Gymnasium's words over :class:`Worlds`. Elevations are drawn without any GL, as text and as
a small raster.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
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


class AssemblyVectorEnv(VectorEnv[dict[str, np.ndarray], np.ndarray, np.ndarray]):
    """``num_envs`` worlds; world k seeded with s behaves like a single one seeded with s + k.

    Observations, rewards and infos equal those of Gymnasium's ``SyncVectorEnv`` over
    :class:`~learn2assemble.envs.assembly.AssemblyEnv`, at the cost of one batched step.

    Args:
        task: the task, or the name of a preset.
        num_envs: B, number of worlds.
        physics: ``static``, ``rigid`` or a physics.
        physics_mask: whether infos carry ``physics_mask``.
        render_mode: None, ``ansi`` or ``rgb_array``.
        autoreset_mode: ``NextStep`` (the call after an end resets that world and ignores its
            action), ``SameStep`` (the last observation and info are ``final_obs`` and
            ``final_info``) or ``Disabled`` (reset with ``options={"reset_mask": bool[B]}``).

    Raises:
        UnknownNameError: for a preset, physics, render mode or autoreset mode that does not exist.
        InputError: for less than one world.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - declared so by the base class
        "render_modes": list(RENDER_MODES),
        "render_fps": 2,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    _STEP_KEYS: ClassVar[dict[str, Any]] = {"verdict": object, "success": bool, "clipped": bool}

    def __init__(
        self,
        task: Task | str,
        num_envs: int = 1,
        physics: str | Physics = "static",
        physics_mask: bool = True,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        if num_envs < 1:
            raise InputError("num_envs", num_envs, "1 or more")
        self._worlds = Worlds(task, physics, num_envs, physics_mask)
        self.task = self._worlds.task
        self.num_envs = num_envs
        self.render_mode = check_render_mode(render_mode)
        self.autoreset_mode = _autoreset_mode(autoreset_mode)
        self.metadata = {**type(self).metadata, "autoreset_mode": self.autoreset_mode}
        self.single_observation_space = spaces.observation_space(self.task)
        self.single_action_space = spaces.action_space(self.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        pairs = [seeding.np_random() for _ in range(num_envs)]
        self._generators, self._seeds = [g for g, _ in pairs], [s for _, s in pairs]
        self._started = False
        self._ended = np.zeros(num_envs, np.bool_)

    @property
    def simulator(self):
        """The simulator, for search and planning."""
        return self._worlds.simulator

    @property
    def state(self):
        """All worlds; copy it before you change it."""
        return self._worlds.state

    # Gymnasium declares these two for one generator; every world here has its own.
    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The random number generator of every world."""
        return tuple(self._generators)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """The seed of every world."""
        return tuple(self._seeds)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Draw fresh problems.

        Args:
            seed: s seeds world k with s + k; a list seeds each world; None goes on drawing.
            options: ``{"reset_mask": bool[B]}`` resets (and seeds) only some worlds.

        Raises:
            InputError: for a list of seeds or a mask of the wrong length.
        """
        seeds = _seeds(seed, self.num_envs)
        rows = self._reset_rows(options)
        for row in rows:
            if seeds[row] is not None:
                self._generators[row], self._seeds[row] = seeding.np_random(seeds[row])
        self._restart(rows)
        self._started = True
        mask = np.zeros(self.num_envs, np.bool_)
        mask[rows] = True
        return self._worlds.observation(), self._infos(mask)

    def step(
        self, actions: ArrayLike
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Place one block in every world.

        Args:
            actions: integers[B], flat actions.

        Raises:
            InputError: for actions outside the action space.
            ResetNeeded: before the first reset; for an ended world where autoreset is disabled.
        """
        self._require_reset()
        restarted = self._ended
        if self.autoreset_mode is AutoresetMode.DISABLED and restarted.any():
            raise ResetNeeded("some worlds have ended: reset them with options['reset_mask']")
        transition, clipped = self._worlds.place(actions)
        ended, final = transition.terminated, {}
        self._ended = ended.copy()
        stepped = ~restarted
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            final = self._final(transition, clipped)
            restarted, stepped = ended, ~ended
        self._restart(np.flatnonzero(restarted))
        infos = final | self._infos(np.ones(self.num_envs, np.bool_))
        self._add_step(infos, transition, clipped, stepped)
        truncated = np.zeros(self.num_envs, np.bool_)
        return self._worlds.observation(), transition.reward, ended, truncated, infos

    def action_masks(self) -> np.ndarray:
        """bool[B, N * N * Na]: the legal actions; none for a world that has ended."""
        self._require_reset()
        return self._worlds.action_masks()

    def render(self) -> tuple[Any, ...]:
        """The drawing of every world; see :class:`~learn2assemble.envs.assembly.AssemblyEnv`."""
        self._require_reset()
        return tuple(self._worlds.render(self.render_mode, row) for row in range(self.num_envs))

    def _restart(self, rows: np.ndarray) -> None:
        for row in rows:
            self._worlds.reset(int(row), self._generators[row])
            self._ended[row] = False

    def _reset_rows(self, options: dict[str, Any] | None) -> np.ndarray:
        mask = (options or {}).get("reset_mask")
        if mask is None:
            return np.arange(self.num_envs)
        mask = np.asarray(mask)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            expected = f"bool[{self.num_envs}] with at least one True"
            raise InputError("options['reset_mask']", mask.tolist(), expected)
        if not self._started:
            raise ResetNeeded("the first reset must reset every world")
        return np.flatnonzero(mask)

    def _infos(self, present: np.ndarray) -> dict[str, Any]:
        """Infos of the state; ``_key`` says which worlds have the key, as Gymnasium does."""
        infos: dict[str, Any] = {}
        for key, value in self._worlds.info().items():
            infos[key], infos[f"_{key}"] = value, present.copy()
        return infos

    def _add_step(
        self,
        infos: dict[str, Any],
        transition: Transition,
        clipped: np.ndarray,
        stepped: np.ndarray,
    ) -> None:
        if not stepped.any():
            return
        for key, kind in self._STEP_KEYS.items():
            infos[key] = np.full(self.num_envs, None if kind is object else False, kind)
            infos[f"_{key}"] = stepped.copy()
        for row in np.flatnonzero(stepped):
            for key, value in self._worlds.step_info(transition, clipped, int(row)).items():
                infos[key][row] = value

    def _final(self, transition: Transition, clipped: np.ndarray) -> dict[str, Any]:
        """``final_obs`` and ``final_info`` of the worlds that end with this step."""
        infos: dict[str, Any] = {}
        rows = np.flatnonzero(transition.terminated)
        if len(rows) == 0:
            return infos
        observations, info = self._worlds.observation(), self._worlds.info()
        for row in rows:
            last = {key: value[row] for key, value in info.items()}
            last |= self._worlds.step_info(transition, clipped, int(row))
            final = {key: value[row] for key, value in observations.items()}
            self._add_info(infos, {"final_obs": final, "final_info": last}, int(row))
        return infos

    def _require_reset(self) -> None:
        if not self._started:
            raise ResetNeeded("call reset() first")


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    names = [m.value for m in AutoresetMode]
    if not isinstance(mode, AutoresetMode) and mode not in names:
        raise UnknownNameError("autoreset_mode", mode, names)
    return AutoresetMode(mode)


def _seeds(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    if seed is None:
        return [None] * count
    if isinstance(seed, (int, np.integer)):
        return [int(seed) + k for k in range(count)]
    if len(seed) != count:
        raise InputError("seed", seed, f"one integer or {count} of them")
    return list(seed)
