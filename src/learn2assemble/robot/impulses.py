"""Contact dynamics as the published simulator computes it: sequential impulses, 50 sweeps.

What is squeezed between hand and table is decided by which constraint comes last and by how many
sweeps there are, and sliding contacts must not lift off. A solver that converges, on a convex
model of friction, throws blocks that the published simulator only nudges.
"""

from __future__ import annotations

import numpy as np
from numba import njit

SWEEPS = 50
CONTACT_SHARE, HOLD_SHARE, STOP_SHARE = 0.08, 0.2, 0.2
"""Shares of a penetration, of an error of the hold and of what a joint is beyond its limit that
go in a step."""
MOTOR_SHARE = 0.1
"""Share of the distance to its command that a joint goes in a step."""
SLOP = 1e-5
"""Penetration that is left alone [m]."""
RESIDUAL = 1e-7
"""Squared change of velocity below which the sweeps end [m^2/s^2]."""
DAMPING = 10.0
"""Drag per mass: DAMPING v (1 + |v|), and the same of turns (all protocol 1.1)."""
HAND = 1
"""Number of the body the arm moves; 0 is the world."""


@njit(cache=True)
def advance(twist, awake, gravity, timestep):
    """Gravity and drag on bodies, twist float64[b, 6], that are awake, in place."""
    for b in range(twist.shape[0]):
        if not awake[b]:
            continue
        speed = np.sqrt(np.sum(twist[b, :3] ** 2))
        rate = np.sqrt(np.sum(twist[b, 3:] ** 2))
        for i in range(3):
            twist[b, i] -= timestep * DAMPING * (1 + speed) * twist[b, i]
            twist[b, 3 + i] -= timestep * DAMPING * (1 + rate) * twist[b, 3 + i]
        twist[b, 2] -= timestep * gravity


@njit(cache=True)
def _row(direction, point, centre, sign, out):
    """Unit wrench float64[6] of an impulse along a direction at a point, on a body's centre."""
    x, y, z = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    out[0], out[1], out[2] = sign * direction[0], sign * direction[1], sign * direction[2]
    out[3] = y * out[2] - z * out[1]
    out[4] = z * out[0] - x * out[2]
    out[5] = x * out[1] - y * out[0]


@njit(cache=True)
def _dot(a, b):
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b[i]
    return total


@njit(cache=True)
def _add(a, factor, b):
    for i in range(a.shape[0]):
        a[i] += factor * b[i]


