"""The search over real worlds: enumeration of three blocks, copies, cells."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from learn2assemble.tasks.networks.agent import make_network
from learn2assemble.tasks.networks.config import NetworkConfig
from learn2assemble.tasks.networks.qnetwork import QNetwork
from learn2assemble.tasks.search.config import TO_THE_END, SearchConfig
from learn2assemble.tasks.search.mcts import search
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import Task
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import WorldModel
from learning_data import advance

torch.set_num_threads(1)


TINY = Task("tiny", num_sides=1, grid=2, num_nodes=8)
"""Up to five blocks; rows with exactly three are picked below."""


def three_block_worlds(count: int) -> tuple[WorldModel, State]:
    simulator = Simulator(TINY)
    state = simulator.new(200, np.random.default_rng(5))
    # Worlds with a rewarding structure: more than the first block is needed.
    rows = np.flatnonzero(state.num_blocks == 3)[:count]
    assert len(rows) == count
    torch.manual_seed(1)
    network = QNetwork(NetworkConfig(width=16, heads=2, rounds=1, position_scale=0.1))
    return WorldModel(simulator, network), state.take(rows)


def enumerate_world(
    model: WorldModel, state: State, rollout: int
) -> dict[tuple[int, ...], tuple[float, int]]:
    """Mean return and visits of every root action when the whole tree is searched, prior off.

    Written out for three blocks, of which the first is placed: two placements, then the end.
    """
    simulator, gamma = model.simulator, model.discount
    out = {}
    for i, j, k in np.ndindex(2, 1, 5):
        after = state.copy()
        first = simulator.step(after, np.array([[i, j, k]]))
        returns = []
        if first.terminated[0]:
            returns.append(first.reward[0])
        else:
            second = []
            for j2, k2 in np.ndindex(2, 5):
                last = simulator.step(after.copy(), np.array([[0, j2, k2]]))
                assert last.terminated[0]
                second.append(float(last.reward[0]))
            q = model.action_values(after)[0].values
            estimate = q.max() if rollout == 1 else second[int(np.argmax(q))]
            returns.append(first.reward[0] + gamma * estimate)
            returns += [first.reward[0] + gamma * r for r in second]
        out[(i, j, k)] = (float(np.mean(returns)), len(returns))
    return out


@pytest.mark.parametrize("rollout", [1, 2, TO_THE_END])
def test_three_blocks_against_enumeration(rollout: int) -> None:
    """The whole tree of a real problem: visits, means and the choice; the world is untouched."""
    model, states = three_block_worlds(6)
    before = states.copy()
    config = SearchConfig(budget=1000, epsilon=0.0, rollout=rollout, prior=False)
    decisions = search(model, states, config, np.random.default_rng(0))
    for mine, theirs in zip(states, before, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    going = 0
    for row, decision in enumerate(decisions):
        expected = enumerate_world(model, states.take(np.array([row])), rollout)
        got = {tuple(a.tolist()): (v, n) for a, v, n in decision.explored()}
        assert {a: n for a, (_, n) in got.items()} == {a: n for a, (_, n) in expected.items()}
        for action, (value, _) in expected.items():
            assert got[action][0] == pytest.approx(value, abs=1e-5)
        best = max(value for value, _ in expected.values())
        assert expected[tuple(decision.action.tolist())][0] == pytest.approx(best, abs=1e-5)
        going += sum(n > 1 for _, n in expected.values())
    assert going > 10, "the problems must not end at once"


def test_world_model_values_are_the_networks() -> None:
    """Local actions in order of (block, reference, relation), and ``best`` is their maximum."""
    model, states = three_block_worlds(4)
    value, action = model.best(states)
    for row, legal in enumerate(model.action_values(states)):
        assert legal.actions.tolist() == [[i, 0, k] for i in range(2) for k in range(5)]
        assert value[row] == pytest.approx(legal.values.max(), abs=1e-5)
        place = legal.actions.tolist().index(action[row].tolist())
        assert legal.values[place] == pytest.approx(value[row], abs=1e-5)


def test_world_model_steps_copies() -> None:
    model, states = three_block_worlds(4)
    before = states.copy()
    result = model.step(states, np.tile([0, 0, 1], (4, 1)))
    for mine, theirs in zip(states, before, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert (result.states.num_placed == 2).all()
    both = model.join([states, result.states])
    assert both.num_placed.tolist() == [1] * 4 + [2] * 4
    taken = model.take(states, np.array([0, 0]))
    taken.position[:] = 9.0
    np.testing.assert_array_equal(states.position, before.position)


def test_groups_are_structures() -> None:
    """Two actions share a group exactly where the simulator puts the block into the same cell."""
    simulator, rng = (
        Simulator(Task("two", num_sides=2, grid=3, num_nodes=20)),
        np.random.default_rng(0),
    )
    state = simulator.new(12, rng)
    for relation in (1, 0, 4):
        # Left of the first block, on top of it, behind it: all stand.
        simulator.step(state, np.tile([0, 0, relation], (12, 1)))
    state = state.take(np.flatnonzero(~state.terminated & (state.num_placed == 4))[:3])
    assert state.batch_size == 3
    torch.manual_seed(0)
    model = WorldModel(simulator, QNetwork(NetworkConfig(width=16, heads=2, rounds=1)))
    for row, legal in enumerate(model.action_values(state)):
        many = state.take(np.full(len(legal.values), row))
        simulator.step(many, legal.actions)
        cells = [tuple(np.round(p, 4).tolist()) for p in many.position[:, 4]]
        assert len(set(legal.group.tolist())) == len(set(cells)) < 20
        assert len(set(zip(legal.group.tolist(), cells, strict=True))) == len(set(cells))


def walls(task: Task, count: int = 60, placements: int = 3) -> tuple[WorldModel, State]:
    """Worlds after some random valid placements."""
    simulator, rng = Simulator(task), np.random.default_rng(1)
    state = advance(simulator, simulator.new(count, rng), placements, rng)
    torch.manual_seed(0)
    return WorldModel(simulator, QNetwork(NetworkConfig(width=16, heads=2, rounds=1))), state


def test_parts_of_a_forward_pass_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    """More graphs than one part holds give the values of a single pass."""
    model, state = walls(TINY.replace(num_sides=2, num_nodes=20, grid=3), 30)
    whole = [model.best(state)[0], *[v.values for v in model.action_values(state)]]
    monkeypatch.setattr("learn2assemble.tasks.world_model.PART", 7)
    parts = [model.best(state)[0], *[v.values for v in model.action_values(state)]]
    for mine, theirs in zip(whole, parts, strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-5)


@pytest.mark.parametrize("encoder", ["attention", "relational"])
def test_values_are_kept(encoder: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Graphs that were valued are not valued again, unless the network learns or they are many."""
    world, state = walls(TINY.replace(num_sides=2, num_nodes=20, grid=3), 30)
    simulator = world.simulator
    network = make_network(NetworkConfig(width=16, heads=2, rounds=1, encoder=encoder))
    calls: list[int] = []
    network.register_forward_pre_hook(lambda _, given: calls.append(len(given[0].nodes)))

    def values(model: WorldModel, rows: list[int]) -> np.ndarray:
        found = model.action_values(state.take(np.array(rows)))
        return np.concatenate([v.values for v in found])

    def fresh(rows: list[int]) -> np.ndarray:
        return values(WorldModel(simulator, network), rows)

    model = WorldModel(simulator, network.eval())
    model.best(state.take(np.arange(20)))
    expected = fresh([3, 25, 19])
    calls.clear()
    np.testing.assert_allclose(values(model, [3, 25, 19]), expected, atol=1e-5)
    np.testing.assert_allclose(values(model, [3, 25, 19]), expected, atol=1e-5)
    assert calls == [1], "only the one that is new"
    monkeypatch.setattr("learn2assemble.tasks.world_model.MEMORY", 2)
    values(model, [25])
    values(model, [25, 3])
    assert calls == [1, 1], "the latest are kept"
    network.train()
    values(model, [3])
    with torch.no_grad():
        for weight in network.parameters():
            weight += 0.1
    np.testing.assert_allclose(values(model, [3]), fresh([3]), atol=1e-5)


def test_legal_and_random_actions() -> None:
    model, state = walls(TINY.replace(num_sides=2, num_nodes=20, grid=3), 6)
    for mine, theirs in zip(model.legal(state), model.action_values(state), strict=True):
        np.testing.assert_array_equal(mine.actions, theirs.actions)
        np.testing.assert_array_equal(mine.group, theirs.group)
        assert not mine.values.any()
    many = state.take(np.zeros(3000, np.int64))
    drawn = model.random_actions(many, np.random.default_rng(0))
    counts = (int(state.num_unplaced[0]), int(state.num_placed[0]), 5)
    for column, size in zip(drawn.T, counts, strict=True):
        found = np.bincount(column, minlength=size)
        assert len(found) == size
        assert (np.abs(found - 3000 / size) < 5 * (3000 / size) ** 0.5).all()
