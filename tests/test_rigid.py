"""Rigid-body settle: what must hold, what must fall, and that a step is a pure function."""

from __future__ import annotations

import pickle

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.constants import EDGE, HALF, MASS
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.tasks.physics.equilibrium import is_stable
from learn2assemble.tasks.physics.protocol import Physics, PlacementVerdict
from learn2assemble.tasks.physics.rigid import (
    RULES,
    SHRINK,
    RigidPhysics,
    build_spec,
    compile_model,
    group_cells,
)
from learn2assemble.tasks.physics.static import StaticPhysics
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import get_task
from learn2assemble.tasks.world.blocks import DIRECTIONS
from learn2assemble.tasks.world.state import State, empty_state

SEEDS = st.integers(0, 2**32 - 1)
ROW = np.array([0])
BAR2, BAR3 = [(0, 0, 0), (1, 0, 0)], [(0, 0, 0), (1, 0, 0), (2, 0, 0)]
SHAPES = [
    [(0, 0, 0)],
    BAR2,
    [(0, 0, 0), (0, 0, 1)],
    BAR3,
    [(1, 0, 0), (0, 0, 0), (0, 0, 1)],
    [(1, 0, 0), (0, 0, 0), (0, 1, 0)],
    [(1, 0, 0), (0, 0, 0), (0, 0, 1), (-1, 0, 1)],
]


def world(*structures: list[tuple[float, ...]], objects: list[int] | None = None) -> State:
    """One row per structure, whose last cell was placed last; cells in block edges."""
    state = empty_state(len(structures), 1, 3, max(map(len, structures)) + 1)
    for row, cells in enumerate(structures):
        count = len(cells)
        state.position[row, :count] = EDGE * np.array(cells, float) + [0.0, 0.0, HALF]
        state.position[row, count:] = 7.0
        state.num_placed[row], state.num_blocks[row] = count, count + 1
        if objects is not None:
            state.object_id[row, :count] = objects
            state.object_id[row, count] = 999
    return state


def settle(*cells: tuple[float, ...], objects: list[int] | None = None) -> PlacementVerdict:
    return PlacementVerdict(RigidPhysics().settle(world(list(cells), objects=objects), ROW)[0])


def same(a: State, b: State) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def random_columns(rng: np.random.Generator, count: int) -> list[tuple[float, ...]]:
    width, depth = int(rng.integers(1, 6)), int(rng.integers(1, 5))
    cells: list[tuple[float, ...]] = []
    for _ in range(count):
        x, y = int(rng.integers(width)), int(rng.integers(depth))
        cells.append((x, y, sum(c[:2] == (x, y) for c in cells)))
    return cells


# ---------------------------------------------------------------- calibration


@pytest.mark.parametrize("height", [1, 2, 12, 30, 45])
def test_columns_stand_however_tall(height: int) -> None:
    physics = RigidPhysics()
    state = world([(0, 0, k) for k in range(height)])
    assert physics.settle(state, ROW)[0] == PlacementVerdict.STABLE
    assert physics.last_speed_sums[0].max() < 0.25 * RULES["block"]


def test_wall_of_forty_stands() -> None:
    wall = [(x, 0, z) for z in range(5) for x in range(8)]
    two = [(x, y, z) for z in range(4) for y in range(2) for x in range(5)]
    for cells in (wall, two):
        assert settle(*cells) == PlacementVerdict.STABLE


