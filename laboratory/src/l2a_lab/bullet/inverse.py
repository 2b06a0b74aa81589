"""Inverse kinematics of the published cell: the authors' iteration, without joint limits."""

from __future__ import annotations

import numpy as np

from learn2assemble.geometry.rotations import rotation_vector
from learn2assemble.kernels import kernel
from learn2assemble.kinematics.chain import (
    Chain,
    factorise,
    fill_gram,
    fill_jacobian,
    get_chain,
    solve_factorised,
    tool_and_frames,
)
from learn2assemble.kinematics.inverse import (
    CONVERGED,
    OUT_OF_STEPS,
    STALLED,
    TOLERANCE,
    IKFailure,
    Solution,
)
from learn2assemble.robot.arm import Arm

MAX_ITERATIONS = 1000


def solve_as_published(
    arm: Arm,
    position: np.ndarray,
    rotation: np.ndarray,
    start: np.ndarray,
    *,
    turned: bool = True,
    max_iterations: int = MAX_ITERATIONS,
) -> Solution:
    """Joints that bring the tool to a pose, from one start.

    Args:
        arm: whose tool.
        position: float64[3] [m, world].
        rotation: float64[3, 3], T_world_tool.
        start: float64[n] [rad].
        turned: whether the rotation matters; else only the first three entries of the error do.
        max_iterations: of a tenth of the error each.
    """
    joints = np.array(start, float)
    state, error, iterations = _least_squares(
        get_chain(arm), position, rotation, 6 if turned else 3, TOLERANCE, max_iterations, joints
    )
    failure = IKFailure.NONE if state == CONVERGED else IKFailure.NO_CONVERGENCE
    return Solution(joints, failure, error, iterations)


@kernel
def _least_squares(
    chain: Chain,
    target_position: np.ndarray,
    target_rotation: np.ndarray,
    rows: int,
    tolerance: float,
    max_iterations: int,
    q: np.ndarray,
) -> tuple[int, float, int]:
    """The solver of the released code, improving q in place, without joint limits.

    error = log6(T_target^-1 T(q)), dq = -0.1 J^T (J J^T + 1e-12 I)^-1 error with J in the tool's
    own axes; done when the norm of the error, its first three entries for position only, is below
    the tolerance. These three depend on ``target_rotation``, too. Returns what
    :func:`~learn2assemble.kinematics.inverse.damped_least_squares` does.
    """
    n = q.shape[0]
    positions, rotations = np.empty((n, 3)), np.empty((n, 3, 3))
    position, rotation = np.empty(3), np.empty((3, 3))
    world, jac, gram = np.empty((6, n)), np.empty((6, n)), np.empty((6, 6))
    relative, turn, error = np.empty(3), np.empty((3, 3)), np.zeros(6)
    every, size = np.ones(n, np.bool_), np.inf
    for iteration in range(max_iterations + 1):
        tool_and_frames(chain, q, positions, rotations, position, rotation)
        for i in range(3):
            relative[i] = 0.0
            for k in range(3):
                relative[i] += target_rotation[k, i] * (position[k] - target_position[k])
            for j in range(3):
                turn[i, j] = 0.0
                for k in range(3):
                    turn[i, j] += target_rotation[k, i] * rotation[k, j]
        logarithm(relative, turn, error)
        size = 0.0
        for i in range(rows):
            size += error[i] * error[i]
        size = np.sqrt(size)
        if size < tolerance:
            return CONVERGED, size, iteration
        if iteration == max_iterations:
            break
        fill_jacobian(positions, rotations, position, world)
        for k in range(n):
            for i in range(3):
                jac[i, k] = jac[3 + i, k] = 0.0
                for j in range(3):
                    jac[i, k] += rotation[j, i] * world[j, k]
                    jac[3 + i, k] += rotation[j, i] * world[3 + j, k]
        fill_gram(jac, rows, every, 1e-12, gram)
        if not factorise(gram, rows):
            return STALLED, size, iteration
        solve_factorised(gram, rows, error)
        for k in range(n):
            for i in range(rows):
                q[k] -= 0.1 * jac[i, k] * error[i]
    return OUT_OF_STEPS, size, max_iterations


@kernel
def logarithm(position: np.ndarray, rotation: np.ndarray, out: np.ndarray) -> None:
    """log6 of a rigid transform: out[:3] translation part [m], out[3:] rotation vector [rad]."""
    rotation_vector(np.eye(3), rotation, out[3:])
    x, y, z = out[3], out[4], out[5]
    square = x * x + y * y + z * z
    if square < 1e-12:
        factor = 1.0 / 12.0
    else:
        angle = np.sqrt(square)
        factor = (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / square
    px, py, pz = position[0], position[1], position[2]
    # v = p - w x p / 2 + factor * w x (w x p)
    cx, cy, cz = y * pz - z * py, z * px - x * pz, x * py - y * px
    out[0] = px - 0.5 * cx + factor * (y * cz - z * cy)
    out[1] = py - 0.5 * cy + factor * (z * cx - x * cz)
    out[2] = pz - 0.5 * cz + factor * (x * cy - y * cx)
