"""Motions as piecewise polynomials whose velocities, accelerations and jerks are bounded between
samples, too, and the slower ones that keep within limits."""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.robot.arm import Limits

REST = 2e-6
"""Changes of a rounded joint position [rad] and velocities [rad/s] up to this are rest."""
MARGIN = 1e-3
"""Share of a limit that a motion which has to be slowed down stays below it."""
PARTS = 4
"""Every polynomial is bounded in so many parts."""


class Knots(NamedTuple):
    """A motion: a quintic between each two knots, continuous up to the acceleration."""

    time: np.ndarray
    """float64[k], increasing [s]."""
    position: np.ndarray
    """float64[k, n] [rad]."""
    velocity: np.ndarray
    """float64[k, n] [rad/s]."""
    acceleration: np.ndarray
    """float64[k, n] [rad/s^2]."""

    def coefficients(self) -> np.ndarray:
        """float64[k-1, n, 6]: of the powers of u, which runs from 0 to 1 between two knots."""
        h = np.diff(self.time)[:, None]
        d = np.diff(self.position, axis=0)
        v0, v1 = self.velocity[:-1] * h, self.velocity[1:] * h
        a0, a1 = self.acceleration[:-1] * h**2, self.acceleration[1:] * h**2
        return np.stack(
            [
                self.position[:-1],
                v0,
                a0 / 2,
                10 * d - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1,
                -15 * d + 8 * v0 + 7 * v1 + 1.5 * a0 - a1,
                6 * d - 3 * (v0 + v1) - 0.5 * (a0 - a1),
            ],
            -1,
        )

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, velocities and accelerations, each float64[m, n], at times float64[m]."""
        piece = self.pieces(time)
        first = int(piece.min(initial=len(self.time)))
        used = Knots(*(part[first : int(piece.max(initial=0)) + 2] for part in self))
        piece = piece - first
        h = np.diff(used.time)[piece][:, None]
        u = (np.clip(time, used.time[0], used.time[-1]) - used.time[piece])[:, None] / h
        c = np.moveaxis(used.coefficients()[piece], -1, 0)
        q, v, a = c[5], 5 * c[5], 20 * c[5]
        for m in (4, 3, 2, 1, 0):
            q = q * u + c[m]
            v = v * u + m * c[m] if m >= 1 else v
            a = a * u + m * (m - 1) * c[m] if m >= 2 else a
        return q, v / h, a / h**2

    def pieces(self, time: np.ndarray) -> np.ndarray:
        """int64[m]: the pieces in which times float64[m] lie."""
        found = np.searchsorted(self.time, np.asarray(time), "right") - 1
        return np.clip(found, 0, len(self.time) - 2)

    def bounds(self) -> Limits:
        """What position, velocity, acceleration and jerk never leave between two knots: their
        magnitudes float64[k-1, n] per piece, and positions from ``lower`` to ``upper``."""
        c: np.ndarray = self.coefficients()
        h = np.diff(self.time)[:, None]
        found: list[tuple[np.ndarray, np.ndarray]] = []
        for order in range(4):
            found.append(_ends(c, 5 - order))
            c = _slope(c)
        (lower, upper), *rates = found
        v, a, j = (np.maximum(-low, high) / h**k for k, (low, high) in enumerate(rates, 1))
        return Limits(v, a, j, lower, upper)


def _ends(c: np.ndarray, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest control points of polynomials float64[..., d+1], each float64[...]."""
    points: list[np.ndarray] = [c @ part.T for part in _control_points(degree)]
    low, high = points[0].min(-1), points[0].max(-1)
    for other in points[1:]:
        low, high = np.minimum(other.min(-1), low), np.maximum(other.max(-1), high)
    return low, high


def _slope(c: np.ndarray) -> np.ndarray:
    """Coefficients of the derivatives of polynomials float64[..., d+1]."""
    return np.multiply(c[..., 1:], np.arange(1, int(c.shape[-1])))


@cache
def _control_points(degree: int) -> np.ndarray:
    """float64[PARTS, d+1, d+1]: from coefficients of powers of u in [0, 1] to the control points
    of the polynomial in each part of that range."""
    out = np.zeros((PARTS, degree + 1, degree + 1))
    for part in range(PARTS):
        # u = (part + w) / PARTS, then powers of w to control points.
        powers = np.zeros((degree + 1, degree + 1))
        for m in range(degree + 1):
            for j in range(m + 1):
                powers[j, m] = math.comb(m, j) * part ** (m - j) / PARTS**m
        for i in range(degree + 1):
            for j in range(i + 1):
                out[part, i] += math.comb(i, j) / math.comb(degree, j) * powers[j]
    return out


def fit(time: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> Knots:
    """The motion through samples, from rest to rest.

    Args:
        time: float64[k], increasing [s].
        position: float64[k, n] [rad].
        velocity: float64[k, n] [rad/s].
    """
    import scipy.linalg  # pyright: ignore[reportMissingTypeStubs]

    acceleration = np.zeros_like(position)
    if len(time) > 2:
        h = np.diff(time)[:, None]
        d = np.diff(position, axis=0)
        # The jerk at a knot from the left equals that from the right.
        v = velocity
        left = (60 * d[:-1] - h[:-1] * (24 * v[:-2] + 36 * v[1:-1])) / h[:-1] ** 3
        right = (60 * d[1:] - h[1:] * (36 * v[1:-1] + 24 * v[2:])) / h[1:] ** 3
        matrix = np.zeros((3, len(time) - 2))
        matrix[0, 1:] = matrix[2, :-1] = -3 / h[1:-1, 0]
        matrix[1] = 9 / h[:-1, 0] + 9 / h[1:, 0]
        lapack: Any = scipy.linalg  # Its types are known in part.
        acceleration[1:-1] = lapack.solve_banded((1, 1), matrix, right - left)
    return Knots(time, position, velocity, acceleration)


def slow_down(motion: Knots, limits: Limits) -> tuple[Knots, float]:
    """The motion on the same path with its time stretched so that all limits hold.

    Returns:
        the motion, and by what its time was multiplied, 1 or more.

    Raises:
        InputError: where a joint leaves its range, which no slower motion helps against.
    """
    bounds = motion.bounds()
    if not len(bounds.velocity):
        return motion, 1.0
    out = (bounds.lower < limits.lower - REST) | (bounds.upper > limits.upper + REST)
    if out.any():
        i, j = np.argwhere(out)[0].tolist()
        got = f"joint {j + 1} at {bounds.lower[i, j]:.6f} to {bounds.upper[i, j]:.6f} rad"
        inside = f"{limits.lower[j]:.6f} to {limits.upper[j]:.6f} rad between the samples"
        raise InputError(f"motion at {motion.time[i]:.2f} s", got, inside)
    needed = max(
        float((bound / limit).max()) ** (1 / order)
        for order, (bound, limit) in enumerate(zip(bounds[:3], limits[:3], strict=True), 1)
    )
    if needed <= 1:
        return motion, 1.0
    factor = needed / (1 - MARGIN)
    start = motion.time[0]
    return Knots(
        start + (motion.time - start) * factor,
        motion.position,
        motion.velocity / factor,
        motion.acceleration / factor**2,
    ), factor


def usage(knots: Knots, limits: Limits) -> dict[str, float]:
    """Largest share of the limits of velocity, acceleration and jerk that a motion uses."""
    bounds = knots.bounds()
    return {
        name: float((getattr(bounds, name) / getattr(limits, name)).max(initial=0.0))
        for name in ("velocity", "acceleration", "jerk")
    }
