"""Impulses that keep bodies apart, joints in their limits and the hand at what it holds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.constants import FRICTION
from learn2assemble.kernels import kernel

TABLE, HAND, FIRST = 0, 1, 2
"""Bodies: the world, the hand, and the first of the free ones."""


SWEEPS = 50


CONTACT_SHARE, HOLD_SHARE, STOP_SHARE = 0.08, 0.2, 0.2
"""Shares of a penetration, of an error of the hold and of an angle beyond a stop that go in a
step."""


MOTOR_SHARE = 0.1
"""Share of the way to its command that a joint goes in a step."""


SLOP = 1e-5
"""Penetration that is left alone [m]."""


RESIDUAL = 1e-7
"""Squared change of a velocity below which the sweeps end."""


class ContactPoints(NamedTuple):
    """Points where bodies touch."""

    first: np.ndarray
    """int64[c]: body."""
    second: np.ndarray
    """int64[c]: body."""
    end_1: np.ndarray
    """float64[c, 3]: the point on the first body [m, world]."""
    end_2: np.ndarray
    """float64[c, 3]: on the second [m, world]."""
    frame: np.ndarray
    """float64[c, 3, 3]: rows the normal from first to second and two tangents, world frame."""
    distance: np.ndarray
    """float64[c]: negative where they overlap [m]."""


class Drive(NamedTuple):
    """The arm in this step; all arrays per joint."""

    jacobian: np.ndarray
    """float64[6, n] of the tool, world axes."""
    inverse: np.ndarray
    """float64[n, n] of the mass matrix."""
    joints: np.ndarray
    """[rad]."""
    command: np.ndarray
    """Where the motors want them [rad]."""
    lower: np.ndarray
    """[rad]."""
    upper: np.ndarray
    """[rad]."""
    impulse: float
    """Largest of a motor in a step [N m s]."""


class HandHold(NamedTuple):
    """The constraint between hand and held object."""

    body: int
    """-1: the hand is empty."""
    point: np.ndarray
    """float64[3]: of the object, to be at the tool point [m, world]."""
    error: np.ndarray
    """float64[6]: shift [m] and rotation [rad] the object lacks, world axes."""


@kernel
def _dot(a: np.ndarray, i: int, b: np.ndarray, j: int) -> float:
    """Of row i of float64[r, 6] and row j of another; written out, as all sweeps are made of it."""
    return (
        a[i, 0] * b[j, 0]
        + a[i, 1] * b[j, 1]
        + a[i, 2] * b[j, 2]
        + a[i, 3] * b[j, 3]
        + a[i, 4] * b[j, 4]
        + a[i, 5] * b[j, 5]
    )


@kernel
def _add(a: np.ndarray, i: int, factor: float, b: np.ndarray, j: int) -> None:
    """To row i of float64[r, 6] a multiple of row j of another."""
    a[i, 0] += factor * b[j, 0]
    a[i, 1] += factor * b[j, 1]
    a[i, 2] += factor * b[j, 2]
    a[i, 3] += factor * b[j, 3]
    a[i, 4] += factor * b[j, 4]
    a[i, 5] += factor * b[j, 5]


@kernel
def _add_rates(rates: np.ndarray, factor: float, reach: np.ndarray, row: int) -> None:
    for i in range(rates.shape[0]):
        rates[i] += factor * reach[row, i]


@kernel
def _times(matrix: np.ndarray, vector: np.ndarray, out: np.ndarray) -> None:
    """Small products without a call of BLAS, which takes longer than they do."""
    for i in range(matrix.shape[0]):
        total = 0.0
        for k in range(matrix.shape[1]):
            total += matrix[i, k] * vector[k]
        out[i] = total


@kernel
def _wrench(
    direction: np.ndarray, point: np.ndarray, centre: np.ndarray, sign: float, out: np.ndarray
) -> None:
    """float64[6]: impulse of size ``sign`` along a direction at a point, about a centre."""
    x, y, z = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    out[0], out[1], out[2] = sign * direction[0], sign * direction[1], sign * direction[2]
    out[3] = y * out[2] - z * out[1]
    out[4] = z * out[0] - x * out[2]
    out[5] = x * out[1] - y * out[0]


@kernel
def resolve(
    centre: np.ndarray,
    twist: np.ndarray,
    rates: np.ndarray,
    inverse_mass: np.ndarray,
    contacts: ContactPoints,
    drive: Drive,
    hold: HandHold,
    timestep: float,
) -> None:
    """Changes twists and rates in place.

    Args:
        centre: float64[b, 3]: centres of mass; of the hand its tool point [m].
        twist: float64[b, 6]: velocity of the centre [m/s] and spin [rad/s].
        rates: float64[n] of the joints [rad/s].
        inverse_mass: float64[b, 6, 6]: twist per impulse; 0 for what does not move. The hand's is
            filled in here.
        contacts: see :class:`ContactPoints`; drive: :class:`Drive`; hold: :class:`HandHold`.
        timestep: [s].
    """
    count, n = len(contacts.first), len(rates)
    # M^-1 J^T: what a wrench on the hand does to the rates, and a joint to the hand.
    arm = np.empty((n, 6))
    for k in range(6):
        _times(drive.inverse, drive.jacobian[k], arm[:, k])
    for k in range(6):
        _times(drive.jacobian, arm[:, k], inverse_mass[HAND, :, k])
    # Rows of contacts, then six of the hold: wrenches on both bodies, and what they do.
    total = 3 * count + 6
    one, two = np.zeros((total, 6)), np.zeros((total, 6))
    effect_1, effect_2 = np.zeros((total, 6)), np.zeros((total, 6))
    reach, mass, impulse = np.zeros((total, n)), np.zeros(total), np.zeros(total)
    least = np.empty(count)
    for c in range(count):
        a, b = contacts.first[c], contacts.second[c]
        for k in range(3):
            row = 3 * c + k
            _wrench(contacts.frame[c, k], contacts.end_1[c], centre[a], -1.0, one[row])
            _wrench(contacts.frame[c, k], contacts.end_2[c], centre[b], 1.0, two[row])
            _times(inverse_mass[a], one[row], effect_1[row])
            _times(inverse_mass[b], two[row], effect_2[row])
            mass[row] = 1.0 / (_dot(one, row, effect_1, row) + _dot(two, row, effect_2, row))
            if a == HAND:
                _times(arm, one[row], reach[row])
            elif b == HAND:
                _times(arm, two[row], reach[row])
        depth = contacts.distance[c] + SLOP
        least[c] = -depth / timestep if depth > 0 else -CONTACT_SHARE * depth / timestep
    first_hold, held = 3 * count, hold.body
    if held >= 0:
        axes = np.eye(3)
        for k in range(6):
            row = first_hold + k
            if k < 3:
                _wrench(axes[k], hold.point, centre[HAND], -1.0, one[row])
                _wrench(axes[k], hold.point, centre[held], 1.0, two[row])
            else:
                one[row, k], two[row, k] = -1.0, 1.0
            _times(inverse_mass[HAND], one[row], effect_1[row])
            _times(inverse_mass[held], two[row], effect_2[row])
            _times(arm, one[row], reach[row])
            mass[row] = 1.0 / (_dot(one, row, effect_1, row) + _dot(two, row, effect_2, row))
    # Of a named tuple, every look at an array counts its users again: taken out once.
    inverse, first, second = drive.inverse, contacts.first, contacts.second
    goal, gain = _goals(drive, timestep)
    most_motor, hold_error = drive.impulse, hold.error
    motor = np.zeros(2 * n)
    guided = 2 * n + (6 if held >= 0 else 0)
    for sweep in range(SWEEPS):
        change = 0.0
        for number in range(guided):
            # Motors, stops, hold, and every other time backwards.
            index = number if sweep % 2 else guided - 1 - number
            if index < 2 * n:
                i = index % n
                if gain[index] == 0.0:
                    continue
                new = motor[index] + (goal[index] - rates[i]) * gain[index]
                if index < n:
                    new = min(max(new, -most_motor), most_motor)
                elif goal[index] > 0:
                    new = max(new, 0.0)
                else:
                    new = min(new, 0.0)
                extra = new - motor[index]
                motor[index] = new
                _add_rates(rates, extra, inverse, i)
                # The mass matrix is symmetric: a row of M^-1 J^T is what a joint does to the hand.
                _add(twist, HAND, extra, arm, i)
                moved = extra / gain[index]
            else:
                k = index - 2 * n
                row = first_hold + k
                now = _dot(one, row, twist, HAND) + _dot(two, row, twist, held)
                moved = HOLD_SHARE * hold_error[k] / timestep - now
                extra = moved * mass[row]
                _add(twist, HAND, extra, effect_1, row)
                _add(twist, held, extra, effect_2, row)
                _add_rates(rates, extra, reach, row)
            change = max(change, moved * moved)
        for c in range(count):
            a, b, row = first[c], second[c], 3 * c
            now = _dot(one, row, twist, a) + _dot(two, row, twist, b)
            new = max(impulse[row] + (least[c] - now) * mass[row], 0.0)
            extra = new - impulse[row]
            if extra != 0:
                impulse[row] = new
                _apply(a, b, extra, effect_1, effect_2, reach, row, twist, rates)
                change = max(change, (extra / mass[row]) ** 2)
        for c in range(count):
            row = 3 * c
            if impulse[row] <= 0 and impulse[row + 1] == 0 and impulse[row + 2] == 0:
                continue
            a, b = first[c], second[c]
            x = impulse[row + 1] - mass[row + 1] * (
                _dot(one, row + 1, twist, a) + _dot(two, row + 1, twist, b)
            )
            y = impulse[row + 2] - mass[row + 2] * (
                _dot(one, row + 2, twist, a) + _dot(two, row + 2, twist, b)
            )
            size, most = np.sqrt(x * x + y * y), FRICTION * impulse[row]
            if size > most:
                x, y = x * most / size, y * most / size
            for k in range(1, 3):
                new = x if k == 1 else y
                extra = new - impulse[row + k]
                impulse[row + k] = new
                _apply(a, b, extra, effect_1, effect_2, reach, row + k, twist, rates)
                change = max(change, (extra / mass[row + k]) ** 2)
        if change < RESIDUAL:
            break


@kernel
def _apply(
    a: int,
    b: int,
    extra: float,
    effect_1: np.ndarray,
    effect_2: np.ndarray,
    reach: np.ndarray,
    row: int,
    twist: np.ndarray,
    rates: np.ndarray,
) -> None:
    _add(twist, a, extra, effect_1, row)
    _add(twist, b, extra, effect_2, row)
    if a == HAND or b == HAND:
        _add_rates(rates, extra, reach, row)


@kernel
def _goals(drive: Drive, timestep: float) -> tuple[np.ndarray, np.ndarray]:
    """What rates the motors and then the stops want, float64[2 n] [rad/s], and the impulse for a
    change of the rate of 1 rad/s; 0 for the stop of a joint that is within its limits."""
    n = len(drive.joints)
    goal, gain = np.zeros(2 * n), np.zeros(2 * n)
    for i in range(n):
        own = 1.0 / drive.inverse[i, i]
        goal[i] = MOTOR_SHARE * (drive.command[i] - drive.joints[i]) / timestep
        gain[i] = own
        below, above = drive.lower[i] - drive.joints[i], drive.joints[i] - drive.upper[i]
        if below > 0 or above > 0:
            goal[n + i] = STOP_SHARE * (below if below > 0 else -above) / timestep
            gain[n + i] = own
    return goal, gain
