"""Joint paths and their time laws."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from learn2assemble.errors import InputError
from learn2assemble.robot.arm import Limits
from learn2assemble.robot.joint_path import JointPath, joint_path
from learn2assemble.simulation.bench import braked
from learn2assemble.simulation.trajectory import (
    PathLimits,
    Segment,
    approach_speed_limits,
    limits_along,
    motion,
    reachable_speed,
)

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
            "from learn2assemble.simulation.cell import DynamicCell\n"
            "import learn2assemble.benchmark, learn2assemble.cli.commands\n"
            "import learn2assemble.tasks.episode\n"
            "print('imported')\nDynamicCell(get_arm('panda'))",
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "imported" in done.stdout
    assert done.returncode != 0
    assert "pip install 'learn2assemble[robot]'" in done.stderr
