"""Targets and losses written out, and the world inside them."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from learn2assemble.learning.dqn import GAIN_UNIT, dqn_loss, same_cell, successor, td_targets

from learn2assemble.graph.batch import to_tensors
from learn2assemble.graph.features import Graph
from learn2assemble.learning.config import TrainConfig
from learn2assemble.learning.replay import Batch
from learn2assemble.networks.qnetwork import QFactors, QNetwork
from learning_data import HEADS, SMALL, TASKS, TINY, Recorded, network, rows_of


class Fixed:
    """A network that answers the same factors whatever it sees."""

    def __init__(self, factors: QFactors) -> None:
        self.factors = factors

    def __call__(self, graph: Any) -> QFactors:
        return self.factors


def test_td_target_by_hand() -> None:
    """``y = r + gamma (1 - end) Q_T(s', a*)``: two worlds, two relations (protocol 10.3).

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
        graph, np.zeros((2, 3), np.int64), np.array([1.0, -1.0], np.float32),
        np.array([False, True]), graph, np.array([0.8, 0.8], np.float32), np.ones(2, np.bool_),
        None, None, np.zeros(2, np.bool_),
    )  # fmt: skip

    def y(**changes: Any) -> list[float]:
        config = TrainConfig(network=SMALL, **changes)
        online, target = cast(Any, Fixed(mine)), cast(Any, Fixed(theirs))
        return td_targets(online, target, batch, config, "cpu").tolist()

    # The target's own maximum is 4. The online network prefers block 5, relation 1: worth 0.
    assert y(double=False) == pytest.approx([1 + 0.8 * 4, -1.0])
    assert y(double=True) == pytest.approx([1 + 0.8 * 0, -1.0])


class Constant:
    """A generator whose every draw is 0.6, so that a loss can be written out."""

    def random(self, size: Any) -> np.ndarray:
        return np.full(size, 0.6)


def smooth_l1(a: float, b: float) -> float:
    d = abs(a - b)
    return 0.5 * d * d if d < 1 else d - 0.5


def legal_values(values: np.ndarray, graph: Graph, row: int) -> list[tuple[float, tuple]]:
    t, p, n = (int(c[row]) for c in (graph.num_targets, graph.num_placed, graph.num_nodes))
    pairs = ((i, j, k) for i in range(t + p, n) for j in range(t, t + p) for k in range(5))
    return [(float(values[row][a]), a) for a in pairs]


