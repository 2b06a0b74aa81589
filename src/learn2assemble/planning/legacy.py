"""The published restore faults as a model of the world, for comparison (protocol 11.6).

The published search did not copy the world: before every simulation it rebuilt one from the
observation, and two steps of an ordinary reset ran along.

* (a) The initial cover c0 is taken from the restored state, so coverage and the success threshold
  refer to what is still open (where coverage is normalised: without a robot).
* (b) Where the structure already covers more than the share at which a reset redraws the problem,
  or the masks are too small, the simulation silently runs in a random new problem.

Left out: (c) constraints of placed objects are not rebuilt, and (d) positions pass through
float32. Placed cubes have no constraints.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.planning.world_model import WorldModel
from learn2assemble.search.model import ActionValues, StepResult
from learn2assemble.world.state import State


class Copies(NamedTuple):
    """Worlds of a search and which of them are the world itself, not yet rebuilt."""

    state: State
    real: np.ndarray
    """bool[B]."""


class LegacyModel:
    """Implements :class:`learn2assemble.search.model.SearchModel` with the published faults.

    Args:
        model: the exact model.
        rng: draws the random problems of fault (b).
    """

    def __init__(self, model: WorldModel, rng: np.random.Generator) -> None:
        self.model, self.rng, self.discount = model, rng, model.discount

    def batch_size(self, states: State | Copies) -> int:
        return _state(states).batch_size

    def take(self, states: State | Copies, rows: np.ndarray) -> Copies:
        copies = _copies(states)
        return Copies(copies.state.take(rows), copies.real[rows])

    def join(self, states: list[Copies]) -> Copies:
        joined = self.model.join([part.state for part in states])
        return Copies(joined, np.concatenate([part.real for part in states]))

    def step(self, states: State | Copies, actions: np.ndarray) -> StepResult:
        copies = _copies(states)
        start, actions = self._restore(copies, actions)
        result = self.model.step(start, actions)
        after = Copies(result.states, np.zeros(len(copies.real), np.bool_))
        return result._replace(states=after)

    def action_values(self, states: State | Copies) -> list[ActionValues]:
        return self.model.action_values(_state(states))

    def legal(self, states: State | Copies) -> list[ActionValues]:
        return self.model.legal(_state(states))

    def random_actions(self, states: State | Copies, rng: np.random.Generator) -> np.ndarray:
        return self.model.random_actions(_state(states), rng)

    def best(self, states: State | Copies) -> tuple[np.ndarray, np.ndarray]:
        return self.model.best(_state(states))

    def _restore(self, copies: Copies, actions: np.ndarray) -> tuple[State, np.ndarray]:
        """What the published search simulated in place of the real rows, and which actions."""
        task = self.model.simulator.task
        start = copies.state.copy()
        if task.normalise_initial:
            start.initial_pixels[copies.real] = start.plane_pixels[copies.real]
        redrawn = start.plane_pixels > task.max_initial_cover * start.mask_pixels
        redrawn |= start.mask_pixels < task.min_mask_pixels
        rows = np.flatnonzero(copies.real & redrawn)
        if not len(rows):
            return start, actions
        # The action names nodes; in the other problem they are clipped to its ranges (protocol 5).
        nodes = actions[rows] + _first_nodes(start, rows)
        self.model.simulator.reset(start, rows, self.rng)
        counts = np.stack([start.num_unplaced[rows], start.num_placed[rows]], -1)
        local = nodes - _first_nodes(start, rows)
        actions = actions.copy()
        actions[rows, :2] = np.clip(local[:, :2], 0, counts - 1)
        return start, actions


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
