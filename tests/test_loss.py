"""Targets and losses written out, and the world inside them."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest
import torch

from learn2assemble.tasks.graph.batch import to_tensors
from learn2assemble.tasks.graph.features import Graph, node_offset
from learn2assemble.tasks.learning.config import TrainConfig
from learn2assemble.tasks.learning.replay import Batch
from learn2assemble.tasks.learning.trainer import dense_error, q_loss, td_targets
from learn2assemble.tasks.networks.agent import Network
from learn2assemble.tasks.networks.placement import PlacementValues
from learn2assemble.tasks.networks.qnetwork import NEGATIVE, QFactors
from learn2assemble.tasks.world.outcomes import Outcomes
from learning_data import RELATIONAL, SMALL, TASKS, TINY, Recorded, network


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
        np.ones(2, np.bool_),
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