def written_out(online: QNetwork, target: QNetwork, data: Recorded, config: TrainConfig) -> float:
    """The loss by loops over dense Q-values, with the simulator in place of stored numbers."""
    batch, gamma, graph = data.batch, data.task.discount, data.batch.graph
    with torch.no_grad():

        def dense(net: QNetwork, g: Graph, part: str = "values") -> np.ndarray:
            tensors = to_tensors(g)
            return getattr(net, part)(net.embeddings(tensors)).dense().double().numpy()

        q, q_next = dense(online, graph), dense(online, batch.next_graph)
        t_next = dense(target, batch.next_graph)
        rewards = dense(online, graph, "rewards") if config.network.reward_head else None
        gains = dense(online, graph, "gains") if config.network.gain_head else None
        if config.exact_next:
            r_next = dense(online, batch.next_graph, "rewards")
            tr_next = dense(target, batch.next_graph, "rewards")
    count = len(batch.action)
    prospects = data.simulator.prospects(data.before)
    next_prospects = data.simulator.prospects(data.after)
    y = []
    for row in range(count):
        value = 0.0
        if not batch.terminal[row]:
            mine = legal_values(q_next, batch.next_graph, row)
            choice = max(mine)[1]
            if config.exact_next:
                corrected = []
                first = int(batch.next_graph.num_targets[row])
                for j in range(first, first + int(batch.next_graph.num_placed[row])):
                    for k in range(5):
                        pair = []
                        for values, guess in ((q_next, r_next), (t_next, tr_next)):
                            same = [
                                v for v in legal_values(values, batch.next_graph, row)
                                if v[1][1:] == (j, k)
                            ]  # fmt: skip
                            best, a = max(same)
                            where = row, j - first, k
                            if batch.next_known[row] and next_prospects.terminal[where]:
                                best = float(next_prospects.reward[where])
                            elif batch.next_known[row]:
                                known = float(next_prospects.reward[where])
                                best += known - float(guess[row][a])
                            pair.append(best)
                        corrected.append(tuple(pair))
                value = max(corrected)[1]
            elif config.double:
                value = float(t_next[row][choice])
            else:
                value = max(legal_values(t_next, batch.next_graph, row))[0]
        y.append(float(batch.reward[row]) + gamma * value)

    td = np.mean([smooth_l1(q[row][tuple(batch.action[row])], y[row]) for row in range(count)])
    total = 0.0
    for number in range(config.imagined):
        errors = []
        for row in range(count):
            first = int(graph.num_targets[row])
            free = first + int(graph.num_placed[row])
            if number == 0:
                i, j, k = max(legal_values(q, graph, row))[1]
            else:
                i = free + int(0.6 * (int(graph.num_nodes[row]) - free))
                good = np.argwhere(prospects.valid[row])
                j, k = (first + good[0][0], good[0][1]) if len(good) else (first, 0)
            world = data.before.take(np.array([row]))
            outcome = data.simulator.step(world, np.array([[i - free, j - first, k]]))
            goal = float(outcome.reward[0])
            if not outcome.terminated[0]:
                g = data.simulator.observe(world)
                with torch.no_grad():
                    goal += gamma * max(legal_values(dense(target, g), g, 0))[0]
            errors.append(smooth_l1(q[row][i, j, k], goal))
        total += float(np.mean(errors))
    td = (td + total) / (1 + config.imagined)

    shared, invalid, final, reward_errors, gain_errors = [], [], [], [], []
    for row in range(count):
        first, placed = int(graph.num_targets[row]), int(graph.num_placed[row])
        free = first + placed
        block = free + int(0.6 * (int(graph.num_nodes[row]) - free))
        taken = data.after.position[row, placed]
        like = []
        for j in range(placed):
            for k in range(5):
                world = data.before.take(np.array([row]))
                data.simulator.step(world, np.array([[0, j, k]]))
                value = float(q[row][block, first + j, k])
                if np.allclose(world.position[0, placed], taken, atol=1e-6):
                    like.append(smooth_l1(value, y[row]))
                known = float(prospects.reward[row, j, k])
                if prospects.terminal[row, j, k]:
                    valid = bool(prospects.valid[row, j, k])
                    (final if valid else invalid).append(smooth_l1(value, known))
                if rewards is not None:
                    guess = float(rewards[row][block, first + j, k])
                    reward_errors.append(smooth_l1(guess, known))
                if gains is not None:
                    gain = float(prospects.gain[row, j, k]) / GAIN_UNIT
                    gain_errors.append(smooth_l1(float(gains[row][block, first + j, k]), gain))
        shared.append(float(np.mean(like)))
    if config.share_cell:
        td = 0.5 * td + 0.5 * float(np.mean(shared))
    loss = float(td)
    if config.terminal_weight:
        parts = sum(invalid) / max(len(invalid), 1) + sum(final) / max(len(final), count)
        loss += config.terminal_weight * parts
    if config.reward_weight:
        loss += config.reward_weight * float(np.mean(reward_errors))
    if config.gain_weight:
        loss += config.gain_weight * float(np.mean(gain_errors))
    return loss


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"double": False},
        {"share_cell": True},
        {"terminal_weight": 0.7},
        {"reward_weight": 2.0, "network": HEADS},
        {"gain_weight": 0.5, "network": HEADS},
        {"imagined": 1},
        {"imagined": 3, "share_cell": True},
        {"exact_next": True, "network": HEADS},
        {"exact_next": True, "network": HEADS, "share_cell": True, "terminal_weight": 1.0,
         "reward_weight": 1.0, "gain_weight": 1.0, "imagined": 2},
    ],
    ids=str,
)  # fmt: skip
@pytest.mark.parametrize("steps", [1, 3])
def test_loss_written_out(changes: dict[str, Any], steps: int) -> None:
    """Every option of the loss against loops over dense Q-values and simulated placements."""
    config = TrainConfig(**{"network": SMALL, **changes})
    data = Recorded(TINY, 8, 3 + steps, steps)
    online, target = network(0, config.network), network(1, config.network)
    # Large enough that both branches of the smooth L1 are met.
    with torch.no_grad():
        for net in (online, target):
            net.readout.weight.mul_(6)
    loss, logs = dqn_loss(
        online, target, data.batch, config, TINY.discount, cast(Any, Constant()), "cpu"
    )
    expected = written_out(online, target, data, config)
    assert float(loss.detach()) == pytest.approx(expected, rel=1e-4, abs=1e-5)
    assert logs["loss"] == pytest.approx(expected, rel=1e-4, abs=1e-5)
    assert data.batch.terminal.any(), "some targets must be without a bootstrap"
    assert not data.batch.terminal.all()
    loss.backward()
    assert all(p.grad is None for p in target.parameters())


@given(seed=st.integers(0, 10_000), sides=st.sampled_from([1, 2, 4]), steps=st.integers(0, 4))
@settings(max_examples=25, deadline=None)
def test_successor_is_what_the_simulator_observes(seed: int, sides: int, steps: int) -> None:
    """Targets and placed blocks in the same order, unplaced ones as a multiset (protocol 4)."""
    data = Recorded(TASKS[sides], 6, seed, steps)
    mine, theirs = successor(data.batch.graph, data.batch.action), data.batch.next_graph
    np.testing.assert_array_equal(mine.num_targets, theirs.num_targets)
    np.testing.assert_array_equal(mine.num_placed, theirs.num_placed)
    np.testing.assert_array_equal(mine.num_nodes, theirs.num_nodes)
    for row in range(len(mine.num_nodes)):
        settled = int(mine.num_targets[row] + mine.num_placed[row])
        used = int(mine.num_nodes[row])
        assert rows_of(mine, row, 0, settled) == rows_of(theirs, row, 0, settled)
        left, right = rows_of(mine, row, settled, used), rows_of(theirs, row, settled, used)
        assert sorted(left) == sorted(right)
        assert not mine.nodes[row, used:].any()


@given(seed=st.integers(0, 10_000), sides=st.sampled_from([1, 2, 4]), steps=st.integers(0, 6))
@settings(max_examples=20, deadline=None)
def test_same_cell_is_where_the_simulator_puts_it(seed: int, sides: int, steps: int) -> None:
    data = Recorded(TASKS[sides], 4, seed, steps)
    blocks = data.task.max_blocks
    got = same_cell(data.batch, blocks)
    for row in range(len(got)):
        placed = int(data.before.num_placed[row])
        taken = data.after.position[row, placed]
        for j in range(blocks):
            for k in range(5):
                expected = False
                if j < placed:
                    world = data.before.take(np.array([row]))
                    data.simulator.step(world, np.array([[0, j, k]]))
                    expected = np.allclose(world.position[0, placed], taken, atol=1e-6)
                assert got[row, j, k] == expected
    assert got.any((1, 2)).all(), "the action itself counts"
