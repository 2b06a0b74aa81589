"""Contact dynamics as the published simulator computes it: sequential impulses, 50 sweeps.

What is squeezed between a hand that does not yield and a table is decided by which constraint
comes last and how many sweeps there are, and sliding contacts must not lift off. A solver that
converges, on a convex model of friction, throws blocks that the published simulator only nudges.
"""

from __future__ import annotations

import numpy as np
from numba import njit

SWEEPS = 50
CONTACT_SHARE, HOLD_SHARE = 0.08, 0.2
"""Shares of a penetration and of an error of the hold that go in a step."""
SLOP = 1e-5
"""Penetration that is left alone [m]."""
RESIDUAL = 1e-7
"""Squared change of velocity below which the sweeps end [m^2/s^2]."""
DAMPING = 10.0
"""Drag per mass: DAMPING v (1 + |v|), and the same of turns (all protocol 1.1)."""


@njit(cache=True)
def advance(velocity, spin, awake, gravity, timestep):
    """Gravity and drag on bodies float64[b, 3] that are awake, in place."""
    for b in range(velocity.shape[0]):
        if not awake[b]:
            continue
        speed = np.sqrt(np.sum(velocity[b] ** 2))
        rate = np.sqrt(np.sum(spin[b] ** 2))
        for i in range(3):
            velocity[b, i] -= timestep * DAMPING * (1 + speed) * velocity[b, i]
            spin[b, i] -= timestep * DAMPING * (1 + rate) * spin[b, i]
        velocity[b, 2] -= timestep * gravity


@njit(cache=True)
def _along(direction, arm_1, arm_2, v1, w1, v2, w2):
    """Velocity of the second body's point relative to the first one's."""
    total = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        one = v1[i] + w1[j] * arm_1[k] - w1[k] * arm_1[j]
        two = v2[i] + w2[j] * arm_2[k] - w2[k] * arm_2[j]
        total += direction[i] * (two - one)
    return total


@njit(cache=True)
def _push(direction, arm, inverse_mass, inverse_inertia, v, w, impulse):
    for i in range(3):
        v[i] += inverse_mass * impulse * direction[i]
    x = arm[1] * direction[2] - arm[2] * direction[1]
    y = arm[2] * direction[0] - arm[0] * direction[2]
    z = arm[0] * direction[1] - arm[1] * direction[0]
    for i in range(3):
        w[i] += impulse * (
            inverse_inertia[i, 0] * x + inverse_inertia[i, 1] * y + inverse_inertia[i, 2] * z
        )


@njit(cache=True)
def _yielding(direction, arm, inverse_mass, inverse_inertia):
    v, w = np.zeros(3), np.zeros(3)
    _push(direction, arm, inverse_mass, inverse_inertia, v, w, 1.0)
    zero = np.zeros(3)
    return _along(direction, zero, arm, zero, zero, v, w)


