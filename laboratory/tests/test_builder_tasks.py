"""The builder of designs as a player of the paper's tasks."""

from __future__ import annotations

import numpy as np
import pytest

from l2a_lab.bounds import best_returns, find_towers
from l2a_lab.builder.network import load_builder
from l2a_lab.builder.tasks import TaskModel, make_problem
from learn2assemble.errors import InputError
from learn2assemble.tasks.evaluation.episodes import (
    evaluate,
    greedy_policy,
    play_episodes,
    search_policy,
)
from learn2assemble.tasks.search.config import SearchConfig
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import get_task
from learn2assemble.tasks.world_model import lookahead_actions

SEARCH = SearchConfig(budget=4, epsilon=0.0)


def model(task: str) -> TaskModel:
    return TaskModel(Simulator(get_task(task)), load_builder())


@pytest.mark.parametrize(
    "task", ["two-sided-3x3-20-24", "two-sided-5x5-40-44", "one-sided-3x3-22-24"]
)
def test_a_problem_is_the_towers_of_its_sides(task: str) -> None:
    """The cells of the design are those that the exact returns let grow, found in another way."""
    simulator = Simulator(get_task(task))
    state = simulator.new(20, np.random.default_rng(3))
    for row in range(20):
        problem = make_problem(simulator, state, row)
        cells = {
            tuple(cell) for cell in (np.argwhere(problem.site.wanted) + problem.corner).tolist()
        }
        towers = find_towers(simulator, state, row)
        high = [
            (*p, z)
            for p, cap in zip(towers.place.tolist(), towers.cap, strict=True)
            for z in range(cap)
        ]
        # A side without open pixels has places there, too, that only have to be passed.
        assert {cell for cell in high if cell[2] > 0} == {cell for cell in cells if cell[2] > 0}
        assert cells <= set(high)


@pytest.mark.parametrize(
    "task", ["two-sided-3x3-20-24", "bars-one-sided-5x5-25-27", "objects-two-sided-5x5-20-24"]
)
def test_what_is_built_is_filled_in_the_design(task: str) -> None:
    """Every placement offered holds, and what stands is what the network is shown."""
    simulator, rng = Simulator(get_task(task)), np.random.default_rng(0)
    player, state = TaskModel(simulator, load_builder()), simulator.new(8, rng)
    for _ in range(2):
        found = player.action_values(state)
        for row, values in enumerate(found):
            world = player.standing(state, row)
            problem = player.problem(state, row)
            filled = np.argwhere((world.owner >= 0).reshape(world.site.wanted.shape))
            placed = state.position[row, : state.num_placed[row]]
            at = np.rint(placed / 0.05 - [0, 0, 0.5]).astype(int)
            inside = {tuple(cell) for cell in at.tolist()}
            assert {tuple(cell) for cell in (filled + problem.corner).tolist()} <= inside
            for kind, left in zip(world.site.kit.kinds, world.heap, strict=True):
                assert 0 <= left <= (kind.count or 0)
            for action in values.actions:
                tried = simulator.step(state.take(np.array([row])), action[None])
                assert tried.verdict[0] == 0
        step = simulator.step(state, player.best(state)[1])
        state = state.take(np.flatnonzero(~step.terminated))


def test_the_builder_plays_nearly_perfectly() -> None:
    """On the problems of 12 episodes: no failure, and at most 4 % below the upper bound."""
    for task in ("two-sided-3x3-20-24", "two-sided-4x4-30-34"):
        player = model(task)
        played = play_episodes(player.simulator, search_policy(player, SEARCH), 12, 7)
        alone = play_episodes(player.simulator, greedy_policy(player, 0.0), 12, 7)
        root = np.random.SeedSequence([2, 7])
        bound = best_returns(player.simulator, 12, np.random.default_rng(root.spawn(1)[0]))
        assert not played.failed.any()
        assert (played.returns <= bound + 1e-9).all()
        assert played.returns.mean() >= max(0.96 * bound.mean(), alone.returns.mean() - 0.05)


def test_rewards_come_first() -> None:
    """Without search it takes what pays wherever the look-ahead finds something that does."""
    simulator = Simulator(get_task("two-sided-5x5-40-44"))
    player, state = (
        TaskModel(simulator, load_builder()),
        simulator.new(16, np.random.default_rng(1)),
    )
    best = simulator.step(state.copy(), lookahead_actions(simulator, state)).reward
    mine = simulator.step(state.copy(), player.best(state)[1]).reward
    np.testing.assert_array_equal(mine, best)


def test_evaluation_of_a_builder() -> None:
    result = evaluate(
        "two-sided-3x3-20-24", agent="builder-s0", search="mcts", budget=2, episodes=2
    )
    assert result.agent == "builder-s0"
    assert result.metrics.f == 0
    with pytest.raises(InputError, match="agent of the paper"):
        evaluate("robot-two-sided-3x3-10-14", agent="builder-s0", episodes=1)
