"""Every learner: the search term, what is stored, a tiny task solved.

Targets and losses written out, and the world inside them.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch

from learn2assemble.tasks.evaluation.episodes import make_policy, random_policy, run_episodes
from learn2assemble.tasks.graph.batch import to_tensors
from learn2assemble.tasks.graph.features import Graph, node_offset
from learn2assemble.tasks.learning.config import CONFIGS, TrainConfig, override
from learn2assemble.tasks.learning.replay import Batch, Searched
from learn2assemble.tasks.learning.run import run_training
from learn2assemble.tasks.learning.trainer import (
    Trainer,
    dense_error,
    q_loss,
    search_cross_entropy,
    td_targets,
)
from learn2assemble.tasks.networks.agent import Network
from learn2assemble.tasks.networks.config import NetworkConfig
from learn2assemble.tasks.networks.placement import PlacementValues
from learn2assemble.tasks.networks.qnetwork import NEGATIVE, QFactors
from learn2assemble.tasks.search.config import training_search
from learn2assemble.tasks.search.mcts import search
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import get_task
from learn2assemble.tasks.world.outcomes import Outcomes
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import WorldModel
from learning_data import RELATIONAL, SMALL, TASKS, TINY, Recorded, look_ahead, network


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
            value = score(make_policy(TINY, trainer.online.eval(), None, 0.0))
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


class Fixed:
    """A network that answers the same factors for the first graphs, whatever it sees."""

    def __init__(self, factors: QFactors) -> None:
        self.factors = factors

    def __call__(self, graph: Any) -> QFactors:
        return QFactors(*[field[: len(graph.nodes)] for field in self.factors])


def test_td_target_by_hand() -> None:
    """``y = r + gamma (1 - end) Q_T(s', a*)``: two worlds, two relations.

    Three targets, one placed (node 3), two unplaced blocks (nodes 4 and 5). The reference and the
    context terms are 0 but for an illegal reference that would win if it were allowed.
    """
    nodes = np.zeros((2, 6, 5), np.float32)
    graph = Graph(
        nodes, np.zeros((2, 6), np.int32), np.array([3, 3]), np.array([1, 1]), np.array([6, 6])
    )
    block = torch.zeros(2, 6, 2)
    block[:, 4] = torch.tensor([1.0, 2.0])
    block[:, 5] = torch.tensor([4.0, 0.0])
    reference = torch.zeros(2, 6, 2)
    reference[:, 0] = 100.0
    theirs = QFactors(block, reference, torch.zeros(2, 2))
    mine = QFactors(block.flip(2), reference, torch.zeros(2, 2))
    batch = Batch(
        graph,
        np.zeros((2, 3), np.int64),
        np.array([1.0, -1.0], np.float32),
        np.array([False, True]),
        graph,
        np.array([0.8, 0.8], np.float32),
    )

    def y(**changes: Any) -> list[float]:
        config = TrainConfig(network=SMALL, **changes)
        online, target = cast(Any, Fixed(mine)), cast(Any, Fixed(theirs))
        return td_targets(online, target, batch, config, "cpu").tolist()

    # The target's own maximum is 4. The online network prefers block 5, relation 1: worth 0.
    assert y(double=False) == pytest.approx([1 + 0.8 * 4, -1.0])
    assert y(double=True) == pytest.approx([1 + 0.8 * 0, -1.0])


def smooth_l1(a: float, b: float) -> float:
    d = abs(a - b)
    return 0.5 * d * d if d < 1 else d - 0.5


def legal_values(net: Network, graph: Graph, row: int) -> dict[tuple[int, int, int], float]:
    """Q of every legal action of a row, asked for one by one."""
    t, p, n = (int(c[row]) for c in (graph.num_targets, graph.num_placed, graph.num_nodes))
    k = net.config.num_actions
    actions = [(i, j, a) for i in range(t + p, n) for j in range(t, t + p) for a in range(k)]
    tensors = to_tensors(graph.take(np.full(len(actions), row)))
    with torch.no_grad():
        q = net(tensors).select(torch.tensor(actions))
    return dict(zip(actions, q.tolist(), strict=True))


def best(values: dict[tuple[int, int, int], float]) -> tuple[int, int, int]:
    return max(values, key=values.__getitem__)


def written_out(online: Network, target: Network, data: Recorded, config: TrainConfig) -> float:
    """The loss by loops over legal actions, with the simulator in place of stored numbers."""
    batch, gamma, graph = data.batch, data.task.discount, data.batch.graph
    count = len(batch.action)
    q = [legal_values(online, graph, row) for row in range(count)]
    td = 0.0
    for row in range(count):
        value = 0.0
        if not batch.terminal[row]:
            theirs = legal_values(target, batch.next_graph, row)
            mine = legal_values(online, batch.next_graph, row)
            value = theirs[best(mine)] if config.double else max(theirs.values())
        y = float(batch.reward[row]) + gamma * value
        td += smooth_l1(q[row][tuple(batch.action[row].tolist())], y) / count
    if not config.dense_weight:
        return td

    with torch.no_grad():
        values = online(to_tensors(graph))
    assert isinstance(values, PlacementValues)
    rewards, invalid, final = [], [], []
    for row in range(count):
        structures = set()
        placed, local = int(data.before.num_placed[row]), node_offset(graph)[row]
        for action, value in q[row].items():
            world = data.before.take(np.array([row]))
            step = data.simulator.step(world, np.array([action]) - local)
            cells = np.round(world.position[0, placed : world.num_placed[0]], 4)
            structure = frozenset(map(tuple, cells.tolist()))
            if structure in structures:
                continue
            structures.add(structure)
            known = float(step.reward[0])
            number = values.cells.locate(torch.tensor([action]).expand(count, 3))[row]
            rewards.append(smooth_l1(float(values.reward[row, number]), known))
            if step.terminated[0]:
                (invalid if step.verdict[0] else final).append(smooth_l1(value, known))
    dense = float(np.mean(rewards)) + sum(invalid) / max(len(invalid), 1)
    dense += sum(final) / max(len(final), count)
    return td + config.dense_weight * dense


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"double": False},
        {"network": RELATIONAL},
        {"network": RELATIONAL, "double": False, "dense_weight": 1.0},
        {"network": RELATIONAL, "dense_weight": 0.3},
    ],
    ids=["published", "plain", "own, no labels", "own, plain", "own"],
)
@pytest.mark.parametrize("steps", [1, 3])
def test_loss_written_out(changes: dict[str, Any], steps: int) -> None:
    """Every option of the loss against loops over actions and simulated placements."""
    config = TrainConfig(**{"network": SMALL, **changes})
    data = Recorded(TINY, 12, 3 + steps, steps)
    online, target = network(0, config.network), network(1, config.network)
    # Large enough that both branches of the smooth L1 are met.
    with torch.no_grad():
        for net in (online, target):
            for parameter in net.readout.parameters():
                parameter.mul_(6)
    loss, logs = q_loss(online, target, data.batch, config, "cpu")
    expected = written_out(online, target, data, config)
    assert float(loss.detach()) == pytest.approx(expected, rel=1e-4, abs=1e-5)
    assert logs["loss"] == pytest.approx(expected, rel=1e-4, abs=1e-5)
    assert ("final" in logs) == (config.dense_weight > 0)
    assert data.batch.terminal.any(), "some targets must be without a bootstrap"
    assert not data.batch.terminal.all()
    loss.backward()
    assert all(p.grad is None for p in target.parameters())


def test_dense_loss_written_out_on_two_sides() -> None:
    """Rows with different numbers of placements."""
    config = TrainConfig(network=RELATIONAL, dense_weight=0.7)
    data = Recorded(TASKS[2], 5, 1, 3)
    assert len(set(data.placements.count.tolist())) > 1
    online, target = network(0, RELATIONAL), network(1, RELATIONAL)
    loss, _ = q_loss(online, target, data.batch, config, "cpu")
    expected = written_out(online, target, data, config)
    assert float(loss.detach()) == pytest.approx(expected, rel=1e-4, abs=1e-5)


class Legal:
    """The only part of the cells that :func:`dense_error` looks at."""

    def __init__(self, *rows: list[int]) -> None:
        self.legal = torch.tensor(rows, dtype=torch.bool)


def test_dense_error_by_hand() -> None:
    """Two states with three and two placements; memory holds a fourth column of another state."""
    q = torch.tensor([[0.5, -3.0, 1.0], [0.0, 2.0, NEGATIVE]], requires_grad=True)
    reward = torch.tensor([[1.0, 0.0, 0.0], [0.5, 3.0, NEGATIVE]], requires_grad=True)
    cells = cast(Any, Legal([1, 1, 1], [1, 1, 0]))
    outcomes = Outcomes(
        np.array([[1, -1, 0, 7], [0, 1, 9, 9]], np.float32),
        np.array([[0, 1, 0, 1], [0, 1, 1, 1]], np.bool_),  # terminal
        np.array([[1, 0, 0, 1], [1, 1, 1, 0]], np.bool_),  # valid; (0, 2) is undecided
        np.zeros((2, 4), np.float32),
    )
    error, parts = dense_error(PlacementValues(q, reward, cells), outcomes)
    # Rewards: |1-1|, |0+1|, (undecided), |0.5-0|, |3-1|: smooth L1 0, 0.5, 0.125, 1.5.
    assert parts["reward"] == pytest.approx((0 + 0.5 + 0.125 + 1.5) / 4)
    # Q where invalid: |-3+1| of one placement.
    assert parts["invalid"] == pytest.approx(1.5)
    # Q where valid and final: |2-1| of one placement, over the two states.
    assert parts["final"] == pytest.approx(0.5 / 2)
    assert float(error.detach()) == pytest.approx(sum(parts.values()))
    error.backward()
    assert q.grad is not None
    assert reward.grad is not None
    np.testing.assert_allclose(q.grad, [[0, -1, 0], [0, 0.5, 0]])
    np.testing.assert_allclose(reward.grad, [[0, 0.25, 0], [0.125, 0.25, 0]])


def test_dense_error_without_a_label_is_zero() -> None:
    """Nothing invalid, nothing final, nothing known: no NaN, no gradient."""
    q = torch.zeros(1, 2, requires_grad=True)
    nothing = np.zeros((1, 2), np.bool_)
    outcomes = Outcomes(np.zeros((1, 2), np.float32), nothing, nothing, np.zeros((1, 2)))
    error, _ = dense_error(PlacementValues(q, q + 1, cast(Any, Legal([1, 1]))), outcomes)
    error.backward()
    assert float(error.detach()) == 0
    assert q.grad is not None
    assert not q.grad.any()
