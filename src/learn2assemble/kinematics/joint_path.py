"""Paths through joint positions: cubic splines with continuous velocity and acceleration."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.robot.arm import Limits

_SAME = 1e-9
"""Joint positions nearer than this, as a share of a second at full speed, are one."""


class JointPath(NamedTuple):
    """A cubic spline with natural ends; s counts seconds at the full speed of the fastest joint."""

    knots: np.ndarray
    """float64[k], increasing from 0 [s]."""
    joints: np.ndarray
    """float64[k, n] [rad]."""
    bend: np.ndarray
    """float64[k, n]: second derivative at the knots [rad/s^2]."""

    @property
    def length(self) -> float:
        """Where the path ends [s]."""
        return float(self.knots[-1])

    def at(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, first and second derivative by s, each float64[m, n], at s float64[m]."""
        if len(self.knots) == 1:
            still = np.zeros((len(s), self.joints.shape[1]))
            return still + self.joints[0], still, still
        piece = np.clip(np.searchsorted(self.knots, s, "right") - 1, 0, len(self.knots) - 2)
        h = np.diff(self.knots)[piece][:, None]
        u = np.asarray(s)[:, None] - self.knots[piece][:, None]
        q, m0, m1 = self.joints[piece], self.bend[piece], self.bend[piece + 1]
        slope = (self.joints[piece + 1] - q) / h - h * (2 * m0 + m1) / 6
        third = (m1 - m0) / h
        return (
            q + u * (slope + u * (m0 / 2 + u * third / 6)),
            slope + u * (m0 + u * third / 2),
            m0 + u * third,
        )

    def bounds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Upper bounds of the first three derivatives' magnitudes per piece, float64[k-1, n]."""
        h = np.diff(self.knots)[:, None]
        m0, m1 = self.bend[:-1], self.bend[1:]
        mean = np.diff(self.joints, axis=0) / h
        left, right = mean - h * (2 * m0 + m1) / 6, mean + h * (m0 + 2 * m1) / 6
        # The control polygon of the derivative, a parabola, contains it.
        first = np.max(np.abs([left, left + m0 * h / 2, right]), axis=0)
        return first, np.maximum(np.abs(m0), np.abs(m1)), np.abs(m1 - m0) / h


def joint_path(joints: np.ndarray, limits: Limits) -> JointPath:
    """The path through joint positions float64[k, n] [rad]; repeated ones count once.

    Raises:
        InputError: where a number is not finite.
    """
    joints = np.atleast_2d(np.asarray(joints, float))
    if not np.isfinite(joints).all():
        raise InputError("joints", joints.tolist(), "finite numbers")
    gap = np.max(np.abs(np.diff(joints, axis=0)) / limits.velocity, axis=1)
    kept = np.concatenate([[True], gap > _SAME])
    joints = joints[kept].copy()
    knots = np.concatenate([[0.0], np.cumsum(gap[kept[1:]])])
    return JointPath(knots, joints, _bends(knots, joints))


def _bends(knots: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Second derivatives at the knots that make the first ones continuous, 0 at both ends."""
    bend = np.zeros_like(joints)
    if len(knots) > 2:
        h = np.diff(knots)
        mean = np.diff(joints, axis=0) / h[:, None]
        inner = np.diag(2 * (h[:-1] + h[1:])) + np.diag(h[1:-1], 1) + np.diag(h[1:-1], -1)
        bend[1:-1] = np.linalg.solve(inner, 6 * np.diff(mean, axis=0))
    return bend
