"""Bodies that nothing guides: gravity, drag, sleep and motion (protocol 1.1).

Body 0 is the world and body 1 the hand; both are moved by others.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from learn2assemble.world.blocks import GRAVITY, HALF

DRAG = 10.0
"""Deceleration per speed: DRAG (1 + speed) [1/s], and the same of turns."""
FASTEST = 100.0
"""Velocities are cut here [m/s], [rad/s]."""
SLOW = 1e-3
"""A body slower than this [m/s] is still ..."""
REST = 10
"""... and after so many steps asleep, with all it touches."""
HAND = 1
FIRST = 2
"""First of the free bodies."""


@njit(cache=True)
def rotations(quaternion):
    """float64[b, 3, 3] of quaternions float64[b, 4] (w, x, y, z)."""
    out = np.empty((len(quaternion), 3, 3))
    for b in range(len(quaternion)):
        w, x, y, z = quaternion[b]
        out[b, 0] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        out[b, 1] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        out[b, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return out


@njit(cache=True)
def wake(still, touching, held):
    """bool[b]: bodies that are in motion, held or touched by what is.

    Args:
        still: int64[b]: steps for which a body has been still; set to 0 where it is awake for
            another reason.
        touching: int64[m, 2]: bodies that touch; the world (body 0) connects nothing.
        held: body in the hand, or -1.
    """
    awake = still < REST
    awake[0], awake[HAND] = False, True
    if held >= 0:
        awake[held] = True
    changed = True
    while changed:
        changed = False
        for c in range(len(touching)):
            a, b = touching[c, 0], touching[c, 1]
            if a > 0 and b > 0 and awake[a] != awake[b]:
                awake[a] = awake[b] = changed = True
    for b in range(FIRST, len(awake)):
        if awake[b] and still[b] >= REST:
            still[b] = 0
    return awake


@njit(cache=True)
def accelerate(twist, awake, timestep):
    """Gravity and drag, on twists float64[b, 6] (velocity of the centre of mass, spin), in
    place."""
    for b in range(FIRST, len(awake)):
        if awake[b]:
            speed = np.sqrt(np.sum(twist[b, :3] ** 2))
            rate = np.sqrt(np.sum(twist[b, 3:] ** 2))
            twist[b, :3] *= max(1 - timestep * DRAG * (1 + speed), 0.0)
            twist[b, 3:] *= max(1 - timestep * DRAG * (1 + rate), 0.0)
            twist[b, 2] -= timestep * GRAVITY


@njit(cache=True)
def yields(inverse_mass, inverse_inertia, rotation, awake):
    """float64[b, 6, 6]: twist per impulse at the centre of mass; 0 for what is not awake.

    Args:
        inverse_mass: float64[b] [1/kg].
        inverse_inertia: float64[b, 3, 3], in the body's frame.
        rotation: float64[b, 3, 3].
    """
    out = np.zeros((len(awake), 6, 6))
    for b in range(FIRST, len(awake)):
        if awake[b]:
            out[b, :3, :3] = inverse_mass[b] * np.eye(3)
            out[b, 3:, 3:] = rotation[b] @ inverse_inertia[b] @ rotation[b].T
    return out


@njit(cache=True)
def move(position, quaternion, twist, awake, still, timestep):
    """Poses and stillness after a step, in place."""
    for b in range(FIRST, len(awake)):
        if not awake[b]:
            twist[b] = 0.0
            still[b] = REST
            continue
        for i in range(6):
            twist[b, i] = min(max(twist[b, i], -FASTEST), FASTEST)
        position[b] += timestep * twist[b, :3]
        rate = np.sqrt(np.sum(twist[b, 3:] ** 2))
        speed = np.abs(twist[b, :3]).max()
        still[b] = still[b] + 1 if max(speed, HALF * rate) < SLOW else 0
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
