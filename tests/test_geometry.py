"""Quaternions, matrices and rotation vectors against SciPy; edges that run through triangles
against every pair in turn, and fans of narrow triangles.

Capsules around arms and the space they sweep, against the geometry of MuJoCo.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from learn2assemble.design.solids import crossed
from learn2assemble.geometry.crossings import find_crossing
from learn2assemble.geometry.rotations import (
    cube_yaw,
    interpolate_quaternions,
    matrix_quaternion,
    quaternion_matrix,
    quaternion_product,
    rotate_vectors,
    rotation_vector,
    yaw_matrix,
    yaw_quaternion,
)
from learn2assemble.kinematics.capsules import (
    apart,
    between_lines,
    capsules_of,
    in_hand,
    placed,
    solid_capsules,
)
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.kinematics.sweeps import clear, still, sweep
from learn2assemble.robot.arm import Arm, arms_spec, get_arm, prefix_of
from learn2assemble.robot.bodies import Part

SEEDS = st.integers(0, 2**32 - 1)


def scipy_order(quaternion: np.ndarray) -> np.ndarray:
    """SciPy's quaternions are (x, y, z, w)."""
    return np.roll(quaternion, -1, axis=-1)


def some(seed: int, count: int) -> Rotation:
    return Rotation.from_quat(np.random.default_rng(seed).normal(size=(count, 4)))


@given(SEEDS)
@settings(deadline=None)
def test_quaternions_agree_with_scipy(seed: int) -> None:
    known = some(seed, 6)
    quaternion = np.roll(known.as_quat(), 1, axis=-1)
    vectors = np.random.default_rng(seed).normal(size=(6, 3))
    np.testing.assert_allclose(quaternion_matrix(quaternion), known.as_matrix(), atol=1e-12)
    shaped = quaternion_matrix(quaternion.reshape(2, 3, 4))
    np.testing.assert_array_equal(shaped.reshape(6, 3, 3), quaternion_matrix(quaternion))
    np.testing.assert_array_equal(quaternion_matrix(quaternion[0]), shaped[0, 0])
    np.testing.assert_allclose(
        rotate_vectors(quaternion, vectors), known.apply(vectors), atol=1e-12
    )
    back = np.array([matrix_quaternion(matrix) for matrix in known.as_matrix()])
    np.testing.assert_allclose(abs((back * quaternion).sum(1)), 1.0, atol=1e-12)
    product = quaternion_product(quaternion[0], quaternion[1])
    np.testing.assert_allclose(
        quaternion_matrix(product), (known[0] * known[1]).as_matrix(), atol=1e-12
    )


@given(st.floats(-7, 7), SEEDS)
@settings(deadline=None)
def test_yaws(yaw: float, seed: int) -> None:
    np.testing.assert_allclose(quaternion_matrix(yaw_quaternion(yaw)), yaw_matrix(yaw), atol=1e-8)
    many = np.random.default_rng(seed).uniform(-4, 4, (2, 3))
    known = Rotation.from_euler("z", many.reshape(-1, 1)).as_matrix()
    np.testing.assert_allclose(
        quaternion_matrix(yaw_quaternion(many)).reshape(6, 3, 3), known, atol=1e-12
    )


def test_yaw_matrices_are_exact_for_quarter_turns() -> None:
    np.testing.assert_array_equal(yaw_matrix(-math.pi / 2) @ [1, 0, 0], [0, -1, 0])
    np.testing.assert_array_equal(yaw_matrix(5 * math.pi / 2), yaw_matrix(math.pi / 2))


@given(st.floats(-3.1, 3.1), st.integers(0, 3))
@settings(max_examples=50, deadline=None)
def test_a_cube_has_a_yaw_on_every_face(yaw: float, rolls: int) -> None:
    rolled = Rotation.from_euler("z", yaw) * Rotation.from_euler("x", rolls * np.pi / 2)
    assert np.cos(4 * (cube_yaw(rolled.as_matrix()) - yaw)) == pytest.approx(1)


