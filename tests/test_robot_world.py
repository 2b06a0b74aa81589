"""The worlds of the robot cell before there is an arm: lattice, cover, layouts, grips, objects."""

# Compiled functions have no stubs that pyright can follow.
# pyright: reportCallIssue=false
from __future__ import annotations

import dataclasses
from collections import Counter

import mujoco
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy import stats

from learn2assemble.constants import EDGE, HALF, MASS
from learn2assemble.errors import InputError, Learn2AssembleError, UnknownNameError
from learn2assemble.tasks.learning.config import CONFIGS, fit_to
from learn2assemble.tasks.learning.trainer import Trainer
from learn2assemble.tasks.physics.equilibrium import is_stable
from learn2assemble.tasks.physics.protocol import PlacementVerdict
from learn2assemble.tasks.physics.rigid import RigidPhysics, compile_model, object_parts
from learn2assemble.tasks.physics.static import StaticPhysics
from learn2assemble.tasks.physics.support import (
    BALANCE_TOLERANCE,
    FLOATING,
    STABLE,
    UNSTABLE,
    classify_cube,
    classify_object,
    find_fillers,
)
from learn2assemble.tasks.search.config import SearchConfig
from learn2assemble.tasks.search.mcts import search
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import PRESETS, Task, get_task
from learn2assemble.tasks.world.blocks import DIRECTIONS, SHAPES, get_action_spec, quarter_turn
from learn2assemble.tasks.world.layouts import scatter, side_frames, waiting_places
from learn2assemble.tasks.world.rules import (
    last_object,
    move_block,
    recover_all,
    target_cell,
    waiting_level,
)
from learn2assemble.tasks.world.state import State, empty_state

SEEDS = st.integers(0, 2**32 - 1)
ROBOTS = {name: task.replace(arm="none") for name, task in PRESETS.items() if task.has_arm}
"""The worlds of the robot cell without their arm."""
TWO = get_task("robot-two-sided-3x3-10-14").replace(arm="none")
OBJECTS = get_task("robot-objects-two-sided-5x5-20-24").replace(arm="none")
RANDOM = get_task("robot-random-two-sided-3x3-10-14").replace(arm="none")
each_robot = pytest.mark.parametrize("task", ROBOTS.values(), ids=lambda task: task.name)


# ---------------------------------------------------------------- what the tasks are


def test_the_papers_robot_tasks() -> None:
    """Sides, grid, nodes, blocks, actions, pitch, layout, reward, discount of every label."""
    rows, slanted = ("rows", "discrete", 0.8), ("slanted-rows", "discrete", 0.8)
    scattered, columns = ("random", "discrete", 0.8), ("columns", "scaled", 0.95)
    wanted = {
        "robot-one-sided-5x5-15-17": (1, 5, 20, (15, 17), 5, 0.055, *rows),
        "robot-one-sided-6x6-16-18": (1, 6, 21, (16, 18), 5, 0.055, *rows),
        "robot-two-sided-3x3-10-14": (2, 3, 20, (10, 14), 20, 0.06, *slanted),
        "robot-two-sided-3x3-14-18": (2, 3, 24, (14, 18), 20, 0.06, *slanted),
        "robot-two-sided-5x5-14-18": (2, 5, 24, (14, 18), 20, 0.06, *slanted),
        "robot-random-two-sided-3x3-10-14": (2, 3, 20, (10, 14), 20, 0.06, *scattered),
        "robot-random-two-sided-3x3-14-18": (2, 3, 24, (14, 18), 20, 0.06, *scattered),
        "robot-random-two-sided-5x5-14-18": (2, 5, 24, (14, 18), 20, 0.06, *scattered),
        "robot-four-sided-3x3-10-18": (4, 3, 30, (10, 18), 20, 0.06, *slanted),
        "robot-four-sided-3x3-16-24": (4, 3, 36, (16, 24), 20, 0.06, *slanted),
        "robot-objects-two-sided-5x5-20-24": (2, 5, 30, (20, 24), 20, 0.06, *columns),
        "robot-objects-two-sided-5x5-30-34": (2, 5, 40, (30, 34), 20, 0.06, *columns),
        "robot-objects-two-sided-6x6-30-34": (2, 6, 40, (30, 34), 20, 0.06, *columns),
    }
    found = {
        name: (
            t.num_sides,
            t.grid,
            t.num_nodes,
            t.block_range,
            t.num_actions,
            t.pitch,
            t.layout,
            t.reward,
            t.discount,
        )
        for name, t in ROBOTS.items()
        if not t.aisle
    }
    assert found == wanted
    for task in [task for task in ROBOTS.values() if not task.aisle]:
        assert (task.success_threshold, task.max_initial_cover) == (0.75, 0.6)
        assert (task.cover_filter, task.normalise_initial, task.touching) == ("wide", False, False)
        assert task.objects == ("set-26" if "objects" in task.name else "cubes")
    for task in PRESETS.values():
        if task.name not in ROBOTS:
            assert (task.pitch, task.cover_filter, task.normalise_initial) == (EDGE, "narrow", True)
            assert task.action_mode == "turns"


