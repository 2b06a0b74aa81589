"""Building on a lattice as environments: put down one block after another, until a random design
is filled or fixed goals are met."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from learn2assemble.errors import InputError, is_whole
from learn2assemble.planning.goals.loads import bears
from learn2assemble.planning.goals.search import Search
from learn2assemble.planning.goals.world import (
    GoalProblem,
    Relaxed,
    legal,
    make_problem,
    put,
    relax,
)
from learn2assemble.planning.tiling.world import LatticeWorld
from learn2assemble.tasks import design_features, goal_features
from learn2assemble.tasks.designs import Solved, make_design
from learn2assemble.tasks.goals import fixed_goals
from learn2assemble.tasks.task import (
    DESIGN_TASKS,
    GOAL_TASKS,
    DesignTask,
    GoalTask,
)

_MOST, BLOCK_COST = 100.0, 0.05
"""No feature is larger; what every block of a structure for goals costs."""


class _CandidateEnv(gymnasium.Env[dict[str, Any], np.int64]):
    """Actions are numbers of the candidates offered.

    Observations are ``candidates`` (features, one row each, zeros after the last), ``summary`` and
    ``mask``. A block that would not stand is not put down, and not offered again until another has
    been.
    """

    metadata: dict[str, Any] = {"render_modes": [], "render_fps": 2}  # noqa: RUF012 - as its base

    def __init__(self, most: int, features: Any, render_mode: str | None) -> None:
        if render_mode is not None:
            raise InputError("render_mode", render_mode, "none")
        self.render_mode: str | None = None
        # Narrower than the base class says; nobody sets them.
        self.observation_space: spaces.Dict[NDArray[np.float32] | NDArray[np.int8]] = spaces.Dict(  # pyright: ignore[reportIncompatibleVariableOverride]
            {
                "candidates": spaces.Box(-_MOST, _MOST, (most, features.NUM_FEATURES), np.float32),
                "summary": spaces.Box(-_MOST, _MOST, (features.NUM_SUMMARY,), np.float32),
                "mask": spaces.MultiBinary(most),
            }
        )
        self.action_space: spaces.Discrete[np.int64] = spaces.Discrete(most)  # pyright: ignore[reportIncompatibleVariableOverride]
        self.world: LatticeWorld | None = None
        """What has been built; copy it before you change it."""
        self._most = most
        self._offered = np.empty(0, np.int64)
        self._fallen: set[int] = set()
        self._ended = False

    def action_masks(self) -> np.ndarray:
        """bool[max_candidates]: the actions that are offered."""
        return np.arange(self._most) < len(self._offered)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin anew; ``seed`` restarts the random numbers. There are no options."""
        super().reset(seed=seed)
        self._fallen, self._ended = set(), False
        self.world = self._draw()
        return self._observe(self.world), self._info(self.world, True)

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
            raise InputError("action", action, f"0 to {self._most - 1}")
        stood, reward = False, 0.0
        if action < len(self._offered):
            candidate = int(self._offered[action])
            stood, reward = self._put(self.world, candidate)
            self._fallen = set() if stood else self._fallen | {candidate}
        observation = self._observe(self.world)
        self._ended = self._over(self.world)
        return observation, float(reward), self._ended, False, self._info(self.world, stood)

    @property
    def offered(self) -> np.ndarray:
        """int64[k]: the candidate of the site that each action puts down."""
        return self._offered

    def _observe(self, world: LatticeWorld) -> dict[str, Any]:
        """Offer the cheapest candidates, and describe them."""
        candidates, cost = self._candidates(world)
        if self._fallen:
            new = ~np.isin(candidates, list(self._fallen))
            candidates, cost = candidates[new], cost[new]
        self._offered = candidates[np.argsort(cost, kind="stable")[: self._most]]
        rows, summary = self._describe(world)
        padded = np.zeros((self._most, rows.shape[1]), np.float32)
        padded[: len(rows)] = np.clip(rows, -_MOST, _MOST)
        mask = self.action_masks().astype(np.int8)
        return {"candidates": padded, "summary": summary, "mask": mask}

    def _over(self, world: LatticeWorld) -> bool:
        return not len(self._offered)

    @abstractmethod
    def _draw(self) -> LatticeWorld:
        """The world of a new episode."""

    @abstractmethod
    def _put(self, world: LatticeWorld, candidate: int) -> tuple[bool, float]:
        """Put down a block in ``self.world``; whether it stood, and the reward."""

    @abstractmethod
    def _candidates(self, world: LatticeWorld) -> tuple[np.ndarray, np.ndarray]:
        """Numbers and costs of what may be put down."""

    @abstractmethod
    def _describe(self, world: LatticeWorld) -> tuple[np.ndarray, np.ndarray]:
        """Features of what is offered, a row each, and the summary."""

    @abstractmethod
    def _info(self, world: LatticeWorld, stood: bool) -> dict[str, Any]: ...