@njit(cache=True)
def resolve(
    centre, velocity, spin, inverse_mass, inverse_inertia, first, second, point, frame, distance,
    friction, held, hold_point, hold_error, hold_turn, timestep,
):  # fmt: skip
    """Changes velocity and spin, float64[b, 3], in place.

    Args:
        centre: float64[b, 3] centres of mass [m].
        inverse_mass: float64[b]; 0 for what cannot be moved.
        inverse_inertia: float64[b, 3, 3], world axes.
        first, second: int64[c]: bodies of each contact.
        point: float64[c, 3] [m]; frame: float64[c, 3, 3], its rows the normal from first to
            second and two tangents.
        distance: float64[c], negative where they overlap [m].
        friction: float64[c].
        held: body that hangs on body 1, or -1.
        hold_point: float64[3]: where [m]; hold_error: float64[3]: by how much it is off [m];
            hold_turn: float64[3]: the rotation it lacks [rad].
    """
    count = len(first)
    arm_1, arm_2 = np.empty((count, 3)), np.empty((count, 3))
    mass = np.empty((count, 3))
    impulse = np.zeros((count, 3))
    least = np.empty(count)
    for c in range(count):
        a, b = first[c], second[c]
        arm_1[c], arm_2[c] = point[c] - centre[a], point[c] - centre[b]
        for k in range(3):
            total = _yielding(frame[c, k], arm_1[c], inverse_mass[a], inverse_inertia[a])
            total += _yielding(frame[c, k], arm_2[c], inverse_mass[b], inverse_inertia[b])
            mass[c, k] = 1.0 / total if total > 0 else 0.0
        depth = distance[c] + SLOP
        least[c] = -depth / timestep if depth > 0 else -CONTACT_SHARE * depth / timestep
    axes = np.eye(3)
    hold_1, hold_2 = np.zeros(3), np.zeros(3)
    hold_mass = np.zeros(6)
    if held >= 0:
        hold_1, hold_2 = hold_point - centre[1], hold_point - centre[held]
        for k in range(3):
            hold_mass[k] = 1.0 / _yielding(
                axes[k], hold_2, inverse_mass[held], inverse_inertia[held]
            )
            hold_mass[3 + k] = 1.0 / inverse_inertia[held, k, k]
    for sweep in range(SWEEPS):
        change = 0.0
        if held >= 0:
            for number in range(6):
                row = number if sweep % 2 else 5 - number
                k = row % 3
                if row < 3:
                    wanted = HOLD_SHARE * hold_error[k] / timestep
                    now = _along(
                        axes[k], hold_1, hold_2, velocity[1], spin[1], velocity[held], spin[held]
                    )
                    extra = (wanted - now) * hold_mass[row]
                    _push(
                        axes[k], hold_2, inverse_mass[held], inverse_inertia[held],
                        velocity[held], spin[held], extra,
                    )  # fmt: skip
                else:
                    wanted = HOLD_SHARE * hold_turn[k] / timestep
                    now = spin[held, k] - spin[1, k]
                    extra = (wanted - now) * hold_mass[row]
                    for i in range(3):
                        spin[held, i] += inverse_inertia[held, i, k] * extra
                change = max(change, (wanted - now) ** 2)
        for c in range(count):
            a, b = first[c], second[c]
            now = _along(
                frame[c, 0], arm_1[c], arm_2[c], velocity[a], spin[a], velocity[b], spin[b]
            )
            new = max(impulse[c, 0] + (least[c] - now) * mass[c, 0], 0.0)
            extra = new - impulse[c, 0]
            impulse[c, 0] = new
            if extra != 0:
                _push(frame[c, 0], arm_1[c], inverse_mass[a], inverse_inertia[a], velocity[a], spin[a], -extra)
                _push(frame[c, 0], arm_2[c], inverse_mass[b], inverse_inertia[b], velocity[b], spin[b], extra)
                change = max(change, (extra / mass[c, 0]) ** 2)
        for c in range(count):
            if impulse[c, 0] <= 0 and impulse[c, 1] == 0 and impulse[c, 2] == 0:
                continue
            a, b = first[c], second[c]
            old_1, old_2 = impulse[c, 1], impulse[c, 2]
            now_1 = _along(frame[c, 1], arm_1[c], arm_2[c], velocity[a], spin[a], velocity[b], spin[b])
            now_2 = _along(frame[c, 2], arm_1[c], arm_2[c], velocity[a], spin[a], velocity[b], spin[b])
            new_1, new_2 = old_1 - now_1 * mass[c, 1], old_2 - now_2 * mass[c, 2]
            size, most = np.sqrt(new_1**2 + new_2**2), friction[c] * impulse[c, 0]
            if size > most:
                new_1, new_2 = new_1 * most / size, new_2 * most / size
            impulse[c, 1], impulse[c, 2] = new_1, new_2
            for k in range(1, 3):
                extra = new_1 - old_1 if k == 1 else new_2 - old_2
                _push(frame[c, k], arm_1[c], inverse_mass[a], inverse_inertia[a], velocity[a], spin[a], -extra)
                _push(frame[c, k], arm_2[c], inverse_mass[b], inverse_inertia[b], velocity[b], spin[b], extra)
                change = max(change, (extra / mass[c, k]) ** 2)
        if change < RESIDUAL:
            break


@njit(cache=True)
def wake(awake, first, second, velocity, spin, slow):
    """Bodies that move, are held or pushed, and all that is connected to them by contacts.

    ``awake`` bool[b] comes with what is driven; the world (body 0) connects nothing.
    """
    for b in range(1, len(awake)):
        if np.abs(velocity[b]).max() > slow or 0.025 * np.abs(spin[b]).max() > slow:
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
def move(position, quaternion, velocity, spin, awake, timestep):
    """Poses after a step; quaternions (w, x, y, z)."""
    for b in range(len(awake)):
        if not awake[b]:
            velocity[b] = 0.0
            spin[b] = 0.0
            continue
        position[b] += timestep * velocity[b]
        rate = np.sqrt(np.sum(spin[b] ** 2))
        if rate > 0:
            half = 0.5 * rate * timestep
            s = np.sin(half) / rate
            w, x, y, z = np.cos(half), s * spin[b, 0], s * spin[b, 1], s * spin[b, 2]
            q = quaternion[b].copy()
            quaternion[b, 0] = w * q[0] - x * q[1] - y * q[2] - z * q[3]
            quaternion[b, 1] = w * q[1] + x * q[0] + y * q[3] - z * q[2]
            quaternion[b, 2] = w * q[2] - x * q[3] + y * q[0] + z * q[1]
            quaternion[b, 3] = w * q[3] + x * q[2] - y * q[1] + z * q[0]
            quaternion[b] /= np.sqrt(np.sum(quaternion[b] ** 2))