def test_the_twin_differs_from_the_one_sided_cell_by_the_robot_alone() -> None:
    twin, robot = (
        get_task("one-sided-5x5-15-17"),
        get_task("robot-one-sided-5x5-15-17").replace(arm="none"),
    )
    assert twin == robot.replace(
        name=twin.name,
        pitch=EDGE,
        cover_filter="narrow",
        normalise_initial=True,
        success_threshold=0.975,
        max_initial_cover=0.95,
    )
    assert (twin.num_actions, twin.block_range) == (robot.num_actions, robot.block_range)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"pitch": 0.049}, InputError, r"pitch: got 0\.049"),
        ({"pitch": 0.08}, InputError, "pitch"),
        ({"cover_filter": "wid"}, UnknownNameError, "did you mean 'wide'"),
        ({"action_mode": "grip"}, UnknownNameError, "did you mean 'grips'"),
        ({"rotations": 3}, InputError, "rotations: got 3, expected 1 or 4"),
        ({"layout": "randam"}, UnknownNameError, "did you mean 'random'"),
        ({"objects": "set-26", "layout": "random"}, InputError, "layout"),
    ],
)
def test_values_out_of_range_are_refused(change: dict, error: type, words: str) -> None:
    with pytest.raises(error, match=words):
        TWO.replace(**change)


# ---------------------------------------------------------------- lattice and cover


@given(seed=SEEDS, pitch=st.sampled_from([EDGE, 0.055, 0.06]), relation=st.integers(0, 4))
@settings(deadline=None)
def test_neighbours_are_a_pitch_apart_and_blocks_touch_above(
    seed: int, pitch: float, relation: int
) -> None:
    state = empty_state(1, 1, 3, 2)
    state.position[0, 0] = np.random.default_rng(seed).normal(size=3)
    step = np.array(target_cell(state, 0, 0, relation, pitch)) - state.position[0, 0]
    assert step == pytest.approx([pitch, pitch, EDGE] * DIRECTIONS[relation], abs=1e-12)


def test_sides_stand_where_the_lattice_has_its_cells() -> None:
    """With d = 0.06: bottom centres of two and of four sides."""
    assert side_frames(2, 0.06)[:, 2:].tolist() == [[0, 0], [0, 0.06]]
    assert side_frames(4, 0.06)[:, 2:].tolist() == [[0, 0], [0, 0.12], [0.06, 0.06], [-0.06, 0.06]]
    for task in ROBOTS.values():
        state = Simulator(task).new(50, np.random.default_rng(0))
        steps = state.position[:, 0, :2] / task.pitch
        assert np.abs(steps - np.rint(steps)).max() < 1e-12


@each_robot
def test_cover_is_relative_to_the_whole_target(task: Task) -> None:
    """F = c / A from the start on; no more than 0.6 of it is covered then, and 0.75 is success."""
    sim, rng = Simulator(task), np.random.default_rng(1)
    state = sim.new(60, rng)
    assert (state.initial_pixels == 0).all()
    start = state.plane_coverage.copy()
    assert np.array_equal(start, state.plane_pixels / state.mask_pixels)
    assert ((start > 0) & (start <= 0.6)).all()
    before = state.plane_coverage.copy()
    good = sim.physics_mask(state)
    actions = np.zeros((60, 3), np.int64)
    for row in range(60):
        choice = rng.choice(np.argwhere(good[row]))
        actions[row] = [0, *choice][-3:]
    step = sim.step(state, actions)
    gain = state.plane_coverage - before
    assert np.array_equal(step.success, state.complete_pixels / state.mask_pixels > 0.75)
    expected = (gain > 0).astype(float)
    if task.reward == "scaled":
        expected = 3 * np.maximum(gain, 0) + step.success
    assert step.reward == pytest.approx(expected)


