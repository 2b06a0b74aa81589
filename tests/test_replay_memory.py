"""The replay memory: a ring, n-step returns, checkpoints."""

from __future__ import annotations

from collections import deque
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.tasks.graph.features import Graph
from learn2assemble.tasks.graph.placements import distinct_placements, locate
from learn2assemble.tasks.learning.config import TrainConfig
from learn2assemble.tasks.learning.replay import Batch, Replay
from learn2assemble.tasks.learning.trainer import Trainer
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.world.blocks import get_action_spec
from learn2assemble.tasks.world.outcomes import Outcomes
from learning_data import RELATIONAL, TINY


def numbered(start: int, worlds: int, graph: Graph, end: set[int]) -> Batch:
    """Transitions that carry their number as reward, and in their first node."""
    number = np.arange(start, start + worlds)
    first, last = graph.take(number % len(graph.num_nodes)), graph.take(0 * number)
    for g, shift in ((first, 0.0), (last, 0.5)):
        g.nodes[:, 0, 0] = number + shift
    return Batch(
        first,
        np.stack([number, number + 1, number + 2], -1),
        number.astype(np.float32),
        np.isin(number, list(end)),
        last,
        np.full(worlds, 0.5, np.float32),
        number % 3 != 0,
    )


@given(
    size=st.integers(4, 12),
    worlds=st.integers(1, 4),
    rounds=st.integers(1, 9),
    steps=st.integers(1, 4),
    end=st.sets(st.integers(0, 35), max_size=8),
)
@settings(max_examples=30, deadline=None)
def test_replay_is_a_ring(size: int, worlds: int, rounds: int, steps: int, end: set[int]) -> None:
    """What comes back is one of the newest ``size`` transitions, whole; n-step by its definition:
    joined with those that followed in its world while these were greedy and nothing ended."""
    simulator = Simulator(TINY)
    graph = simulator.observe(simulator.new(5, np.random.default_rng(0)))
    memory = Replay(size, TINY.num_nodes, worlds=worlds)
    kept: deque[int] = deque(maxlen=size)
    for number in range(rounds):
        memory.add(numbered(number * worlds, worlds, graph, end))
        kept.extend(range(number * worlds, (number + 1) * worlds))
    assert memory.length == len(kept)
    newest = rounds * worlds - 1
    batch = memory.sample(100, np.random.default_rng(0), steps)
    assert {int(a[0]) for a in batch.action} <= set(kept)
    if len(kept) <= 6:
        assert {int(a[0]) for a in batch.action} == set(kept)
    for n in range(100):
        number = int(batch.action[n, 0])
        assert batch.action[n].tolist() == [number, number + 1, number + 2]
        assert batch.greedy[n] == (number % 3 != 0)
        original = graph.take(np.array([number % len(graph.num_nodes)]))
        original.nodes[0, 0, 0] = number
        for field, value in zip(Graph._fields, batch.graph, strict=True):
            np.testing.assert_array_equal(value[n], getattr(original, field)[0], err_msg=field)
        reward, discount, last = float(number), 0.5, number
        for _ in range(steps - 1):
            following = last + worlds
            if last in end or following > newest or following % 3 == 0:
                break
            reward, discount, last = reward + discount * following, discount * 0.5, following
        assert batch.reward[n] == pytest.approx(reward)
        assert batch.discount[n] == pytest.approx(discount)
        assert batch.terminal[n] == (last in end)
        assert batch.next_graph.nodes[n, 0, 0] == last + 0.5


