"""Quaternions, matrices and rotation vectors against SciPy; edges that run through triangles
against every pair in turn, and fans of narrow triangles."""

from __future__ import annotations

import math

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
