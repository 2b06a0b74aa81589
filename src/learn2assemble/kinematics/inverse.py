"""Inverse kinematics within joint limits: damped least squares with restarts, compiled.

Per iteration, with e the error of the tool (position [m] and rotation vector [rad], world axes),
J the Jacobian and d the pull towards the preferred posture,

    dq = d + J^T (J J^T + lambda I)^-1 (e - J d),

where lambda falls with the square of e (Sugihara 2011), so that the last steps are Newton's. A
joint that would leave its limits is stopped there and the step is solved again without it.

The first start is the caller's, so that the answer stays near; the next ones come from a table of
fixed configurations, those whose tool is nearest to the target first. Nothing is random. A failure
says which one.
"""

from __future__ import annotations

from enum import IntEnum
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.geometry.rotations import rotation_vector
from learn2assemble.kernels import kernel
from learn2assemble.kinematics.chain import (
    Chain,
    factorise,
    fill_gram,
    fill_jacobian,
    forward_many,
    get_chain,
    jacobian,
    smallest_singular_value,
    solve_factorised,
    tool_and_frames,
)
from learn2assemble.robot.arm import Arm

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


@kernel
def damped_least_squares(
    chain: Chain,
    lower: np.ndarray,
    upper: np.ndarray,
    posture: np.ndarray,
    target_position: np.ndarray,
    target_rotation: np.ndarray,
    rows: int,
    tolerance: float,
    max_iterations: int,
    q: np.ndarray,
) -> tuple[int, float, int]:
    """Improves q, float64[n] [rad], in place.

    Args:
        chain: see :class:`~learn2assemble.kinematics.chain.Chain`.
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


@kernel
def _bounded_step(
    jac: np.ndarray,
    error: np.ndarray,
    rows: int,
    damping: float,
    pull: np.ndarray,
    q: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    free: np.ndarray,
    gram: np.ndarray,
    rest: np.ndarray,
    step: np.ndarray,
) -> bool:
    """Fills ``step``: the formula above over the joints that do not run into a limit."""
    n = q.shape[0]
    for _ in range(n):
        for i in range(rows):
            rest[i] = error[i]
            for k in range(n):
                rest[i] -= jac[i, k] * (pull[k] if free[k] else step[k])
        fill_gram(jac, rows, free, damping, gram)
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


TOLERANCE = 1e-6
"""Largest error of a solution in position [m] and in rotation [rad]."""
SINGULAR_VALUE = 0.005
"""Below this smallest singular value of the Jacobian a configuration counts as singular: there is
a direction in which 5 mm/s of the tool (or 5 mrad/s) cost a joint 1 rad/s."""
RESTARTS = 16
SINGULAR_RESTARTS = 4
"""How many more starts are tried once a singular solution is known."""
NUM_SEEDS = 1024
METRES_PER_RADIAN = 0.3
"""How a rotation compares with a shift when seeds are ranked."""


class IKFailure(IntEnum):
    """Why there is no solution; stored as int8."""

    NONE = 0
    """There is one."""
    OUT_OF_REACH = 1
    """A gap is left even where joint limits do not count."""
    JOINT_LIMIT = 2
    """There is one beyond the limits; within them none was found."""
    SINGULAR = 3
    """Found only with the arm in a singular configuration (:data:`SINGULAR_VALUE`), which it could
    not leave in every direction at bounded joint speed. The joints are those of this solution."""
    NO_CONVERGENCE = 4
    """Not found in the iterations allowed; nothing is proven."""


_NONE, _FAR, _LIMIT, _SINGULAR, _OPEN = (int(failure) for failure in IKFailure)


class Seeds(NamedTuple):
    """Configurations and the tool poses they give."""

    joints: np.ndarray
    """float64[k, n] [rad]."""
    position: np.ndarray
    """float64[k, 3] [m, world]."""
    rotation: np.ndarray
    """float64[k, 3, 3]."""


@lru_cache(maxsize=32)
def ik_seeds(arm: Arm, branch: str | None = None) -> Seeds:
    """Fixed configurations spread evenly over a branch, at most a turn around the home pose."""
    lower, upper = arm.limits(branch)
    lower, upper = np.maximum(lower, arm.home - np.pi), np.minimum(upper, arm.home + np.pi)
    # The additive recurrence of the generalised golden ratio: even in any dimension.
    n = len(lower)
    ratio = 2.0
    for _ in range(60):
        ratio = (1 + ratio) ** (1 / (n + 1))
    share = np.outer(np.arange(1, NUM_SEEDS + 1), ratio ** -np.arange(1.0, n + 1)) % 1
    joints = lower + share * (upper - lower)
    return Seeds(joints, *forward_many(get_chain(arm), joints))


# ---------------------------------------------------------------- compiled


@kernel
def _solve(
    chain: Chain,
    lower: np.ndarray,
    upper: np.ndarray,
    posture: np.ndarray,
    table: Seeds,
    position: np.ndarray,
    rotation: np.ndarray,
    rows: int,
    max_iterations: int,
    restarts: int,
    q: np.ndarray,
) -> tuple[int, float, int]:
    """Leaves the solution in q, which holds the start."""
    n = q.shape[0]
    start = q.copy()
    trial, singular = np.empty(n), np.empty(n)
    best, spent, is_singular, open_end = np.inf, 0, False, False
    ranks = np.empty(0)
    last, left_singular = restarts, 0.0
    reach = _reach(chain)
    away = 0.0
    for i in range(3):
        away += (position[i] - chain.offset[0, i]) ** 2
    if np.sqrt(away) > reach:
        _clip(q, lower, upper)
        return _FAR, np.sqrt(away) - reach, 0
    restart = -1
    while restart < last:
        restart += 1
        if restart == 0:
            _copy(start, trial)
        else:
            if restart == 1:
                ranks = seed_distances(table, position, rotation, rows)
            nearest = 0
            for k in range(ranks.shape[0]):
                if ranks[k] < ranks[nearest]:
                    nearest = k
            ranks[nearest] = np.inf
            _copy(table.joints[nearest], trial)
        _clip(trial, lower, upper)
        state, left, taken = damped_least_squares(
            chain,
            lower,
            upper,
            posture,
            position,
            rotation,
            rows,
            TOLERANCE,
            max_iterations,
            trial,
        )
        spent += taken
        if state == CONVERGED:
            _unwind(trial, start, lower, upper)
            if smallest_singular_value(jacobian(chain, trial), rows) >= SINGULAR_VALUE:
                _copy(trial, q)
                return _NONE, left, spent
            if last > restart + SINGULAR_RESTARTS:
                last = restart + SINGULAR_RESTARTS
            if not is_singular:
                is_singular = True
                _copy(trial, singular)
                left_singular = left
        open_end |= state == OUT_OF_STEPS
        if left < best:
            best = left
            _copy(trial, q)
    if is_singular:
        _copy(singular, q)
        return _SINGULAR, left_singular, spent
    # Which of the others: the same without limits, from the best that was found and from the start.
    below, above = np.empty(n), np.empty(n)
    for k in range(n):
        below[k], above[k] = -1e3, 1e3
    for restart in range(2):
        _copy(q if restart == 0 else start, trial)
        state, left, taken = damped_least_squares(
            chain,
            below,
            above,
            posture,
            position,
            rotation,
            rows,
            TOLERANCE,
            max_iterations,
            trial,
        )
        spent += taken
        if state == CONVERGED:
            _unwind(trial, start, lower, upper)
            if not _inside(trial, lower, upper):
                return _LIMIT, best, spent
            _copy(trial, q)
            if smallest_singular_value(jacobian(chain, q), rows) < SINGULAR_VALUE:
                return _SINGULAR, left, spent
            return _NONE, left, spent
        open_end |= state == OUT_OF_STEPS
    return (_OPEN if open_end else _FAR), best, spent


@kernel
def _reach(chain: Chain) -> float:
    """An upper bound of how far the tool can be from the first joint [m]."""
    total = _length(chain.tool_offset)
    for k in range(1, chain.offset.shape[0]):
        total += _length(chain.offset[k])
    return total


@kernel
def _length(vector: np.ndarray) -> float:
    return np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)


@kernel
def _copy(source: np.ndarray, target: np.ndarray) -> None:
    # Slices would say the same, but take seconds to compile.
    for k in range(source.shape[0]):
        target[k] = source[k]


@kernel
def seed_distances(
    table: Seeds, position: np.ndarray, rotation: np.ndarray, rows: int
) -> np.ndarray:
    """Distances of the table's tool poses from the target [m], rotations counted as metres."""
    count = table.joints.shape[0]
    out = np.empty(count)
    for k in range(count):
        square = 0.0
        for i in range(3):
            square += (table.position[k, i] - position[i]) ** 2
        if rows == 6:
            trace = 0.0
            for i in range(3):
                for j in range(3):
                    trace += table.rotation[k, i, j] * rotation[i, j]
            angle = np.arccos(min(max(0.5 * (trace - 1), -1.0), 1.0))
            square += (METRES_PER_RADIAN * angle) ** 2
        out[k] = square
    return out


