"""The transition of the world: placements, coverage, rewards, ends, snapshots."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.constants import EDGE, HALF
from learn2assemble.tasks.graph.features import graph_row
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import PRESETS, Task, get_task
from learn2assemble.tasks.world.blocks import DIRECTIONS, RELATIONS
from learn2assemble.tasks.world.coverage import IMAGE_SIZE, ROWS
from learn2assemble.tasks.world.layouts import side_frames
from learn2assemble.tasks.world.rules import (
    DISCRETE,
    SCALED,
    count_row,
    cover_block,
    move_block,
    recover_all,
    reward_and_end,
    reward_and_success,
    target_cell,
)
from learn2assemble.tasks.world.state import State, empty_state
from learning_data import from_pixels

SEEDS = st.integers(0, 2**32 - 1)
SMALL = get_task("two-sided-3x3-20-24")
TASKS = [
    *PRESETS.values(),
    SMALL.replace(name="scaled", reward="scaled"),
    SMALL.replace(name="easy", reward="scaled", success_threshold=0.2),
]
CUBES = [task for task in TASKS if task.objects == "cubes"]
some_task = st.sampled_from(TASKS)
SIMULATORS = {task.name: Simulator(task) for task in TASKS}


def same(a: State, b: State) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def played(task: Task, batch: int, rng: np.random.Generator, steps: int) -> State:
    """States some way into an episode; mostly good placements, so that rows stay alive."""
    sim = SIMULATORS[task.name]
    state = sim.new(batch, rng)
    for _ in range(steps):
        good = sim.physics_mask(state)
        actions = np.zeros((batch, 3), np.int64)
        for row in range(batch):
            choice = rng.choice(np.argwhere(good[row]))
            # Without a block in the choice, any may go.
            actions[row] = [rng.integers(state.num_unplaced[row]), *choice][-3:]
        before = state.copy()
        ended = np.flatnonzero(sim.step(state, actions).terminated)
        state.put(ended, before.take(ended))
    return state


def random_actions(task: Task, state: State, rng: np.random.Generator) -> np.ndarray:
    spec = np.full(state.batch_size, task.num_actions)
    limits = np.stack([state.num_unplaced, state.num_placed, spec], -1)
    return rng.integers(np.maximum(limits, 1))


# ---------------------------------------------------------------- placements


def test_relations_point_where_their_names_say() -> None:
    state = empty_state(1, 1, 3, 2)
    state.position[0, 0] = 0.1, 0.2, 0.3
    wanted = {
        "top": (0, 0, 1),
        "left": (-1, 0, 0),
        "right": (1, 0, 0),
        "front": (0, -1, 0),
        "behind": (0, 1, 0),
    }
    assert tuple(wanted) == RELATIONS
    for relation, name in enumerate(RELATIONS):
        cell = target_cell(state, 0, 0, relation)
        assert cell == pytest.approx(state.position[0, 0] + EDGE * np.array(wanted[name]))


@given(angle=st.floats(-3.2, 3.2), axis=st.sampled_from(range(3)), relation=st.integers(0, 4))
@settings(deadline=None)
def test_target_cell_is_in_the_frame_of_the_reference(
    angle: float, axis: int, relation: int
) -> None:
    state = empty_state(1, 1, 3, 2)
    state.position[0, 0] = 0.1, -0.2, 0.3
    state.quaternion[0, 0] = 0.0
    state.quaternion[0, 0, 0] = np.cos(angle / 2)
    state.quaternion[0, 0, 1 + axis] = np.sin(angle / 2)
    matrix = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[[i, i, j, j], [i, j, i, j]] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
    expected = state.position[0, 0] + EDGE * matrix @ DIRECTIONS[relation]
    assert target_cell(state, 0, 0, relation) == pytest.approx(expected, abs=1e-12)


@given(seed=SEEDS, blocks=st.integers(2, 12), data=st.data())
@settings(deadline=None, max_examples=50)
def test_moving_a_block_is_list_surgery(seed: int, blocks: int, data: st.DataObject) -> None:
    """A node leaves the unplaced group and becomes the last placed one; the others shift."""
    rng = np.random.default_rng(seed)
    state = empty_state(2, 1, 3, blocks + 1)
    state.position[:] = rng.normal(size=state.position.shape)
    state.quaternion[:] = rng.normal(size=state.quaternion.shape)
    state.object_id[:] = rng.permutation(blocks + 1)
    placed = data.draw(st.integers(1, blocks - 1))
    state.num_placed[:], state.num_blocks[:] = placed, blocks
    pairs = list(zip(state.object_id[0].tolist(), state.position[0].tolist(), strict=True))
    chosen = data.draw(st.integers(0, blocks - placed - 1))
    reference = data.draw(st.integers(0, placed - 1))
    before = state.copy()
    move_block(state, 0, chosen, reference, 1.0, 2.0, 3.0)
    moved, _ = pairs.pop(placed + chosen)
    pairs.insert(placed, (moved, [1.0, 2.0, 3.0]))
    assert state.object_id[0].tolist() == [number for number, _ in pairs]
    assert state.position[0].tolist() == [position for _, position in pairs]
    assert state.num_placed.tolist() == [placed + 1, placed]
    assert np.array_equal(state.quaternion[0, placed], before.quaternion[0, reference])
    assert np.array_equal(state.quaternion[0, :placed], before.quaternion[0, :placed])
    assert same(state.take(np.array([1])), before.take(np.array([1])))


def test_nodes_come_targets_first_then_placed_then_unplaced() -> None:
    sim = Simulator(SMALL)
    state = sim.new(1, np.random.default_rng(5))
    waiting = state.position[0, 1:].copy()
    sim.step(state, np.array([[3, 0, RELATIONS.index("top")]]))
    all_nodes, counts = np.zeros((1, 30, 5)), np.zeros((3, 1), np.int64)
    graph_row(state, 0, sim.frames, all_nodes, np.zeros((1, 30), np.int64), counts)
    nodes, targets = all_nodes[0], int(state.num_targets[0])
    assert counts[:, 0].tolist() == [targets, 2, 30]
    flags = [(1, 1)] * targets + [(1, -1)] * 2 + [(-1, -1)] * (28 - targets)
    assert nodes[:, 3:].tolist() == [list(map(float, flag)) for flag in flags]
    first = int(state.num_vertices[0, 0])
    assert nodes[:first, [0, 2]].tolist() == state.vertices[0, 0, :first].tolist()
    assert (nodes[:first, 1] == -HALF).all()
    # The second wall is the first one turned by 180 degrees and moved back by one block.
    second = state.vertices[0, 1, : targets - first]
    assert nodes[first:targets, [0, 2]] == pytest.approx(second * [-1, 1])
    assert nodes[first:targets, 1] == pytest.approx(EDGE + HALF)
    start = state.position[0, 0]
    assert nodes[targets : targets + 2, :3] == pytest.approx(
        start + np.array([[0, 0, 0], [0, 0, EDGE]]), abs=1e-12
    )
    left = np.delete(waiting, 3, 0)[: 28 - targets]
    assert nodes[targets + 2 :, :3].tolist() == left.tolist()


# ---------------------------------------------------------------- coverage


@given(
    sides=st.integers(1, 4),
    cells=st.lists(
        st.tuples(st.integers(-3, 3), st.integers(-2, 4), st.integers(0, 6)), max_size=12
    ),
)
@settings(deadline=None, max_examples=50)
def test_recomputed_cover_is_the_incremental_one(
    sides: int, cells: list[tuple[int, int, int]]
) -> None:
    frames = side_frames(sides)
    state = empty_state(2, sides, 3, len(cells) + 1)
    state.mask[:] = from_pixels(np.ones((ROWS, IMAGE_SIZE), bool))
    state.mask_rows[:] = 0, ROWS
    recover_all(state, 0, frames)
    for k, cell in enumerate(cells):
        state.position[0, k] = EDGE * np.array(cell) + [0, 0, HALF]
        state.num_placed[0] = k + 1
        cover_block(state, 0, frames, k)
    state.put(np.array([1]), state.take(np.array([0])))
    state.covered[1] = state.occluded[1] = np.uint64(2**64 - 1)  # stale sets must not survive
    recover_all(state, 1, frames)
    assert np.array_equal(state.covered[0], state.covered[1])
    assert np.array_equal(state.occluded[0], state.occluded[1])
    for row in range(2):
        count_row(state, row)
    assert state.plane_pixels[0] == state.plane_pixels[1]
    counted = np.bitwise_count(state.mask[0] & state.covered[0]).sum()
    assert state.complete_pixels[0] == state.complete_pixels[1] == counted


def wall_state() -> tuple[State, np.ndarray]:
    """One side with a mask of two columns and three levels, its first block in place."""
    frames = side_frames(1)
    state = empty_state(1, 1, 4, 8)
    state.vertices[0, 0, :4] = [(-0.025, 0), (-0.025, 0.15), (0.075, 0.15), (0.075, 0)]
    state.num_vertices[0, 0] = 4
    pixels = np.zeros((ROWS, IMAGE_SIZE), bool)
    pixels[63:82, 47:60] = True
    state.mask[0, 0] = from_pixels(pixels)
    state.mask_rows[0] = 63, 82
    state.mask_pixels[0] = pixels.sum()
    state.position[0, 0] = 0, 0, HALF
    state.num_placed[0], state.num_blocks[0] = 1, 8
    recover_all(state, 0, frames)
    count_row(state, 0)
    state.initial_pixels[0] = state.plane_pixels[0]
    return state, frames


def test_a_block_in_front_lowers_the_plane_filter_only() -> None:
    state, frames = wall_state()
    # The block shows 7 columns by 6 rows above the table's row, which has 13 mask pixels.
    assert state.initial_pixels[0] == state.complete_pixels[0] == 7 * 6 + 13
    assert state.plane_coverage[0] == state.complete_coverage[0] == 0.0
    previous = int(state.plane_pixels[0])
    move_block(state, 0, 0, 0, *target_cell(state, 0, 0, RELATIONS.index("front")))
    cover_block(state, 0, frames, 1)
    count_row(state, 0)
    assert state.plane_coverage[0] < 0.0
    assert state.complete_coverage[0] >= 0.0
    assert reward_and_end(state, 0, previous, True, DISCRETE, 0.975) == (0.0, False, False)
    assert reward_and_end(state, 0, previous, True, SCALED, 0.975) == (0.0, False, False)
    # The next gain counts from the lowered value.
    lowered = int(state.plane_pixels[0])
    assert lowered < previous
    move_block(state, 0, 0, 0, *target_cell(state, 0, 0, RELATIONS.index("right")))
    cover_block(state, 0, frames, 2)
    count_row(state, 0)
    assert reward_and_end(state, 0, lowered, True, DISCRETE, 0.975)[0] == 1.0


# ---------------------------------------------------------------- rewards and ends (6.3, 6.4)


@pytest.mark.parametrize(
    ("kind", "previous", "plane", "complete", "valid", "reward", "success"),
    [
        # 100 mask pixels, 20 of them covered from the start: F = (c - 20) / 80.
        (DISCRETE, 20, 21, 21, True, 1.0, False),
        (DISCRETE, 20, 20, 20, True, 0.0, False),
        (DISCRETE, 30, 20, 30, True, 0.0, False),
        (DISCRETE, 20, 60, 60, False, -1.0, False),
        (DISCRETE, 90, 100, 100, True, 1.0, True),
        (DISCRETE, 90, 80, 100, True, 0.0, True),  # hidden, not open: done without reward
        (DISCRETE, 90, 100, 100, False, -1.0, False),
        (DISCRETE, 20, 80, 80, True, 1.0, False),  # F_co = 0.75, and the threshold is strict
        (DISCRETE, 20, 81, 81, True, 1.0, True),
        (SCALED, 20, 40, 40, True, 3 * 0.25, False),
        (SCALED, 40, 20, 40, True, 0.0, False),
        (SCALED, 20, 60, 60, False, -1.0, False),
        (SCALED, 80, 100, 100, True, 3 * 0.25 + 1, True),
        (SCALED, 80, 80, 100, True, 1.0, True),  # the bonus does not ask for a gain (13.12)
        (SCALED, 80, 100, 100, False, -1.0, False),
    ],
)
def test_reward_table(
    kind: int, previous: int, plane: int, complete: int, valid: bool, reward: float, success: bool
) -> None:
    assert reward_and_success(100, 20, previous, plane, complete, valid, kind, 0.75) == (
        pytest.approx(reward),
        success,
    )


@pytest.mark.parametrize("valid", [True, False])
@pytest.mark.parametrize("full", [True, False])
@pytest.mark.parametrize("unplaced", [0, 1, 5])
def test_an_episode_ends_with_failure_success_or_the_last_block(
    valid: bool, full: bool, unplaced: int
) -> None:
    state, _ = wall_state()
    state.num_placed[0] = 8 - unplaced
    if full:
        state.complete_pixels[0] = state.mask_pixels[0]
    _, ended, success = reward_and_end(state, 0, int(state.plane_pixels[0]), valid, DISCRETE, 0.975)
    assert success == (valid and full)
    assert ended == (not valid or full or unplaced == 0)


# ---------------------------------------------------------------- snapshots


@given(seed=SEEDS, task=some_task)
@settings(deadline=None, max_examples=10)
def test_snapshots_are_exact_and_share_nothing(seed: int, task: Task) -> None:
    rng, sim = np.random.default_rng(seed), SIMULATORS[task.name]
    state = played(task, 3, rng, int(rng.integers(4)))
    snapshot = state.copy()
    rows = np.array([2, 0, 0, 1, 2])
    several = state.take(rows)
    for field, taken in zip(state, several, strict=True):
        assert np.array_equal(field[rows], taken)
        assert not np.shares_memory(field, taken)
    sim.step(state, random_actions(task, state, rng))
    assert not same(state, snapshot), "a step must be visible"
    assert all(not np.shares_memory(a, b) for a, b in zip(state, snapshot, strict=True))
    after = state.copy()
    state.put(np.array([1]), snapshot.take(np.array([1])))
    assert same(state.take(np.array([1])), snapshot.take(np.array([1])))
    assert same(state.take(np.array([0, 2])), after.take(np.array([0, 2])))
    state.put(np.arange(3), snapshot)
    assert same(state, snapshot)
    action = random_actions(task, state, rng)
    again = state.copy()
    assert_equal_steps(sim, state, again, action)


def assert_equal_steps(sim: Simulator, a: State, b: State, actions: np.ndarray) -> None:
    first, second = sim.step(a, actions), sim.step(b, actions)
    for x, y in zip(first, second, strict=True):
        assert np.array_equal(x, y)
    assert same(a, b)


# ---------------------------------------------------------------- batches


@given(seed=SEEDS, task=some_task, steps=st.integers(0, 8))
@settings(deadline=None, max_examples=15)
def test_rows_of_a_batch_do_not_leak(seed: int, task: Task, steps: int) -> None:
    rng, sim = np.random.default_rng(seed), SIMULATORS[task.name]
    state = played(task, 4, rng, steps)
    state.terminated[3] = True
    actions = random_actions(task, state, rng)
    alone = [state.take(np.array([row])) for row in range(4)]
    frozen = alone[3].copy()
    together = sim.step(state, actions)
    for row, single in enumerate(alone):
        result = sim.step(single, actions[row : row + 1])
        assert same(single, state.take(np.array([row])))
        for a, b in zip(together, result, strict=True):
            assert a[row] == b[0]
    assert same(alone[3], frozen), "a row that has ended is left alone"
    assert together.reward[3] == 0.0
    assert not together.terminated[3]