def test_the_tolerant_camera_sees_blocks_that_stand_beside_their_places() -> None:
    """Faces 1 cm before and 2 cm behind the plane still count, and not with the narrow window."""
    for shift, wide, narrow in (
        (0.0, True, True),
        (-0.01, True, False),
        (0.02, True, False),
        (-0.04, False, False),
        (0.04, False, False),
    ):
        seen = {}
        for name in ("wide", "narrow"):
            sim = Simulator(TWO.replace(num_sides=1, num_nodes=15, cover_filter=name))
            state = sim.new(1, np.random.default_rng(0))
            state.position[0, 0] = 0, shift, 0.25
            state.num_placed[0] = 1
            recover_all(state, 0, sim.frames, sim.depths)
            image = state.covered[0, 0] & ~state.occluded[0, 0]
            state.position[0, 0, 0] = 9.0
            recover_all(state, 0, sim.frames, sim.depths)
            seen[name] = (image & ~(state.covered[0, 0] & ~state.occluded[0, 0])).any()
        assert seen == {"wide": wide, "narrow": narrow}, shift


# ---------------------------------------------------------------- random places


def test_cubes_at_random_places_keep_room_for_the_fingers() -> None:
    sim, rng = Simulator(RANDOM), np.random.default_rng(5)
    state = sim.new(400, rng)
    behind = []
    for row in range(400):
        waiting = state.position[row, 1 : state.num_blocks[row]]
        assert (waiting[:, 2] == HALF).all()
        assert ((np.abs(waiting[:, 1]) >= 0.15) & (np.abs(waiting[:, 1]) <= 0.35)).all()
        assert (np.abs(waiting[:, 0] + 0.07) <= 0.28828).all()
        gap = np.linalg.norm(waiting[:, None] - waiting, axis=-1) + np.eye(len(waiting))
        assert gap.min() >= 0.095
        behind.append((waiting[:, 1] > 0).mean())
    assert abs(np.mean(behind) - 0.5) < 0.03
    # The first is drawn before anything is in its way.
    first = state.position[:, 1]
    across, along = (first[:, 0] + 0.07) / 0.57656 + 0.5, (np.abs(first[:, 1]) - 0.15) / 0.2
    assert stats.kstest(across, "uniform").pvalue > 1e-3
    assert stats.kstest(along, "uniform").pvalue > 1e-3
    again = sim.new(400, np.random.default_rng(5))
    assert np.array_equal(again.position, state.position)
    other = Simulator(TWO).new(400, np.random.default_rng(5))
    assert not np.array_equal(other.position[:, 1], first)


def test_who_is_too_near_is_pushed_away_from_the_structure() -> None:
    """Offsets in y of whole edges from what was drawn, unless that led beyond 0.35 m."""
    places, pushed = np.zeros((14, 3)), 0
    for seed in range(200):
        assert scatter(np.random.default_rng(seed), places, 0.095)
        copy = np.random.default_rng(seed)
        for x, y, _ in places:
            drawn_x = -0.07 + (2 * copy.random() - 1) * 0.28828
            drawn_y, sign = 0.15 + 0.2 * copy.random(), 1 if copy.random() < 0.5 else -1
            if drawn_x != x:
                break  # Drawn again; the numbers no longer correspond.
            steps = (sign * y - drawn_y) / EDGE
            assert steps >= -1e-9
            assert steps == pytest.approx(round(steps), abs=1e-9)
            pushed += round(steps) > 0
    assert pushed > 50


def test_a_place_for_too_many_cubes_is_not_searched_for_ever() -> None:
    crowd = RANDOM.replace(name="crowd", num_nodes=200)
    with pytest.raises(Learn2AssembleError, match="crowd: no acceptable"):
        Simulator(crowd).new(1, np.random.default_rng(0))


def test_rows_and_columns_of_the_robot_cells() -> None:
    """The first numbers written out; see also the recorded first steps."""
    x = 0.384375 * np.array([0, 0.5, -0.5, -0.25, 0.75, 0.25]) - 0.076875
    rows = waiting_places("slanted-rows", 13).position
    assert rows[:6] == pytest.approx(np.stack([x, 0 * x - 0.15, 0 * x + HALF], -1))
    assert rows[6:12] == pytest.approx(rows[:6] - np.array([0.025, 0.1, 0]))
    assert rows[12] == pytest.approx(rows[0] - np.array([0.05, 0.2, 0]))
    columns = waiting_places("columns", 7)
    assert columns.apart == 0.07
    assert columns.position[:6] == pytest.approx(np.stack([x, 0 * x - 0.15, 0 * x], -1))
    assert columns.position[6] == pytest.approx(columns.position[0])


