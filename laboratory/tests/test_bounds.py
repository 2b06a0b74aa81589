"""The upper bound on returns and the exact look-ahead."""

from __future__ import annotations

import numpy as np
import pytest

from learn2assemble.tasks.evaluation.bounds import open_cells, return_bound
from learn2assemble.tasks.evaluation.episodes import run_episodes
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import get_task
from learn2assemble.tasks.world_model import lookahead_actions


def test_no_play_exceeds_the_bound() -> None:
    task = get_task("two-sided-3x3-20-24")
    simulator = Simulator(task)
    state = simulator.new(60, np.random.default_rng(0))
    bound = return_bound(state, task.discount)
    total, discount = np.zeros(60), 1.0
    while not state.terminated.all():
        total += discount * simulator.step(state, lookahead_actions(simulator, state)).reward
        discount *= task.discount
    assert (total <= bound + 1e-9).all()
    # The look-ahead comes close, so the bound says something.
    assert total.mean() > 0.95 * bound.mean()


def test_open_cells_of_one_block_high_wall() -> None:
    task = get_task("one-sided-3x3-22-24")
    simulator = Simulator(task)
    state = simulator.new(1, np.random.default_rng(0))
    state.mask[:] = 0
    # Rows 70 to 80 show heights of about 2 to 9 cm, columns 42 to 58 three blocks.
    for row in range(76, 80):
        state.mask[0, 0, row, 0] = ((1 << 59) - 1) & ~((1 << 42) - 1)
    assert open_cells(state)[0] == 3 - 1


def test_look_ahead_never_fails_on_cubes() -> None:
    task = get_task("two-sided-4x4-20-24")
    simulator = Simulator(task)
    metrics = run_episodes(
        task, lambda state, rng: lookahead_actions(simulator, state), episodes=20, seed=0
    )
    assert metrics.f == 0
    assert metrics.success + metrics.b == pytest.approx(1)
