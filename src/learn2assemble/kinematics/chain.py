"""Forward kinematics of an arm, and small linear algebra, as compiled functions.

The chain is read from the arm's MJCF once. Every joint is brought to turn about the z axis of its
own *joint frame*, so that a joint costs two columns of one 3x3 product.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.kernels import kernel
from learn2assemble.robot.arm import Arm, arm_model


@kernel
def factorise(matrix: np.ndarray, size: int) -> bool:
    """Replaces the lower half of a symmetric positive definite matrix by its Cholesky factor.

    Returns False, with the factor unfinished, where the matrix is not positive definite.
    """
    for i in range(size):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if total <= 1e-300:
                    return False
                matrix[i, i] = np.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    return True


@kernel
def solve_factorised(factor: np.ndarray, size: int, vector: np.ndarray) -> None:
    """Solves with a Cholesky factor, in place."""
    for i in range(size):
        for k in range(i):
            vector[i] -= factor[i, k] * vector[k]
        vector[i] /= factor[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            vector[i] -= factor[k, i] * vector[k]
        vector[i] /= factor[i, i]


@kernel
def fill_gram(
    jacobian: np.ndarray, rows: int, free: np.ndarray, damping: float, out: np.ndarray
) -> None:
    """Fills the lower half of J J^T + damping I: J's first ``rows`` rows, its ``free`` columns."""
    for i in range(rows):
        for j in range(i + 1):
            total = 0.0
            for k in range(jacobian.shape[1]):
                if free[k]:
                    total += jacobian[i, k] * jacobian[j, k]
            out[i, j] = total
        out[i, i] += damping


@kernel
def smallest_singular_value(jacobian: np.ndarray, rows: int) -> float:
    """Of the first ``rows`` rows, by inverse iteration on J J^T; 0 where that is singular."""
    gram = np.empty((6, 6))
    columns: int = jacobian.shape[1]
    fill_gram(jacobian, rows, np.ones(columns, np.bool_), 0.0, gram)
    if not factorise(gram, rows):
        return 0.0
    vector, size = np.empty(6), 1.0
    for i in range(6):
        vector[i] = 1.0 + i
    for _ in range(12):
        solve_factorised(gram, rows, vector)
        size = 0.0
        for i in range(rows):
            size += vector[i] * vector[i]
        size = np.sqrt(size)
        for i in range(rows):
            vector[i] /= size
    return 1.0 / np.sqrt(size)


class Chain(NamedTuple):
    """Fixed transforms of an arm with n joints, its base pose in the world included."""

    offset: np.ndarray
    """float64[n, 3]: origin of each joint frame in the one before (the first in the world) [m]."""
    turn: np.ndarray
    """float64[n, 3, 3]: its rotation there, at joint angle 0."""
    tool_offset: np.ndarray
    """float64[3]: the tool in the last joint frame [m]."""
    tool_turn: np.ndarray
    """float64[3, 3]."""


@lru_cache(maxsize=16)
def get_chain(arm: Arm) -> Chain:
    """The chain of an arm from its base in the world to its tool.

    Raises:
        InputError: where the joints do not follow one another from base to tool.
    """
    model = arm_model(arm)
    data = mujoco.MjData(model)
    data.qpos[:] = 0
    mujoco.mj_forward(model, data)
    ids = [model.joint(name).id for name in arm.joints]
    bodies = model.jnt_bodyid[ids]
    path, body = list[int](), int(model.site_bodyid[model.site(arm.tool).id])
    while body:
        path.append(body)
        body = int(model.body_parentid[body])
    moving = [b for b in reversed(path) if model.body_jntnum[b]]
    if moving != bodies.tolist() or (model.body_jntnum[bodies] != 1).any():
        raise InputError(
            f"arm {arm.name}, joints", list(arm.joints), "all joints from base to tool, in order"
        )
    frames = [(data.xanchor[j], _frame_with_z(data.xaxis[j])) for j in ids]
    parents = [(np.zeros(3), np.eye(3)), *frames[:-1]]
    joints = [_relative(a, b) for a, b in zip(parents, frames, strict=True)]
    site = data.site(arm.tool)
    tool = _relative(frames[-1], (site.xpos, site.xmat.reshape(3, 3)))
    offset, turn = (np.array(part) for part in zip(*joints, strict=True))
    return Chain(offset, turn, np.ascontiguousarray(tool[0]), np.ascontiguousarray(tool[1]))


Pose = tuple[np.ndarray, np.ndarray]


def _relative(parent: Pose, child: Pose) -> Pose:
    """T_parent_child of two poses in the world."""
    return parent[1].T @ (child[0] - parent[0]), parent[1].T @ child[1]


def _frame_with_z(axis: np.ndarray) -> np.ndarray:
    """A rotation whose z axis is ``axis``."""
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(helper, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], 1)


# ---------------------------------------------------------------- compiled


