"""Evaluation: metrics of scripted policies by hand, fair problems, exploration, bounds, cells."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
import pytest
import torch

from learn2assemble.errors import InputError
from learn2assemble.kinematics.cell import KinematicCell
from learn2assemble.robot.moves import Attempt, Outcome
from learn2assemble.tasks.episode import sample_problem
from learn2assemble.tasks.evaluation import episodes
from learn2assemble.tasks.evaluation.bounds import open_cells, return_bound
from learn2assemble.tasks.evaluation.episodes import (
    BATCH,
    EVALUATION_STREAM,
    Policy,
    evaluate,
    greedy_policy,
    make_policy,
    run_episodes,
    search_policy,
)
from learn2assemble.tasks.evaluation.fidelities import compare
from learn2assemble.tasks.learning.config import TrainConfig
from learn2assemble.tasks.learning.trainer import TRAINING_STREAM, Trainer
from learn2assemble.tasks.networks.agent import Agent, load_agent
from learn2assemble.tasks.networks.config import NetworkConfig
from learn2assemble.tasks.networks.qnetwork import QNetwork
from learn2assemble.tasks.physics.rigid import RigidPhysics
from learn2assemble.tasks.search.config import SearchConfig
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import Task, get_task
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import WorldModel, lookahead_actions

torch.set_num_threads(1)

TINY = Task("tiny", num_sides=1, grid=2, num_nodes=9)
FEW = Task("few", num_sides=1, grid=3, num_nodes=8)
"""Mostly more to fill than there are blocks."""
NETWORK = NetworkConfig(width=16, heads=2, rounds=1, position_scale=0.1)


def network() -> QNetwork:
    torch.manual_seed(0)
    return QNetwork(NETWORK).eval()


def script(*relations: int) -> Policy:
    """Places the next block against the newest one, in these relations one after the other."""

    def act(state: State, rng: np.random.Generator) -> np.ndarray:
        newest = state.num_placed - 1
        steps = np.array([relations[min(n, len(relations) - 1)] for n in newest])
        return np.stack([0 * newest, newest, steps], -1)

    return act


TOP, LEFT, RIGHT = 0, 1, 2


def by_hand(task: Task, policy: Policy, count: int, seed: int) -> dict[str, Any]:
    """The same problems, one world at a time, with the definitions of the paper's metrics."""
    simulator = Simulator(task)
    stream = np.random.SeedSequence([EVALUATION_STREAM, seed]).spawn(2)[0]
    rng, worlds = np.random.default_rng(stream), []
    while len(worlds) < count:
        batch = simulator.new(min(BATCH, count - len(worlds)), rng)
        worlds += [batch.take(np.array([row])) for row in range(batch.batch_size)]
    returns, actions, failed, out, success, cover = [], [], [], [], [], []
    for world in worlds:
        rewards, ended = [], False
        while not ended:
            step = simulator.step(world, policy(world, np.random.default_rng(0)))
            rewards.append(float(step.reward[0]))
            ended = bool(step.terminated[0])
        returns.append(sum(r * task.discount**t for t, r in enumerate(rewards)))
        actions.append(len(rewards))
        invalid, filled = bool(step.verdict[0] != 0), bool(step.success[0])
        failed.append(invalid)
        success.append(filled)
        out.append(not invalid and not filled and world.num_unplaced[0] == 0)
        cover.append(float(world.complete_coverage[0]))
    spread = math.sqrt(sum((r - np.mean(returns)) ** 2 for r in returns) / (count - 1))
    return {
        "R": np.mean(returns),
        "R_ci95": 1.96 * spread / math.sqrt(count),
        "a": np.mean(actions),
        "f": np.mean(failed),
        "b": np.mean(out),
        "success": np.mean(success),
        "coverage": np.mean(cover),
        "episodes": count,
    }


@pytest.mark.parametrize("task", [TINY, FEW], ids=lambda t: t.name)
@pytest.mark.parametrize("relations", [(TOP,), (LEFT, RIGHT), (TOP, LEFT), (LEFT, LEFT, TOP)])
def test_metrics_of_a_script(task: Task, relations: tuple[int, ...]) -> None:
    """Against one world at a time; more episodes than one batch of worlds holds."""
    count = BATCH + 7
    metrics = run_episodes(task, script(*relations), count, seed=3).to_dict()
    for name, value in by_hand(task, script(*relations), count, 3).items():
        assert metrics[name] == pytest.approx(value, abs=1e-9), name
    assert metrics["f"] + metrics["b"] + metrics["success"] == pytest.approx(1.0)