# ---------------------------------------------------------------- actions


def test_grips_turn_objects_as_the_protocol_says() -> None:
    """(grasp, place) yaws AA, AB, BA, BB: net rotation 0, -90, +90, 0 degrees."""
    spec = get_action_spec("grips", 4, 0.06)
    degrees = {0: 0, 1: 90, 2: 180, 3: -90}
    assert [degrees[turns] for turns in spec.turns.tolist()] == [0, -90, 90, 0]
    assert spec.grips.tolist() == [0, 1, 2, 3]
    assert spec.level
    assert (spec.num_grips, get_action_spec("turns", 4).num_grips) == (4, 1)
    assert not get_action_spec("turns", 4).level
    assert len(get_action_spec("turns", 1).turns) == len(get_action_spec("grips", 1).turns) == 1


def test_for_a_cube_the_grip_decides_nothing_without_an_arm() -> None:
    sim = Simulator(TWO)
    state = sim.new(1, np.random.default_rng(3))
    for relation in range(5):
        after = []
        for way in range(4):
            world = state.copy()
            after.append((sim.step(world, np.array([[2, 0, 4 * relation + way]])), world))
        for step, world in after[1:]:
            assert all(np.array_equal(a, b) for a, b in zip(step, after[0][0], strict=True))
            assert all(np.array_equal(a, b) for a, b in zip(world, after[0][1], strict=True))


@given(seed=SEEDS, action=st.integers(0, 19))
@settings(deadline=None, max_examples=80)
def test_an_object_stands_at_the_level_of_its_reference(seed: int, action: int) -> None:
    """Its lowest cell does, whichever is chosen; the others keep their places around it."""
    sim, rng = Simulator(OBJECTS), np.random.default_rng(seed)
    state = sim.new(1, rng)
    waiting = int(state.num_unplaced[0])
    chosen = int(rng.integers(waiting))
    ids, start = state.object_id[0, 1 : 1 + waiting], state.position[0, 1 : 1 + waiting].copy()
    members = np.flatnonzero(ids == ids[chosen])
    assert start[members, 2].min() == 0, "planned from the table, not from the centres of cells"
    origin = state.position[0, 0].copy()
    sim.step(state, np.array([[chosen, 0, action]]))
    relation, way = divmod(action, 4)
    placed = state.position[0, 1 : 1 + len(members)]
    step = [0.06, 0.06, EDGE] * DIRECTIONS[relation]
    assert placed[0, :2] == pytest.approx((origin + step)[:2])
    assert placed[:, 2].min() == pytest.approx(origin[2] + step[2])
    for cell, k in zip(placed, [chosen, *members[members != chosen]], strict=True):
        offset = start[k] - start[chosen]
        offset[:2] = quarter_turn(offset[0], offset[1], (0, 3, 1, 0)[way])
        assert cell - placed[0] == pytest.approx(offset, abs=1e-9)


# ---------------------------------------------------------------- balance on a wider lattice

PITCHES = st.sampled_from([0.055, 0.06])


@given(
    columns=st.lists(st.tuples(st.integers(0, 2), st.integers(0, 2)), min_size=1, max_size=12),
    cell=st.tuples(st.integers(0, 3), st.integers(0, 2), st.integers(0, 4)),
    pitch=PITCHES,
)
@settings(deadline=None, max_examples=60)
def test_the_column_rule_holds_where_columns_do_not_touch(
    columns: list[tuple[int, int]], cell: tuple[int, int, int], pitch: float
) -> None:
    cells = [(x, y, columns[:k].count((x, y))) for k, (x, y) in enumerate(columns)]
    assume(cell not in cells)
    centres = np.array([*cells, cell], float) * [pitch, pitch, EDGE] + [0, 0, HALF]
    verdict = classify_cube(centres, len(cells), *centres[-1].tolist(), HALF)
    assert verdict in (STABLE, FLOATING)
    assert (verdict == STABLE) == (cell[2] == columns.count(cell[:2]))
    assert (verdict == STABLE) == is_stable(centres, np.arange(len(centres)))


