"""Distances of two arms with what they hold, by a second library, against MuJoCo."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import mujoco
import numpy as np
import pytest

from l2a_lab.arm_distances import ArmDistances, Moment
from learn2assemble.geometry.hulls import hull_of
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.robot.arm import arms_spec, get_arm, prefix_of
from learn2assemble.robot.bodies import Part, Shape

LEFT = get_arm("panda", "suction", (-0.35, 0.0, 0.0, 0.0))
RIGHT = get_arm("ur5e", "gripper", (0.35, 0.05, 0.0, np.pi))
ARMS = LEFT, RIGHT
CORNERS = np.array([[x, y, z] for x, y, z in np.ndindex(2, 2, 2)], float) * [0.06, 0.05, 0.04] - [
    0.03,
    0.025,
    0.02,
]
CORNERS[CORNERS[:, 2] > 0, 0] *= 0.6
SHAPES: dict[str, Shape] = {
    "wedge": (Part((0.0, 0.0, 0.0), (0.03, 0.025, 0.02), hull_of(CORNERS)),),
    "corner": (
        Part((0.03, 0.0, 0.0), (0.05, 0.02, 0.02)),
        Part((-0.04, 0.03, 0.0), (0.02, 0.05, 0.02)),
    ),
}
"""A hull that is no box, and two boxes in one."""
AGREED = 1e-4
"""By so much two libraries differ at most [m]; both go nearer step by step."""


class Truth:
    """Both arms, each with a block of its own, by MuJoCo."""

    def __init__(self) -> None:
        spec = arms_spec(ARMS)
        for name, shape in SHAPES.items():
            body = spec.worldbody.add_body(name=name)
            body.add_freejoint()
            for number, part in enumerate(shape):
                given = {"pos": part.centre}
                if part.hull is None:
                    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=part.half, **given)
                    continue
                mesh = spec.add_mesh(name=f"{name}{number}", uservert=part.hull.points.ravel())
                body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name, **given)
        self.model = m = spec.compile()
        self.data = mujoco.MjData(m)
        names = [m.body(int(b)).name for b in m.geom_bodyid]
        solid = (m.geom_contype | m.geom_conaffinity) > 0
        second = np.array([n.startswith(prefix_of(1)) or n == "corner" for n in names])
        self.sides = [np.flatnonzero(solid & (second == which)) for which in (False, True)]
        self.of = np.array(names)

    def __call__(self, moment: Moment) -> float:
        """[m]"""
        m, d = self.model, self.data
        d.qpos[: len(moment.joints)] = moment.joints
        for number, held in enumerate(moment.held):
            if held is not None:
                first = len(moment.joints) + 7 * number
                d.qpos[first : first + 7] = held[1]
        mujoco.mj_kinematics(m, d)
        there = {held[0] for held in moment.held if held is not None}
        one, two = (
            [g for g in side.tolist() if self.of[g] not in SHAPES or self.of[g] in there]
            for side in self.sides
        )
        return min(mujoco.mj_geomDistance(m, d, a, b, 2.0, None) for a in one for b in two)


def drawn(rng: np.random.Generator) -> Moment:
    """Arms somewhere around home, most of the time with a block near the hand of each."""
    joints: list[float] = []
    for arm in ARMS:
        joints += np.clip(arm.home + rng.normal(0, 0.5, len(arm.home)), *arm.limits()).tolist()
        joints += [0.01] * len(arm.gripper.joints)
    held: list[tuple[str, np.ndarray] | None] = []
    for name in SHAPES:
        turn = rng.normal(size=4)
        where = rng.uniform([-0.15, -0.2, 0.2], [0.15, 0.2, 0.5])
        pose = np.concatenate([where, turn / np.linalg.norm(turn)])
        held.append((name, pose) if rng.random() < 0.7 else None)
    return Moment(np.array(joints), tuple(held))


def test_distances_are_those_of_mujoco() -> None:
    """Of what overlaps the depth means little; that it does both say."""
    mine, truth, rng = ArmDistances(ARMS, SHAPES), Truth(), np.random.default_rng(0)
    moments = [drawn(rng) for _ in range(300)]
    found = np.array([mine.between(moment) for moment in moments])
    told = np.array([truth(moment) for moment in moments])
    apart = told > 1e-4
    assert 100 < apart.sum() < 290
    assert np.abs(found - told)[apart].max() < AGREED
    assert (found[told < -1e-3] <= 0).all()
    # Some are those of a block.
    bare = np.array([mine.between(moment._replace(held=(None, None))) for moment in moments])
    assert (bare[apart] - found[apart] > 1e-3).sum() > 20
    assert (bare >= found - AGREED).all()
    # Looked at together, nothing is lost by what is not looked at.
    some = [moment for moment, far in zip(moments, apart, strict=True) if far]
    assert mine.least(some).distance == pytest.approx(told[apart].min(), abs=AGREED)


def test_a_solid_that_nobody_knows_is_said() -> None:
    mine = ArmDistances(ARMS, {})
    mine.model.geom_type[0] = mujoco.mjtGeom.mjGEOM_ELLIPSOID
    with pytest.raises(ValueError, match="ELLIPSOID"):
        mine._geom(0)


def test_corners_of_a_block_are_where_they_are_drawn() -> None:
    """The frame of a held block is that of its pose."""
    mine = ArmDistances(ARMS, SHAPES)
    pose = np.array([0.1, 0.2, 0.9, *(np.array([0.9, 0.1, -0.3, 0.2]) / np.sqrt(0.95))])
    solids = mine._arm(0, ("corner", pose))
    wanted = (
        pose[:3] + np.array([p.centre for p in SHAPES["corner"]]) @ quaternion_matrix(pose[3:]).T
    )
    assert np.allclose(solids.place[-2:], wanted)