@kernel
def _clip(q: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> None:
    for k in range(q.shape[0]):
        q[k] = min(max(q[k], lower[k]), upper[k])


@kernel
def _unwind(q: np.ndarray, start: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> None:
    """Takes off whole turns of joints where that brings them nearer to the start, or inside."""
    turn = 2 * np.pi
    for k in range(q.shape[0]):
        wanted = q[k] - turn * np.floor((q[k] - start[k]) / turn + 0.5)
        while wanted < lower[k]:
            wanted += turn
        while wanted > upper[k]:
            wanted -= turn
        if lower[k] <= wanted <= upper[k]:
            q[k] = wanted


@kernel
def _inside(q: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> bool:
    for k in range(q.shape[0]):  # noqa: SIM110 (compiled)
        if q[k] < lower[k] or q[k] > upper[k]:
            return False
    return True


class Solution(NamedTuple):
    """Joints for a pose of the tool."""

    joints: np.ndarray
    """float64[n] [rad]; after a failure the best that was found."""
    failure: IKFailure
    error: float
    """Distance [m] plus angle [rad] that is left."""
    iterations: int
    """Over all starts."""

    @property
    def ok(self) -> bool:
        return self.failure == IKFailure.NONE


def solve(
    arm: Arm,
    position: np.ndarray,
    rotation: np.ndarray | None,
    start: np.ndarray | None = None,
    *,
    branch: str | None = None,
    max_iterations: int = 60,
    restarts: int = RESTARTS,
) -> Solution:
    """Joints that bring the tool to a pose.

    Args:
        arm: whose tool.
        position: float64[3] [m, world].
        rotation: float64[3, 3], T_world_tool; None where only the position matters.
        start: float64[n] [rad], tried first; the home pose by default.
        branch: a name of ``arm.branches``, by default the first; ``"any"`` for all the joints'
            range.
        max_iterations: per start.
        restarts: how many other starts are tried where the first leads nowhere.

    Raises:
        InputError: where a shape is wrong, a number not finite or a matrix not a rotation.
        UnknownNameError: for a branch there is not.
    """
    position = _checked("position", position, 3)
    rows = 3 if rotation is None else 6
    rotation = _checked("rotation", np.eye(3) if rotation is None else rotation, 3, 3)
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6:
        raise InputError("rotation", rotation.tolist(), "a rotation matrix")
    joints = _checked("start", arm.home if start is None else start, len(arm.joints))
    # Copies: a read-only array is another type, and would be compiled for anew.
    lower, upper = (limit.copy() for limit in arm.limits(branch))
    failure, error, iterations = _solve(
        get_chain(arm),
        lower,
        upper,
        arm.home.copy(),
        ik_seeds(arm, branch),
        position,
        rotation,
        rows,
        max_iterations,
        restarts,
        joints,
    )
    return Solution(joints, IKFailure(failure), error, iterations)


def _checked(name: str, values: np.ndarray, *shape: int) -> np.ndarray:
    """A copy as float64 of this shape."""
    array = np.array(values, float, order="C")
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(name, array.tolist(), f"{shape} finite numbers")
    return array
