"""The restore faults of the published search as a model of the world (deviation D4).

Before every simulation the published search rebuilt the world from the observation, and two steps
of an ordinary reset ran along:

* (a) The initial cover c0 is taken from the restored state, so coverage and the success threshold
  refer to what is still open (where coverage is normalised: without a robot).
* (b) Where the structure already covers more than the share at which a reset redraws the problem,
  or the masks are too small, the simulation silently runs in a random new problem.
* (c) The cells of placed objects are not joined again, so an overhanging cell falls and every
  action looks invalid; waiting objects are put together from cells that follow each other in the
  list and touch, which splits those that are no chains (W, bars listed middle first).
* (d) Positions pass through the normalised observation in single precision.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.constants import EDGE, HALF
from learn2assemble.kernels import kernel
from learn2assemble.tasks.physics.support import reaches_ground
from learn2assemble.tasks.search.tree import ActionValues, StepResult
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import WorldModel

OBSERVED_SCALE = 1.025
"""Positions are divided by it in the published observation [m]."""
TOUCH_TOLERANCE = 1e-3
"""Cells of waiting objects are taken to touch up to this [m]."""


class Copies(NamedTuple):
    """Worlds of a search and which of them are the world itself, not yet rebuilt."""

    state: State
    real: np.ndarray
    """bool[B]."""


class LegacyModel:
    """Implements :class:`learn2assemble.tasks.search.tree.SearchModel` with the published faults.

    Args:
        model: the exact model.
        rng: draws the random problems of fault (b).
    """

    def __init__(self, model: WorldModel, rng: np.random.Generator) -> None:
        self.model, self.rng, self.discount = model, rng, model.discount

    def take(self, states: State | Copies, rows: np.ndarray) -> Copies:
        copies = _copies(states)
        return Copies(copies.state.take(rows), copies.real[rows])

    def join(self, states: list[Copies]) -> Copies:
        joined = self.model.join([part.state for part in states])
        return Copies(joined, np.concatenate([part.real for part in states]))

    def step(self, states: State | Copies, actions: np.ndarray) -> StepResult:
        copies = _copies(states)
        start, actions, fell = self._restore(copies, actions)
        result = self.model.step(start, actions)
        result.states.terminated[fell] = True
        after = Copies(result.states, np.zeros(len(copies.real), np.bool_))
        reward = np.where(fell, -1.0, result.reward)
        return StepResult(after, reward, result.terminal | fell)

    def action_values(self, states: State | Copies) -> list[ActionValues]:
        return self.model.action_values(_state(states))

    def legal(self, states: State | Copies) -> list[ActionValues]:
        return self.model.legal(_state(states))

    def random_actions(self, states: State | Copies, rng: np.random.Generator) -> np.ndarray:
        return self.model.random_actions(_state(states), rng)

    def best(self, states: State | Copies) -> tuple[np.ndarray, np.ndarray]:
        return self.model.best(_state(states))

    def _restore(self, copies: Copies, actions: np.ndarray) -> tuple[State, np.ndarray, np.ndarray]:
        """What the published search simulated in place of the real rows, which actions, and in
        which rows a cell falls."""
        task = self.model.simulator.task
        start = copies.state.copy()
        seen = (start.position[copies.real] / OBSERVED_SCALE).astype(np.float32)
        start.position[copies.real] = seen * np.float32(OBSERVED_SCALE)
        fell = np.zeros(start.batch_size, np.bool_)
        if task.objects != "cubes":
            _take_apart(start, copies.real, task.pitch, fell)
        if task.normalise_initial:
            start.initial_pixels[copies.real] = start.plane_pixels[copies.real]
        redrawn = start.plane_pixels > task.max_initial_cover * start.mask_pixels
        redrawn |= start.mask_pixels < task.min_mask_pixels
        rows = np.flatnonzero(copies.real & redrawn)
        if not len(rows):
            return start, actions, fell
        fell[rows] = False
        # The action names nodes; in the other problem they are clipped to its ranges.
        nodes = actions[rows] + _first_nodes(start, rows)
        self.model.simulator.reset(start, rows, self.rng)
        counts = np.stack([start.num_unplaced[rows], start.num_placed[rows]], -1)
        local = nodes - _first_nodes(start, rows)
        actions = actions.copy()
        actions[rows, :2] = np.clip(local[:, :2], 0, counts - 1)
        return start, actions, fell


@kernel
def _take_apart(state: State, rebuilt: np.ndarray, pitch: float, fell: np.ndarray) -> None:
    """Fault (c) on the rows ``rebuilt``; sets ``fell`` where a placed cell then hangs."""
    for row in range(len(rebuilt)):
        if not rebuilt[row]:
            continue
        position, placed = state.position[row], state.num_placed[row]
        number = 0
        for k in range(state.num_blocks[row]):
            if k < placed:
                fell[row] |= not reaches_ground(position, placed, k, HALF)
            apart = 0.0
            for axis in range(3):
                apart += abs(position[k, axis] - position[k - 1, axis])
            # Cells are on one lattice, so neighbours are one step apart along one axis.
            off = min(abs(apart - EDGE), abs(apart - pitch))
            if k <= placed or off > TOUCH_TOLERANCE:
                number += 1
            state.object_id[row, k] = number


def _state(states: State | Copies) -> State:
    return states.state if isinstance(states, Copies) else states


def _copies(states: State | Copies) -> Copies:
    if isinstance(states, Copies):
        return states
    return Copies(states, np.ones(states.batch_size, np.bool_))


def _first_nodes(state: State, rows: np.ndarray) -> np.ndarray:
    """Node index of the first unplaced and of the first placed block, and 0: int64[R, 3]."""
    targets, placed = state.num_targets[rows], state.num_placed[rows]
    return np.stack([targets + placed, targets, 0 * placed], -1)


def with_restore_faults(model: WorldModel) -> LegacyModel:
    """The exact model of a search with the published faults around it."""
    return LegacyModel(model, np.random.default_rng(0))
