"""Building with hidden errors as an environment: put given blocks to their places with a hand that
is off, look where they are, and take up what is not where it should be."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded

from learn2assemble.errors import InputError, UnknownNameError, is_whole
from learn2assemble.tasks.hidden_errors import LOOK, draw_look, draw_numbers, draw_placing
from learn2assemble.tasks.hidden_world import (
    TOLERANCE,
    GivenBlocks,
    Happened,
    HiddenWorld,
    make_given_blocks,
)
from learn2assemble.tasks.task import HIDDEN_TASKS, HiddenTask

STEP = np.array([0.5, 0.5, 1.0])
"""By which the correction of the hand is changed: x, y [mm], yaw [mrad]."""
MOST = np.array([6.0, 6.0, 12.0])
"""Largest correction: x, y [mm], yaw [mrad]."""
MOVE, ADJUST = 10, 1
"""Time of a placement, of taking up, and of a look; of a change of the correction."""
(
    MIDDLE,
    SIZE,
    THERE,
    STANDS,
    COMMANDED,
    SEEN,
    MEASURED,
    EXTENT,
) = (slice(0, 3), slice(3, 6), 6, 7, slice(8, 11), 11, slice(12, 15), slice(15, 17))
COLUMNS = 17
"""Of the table of blocks, see :class:`HiddenEnv`."""
_REACH = 1000.0
"""No number of an observation is larger."""
_MILLI = 1e3


class HiddenActions:
    """Numbers of the actions of a task of at most ``most`` blocks.

    ``0 .. most - 1`` put that block down, ``done`` ends, ``look`` looks, ``adjust .. adjust + 5``
    change the correction of the hand (less and more x, y, yaw), and ``take + k`` takes block k up.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self.done: int = most
        self.look: int = most + 1
        self.adjust: int = most + 2
        self.take: int = most + 8
        self.count: int = 2 * most + 8