@njit(cache=True)
def resolve(
    centre, twist, yielding, first, second, end_1, end_2, frame, distance, friction,
    held, hold_point, hold_error, jac, inverse, joints, rates, command, lower, upper, largest,
    timestep,
):  # fmt: skip
    """Changes twist, float64[b, 6] (velocity of the centre and spin), and rates in place.

    Args:
        centre: float64[b, 3] centres of mass; of the hand its tool point [m].
        yielding: float64[b, 6, 6]: twist per impulse; 0 for what cannot be moved.
        first, second: int64[c]: bodies of each contact.
        point: float64[c, 3] [m]; frame: float64[c, 3, 3], its rows the normal from first to
            second and two tangents.
        distance: float64[c], negative where they overlap [m].
        friction: float64[c].
        held: body that hangs on the hand, or -1.
        hold_point: float64[3]: where [m]; hold_error: float64[6]: by how much it is off [m, rad].
        jac: float64[6, n] of the tool; inverse: float64[n, n] of the arm's mass matrix.
        joints, rates, command, lower, upper: float64[n]; see :class:`~.servo.Servo`.
        largest: impulse of a motor in a step [N m s].
    """
    count, n = len(first), len(rates)
    one, two = np.zeros((count, 3, 6)), np.zeros((count, 3, 6))
    give_1, give_2 = np.zeros((count, 3, 6)), np.zeros((count, 3, 6))
    arm = inverse @ jac.T
    reach = np.zeros((count, 3, n))
    mass, impulse = np.empty((count, 3)), np.zeros((count, 3))
    least = np.empty(count)
    for c in range(count):
        a, b = first[c], second[c]
        for k in range(3):
            _row(frame[c, k], end_1[c], centre[a], -1.0, one[c, k])
            _row(frame[c, k], end_2[c], centre[b], 1.0, two[c, k])
            give_1[c, k] = yielding[a] @ one[c, k]
            give_2[c, k] = yielding[b] @ two[c, k]
            mass[c, k] = 1.0 / (_dot(one[c, k], give_1[c, k]) + _dot(two[c, k], give_2[c, k]))
            if a == HAND:
                reach[c, k] = arm @ one[c, k]
            elif b == HAND:
                reach[c, k] = arm @ two[c, k]
        depth = distance[c] + SLOP
        least[c] = -depth / timestep if depth > 0 else -CONTACT_SHARE * depth / timestep
    axes = np.eye(3)
    hand_row, held_row = np.zeros((6, 6)), np.zeros((6, 6))
    hand_give, held_give = np.zeros((6, 6)), np.zeros((6, 6))
    hold_reach, hold_mass = np.zeros((6, n)), np.zeros(6)
    if held >= 0:
        for k in range(3):
            _row(axes[k], hold_point, centre[HAND], -1.0, hand_row[k])
            _row(axes[k], hold_point, centre[held], 1.0, held_row[k])
            hand_row[3 + k, 3 + k], held_row[3 + k, 3 + k] = -1.0, 1.0
        for k in range(6):
            hand_give[k], held_give[k] = yielding[HAND] @ hand_row[k], yielding[held] @ held_row[k]
            hold_reach[k] = arm @ hand_row[k]
            hold_mass[k] = 1.0 / (_dot(hand_row[k], hand_give[k]) + _dot(held_row[k], held_give[k]))
    motor, stop = np.zeros(n), np.zeros(n)
    turn = np.ascontiguousarray((jac @ inverse).T)
    for sweep in range(SWEEPS):
        change = 0.0
        for number in range(2 * n + 6):
            row = number if sweep % 2 else 2 * n + 5 - number
            if row >= 2 * n:
                if held < 0:
                    continue
                k = row - 2 * n
                now = _dot(hand_row[k], twist[HAND]) + _dot(held_row[k], twist[held])
                extra = (HOLD_SHARE * hold_error[k] / timestep - now) * hold_mass[k]
                _add(twist[HAND], extra, hand_give[k])
                _add(twist[held], extra, held_give[k])
                _add(rates, extra, hold_reach[k])
                change = max(change, (extra / hold_mass[k]) ** 2)
                continue
            i = row % n
            if row < n:
                below, above = lower[i] - joints[i], joints[i] - upper[i]
                if below <= 0 and above <= 0:
                    continue
                if below > 0:
                    new = stop[i] + (STOP_SHARE * below / timestep - rates[i]) / inverse[i, i]
                    new = max(new, 0.0)
                else:
                    new = stop[i] + (-STOP_SHARE * above / timestep - rates[i]) / inverse[i, i]
                    new = min(new, 0.0)
                extra = new - stop[i]
                stop[i] = new
            else:
                wanted = MOTOR_SHARE * (command[i] - joints[i]) / timestep
                new = motor[i] + (wanted - rates[i]) / inverse[i, i]
                new = min(max(new, -largest), largest)
                extra = new - motor[i]
                motor[i] = new
            _add(rates, extra, inverse[i])
            _add(twist[HAND], extra, turn[i])
            change = max(change, (extra * inverse[i, i]) ** 2)
        for c in range(count):
            a, b = first[c], second[c]
            now = _dot(one[c, 0], twist[a]) + _dot(two[c, 0], twist[b])
            new = max(impulse[c, 0] + (least[c] - now) * mass[c, 0], 0.0)
            extra = new - impulse[c, 0]
            if extra != 0:
                impulse[c, 0] = new
                _add(twist[a], extra, give_1[c, 0])
                _add(twist[b], extra, give_2[c, 0])
                if a == HAND or b == HAND:
                    _add(rates, extra, reach[c, 0])
                change = max(change, (extra / mass[c, 0]) ** 2)
        for c in range(count):
            if impulse[c, 0] <= 0 and impulse[c, 1] == 0 and impulse[c, 2] == 0:
                continue
            a, b = first[c], second[c]
            old_1, old_2 = impulse[c, 1], impulse[c, 2]
            now_1 = _dot(one[c, 1], twist[a]) + _dot(two[c, 1], twist[b])
            now_2 = _dot(one[c, 2], twist[a]) + _dot(two[c, 2], twist[b])
            new_1, new_2 = old_1 - now_1 * mass[c, 1], old_2 - now_2 * mass[c, 2]
            size, most = np.sqrt(new_1**2 + new_2**2), friction[c] * impulse[c, 0]
            if size > most:
                new_1, new_2 = new_1 * most / size, new_2 * most / size
            impulse[c, 1], impulse[c, 2] = new_1, new_2
            for k in range(1, 3):
                extra = new_1 - old_1 if k == 1 else new_2 - old_2
                _add(twist[a], extra, give_1[c, k])
                _add(twist[b], extra, give_2[c, k])
                if a == HAND or b == HAND:
                    _add(rates, extra, reach[c, k])
                change = max(change, (extra / mass[c, k]) ** 2)
        if change < RESIDUAL:
            break


@njit(cache=True)
def wake(awake, first, second, twist, slow):
    """Bodies that move, are held or pushed, and all that is connected to them by contacts.

    ``awake`` bool[b] comes with what is driven; the world (body 0) connects nothing.
    """
    for b in range(1, len(awake)):
        if np.abs(twist[b, :3]).max() > slow or 0.025 * np.abs(twist[b, 3:]).max() > slow:
            awake[b] = True
    changed = True
    while changed:
        changed = False
        for c in range(len(first)):
            a, b = first[c], second[c]
            if a > 0 and b > 0 and awake[a] != awake[b]:
                awake[a] = awake[b] = True
                changed = True


@njit(cache=True)
def move(position, quaternion, twist, awake, timestep):
    """Poses after a step; quaternions (w, x, y, z)."""
    for b in range(len(awake)):
        if not awake[b]:
            twist[b] = 0.0
            continue
        position[b] += timestep * twist[b, :3]
        rate = np.sqrt(np.sum(twist[b, 3:] ** 2))
        if rate > 0:
            half = 0.5 * rate * timestep
            s = np.sin(half) / rate
            w, x, y, z = np.cos(half), s * twist[b, 3], s * twist[b, 4], s * twist[b, 5]
            q = quaternion[b].copy()
            quaternion[b, 0] = w * q[0] - x * q[1] - y * q[2] - z * q[3]
            quaternion[b, 1] = w * q[1] + x * q[0] + y * q[3] - z * q[2]
            quaternion[b, 2] = w * q[2] - x * q[3] + y * q[0] + z * q[1]
            quaternion[b, 3] = w * q[3] + x * q[2] - y * q[1] + z * q[0]
            quaternion[b] /= np.sqrt(np.sum(quaternion[b] ** 2))