@given(SEEDS, st.floats(0, 1))
@settings(deadline=None)
def test_interpolation_takes_the_shorter_way(seed: int, share: float) -> None:
    first, second = np.roll(some(seed, 2).as_quat(), 1, axis=-1)
    between = interpolate_quaternions(first, second, share)
    assert np.linalg.norm(between) == pytest.approx(1)
    whole = Rotation.from_quat(scipy_order(first)).inv() * Rotation.from_quat(scipy_order(second))
    part = Rotation.from_quat(scipy_order(first)).inv() * Rotation.from_quat(scipy_order(between))
    assert part.magnitude() <= whole.magnitude() + 1e-7
    np.testing.assert_allclose(abs(interpolate_quaternions(first, second, 0.0) @ first), 1.0)
    np.testing.assert_allclose(abs(interpolate_quaternions(first, second, 1.0) @ second), 1.0)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 1.0, 3.0, np.pi - 1e-4, np.pi - 1e-9])
def test_rotation_vectors_turn_one_rotation_into_the_other(angle: float) -> None:
    rng, out = np.random.default_rng(3), np.empty(3)
    for axis in (*np.eye(3), *-np.eye(3), *rng.normal(size=(20, 3))):
        turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
        first = Rotation.from_rotvec(rng.normal(size=3))
        second = (turn * first).as_matrix()
        rotation_vector(first.as_matrix(), second, out)
        assert np.linalg.norm(out) == pytest.approx(angle, abs=1e-8)
        # In half a turn the sense of the axis is not defined.
        found = (Rotation.from_rotvec(out) * first).as_matrix()
        np.testing.assert_allclose(found, second, atol=1e-7)


def slow(points: np.ndarray, edges: np.ndarray, triangles: np.ndarray) -> set[tuple[int, int]]:
    """The edges that run through triangles, by the solution of a linear system for every pair."""
    found = set()
    for i, j in edges.tolist():
        for triangle in triangles.tolist():
            if {i, j} & set(triangle):
                continue
            a, b, c = points[triangle]
            system = np.column_stack([b - a, c - a, points[i] - points[j]])
            if abs(np.linalg.det(system)) < 1e-12:
                continue
            s, t, along = np.linalg.solve(system, points[i] - a)
            if min(s, t, 1 - s - t) > 0 and 0 < along < 1:
                found.add((i, j))
    return found


