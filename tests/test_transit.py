"""What is decided before the arm moves: columns of joint positions and free ways.

Joint paths and their time laws.
"""

from __future__ import annotations

import subprocess
import sys
from itertools import pairwise, product

import mujoco
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from learn2assemble.errors import InputError
from learn2assemble.handling.prepare import Course, Following, prepare
from learn2assemble.handling.ways import KEEP, STRIDE, WorldChecker, straight_or_tree
from learn2assemble.kinematics.approach import (
    JUMP,
    SPACING,
    ApproachPath,
    approach_path,
    approach_paths,
    on_path,
    tool_path,
)
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.kinematics.collisions import Collision
from learn2assemble.kinematics.inverse import solve
from learn2assemble.kinematics.joint_path import JointPath, joint_path
from learn2assemble.kinematics.time_law import (
    PathLimits,
    Segment,
    approach_speed_limits,
    limits_along,
    motion,
    reachable_speed,
)
from learn2assemble.robot.arm import Arm, Limits, get_arm
from learn2assemble.robot.grasps import Attitude, get_grasps
from learn2assemble.robot.moves import OPENING, Failure, Move, Scene
from learn2assemble.simulation.bench import braked
from learn2assemble.simulation.model import compile_world
from learn2assemble.simulation.objects import PRESS, take_order
from robot_scenes import hands

PANDA = get_arm("panda")
AA = get_grasps("along-y")[0]


def tower(levels: int) -> Scene:
    """A block that waits at the left, and a tower between it and the right."""
    cells = [(0.0, 0.0, 0.025 + 0.05 * k) for k in range(levels)]
    position = np.array([*cells, (0.0, -0.25, 0.025)])
    return Scene(position, np.zeros(levels + 1), np.arange(levels + 1), levels)


def around(scene: Scene, arm: Arm = PANDA) -> WorldChecker:
    order = take_order(scene, Move(scene.num_placed, np.array([0.0, 0.25, 0.025]), *AA))
    found = WorldChecker(
        arm, compile_world((arm,), order.objects.shape, 1.0), order.poses, order.names
    )
    found.empty(OPENING)
    return found


def over(y: float, z: float = 0.15, x: float = 0.0, arm: Arm = PANDA) -> np.ndarray:
    found = solve(arm, np.array([x, y, z]), Attitude().rotation())
    assert found.ok
    return found.joints


# ---------------------------------------------------------------- columns


@given(
    st.sampled_from(["panda", "ur5e"]),
    st.floats(-0.2, 0.2),
    st.floats(-0.35, 0.2),
    st.floats(0.0, 0.2),
    st.sampled_from([0.0, -np.pi / 2, np.pi]),
    st.sampled_from([0.0, np.pi / 6]),
)
@settings(max_examples=12, deadline=None)
def test_columns_stay_on_one_branch_and_on_their_line(
    name: str, x: float, y: float, z: float, yaw: float, tilt: float
) -> None:
    arm, attitude = get_arm(name), Attitude(yaw, tilt)
    centre = np.array([x, y, 0.025 + z])
    for found in approach_paths(arm, tool_path(centre, attitude, 0.3), PRESS):
        if isinstance(found, str):
            assert found.startswith("tool at")
            continue
        assert np.abs(np.diff(found.joints, axis=0)).max() <= JUMP
        assert arm.inside_limits(found.joints).all()
        assert found.rise[0] == -PRESS
        assert np.diff(found.rise).max() <= SPACING + 1e-9
        poses = [forward(get_chain(arm), q) for q in found.joints]
        for _, rotation in poses:
            np.testing.assert_allclose(rotation, attitude.rotation(), atol=1e-5)
        contact = int(np.argmin(np.abs(found.rise)))
        np.testing.assert_allclose(poses[contact][0], attitude.tool_point(centre), atol=1e-5)
        way = np.linalg.norm(np.diff([p for p, _ in poses], axis=0), axis=1)
        np.testing.assert_allclose(np.cumsum(way), found.rise[1:] + PRESS, atol=1e-4)