class DesignEnv(_CandidateEnv):
    """Build random designs with a known solution.

    An action is the number of a candidate among those offered; legal ones come from below.

    The reward is the share of wanted cells newly filled, and 1 more for the finished design: the
    share is a potential, so it pays the same by whatever way, and half of every return is for the
    end. An episode ends with the finished design, or when nothing that is offered can stand.

    ``info``: ``family``, ``blocks`` of the known solution, ``coverage``, ``open`` and ``stranded``
    cells (of which no candidate is left), ``success``, ``stood`` (of the last action).

    Args:
        task: of :data:`learn2assemble.tasks.task.DESIGN_TASKS`, by name or as such.
        pool: problems that episodes are drawn from, each made when it first comes; None makes a new
            one for every episode. Finding a known solution takes as long as hundreds of steps, so
            training is many times faster with a pool, and sees no more than these problems. A seed
            of ``reset`` begins a new pool.

    Raises:
        InputError: for a pool of none.
    """

    def __init__(
        self, task: DesignTask | str, render_mode: str | None = None, pool: int | None = None
    ) -> None:
        if pool is not None and not is_whole(pool, 1):
            raise InputError("pool", pool, "a whole number of at least 1")
        self.task: DesignTask = DESIGN_TASKS[task] if isinstance(task, str) else task
        super().__init__(self.task.max_candidates, design_features, render_mode)
        self.solved: Solved | None = None
        """The design with the solution that was found for it."""
        self._size, self._pool = pool, dict[int, Solved]()
        self._first: int | None = None
        """Seed of the pool."""
        self._last: tuple[Any, Solved, Any] | None = None
        """The last problem beside a pool, and the state of the random numbers before and after it:
        several policies play the same one after another."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin anew; ``seed`` restarts the random numbers. There are no options."""
        if seed is not None:
            self._first = None
        return super().reset(seed=seed, options=options)

    def _draw(self) -> LatticeWorld:
        if self._size is None:
            numbers = self.np_random.bit_generator
            if self._last is None or self._last[0] != numbers.state:
                before = numbers.state
                self._last = before, make_design(self.task, self.np_random), numbers.state
            _, self.solved, numbers.state = self._last
            return LatticeWorld(self.solved.site)
        if self._first is None:
            self._first, self._pool = int(self.np_random.integers(2**62)), {}
        number = int(self.np_random.integers(self._size))
        if number not in self._pool:
            own = np.random.default_rng([self._first, number])
            self._pool[number] = make_design(self.task, own)
        self.solved = self._pool[number]
        return LatticeWorld(self.solved.site)

    def _put(self, world: LatticeWorld, candidate: int) -> tuple[bool, float]:
        before = world.open
        stood = world.place(candidate, program=True)
        reward = (before - world.open) / int(world.site.wanted.sum())
        return stood, reward + world.complete

    def _candidates(self, world: LatticeWorld) -> tuple[np.ndarray, np.ndarray]:
        candidates = world.legal()
        return candidates, world.site.found.origin[candidates, 2]

    def _describe(self, world: LatticeWorld) -> tuple[np.ndarray, np.ndarray]:
        return design_features.describe(world, self._offered)

    def _info(self, world: LatticeWorld, stood: bool) -> dict[str, Any]:
        assert self.solved is not None
        return {
            "action_masks": self.action_masks().astype(np.int8),
            "family": self.solved.family,
            "blocks": len(self.solved.order),
            "coverage": 1 - world.open / int(world.site.wanted.sum()),
            "open": world.open,
            "stranded": len(world.stranded()),
            "success": world.complete,
            "stood": stood,
        }


