"""The replay memory: a ring, checkpoints; mirrored and exchanged transitions."""

from __future__ import annotations

from collections import deque
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.constants import EDGE, HALF
from learn2assemble.tasks.graph.features import Graph, node_offset
from learn2assemble.tasks.graph.placements import distinct_placements, locate
from learn2assemble.tasks.learning.config import TrainConfig
from learn2assemble.tasks.learning.replay import (
    EXCHANGE,
    MIRROR,
    Batch,
    Replay,
    Searched,
    random_symmetry,
)
from learn2assemble.tasks.learning.trainer import Trainer
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.world.blocks import get_action_spec
from learn2assemble.tasks.world.coverage import paper_mask
from learn2assemble.tasks.world.layouts import to_world
from learn2assemble.tasks.world.outcomes import Outcomes
from learn2assemble.tasks.world.rules import count_row, recover_all
from learn2assemble.tasks.world.state import State
from learning_data import RELATIONAL, TASKS, TINY, Recorded, random_actions, rows_of


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
    )


@given(
    size=st.integers(4, 12),
    worlds=st.integers(1, 4),
    rounds=st.integers(1, 9),
    end=st.sets(st.integers(0, 35), max_size=8),
)
@settings(max_examples=30, deadline=None)
def test_replay_is_a_ring(size: int, worlds: int, rounds: int, end: set[int]) -> None:
    """What comes back is one of the newest ``size`` transitions, whole."""
    simulator = Simulator(TINY)
    graph = simulator.observe(simulator.new(5, np.random.default_rng(0)))
    memory = Replay(size, TINY.num_nodes)
    kept: deque[int] = deque(maxlen=size)
    for number in range(rounds):
        memory.add(numbered(number * worlds, worlds, graph, end))
        kept.extend(range(number * worlds, (number + 1) * worlds))
    assert memory.length == len(kept)
    batch = memory.sample(100, np.random.default_rng(0))
    assert {int(a[0]) for a in batch.action} <= set(kept)
    if len(kept) <= 6:
        assert {int(a[0]) for a in batch.action} == set(kept)
    for n in range(100):
        number = int(batch.action[n, 0])
        assert batch.action[n].tolist() == [number, number + 1, number + 2]
        original = graph.take(np.array([number % len(graph.num_nodes)]))
        original.nodes[0, 0, 0] = number
        for field, value in zip(Graph._fields, batch.graph, strict=True):
            np.testing.assert_array_equal(value[n], getattr(original, field)[0], err_msg=field)
        assert (batch.reward[n], batch.discount[n]) == (number, 0.5)
        assert batch.terminal[n] == (number in end)
        assert batch.next_graph.nodes[n, 0, 0] == number + 0.5


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
    memory = Replay(size, TINY.num_nodes, outcomes=True)
    kept: dict[int, tuple[Outcomes, int]] = {}
    for number, width in enumerate(widths):
        outcomes = some_outcomes(2, width, rng)
        batch = numbered(2 * number, 2, graph, set())
        memory.add(batch._replace(outcomes=outcomes))
        for row in range(2):
            kept[2 * number + row] = Outcomes(*[field[row] for field in outcomes]), width
        if number == len(widths) // 2:
            arrays = {k: v.copy() for k, v in memory.state().items()}
            other = Replay(size, TINY.num_nodes, outcomes=True)
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
    other = Replay(20, TINY.num_nodes, outcomes=dense_weight > 0)
    other.load(arrays, trainer.replay.cursor)
    a, b = (r.sample(50, np.random.default_rng(1)) for r in (trainer.replay, other))
    assert (a.outcomes is None) == (dense_weight == 0)
    for mine, theirs in zip(a, b, strict=True):
        if mine is None:
            assert theirs is None
            continue
        for x, y in zip(cast(Any, mine), cast(Any, theirs), strict=True):
            np.testing.assert_array_equal(x, y)


# Mirrored and exchanged transitions are true transitions.


def in_frame(frame: np.ndarray, world: np.ndarray) -> np.ndarray:
    """World points [m] in local coordinates of a side; the inverse of ``to_world``."""
    c, s, tx, ty = frame
    x, y = world[:, 0] - tx, world[:, 1] - ty
    return np.stack([c * x + s * y, c * y - s * x, world[:, 2]], -1)


def image(simulator: Simulator, state: State, mirror: bool, exchange: bool) -> State:
    """The world seen in a mirror: x -> -x and, or, y -> c - y; masks are drawn afresh."""
    frames, out = simulator.frames, state.copy()
    middle = {1: 0.0, 2: EDGE, 4: 2 * EDGE}[len(frames)]
    sign = np.array([-1.0 if mirror else 1.0, -1.0 if exchange else 1.0, 1.0])
    offset = np.array([0.0, middle if exchange else 0.0, 0.0])
    for row in range(state.batch_size):
        found = set()
        for side, frame in enumerate(frames):
            count = int(state.num_vertices[row, side])
            outline = state.vertices[row, side, :count]
            world = to_world(frame, outline[:, 0], np.full(count, -HALF), outline[:, 1])
            world = world * sign + offset
            # The side in whose face plane (y = -HALF) the reflected outline lies.
            seen = [in_frame(f, world) for f in frames]
            other = next(n for n, p in enumerate(seen) if np.allclose(p[:, 1], -HALF))
            local = seen[other][:, [0, 2]]
            found.add(other)
            if local[0, 0] > local[-1, 0]:
                local = local[::-1]
            out.vertices[row, other] = 0
            out.vertices[row, other, :count] = local
            out.num_vertices[row, other] = count
        assert len(found) == len(frames)
        out.mask_pixels[row] = sum(
            paper_mask(out.vertices[row, n], int(out.num_vertices[row, n]), out.mask[row, n])
            for n in range(len(frames))
        )
        lines = np.flatnonzero(out.mask[row].any((0, 2)))
        out.mask_rows[row] = lines[0], lines[-1] + 1
        placed = int(state.num_placed[row])
        out.position[row, :placed] = state.position[row, :placed] * sign + offset
        recover_all(out, row, frames)
        count_row(out, row)
    return out


