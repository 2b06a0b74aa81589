"""Mirrored and exchanged transitions are true transitions."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from learn2assemble.constants import EDGE, HALF
from learn2assemble.tasks.graph.features import node_offset
from learn2assemble.tasks.learning.replay import EXCHANGE, MIRROR, Searched, random_symmetry
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.world.coverage import paper_mask
from learn2assemble.tasks.world.layouts import to_world
from learn2assemble.tasks.world.rules import count_row, recover_all
from learn2assemble.tasks.world.state import State
from learning_data import TASKS, Recorded, random_actions, rows_of


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
