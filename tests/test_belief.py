"""Estimates of poses against posteriors worked out by hand; outliers; blocks that were moved."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.acting.belief import (
    DRIFT,
    GATE,
    Belief,
    Estimate,
    averaged,
    distance,
    fused,
    rotation_of,
    step_between,
)
from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix, yaw_matrix

THERE = np.array([0.3, -0.1, 0.05, 1.0, 0.0, 0.0, 0.0])
NOISE = np.diag([5e-4] * 3 + [3.5e-3] * 3) ** 2


def random_pose(rng: np.random.Generator) -> np.ndarray:
    turn = rng.normal(size=4)
    return np.array([*rng.normal(size=3), *turn / np.linalg.norm(turn)])


def belief() -> Belief:
    return Belief(lambda name: (np.eye(3), yaw_matrix(math.pi)))


def drawn(
    rng: np.random.Generator, pose: np.ndarray = THERE, noise: np.ndarray = NOISE
) -> Estimate:
    step = np.linalg.cholesky(noise) @ rng.normal(size=6)
    return Estimate(pose, noise).moved(step)


@settings(deadline=None, max_examples=100)
@given(st.integers(0, 10**6))
def test_steps_between_poses_lead_from_one_to_the_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = random_pose(rng), random_pose(rng)
    there = Estimate(a, NOISE).moved(step_between(a, b)).pose
    assert np.allclose(there[:3], b[:3], atol=1e-12)
    assert abs(abs(there[3:] @ b[3:]) - 1) < 1e-9
    vector = rng.normal(size=3)
    turn = rotation_of(vector)
    assert np.allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.allclose(turn @ vector, vector)
    assert math.isclose(np.trace(turn), 1 + 2 * math.cos(np.linalg.norm(vector)))


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 10**6), st.integers(2, 12))
def test_readings_of_a_block_at_rest_have_the_posterior_of_their_weighted_mean(
    seed: int, count: int
) -> None:
    """Position, and a turn about one axis, where the posterior is exact: precisions add up."""
    rng = np.random.default_rng(seed)
    precision, weighted = np.zeros((4, 4)), np.zeros(4)
    found: Estimate | None = None
    for _ in range(count):
        root = rng.normal(size=(4, 4)) * 1e-3
        four = root @ root.T + 1e-8 * np.eye(4)
        value = rng.normal(size=4) * np.array([5e-4, 5e-4, 5e-4, 3e-3])
        noise = np.diag([1e-8] * 6)
        rows = [0, 1, 2, 5]
        noise[np.ix_(rows, rows)] = four
        turned = matrix_quaternion(yaw_matrix(value[3]))
        one = Estimate(np.array([*value[:3], *turned]), noise)
        found = one if found is None else averaged(found, one)
        precision += np.linalg.inv(four)
        weighted += np.linalg.solve(four, value)
    assert found is not None
    mean = np.linalg.solve(precision, weighted)
    got = step_between(np.array([0, 0, 0, 1.0, 0, 0, 0]), found.pose)
    assert np.allclose(got[[0, 1, 2, 5]], mean, atol=1e-8)
    rows = np.ix_([0, 1, 2, 5], [0, 1, 2, 5])
    assert np.allclose(found.covariance[rows], np.linalg.inv(precision), rtol=1e-6, atol=1e-14)


def test_creep_between_looks_is_the_known_steady_state() -> None:
    """P = P' R / (P' + R) with P' = P + Q has the root of P^2 + Q P - Q R."""
    known, rng = belief(), np.random.default_rng(0)
    known.see("b", drawn(rng))
    known.see("b", drawn(rng))
    for _ in range(2000):
        known.rest()
        known.see("b", drawn(rng))
    q, r = DRIFT**2, NOISE[0, 0]
    steady = (-q + math.sqrt(q * q + 4 * q * r)) / 2
    assert math.isclose(known.known["b"].covariance[0, 0], steady, rel_tol=1e-3)


def test_the_covariance_says_how_far_estimates_are_off() -> None:
    rng, far = np.random.default_rng(1), []
    for _ in range(400):
        found = drawn(rng)
        for _ in range(4):
            found = averaged(found, drawn(rng))
        off = step_between(found.pose, THERE)
        far.append(off @ np.linalg.solve(found.covariance, off))
    # Mean of chi-square with six degrees: 6, of 400 of them within 5 %.
    assert abs(np.mean(far) - 6) < 4 * math.sqrt(12 / 400)


def test_a_measurement_of_one_coordinate_leaves_independent_ones_alone() -> None:
    one = Estimate(THERE, NOISE)
    rows = np.eye(6)[[2]]
    found = fused(one, rows, np.array([1e-3]), np.array([[NOISE[2, 2]]]))
    assert math.isclose(found.pose[2] - THERE[2], 5e-4, rel_tol=1e-6)
    assert math.isclose(found.covariance[2, 2], NOISE[2, 2] / 2, rel_tol=1e-6)
    assert np.allclose(np.delete(found.pose, 2), np.delete(THERE, 2))