class Coins:
    """A generator that answers the two coins of :func:`random_symmetry`."""

    def __init__(self, mirror: bool, exchange: bool) -> None:
        self.answers = [0.0 if mirror else 1.0, 0.0 if exchange else 1.0]

    def random(self, size: int) -> np.ndarray:
        return np.full(size, self.answers.pop(0))


@pytest.mark.parametrize("sides", [1, 2, 4])
@pytest.mark.parametrize(("mirror", "exchange"), [(True, False), (False, True), (True, True)])
def test_augmented_transitions_are_true(sides: int, mirror: bool, exchange: bool) -> None:
    """The mirrored world gives the same rewards, ends and successors for the mirrored actions.

    Problems whose masks are not mirrored to the pixel are left out: the roof of a five-sided
    outline is split at a whole column, so a few differ by some pixels.
    """
    data = Recorded(TASKS[sides], 60, 11, 3)
    moved = exchange and sides in (2, 4)
    mirrored = image(data.simulator, data.before, mirror, moved)
    exact = mirrored.mask_pixels == data.before.mask_pixels
    exact &= mirrored.plane_pixels == data.before.plane_pixels
    assert exact.mean() > 0.7
    rows = np.flatnonzero(exact)
    mirrored = mirrored.take(rows)
    mirrored.initial_pixels[:] = data.before.initial_pixels[rows]

    coins = cast(Any, Coins(mirror, exchange))
    got = random_symmetry(data.batch, sides, coins)
    graph = data.simulator.observe(mirrored)
    step = data.simulator.step(mirrored, (got.action - node_offset(got.graph))[rows])
    np.testing.assert_array_equal(got.reward[rows], step.reward.astype(np.float32))
    np.testing.assert_array_equal(got.terminal[rows], step.terminated)
    successors = data.simulator.observe(mirrored)
    for mine, theirs in ((got.graph, graph), (got.next_graph, successors)):
        for n, row in enumerate(rows):
            targets = int(mine.num_targets[row])
            settled = targets + int(mine.num_placed[row])
            assert sorted(rows_of(mine, row, 0, targets)) == sorted(rows_of(theirs, n, 0, targets))
            assert rows_of(mine, row, targets, settled) == rows_of(theirs, n, targets, settled)
    # Waiting blocks stay where they are.
    free = ~(
        np.arange(TASKS[sides].num_nodes)
        < (data.batch.graph.num_targets + data.batch.graph.num_placed)[:, None]
    )
    np.testing.assert_array_equal(got.graph.nodes[free], data.batch.graph.nodes[free])


def test_every_transition_has_its_own_coins() -> None:
    data = Recorded(TASKS[2], 20, 0)
    got = random_symmetry(data.batch, 2, np.random.default_rng(0))
    again = np.random.default_rng(0)
    mirror, exchange = again.random(len(got.reward)) < 0.5, again.random(len(got.reward)) < 0.5
    assert len(set(zip(mirror.tolist(), exchange.tolist(), strict=True))) == 4
    for row in range(len(got.reward)):
        relation = int(data.batch.action[row, 2])
        relation = int(MIRROR[relation]) if mirror[row] else relation
        relation = int(EXCHANGE[relation]) if exchange[row] else relation
        assert got.action[row].tolist() == [*data.batch.action[row, :2].tolist(), relation]


def test_one_sided_structures_are_not_exchanged() -> None:
    data = Recorded(TASKS[1], 8, 0)
    got = random_symmetry(data.batch, 1, cast(Any, Coins(False, True)))
    np.testing.assert_array_equal(got.graph.nodes, data.batch.graph.nodes)
    np.testing.assert_array_equal(got.action, data.batch.action)


def test_symmetry_turns_the_explored_actions_of_a_search() -> None:
    """An explored action turns as the action taken would."""
    data = Recorded(TASKS[2], 30, 0)
    count = len(data.batch.action)
    rng = np.random.default_rng(5)
    explored = np.stack([data.batch.action, random_actions(data.batch.graph, 5, rng)], 1)
    searched = Searched(explored, np.zeros((count, 2), np.float32), np.full(count, 2))
    batch = data.batch._replace(searched=searched)
    got = random_symmetry(batch, 2, np.random.default_rng(0))
    second = batch._replace(action=explored[:, 1])
    other = random_symmetry(second, 2, np.random.default_rng(0))
    assert got.searched is not None
    np.testing.assert_array_equal(got.searched.action[:, 0], got.action)
    np.testing.assert_array_equal(got.searched.action[:, 1], other.action)
    assert (got.action != data.batch.action).any()
    np.testing.assert_array_equal(searched.action, explored, err_msg="the batch given stays")