def test_metrics_that_are_known_beforehand() -> None:
    """Left, then back right onto the first block: fails in the second step at the latest."""
    metrics = run_episodes(TINY, script(LEFT, RIGHT), 60, seed=0)
    assert metrics.f > 0.5
    assert metrics.b == 0
    assert 1 <= metrics.a <= 2
    # Towers run out of blocks or fill the target, and never fall.
    tower = run_episodes(FEW, script(TOP), 60, seed=0)
    assert tower.f == 0
    assert tower.b > 0.5
    assert tower.episodes == 60
    assert tower.physics == "static"


def test_one_episode_has_no_interval() -> None:
    assert run_episodes(TINY, script(TOP), 1, seed=0).to_dict()["R_ci95"] is None


def test_same_seed_same_metrics_and_progress_counts() -> None:
    policy = greedy_policy(WorldModel(Simulator(TINY), network()), 0.5)
    told: list[int] = []
    runs = [run_episodes(TINY, policy, 60, seed=4, progress=told.append) for _ in range(2)]
    for name in ("R", "a", "f", "b", "success", "coverage", "R_ci95"):
        assert getattr(runs[0], name) == getattr(runs[1], name)
    assert told == [50, 60, 50, 60]
    assert run_episodes(TINY, policy, 60, seed=5).R != runs[0].R


def problems(policy: Policy, seed: int, count: int = BATCH + 10) -> list[bytes]:
    """Outlines of the problems an evaluation poses, batch by batch."""
    seen: list[bytes] = []

    def act(state: State, rng: np.random.Generator) -> np.ndarray:
        fresh = state.num_placed == 1
        seen.extend(state.vertices[row].tobytes() for row in np.flatnonzero(fresh))
        return policy(state, rng)

    run_episodes(TINY, act, count, seed)
    assert len(seen) == count
    return seen


def test_every_policy_meets_the_same_problems() -> None:
    """However much randomness it uses, and however long its episodes are."""
    model = WorldModel(Simulator(TINY), network())
    policies = [
        script(LEFT, RIGHT),
        greedy_policy(model, 1.0),
        search_policy(model, SearchConfig(budget=3, epsilon=0.3)),
    ]
    first, *others = [problems(policy, 1) for policy in policies]
    assert len(set(first)) == len(first)
    for other in others:
        assert other == first
    assert not set(problems(policies[0], 2)) & set(first)


def test_no_training_problem_is_evaluated() -> None:
    """Equal seeds draw from different streams (12.1)."""
    assert TRAINING_STREAM != EVALUATION_STREAM
    config = TrainConfig(network=NETWORK, num_envs=30, replay_size=10)
    trained, evaluated = set(), set()
    for seed in range(4):
        trainer = Trainer(TINY, config, seed)
        for _ in range(10):
            trained |= {v.tobytes() for v in trainer.state.vertices}
            trainer.collect()
        evaluated |= set(problems(script(TOP), seed))
    assert len(trained) > 400
    assert len(evaluated) == 4 * (BATCH + 10)
    assert not trained & evaluated


def test_no_training_problem_is_built() -> None:
    """``l2a build PRESET --seed s`` shows problems that no training seed has seen."""
    name = "one-sided-3x3-22-24"
    config = TrainConfig(network=NETWORK, num_envs=2, replay_size=10)
    trained = {Trainer(get_task(name), config, s).state.vertices[0].tobytes() for s in range(3)}
    built = {sample_problem(get_task(name), s).vertices[0].tobytes() for s in range(3)}
    assert not trained & built


