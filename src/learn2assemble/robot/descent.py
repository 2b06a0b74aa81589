"""Compiled core of the inverse kinematics: damped least squares from one start.

Per iteration, with e the error of the tool (position [m] and rotation vector [rad], world axes),
J the Jacobian and d the pull towards the preferred posture,

    dq = d + J^T (J J^T + lambda I)^-1 (e - J d),

where lambda falls with the square of e (Sugihara 2011), so that the last steps are Newton's. A
joint that would leave its limits is stopped there and the step is solved again without it.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from learn2assemble.robot.kinematics import fill_jacobian, tool_and_frames
from learn2assemble.robot.rotations import (
    factorise,
    logarithm,
    rotation_vector,
    solve_factorised,
)

CONVERGED, STALLED, OUT_OF_STEPS = 0, 1, 2

MAX_SHIFT, MAX_TURN = 0.25, 0.9
"""Largest error a single iteration tries to remove [m], [rad]."""
MAX_STEP = 0.7
"""Largest change of a joint in one iteration [rad]."""
DAMPING, MIN_DAMPING = 0.02, 1e-9
POSTURE_GAIN, POSTURE_FADE = 0.35, 0.15
"""Share of the way to the preferred posture per iteration, and the error below which it fades."""
PATIENCE = 8
"""Iterations without progress before a start is given up."""


@njit(cache=True)
def descend(
    chain, lower, upper, posture, target_position, target_rotation, rows, tolerance,
    max_iterations, q,
):  # fmt: skip
    """Improves q, float64[n] [rad], in place.

    Args:
        chain: see :class:`~learn2assemble.robot.kinematics.Chain`.
        lower, upper: float64[n] [rad]; q must be within them.
        posture: float64[n] [rad], approached as far as the pose leaves freedom.
        target_position: float64[3] [m, world].
        target_rotation: float64[3, 3], T_world_tool.
        rows: 6, or 3 where only the position matters.
        tolerance: on position [m] and rotation [rad] alike.
        max_iterations: steps at most.

    Returns:
        One of the states above, the error (m + rad) at the q left behind, the iterations taken.
    """
    n = q.shape[0]
    positions, rotations = np.empty((n, 3)), np.empty((n, 3, 3))
    position, rotation = np.empty(3), np.empty((3, 3))
    jac, gram = np.empty((6, n)), np.empty((6, 6))
    error, rest = np.zeros(6), np.zeros(6)
    step, pull = np.zeros(n), np.zeros(n)
    free = np.ones(n, np.bool_)
    best, since = np.inf, 0
    total = np.inf
    for iteration in range(max_iterations + 1):
        tool_and_frames(chain, q, positions, rotations, position, rotation)
        for i in range(3):
            error[i] = target_position[i] - position[i]
        shift = np.sqrt(error[0] ** 2 + error[1] ** 2 + error[2] ** 2)
        turn = 0.0
        if rows == 6:
            rotation_vector(rotation, target_rotation, error[3:])
            turn = np.sqrt(error[3] ** 2 + error[4] ** 2 + error[5] ** 2)
        total = shift + turn
        if shift < tolerance and turn < tolerance:
            return CONVERGED, total, iteration
        if iteration == max_iterations:
            break
        since += 1
        if total < 0.95 * best:
            best, since = total, 0
        elif since > PATIENCE:
            return STALLED, total, iteration
        if shift > MAX_SHIFT:
            for i in range(3):
                error[i] *= MAX_SHIFT / shift
        if turn > MAX_TURN:
            for i in range(3, 6):
                error[i] *= MAX_TURN / turn
        fill_jacobian(positions, rotations, position, jac)
        damping = DAMPING * min(total * total, 1.0) + MIN_DAMPING
        gain = POSTURE_GAIN * min(1.0, total / POSTURE_FADE) if n > rows else 0.0
        for k in range(n):
            pull[k] = gain * (posture[k] - q[k])
            free[k] = True
        if not _bounded_step(
            jac, error, rows, damping, pull, q, lower, upper, free, gram, rest, step
        ):
            return STALLED, total, iteration
        largest = 0.0
        for k in range(n):
            largest = max(largest, abs(step[k]))
        scale = min(1.0, MAX_STEP / largest) if largest > 0 else 1.0
        for k in range(n):
            q[k] = min(max(q[k] + scale * step[k], lower[k]), upper[k])
    return OUT_OF_STEPS, total, max_iterations


@njit(cache=True)
def _bounded_step(jac, error, rows, damping, pull, q, lower, upper, free, gram, rest, step):
    """Fills ``step``: the formula above over the joints that do not run into a limit."""
    n = q.shape[0]
    for _ in range(n):
        for i in range(rows):
            rest[i] = error[i]
            for k in range(n):
                rest[i] -= jac[i, k] * (pull[k] if free[k] else step[k])
            for j in range(i + 1):
                total = 0.0
                for k in range(n):
                    if free[k]:
                        total += jac[i, k] * jac[j, k]
                gram[i, j] = total
            gram[i, i] += damping
        if not factorise(gram, rows):
            return False
        solve_factorised(gram, rows, rest)
        stopped = False
        for k in range(n):
            if not free[k]:
                continue
            total = pull[k]
            for i in range(rows):
                total += jac[i, k] * rest[i]
            step[k] = total
            if q[k] + total < lower[k]:
                step[k], stopped, free[k] = lower[k] - q[k], True, False
            elif q[k] + total > upper[k]:
                step[k], stopped, free[k] = upper[k] - q[k], True, False
        if not stopped:
            break
    return True


@njit(cache=True)
def descend_published(chain, target_position, target_rotation, rows, tolerance, max_iterations, q):
    """The published solver (protocol 8.1), improving q in place, without joint limits.

    error = log6(T_target^-1 T(q)), dq = -0.1 J^T (J J^T + 1e-12 I)^-1 error with J in the tool's
    own axes; done when the norm of the error, its first three entries for position only, is below
    the tolerance. These three depend on ``target_rotation``, too. Returns as :func:`descend` does.
    """
    n = q.shape[0]
    positions, rotations = np.empty((n, 3)), np.empty((n, 3, 3))
    position, rotation = np.empty(3), np.empty((3, 3))
    world, jac, gram = np.empty((6, n)), np.empty((6, n)), np.empty((6, 6))
    relative, turn, error = np.empty(3), np.empty((3, 3)), np.zeros(6)
    size = np.inf
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
        for i in range(rows):
            for j in range(i + 1):
                gram[i, j] = 0.0
                for k in range(n):
                    gram[i, j] += jac[i, k] * jac[j, k]
            gram[i, i] += 1e-12
        if not factorise(gram, rows):
            return STALLED, size, iteration
        solve_factorised(gram, rows, error)
        for k in range(n):
            for i in range(rows):
                q[k] -= 0.1 * jac[i, k] * error[i]
    return OUT_OF_STEPS, size, max_iterations
