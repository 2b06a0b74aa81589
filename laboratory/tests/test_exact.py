"""Exact returns on cubes against brute force over all placements, and the packing bound."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from l2a_lab import bounds
from l2a_lab.bounds import (
    MAX_COLUMN,
    best_return,
    cell_pixels,
    find_towers,
    gains,
    has_bound,
    is_in_reach,
    return_bound,
    sweep,
    tower_bound,
)
from l2a_lab.object_bounds import (
    Inventory,
    Lattice,
    discounted_bound,
    gaining_poses,
    most_pixels,
    object_return_bound,
    state_inventory,
    state_lattice,
    turns_of,
)
from learn2assemble.constants import EDGE, HALF
from learn2assemble.errors import InputError
from learn2assemble.tasks.graph.features import node_offset
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import PRESETS, Task, get_task
from learn2assemble.tasks.world.blocks import DIRECTIONS
from learn2assemble.tasks.world.coverage import ROWS, WORDS, add_box, clear_to_ground, to_pixels
from learn2assemble.tasks.world.layouts import start_objects, waiting_places
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import lookahead_actions
from learning_data import from_pixels, look_ahead

Cell = tuple[int, int, int]


@cache
def table_pixels() -> np.ndarray:
    """uint64[2, ROWS, WORDS]: (covered, occluded) of the empty table."""
    table = np.zeros((2, ROWS, WORDS), np.uint64)
    clear_to_ground(*table)
    return table


@cache
def images(cell: Cell, frame: tuple[float, ...]) -> tuple[int, int]:
    """(covered, occluded) of one cube on the lattice, seen by one side, as integers of bits."""
    c, s, tx, ty = frame
    wx, wy = EDGE * cell[0] - tx, EDGE * cell[1] - ty
    pair = np.zeros((2, ROWS, WORDS), np.uint64)
    z = HALF + EDGE * cell[2]
    add_box(pair[0], pair[1], round(c * wx + s * wy, 9), round(c * wy - s * wx, 9), z, HALF)
    return bits(pair[0]), bits(pair[1])


def bits(image: np.ndarray) -> int:
    return int.from_bytes(np.ascontiguousarray(image).tobytes(), "little")


class BruteForce:
    """The best return over every placement next to a placed block, in no plane in particular."""

    def __init__(self, simulator: Simulator, state: State) -> None:
        self.task = simulator.task
        self.frames = [tuple(frame) for frame in simulator.frames]
        self.masks = [bits(mask) for mask in state.mask[0]]
        self.blocks, self.initial = int(state.num_blocks[0]), int(state.initial_pixels[0])
        self.span = int(state.mask_pixels[0]) - self.initial
        x, y, _ = np.rint(state.position[0, 0] / EDGE)
        self.first: Cell = (int(x), int(y), 0)
        self.known: dict[frozenset[Cell], float] = {}

    def counts(self, placed: frozenset[Cell]) -> tuple[int, int]:
        plane = complete = 0
        table = [bits(image) for image in table_pixels()]
        for frame, mask in zip(self.frames, self.masks, strict=True):
            covered, occluded = table
            for cell in placed:
                c, o = images(cell, frame)
                covered, occluded = covered | c, occluded | o
            complete += (covered & mask).bit_count()
            plane += (covered & ~occluded & mask).bit_count()
        return plane, complete

    def best(self, placed: frozenset[Cell]) -> float:
        if placed in self.known:
            return self.known[placed]
        plane, complete = self.counts(placed)
        value = 0.0
        success = (complete - self.initial) / self.span > self.task.success_threshold
        if not success and len(placed) < self.blocks:
            value = max(self.after(placed, cell, plane) for cell in self.choices(placed))
        self.known[placed] = value
        return value

    def after(self, placed: frozenset[Cell], cell: Cell, plane: int) -> float:
        grown = placed | {cell}
        reward = 1.0 if self.counts(grown)[0] > plane else 0.0
        return reward + self.task.discount * self.best(grown)

    def choices(self, placed: frozenset[Cell]) -> set[Cell]:
        found = set()
        for x, y, z in placed:
            around = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1))
            for dx, dy, dz in around:
                cell = (x + dx, y + dy, z + dz)
                carried = cell[2] == 0 or (cell[0], cell[1], cell[2] - 1) in placed
                if cell not in placed and carried:
                    found.add(cell)
        return found


def problem(sides: int, grid: int, blocks: int, seed: int) -> tuple[Simulator, State]:
    """A random problem of the published kind with few blocks."""
    task = Task("small", num_sides=sides, grid=grid, num_nodes=5 * sides + 12, min_mask_pixels=20)
    simulator = Simulator(task)
    state = simulator.new(1, np.random.default_rng(seed))
    state.num_blocks[0] = blocks
    return simulator, state


def painted(
    shares: list[dict[tuple[int, int], float]],
    blocks: int,
    discount: float = 0.8,
    threshold: float = 0.975,
    seed: int | None = None,
) -> tuple[Simulator, State]:
    """A problem whose masks are shares of the pixels of the given cells (column, level).

    Without a seed they are pixels that no other cell shows.
    """
    shown = to_pixels(cell_pixels()).sum((0, 1))
    rng = np.random.default_rng(seed or 0)
    task = Task("painted", len(shares), 6, 40, discount=discount, success_threshold=threshold)
    simulator = Simulator(task)
    state = simulator.empty(1)
    for side, cells in enumerate(shares):
        pixels = np.zeros((ROWS, 100), bool)
        for (column, level), share in cells.items():
            image = to_pixels(cell_pixels()[column + MAX_COLUMN, level])
            face = np.argwhere(image if seed is not None else image & (shown == 1))
            count = max(round(share * len(face)), 1)
            chosen = rng.permutation(len(face))[:count]
            pixels[tuple(face[chosen].T)] = True
        state.mask[0, side] = from_pixels(pixels)
    state.mask_pixels[0] = np.bitwise_count(state.mask[0]).sum()
    start_objects(state, 0, simulator.frames, waiting_places("line", blocks), 0, blocks)
    return simulator, state


def feasible_return(simulator: Simulator, state: State, row: int = 0) -> float:
    """What the best order of towers earns in the simulator, played step by step: no detours."""
    towers, discount = find_towers(simulator, state, row), simulator.task.discount
    values = np.empty(np.prod(towers.cap - towers.low + 1))
    sweep(towers, discount, False, 0.0, np.empty(0), values)
    strides = np.cumprod(np.concatenate([[1], towers.cap - towers.low + 1]))
    heights, index, total, factor = towers.low.copy(), 0, 0.0, 1.0
    placed = [(*towers.place[np.flatnonzero(towers.low)[0]], 0)]
    world = state.take(np.array([row]))
    while values[index] > 0:
        worth = np.full(len(heights), -1.0)
        for n in np.flatnonzero(heights < towers.cap):
            if is_in_reach(towers, heights, n):
                worth[n] = gains(towers, heights, n) + discount * values[index + strides[n]]
        n = int(np.argmax(worth))
        cell = (*towers.place[n], heights[n])
        offset = np.array(cell) - np.array(placed)
        reference, relation = np.argwhere((offset[:, None] == DIRECTIONS).all(-1))[0]
        assert not world.terminated[0]
        step = simulator.step(world, np.array([[0, reference, relation]]))
        assert step.verdict[0] == 0
        total += factor * float(step.reward[0])
        factor *= discount
        placed.append(cell)
        heights[n] += 1
        index += int(strides[n])
    return total


# ---------------------------------------------------------------- cubes


def test_only_blocks_in_the_face_planes_gain() -> None:
    """What the proof of the upper bound rests on; depth in blocks behind the face plane."""
    table, _ = table_pixels()
    for depth in (-4, -3, -2, -1, 1, 2, 3):
        for column in range(-MAX_COLUMN, MAX_COLUMN + 1):
            for level in range(12):
                pair = np.zeros((2, ROWS, WORDS), np.uint64)
                x, y, z = EDGE * column, EDGE * depth, HALF + EDGE * level
                add_box(pair[0], pair[1], x, y, z, HALF)
                assert not (pair[0] & ~pair[1] & ~table).any(), (depth, column, level)


def test_a_pixel_belongs_to_two_neighbouring_columns_at_most() -> None:
    columns = to_pixels(np.bitwise_or.reduce(cell_pixels(), axis=1))
    assert columns.sum(0).max() == 2
    for first in range(len(columns)):
        for second in range(first + 2, len(columns)):
            assert not (columns[first] & columns[second]).any()


@settings(max_examples=12, deadline=None)
# An open roof: towers of twelve blocks' height, and two blocks.
@example(1, 1, 2, 280)
@given(st.sampled_from([1, 2]), st.sampled_from([1, 2, 3]), st.integers(2, 5), st.integers(0, 9999))
def test_optimum_equals_brute_force(sides: int, grid: int, blocks: int, seed: int) -> None:
    simulator, state = problem(sides, grid, blocks, seed)
    brute = BruteForce(simulator, state)
    best = brute.best(frozenset([brute.first]))
    # A detour never pays with so few blocks.
    assert feasible_return(simulator, state) == pytest.approx(best)
    assert best_return(simulator, state) == pytest.approx(best)


CELLS = st.dictionaries(
    st.tuples(st.integers(-2, 2), st.integers(0, 2)), st.floats(0, 1), min_size=1, max_size=4
)


@settings(max_examples=30, deadline=None)
@given(
    st.lists(CELLS, min_size=1, max_size=2),
    st.integers(2, 5),
    st.sampled_from([0.5, 0.8, 0.95]),
    st.sampled_from([0.3, 0.6, 0.975]),
    st.integers(0, 99),
)
def test_bounds_hold_on_scattered_masks(
    shares: list[dict[tuple[int, int], float]],
    blocks: int,
    discount: float,
    threshold: float,
    seed: int,
) -> None:
    simulator, state = painted(shares, blocks, discount, threshold, seed)
    if state.initial_pixels[0] == state.mask_pixels[0]:
        return
    brute = BruteForce(simulator, state)
    best = brute.best(frozenset([brute.first]))
    upper = best_return(simulator, state)
    closed = tower_bound(find_towers(simulator, state, 0), discount)
    assert feasible_return(simulator, state) <= best + 1e-9
    assert best <= upper + 1e-9
    assert upper <= closed + 1e-9
    assert closed <= return_bound(state, discount)[0] + 1e-9
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bounds, "MAX_STRUCTURES", 0)
        assert best_return(simulator, state) == closed


def test_supports_delay() -> None:
    simulator, state = painted([{(2, 1): 0.5}], blocks=6)
    # Beside the first block, one further, on top of it: the third step is rewarded.
    assert best_return(simulator, state) == pytest.approx(0.8**2)
    assert feasible_return(simulator, state) == pytest.approx(0.8**2)
    assert tower_bound(find_towers(simulator, state, 0), 0.8) == pytest.approx(0.8)
    assert return_bound(state, 0.8)[0] == 1


def test_the_last_cell_is_lost_where_success_comes_before_it() -> None:
    # The crumb of one pixel lies on the full cell, which alone is success.
    simulator, state = painted([{(1, 0): 1.0, (1, 1): 0.0}], blocks=6, threshold=0.9)
    assert best_return(simulator, state) == feasible_return(simulator, state) == 1
    # Beside it, the crumb can be had first.
    simulator, state = painted([{(1, 0): 1.0, (-1, 0): 0.0}], blocks=6, threshold=0.9)
    assert best_return(simulator, state) == pytest.approx(1.8)
    assert feasible_return(simulator, state) == pytest.approx(1.8)


def test_a_detour_that_pays_is_in_the_upper_bound() -> None:
    """Around the full cell behind the only wall, to the crumb beyond it: three blocks, then two
    rewards. No plan within the face plane does that, so the gap is real."""
    simulator, state = painted([{(1, 0): 1.0, (2, 0): 0.0}], 6, discount=0.95, threshold=0.9)
    brute = BruteForce(simulator, state)
    best = brute.best(frozenset([brute.first]))
    assert best == pytest.approx(0.95**3 + 0.95**4)
    assert best_return(simulator, state) == pytest.approx(best)
    assert feasible_return(simulator, state) == 1


def test_no_play_exceeds_the_exact_return_and_the_look_ahead_comes_close() -> None:
    task = get_task("two-sided-3x3-20-24")
    simulator = Simulator(task)
    state = simulator.new(40, np.random.default_rng(1))
    upper = np.array([best_return(simulator, state, row) for row in range(40)])
    reached = [feasible_return(simulator, state, row) for row in range(40)]
    np.testing.assert_allclose(reached, upper, atol=1e-9)
    assert (upper <= return_bound(state, task.discount) + 1e-9).all()
    total, discount = np.zeros(40), 1.0
    while not state.terminated.all():
        total += discount * simulator.step(state, lookahead_actions(simulator, state)).reward
        discount *= task.discount
    assert (total <= upper + 1e-9).all()
    assert total.mean() > 0.97 * upper.mean()


def test_what_is_not_a_fresh_problem_with_cubes_is_refused() -> None:
    simulator = Simulator(get_task("four-sided-3x3-10-18"))
    with pytest.raises(InputError, match="num_sides"):
        best_return(simulator, simulator.new(1, np.random.default_rng(0)))
    simulator = Simulator(get_task("two-sided-3x3-20-24"))
    state = simulator.new(1, np.random.default_rng(0))
    simulator.step(state, np.array([[0, 0, 0]]))
    with pytest.raises(InputError, match="num_placed"):
        best_return(simulator, state)
    simulator = Simulator(get_task("two-sided-3x3-20-24").replace(reward="scaled"))
    with pytest.raises(InputError, match="reward"):
        best_return(simulator, state)


# ---------------------------------------------------------------- objects

SHAPES = (
    np.array([[0, 0, 0]]),
    np.array([[0, 0, 0], [0, 0, 1]]),
    np.array([[0, 0, 0], [1, 0, 0]]),
    np.array([[1, 0, 0], [0, 0, 0], [0, 0, 1]]),
)


def random_lattice(rng: np.random.Generator) -> Lattice:
    """A wall of 2x2 cells with a row of cells before it, and six pixels seen at random."""
    wall = [[x, 0, z] for x in range(2) for z in range(2)]
    front = [[x, -1, 0] for x in range(2)]
    cells = np.array(wall + front)
    shows, hides = rng.random((2, 6, 6)) < 0.4
    hides[:4] = False
    shows[4:] = hides[4:]
    return Lattice(cells, shows, hides, np.array([[-1, 0, 0]]))


def best_packings(lattice: Lattice, inventory: Inventory, rotations: int) -> list[int]:
    """F(t) by trying every set of objects at every place in a box, with no idea of gains."""
    row = {tuple(cell): n for n, cell in enumerate(lattice.cells.tolist())}
    taken = set(map(tuple, lattice.taken.tolist()))
    places: list[dict[frozenset[Cell], frozenset[int]]] = []
    for shape in inventory.shapes:
        found = {}
        for turns in range(rotations):
            for shift in np.ndindex(6, 6, 3):
                moved = np.array(turns_of(shape, 4)[turns]) + np.array(shift) - (2, 3, 0)
                cells = frozenset(tuple(cell) for cell in moved.tolist())
                if cells & taken or moved[:, 2].min() < 0:
                    continue
                rows = [row[cell] for cell in cells if cell in row]
                gained = lattice.shows[rows].any(0) & ~lattice.hides[rows].any(0)
                if gained.any():
                    found[cells] = frozenset(np.flatnonzero(gained).tolist())
        places.append(found)
    total = sum(inventory.counts)
    best = [0] * (total + 1)

    def add(used: frozenset[Cell], gained: frozenset[int], left: list[int], t: int) -> None:
        best[t] = max(best[t], len(gained))
        for shape, found in enumerate(places):
            if left[shape]:
                after = [n - (k == shape) for k, n in enumerate(left)]
                for cells, more in found.items():
                    if not cells & used and not more <= gained:
                        add(used | cells, gained | more, after, t + 1)

    add(frozenset(), frozenset(), list(inventory.counts), 0)
    return [int(n) for n in np.maximum.accumulate(best)]


@settings(max_examples=15, deadline=None)
@given(
    st.integers(0, 10**6),
    st.lists(st.sampled_from([0, 1, 2, 3]), min_size=1, max_size=3),
    st.sampled_from([1, 4]),
)
def test_packing_equals_brute_force(seed: int, objects: list[int], rotations: int) -> None:
    lattice = random_lattice(np.random.default_rng(seed))
    kinds = sorted(set(objects))
    inventory = Inventory([SHAPES[k] for k in kinds], [objects.count(k) for k in kinds])
    expected = best_packings(lattice, inventory, rotations)
    assert most_pixels(lattice, inventory, rotations).tolist() == expected
    stopped = most_pixels(lattice, inventory, rotations, max_nodes=0)
    assert (stopped >= expected).all()


def test_an_object_that_hides_its_own_face_gains_nothing() -> None:
    cells = np.array([[0, 0, 0], [0, -1, 0]])
    shows = np.array([[True, True], [False, True]])
    hides = np.array([[False, False], [False, True]])
    lattice = Lattice(cells, shows, hides, np.zeros((0, 3), np.int64))
    across = Inventory([np.array([[0, 0, 0], [0, 1, 0]])], [1])
    found = {tuple(map(int, pose.gains)) for pose in gaining_poses(lattice, across, 1)}
    # Standing before the face it hides pixel 1, standing behind it shows both.
    assert found == {(1, 0), (1, 1)}


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.integers(0, 40), min_size=1, max_size=6),
    st.sampled_from([0.5, 0.8, 0.95]),
    st.sampled_from([0.5, 0.75, 0.975]),
)
def test_the_discounted_bound_holds_for_every_sequence_of_gains(
    gains: list[int], discount: float, threshold: float
) -> None:
    """One play whose gains are known, so F is the sum of the largest ones."""
    span = max(sum(gains), 1)
    most = np.cumsum([0, *sorted(gains, reverse=True)])
    total, covered, factor = 0.0, 0, 1.0
    for gain in gains:
        covered += gain
        success = covered / span > threshold
        total += factor * (3 * gain / span + success)
        factor *= discount
        if success:
            break
    assert total <= discounted_bound(most, span, discount, threshold) + 1e-9


def test_discounted_bound_by_hand() -> None:
    # Half, then the other half: success at the second step.
    assert discounted_bound(np.array([0, 5, 10]), 10, 0.9, 0.75) == pytest.approx(
        3 * (0.5 + 0.9 * 0.5) + 0.9
    )
    assert discounted_bound(np.array([0]), 10, 0.9, 0.75) == 0


def test_the_objects_bound_of_a_state_of_cubes() -> None:
    """Cubes are objects of one cell: the look-ahead stays below the bound, and close."""
    task = get_task("two-sided-3x3-20-24").replace(reward="scaled", discount=0.95)
    simulator = Simulator(task)
    state = simulator.new(8, np.random.default_rng(0))
    inventory = state_inventory(state, 0)
    assert [shape.tolist() for shape in inventory.shapes] == [[[0, 0, 0]]]
    assert inventory.counts == [state.num_unplaced[0]]
    open_pixels = np.bitwise_count(state.mask[0] & ~state.covered[0]).sum()
    assert state_lattice(state, 0, simulator.frames).shows.shape[1] == open_pixels
    most = np.array(
        [object_return_bound(state, row, simulator.frames, 0.95, 0.975, 1) for row in range(8)]
    )
    total, discount = np.zeros(8), 1.0
    while not state.terminated.all():
        placements, found = look_ahead(simulator, state)
        best = placements.action[np.arange(8), found.gain.argmax(1)]
        actions = best - node_offset(simulator.observe(state))
        stuck = found.gain.max(1) <= 0
        actions[stuck] = lookahead_actions(simulator, state)[stuck]
        total += discount * simulator.step(state, actions).reward
        discount *= task.discount
    assert (total <= most + 1e-9).all()
    assert total.mean() > 0.8 * most.mean()


def test_an_inventory_counts_turned_objects_as_one_shape() -> None:
    simulator = Simulator(get_task("two-sided-3x3-20-24"))
    state = simulator.new(1, np.random.default_rng(0))
    state.num_blocks[0] = 6
    state.object_id[0, 1:6] = [1, 1, 2, 2, 3]
    state.position[0, 1:6] = (
        np.array([[0, 0, 0], [1, 0, 0], [5, 5, 0], [5, 4, 0], [9, 9, 0]]) * EDGE
    )
    assert sorted(state_inventory(state, 0).counts) == [1, 2]
    assert sorted(state_inventory(state, 0, rotations=1).counts) == [1, 1, 1]


@pytest.mark.parametrize("name", [name for name, task in PRESETS.items() if task.has_arm])
def test_blocks_that_do_not_touch_have_no_bound(name: str) -> None:
    assert not has_bound(PRESETS[name].replace(arm="none"))
