"""The kinematic cell: columns, collisions, typed outcomes."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.constants import HALF
from learn2assemble.errors import UnknownNameError
from learn2assemble.geometry.rotations import yaw_quaternion
from learn2assemble.kinematics.approach import ApproachCache, tool_path
from learn2assemble.kinematics.cell import Attempt, KinematicCell
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.kinematics.collisions import BlockChecker
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.grasps import GRASP_SETS, Attitude, get_grasps
from learn2assemble.robot.holding import why_not_held
from learn2assemble.robot.moves import (
    BASE_THERE,
    OPENING,
    Move,
    Outcome,
    Scene,
    carried,
    crossing_height,
    fillers,
    put_down,
)
from robot_scenes import GROUND, box, cell, check_hit, hands, scene

AA, AB, BA, BB = get_grasps("paper")


@pytest.fixture(scope="module")
def panda() -> KinematicCell:
    return KinematicCell(get_arm("panda"), num_cells=16)


@pytest.fixture(scope="module")
def ur5e() -> KinematicCell:
    return KinematicCell(get_arm("ur5e"), num_cells=16)


# ---------------------------------------------------------------- attitudes and columns


def test_attitudes_close_along_the_axes_of_the_paper() -> None:
    np.testing.assert_array_equal(abs(AA.grasp.rotation()[:, 1]), [0, 1, 0])
    np.testing.assert_array_equal(abs(BB.grasp.rotation()[:, 1]), [1, 0, 0])
    for pair in (AA, AB, BA, BB):
        np.testing.assert_array_equal(pair.grasp.rotation()[:, 2], [0, 0, -1])
    # Net turns of 0, -90, 90 and 0 degrees.
    turns = [pair.place.yaw - pair.grasp.yaw for pair in (AA, AB, BA, BB)]
    np.testing.assert_allclose(np.degrees(turns), [0, -90, 90, 0])


@pytest.mark.parametrize("name", GRASP_SETS)
def test_rotations_are_proper_and_the_tool_points_down(name: str) -> None:
    for attitude in {a for pair in get_grasps(name) for a in pair}:
        rotation = attitude.rotation()
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1)
        assert rotation[2, 2] < -0.8
        # Exchanging the fingers turns the closing axis round and leaves the approach.
        other = attitude._replace(yaw=attitude.yaw + np.pi)
        np.testing.assert_allclose(other.rotation()[:2, 1], -rotation[:2, 1], atol=1e-12)


def test_unknown_grasp_sets_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="paper"):
        get_grasps("papper")


@given(st.floats(-0.6, 0.6), st.floats(0, 0.02), st.floats(-math.pi, math.pi))
def test_the_hand_leans_and_keeps_off_along_its_approach(
    tilt: float, depth: float, yaw: float
) -> None:
    attitude = Attitude(yaw, tilt, depth)
    centre = np.array([0.1, -0.2, 0.3])
    poses = tool_path(centre, attitude, 0.5)
    away = poses.position[0] - centre
    np.testing.assert_allclose(away, -depth * poses.rotation[:, 2], atol=1e-12)
    near = np.diff(poses.position[:4], axis=0)
    along = near / np.linalg.norm(near, axis=1)[:, None]
    np.testing.assert_allclose(along, np.tile(-poses.rotation[:, 2], (3, 1)), atol=1e-9)
    assert (np.diff(poses.position[:, 2]) > 0).all()
    assert poses.position[-1, 2] == pytest.approx(0.5)


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_columns_reach_their_poses_on_one_branch(name: str) -> None:
    arm = get_arm(name)
    approaches = ApproachCache(arm)
    for x, y in ((0.0, 0.0), (0.1, 0.12), (-0.15, -0.2)):
        centre = np.array([x, y, GROUND])
        joints = approaches.solve(centre, AA.grasp, 0.3)
        assert not isinstance(joints, str), joints
        assert arm.inside_limits(joints).all()
        poses = tool_path(centre, AA.grasp, 0.3)
        for q, position in zip(joints, poses.position, strict=True):
            where, rotation = forward(get_chain(arm), q)
            np.testing.assert_allclose(where, position, atol=1e-5)
            np.testing.assert_allclose(rotation, poses.rotation, atol=1e-5)
        assert abs(np.diff(joints, axis=0)).max() < 0.6
        assert approaches.solve(centre, AA.grasp, 0.3) is joints


# ---------------------------------------------------------------- scenes


def test_crossing_height_clears_what_stands_and_what_hangs() -> None:
    low = scene([(0, 0, 0)], [(3, -3, 0)])
    tall = scene([(0, 0, k) for k in range(5)], [(3, -3, 0)])
    pair = scene([(0, 0, 0)], [(3, -3, 0), (3, -3, 1)], [0, 1, 1])
    move = Move(1, cell(1, 0, 0), *AA)
    base = crossing_height(low, move)
    assert crossing_height(tall, move._replace(cell=5)) == pytest.approx(base + 0.2)
    assert crossing_height(pair, move._replace(cell=2)) == pytest.approx(base + 0.05)


def test_ways_lead_past_what_stands_at_the_side_and_above_what_is_between() -> None:
    places = [(-4, 4, k) for k in range(5)] + [(2, -1, k) for k in range(5)] + [(0, 0, 0)]
    every = scene(places, [(3, -3, 0)])
    move = Move(11, cell(1, 0, 0), *AA)
    height = crossing_height(every, move)
    aside = np.arange(12) < 5
    far = every._replace(aside=aside)
    # What is between both places counts, whether it is said to stand at the side or not.
    assert crossing_height(far, move) == height
    assert crossing_height(every._replace(aside=np.arange(12) < 10), move) == height
    # The base of another arm does not: no way leads above that.
    base = np.where(np.arange(12) < 10, BASE_THERE, 0)
    assert crossing_height(every._replace(aside=base), move) == pytest.approx(height - 0.2)
    # Without that, what is at the side does not.
    few = far.rows(np.array([0, 1, 2, 3, 4, 10, 11]), 6)
    assert few.aside is not None
    assert crossing_height(few, move._replace(cell=6)) == pytest.approx(height - 0.2)
    assert crossing_height(few._replace(aside=None), move._replace(cell=6)) == height


def test_put_down_lists_the_object_last_with_the_grasped_cell_first() -> None:
    before = scene([(0, 0, 0)], [(2, -3, 0), (3, -3, 0), (4, -3, 0), (6, -3, 0)], [0, 1, 2, 2, 3])
    after = put_down(before, Move(3, cell(0, 1, 0), *AB))
    assert after.num_placed == 3
    assert after.object_id.tolist() == [0, 2, 2, 1, 3]
    np.testing.assert_allclose(after.position[1], cell(0, 1, 0))
    # The other cell lay to the left; a quarter turn to the right puts it behind.
    np.testing.assert_allclose(after.position[2], cell(0, 2, 0), atol=1e-12)
    np.testing.assert_allclose(after.position[3:], before.position[[1, 4]])


@given(st.integers(0, 3), st.integers(0, 2))
def test_carried_objects_stay_rigid(turns: int, grasped: int) -> None:
    shape = [(5, -3, 0), (6, -3, 0), (6, -3, 1)]
    before = scene([(0, 0, 0)], shape, [0, 1, 1, 1])
    place = Attitude(yaw=-turns * math.pi / 2)
    move = Move(1 + grasped, cell(0, 0, 1), AA.grasp, place)
    members = before.members(move.cell)
    position, quaternion = carried(before, move, members)
    np.testing.assert_allclose(position[0], move.target)
    start = before.position[members]
    for a in range(3):
        for b in range(3):
            np.testing.assert_allclose(
                np.linalg.norm(position[a] - position[b]), np.linalg.norm(start[a] - start[b])
            )
    np.testing.assert_allclose(quaternion, yaw_quaternion(np.full(3, -turns * math.pi / 2)))


def test_fillers_join_horizontal_neighbours_of_one_object() -> None:
    cells = scene([(0, 0, 0)], [(5, -3, 0), (6, -3, 0), (6, -3, 1), (7, -3, 0)], [0, 1, 1, 1, 2])
    assert fillers(cells.position, cells.object_id).tolist() == [[1, 2]]
    alone = scene([(0, 0, 0)], [(1, 0, 0)])
    assert len(fillers(alone.position, alone.object_id)) == 0


# ---------------------------------------------------------------- collisions against MuJoCo


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10**9))
def test_collisions_agree_with_distances_of_all_pairs(seed: int) -> None:
    """The verdict of broad phase, masks and exclusions against every pair of geoms by itself."""
    rng = np.random.default_rng(seed)
    arm = get_arm("panda")
    model = BlockChecker(arm, 4)
    position = rng.uniform([-0.4, -0.3, 0.0], [0.2, 0.3, 0.5], (4, 3))
    model.place(Scene(position, rng.uniform(-3, 3, 4), np.array([0, 1, 2, 2]), 1))
    model.carry(np.array([[0.0, 0.0, 0.0]]), np.zeros(1, np.int64))
    joints = rng.uniform(arm.lower, arm.upper)
    model.opening = OPENING
    hit = model.check(joints)
    m, d = model.model, model.data
    mujoco.mj_kinematics(m, d)

    def name(geom: int) -> str:
        return m.body(m.geom_bodyid[geom]).name

    thing = ("table", "block", "filler")
    things = [g for g in range(m.ngeom) if name(g).startswith(thing)]
    held = [g for g in range(m.ngeom) if name(g).startswith("what is held")]
    links = [g for g in range(m.ngeom) if g not in (*things, *held) and m.geom_group[g] == 3]
    nearest = min(
        mujoco.mj_geomDistance(m, d, a, b, 0.05, None)
        for a in (*links, *held)
        for b in things
        if name(a) != "link0"  # the base and what stands on the table cannot meet
    )
    if abs(nearest) < 1e-5:
        return
    if nearest < 0:
        assert hit is not None
    elif hit is not None:
        # Only the arm itself is left.
        assert not hit.other.startswith(thing)


# ---------------------------------------------------------------- outcomes


def outcome(found: Attempt) -> tuple[Outcome, str]:
    return found.outcome, found.stage


@pytest.mark.parametrize("pair", [AA, AB, BA, BB])
def test_a_block_on_a_block_is_reached(
    panda: KinematicCell, ur5e: KinematicCell, pair: tuple
) -> None:
    world = scene([(0, 0, 0)], [(-1, -4, 0), (1, -4, 0)])
    for arm in (panda, ur5e):
        found = arm.attempt(world, Move(1, cell(0, 0, 1), *pair))
        assert outcome(found) == (Outcome.REACHED, "")
        assert found.pick is not None
        assert arm.arm.inside_limits(found.pick).all()


def test_far_places_are_unreachable(panda: KinematicCell) -> None:
    world = scene([(0, 0, 0)], [(1, -4, 0), (14, 0, 0)])
    for number, target, stage in ((1, cell(14, 0, 0), "place"), (2, cell(0, 0, 1), "pick")):
        found = panda.attempt(world, Move(number, target, *AA))
        assert outcome(found) == (Outcome.UNREACHABLE, stage)
        assert "out of reach" in found.detail


def test_a_neighbour_on_the_closing_axis_is_in_the_way(panda: KinematicCell) -> None:
    # At y the neighbour stands where a finger has to go, at x there is room.
    waiting = scene([(0, 0, 0)], [(2, -4, 0), (2, -5, 0)])
    found = panda.attempt(waiting, Move(1, cell(0, 0, 1), *AA))
    assert outcome(found) == (Outcome.GRASP_COLLISION, "pick")
    assert "finger touches block 2" in found.detail
    assert panda.attempt(waiting, Move(1, cell(0, 0, 1), *BB)).reached
    wall = scene([(0, 0, 0)], [(2, -4, 0)])
    found = panda.attempt(wall, Move(1, cell(0, 1, 0), *AA))
    assert found.outcome == Outcome.PLACE_COLLISION
    assert panda.attempt(wall, Move(1, cell(0, 1, 0), *AB)).reached


def test_a_higher_neighbour_on_the_closing_axis_stops_the_hand(panda: KinematicCell) -> None:
    world = scene([(0, 0, 0), (2, 0, 0), (2, 0, 1), (2, 0, 2)], [(0, -4, 0)])
    blocked = panda.attempt(world, Move(4, cell(0, 0, 1), *BB))
    assert blocked.outcome == Outcome.PLACE_COLLISION
    assert panda.attempt(world, Move(4, cell(0, 0, 1), *BA)).reached


@pytest.mark.parametrize(
    ("target", "other"), [((0, 0, 0), "block 0"), ((2, 0, -1), "table"), ((0, 0, 0.5), "block 0")]
)
def test_occupied_and_sunken_cells_collide(panda: KinematicCell, target: tuple, other: str) -> None:
    world = scene([(0, 0, 0)], [(0, -4, 0)])
    found = panda.attempt(world, Move(1, cell(*target), *AA))
    assert outcome(found) == (Outcome.PLACE_COLLISION, "place")
    assert found.detail.endswith(other)


def test_objects_are_grasped_by_any_cell_the_hand_can_get_at(panda: KinematicCell) -> None:
    upright = scene([(0, 0, 0)], [(1, -4, 0), (1, -4, 1)], [0, 1, 1])
    upper = panda.attempt(upright, Move(2, cell(0, -1, 1), *BB))
    assert upper.reached
    lower = panda.attempt(upright, Move(1, cell(0, -1, 0), *BB))
    assert lower.outcome == Outcome.GRASP_COLLISION
    assert "block 2" in lower.detail
    lying = scene([(0, 0, 0)], [(1, -4, 0), (2, -4, 0)], [0, 1, 1])
    # Across the object there is room; along it, its own other cell is in the way.
    assert panda.attempt(lying, Move(1, cell(1, 0, 0), *AA)).reached
    assert panda.attempt(lying, Move(1, cell(1, 0, 0), *BB)).outcome == Outcome.GRASP_COLLISION


def test_what_is_carried_does_not_meet_the_base() -> None:
    arm = get_arm("panda")
    model = BlockChecker(arm, 1)
    joints = arm.home
    position, rotation = forward(get_chain(arm), joints)
    model.place(Scene(np.array([[0.5, 0.4, 0.025]]), np.zeros(1), np.zeros(1, int), 1))
    model.opening = OPENING
    assert model.check(joints) is None
    # A long object that reaches from the hand into the base.
    base = (arm.base_position + np.array([0.0, 0.0, 0.06]) - position) @ rotation
    model.carry(base[None], np.zeros(1, np.int64))
    assert model.check(joints) is not None


def test_what_hangs_from_the_hand_collides(panda: KinematicCell) -> None:
    """A vertical pair held by its upper cell: its lower one hits what the hand would clear."""
    world = scene([(0, 0, 0), (0, 0, 1)], [(1, -4, 0), (1, -4, 1)], [0, 1, 2, 2])
    found = panda.attempt(world, Move(3, cell(0, 0, 2), *BB))
    assert found.outcome == Outcome.PLACE_COLLISION
    assert found.detail.startswith("what is held")
    assert panda.attempt(world, Move(3, cell(0, 0, 3), *BB)).reached


def test_an_attempt_leaves_the_scene_alone_and_forgets_the_last(panda: KinematicCell) -> None:
    world = scene([(0, 0, 0)], [(1, -4, 0), (1, -4, 1), (-1, -4, 0)], [0, 1, 1, 2])
    before = [np.copy(field) for field in world]
    orders = [
        (world, Move(n, cell(*to), *pair))
        for n, to, pair in (
            (2, (0, 0, 2), AA),
            (3, (0, 0, 1), BB),
            (1, (0, 0, 1), AA),
            (3, (1, 0, 0), AB),
        )
    ]
    first = [panda.attempt(*order) for order in orders]
    again = [panda.attempt(*order) for order in orders[::-1]][::-1]
    assert [outcome(a) for a in first] == [outcome(a) for a in again]
    fresh = KinematicCell(get_arm("panda"), num_cells=16)
    assert [outcome(a) for a in (fresh.attempt(*order) for order in orders)] == [
        outcome(a) for a in first
    ]
    for field, old in zip(world, before, strict=True):
        np.testing.assert_array_equal(field, old)


# ---------------------------------------------------------------- boxes of any size, tools


@pytest.mark.parametrize("sized", [False, True])
def test_many_moves_in_one_scene_are_judged_as_each_alone(sized: bool) -> None:
    """What a move took away, or put down, is where the scene has it when the next one begins: two
    blocks can come to one place one after the other, and neither where the other one waits."""
    there = scene([(0, 0, 0)], [(-2, -4, 0), (2, -4, 0)])
    if sized:
        there = there._replace(half=np.full((3, 3), HALF))
    place, waits = cell(0, 0, 1), there.position[2]
    tries = [(1, place), (2, place), (1, waits), (2, cell(0, -4, 0)), (1, place), (1, waits)]
    kept = KinematicCell(get_arm("panda"))
    judged = list[tuple[Outcome, str]]()
    for number, target in tries:
        move = Move(number, target, *BB)
        alone, found = (one.attempt(there, move) for one in (KinematicCell(kept.arm), kept))
        judged.append(outcome(found))
        assert judged[-1] == outcome(alone)
        for a, b in ((alone.pick, found.pick), (alone.place, found.place)):
            assert (a is None) == (b is None)
            assert a is None or np.array_equal(a, b)
    assert [found == Outcome.REACHED for found, _ in judged] == [1, 1, 0, 1, 1, 0]


def row(gap: float, target: int, size: tuple[float, float, float]) -> tuple[Scene, np.ndarray]:
    """Nine boxes in a 3 x 3 field with joints of ``gap`` [m], but one waits; and its place."""
    half = np.array(size) / 2
    cells = [(x, y) for y in (-1, 0, 1) for x in (-1, 0, 1)]
    position = np.array([[*(np.array(c) * (2 * half[:2] + gap)), half[2]] for c in cells])
    place = position[target].copy()
    order = [k for k in range(9) if k != target] + [target]
    position[target] = [0.05, -0.3, half[2]]
    sizes = np.tile(half, (9, 1))
    return Scene(position[order], np.zeros(9), np.arange(9), 8, sizes), place


@pytest.mark.parametrize("name", ["panda", "ur5e"])
@pytest.mark.parametrize("gap", [1e-4, 5e-4])
def test_a_cup_fills_the_hole_that_fingers_cannot(name: str, gap: float) -> None:
    world, place = row(gap, 4, (0.1, 0.05, 0.05))
    for tool, wanted in (("suction", Outcome.REACHED), ("gripper", Outcome.PLACE_COLLISION)):
        arm = KinematicCell(get_arm(name, tool))
        found = [arm.attempt(world, Move(8, place, a, a)) for a in hands(arm.arm, HALVES)]
        assert found
        assert {one.outcome for one in found} == {wanted}, found[0].detail
    # Two millimetres to the side, it would stand in its neighbour.
    for tool, off in (("suction", [0.003, 0, 0]), ("suction", [0, 0, -0.003])):
        arm = KinematicCell(get_arm(name, tool))
        grasp = hands(arm.arm, HALVES)[0]
        found_off = arm.attempt(world, Move(8, place + off, grasp, grasp))
        assert found_off.outcome == Outcome.PLACE_COLLISION
        assert found_off.detail.startswith("what is held")


HALVES = np.array([0.05, 0.025, 0.025])


def test_attitudes_fit_the_box_and_the_tool() -> None:
    panda, cup = get_arm("panda"), get_arm("panda", "suction")
    cube = hands(panda, np.full(3, 0.025))
    middle = [a for a in cube if a.aside == (0.0, 0.0, 0.0)]
    assert cube[:2] == middle, "in the middle of a face first"
    assert [round(a.yaw / math.pi * 2) for a in middle] == [0, 1]
    assert all(0 < abs(a.aside[0]) < 0.025 and a.aside[1:] == (0.0, 0.0) for a in cube[2:])
    assert {a.yaw for a in hands(panda, HALVES)} == {0.0}
    tall = hands(panda, np.array([0.02, 0.02, 0.1]))
    assert {round(a.depth, 9) for a in tall} == {0.075}
    flat = hands(panda, np.array([0.02, 0.02, 0.006]))
    assert flat
    assert all(0.006 > a.depth >= panda.gripper.tip - 0.006 for a in flat)
    assert not hands(panda, np.array([0.06, 0.06, 0.025]))
    assert [a.depth for a in hands(cup, HALVES)] == [0.025]
    assert not hands(cup, np.array([0.05, 0.014, 0.025]))
    assert why_not_held(cup, box(HALVES), 0.2) is None
    assert why_not_held(cup, box(HALVES), 2.0000004) is None  # 2 kg, of a mesh of single precision.
    assert "2.5 kg is too heavy for a cup that takes 2 kg" in str(
        why_not_held(cup, box(HALVES), 2.5)
    )
    assert "too small" in str(why_not_held(cup, box(HALVES * 0.5), 0.2))
    assert "no two faces" in str(why_not_held(panda, box(HALVES * 2), 0.2))


def test_a_load_beside_the_cup_is_refused() -> None:
    arm = KinematicCell(get_arm("panda", "suction"))
    half = np.array([[0.05, 0.05, 0.05], [0.05, 0.05, 0.05], [0.2, 0.05, 0.05]])
    position = np.array([[0.1, 0.1, 0.05], [-0.2, -0.3, 0.05], [0.05, -0.3, 0.05]])
    density = np.array([800.0, 100.0, 400.0])
    world = Scene(position, np.zeros(3), np.array([0, 1, 1]), 1, half, density)
    grasp = hands(arm.arm, half[1])[0]
    # 1.6 kg a quarter of a metre from the cup, and 0.1 kg under it.
    found = arm.attempt(world, Move(1, np.array([-0.2, 0.1, 0.05]), grasp, grasp))
    assert (found.outcome, found.stage) == (Outcome.GRASP_LOST, "lift")
    share = 9.81 * (1.7 + 1.6 * 0.25 / 0.015) / 42.4
    assert f"its weight is {100 * share:.0f} %" in found.detail


def test_an_object_may_have_many_boxes() -> None:
    """A grate of 25 bars, carried by one of them."""
    arm = KinematicCell(get_arm("ur5e", "suction"))
    grid = np.array([(x, y) for x in range(5) for y in range(5)]) - 2.0
    position = np.column_stack([0.05 * grid[:, 0], 0.05 * grid[:, 1] - 0.3, np.full(25, 0.02)])
    half = np.tile([0.025, 0.025, 0.02], (25, 1))
    position, half = np.vstack([[[0.0, 0.2, 0.05]], position]), np.vstack([[[0.05] * 3], half])
    world = Scene(position, np.zeros(26), np.array([0, *[1] * 25]), 1, half, np.full(26, 300.0))
    grasp = hands(arm.arm, half[13])[0]
    assert arm.attempt(world, Move(13, np.array([0.1, 0.05, 0.12]), grasp, grasp)).reached
    found = arm.attempt(world, Move(13, np.array([0.0, 0.05, 0.08]), grasp, grasp))
    assert found.outcome == Outcome.PLACE_COLLISION
    assert "what is held" in found.detail


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**9))
def test_boxes_collide_where_their_distances_say_so(seed: int) -> None:
    """After resizing, the broad phase must not miss what every pair of geoms by itself shows."""
    rng = np.random.default_rng(seed)
    arm = get_arm("panda", "suction")
    model = SIZED.setdefault("panda", BlockChecker(arm, 8, sized=True))
    count = int(rng.integers(2, 9))
    position = rng.uniform([-0.4, -0.3, 0.0], [0.2, 0.3, 0.5], (count, 3))
    half = rng.uniform(0.01, 0.2, (count, 3))
    yaw = rng.uniform(-3, 3, count)
    world = Scene(position, yaw, np.arange(count), 1, half)
    model.place(world)
    model.hang(world, np.zeros(1, np.int64), np.zeros((1, 3)), np.eye(3)[None])
    joints = rng.uniform(arm.lower, arm.upper)
    hit = model.check(joints)
    check_hit(model, hit, 1e-4)


SIZED: dict[str, BlockChecker] = {}
