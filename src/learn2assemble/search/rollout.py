"""What a leaf is worth: a rollout, then the largest Q (protocol 11.1)."""

from __future__ import annotations

import numpy as np

from learn2assemble.search.config import SearchConfig
from learn2assemble.search.model import SearchModel, StepResult


def returns(
    model: SearchModel, result: StepResult, config: SearchConfig, rng: np.random.Generator
) -> np.ndarray:
    """``G = sum_t gamma^t r_t + gamma^eta max Q`` of the steps just made: float64[B].

    The first step is ``result``; ``eta - 1`` steps of the rollout policy follow. Episodes that
    end on the way have no bootstrap. All rows go on together.
    """
    total = np.asarray(result.reward, float).copy()
    alive = np.flatnonzero(~result.terminal)
    states = model.take(result.states, alive)
    scale = model.discount
    for _ in range(config.rollout - 1):
        if not len(alive):
            return total
        step = model.step(states, _rollout_actions(model, states, len(alive), config, rng))
        total[alive] += scale * step.reward
        scale *= model.discount
        going = np.flatnonzero(~step.terminal)
        alive, states = alive[going], model.take(step.states, going)
    if len(alive):
        total[alive] += scale * model.best(states)[0]
    return total


def _rollout_actions(
    model: SearchModel, states: object, count: int, config: SearchConfig, rng: np.random.Generator
) -> np.ndarray:
    """One action a row: uniform, or greedy with a uniform one at the rate epsilon."""
    if config.rollout_policy == "random":
        return model.random_actions(states, rng)
    _, actions = model.best(states)
    if config.epsilon:
        chance = rng.random(count) < config.epsilon
        actions = np.where(chance[:, None], model.random_actions(states, rng), actions)
    return actions