class GoalsEnv(_CandidateEnv):
    """Invent a structure that meets fixed goals.

    An action is the number of a candidate among those offered, the cheapest ways to a goal first.

    The reward is the share of the relaxed plan that a block saves (a potential), less 0.05 for
    every block, and 1 where all goals are met and all loads are borne, which ends the episode. It
    also ends where a goal is out of reach or nothing that is offered can stand.

    ``info``: ``blocks``, ``missing`` (of the relaxed plan), ``success``, ``stood``.

    Args:
        task: of :data:`learn2assemble.tasks.task.GOAL_TASKS`, by name or as such.
    """

    def __init__(self, task: GoalTask | str, render_mode: str | None = None) -> None:
        self.task: GoalTask = GOAL_TASKS[task] if isinstance(task, str) else task
        self.problem: GoalProblem = make_problem(fixed_goals(self.task.goals))
        self._look = Search(self.problem)
        super().__init__(self.task.max_candidates, goal_features, render_mode)
        # Every episode begins with the same world: what it takes is found once.
        self._begun: Relaxed = relax(self.problem, LatticeWorld(self.problem.site))
        self._relaxed = self._begun
        self._start = self._begun.blocks
        self._first: tuple[dict[str, Any], np.ndarray] | None = None
        """Its observation, and what it offers."""
        self._met: bool | None = None
        """Whether ``self.world`` is a success; None where nobody has asked yet."""

    def _draw(self) -> LatticeWorld:
        self._relaxed, self._met = self._begun, None
        return LatticeWorld(self.problem.site)

    def _observe(self, world: LatticeWorld) -> dict[str, Any]:
        if world.placed or self._fallen:
            return super()._observe(world)
        if self._first is None:
            self._first = super()._observe(world), self._offered
        seen, offered = self._first
        self._offered = offered.copy()
        return {name: part.copy() for name, part in seen.items()}

    def _put(self, world: LatticeWorld, candidate: int) -> tuple[bool, float]:
        grown, reward = put(world, candidate), 0.0
        if grown is None:
            return False, reward
        before = self._relaxed.blocks
        self.world: LatticeWorld | None = grown
        self._met = None
        self._relaxed = relax(self.problem, grown, self._relaxed.price)
        if np.isfinite(self._relaxed.blocks):
            reward = (before - self._relaxed.blocks) / self._start
        return True, reward + (self._success(grown) - BLOCK_COST)

    def _success(self, world: LatticeWorld) -> bool:
        if self._met is None:
            self._met = self._relaxed.blocks == 0 and bears(self.problem, world)
        return self._met

    def _over(self, world: LatticeWorld) -> bool:
        lost = not np.isfinite(self._relaxed.blocks) or not len(self._offered)
        return bool(lost or self._success(world))

    def _candidates(self, world: LatticeWorld) -> tuple[np.ndarray, np.ndarray]:
        children = legal(self.problem, world)
        return children, self._relaxed.detour[children] - self._relaxed.used[children]

    def _describe(self, world: LatticeWorld) -> tuple[np.ndarray, np.ndarray]:
        helps, _ = self._look.advice(world, self._relaxed, self._offered)
        return goal_features.describe(self.problem, world, self._relaxed, self._offered, helps)

    def _info(self, world: LatticeWorld, stood: bool) -> dict[str, Any]:
        return {
            "action_masks": self.action_masks().astype(np.int8),
            "blocks": len(world.placed),
            "missing": self._relaxed.blocks,
            "success": self._success(world),
            "stood": stood,
        }