def test_near_the_base_other_branches_are_found() -> None:
    """Starting from home leads into a joint limit there."""
    centre = np.array([-0.269, -0.15, 0.025])
    found = list(approach_paths(PANDA, tool_path(centre, Attitude(), 0.3), PRESS))
    assert isinstance(found[0], str)
    assert any(isinstance(one, ApproachPath) for one in found)
    assert isinstance(approach_path(PANDA, tool_path(centre, Attitude(), 0.3)), ApproachPath)
    far = approach_path(PANDA, tool_path(np.array([0.9, 0.0, 0.025]), Attitude(), 0.3))
    assert isinstance(far, str)
    assert "out of reach" in far


# ---------------------------------------------------------------- ways


def test_the_straight_way_is_taken_where_it_is_free() -> None:
    way = straight_or_tree(around(tower(1)), over(-0.25), over(0.25))
    assert isinstance(way, np.ndarray)
    assert len(way) == 2


def test_a_tower_is_gone_round() -> None:
    there = around(tower(6))
    start, end = over(-0.25), over(0.25)
    hit = there.blocked(start, end)
    assert hit is not None
    way = straight_or_tree(there, start, end)
    assert isinstance(way, np.ndarray)
    assert len(way) > 2
    np.testing.assert_array_equal(way[0], start)
    np.testing.assert_array_equal(way[-1], end)
    for a, b in pairwise(way):
        for share in np.linspace(0, 1, 40):
            assert there.near(a + share * (b - a), 0.0)[0] is None
    np.testing.assert_array_equal(straight_or_tree(around(tower(6)), start, end), way)


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_a_free_way_is_free_between_checks(name: str) -> None:
    """Also past corners that a finger passes within one stride of the joints."""
    arm, rng = get_arm(name), np.random.default_rng(5)
    there = around(tower(5), arm)
    free = clipped = 0
    for _ in range(60):
        x, y, z = rng.uniform([-0.12, -0.12, 0.22], [0.12, 0.12, 0.3], (2, 3)).T
        start, end = (over(y[k], z[k], x[k], arm) for k in range(2))
        nearest = [
            there.near(start + share * (end - start), 0.0)[1] for share in np.linspace(0, 1, 400)
        ]
        if there.blocked(start, end) is None:
            free += 1
            assert min(nearest) >= KEEP - 1e-4
        else:
            count = int(np.ceil(np.abs(end - start).max() / STRIDE))
            shares = np.arange(count + 1) / count
            clipped += all(there.check(start + k * (end - start)) is None for k in shares)
    assert free > 5
    assert clipped > 0


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_no_point_moves_farther_than_reach_says(name: str) -> None:
    arm, rng = get_arm(name), np.random.default_rng(1)
    there = around(tower(1), arm)
    there.carry(1, np.array([0.01, 0.0, 0.02]), np.eye(3), 0.05)
    m, d = there.model, there.data
    moving = np.flatnonzero((m.body_weldid[m.geom_bodyid] > 0) & (there.world.kind != 0))

    def corners(joints: np.ndarray) -> np.ndarray:
        there.near(joints, 0.0)
        out = [
            d.geom_xpos[g] + d.geom_xmat[g].reshape(3, 3) @ (sign * m.geom_size[g])
            for g in moving
            for sign in np.array(list(product([-1, 1], repeat=3)))
        ]
        return np.array(out)

    for _ in range(50):
        start = rng.uniform(*arm.limits())
        end = start + rng.normal(0, 0.2, len(start)) * (rng.random(len(start)) < 0.5)
        far = np.linalg.norm(corners(end) - corners(start), axis=1).max()
        assert far <= np.abs(end - start) @ there.reach() + 1e-9