@kernel
def _step(
    chain: Chain,
    k: int,
    angle: float,
    position: np.ndarray,
    rotation: np.ndarray,
    new_position: np.ndarray,
    new_rotation: np.ndarray,
) -> None:
    """Joint frame k from the one before, whose arrays it may replace, turned by ``angle``."""
    c, s = np.cos(angle), np.sin(angle)
    for i in range(3):
        new_position[i] = (
            position[i]
            + rotation[i, 0] * chain.offset[k, 0]
            + rotation[i, 1] * chain.offset[k, 1]
            + rotation[i, 2] * chain.offset[k, 2]
        )
        x = y = z = 0.0
        for j in range(3):
            x += rotation[i, j] * chain.turn[k, j, 0]
            y += rotation[i, j] * chain.turn[k, j, 1]
            z += rotation[i, j] * chain.turn[k, j, 2]
        new_rotation[i, 0] = c * x + s * y
        new_rotation[i, 1] = c * y - s * x
        new_rotation[i, 2] = z


@kernel
def _place(
    position: np.ndarray,
    rotation: np.ndarray,
    offset: np.ndarray,
    turn: np.ndarray,
    new_position: np.ndarray,
    new_rotation: np.ndarray,
) -> None:
    for i in range(3):
        new_position[i] = position[i]
        for j in range(3):
            new_position[i] += rotation[i, j] * offset[j]
            new_rotation[i, j] = (
                rotation[i, 0] * turn[0, j]
                + rotation[i, 1] * turn[1, j]
                + rotation[i, 2] * turn[2, j]
            )


@kernel
def joint_frames(chain: Chain, q: np.ndarray, positions: np.ndarray, rotations: np.ndarray) -> None:
    """Fills the joint frames, float64[n, 3] [m, world] and float64[n, 3, 3], of joints q [rad]."""
    for i in range(3):
        positions[0, i] = 0.0
        for j in range(3):
            rotations[0, i, j] = 1.0 if i == j else 0.0
    for k in range(q.shape[0]):
        before = max(k - 1, 0)
        _step(chain, k, q[k], positions[before], rotations[before], positions[k], rotations[k])


@kernel
def tool_and_frames(
    chain: Chain,
    q: np.ndarray,
    positions: np.ndarray,
    rotations: np.ndarray,
    position: np.ndarray,
    rotation: np.ndarray,
) -> None:
    """As :func:`joint_frames`, and fills the tool's float64[3] and float64[3, 3] (world)."""
    joint_frames(chain, q, positions, rotations)
    last = q.shape[0] - 1
    _place(positions[last], rotations[last], chain.tool_offset, chain.tool_turn, position, rotation)


@kernel
def forward(chain: Chain, q: np.ndarray) -> Pose:
    """The tool in the world at joints q, float64[n] [rad]: position float64[3] [m], rotation
    float64[3, 3] (T_world_tool)."""
    n = q.shape[0]
    position, rotation = np.empty(3), np.empty((3, 3))
    tool_and_frames(chain, q, np.empty((n, 3)), np.empty((n, 3, 3)), position, rotation)
    return position, rotation


@kernel
def forward_many(chain: Chain, q: np.ndarray) -> Pose:
    """:func:`forward` of float64[m, n]: float64[m, 3] and float64[m, 3, 3]."""
    m, n = q.shape
    position, rotation = np.empty((m, 3)), np.empty((m, 3, 3))
    positions, rotations = np.empty((n, 3)), np.empty((n, 3, 3))
    for k in range(m):
        tool_and_frames(chain, q[k], positions, rotations, position[k], rotation[k])
    return position, rotation


@kernel
def fill_jacobian(
    positions: np.ndarray, rotations: np.ndarray, position: np.ndarray, out: np.ndarray
) -> None:
    """The geometric Jacobian, float64[6, n], from joint frames and tool position."""
    for k in range(positions.shape[0]):
        ax, ay, az = rotations[k, 0, 2], rotations[k, 1, 2], rotations[k, 2, 2]
        x, y, z = position[0] - positions[k, 0], position[1] - positions[k, 1], position[2]
        z -= positions[k, 2]
        out[0, k] = ay * z - az * y
        out[1, k] = az * x - ax * z
        out[2, k] = ax * y - ay * x
        out[3, k], out[4, k], out[5, k] = ax, ay, az


@kernel
def jacobian(chain: Chain, q: np.ndarray) -> np.ndarray:
    """float64[6, n]: velocity of the tool point [m/s] and angular velocity [rad/s], both in
    world axes, per joint velocity [rad/s]."""
    n = q.shape[0]
    positions, rotations = np.empty((n, 3)), np.empty((n, 3, 3))
    position, out = np.empty(3), np.empty((6, n))
    tool_and_frames(chain, q, positions, rotations, position, np.empty((3, 3)))
    fill_jacobian(positions, rotations, position, out)
    return out
