"""What perfect play could score on fresh problems of a task: the tightest proven upper bounds."""

from __future__ import annotations

import numpy as np

from learn2assemble.evaluation.bounds import return_bound
from learn2assemble.evaluation.exact import exact_return
from learn2assemble.evaluation.object_bounds import object_return_bound
from learn2assemble.simulator import Simulator
from learn2assemble.task import Task
from learn2assemble.world.state import State


def has_bound(task: Task) -> bool:
    """Whether a bound is known: cubes with the discrete, anything with the scaled reward, where
    blocks touch."""
    return task.touching and (task.reward == "scaled" or task.objects == "cubes")


def best_returns(simulator: Simulator, count: int, rng: np.random.Generator) -> np.ndarray:
    """Upper bound on the return of each of ``count`` fresh problems, float64[count].

    Cubes on one or two sides: the optimum but for a gap that is nearly always 0 (``exact``); on
    more sides the number of cells to fill (``bounds``). Scaled reward: the packing bound, which
    knows neither balance nor support (``object_bounds``). Problems as in the evaluation episodes
    of the same generator.
    """
    task, state = simulator.task, simulator.new(count, rng)
    if task.reward == "scaled":
        return np.array([_of_objects(simulator, state, row) for row in range(count)])
    if task.num_sides <= 2:
        return np.array([exact_return(simulator, state, row).upper for row in range(count)])
    return return_bound(state, task.discount)


def _of_objects(simulator: Simulator, state: State, row: int) -> float:
    task = simulator.task
    return object_return_bound(
        state, row, simulator.frames, task.discount, task.success_threshold, task.rotations
    )
