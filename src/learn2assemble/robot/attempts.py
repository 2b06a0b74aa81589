"""Several starts for one pose, and the reason where none leads there. Compiled.

The first start is the caller's; the next ones come from a table of fixed configurations, those
whose tool is nearest to the target first. Nothing is random: the same question has the same answer.
"""

from __future__ import annotations

from enum import IntEnum
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.descent import CONVERGED, OUT_OF_STEPS, descend, descend_published
from learn2assemble.robot.kinematics import forward_many, get_chain, jacobian
from learn2assemble.robot.rotations import smallest_singular_value

TOLERANCE = 1e-6
"""Largest error of a solution in position [m] and in rotation [rad]."""
SINGULAR_VALUE = 0.005
"""Below this smallest singular value of the Jacobian a configuration counts as singular: there is
a direction in which 5 mm/s of the tool (or 5 mrad/s) cost a joint 1 rad/s."""
MAX_ITERATIONS, PUBLISHED_ITERATIONS = 60, 1000
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
def seeds(arm: Arm, branch: str | None = None) -> Seeds:
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


@njit(cache=True)
def solve_published(
    chain, position, rotation, rows, max_iterations, joints, failure, error, iterations
):
    for k in range(position.shape[0]):
        state, error[k], iterations[k] = descend_published(
            chain, position[k], rotation[k], rows, TOLERANCE, max_iterations, joints[k]
        )
        failure[k] = _NONE if state == CONVERGED else _OPEN


@njit(cache=True)
def solve_all(
    chain, lower, upper, posture, table, position, rotation, rows, max_iterations, restarts,
    joints, failure, error, iterations,
):  # fmt: skip
    for k in range(position.shape[0]):
        failure[k], error[k], iterations[k] = _solve_one(
            chain, lower, upper, posture, table, position[k], rotation[k], rows, max_iterations,
            restarts, joints[k],
        )  # fmt: skip


@njit(cache=True)
def _solve_one(
    chain, lower, upper, posture, table, position, rotation, rows, max_iterations, restarts, q
):
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
    attempt = -1
    while attempt < last:
        attempt += 1
        if attempt == 0:
            _copy(start, trial)
        else:
            if attempt == 1:
                ranks = _ranks(table, position, rotation, rows)
            nearest = 0
            for k in range(ranks.shape[0]):
                if ranks[k] < ranks[nearest]:
                    nearest = k
            ranks[nearest] = np.inf
            _copy(table.joints[nearest], trial)
        _clip(trial, lower, upper)
        state, left, taken = descend(
            chain, lower, upper, posture, position, rotation, rows, TOLERANCE, max_iterations,
            trial,
        )  # fmt: skip
        spent += taken
        if state == CONVERGED:
            _unwind(trial, start, lower, upper)
            if smallest_singular_value(jacobian(chain, trial), rows) >= SINGULAR_VALUE:
                _copy(trial, q)
                return _NONE, left, spent
            if last > attempt + SINGULAR_RESTARTS:
                last = attempt + SINGULAR_RESTARTS
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
    for attempt in range(2):
        _copy(q if attempt == 0 else start, trial)
        state, left, taken = descend(
            chain, below, above, posture, position, rotation, rows, TOLERANCE, max_iterations,
            trial,
        )  # fmt: skip
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


@njit(cache=True)
def _reach(chain):
    """An upper bound of how far the tool can be from the first joint [m]."""
    total = _length(chain.tool_offset)
    for k in range(1, chain.offset.shape[0]):
        total += _length(chain.offset[k])
    return total


@njit(cache=True)
def _length(vector):
    return np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)


@njit(cache=True)
def _copy(source, target):
    # Slices would say the same, but take seconds to compile.
    for k in range(source.shape[0]):
        target[k] = source[k]


@njit(cache=True)
def _ranks(table, position, rotation, rows):
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


@njit(cache=True)
def _clip(q, lower, upper):
    for k in range(q.shape[0]):
        q[k] = min(max(q[k], lower[k]), upper[k])


@njit(cache=True)
def _unwind(q, start, lower, upper):
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


@njit(cache=True)
def _inside(q, lower, upper):
    for k in range(q.shape[0]):  # noqa: SIM110 (compiled)
        if q[k] < lower[k] or q[k] > upper[k]:
            return False
    return True