@pytest.mark.parametrize("away", [0.001, -0.004])
def test_an_arm_that_stands_near_a_block_leaves_it_upwards(away: float) -> None:
    """It touches it, or keeps less distance than on its ways: no reason to stay there for ever."""
    width = OPENING / 2 - 0.025
    there = around(tower(3))
    start = over(width - away, 0.125)
    hit = there.check(start)
    assert hit is not None
    assert "finger" in str(hit)
    way = straight_or_tree(there, start, over(0.25))
    assert isinstance(way, np.ndarray)
    np.testing.assert_array_equal(way[0], start)
    tools = [forward(get_chain(PANDA), q)[0] for q in way]
    assert tools[1][2] == pytest.approx(tools[0][2] + 0.01, abs=1e-5)
    np.testing.assert_allclose(tools[1][:2], tools[0][:2], atol=1e-5)
    free = next(k for k, q in enumerate(way) if there.check(q) is None)
    assert all(there.blocked(a, b) is None for a, b in pairwise(way[free:]))


def test_an_end_inside_a_block_cannot_be_reached() -> None:
    inside = straight_or_tree(around(tower(3)), over(-0.25), over(0.0, 0.1))
    assert isinstance(inside, Collision)
    assert "block" in str(inside)


def test_what_is_carried_counts() -> None:
    there = around(tower(3))
    clear, end = over(0.0, 0.21), over(0.25, 0.21)
    assert there.blocked(clear, end) is None
    hanging = np.array([0.0, 0.0, 0.05])
    there.carry(3, hanging, np.diag([1.0, -1.0, -1.0]), 0.05)
    hit = there.blocked(clear, end)
    assert hit is not None
    assert "block 3" in str(hit)
    assert not hit.by_link
    there.empty(OPENING)
    assert there.blocked(clear, end) is None


@pytest.mark.parametrize("height", [2, 5])
def test_a_course_crosses_above_everything(height: int) -> None:
    scene = tower(height)
    order = take_order(scene, Move(height, np.array([0.0, 0.15, 0.025]), *AA))
    world = compile_world((PANDA,), order.objects.shape, 1.0)
    course = prepare(PANDA, world, order, PANDA.home, True)
    tops = [forward(get_chain(PANDA), q)[0][2] for q in (course.across[0], course.across[-1])]
    assert min(tops) > 0.05 * height + 0.025
    assert course.home is not None
    np.testing.assert_allclose(course.home[-1], PANDA.home)


def test_a_build_takes_low_ways_and_waits_above_the_next_object() -> None:
    order = take_order(tower(2), Move(2, np.array([0.0, 0.15, 0.025]), *AA))
    world = compile_world((PANDA,), order.objects.shape, 1.0)
    high = prepare(PANDA, world, order, PANDA.home, True)
    low = prepare(PANDA, world, order, PANDA.home, True, Following(np.array([0.05, 0.0, 0.0])))
    where = [forward(get_chain(PANDA), q)[0] for q in (low.across[0], low.home[-1])]
    np.testing.assert_allclose(where[1], where[0] + [0.05, 0.0, 0.0], atol=1e-4)
    for one, other in ((low.plan.pick, high.plan.pick), (low.plan.leave, high.plan.leave)):
        assert len(one.joints) <= len(other.joints)
    assert len(low.plan.leave.joints) < len(high.plan.leave.joints)
    home = prepare(PANDA, world, order, PANDA.home, True, low=True)
    assert (home.across == low.across).all()
    assert len(home.plan.leave.joints) < len(high.plan.leave.joints)
    np.testing.assert_allclose(home.home[-1], PANDA.home)
    checker = WorldChecker(PANDA, world, order.poses, order.names)
    checker.carry(order.target, *order.in_hand(low.plan.move.grasp), order.held)
    assert all(checker.blocked(a, b) is None for a, b in pairwise(low.across))
    checker.empty(order.opening)
    assert all(checker.blocked(a, b) is None for a, b in pairwise(low.there))


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_a_cup_goes_down_from_where_it_waits_above_what_it_takes(name: str) -> None:
    arm = get_arm(name, "suction")
    scene = tower(2)._replace(half=np.full((3, 3), 0.025))
    hand = hands(arm, np.full(3, 0.025))[0]
    order = take_order(scene, Move(2, np.array([0.0, 0.25, 0.025]), hand, hand))
    world = compile_world((arm,), order.objects.shape, 1.0)
    following = Following(np.array([0.05, 0.0, 0.0]))

    def course(start: np.ndarray) -> Course:
        return prepare(arm, world, order, start, True, following)

    pick, chain = course(arm.home).plan.pick, get_chain(arm)
    contact, turn = forward(chain, pick.joints[int(np.searchsorted(pick.rise, -1e-9))])
    for aside, up, goes_down in ((1e-3, 0.055, True), (4e-3, 0.055, False), (0.0, 0.01, False)):
        start = solve(
            arm, contact + np.array([aside, 0.0, up]), turn, pick.joints[-1], restarts=0
        ).joints
        found = course(start)
        assert (len(found.there) == 1) == goes_down
        if not goes_down:
            continue
        count, rise = on_path(arm, pick, start) or (0, 0.0)
        assert rise == pytest.approx(up, abs=1e-6)
        assert pick.rise[count - 1] < up - SPACING / 2 + 1e-9
        way = joint_path(np.vstack([start, pick.joints[:count][::-1]]), arm.bounds)
        tool = [forward(chain, q)[0] for q in way.at(np.linspace(0, way.length, 200))[0]]
        off = np.array(tool) - contact
        assert np.abs(off[:, :2]).max() <= aside + 1e-5
        assert (np.diff(off[:, 2]) < 0).all()


