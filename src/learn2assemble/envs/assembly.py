"""The environments of the tasks: one world, and many worlds stepped as one batch.

Both are :class:`_Worlds` in Gymnasium's words. An action is the published triple (i, j, k): node
index of the unplaced block to place, node index of the placed reference block, action. Spaces use
its flat index ``a = (i * N + j) * Na + k``, or the number of a distinct placement. Elevations are
drawn without any GL, as text and as a small raster.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from learn2assemble.envs.actions import (
    ACTION_SPACES,
    FlatActions,
    PlacementActions,
    Seen,
    num_placement_actions,
    outside,
)
from learn2assemble.envs.drawing import draw_image, draw_text
from learn2assemble.errors import InputError, UnknownNameError, is_whole
from learn2assemble.tasks.graph.features import NUM_FEATURES, POSITION
from learn2assemble.tasks.physics.protocol import Physics, PlacementVerdict
from learn2assemble.tasks.simulator import Simulator, WorldTransition
from learn2assemble.tasks.task import Task, get_task
from learn2assemble.tasks.world.state import State

WAITING_REACH = 1.25
"""No waiting block and no target is farther from the origin than this along an axis [m]."""
MOST_ENVS = 100_000
"""Worlds stepped at once."""
RENDER_MODES = ("ansi", "rgb_array")
REFUSED = "REFUSED"
"""Verdict on an action that is refused."""
_VERDICTS = {verdict.value: verdict.name for verdict in PlacementVerdict}


# ---------------------------------------------------------------- spaces and actions


def observation_space(task: Task, actions: str = "flat") -> spaces.Dict:
    """The graph of one world; :func:`learn2assemble.tasks.graph.features.connectivity` needs no
    more.

    ``nodes`` float32[N, 5]: x, y, z [m, world], placed and target flag (+-1). ``object_id``
    int32[N]: object number; -1 - s for vertices of side s. ``num_targets``, ``num_placed``,
    ``num_nodes``. Where actions are placements also ``placements`` float32[A, 3]: middle of the
    cells each would fill [m, world], zeros in the padding.
    """
    high = np.ones((task.num_nodes, NUM_FEATURES), np.float32)
    # Every placement reaches at most one cell farther than the structure already did.
    reach = WAITING_REACH + task.pitch * task.max_blocks
    high[:, POSITION] = reach
    count = task.num_nodes + 1
    parts: dict[str, spaces.Space[Any]] = {
        "nodes": spaces.Box(-high, high, dtype=np.float32),
        "object_id": spaces.Box(-task.num_sides, task.max_blocks - 1, (task.num_nodes,), np.int32),
        "num_targets": spaces.Discrete(count),
        "num_placed": spaces.Discrete(count),
        "num_nodes": spaces.Discrete(count),
    }
    if actions == "placements":
        parts["placements"] = spaces.Box(
            -reach, reach, (num_placement_actions(task), 3), np.float32
        )
    return spaces.Dict(parts)


# ---------------------------------------------------------------- environments


class _Worlds:
    """A batch of worlds of one task that takes flat actions and gives observations and infos."""

    def __init__(
        self,
        task: Task | str,
        physics: str | Physics,
        count: int,
        physics_mask: bool,
        render_mode: str | None,
        actions: str,
    ) -> None:
        if actions not in ACTION_SPACES:
            raise UnknownNameError("actions", actions, ACTION_SPACES)
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise UnknownNameError("render_mode", render_mode, RENDER_MODES)
        self.render_mode = render_mode
        self.task: Task = get_task(task) if isinstance(task, str) else task
        self.simulator: Simulator = Simulator(self.task, physics)
        """For search and planning."""
        self.state: State = self.simulator.empty(count)
        """All worlds; copy it before you change it."""
        self.numbering: FlatActions | PlacementActions = ACTION_SPACES[actions](self.simulator)
        """What numbers of actions mean."""
        self._physics_mask = physics_mask
        self._started = False
        self._seen: Seen | None = None
        """Of the state; None where that has changed since."""
        self._ended = np.zeros(count, np.bool_)

    def _begin(self, row: int, rng: np.random.Generator) -> None:
        """Draw a fresh problem into one world."""
        self.simulator.reset(self.state, np.array([row]), rng)
        self._seen = None
        self._started, self._ended[row] = True, False

    def _require_reset(self) -> None:
        if not self._started:
            raise ResetNeeded("call reset() first")

    def _place(self, flat: ArrayLike) -> tuple[WorldTransition, list[dict[str, Any]]]:
        """Step every world that has not ended; what happened, and what infos say of it."""
        numbers, mask = self._checked(flat), self._physics_mask
        if self._seen is None:
            self.look()
        done, clipped, refused, self._seen = self.numbering.step(self.state, numbers, mask)
        self._ended = done.terminated
        columns = done.verdict, done.success, clipped, refused
        return done, [
            {
                "verdict": REFUSED if padding else _VERDICTS[verdict],
                "success": success,
                "clipped": changed,
            }
            for verdict, success, changed, padding in zip(
                *map(np.ndarray.tolist, columns), strict=True
            )
        ]

    def _checked(self, flat: ArrayLike) -> np.ndarray:
        count, size = self.state.batch_size, self.numbering.size

        def expected() -> str:
            return f"{count} integer{'s' if count > 1 else ''} in 0..{size - 1}"

        try:
            array = np.asarray(flat)
        except ValueError as error:  # ragged
            raise InputError("action", flat, expected()) from error
        good = array.shape == (count,) and array.dtype.kind in "iu"
        if not good or outside(array := array.astype(np.int64), size):
            raise InputError("action", array.tolist(), expected())
        return array

    def look(self) -> Seen:
        """What there is to say of the state; what actions mean goes with it."""
        if self._seen is None:
            self._seen = self.numbering.see(self.state, self._physics_mask)
        return self._seen

    def _observe(self) -> dict[str, np.ndarray]:
        seen = self.look().graph._asdict()
        if isinstance(self.numbering, PlacementActions):
            seen["placements"] = self.numbering.describe()
        return seen

    def _legal(self) -> np.ndarray:
        """bool[B, A]: see :class:`Seen`."""
        self._require_reset()
        return self.look().legal.copy()

    def _known(self) -> dict[str, np.ndarray]:
        """What infos say of the state, see :class:`AssemblyEnv`; arrays over the worlds."""
        self._require_reset()
        seen = self.look()
        info = {"action_masks": seen.legal.view(np.int8)}
        if self._physics_mask:
            info["physics_mask"] = seen.stable.view(np.int8)
        info["coverage"] = seen.coverage
        info["plane_coverage"] = seen.plane_coverage
        return info

    def _draw(self, row: int) -> Any:
        """A drawing of one world in the render mode; None without one."""
        self._require_reset()
        if self.render_mode == "ansi":
            return draw_text(self.state, self.simulator.frames, row, self.task.pitch)
        if self.render_mode == "rgb_array":
            return draw_image(self.state, row, self.simulator.depths)
        return None


class AssemblyEnv(_Worlds, gymnasium.Env[dict[str, Any], np.int64]):
    """Place blocks until the target elevations are filled.

    Actions are flat indices of (i, j, k), observations graphs; see
    :func:`observation_space`. Illegal i and j are clipped like in the published code, and
    ``info["clipped"]`` says so. With ``actions="placements"`` an action is the number of a
    distinct placement instead, a few hundred in place of thousands; the padding is refused, which
    ends the episode with reward -1 and the verdict ``REFUSED``. An episode ends with an invalid
    placement, the filled target or the last block; it is never truncated.

    ``info``: ``action_masks`` int8[A]: legal, as ``action_space.sample`` wants it, over all ``A``
    actions; ``physics_mask`` int8[A]: legal, free and stable by static physics, a help the paper's
    agent does not have, never applied; ``coverage`` and ``plane_coverage``: F_co and F_pl; and
    after a step ``verdict`` (name of a
    :class:`~learn2assemble.tasks.physics.protocol.PlacementVerdict`), ``success`` and ``clipped``.

    Args:
        task: the task, or the name of a preset.
        physics: ``static``, ``rigid`` or a physics.
        physics_mask: whether infos carry ``physics_mask``.
        render_mode: None, ``ansi`` or ``rgb_array``.
        actions: ``flat`` (N * N * Na of them) or ``placements``.

    Raises:
        UnknownNameError: for a preset, physics, render mode or kind of actions that does not
            exist.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - declared so by the base class
        "render_modes": list(RENDER_MODES),
        "render_fps": 2,
    }

    def __init__(
        self,
        task: Task | str,
        physics: str | Physics = "static",
        physics_mask: bool = True,
        render_mode: str | None = None,
        actions: str = "flat",
    ) -> None:
        super().__init__(task, physics, 1, physics_mask, render_mode, actions)
        # Narrower than the base class says; nobody sets them.
        self.observation_space: spaces.Dict = observation_space(self.task, actions)  # pyright: ignore[reportIncompatibleVariableOverride]
        self.action_space: spaces.Discrete[np.int64] = spaces.Discrete(self.numbering.size)  # pyright: ignore[reportIncompatibleVariableOverride]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Draw a fresh problem; ``seed`` restarts the random numbers. There are no options."""
        super().reset(seed=seed)
        self._begin(0, self.np_random)
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
        if self._ended[0]:
            raise ResetNeeded("the episode has ended: call reset() before step()")
        done, (told,) = self._place(np.asarray(action)[None])
        info = self._info() | told
        return self._observation(), float(done.reward[0]), bool(done.terminated[0]), False, info

    def action_masks(self) -> np.ndarray:
        """bool[A]: the legal actions, as maskable algorithms ask for them."""
        return self._legal()[0]

    def render(self) -> Any:
        """The elevations in the render mode of the constructor; None without one.

        Raises:
            ResetNeeded: before the first reset.
        """
        return self._draw(0)

    def _observation(self) -> dict[str, Any]:
        return {key: value[0] for key, value in self._observe().items()}

    def _info(self) -> dict[str, Any]:
        info: dict[str, Any] = {key: value[0] for key, value in self._known().items()}
        for key in ("coverage", "plane_coverage"):
            info[key] = float(info[key])
        return info