def test_replay_keeps_the_outcome_of_every_placement() -> None:
    """Those of the action taken are what the step brought, in the order of the sampled graph."""
    config = TrainConfig(network=RELATIONAL, num_envs=3, replay_size=50, dense_weight=1.0)
    trainer = Trainer(TINY, config, 0)
    for _ in range(30):
        trainer.collect()
    batch = trainer.replay.sample(200, np.random.default_rng(0))
    assert batch.outcomes is not None
    assert not batch.outcomes.gain.any(), "the gain is not kept"
    placements = distinct_placements(batch.graph, get_action_spec())
    taken = locate(placements, batch.graph, batch.action, get_action_spec())
    assert (taken >= 0).all()
    where = np.arange(200), taken
    np.testing.assert_array_equal(batch.outcomes.reward[where], batch.reward)
    np.testing.assert_array_equal(batch.outcomes.terminal[where], batch.terminal)
    np.testing.assert_array_equal(batch.outcomes.valid[where], batch.reward >= 0)
    assert batch.terminal.any()
    # On a lattice of cubes the rules decide every placement.
    decided = batch.outcomes.valid | batch.outcomes.terminal
    width = placements.used.shape[1]
    assert decided[:, :width][placements.used].all()


def test_replay_without_outcomes_gives_none() -> None:
    trainer = Trainer(TINY, TrainConfig(network=RELATIONAL, num_envs=3, replay_size=50), 0)
    trainer.collect()
    assert trainer.replay.sample(4, np.random.default_rng(0)).outcomes is None
    assert not any(name.startswith("outcome") for name in trainer.replay.arrays)


def some_outcomes(worlds: int, width: int, rng: np.random.Generator) -> Outcomes:
    """Whole numbers, which a short float holds exactly."""
    flags = rng.random((2, worlds, width)) < 0.5
    reward = rng.integers(-1, 5, (worlds, width)).astype(np.float32)
    return Outcomes(reward, flags[0], flags[1], np.zeros_like(reward))


@given(
    size=st.integers(4, 9),
    widths=st.lists(st.sampled_from([1, 30, 64, 65, 200, 300]), min_size=1, max_size=6),
    seed=st.integers(0, 99),
)
@settings(max_examples=25, deadline=None)
def test_arrays_of_outcomes_grow(size: int, widths: list[int], seed: int) -> None:
    """Whatever numbers of placements come in whatever order, also through a checkpoint."""
    simulator, rng = Simulator(TINY), np.random.default_rng(seed)
    graph = simulator.observe(simulator.new(5, rng))
    memory = Replay(size, TINY.num_nodes, worlds=2, outcomes=True)
    kept: dict[int, tuple[Outcomes, int]] = {}
    for number, width in enumerate(widths):
        outcomes = some_outcomes(2, width, rng)
        batch = numbered(2 * number, 2, graph, set())
        memory.add(batch._replace(outcomes=outcomes))
        for row in range(2):
            kept[2 * number + row] = Outcomes(*[field[row] for field in outcomes]), width
        if number == len(widths) // 2:
            arrays = {k: v.copy() for k, v in memory.state().items()}
            other = Replay(size, TINY.num_nodes, worlds=2, outcomes=True)
            other.load(arrays, memory.cursor)
            memory = other
    got = memory.sample(40, np.random.default_rng(0))
    assert got.outcomes is not None
    for n, number in enumerate(got.action[:, 0].tolist()):
        expected, width = kept[number]
        for mine, theirs in zip(got.outcomes[:3], expected[:3], strict=True):
            np.testing.assert_array_equal(mine[n, :width], theirs)


@pytest.mark.parametrize("dense_weight", [0.0, 1.0])
def test_replay_survives_a_checkpoint(dense_weight: float) -> None:
    config = TrainConfig(network=RELATIONAL, num_envs=3, replay_size=20, dense_weight=dense_weight)
    trainer = Trainer(TINY, config, 0)
    for _ in range(11):
        trainer.collect()
    arrays = {k: v.copy() for k, v in trainer.replay.state().items()}
    other = Replay(20, TINY.num_nodes, worlds=3, outcomes=dense_weight > 0)
    other.load(arrays, trainer.replay.cursor)
    a, b = (r.sample(50, np.random.default_rng(1), 3) for r in (trainer.replay, other))
    assert (a.outcomes is None) == (dense_weight == 0)
    for mine, theirs in zip(a, b, strict=True):
        if mine is None:
            assert theirs is None
            continue
        for x, y in zip(cast(Any, mine), cast(Any, theirs), strict=True):
            np.testing.assert_array_equal(x, y)