@pytest.mark.parametrize("across", [0.0501, 0.052])
@pytest.mark.parametrize(("above", "free"), [(0.0501, False), (0.053, False), (0.056, True)])
def test_what_is_held_is_near_to_a_block_diagonally_below(
    across: float, above: float, free: bool
) -> None:
    """As one that comes down beside a higher one: MuJoCo's boxes have no contact there."""
    order = take_order(tower(1), Move(1, np.array([0.0, 0.25, 0.025]), *AA))
    joints = over(0.0, 0.3)
    centre, axes = forward(get_chain(PANDA), joints)
    held, turn = order.in_hand(AA[0])
    beside = axes @ turn @ np.array([across, 0.0, 0.0]) - [0.0, 0.0, above]
    poses = order.poses.copy()
    poses[1 - order.target, :3] = centre + axes @ held + beside
    world = compile_world((PANDA,), order.objects.shape, 1.0)
    checker = WorldChecker(PANDA, world, poses, order.names)
    checker.carry(order.target, held, turn, order.held)
    hit, distance = checker.near(joints, 0.005)
    m, d = world.plan, checker.data
    one, two = (int(np.flatnonzero(world.kind == k)[0]) for k in (order.target, 1 - order.target))
    gap = mujoco.mj_geomDistance(m, d, one, two, 0.1, None)
    assert 0 < gap < 0.01
    assert distance == pytest.approx(gap, abs=1e-6)
    assert (hit is None) == free


def test_where_no_way_is_free_the_target_is_unreachable(monkeypatch: pytest.MonkeyPatch) -> None:
    def nowhere(*_: object) -> Collision:
        return Collision("link5", "block 0", True)

    monkeypatch.setattr("learn2assemble.handling.ways.straight_or_tree", nowhere)
    order = take_order(tower(1), Move(1, np.array([0.0, 0.15, 0.025]), *AA))
    world = compile_world((PANDA,), order.objects.shape, 1.0)
    with pytest.raises(Failure, match=r"unreachable \(cross\): no free way: link5 touches"):
        prepare(PANDA, world, order, PANDA.home, True)


STEP = 0.002
LIMITS = Limits(
    np.array([2.0, 2.5, 1.0]),
    np.array([15.0, 7.5, 3.0]),
    np.array([800.0, 90.0, 40.0]),
    *np.full((2, 3), np.inf),
)


def walks(seed: int, count: int) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).normal(0, 0.4, (count, 3)), axis=0)


def shares(samples: np.ndarray, limits: Limits) -> list[float]:
    """Largest derivatives of positions one step apart, by finite differences, over the limits."""
    out = []
    for limit in limits[:3]:
        samples = np.diff(samples, axis=0) / STEP
        out.append(float(np.max(np.abs(samples) / limit, initial=0.0)))
    return out