class FirstIsBest:
    """A model whose greedy action is always (0, 0, top)."""

    discount = 0.8

    def best(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(state.batch_size), np.zeros((state.batch_size, 3), np.int64)


@pytest.mark.parametrize("epsilon", [0.0, 0.05, 0.5, 1.0])
def test_epsilon_greedy_rate(epsilon: float) -> None:
    """Uniform over all legal actions with probability epsilon."""
    simulator, rng = Simulator(FEW), np.random.default_rng(0)
    state = simulator.new(4000, rng)
    simulator.step(state, np.tile([0, 0, TOP], (4000, 1)))
    state = state.take(np.flatnonzero(~state.terminated & (state.num_unplaced == 2)))
    count = state.batch_size
    assert count > 500
    policy = greedy_policy(cast(Any, FirstIsBest()), epsilon)
    actions = np.concatenate([policy(state, rng) for _ in range(6)])
    sizes = (2, 2, 5)
    assert (actions >= 0).all()
    assert (actions < sizes).all()
    other = (actions != 0).any(1)
    # One of the 20 legal actions is the greedy one.
    rate = epsilon * (1 - 1 / 20)
    assert other.mean() == pytest.approx(rate, abs=4 * math.sqrt(rate / len(actions)) + 1e-12)
    if epsilon == 1:
        counts = np.bincount(np.ravel_multi_index(tuple(actions.T), sizes), minlength=20)
        assert np.abs(counts - counts.mean()).max() < 5 * math.sqrt(counts.mean())


def test_make_policy_picks_the_search() -> None:
    """Without a budget, the plain Q-policy; a search's choice is the best child's."""
    rng, state = np.random.default_rng(0), Simulator(TINY).new(6, np.random.default_rng(1))
    plain = greedy_policy(WorldModel(Simulator(TINY), network()), 0.0)(state, rng)
    for config in (None, SearchConfig(budget=0, epsilon=0.0)):
        got = make_policy(TINY, network(), config, 0.0)(state, rng)
        np.testing.assert_array_equal(got, plain)
    exact = SearchConfig(budget=200, epsilon=0.0, prior=False)
    searched = make_policy(TINY, network(), exact, 0.0)(state.copy(), rng)
    assert (searched != plain).any()


def test_search_beats_a_random_network() -> None:
    """Search needs no training to see that invalid actions are bad."""
    policy = make_policy(TINY, network(), SearchConfig(budget=30, epsilon=0.0), 0.0)
    plain = make_policy(TINY, network(), None, 0.0)
    assert run_episodes(TINY, policy, 20, 0).f < run_episodes(TINY, plain, 20, 0).f - 0.3


def test_a_search_asks_the_checker_it_looks_ahead_with(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = 0
    settle = RigidPhysics.settle

    def count(self: RigidPhysics, state: State, rows: np.ndarray) -> np.ndarray:
        nonlocal asked
        asked += len(rows)
        return settle(self, state, rows)

    monkeypatch.setattr(RigidPhysics, "settle", count)
    agent = Agent("tiny", network(), TINY.name, {})
    found = {}
    for ahead in (None, "rigid"):
        found[ahead] = evaluate(
            TINY, agent=agent, search="mcts", budget=3, episodes=2, look_ahead=ahead
        )
        assert (asked > 0) == (ahead == "rigid")
    assert [one.look_ahead for one in found.values()] == ["static", "rigid"]
    assert all(one.metrics.physics == "static" for one in found.values())
    with pytest.raises(InputError, match="look_ahead"):
        evaluate(TINY, agent=agent, look_ahead="rigid", episodes=1)


def test_the_judge_can_be_rigid() -> None:
    metrics = run_episodes(FEW, script(TOP), 3, seed=0, physics=RigidPhysics())
    assert metrics.physics == "rigid"
    assert metrics.f == 0


def test_batches_do_not_change_an_episode(monkeypatch: pytest.MonkeyPatch) -> None:
    """A deterministic policy plays the same whether 50 or 7 worlds run side by side."""
    policy = make_policy(TINY, network(), SearchConfig(budget=5, epsilon=0.0), 0.0)
    whole = run_episodes(TINY, policy, 30, 2)
    monkeypatch.setattr(episodes, "BATCH", 7)
    parts = run_episodes(TINY, policy, 30, 2)
    for name in ("R", "a", "f", "b", "success", "coverage"):
        assert getattr(whole, name) == pytest.approx(getattr(parts, name))


# The kinematic cell against the dynamic one, on the same moves.

TASK = get_task("robot-two-sided-3x3-10-14")


def test_both_cells_judge_the_same_moves() -> None:
    agent = load_agent("relational-two-sided-s0")
    found = compare(TASK, agent, 8, seed=4)
    again = compare(TASK, agent, 8, seed=4)
    data = found.to_dict()
    assert data["actions"] == sum(data["outcomes"].values()) == 8
    assert data["agree"] >= 7
    assert found.outcomes == again.outcomes
    assert min(data["kinematic_ms"], data["dynamic_ms"]) > 0
    assert data["share"] == found.share == data["agree"] / 8
    assert len(data["disagreements"]) == 8 - data["agree"]
    assert data["commit"]


def test_a_cell_that_is_wrong_is_found_out(monkeypatch) -> None:
    """A kinematic cell that says no to everything disagrees wherever the dynamic one succeeds."""
    no = Attempt(Outcome.UNREACHABLE, "pick", "never")
    monkeypatch.setattr(KinematicCell, "attempt", lambda self, scene, move: no)
    found = compare(TASK, load_agent("relational-two-sided-s0"), 6, seed=4)
    reached = sum(n for (_, second), n in found.outcomes.items() if second == "reached")
    assert reached > 0
    assert found.share == (6 - reached) / 6
    assert len(found.to_dict()["disagreements"]) == reached


# The upper bound on returns and the exact look-ahead.


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
