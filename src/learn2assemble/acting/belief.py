"""Where blocks are, as far as it was sensed: estimates of poses with their covariances.

A block at rest is estimated by a Kalman filter over all six coordinates: three of its position and
a small rotation about the axes of the world. Between two looks it may creep a little. A reading
that fits the estimate (a gate on its chi-square distance) is averaged in; one that does not is
either an outlier or the block was moved, and only a second reading that fits the first tells: then
the block is where both say. A block of which there is no estimate is not known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix, rotation_of
from learn2assemble.plants.plant import BlockReading

GATE = 27.86
"""A reading of a block at rest is farther off once in 10,000 (chi-square, six degrees)."""
DRIFT, DRIFT_TURN = 1e-5, 5e-5
"""By which a block at rest may creep between two looks: standard deviations [m], [rad]."""
NUDGE, NUDGE_TURN = 0.005, 0.05
"""Standard deviations of how far a block goes that is nudged, or slips in the hand [m], [rad]."""
TINY = 1e-18
"""Added to variances of which the inverse is taken."""


class Estimate(NamedTuple):
    """A pose and how far it may be off."""

    pose: np.ndarray
    """float64[7]: position [m] and quaternion (w, x, y, z)."""
    covariance: np.ndarray
    """float64[6, 6]: of position [m] and a small rotation about fixed axes [rad]."""

    @property
    def spread(self) -> float:
        """Standard deviation of the place along the axis where it is largest [m]."""
        return math.sqrt(max(float(np.linalg.eigvalsh(self.covariance[:3, :3])[-1]), 0.0))

    @property
    def turn_spread(self) -> float:
        """The same of its rotation [rad]."""
        return math.sqrt(max(float(np.linalg.eigvalsh(self.covariance[3:, 3:])[-1]), 0.0))

    def moved(self, step: np.ndarray) -> Estimate:
        """The pose moved by a small step float64[6]."""
        turn = rotation_of(step[3:]) @ quaternion_matrix(self.pose[3:])
        return self._replace(pose=np.array([*(self.pose[:3] + step[:3]), *matrix_quaternion(turn)]))

    def seen_from(self, position: np.ndarray, rotation: np.ndarray) -> Estimate:
        """The same in a frame at a place float64[3] [m] with axes float64[3, 3]."""
        turn = rotation.T @ quaternion_matrix(self.pose[3:])
        place = rotation.T @ (self.pose[:3] - position)
        return Estimate(np.array([*place, *matrix_quaternion(turn)]), _turned(self, rotation.T))

    def seen_in(self, position: np.ndarray, rotation: np.ndarray) -> Estimate:
        """The other way: from that frame into the one that it is given in."""
        turn = rotation @ quaternion_matrix(self.pose[3:])
        place = position + rotation @ self.pose[:3]
        return Estimate(np.array([*place, *matrix_quaternion(turn)]), _turned(self, rotation))


def _turned(estimate: Estimate, rotation: np.ndarray) -> np.ndarray:
    both = np.zeros((6, 6))
    both[:3, :3] = both[3:, 3:] = rotation
    return both @ estimate.covariance @ both.T


def step_between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """float64[6]: by which a pose float64[7] is moved into another: position [m] and the vector of
    its rotation about fixed axes [rad]."""
    turn = quaternion_matrix(end[3:]) @ quaternion_matrix(start[3:]).T
    w, *axis = matrix_quaternion(turn)
    vector = np.array(axis) * (1.0 if w >= 0 else -1.0)
    size = float(np.linalg.norm(vector))
    angle = 2 * math.atan2(size, abs(w))
    return np.array([*(end[:3] - start[:3]), *(vector * (angle / size if size > 1e-12 else 2.0))])


def fused(
    estimate: Estimate, rows: np.ndarray, off: np.ndarray, covariance: np.ndarray
) -> Estimate:
    """An estimate after a measurement (the update of a Kalman filter).

    Args:
        estimate: before.
        rows: float64[m, 6]: what of a small step is measured.
        off: float64[m]: what was measured less what the estimate says.
        covariance: float64[m, m] of the measurement.
    """
    before = estimate.covariance
    total = rows @ before @ rows.T + covariance + TINY * np.eye(len(rows))
    gain = np.linalg.solve(total, rows @ before).T
    left = np.eye(6) - gain @ rows
    after = left @ before @ left.T + gain @ covariance @ gain.T
    return estimate.moved(gain @ off)._replace(covariance=(after + after.T) / 2)


def distance(estimate: Estimate, reading: Estimate) -> float:
    """Chi-square distance of a reading from an estimate."""
    off = step_between(estimate.pose, reading.pose)
    total = estimate.covariance + reading.covariance + TINY * np.eye(6)
    return float(off @ np.linalg.solve(total, off))


def averaged(estimate: Estimate, reading: Estimate) -> Estimate:
    """An estimate after a reading of the whole pose."""
    off = step_between(estimate.pose, reading.pose)
    return fused(estimate, np.eye(6), off, reading.covariance)


def moved_on(known: Estimate | None, seen: Estimate) -> Estimate:
    """An estimate after readings that agree with one another and contradict what was known.

    A block that was nudged, or slipped in the hand, is still near where it was, which counts where
    the readings do not say where it is, as of a block that is half hidden. One that is elsewhere is
    where it is seen.
    """
    if known is None:
        return seen
    nudge = np.diag([NUDGE**2] * 3 + [NUDGE_TURN**2] * 3)
    near = known._replace(covariance=known.covariance + nudge)
    return averaged(near, seen) if distance(near, seen) <= GATE else seen


class Belief:
    """What is known of every block.

    Args:
        alike: by the name of a block, rotations float64[3, 3] that leave its shape as it is, the
            one that does nothing first.
    """

    def __init__(self, alike: Callable[[str], Iterable[np.ndarray]]) -> None:
        self.alike = alike
        self.known: dict[str, Estimate] = {}
        self.rivals: dict[str, Estimate] = {}
        """Readings that did not fit, of which it is not known yet what they mean."""

    def put(self, name: str, estimate: Estimate) -> None:
        """It is known where a block is, for example because the arm has put it there."""
        self.known[name] = estimate
        self.rivals.pop(name, None)

    def forget(self, name: str) -> None:
        """It is not known any more where a block is."""
        self.known.pop(name, None)
        self.rivals.pop(name, None)

    def rest(self) -> None:
        """Time has passed: everything may have crept a little."""
        creep = np.diag([DRIFT**2] * 3 + [DRIFT_TURN**2] * 3)
        for name, one in self.known.items():
            self.known[name] = one._replace(covariance=one.covariance + creep)

    def see(self, name: str, reading: Estimate) -> bool:
        """Take a reading in; whether it is known now where the block is.

        An exact reading is believed at once.
        """
        known, rival = self.known.get(name), self.rivals.get(name)
        reading = self.as_known(name, reading, known or rival)
        if not reading.covariance.any():
            self.put(name, reading)
            return True
        if known is not None and distance(known, reading) <= GATE:
            self.known[name] = averaged(known, reading)
            self.rivals.pop(name, None)
            return True
        if rival is not None and distance(rival, reading) <= GATE:
            self.put(name, moved_on(known, averaged(rival, reading)))
            return True
        self.rivals[name] = reading
        return False

    def as_known(self, name: str, reading: Estimate, known: Estimate | None) -> Estimate:
        """A reading turned, as far as the block looks the same, into how it is known to lie; else
        with its own z axis up as far as it may be."""
        turn = quaternion_matrix(reading.pose[3:])
        wanted = np.eye(3) if known is None else quaternion_matrix(known.pose[3:])
        fits = [turn @ one for one in self.alike(name)]
        if known is None:
            worth = [round(float(one[2, 2]), 3) for one in fits]
        else:
            worth = [round(float(np.trace(wanted.T @ one)), 3) for one in fits]
        best = int(np.argmax(worth))
        if best == 0 or worth[best] <= worth[0]:
            return reading
        pose = np.array([*reading.pose[:3], *matrix_quaternion(fits[best])])
        return reading._replace(pose=pose)

    def state(self) -> dict[str, Any]:
        """What a file says of it."""
        return {
            name: [one.pose.tolist(), one.covariance.tolist()] for name, one in self.known.items()
        }

    def restore(self, state: dict[str, Any]) -> None:
        """As a file says it was."""
        self.rivals.clear()
        self.known = {
            name: Estimate(np.array(pose), np.array(covariance))
            for name, (pose, covariance) in state.items()
        }


def read(one: BlockReading) -> Estimate:
    """A reading as an estimate by itself."""
    return Estimate(one.pose.copy(), one.covariance.copy())