def test_an_outlier_is_left_out_and_a_move_is_believed_at_the_second_reading() -> None:
    known, rng = belief(), np.random.default_rng(2)
    for _ in range(4):
        known.see("b", drawn(rng))
    before = known.known["b"]
    away = THERE + np.array([0.03, 0, 0, 0, 0, 0, 0])
    assert not known.see("b", drawn(rng, away))
    assert known.known["b"] is before
    assert known.see("b", drawn(rng))
    assert np.linalg.norm(known.known["b"].pose[:3] - THERE[:3]) < 1e-3
    assert not known.see("b", drawn(rng, away))
    # An outlier elsewhere says nothing about the first one.
    assert not known.see("b", drawn(rng, THERE - [0.0, 0.05, 0, 0, 0, 0, 0]))
    assert not known.see("b", drawn(rng, away))
    assert known.see("b", drawn(rng, away))
    assert np.linalg.norm(known.known["b"].pose[:3] - away[:3]) < 2e-3


def test_what_readings_do_not_tell_of_a_nudged_block_stays_known() -> None:
    """Readings that tell the yaw alone, of a block that was turned by 4 degrees: its place, and
    how it leans, stay what they were. After a move by 30 cm nothing stays."""
    rng = np.random.default_rng(6)
    blind = np.diag([0.03, 0.03, 0.03, 0.2, 0.2, 3.5e-3]) ** 2
    turned = Estimate(THERE, NOISE).moved(np.array([0, 0, 0, 0, 0, 0.07])).pose
    known = belief()
    for _ in range(4):
        known.see("b", drawn(rng))
    known.see("b", drawn(rng, turned, blind))
    known.see("b", drawn(rng, turned, blind))
    off = step_between(turned, known.known["b"].pose)
    assert np.abs(off[:3]).max() < 2e-3
    assert np.abs(off[3:5]).max() < 0.05
    assert abs(off[5]) < 0.01
    away = THERE + np.array([0.3, 0, 0, 0, 0, 0, 0])
    readings = [drawn(rng, away) for _ in range(2)]
    for one in readings:
        known.see("b", one)
    assert np.allclose(known.known["b"].pose, averaged(*readings).pose)


def test_the_gate_lets_through_what_it_says() -> None:
    rng = np.random.default_rng(3)
    one = Estimate(THERE, NOISE)
    far = [distance(one, drawn(rng, drawn(rng).pose)) for _ in range(3000)]
    assert sum(d > GATE for d in far) <= 3
    assert max(far) > GATE / 3


def test_what_is_not_seen_is_not_known() -> None:
    known, rng = belief(), np.random.default_rng(4)
    assert "b" not in known.known
    assert not known.see("b", drawn(rng))  # One reading may be an outlier.
    assert "b" not in known.known
    assert known.see("b", drawn(rng))
    known.forget("b")
    assert "b" not in known.known


def test_exact_readings_are_believed_at_once() -> None:
    known = belief()
    assert known.see("b", Estimate(THERE, np.zeros((6, 6))))
    away = THERE + np.array([0.03, 0, 0, 0, 0, 0, 0])
    assert known.see("b", Estimate(away, np.zeros((6, 6))))
    assert np.array_equal(known.known["b"].pose, away)


def test_a_block_that_looks_the_same_is_read_as_it_is_known_to_lie() -> None:
    known, rng = belief(), np.random.default_rng(5)
    for _ in range(2):
        known.see("b", drawn(rng))
    half = THERE.copy()
    half[3:] = matrix_quaternion(yaw_matrix(math.pi))
    assert known.see("b", drawn(rng, half))
    turn = quaternion_matrix(known.known["b"].pose[3:])
    assert np.trace(turn) > 2.99


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 10**6))
def test_frames_there_and_back(seed: int) -> None:
    rng = np.random.default_rng(seed)
    frame, root = random_pose(rng), rng.normal(size=(6, 6)) * 1e-3
    one = Estimate(random_pose(rng), root @ root.T)
    turn = quaternion_matrix(frame[3:])
    back = one.seen_from(frame[:3], turn).seen_in(frame[:3], turn)
    assert np.allclose(step_between(one.pose, back.pose), 0, atol=1e-9)
    assert np.allclose(back.covariance, one.covariance, atol=1e-12)
    # A step in the world is the same step in the frame.
    step = rng.normal(size=6) * 1e-4
    seen = one.moved(step).seen_from(frame[:3], turn)
    inner = step_between(one.seen_from(frame[:3], turn).pose, seen.pose)
    assert np.allclose(inner, [*(turn.T @ step[:3]), *(turn.T @ step[3:])], atol=1e-9)


def test_estimates_travel_through_a_file() -> None:
    known, other, rng = belief(), belief(), np.random.default_rng(6)
    known.see("b", drawn(rng))
    known.see("b", drawn(rng))
    other.restore(known.state())
    assert np.array_equal(other.known["b"].pose, known.known["b"].pose)
    assert np.array_equal(other.known["b"].covariance, known.known["b"].covariance)


@pytest.mark.parametrize("spread", [1e-4, 3e-3])
def test_the_spread_is_that_of_the_widest_axis(spread: float) -> None:
    turn = yaw_matrix(0.7)
    wide = np.zeros((6, 6))
    wide[:3, :3] = turn @ np.diag([spread**2, 1e-10, 1e-10]) @ turn.T
    assert math.isclose(Estimate(THERE, wide).spread, spread, rel_tol=1e-9)