def pile(pitch: float, *objects: list[tuple[int, int, int]]) -> State:
    """A state in which the objects (in cells, level 0 on the table) are placed."""
    cells = [cell for one in objects for cell in one]
    state = empty_state(1, 1, 3, len(cells) + 1)
    spacing = [pitch, pitch, EDGE]
    state.position[0, : len(cells)] = spacing * np.array(cells, float) + [0, 0, HALF]
    state.object_id[0] = len(objects)
    state.object_id[0, : len(cells)] = [k for k, one in enumerate(objects) for _ in one]
    state.num_placed[0], state.num_blocks[0] = len(cells), len(cells) + 1
    return state


def verdicts(
    pitch: float, *objects: list[tuple[int, int, int]]
) -> tuple[PlacementVerdict, PlacementVerdict, bool]:
    """What static and rigid physics and the equilibrium program say of the last object."""
    state = pile(pitch, *objects)
    count = int(state.num_placed[0])
    program = is_stable(state.position[0, :count], state.object_id[0, :count])
    static = StaticPhysics().settle(state, np.array([0]))[0]
    rigid = RigidPhysics("object", pitch=pitch).settle(state, np.array([0]))[0]
    return PlacementVerdict(static), PlacementVerdict(rigid), program


L = [(1, 0, 1), (0, 0, 1), (0, 0, 2)]
"""A standing L one level up; its corner stands over (0, 0)."""
HOLDS, FALLS = (
    (PlacementVerdict.STABLE, PlacementVerdict.STABLE, True),
    (PlacementVerdict.UNSTABLE, PlacementVerdict.UNSTABLE, False),
)


def test_an_object_on_a_wider_lattice_needs_support_under_its_centre_of_mass() -> None:
    """At 6 cm the centre of an L with its filler is 22.5 mm from its corner: within the cube under
    it, but not within the one under its end; that of a bar, 30 mm, is beyond either."""
    assert verdicts(0.06, [(0, 0, 0)], L) == HOLDS
    assert verdicts(0.06, [(1, 0, 0)], L) == FALLS
    assert verdicts(0.06, [(0, 0, 0)], [(0, 0, 1), (1, 0, 1)]) == FALLS
    assert verdicts(0.06, [(0, 0, 0)], [(1, 0, 0)], [(0, 0, 1), (1, 0, 1)]) == HOLDS
    assert verdicts(0.06, [(2, 0, 0)], L)[:2] == (
        PlacementVerdict.FLOATING,
        PlacementVerdict.FLOATING,
    )


def test_the_filler_weighs_as_much_as_a_cube() -> None:
    """At 7 cm the centre of an L is 23.3 mm from its corner without the filler, 26.3 mm with it:
    beyond the edge of the cube that carries it."""
    assert verdicts(0.07, [(0, 0, 0)], L) == FALLS
    cells = pile(0.07, L).position[0, :3]
    out = np.empty((6, 3))
    assert find_fillers(cells, 0, 3, HALF, out) == 1
    assert out[0] == pytest.approx((cells[0] + cells[1]) / 2)
    assert find_fillers(pile(EDGE, L).position[0, :3], 0, 3, HALF, out) == 0
    flat = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)]
    assert find_fillers(pile(0.06, flat).position[0, :4], 0, 4, HALF, np.empty((8, 3))) == 4
    standing = [(0, 0, 0), (0, 0, 1), (0, 0, 2)]
    assert find_fillers(pile(0.06, standing).position[0, :3], 0, 3, HALF, out) == 0
    parts = object_parts(np.array(L), 0.06)
    assert len(parts.fillers) == 1
    assert parts.sizes[0] == pytest.approx([0.005, HALF - 1.5e-4, HALF])
    assert np.concatenate([parts.cells, parts.fillers]).mean(0) == pytest.approx(0)
    model = compile_model((tuple(L),), pitch=0.06)
    assert model.body_mass[1] == pytest.approx(4 * MASS)
    assert model.body_ipos[1] == pytest.approx(0, abs=1e-12)
    assert (model.geom_type[1:] == mujoco.mjtGeom.mjGEOM_BOX).all()
    assert len(compile_model((tuple(L),)).geom_type) == 4


