"""Inverse kinematics within joint limits; a failure says which one.

One descent (:mod:`learn2assemble.robot.descent`) starts where the caller says, so that the answer
stays near; where that leads nowhere, others follow (:mod:`learn2assemble.robot.attempts`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.errors import InputError, look_up
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.attempts import (
    MAX_ITERATIONS,
    PUBLISHED_ITERATIONS,
    RESTARTS,
    IKFailure,
    seeds,
    solve_all,
    solve_published,
)
from learn2assemble.robot.kinematics import get_chain

__all__ = ["IKFailure", "Solution", "Solutions", "solve", "solve_many"]


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


class Solutions(NamedTuple):
    """Joints for m poses; see :class:`Solution`."""

    joints: np.ndarray
    """float64[m, n]."""
    failure: np.ndarray
    """int8[m] of :class:`IKFailure`."""
    error: np.ndarray
    """float64[m]."""
    iterations: np.ndarray
    """int64[m]."""

    @property
    def ok(self) -> np.ndarray:
        """bool[m]."""
        return self.failure == IKFailure.NONE


def solve(
    arm: Arm,
    position: np.ndarray,
    rotation: np.ndarray | None,
    start: np.ndarray | None = None,
    *,
    branch: str | None = None,
    method: str = "limits",
    max_iterations: int | None = None,
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
        method: ``"limits"``, or ``"published"``: protocol 8.1, without limits and restarts.
        max_iterations: per start; 60, and 1000 for the published method.
        restarts: how many other starts are tried where the first leads nowhere.

    Raises:
        InputError: where a shape is wrong, a number not finite or a matrix not a rotation.
        UnknownNameError: for a branch or method there is not.
    """
    many = solve_many(
        arm, np.asarray(position, float)[None],
        None if rotation is None else np.asarray(rotation, float)[None], start,
        branch=branch, method=method, max_iterations=max_iterations, restarts=restarts,
    )  # fmt: skip
    return Solution(
        many.joints[0], IKFailure(int(many.failure[0])), float(many.error[0]),
        int(many.iterations[0]),
    )  # fmt: skip


def solve_many(
    arm: Arm,
    position: np.ndarray,
    rotation: np.ndarray | None,
    start: np.ndarray | None = None,
    *,
    branch: str | None = None,
    method: str = "limits",
    max_iterations: int | None = None,
    restarts: int = RESTARTS,
) -> Solutions:
    """:func:`solve` for float64[m, 3] and float64[m, 3, 3]; ``start`` for all or one for each."""
    look_up("method", method, {"limits": None, "published": None})
    n = len(arm.joints)
    position = np.ascontiguousarray(position, float)
    m = len(position)
    _check("position", position, (m, 3))
    rows = 3 if rotation is None else 6
    if rotation is None:
        rotation = np.broadcast_to(np.eye(3), (m, 3, 3)).copy()
    else:
        rotation = np.ascontiguousarray(rotation, float)
        _check("rotation", rotation, (m, 3, 3))
        if np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(initial=0) > 1e-6:
            raise InputError("rotation", rotation.tolist(), "rotation matrices")
    start = np.array(arm.home if start is None else start, float)
    if start.ndim == 1:
        start = np.broadcast_to(start, (m, len(start)))
    _check("start", start, (m, n))
    joints = np.array(start, order="C")
    out = Solutions(joints, np.empty(m, np.int8), np.empty(m), np.empty(m, np.int64))
    chain = get_chain(arm)
    if method == "published":
        solve_published(
            chain, position, rotation, rows,
            PUBLISHED_ITERATIONS if max_iterations is None else max_iterations, *out,
        )  # fmt: skip
    else:
        # Copies: a read-only array is another type, and would be compiled for anew.
        lower, upper = (limit.copy() for limit in arm.limits(branch))
        solve_all(
            chain, lower, upper, arm.home.copy(), seeds(arm, branch), position, rotation, rows,
            MAX_ITERATIONS if max_iterations is None else max_iterations, restarts, *out,
        )  # fmt: skip
    return out


def _check(name: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(name, array.tolist(), f"{shape} finite numbers")
