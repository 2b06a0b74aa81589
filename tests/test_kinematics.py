"""Forward kinematics and Jacobian against MuJoCo and finite differences."""

from __future__ import annotations

import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest

from learn2assemble.errors import InputError
from learn2assemble.geometry.rotations import rotation_vector
from learn2assemble.robot.arm import ARMS, Arm, arm_model, get_arm, load_arm
from learn2assemble.robot.kinematics import (
    forward,
    forward_many,
    get_chain,
    jacobian,
    smallest_singular_value,
)


@pytest.fixture(params=ARMS)
def arm(request: pytest.FixtureRequest) -> Arm:
    return get_arm(request.param)


def random_joints(arm: Arm, count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(arm.lower, arm.upper, (count, len(arm.joints)))


def test_poses_and_jacobian_are_mujocos(arm: Arm) -> None:
    model = arm_model(arm)
    data = mujoco.MjData(model)
    ids = [model.joint(name).id for name in arm.joints]
    site, chain = model.site(arm.tool).id, get_chain(arm)
    for q in random_joints(arm, 100):
        data.qpos[model.jnt_qposadr[ids]] = q
        mujoco.mj_forward(model, data)
        position, rotation = forward(chain, q)
        np.testing.assert_allclose(position, data.site_xpos[site], atol=1e-12)
        np.testing.assert_allclose(rotation.ravel(), data.site_xmat[site], atol=1e-12)
        shift, turn = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, shift, turn, site)
        columns = model.jnt_dofadr[ids]
        expected = np.vstack([shift[:, columns], turn[:, columns]])
        np.testing.assert_allclose(jacobian(chain, q), expected, atol=1e-12)


def test_the_jacobian_is_the_derivative(arm: Arm) -> None:
    chain, step = get_chain(arm), 1e-6
    for q in random_joints(arm, 10, seed=1):
        exact, turn = jacobian(chain, q), np.empty(3)
        for k in range(len(q)):
            low, high = q.copy(), q.copy()
            low[k], high[k] = q[k] - step, q[k] + step
            (p0, r0), (p1, r1) = forward(chain, low), forward(chain, high)
            rotation_vector(r0, r1, turn)
            numeric = np.concatenate([p1 - p0, turn]) / (2 * step)
            np.testing.assert_allclose(exact[:, k], numeric, atol=1e-7)


def test_many_are_the_same_as_one(arm: Arm) -> None:
    chain, q = get_chain(arm), random_joints(arm, 7, seed=2)
    positions, rotations = forward_many(chain, q)
    for k in range(len(q)):
        position, rotation = forward(chain, q[k])
        np.testing.assert_array_equal(positions[k], position)
        np.testing.assert_array_equal(rotations[k], rotation)


def test_joints_out_of_order_are_refused(tmp_path: Path) -> None:
    shutil.copytree(ARMS["ur5e"].parent, tmp_path / "mine")
    path = tmp_path / "mine" / "arm.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('"wrist_1", "wrist_2"', '"wrist_2", "wrist_1"'), encoding="utf-8")
    with pytest.raises(InputError, match="all joints from base to tool, in order"):
        get_chain(load_arm(path))


# ---------------------------------------------------------------- helpers


def test_smallest_singular_values() -> None:
    rng = np.random.default_rng(5)
    for n in (6, 7):
        for _ in range(50):
            u, v = (np.linalg.qr(rng.normal(size=(k, k)))[0] for k in (6, n))
            values = np.concatenate([[rng.uniform(1e-6, 0.05)], rng.uniform(0.1, 2, 5)])
            matrix = u @ np.diag(values) @ v[:6]
            assert smallest_singular_value(matrix, 6) == pytest.approx(values[0], rel=1e-3)
    assert smallest_singular_value(np.zeros((6, 7)), 6) == 0.0