@settings(max_examples=15, deadline=None)
@given(seed=SEEDS, count=st.integers(1, 45))
def test_supported_structures_stand_and_stay(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    state = world(random_columns(rng, count))
    # Positions as a simulator leaves them, not on the lattice to the last bit.
    state.position[0, :count] += rng.uniform(-2e-5, 2e-5, (count, 3))
    before = state.copy()
    assert RigidPhysics().settle(state, ROW)[0] == PlacementVerdict.STABLE
    assert np.abs(state.position - before.position)[0, :count, :2].max() < 1e-4
    assert np.abs(state.position - before.position)[0, :count, 2].max() < 1e-3


@settings(max_examples=15, deadline=None)
@given(seed=SEEDS, count=st.integers(1, 12), height=st.integers(1, 3))
def test_a_fall_of_one_block_or_more_always_fails(seed: int, count: int, height: int) -> None:
    rng = np.random.default_rng(seed)
    cells = random_columns(rng, count)
    x, y = cells[rng.integers(count)][:2]
    top = sum(c[:2] == (x, y) for c in cells)
    physics = RigidPhysics()
    state = world([*cells, (x, y, top + height)])
    assert physics.settle(state, ROW)[0] == PlacementVerdict.FLOATING
    assert physics.last_speed_sums[0][-1] > 10, "5 cm in steps of 4 ms is 12.5"
    assert state.position[0, count, 2] < EDGE * (top + height) + HALF - 0.9 * EDGE


def test_block_between_neighbours_falls() -> None:
    """Nothing presses the neighbours together (the published engine let a few such stick)."""
    ring = [(-1, 0), (1, 0), (0, -1), (0, 1)]
    cells = [(x, y, z) for z in range(3) for x, y in ring]
    assert settle(*cells, (0, 0, 2)) == PlacementVerdict.FLOATING


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(
    ("overhang", "verdict"),
    [
        (0.2, PlacementVerdict.STABLE),
        (-0.49, PlacementVerdict.STABLE),
        (0.51, PlacementVerdict.UNSTABLE),
        (-0.6, PlacementVerdict.UNSTABLE),
        (0.9, PlacementVerdict.UNSTABLE),
    ],
)
def test_overhang(overhang: float, verdict: PlacementVerdict, axis: int) -> None:
    at = [0.0, 0.0, 1.0]
    at[axis] = overhang
    assert settle((0, 0, 0), tuple(at)) == verdict


@pytest.mark.parametrize(
    ("last", "verdict"),
    [
        ((0, 0, 0), PlacementVerdict.OVERLAP),
        ((0.3, 0, 0.5), PlacementVerdict.OVERLAP),
        ((1, 0, -1), PlacementVerdict.BELOW_GROUND),
    ],
)
def test_geometric_facts_are_not_simulated(
    last: tuple[float, ...], verdict: PlacementVerdict
) -> None:
    state = world([(0, 0, 0), (0, 0, 1), last])
    before, physics = state.copy(), RigidPhysics()
    assert physics.settle(state, ROW)[0] == verdict
    assert same(state, before)
    assert [len(s) for s in physics.last_speed_sums] == [0]


def test_rules_and_thresholds() -> None:
    cells = [(x, 0, 0) for x in range(30)]
    fine = RigidPhysics("block", threshold=0.006)
    assert fine.settle(world(cells), ROW)[0] == PlacementVerdict.STABLE
    sums = fine.last_speed_sums[0]
    assert sums.shape == (30,)
    assert sums.sum() > 0.006 > sums.max() > 0
    assert (
        RigidPhysics("sum", threshold=0.006).settle(world(cells), ROW)[0]
        == PlacementVerdict.UNSTABLE
    )
    assert RigidPhysics("sum").settle(world(cells), ROW)[0] == PlacementVerdict.STABLE
    assert RigidPhysics("sum").threshold == 1.0
    with pytest.raises(UnknownNameError, match="did you mean 'block'"):
        RigidPhysics("blok")
    for bad in ({"threshold": -1.0}, {"settle_steps": 0}, {"timestep": 0.0}):
        with pytest.raises(InputError, match=next(iter(bad))):
            RigidPhysics(**bad)


def test_a_finer_step_gives_the_same_path_length() -> None:
    coarse, fine = RigidPhysics(), RigidPhysics(timestep=0.002, settle_steps=100)
    for overhang, verdict in ((0.4, PlacementVerdict.STABLE), (0.6, PlacementVerdict.UNSTABLE)):
        for physics in (coarse, fine):
            state = world([(0, 0, 0), (overhang, 0, 1)])
            assert physics.settle(state, ROW)[0] == verdict
    for physics in (coarse, fine):
        physics.settle(world([(0, 0, 0), (3, 0, 1)]), ROW)
    falls = [p.last_speed_sums[0][-1] for p in (coarse, fine)]
    assert falls[0] == pytest.approx(falls[1], rel=0.05)


# ---------------------------------------------------------------- agreement of the two physics


def play(seed: int, steps: int) -> tuple[int, int, int]:
    """Random placements, kept where rigid physics holds them: steps, agreements, valid steps."""
    rng, rigid, static = np.random.default_rng(seed), RigidPhysics(), StaticPhysics()
    state = world([(0, 0, 0), *[(9, 9, 9)] * steps])
    state.num_placed[0] = 1
    agree = valid = 0
    for _ in range(steps):
        count = int(state.num_placed[0])
        before = state.copy()
        reference = int(rng.integers(count))
        step = EDGE * DIRECTIONS[rng.integers(len(DIRECTIONS))]
        state.position[0, count] = state.position[0, reference] + step
        state.quaternion[0, count] = state.quaternion[0, reference]
        state.num_placed[0] = count + 1
        expected = static.settle(state, ROW)[0]
        found = rigid.settle(state, ROW)[0]
        agree += int((found == PlacementVerdict.STABLE) == (expected == PlacementVerdict.STABLE))
        valid += int(found == PlacementVerdict.STABLE)
        if found != PlacementVerdict.STABLE:
            state.put(ROW, before)
    return steps, agree, valid


def test_static_and_rigid_agree_on_lattice_placements() -> None:
    total = np.sum([play(seed, 25) for seed in range(10)], axis=0)
    steps, agree, valid = total
    assert 0.2 < valid / steps < 0.9, "both outcomes must be there"
    assert agree / steps >= 0.99


def test_static_and_rigid_agree_on_objects_of_several_cells() -> None:
    rng, rigid = np.random.default_rng(3), RigidPhysics()
    steps = agree = stable = 0
    for _ in range(25):
        cells, ids = [(0, 0, 0)], [0]
        for number in range(1, 9):
            shape = np.array(SHAPES[rng.integers(len(SHAPES))])
            for _ in range(rng.integers(4)):
                shape = shape[:, [1, 0, 2]] * [-1, 1, 1]
            at = np.array(cells[rng.integers(len(cells))]) + DIRECTIONS[rng.integers(5)].astype(int)
            new = [tuple(map(int, c)) for c in shape - shape[rng.integers(len(shape))] + at]
            free = all(c not in cells and c[2] >= 0 for c in new)
            if not free or not any(c[2] == 0 or (*c[:2], c[2] - 1) in cells for c in new):
                continue
            together, names = cells + new, ids + [number] * len(new)
            state = world(together, objects=names)
            placed = state.position[0, : len(together)].copy()
            found = rigid.settle(state, ROW)[0] == PlacementVerdict.STABLE
            expected = is_stable(placed, np.array(names))
            steps, agree, stable = steps + 1, agree + int(found == expected), stable + int(found)
            if found and expected:
                cells, ids = together, names
    assert steps > 80
    assert 0.5 < stable / steps < 0.99
    assert agree / steps >= 0.98


# ---------------------------------------------------------------- objects of several cells


def test_bars_hold_as_one_body() -> None:
    bridge = [(0, 0, 0), (2, 0, 0), (0, 0, 1), (1, 0, 1), (2, 0, 1)]
    assert settle(*bridge, objects=[0, 1, 2, 2, 2]) == PlacementVerdict.STABLE
    assert settle((0, 0, 0), (2, 0, 0), (1, 0, 1)) == PlacementVerdict.FLOATING
    end = [(0, 0, 0), (0, 0, 1), (1, 0, 1), (2, 0, 1)]
    assert settle(*end, objects=[0, 1, 1, 1]) == PlacementVerdict.UNSTABLE
    assert (
        settle(*end, (0, 0, 2), (0, 0, 3), (0, 0, 4), (0, 0, 5), objects=[0, 1, 1, 1, 2, 3, 4, 5])
        == PlacementVerdict.STABLE
    )
    assert settle(*end, (0, 0, 1), objects=[0, 1, 1, 1, 2]) == PlacementVerdict.OVERLAP
    assert settle((0, 0, 1), (1, 0, 1), objects=[4, 4]) == PlacementVerdict.FLOATING
    assert settle((0, 0, 0), (0, 0, -1), objects=[4, 4]) == PlacementVerdict.BELOW_GROUND


def test_a_falling_object_keeps_its_shape_and_can_be_settled_again() -> None:
    cells = [(0, 0, 0), (0, 0, 1), (1, 0, 1), (2, 0, 1)]
    state, physics = world(cells, objects=[0, 1, 1, 1]), RigidPhysics()
    before = state.copy()
    for verdict in (
        PlacementVerdict.UNSTABLE,
        PlacementVerdict.STABLE,
    ):  # It topples, then leans where it fell.
        assert physics.settle(state, ROW)[0] == verdict
        bar, turn = state.position[0, 1:4], state.quaternion[0, 1:4]
        np.testing.assert_allclose(np.linalg.norm(np.diff(bar, axis=0), axis=1), EDGE, atol=1e-9)
        np.testing.assert_array_equal(turn, np.tile(turn[0], (3, 1)))
    assert state.position[0, 3, 2] < before.position[0, 3, 2] - 0.01


def test_speed_of_a_cell_is_its_path() -> None:
    """V of each cell of a toppling bar against the displacements seen step by step."""
    cells = [(0, 0, 0), (0, 0, 1), (1, 0, 1), (2, 0, 1)]
    state, physics = world(cells, objects=[0, 1, 1, 1]), RigidPhysics()
    physics.settle(state, ROW)
    swept = physics.last_speed_sums[0]
    path, last = np.zeros(4), world(cells, objects=[0, 1, 1, 1]).position[0, :4]
    for steps in range(1, 51):
        partial = world(cells, objects=[0, 1, 1, 1])
        RigidPhysics(settle_steps=steps).settle(partial, ROW)
        path += np.abs(partial.position[0, :4] - last).sum(-1)
        last = partial.position[0, :4]
    np.testing.assert_allclose(swept, path / 0.004, rtol=0.03, atol=0.02)


def test_grouping() -> None:
    state = world([(0, 0, 0), (1, 0, 0), (0, 0, 1), (0, 1, 1)], objects=[5, 9, 7, 7])
    position, quaternion = state.position[0, :4], state.quaternion[0, :4]
    group = group_cells(position, quaternion, state.object_id[0, :4])
    assert group.layout == (((0, 0, 0),), ((0, 0, 0),), ((0, 0, 0), (0, 1, 0)))
    np.testing.assert_array_equal(group.body, [0, 1, 2, 2])
    np.testing.assert_allclose(group.offset[2:], [[0, -HALF, 0], [0, HALF, 0]], atol=1e-12)
    turn = np.tile([np.sqrt(0.5), 0, 0, np.sqrt(0.5)], (4, 1))
    turned = group_cells(position, turn, state.object_id[0, :4])
    assert turned.layout[2] == ((0, 0, 0), (1, 0, 0)), "y of the world is x of the object"
    position[3, 1] += 0.02
    with pytest.raises(InputError, match="object 7"):
        group_cells(position, quaternion, state.object_id[0, :4])


def test_model_of_a_layout() -> None:
    layout = (((0, 0, 0),), ((0, 0, 0), (1, 0, 0)))
    model = compile_model(layout)
    assert model is compile_model(layout)
    np.testing.assert_allclose(model.body_mass[1:], [MASS, 2 * MASS])
    np.testing.assert_allclose(model.body_ipos[1:], 0, atol=1e-12)
    thin = HALF - SHRINK
    np.testing.assert_allclose(model.geom_size[1:], [[thin, thin, HALF]] * 3)
    assert (model.dof_damping > 0).all()
    again = mujoco.MjModel.from_xml_string(_xml(layout))
    assert (again.nbody, again.ngeom) == (3, 4)


def _xml(layout: tuple[tuple[tuple[int, int, int], ...], ...]) -> str:
    spec = build_spec(layout)
    spec.compile()
    return spec.to_xml()


# ---------------------------------------------------------------- purity


def random_world(seed: int) -> State:
    """Columns and a last block somewhere near: stable, toppling, floating or overlapping."""
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(3):
        cells = random_columns(rng, int(rng.integers(1, 8)))
        x, y, z = cells[rng.integers(len(cells))]
        rows.append([*cells, (x + rng.uniform(-0.7, 0.7), y + rng.uniform(-0.7, 0.7), z + 1)])
    return world(*rows)


@settings(max_examples=15, deadline=None)
@given(seed=SEEDS)
def test_settling_is_a_pure_function_of_each_row(seed: int) -> None:
    start = random_world(seed)
    used, together = RigidPhysics(), start.copy()
    verdicts = used.settle(together, np.arange(3))
    sums = used.last_speed_sums
    for row in (2, 0, 1):
        alone = start.copy()
        # `used` carries the memory of other worlds, the fresh one does not: both must not matter.
        fresh = RigidPhysics()
        for physics in (used, fresh):
            alone.put(np.arange(3), start)
            assert physics.settle(alone, np.array([row]))[0] == verdicts[row]
            np.testing.assert_array_equal(physics.last_speed_sums[0], sums[row])
            assert same(alone.take(np.array([row])), together.take(np.array([row])))
        others = np.array([r for r in range(3) if r != row])
        assert same(alone.take(others), start.take(others))


def test_only_poses_of_placed_blocks_change() -> None:
    state = world([(0, 0, 0), (0.6, 0, 1)])
    before = state.copy()
    RigidPhysics().settle(state, ROW)
    assert not np.array_equal(state.position[0, :2], before.position[0, :2])
    assert not np.array_equal(state.quaternion[0, :2], before.quaternion[0, :2])
    after = state.copy()
    for name in ("position", "quaternion"):
        getattr(after, name)[0, :2] = getattr(before, name)[0, :2]
    assert same(after, before)


def test_pickling_keeps_the_settings_and_drops_the_worlds() -> None:
    physics = RigidPhysics("sum", threshold=2.0)
    physics.settle(world([(0, 0, 0)]), ROW)
    again = pickle.loads(pickle.dumps(physics))
    assert (again.rule, again.threshold) == ("sum", 2.0)
    assert again.settle(world([(0, 0, 0)]), ROW)[0] == PlacementVerdict.STABLE


def test_simulator_runs_on_it() -> None:
    physics: Physics = RigidPhysics()
    simulator = Simulator(get_task("two-sided-3x3-20-24"), physics)
    state = simulator.new(2, np.random.default_rng(0))
    saved = state.copy()
    up_and_over = np.array([[0, 0, 0], [0, 0, 1]])
    first = simulator.step(state, up_and_over)
    assert (first.verdict == PlacementVerdict.STABLE).all()
    restored = saved.copy()
    second = simulator.step(restored, up_and_over)
    assert same(state, restored)
    np.testing.assert_array_equal(first.reward, second.reward)
    floating = simulator.step(state, np.array([[0, 1, 1], [0, 0, 1]]))
    assert floating.verdict.tolist() == [PlacementVerdict.FLOATING, PlacementVerdict.OVERLAP]
    assert floating.reward.tolist() == [-1.0, -1.0]