def case(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, edges and triangles at random."""
    random = np.random.default_rng(seed)
    edges = np.array([random.permutation(24)[:2] for _ in range(3)])
    triangles = np.array([random.permutation(24)[:3] for _ in range(int(random.integers(1, 6)))])
    return random.random((24, 3)), edges, triangles


@pytest.mark.parametrize("seed", range(24))
def test_the_first_edge_that_crosses_is_found(seed: int) -> None:
    points, edges, triangles = case(seed)
    through = slow(points, edges, triangles)
    found = find_crossing(points, edges, triangles, 1e-9, 0.0)
    crossing = [tuple(edge) for edge in edges.tolist() if tuple(edge) in through]
    assert (None if found is None else tuple(found.tolist())) == (crossing or [None])[0]


def test_the_cases_have_both_answers() -> None:
    answers = [bool(slow(*case(seed))) for seed in range(24)]
    assert 5 < sum(answers) < 20


def test_a_fan_of_narrow_triangles_is_searched_at_once() -> None:
    """Of 160,000 triangles nearly all boxes of the two caps overlap: 10⁹ pairs, each of which was
    written down. A spike through a cap is found among them."""
    tube = trimesh.creation.cylinder(1.0, height=2.0, sections=40_000)
    vertices, faces = np.asarray(tube.vertices), np.asarray(tube.faces)
    assert not crossed(vertices, faces)
    spike = trimesh.creation.cone(0.01, height=1.0, sections=8)
    spike.apply_translation((0.4, 0.3, 0.5))
    both = trimesh.util.concatenate([tube, spike])
    assert crossed(np.asarray(both.vertices), np.asarray(both.faces))


LEFT = get_arm("panda", "gripper", (-0.28, 0.0, 0.0, 0.0))
RIGHT = get_arm("ur5e", "suction-side", (0.28, 0.05, 0.0, np.pi))


class Truth:
    """Distances of the solids of two arms, by MuJoCo."""

    def __init__(self, arms: tuple[Arm, Arm], opening: float = 0.0) -> None:
        self.arms, self.model = arms, arms_spec(arms).compile()
        self.data = mujoco.MjData(self.model)
        m, names = self.model, [self.model.body(k).name for k in range(self.model.nbody)]
        solid = (m.geom_contype | m.geom_conaffinity) > 0
        second = np.array([names[b].startswith("1/") for b in m.geom_bodyid])
        self.geoms = [np.flatnonzero(solid & (second == which)).tolist() for which in (False, True)]
        self.opening = opening

    def __call__(self, *joints: np.ndarray) -> float:
        """[m], at most 1."""
        m, d = self.model, self.data
        for number, (arm, q) in enumerate(zip(self.arms, joints, strict=True)):
            prefix = prefix_of(number)
            for name, value in zip(arm.joints, q, strict=True):
                d.qpos[m.joint(prefix + name).qposadr[0]] = value
            for name in arm.gripper.joints:
                d.qpos[m.joint(prefix + name).qposadr[0]] = self.opening / 2
        mujoco.mj_kinematics(m, d)
        return min(
            mujoco.mj_geomDistance(m, d, a, b, 1.0, None)
            for a in self.geoms[0]
            for b in self.geoms[1]
        )


def postures(arm: Arm, rng: np.random.Generator) -> np.ndarray:
    """Joints somewhere around home."""
    lower, upper = arm.limits()
    return np.clip(arm.home + rng.normal(0, 0.7, len(arm.home)), lower, upper)


def test_lines_are_as_far_apart_as_points_on_them() -> None:
    rng = np.random.default_rng(0)
    share = np.linspace(0, 1, 201)[:, None]
    for _ in range(200):
        a, b = rng.normal(size=(2, 2, 3))
        if rng.random() < 0.2:
            b = a + rng.normal(size=3)  # parallel
        if rng.random() < 0.1:
            a[1] = a[0]  # a point
        p, q = a[0] + share * (a[1] - a[0]), b[0] + share * (b[1] - b[0])
        least = np.linalg.norm(p[:, None] - q, axis=2).min()
        found = between_lines(a, b)
        assert found <= least + 1e-12
        assert found >= least - 0.03


@pytest.mark.parametrize("opening", [0.0, 0.08])
def test_capsules_are_never_farther_apart_than_the_arms_are(opening: float) -> None:
    truth, rng, near = Truth((LEFT, RIGHT), opening), np.random.default_rng(1), 0
    chains, shapes = [get_chain(one) for one in truth.arms], [*map(capsules_of, truth.arms)]
    for _ in range(60):
        q = [postures(arm, rng) for arm in truth.arms]
        lines = [placed(c, s, p[None])[0] for c, s, p in zip(chains, shapes, q, strict=True)]
        bound = apart(lines[0], shapes[0].radius, lines[1], shapes[1].radius)
        there = truth(*q)
        assert bound <= max(there, 0.0) + 1e-6
        # Not so much nearer that nothing could pass.
        assert bound >= there - 0.08
        near += there < 0.1
    assert near > 5


def test_arms_that_are_said_to_keep_their_distance_do_at_every_moment() -> None:
    """Both verdicts happen; where one is good, no pair of moments is nearer, by MuJoCo."""
    truth, rng = Truth((LEFT, RIGHT)), np.random.default_rng(2)
    shapes, verdicts, margin = [*map(capsules_of, truth.arms)], [], 0.015
    for _ in range(40):
        ways = [
            arm.home + np.linspace(0, 1, 7)[:, None] * (postures(arm, rng) - arm.home)
            for arm in truth.arms
        ]
        swept = [sweep(a, s, w) for a, s, w in zip(truth.arms, shapes, ways, strict=True)]
        verdicts.append(clear(*swept, margin))
        if verdicts[-1]:
            for _ in range(12):
                at = [w[0] + rng.random() * (w[-1] - w[0]) for w in ways]
                assert truth(*at) >= margin
    assert 10 < sum(verdicts) < 35


def test_a_sweep_that_comes_nearer_than_it_may_is_refused() -> None:
    """The verdict is not good only for being strict: as near as it may be it is let through."""
    arm, rng = RIGHT, np.random.default_rng(3)
    capsules, chain = capsules_of(arm), get_chain(arm)
    for _ in range(10):
        q = postures(arm, rng), postures(arm, rng)
        swept = sweep(arm, capsules, np.array(q))
        point = forward(chain, (q[0] + q[1]) / 2)[0] + rng.normal(0, 0.3, 3)
        ball = solid_capsules((Part((0, 0, 0), (0.01, 0.01, 0.01)),), point, np.eye(3))
        thing = still(ball)
        gap = min(
            apart(lines, capsules.radius, ball.ends, ball.radius)
            for lines in placed(chain, capsules, np.linspace(*q, 2000))
        )
        if gap > 0.02:
            assert clear(swept, thing, gap - 0.007)
        assert not clear(swept, thing, gap + 1e-3)


def test_what_is_held_belongs_to_the_arm() -> None:
    brick = (Part((0.0, 0.0, 0.0), (0.1, 0.02, 0.02)),)
    held = in_hand(RIGHT, solid_capsules(brick, np.array([0.0, 0.0, 0.05]), np.eye(3)))
    chain = get_chain(RIGHT)
    lines = placed(chain, held, RIGHT.home[None])[0]
    place, turn = forward(chain, RIGHT.home)
    corners = place + (brick[0].points + np.array([0.0, 0.0, 0.05])) @ turn.T
    for corner in corners:
        point = np.array([corner, corner])
        assert between_lines(lines[0], point) <= held.radius[0] + 1e-9
    both = capsules_of(RIGHT).add(held)
    assert (both.reach(chain) >= capsules_of(RIGHT).reach(chain)).all()


def test_nothing_moves_farther_than_a_sweep_says() -> None:
    rng = np.random.default_rng(4)
    for arm in (LEFT, RIGHT):
        capsules = capsules_of(arm)
        swept = sweep(arm, capsules, np.array([postures(arm, rng), postures(arm, rng)]))
        moved = np.linalg.norm(np.diff(swept.lines, axis=0), axis=3).max((1, 2))
        assert (moved <= np.diff(swept.way, axis=0).max(1) + 1e-9).all()
        assert moved.max() > 1e-3


@pytest.mark.parametrize("seed", range(3))
def test_what_is_left_of_a_way_has_all_that_comes(seed: int) -> None:
    """Of an arm that strays from it by some millimetres: nothing that is ahead is missing, and of
    what is behind only the last bit is there."""
    rng, capsules = np.random.default_rng(seed), capsules_of(RIGHT)
    start, end = postures(RIGHT, rng), postures(RIGHT, rng)
    whole = sweep(RIGHT, capsules, np.array([start, end]))
    share = 0.0
    for _ in range(6):
        share += rng.uniform(0.05, 0.2)
        stray = rng.normal(0, 1e-3, len(start))
        here = sweep(RIGHT, capsules, (start + share * (end - start) + stray)[None])
        left = whole.from_near(here)
        gone = len(whole.lines) - len(left.lines)
        assert np.array_equal(left.lines, whole.lines[gone:])
        assert gone / (len(whole.lines) - 1) <= share
        assert gone / (len(whole.lines) - 1) > share - 8 / len(whole.lines)
        assert not clear(left, here, 0.0)
    assert len(whole.lines) > 50