def random_pile(rng: np.random.Generator, count: int) -> State:
    """A structure of about ``count`` cells of which only the object placed last may not hold."""
    sim = Simulator(OBJECTS)
    state, physics, spec = sim.new(1, rng), StaticPhysics(), sim.action_spec
    for _ in range(200):
        trial = state.copy()
        reference, way = int(rng.integers(trial.num_placed[0])), int(rng.integers(4))
        relation = int(rng.choice([0, 0, 1, 2, 3, 4]))
        chosen = int(rng.integers(trial.num_unplaced[0]))
        x, y, z = target_cell(trial, 0, reference, relation, spec.pitch)
        z += waiting_level(trial.position[0, trial.num_placed[0] + chosen, 2])
        move_block(trial, 0, chosen, reference, x, y, z, spec.turns[way], spec.pitch)
        if trial.num_placed[0] >= min(count, trial.num_blocks[0] - 4):
            return trial
        if physics.settle(trial, np.array([0]))[0] == STABLE:
            state = trial
    raise AssertionError


@given(seed=SEEDS, count=st.integers(2, 16))
@example(seed=329109, count=16)
@settings(deadline=None, max_examples=60)
def test_both_proofs_agree_with_the_equilibrium_program(seed: int, count: int) -> None:
    state = random_pile(np.random.default_rng(seed), count)
    placed = int(state.num_placed[0])
    cells, ids = state.position[0, :placed], state.object_id[0, :placed]
    found = classify_object(state.position[0], last_object(state, 0), placed, HALF)
    # Objects below have been found to stand within the tolerance of their balance.
    if found == STABLE:
        assert is_stable(cells, ids, slack=BALANCE_TOLERANCE)
    if found == UNSTABLE:
        assert not is_stable(cells, ids)


def test_static_and_rigid_agree_on_random_objects() -> None:
    rng, found = np.random.default_rng(3), Counter()
    static, rigid = StaticPhysics(), RigidPhysics(OBJECTS.stability, pitch=OBJECTS.pitch)
    for _ in range(200):
        state = random_pile(rng, 12)
        verdict = static.settle(state, np.array([0]))[0]
        assert verdict == rigid.settle(state, np.array([0]))[0]
        found[PlacementVerdict(int(verdict))] += 1
    assert found[PlacementVerdict.STABLE] > 30
    assert found[PlacementVerdict.UNSTABLE] > 0


def test_an_object_off_its_lattice_is_refused_by_rigid_physics() -> None:
    state = pile(0.06, [(0, 0, 0)], [(1, 0, 0), (2, 0, 0)])
    with pytest.raises(InputError, match="cells on one 5 cm lattice"):
        RigidPhysics("object").settle(state, np.array([0]))
    assert (
        RigidPhysics("object", pitch=0.06).settle(state, np.array([0]))[0]
        == PlacementVerdict.STABLE
    )


def test_every_shape_stands_on_the_table() -> None:
    for shape in SHAPES.values():
        lowest = min(z for _, _, z in shape.cells)
        cells = [(x, y, z - lowest) for x, y, z in shape.cells]
        assert verdicts(0.06, [(5, 5, 0)], cells) == HOLDS


# ---------------------------------------------------------------- learning and search

SMALL = TWO.replace(name="small", grid=2, num_nodes=14, min_mask_pixels=20)


@pytest.mark.parametrize("task", [SMALL, OBJECTS], ids=["cubes", "objects"])
@pytest.mark.parametrize("name", ["published", "relational"])
def test_networks_learn_and_search_there(task: Task, name: str) -> None:
    config = dataclasses.replace(
        fit_to(CONFIGS[name], task), num_envs=3, initial_samples=6, batch_size=4, replay_size=40
    )
    trainer = Trainer(task, config, 0)
    before = [p.clone() for p in trainer.online.parameters()]
    for _ in range(4):
        trainer.round()
    assert any(not a.equal(b) for a, b in zip(trainer.online.parameters(), before, strict=True))
    assert trainer.updates > 0
    state = trainer.simulator.new(2, np.random.default_rng(1))
    before_search = state.copy()
    how = SearchConfig(budget=6, distinct=True)
    for row, decision in enumerate(search(trainer.model, state, how, np.random.default_rng(0))):
        limits = state.num_unplaced[row], state.num_placed[row], task.num_actions
        assert ((decision.action >= 0) & (decision.action < limits)).all()
        assert len(decision.explored()) == 6
    assert all(np.array_equal(a, b) for a, b in zip(state, before_search, strict=True))


# ---------------------------------------------------------------- what is not known there yet


@each_robot
def test_what_needs_touching_blocks_says_so(task: Task) -> None:
    """Symmetries are those of touching blocks."""
    fitted = fit_to(CONFIGS["published"], task)
    assert not fitted.augment
    assert fitted.network.action_mode == task.action_mode
    assert fitted.network.pitch == task.pitch
    assert fitted.network.num_actions == task.num_actions