class HiddenEnv(gymnasium.Env[dict[str, Any], np.int64]):
    """Build a design of given blocks with a hand, blocks and a friction that are not as told.

    What is hidden in an episode: by how much the hand is off, in every placement alike; length and
    width of each block; the coefficient of friction; and in each placement how far the block slides
    and turns when it is let go, and how it jolts what stands. See
    :mod:`learn2assemble.tasks.hidden_errors` for the sizes and
    :mod:`learn2assemble.tasks.hidden_world` for what comes of it.

    Actions (:class:`HiddenActions`): put a block down at its place and the correction of the hand;
    take one up that nothing rests on; look; change the correction by a step; be done. Placements,
    takings and looks take a *move* of the time there is, a change of the correction a tenth. An
    action that the mask forbids takes as long and does nothing.

    Observations: ``blocks`` float32[most, 17], a row each, from below: middle (3) and nominal size
    (3) in its place [m]; whether there is such a block; whether it stands; the correction with
    which it was put down (x, y [mm], yaw [mrad]); whether a look has seen it since; where it was
    seen, less its place (the same three), and its length and width as seen, less the nominal ones
    [mm]. ``hand`` float32[3]: the correction (x, y [mm], yaw [mrad]). ``clock`` float32[5]: moves
    left; moves since the last look, or since the start; standard deviations of what a look says,
    of places [mm] and of yaws [mrad]; and the tolerance [mm].

    The reward is the share of all blocks that are in their place, each time less what it was
    before: the return is that share at the end, at most 1. A reward tells what is hidden: in the
    benchmark nobody is told.

    ``info``: ``action_masks``, ``family``, ``blocks``, ``standing``, ``verdict`` of the last action
    (``placed``, ``collides``, ``falls``, ``taken``, ``looked``, ``adjusted``, ``done``,
    ``refused``; "" at first), ``fallen`` (blocks that fell), ``success`` (at the end: whether all
    are in their place; False before).

    Args:
        task: of :data:`learn2assemble.tasks.task.HIDDEN_TASKS`, by name or as such.
    """

    metadata: dict[str, Any] = {"render_modes": [], "render_fps": 2}  # noqa: RUF012 - as its base

    def __init__(self, task: HiddenTask | str, render_mode: str | None = None) -> None:
        if render_mode is not None:
            raise InputError("render_mode", render_mode, "none")
        if isinstance(task, str) and task not in HIDDEN_TASKS:
            raise UnknownNameError("task", task, HIDDEN_TASKS)
        self.render_mode: str | None = None
        self.task: HiddenTask = HIDDEN_TASKS[task] if isinstance(task, str) else task
        most = self.task.blocks[1]
        self.actions: HiddenActions = HiddenActions(most)
        # Narrower than the base class says; nobody sets them.
        self.observation_space: spaces.Dict = spaces.Dict(  # pyright: ignore[reportIncompatibleVariableOverride]
            {
                "blocks": spaces.Box(-_REACH, _REACH, (most, COLUMNS), np.float32),
                "hand": spaces.Box(-_REACH, _REACH, (3,), np.float32),
                "clock": spaces.Box(0.0, _REACH, (5,), np.float32),
            }
        )
        self.action_space: spaces.Discrete[np.int64] = spaces.Discrete(self.actions.count)  # pyright: ignore[reportIncompatibleVariableOverride]
        self.design: GivenBlocks | None = None
        """The design of the episode."""
        self._world: HiddenWorld | None = None
        self._ended = False

    # ------------------------------------------------------------ episodes

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Draw a design and what is hidden; ``seed`` restarts the random numbers. There are no
        options."""
        super().reset(seed=seed)
        self.design = make_given_blocks(self.task, self.np_random)
        self._begin(self.design, np.random.default_rng(self.np_random.integers(2**63)))
        return self.observe(), self._info(Happened(""))

    def imagined(self, seed: int = 0) -> HiddenEnv:
        """The start of this episode with other hidden numbers: what one may know who knows the
        model. It is no use to who wants to know the true ones.

        Raises:
            ResetNeeded: before the first reset.
        """
        if self.design is None:
            raise ResetNeeded("call reset() first")
        other = copy.copy(self)
        # Neither generator nor seed: the true numbers follow from them.
        other._np_random, other._np_random_seed = np.random.default_rng(seed), -1
        other._begin(self.design, np.random.default_rng(seed))
        return other

    def _begin(self, design: GivenBlocks, hidden: np.random.Generator) -> None:
        count = len(design)
        numbers = draw_numbers(count, self.task.factor, hidden)
        self._hidden = hidden
        self._world = HiddenWorld(design, numbers)
        self._commanded = np.zeros((count, 3))
        self._seen = np.zeros(count, bool)
        self._measured = np.zeros((count, 5))
        self._hand = np.zeros(3)
        each, more = self.task.moves
        self._left = round(MOVE * (each * count + more))
        self._since = 0
        self._share, self._ended = 0.0, False

    def step(
        self, action: np.int64 | int
    ) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Do one thing.

        Raises:
            InputError: for an action outside the action space.
            ResetNeeded: before the first reset and after the end of an episode.
        """
        if self._world is None or self._ended:
            raise ResetNeeded("call reset() before step()")
        if not is_whole(action, 0, self.actions.count - 1):
            raise InputError("action", action, f"0 to {self.actions.count - 1}")
        number, names = int(action), self.actions
        adjusts = names.adjust <= number < names.take
        spent = ADJUST if adjusts else MOVE
        self._left, self._since = max(self._left - spent, 0), self._since + spent
        happened = Happened("refused")
        if self.action_masks()[number]:
            happened = self._do(self._world, number)
        self._ended = happened.verdict == "done" or self._left < MOVE
        before, self._share = self._share, float(self._world.in_place().mean())
        reward = self._share - before
        return self.observe(), reward, self._ended, False, self._info(happened)

    def _do(self, world: HiddenWorld, number: int) -> Happened:
        names, factor = self.actions, self.task.factor
        if number == names.done:
            return Happened("done")
        if number == names.look:
            return self._look(world)
        if names.adjust <= number < names.take:
            axis, more = divmod(number - names.adjust, 2)
            self._hand[axis] += STEP[axis] * (2 * more - 1)
            return Happened("adjusted")
        placing = draw_placing(world.numbers.friction, factor, self._hidden)
        if number >= names.take:
            happened = world.take(number - names.take, placing)
            self._forget(number - names.take)
        else:
            happened = world.place(number, self._hand / _MILLI, placing)
            if happened.verdict != "collides":
                self._commanded[number] = self._hand
        for block in happened.fallen:
            self._forget(block)
        return happened

    def _forget(self, block: int) -> None:
        self._seen[block] = False
        self._commanded[block] = self._measured[block] = 0.0

    def _look(self, world: HiddenWorld) -> Happened:
        noise = draw_look(len(world.design), self.task.factor, self._hidden)
        place = np.append(world.design.middle[:, :2], np.zeros((len(noise), 1)), 1)
        true = np.concatenate([world.pose - place, world.numbers.size], 1)
        self._measured = np.where(world.stands[:, None], _MILLI * (true + noise), 0.0)
        self._seen, self._since = world.stands.copy(), 0
        return Happened("looked")

    # ------------------------------------------------------------ what is told

    def action_masks(self) -> np.ndarray:
        """bool[A]: what may be done.

        Raises:
            ResetNeeded: before the first reset.
        """
        if self._world is None:
            raise ResetNeeded("call reset() first")
        names, mask = self.actions, np.zeros(self.actions.count, bool)
        place, take = self._world.may_place(), self._world.may_take()
        mask[: len(place)], mask[names.take : names.take + len(take)] = place, take
        mask[[names.done, names.look]] = True
        for axis, more in np.ndindex(3, 2):
            value = self._hand[axis] + STEP[axis] * (2 * more - 1)
            mask[names.adjust + 2 * axis + more] = abs(value) <= MOST[axis]
        return mask

    def observe(self) -> dict[str, Any]:
        """What is known of every block, of the hand and of what is left of the budget."""
        assert self._world is not None
        design, count = self._world.design, len(self._world.design)
        blocks = np.zeros((self.task.blocks[1], COLUMNS), np.float32)
        rows = blocks[:count]
        rows[:, MIDDLE], rows[:, SIZE], rows[:, THERE] = design.middle, design.size, 1.0
        rows[:, STANDS], rows[:, COMMANDED] = self._world.stands, self._commanded
        rows[:, SEEN] = self._seen
        rows[:, MEASURED] = self._measured[:, :3]
        rows[:, EXTENT] = self._measured[:, 3:]
        noise = self.task.factor * _MILLI * LOOK
        clock = [self._left / MOVE, self._since / MOVE, noise[0], noise[2], _MILLI * TOLERANCE]
        return {
            "blocks": blocks,
            "hand": self._hand.astype(np.float32),
            "clock": np.array(clock, np.float32),
        }

    def _info(self, happened: Happened) -> dict[str, Any]:
        assert self._world is not None
        return {
            "action_masks": self.action_masks().astype(np.int8),
            "family": self._world.design.family,
            "blocks": len(self._world.design),
            "standing": int(self._world.stands.sum()),
            "verdict": happened.verdict,
            "fallen": list(happened.fallen),
            "success": self._ended and bool(self._world.in_place().all()),
        }
