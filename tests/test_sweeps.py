"""Capsules around arms and the space they sweep, against the geometry of MuJoCo."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import mujoco
import numpy as np
import pytest

from learn2assemble.robot.arm import Arm, arms_spec, get_arm, prefix_of
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.capsules import (
    apart,
    between_lines,
    capsules_of,
    in_hand,
    placed,
    solid_capsules,
)
from learn2assemble.robot.kinematics import forward, get_chain
from learn2assemble.robot.sweeps import clear, still, sweep

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
