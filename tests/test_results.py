"""Published tables come from result files and from nowhere else."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from learn2assemble.evaluation.bounds import open_cells, return_bound
from learn2assemble.evaluation.episodes import run_episodes
from learn2assemble.planning.lookahead import lookahead_actions
from learn2assemble.presets import get_task
from learn2assemble.simulator import Simulator

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def results() -> ModuleType:
    spec = importlib.util.spec_from_file_location("results", ROOT / "benchmarks" / "results.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_table_of_the_readme_is_generated(results: ModuleType) -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert results.with_table(readme) == readme


def test_the_results_file_says_how_it_was_made(results: ModuleType) -> None:
    data = json.loads(results.RESULTS.read_text(encoding="utf-8"))
    for key in ("agent", "origin", "commit", "hardware", "torch", "rows", "references"):
        assert data[key], key
    for row in data["rows"]:
        assert row["episodes"] == 100 * len(row["seeds"])
        assert row["f"] + row["b"] + row["success"] == pytest.approx(1)
        assert row["seconds"] > 0


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
