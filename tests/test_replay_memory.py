"""The replay memory: a ring, n-step returns, checkpoints."""

from __future__ import annotations

from collections import deque
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.graph.features import Graph
from learn2assemble.learning.config import TrainConfig
from learn2assemble.learning.replay import Batch, Replay
from learn2assemble.learning.trainer import Trainer
from learn2assemble.simulator import Simulator
from learning_data import SMALL, TINY


def numbered(start: int, worlds: int, graph: Graph, prospects: Any, end: set[int]) -> Batch:
    """Transitions that carry their number as reward, and in their first node."""
    number = np.arange(start, start + worlds)
    first, last = graph.take(number % len(graph.num_nodes)), graph.take(0 * number)
    for g, shift in ((first, 0.0), (last, 0.5)):
        g.nodes[:, 0, 0] = number + shift
    return Batch(
        first, np.stack([number, number + 1, number + 2], -1), number.astype(np.float32),
        np.isin(number, list(end)), last, np.full(worlds, 0.5, np.float32), number % 3 != 0,
        prospects, None, np.zeros(worlds, np.bool_),
    )  # fmt: skip


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
    memory = Replay(size, TINY.num_nodes, TINY.max_blocks, 5, worlds=worlds, prospects=False)
    kept: deque[int] = deque(maxlen=size)
    for number in range(rounds):
        memory.add(numbered(number * worlds, worlds, graph, None, end))
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


def test_replay_keeps_prospects_of_this_state_and_the_next() -> None:
    config = TrainConfig(network=SMALL, num_envs=3, replay_size=50, terminal_weight=1.0)
    trainer = Trainer(TINY, config, 0)
    for _ in range(30):
        trainer.collect()
    batch = trainer.replay.sample(200, np.random.default_rng(0))
    assert batch.prospects is not None
    assert batch.next_prospects is not None
    rows, references = np.arange(200), batch.action[:, 1] - batch.graph.num_targets
    where = rows, references, batch.action[:, 2]
    np.testing.assert_array_equal(batch.prospects.reward[where], batch.reward)
    np.testing.assert_array_equal(batch.prospects.terminal[where], batch.terminal)
    known = batch.next_known
    assert known.any()
    assert not (known & batch.terminal).any()
    # Of a known successor, exactly the placed references have prospects.
    placed = batch.next_graph.num_placed
    used = np.arange(TINY.max_blocks) < placed[:, None]
    outcome = batch.next_prospects.valid | batch.next_prospects.terminal
    assert not outcome[known][~used[known]].any()
    assert outcome[known].any(2).sum(1).tolist() == [
        int(outcome[n][: placed[n]].any(1).sum()) for n in np.flatnonzero(known)
    ]


def test_replay_survives_a_checkpoint() -> None:
    trainer = Trainer(TINY, TrainConfig(network=SMALL, num_envs=3, replay_size=20, imagined=1), 0)
    for _ in range(11):
        trainer.collect()
    arrays = {k: v.copy() for k, v in trainer.replay.state().items()}
    other = Replay(20, TINY.num_nodes, TINY.max_blocks, 5, worlds=3, prospects=True)
    other.load(arrays, trainer.replay.cursor)
    a, b = (r.sample(50, np.random.default_rng(1), 3) for r in (trainer.replay, other))
    for mine, theirs in zip(a[:-1], b[:-1], strict=True):
        for x, y in zip(cast(Any, mine), cast(Any, theirs), strict=True):
            np.testing.assert_array_equal(x, y)