seeds = st.integers(0, 10**6)


@given(seed=seeds, count=st.integers(2, 9), speed=st.floats(0.1, 1.0))
@settings(max_examples=60, deadline=None)
def test_no_limit_is_exceeded(seed: int, count: int, speed: float) -> None:
    limits = LIMITS.scaled(speed)
    path = joint_path(walks(seed, count), limits)
    run = motion(path, limits_along(path, limits), STEP)
    positions = np.vstack([path.joints[:1], run.position])
    assert max(shares(positions, limits)) <= 1 + 1e-4
    assert np.max(np.abs(run.velocity) / limits.velocity) <= 1 + 1e-9
    assert np.max(np.abs(run.acceleration) / limits.acceleration) <= 1 + 1e-9
    np.testing.assert_allclose(run.position[-1], path.joints[-1], atol=1e-9)
    np.testing.assert_allclose(run.velocity[-1], 0, atol=1e-9)


def test_straight_lines_use_the_limits_up() -> None:
    """The bounds are not merely safe: the slowest joint is at its limit."""
    path = joint_path(np.array([[0.0, 0, 0], [3.0, 1.0, 4.0]]), LIMITS)
    run = motion(path, limits_along(path, LIMITS), STEP)
    assert np.max(np.abs(run.velocity) / LIMITS.velocity) == pytest.approx(1)
    assert np.max(np.abs(run.acceleration) / LIMITS.acceleration) == pytest.approx(1)
    # A straight path is straight.
    np.testing.assert_allclose(run.position[:, 1] * 3, run.position[:, 0], atol=1e-9)


@given(seed=seeds, count=st.integers(3, 9))
@settings(max_examples=40, deadline=None)
def test_paths_go_through_their_knots_smoothly(seed: int, count: int) -> None:
    path = joint_path(walks(seed, count), LIMITS)
    position, slope, bend = path.at(path.knots)
    np.testing.assert_allclose(position, path.joints, atol=1e-9)
    near = 1e-7
    for side in (-near, near):
        _, other, curved = path.at(np.clip(path.knots + side, 0, path.length))
        np.testing.assert_allclose(other, slope, atol=1e-3)
        np.testing.assert_allclose(curved, bend, atol=1e-2 * (1 + np.abs(bend).max()))
    s = np.linspace(0, path.length, 200)
    dense, rate, _ = path.at(s)
    np.testing.assert_allclose(np.gradient(dense, s, axis=0)[2:-2], rate[2:-2], atol=0.2)
    first, second, third = path.bounds()
    assert (np.abs(path.at(s)[1]) <= first.max(0) + 1e-9).all()
    assert (np.abs(path.at(s)[2]) <= second.max(0) + 1e-9).all()
    assert (third >= 0).all()


@given(seed=seeds, share=st.floats(0.05, 0.95))
@settings(max_examples=40, deadline=None)
def test_an_arm_that_brakes_stays_within_the_limits(seed: int, share: float) -> None:
    path = joint_path(walks(seed, 5), LIMITS)
    bounds = limits_along(path, LIMITS)
    run = motion(path, bounds, STEP)
    k = int(share * (len(run.position) - 1))
    rest = braked(LIMITS, *(part[k] for part in run[1:]))
    joined = np.vstack([path.joints[:1], run.position[: k + 1], rest.position])
    assert max(shares(joined, LIMITS)) <= 1 + 2e-3
    np.testing.assert_array_equal(rest.velocity[-1], 0)
    # As soon as that is: no joint needs longer from its velocity to rest.
    assert len(rest.position) * STEP < 2.0


