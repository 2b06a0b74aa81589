"""Every learner: the search term, what is stored, a tiny task solved."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learn2assemble.tasks.evaluation.episodes import make_policy, random_policy, run_episodes
from learn2assemble.tasks.graph.batch import to_tensors
from learn2assemble.tasks.graph.features import node_offset
from learn2assemble.tasks.learning.config import CONFIGS, TrainConfig, override
from learn2assemble.tasks.learning.replay import Searched
from learn2assemble.tasks.learning.run import run_training
from learn2assemble.tasks.learning.trainer import (
    Trainer,
    q_loss,
    search_cross_entropy,
    td_targets,
)
from learn2assemble.tasks.networks.config import NetworkConfig
from learn2assemble.tasks.networks.qnetwork import QFactors
from learn2assemble.tasks.search.config import training_search
from learn2assemble.tasks.search.mcts import search
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import get_task
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import WorldModel
from learning_data import RELATIONAL, SMALL, TINY, look_ahead


def play_well(simulator: Simulator) -> Callable[[State, np.random.Generator], np.ndarray]:
    """Takes the valid placement that covers most, one step ahead."""

    def act(state: State, rng: np.random.Generator) -> np.ndarray:
        placements, options = look_ahead(simulator, state)
        worth = np.where(options.valid, options.reward + options.gain, -9.0)
        chosen = placements.action[np.arange(len(worth)), worth.argmax(1)]
        return chosen - node_offset(simulator.observe(state))

    return act


# The search term.


def test_cross_entropy_by_hand() -> None:
    """Two explored actions with search values 1 and 0, two with Q = 0 and Q = 2: softmax(1, 0)
    against log softmax(0, 2); a sample without search adds 0, and the divisor stays 3."""
    block = torch.zeros(3, 4, 1, requires_grad=True)
    with torch.no_grad():
        block[0, 1], block[0, 2] = 0.0, 2.0
        block[2, 1], block[2, 2], block[2, 3] = 1.0, 1.0, 1.0
    factors = QFactors(block, torch.zeros(3, 4, 1), torch.zeros(3, 1))
    action = np.zeros((3, 3, 3), np.int64)
    action[0, :2, 0] = 1, 2
    action[2, :, 0] = 1, 2, 3
    value = np.array([[1.0, 0.0, 99.0], [99.0, 99.0, 99.0], [0.5, 0.5, 0.5]], np.float32)
    searched = Searched(action, value, np.array([2, 0, 3]))
    p = math.e / (1 + math.e)
    first = -(p * -math.log(1 + math.e**2) + (1 - p) * (2 - math.log(1 + math.e**2)))
    loss = search_cross_entropy(factors, searched, torch.tensor([[1, 0, 0]] * 3))
    assert float(loss.detach()) == pytest.approx((first + 0 + math.log(3)) / 3, rel=1e-5)
    loss.backward()
    assert block.grad is not None
    # The gradient of a cross-entropy: softmax(Q) - softmax(Q_S), over 3.
    q = 1 / (1 + math.e**2)
    expected = [0, (q - p) / 3, (p - q) / 3, 0]
    np.testing.assert_allclose(block.grad[0, :, 0], expected, atol=1e-6)
    assert not block.grad[1].any(), "nothing is learned where nothing was searched"
    np.testing.assert_allclose(block.grad[2], 0, atol=1e-7)


@pytest.mark.parametrize("network", [SMALL, RELATIONAL], ids=lambda c: c.encoder)
@pytest.mark.parametrize("weight", [0.5, 0.2])
@pytest.mark.parametrize("method", ["q-mcts", "eps-mcts"])
def test_loss_of_the_search_learners(method: str, weight: float, network: NetworkConfig) -> None:
    """``(1 - w) smoothL1 + w CE`` over a batch from replay, by loops over single Q-values."""
    trainer = searcher(method, search_weight=weight, network=network)
    collect(trainer, 12)
    batch = trainer.replay.sample(16, np.random.default_rng(0))
    loss, logs = q_loss(trainer.online, trainer.target, batch, trainer.config, "cpu")
    searched = batch.searched
    assert searched is not None
    if method == "eps-mcts":
        assert (searched.count == 0).any()
    with torch.no_grad():
        values = trainer.online(to_tensors(batch.graph))
        y = td_targets(trainer.online, trainer.target, batch, trainer.config, "cpu").numpy()

    def q(row: int, action: np.ndarray) -> float:
        return float(
            values.select(
                torch.from_numpy(batch.action).index_put(
                    (torch.tensor(row),), torch.from_numpy(action)
                )
            )[row]
        )

    td, ce = 0.0, 0.0
    for row in range(16):
        error = abs(q(row, batch.action[row]) - y[row])
        td += (0.5 * error**2 if error < 1 else error - 0.5) / 16
        count = int(searched.count[row])
        goal = np.exp(searched.value[row, :count].astype(float))
        mine = np.exp([q(row, a) for a in searched.action[row, :count]])
        ce -= (goal / goal.sum() * np.log(mine / mine.sum())).sum() / 16
    assert float(loss.detach()) == pytest.approx((1 - weight) * td + weight * ce, rel=1e-4)
    assert logs["search"] == pytest.approx(ce, rel=1e-4)


# What the learners store.


def searcher(method: str, **changes: Any) -> Trainer:
    values: dict[str, Any] = {
        "network": SMALL,
        "num_envs": 6,
        "replay_size": 200,
        "epsilon_samples": 100,
        "epsilon_final": 0.3,
        "search_budget": 4,
    }
    return Trainer(TINY, TrainConfig(**{**values, **changes}, method=method), 0)


def collect(trainer: Trainer, rounds: int) -> None:
    for _ in range(rounds):
        trainer.collect()


@pytest.mark.parametrize("method", ["q-mcts", "eps-mcts"])
def test_stored_searches_are_what_the_search_found(method: str) -> None:
    """The search repeated with the same generator and network finds the stored values; the action
    played is one of the explored, or random without a search."""
    trainer = searcher(method)
    for _ in range(10):
        state, epsilon = trainer.state.copy(), trainer.epsilon
        rng = copy.deepcopy(trainer.rng)
        graph, first = trainer.graph, trainer.replay.cursor
        trainer.collect()
        config = training_search(method, 4, epsilon)
        decisions = search(WorldModel(trainer.simulator, trainer.online), state, config, rng)
        stored = trainer.replay.arrays
        offset = node_offset(graph)
        for row, decision in enumerate(decisions):
            n = (first + row) % 200
            found = decision.explored()
            assert stored["searched.count"][n] == len(found) in (0, 4)
            assert stored["greedy"][n] == (not decision.random)
            assert stored["action"][n].tolist() == (decision.action + offset[row]).tolist()
            for e, (action, value, _) in enumerate(found):
                assert stored["searched.action"][n, e].tolist() == (action + offset[row]).tolist()
                assert stored["searched.value"][n, e] == np.float32(value)
            if found:
                explored = stored["searched.action"][n].tolist()
                assert stored["action"][n].tolist() in explored
    if method == "q-mcts":
        assert (stored["searched.count"][: trainer.replay.length] == 4).all()


def test_eps_mcts_searches_at_the_rate_of_its_schedule() -> None:
    """At random without a search with probability epsilon, else top-B by Q."""
    trainer = searcher("eps-mcts", epsilon_samples=1, epsilon_final=0.25, replay_size=2000)
    collect(trainer, 1)
    start = trainer.replay.cursor
    collect(trainer, 200)
    counts = trainer.replay.arrays["searched.count"][start : trainer.replay.length]
    assert set(counts.tolist()) == {0, 4}
    assert (counts == 0).mean() == pytest.approx(0.25, abs=0.06)


def test_dqn_stores_no_searches() -> None:
    trainer = searcher("dqn")
    collect(trainer, 2)
    assert trainer.replay.sample(4, np.random.default_rng(0)).searched is None
    assert not any(name.startswith("searched") for name in trainer.replay.arrays)


# Learning works.

TINY_PUBLISHED = ["network.position_scale=0.1", "learning_rate=3e-3", "final_learning_rate=5e-4"]
FULL = ["network.connectivity=full"]
LEARNERS = {
    "own": ("relational", 2500, 0.9, ["learning_rate=3e-3", "final_learning_rate=5e-4"]),
    "paper": (
        "paper",
        10000,
        0.65,
        [
            "network.feed_forward=none",
            "network.position_scale=0.1",
            "steps_per_round=5",
            "updates_per_round=10",
            "learning_rate=2e-3",
            "final_learning_rate=2e-3",
        ],
    ),
    "dqn": (
        "published",
        4000,
        0.65,
        [*TINY_PUBLISHED, "updates_per_round=8", "learning_rate=2e-3"],
    ),
    "q-mcts": ("published", 4000, 0.5, [*TINY_PUBLISHED, "method=q-mcts"]),
    "eps-mcts": ("published", 6000, 0.65, [*TINY_PUBLISHED, "method=eps-mcts"]),
    "s2v": ("published", 4000, 0.4, [*TINY_PUBLISHED, *FULL, "network.encoder=s2v"]),
    "sha": ("published", 4000, 0.4, [*TINY_PUBLISHED, *FULL, "network.heads=1"]),
}


def score(policy: Any) -> float:
    return run_episodes(TINY, policy, 200, seed=0).R


@pytest.fixture(scope="module")
def tiny_returns() -> tuple[float, float]:
    """R of a one-step oracle, and of random play."""
    best, chance = score(play_well(Simulator(TINY))), score(random_policy(TINY.num_actions))
    assert chance < 0.25 * best
    return best, chance


@pytest.mark.slow
@pytest.mark.parametrize("name", LEARNERS)
def test_learner_solves_a_tiny_task(name: str, tiny_returns: tuple[float, float]) -> None:
    """A few seconds of training bring the greedy policy near to a one-step oracle (R = 2.1).

    The published learner gets less far in the time; it must still leave random play far behind.
    Another processor rounds otherwise and so trains another network, so what is asked for is the
    median over three seeds; where the first two agree it is decided.
    """
    base, samples, share, changes = LEARNERS[name]
    config = override(
        CONFIGS[base],
        [
            "network.width=32",
            "network.rounds=2",
            f"num_samples={samples}",
            "initial_samples=400",
            "epsilon_samples=2000",
            "replay_size=10000",
            "target_period=100",
            "num_envs=16",
            *changes,
        ],
    )

    best, chance = tiny_returns

    def learned(seed: int) -> float:
        trainer, value = Trainer(TINY, config, seed), 0.0
        for part in (0.4, 0.6, 0.8, 1.0):
            while trainer.samples < part * samples:
                trainer.round()
            value = score(make_policy(TINY, trainer.agent_network.eval(), None, 0.0))
            if value > share * best:  # It may be there before the time is up.
                break
        return value

    found = [learned(seed) for seed in range(2)]
    if len({value > share * best for value in found}) == 2:
        found.append(learned(2))
    assert np.median(found) > share * best, (chance, found, best)


@pytest.mark.parametrize("name", ["published", "relational"])
def test_presets_can_be_trained(name: str, tmp_path: Path) -> None:
    """One round of learning on the smallest and the largest task of the table."""
    config = override(
        CONFIGS[name],
        [
            "network.width=16",
            "network.rounds=1",
            "num_samples=8",
            "num_envs=4",
            "batch_size=4",
            "initial_samples=4",
            "replay_size=16",
            "updates_per_round=1",
        ],
    )
    for task in ("one-sided-3x3-22-24", "four-sided-5x5-30-38"):
        metrics = run_training(get_task(task), config, tmp_path / task, device="cpu", quiet=True)
        assert metrics["updates"] >= 1
        assert math.isfinite(metrics["batch_loss"])