class AssemblyVectorEnv(_Worlds, VectorEnv[dict[str, np.ndarray], np.ndarray, np.ndarray]):
    """``num_envs`` worlds; world k seeded with s behaves like a single one seeded with s + k.

    Observations, rewards and infos equal those of Gymnasium's ``SyncVectorEnv`` over
    :class:`~learn2assemble.envs.assembly.AssemblyEnv`, at the cost of one batched step.

    Args:
        task, physics, physics_mask, render_mode, actions: as of the single one.
        num_envs: B, number of worlds.
        autoreset_mode: ``NextStep`` (the call after an end resets that world and ignores its
            action), ``SameStep`` (the last observation and info are ``final_obs`` and
            ``final_info``) or ``Disabled`` (reset with ``options={"reset_mask": bool[B]}``).

    Raises:
        UnknownNameError: for a preset, physics, render mode or autoreset mode that does not exist.
        InputError: for less than one world.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - declared so by the base class
        **AssemblyEnv.metadata,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        task: Task | str,
        num_envs: int = 1,
        physics: str | Physics = "static",
        physics_mask: bool = True,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        actions: str = "flat",
    ) -> None:
        if not is_whole(num_envs, 1, MOST_ENVS):
            raise InputError("num_envs", num_envs, f"a whole number from 1 to {MOST_ENVS}")
        super().__init__(task, physics, num_envs, physics_mask, render_mode, actions)
        self.num_envs = num_envs
        names = [mode.value for mode in AutoresetMode]
        if not isinstance(autoreset_mode, AutoresetMode) and autoreset_mode not in names:
            raise UnknownNameError("autoreset_mode", autoreset_mode, names)
        self.autoreset_mode: AutoresetMode = AutoresetMode(autoreset_mode)
        self.metadata = {**type(self).metadata, "autoreset_mode": self.autoreset_mode}
        self.single_observation_space: spaces.Dict = observation_space(self.task, actions)  # pyright: ignore[reportIncompatibleVariableOverride]
        self.single_action_space: spaces.Discrete[np.int64] = spaces.Discrete(self.numbering.size)  # pyright: ignore[reportIncompatibleVariableOverride]
        self.observation_space: spaces.Space[Any] = batch_space(
            self.single_observation_space, num_envs
        )
        self.action_space: spaces.Space[Any] = batch_space(self.single_action_space, num_envs)
        self._seed([seeding.np_random() for _ in range(num_envs)])

    def _seed(self, pairs: list[tuple[np.random.Generator, int]]) -> None:
        """Generator and seed of every world, where Gymnasium has one of each for all."""
        self._pairs = pairs
        self._np_random, self._np_random_seed = cast("Any", tuple(zip(*pairs, strict=True)))

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
        mask = self._reset_mask(options)
        self._seed(
            [
                seeding.np_random(new) if chosen and new is not None else pair
                for pair, new, chosen in zip(self._pairs, seeds, mask, strict=True)
            ]
        )
        self._restart(mask)
        return self._observe(), self._infos(mask)

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
        done, told = self._place(actions)
        ended, final = done.terminated.copy(), {}
        stepped = ~restarted
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            final = self._final(ended, told)
            restarted, stepped = ended, ~ended
        self._restart(restarted)
        infos = final | self._infos(np.ones(self.num_envs, np.bool_))
        for key, kind in ("verdict", object), ("success", bool), ("clipped", bool):
            if stepped.any():
                values = [one[key] if s else None for one, s in zip(told, stepped, strict=True)]
                infos[key], infos[f"_{key}"] = np.array(values, kind), stepped.copy()
        truncated = np.zeros(self.num_envs, np.bool_)
        return self._observe(), done.reward, ended, truncated, infos

    def action_masks(self) -> np.ndarray:
        """bool[B, A]: the legal actions; none for a world that has ended."""
        return self._legal()

    def render(self) -> tuple[Any, ...]:
        """The drawing of every world; see :class:`~learn2assemble.envs.assembly.AssemblyEnv`."""
        return tuple(map(self._draw, range(self.num_envs)))

    def _restart(self, mask: np.ndarray) -> None:
        for row in np.flatnonzero(mask).tolist():
            self._begin(row, self._pairs[row][0])

    def _reset_mask(self, options: dict[str, Any] | None) -> np.ndarray:
        mask = (options or {}).get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        mask = np.array(mask)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            expected = f"bool[{self.num_envs}] with at least one True"
            raise InputError("options['reset_mask']", mask.tolist(), expected)
        if not self._started:
            raise ResetNeeded("the first reset must reset every world")
        return mask

    def _infos(self, present: np.ndarray) -> dict[str, Any]:
        """Infos of the state; ``_key`` says which worlds have the key, as Gymnasium does."""
        infos: dict[str, Any] = {}
        for key, value in self._known().items():
            infos[key], infos[f"_{key}"] = value, present.copy()
        return infos

    def _final(self, ended: np.ndarray, told: list[dict[str, Any]]) -> dict[str, Any]:
        """``final_obs`` and ``final_info`` of the worlds that end with this step."""
        infos: dict[str, Any] = {}
        if ended.any():
            observations, known = self._observe(), self._known()
            for row in np.flatnonzero(ended).tolist():
                final, last = (
                    {key: value[row] for key, value in found.items()}
                    for found in (observations, known)
                )
                self._add_info(infos, {"final_obs": final, "final_info": last | told[row]}, row)
        return infos


def _seeds(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    if seed is None:
        return [None] * count
    if isinstance(seed, (int, np.integer)):
        return [int(seed) + k for k in range(count)]
    if len(seed) != count:
        raise InputError("seed", seed, f"one integer or {count} of them")
    return list(seed)