@given(
    st.floats(0.05, 2),
    st.floats(0.2, 20),
    st.floats(2, 3000),
    st.floats(0.001, 1.0),
    st.floats(0.0, 1.0),
)
@example(1.0, 1 - 2**-53, 2.0, 1 - 2**-53, 0.0)  # two shapes of the profile meet
@settings(max_examples=100, deadline=None)
def test_speeds_within_reach_need_no_run_up(
    top: float, acceleration: float, jerk: float, way: float, share: float
) -> None:
    bounds = PathLimits(top, acceleration, jerk)
    path = JointPath(np.array([0.0, way]), np.array([[0.0], [way]]), np.zeros((2, 1)))
    middle = 0.5 * way
    speed = share * min(top, reachable_speed(0.0, middle, bounds))
    run = motion(path, bounds, STEP, (Segment(middle, speed),))
    assert (run.progress[:, 1] >= -1e-9).all()
    assert run.progress[-1, 0] == pytest.approx(middle)


@given(st.floats(0.03, 0.2), st.floats(0.006, 0.03), st.floats(0.2, 3.0))
@settings(max_examples=60, deadline=None)
def test_slow_zones_that_are_near_each_other_are_entered_slowly_enough(
    way: float, height: float, top: float
) -> None:
    path = JointPath(np.array([0.0, way]), np.array([[0.0], [way]]), np.zeros((2, 1)))
    bounds, rise = PathLimits(top, 2.0, 40.0), np.array([way, 0.0])
    zones = ((height, 0.1), (0.005, 0.02))
    run = motion(path, bounds, STEP, approach_speed_limits(path, rise, zones, bounds))
    s, rate = run.progress[:, 0], run.progress[:, 1]
    assert (np.diff(s) >= -1e-9).all()
    assert s[-1] == pytest.approx(way)
    for above, speed in zones:
        assert rate[way - s < above - 1e-9].max() <= speed + 1e-6


@given(seed=seeds)
@settings(max_examples=40, deadline=None)
def test_the_quickest_limits_keep_to_those_of_the_joints_and_are_not_slower(seed: int) -> None:
    path = joint_path(walks(seed, 5), LIMITS)
    usual, quickest = (
        motion(path, limits_along(path, LIMITS, quick), STEP) for quick in (False, True)
    )
    joined = np.vstack([path.joints[:1], quickest.position])
    assert max(shares(joined, LIMITS)) <= 1 + 2e-3
    assert len(quickest.position) <= 1.1 * len(usual.position) + 1


def test_legs_change_the_speed_on_the_way() -> None:
    path = joint_path(np.array([[0.0, 0, 0], [1.0, 0, 0]]), LIMITS)
    bounds = limits_along(path, LIMITS)
    slow = 0.1 * bounds.speed
    segments = (Segment(0.6 * path.length, slow), Segment(path.length, 0.0, slow))
    run = motion(path, bounds, STEP, segments)
    s, rate = run.progress[:, 0], run.progress[:, 1]
    assert rate[s < 0.5 * path.length].max() > 3 * slow
    assert rate[s > 0.6 * path.length].max() <= slow + 1e-9
    assert s[-1] == pytest.approx(path.length)


def test_repeated_positions_count_once_and_a_point_is_a_path() -> None:
    path = joint_path(np.array([[0.0, 0, 0], [0, 0, 0], [1, 1, 1], [1, 1, 1]]), LIMITS)
    assert len(path.knots) == 2
    point = joint_path(np.zeros((2, 3)), LIMITS)
    assert point.length == 0
    assert len(motion(point, limits_along(point, LIMITS), STEP).position) == 0


def test_numbers_must_be_finite() -> None:
    with pytest.raises(InputError, match="finite"):
        joint_path(np.array([[0.0, np.nan, 0.0]]), LIMITS)


def test_without_ruckig_the_extra_is_named() -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys; sys.modules['ruckig'] = None\n"
            "from learn2assemble.robot.arm import get_arm\n"
            "from learn2assemble.handling.dynamic_cell import DynamicCell\n"
            "import learn2assemble.benchmark, learn2assemble.cli.commands\n"
            "print('imported')\nDynamicCell(get_arm('panda'))",
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "imported" in done.stdout
    assert done.returncode != 0
    assert "pip install 'learn2assemble[robot]'" in done.stderr
