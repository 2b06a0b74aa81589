"""Inverse kinematics of the published cell: its iteration as written, which knows no limits."""

from __future__ import annotations

import numpy as np

from l2a_lab.bullet.inverse import logarithm, solve_as_published
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.inverse import IKFailure
from learn2assemble.robot.kinematics import forward, get_chain, jacobian


def downward(yaw: float) -> np.ndarray:
    """T_world_tool of a hand that points down, its closing direction ``yaw`` from the y axis."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, s, 0], [s, -c, 0], [0, 0, -1.0]])


def turned(axis: np.ndarray, angle: float) -> np.ndarray:
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def reference_step(chain, q: np.ndarray, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """One iteration of the published solver in matrices, with a numeric derivative of the twist."""
    here, turn = forward(chain, q)
    relative = np.eye(4)
    relative[:3, :3], relative[:3, 3] = rotation.T @ turn, rotation.T @ (here - position)
    values, vectors = np.linalg.eig(relative)
    log = (vectors @ np.diag(np.log(values)) @ np.linalg.inv(vectors)).real
    error = np.array([*log[:3, 3], log[2, 1], log[0, 2], log[1, 0]])
    world = jacobian(chain, q)
    local = np.vstack([turn.T @ world[:3], turn.T @ world[3:]])
    return q - 0.1 * local.T @ np.linalg.solve(local @ local.T + 1e-12 * np.eye(6), error)


def test_the_published_step_is_as_written() -> None:
    arm = get_arm("panda")
    chain, target = get_chain(arm), np.array([0.05, 0.1, 0.2])
    rotation = downward(0.4)
    expected = arm.home
    for steps in range(1, 4):
        # The eigenvectors of a rigid transform span the space where it is a true screw motion.
        expected = reference_step(chain, expected, target, rotation)
        found = solve_as_published(arm, target, rotation, arm.home, max_iterations=steps)
        np.testing.assert_allclose(found.joints, expected, atol=1e-6)
        assert found.failure == IKFailure.NO_CONVERGENCE


def test_the_published_solver_converges_as_slowly_as_published() -> None:
    """A step removes a tenth of the error: from about 1 to 1e-6 in some 130 steps."""
    arm = get_arm("panda")
    found = solve_as_published(arm, np.array([0.05, 0.1, 0.2]), downward(0.0), arm.home)
    assert found.ok
    assert found.error < 1e-6
    assert 110 < found.iterations < 150


def test_position_only() -> None:
    arm, target = get_arm("panda"), np.array([0.1, 0.05, 0.1])
    found = solve_as_published(arm, target, np.eye(3), arm.home, turned=False)
    assert found.ok
    np.testing.assert_allclose(forward(get_chain(arm), found.joints)[0], target, atol=2e-6)


def test_it_knows_no_limits() -> None:
    """A pose the Panda can take with its shoulder bent beyond the limit, and not otherwise."""
    arm = get_arm("panda")
    beyond = np.array([0, 2.4, 0, -0.3, 0, 1.0, 0.8])
    position, rotation = forward(get_chain(arm), beyond)
    found = solve_as_published(arm, position, rotation, beyond)
    assert found.ok
    assert not arm.inside_limits(found.joints)


def test_logarithms_of_rigid_transforms() -> None:
    """The exponential of log6, by its power series, is the transform."""
    rng, out = np.random.default_rng(4), np.empty(6)
    for angle in (0.0, 1e-8, 1e-3, 1.0, 3.1):
        position, rotation = rng.normal(size=3), turned(rng.normal(size=3), angle)
        logarithm(position, rotation, out)
        x, y, z = out[3:]
        twist = np.array([[0, -z, y, out[0]], [z, 0, -x, out[1]], [-y, x, 0, out[2]], [0] * 4])
        term, total = np.eye(4), np.eye(4)
        for k in range(1, 40):
            term = term @ twist / k
            total = total + term
        np.testing.assert_allclose(total[:3, :3], rotation, atol=1e-8)
        np.testing.assert_allclose(total[:3, 3], position, atol=1e-8)
