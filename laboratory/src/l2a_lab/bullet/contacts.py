"""Contact solver of the published cell, after the simulator the authors used.

Free bodies have gravity, drag and sleep; body 0 is the world and body 1 the hand, both moved by
others. At most four contact points for each pair of shapes live on from step to step, with the
normal they began with: a block that slips off an edge is dragged by them.

Motors, hold and contacts are solved by sequential impulses. Where a block is squeezed between a
hand that does not yield and the table, no velocities satisfy all constraints. Which of them gives
way is decided by their order and by the number of sweeps: first motors and hold, then all normals,
then all friction, 50 times. A solver that converges, or one whose friction lifts what slides,
throws blocks that the published simulator only nudges.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from l2a_lab.bullet.resolution import FIRST, HAND, ContactPoints
from learn2assemble.constants import HALF
from learn2assemble.kernels import kernel
from learn2assemble.tasks.world.blocks import GRAVITY

DRAG = 10.0
"""Deceleration per speed: DRAG (1 + speed) [1/s], and the same of turns."""
FASTEST = 100.0
"""Velocities are cut here [m/s], [rad/s]."""
SLOW = 1e-3
"""A body slower than this [m/s] is still ..."""
REST = 10
"""... and after so many steps asleep, with all it touches."""


@kernel
def wake(still: np.ndarray, touching: np.ndarray, held: int) -> np.ndarray:
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


@kernel
def accelerate(twist: np.ndarray, awake: np.ndarray, timestep: float) -> None:
    """Gravity and drag, on twists float64[b, 6] (velocity of the centre of mass, spin), in
    place."""
    for b in range(FIRST, len(awake)):
        if awake[b]:
            speed = np.sqrt(np.sum(twist[b, :3] ** 2))
            rate = np.sqrt(np.sum(twist[b, 3:] ** 2))
            twist[b, :3] *= max(1 - timestep * DRAG * (1 + speed), 0.0)
            twist[b, 3:] *= max(1 - timestep * DRAG * (1 + rate), 0.0)
            twist[b, 2] -= timestep * GRAVITY


@kernel
def turned_inertia(rotation: np.ndarray, inertia: np.ndarray, out: np.ndarray) -> None:
    """Fills R I R^T of float64[3, 3]; written out, as small products cost more as calls of BLAS."""
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                for m in range(3):
                    total += rotation[i, k] * inertia[k, m] * rotation[j, m]
            out[i, j] = total


@kernel
def inverse_mass_matrix(
    inverse_mass: np.ndarray, inverse_inertia: np.ndarray, rotation: np.ndarray, awake: np.ndarray
) -> np.ndarray:
    """float64[b, 6, 6]: twist per impulse at the centre of mass; 0 for what is not awake.

    Args:
        inverse_mass: float64[b] [1/kg].
        inverse_inertia: float64[b, 3, 3], in the body's frame.
        rotation: float64[b, 3, 3].
    """
    out = np.zeros((len(awake), 6, 6))
    for b in range(FIRST, len(awake)):
        if awake[b]:
            for i in range(3):
                out[b, i, i] = inverse_mass[b]
            turned_inertia(rotation[b], inverse_inertia[b], out[b, 3:, 3:])
    return out


@kernel
def integrate(
    position: np.ndarray,
    quaternion: np.ndarray,
    twist: np.ndarray,
    awake: np.ndarray,
    still: np.ndarray,
    timestep: float,
) -> None:
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


POINTS = 4
BREAKING = 0.866e-3
"""A point ends when its ends are farther apart, or have slid farther, than this [m]: 2 % of a
block's half diagonal."""


class Manifolds(NamedTuple):
    """All pairs of ``g`` shapes that touch or did so in the last step."""

    slot: np.ndarray
    """int64[g, g]: row of a pair (first shape, second shape) below, or -1."""
    pair: np.ndarray
    """int64[m, 2]: shapes."""
    count: np.ndarray  # pyright: ignore[reportIncompatibleMethodOverride]
    """int64[m]."""
    one: np.ndarray
    """float64[m, 4, 3]: the point in the frame of the first shape's body [m]."""
    two: np.ndarray
    """float64[m, 4, 3]: in that of the second."""
    normal: np.ndarray
    """float64[m, 4, 3]: from first to second, world frame."""
    distance: np.ndarray
    """float64[m, 4] [m]."""
    since: np.ndarray
    """int64[m]: step at which the pair began."""


def empty_manifolds(shapes: int, pairs: int) -> Manifolds:
    """Room for so many shapes and touching pairs."""
    return Manifolds(
        np.full((shapes, shapes), -1),
        np.full((pairs, 2), -1),
        np.zeros(pairs, np.int64),
        np.zeros((pairs, POINTS, 3)),
        np.zeros((pairs, POINTS, 3)),
        np.zeros((pairs, POINTS, 3)),
        np.zeros((pairs, POINTS)),
        np.zeros(pairs, np.int64),
    )


@kernel
def _local(point: np.ndarray, position: np.ndarray, rotation: np.ndarray, out: np.ndarray) -> None:
    for i in range(3):
        out[i] = 0.0
        for k in range(3):
            out[i] += rotation[k, i] * (point[k] - position[k])


@kernel
def _world(point: np.ndarray, position: np.ndarray, rotation: np.ndarray, out: np.ndarray) -> None:
    for i in range(3):
        out[i] = position[i]
        for k in range(3):
            out[i] += rotation[i, k] * point[k]


@kernel
def _cross_size(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> float:
    """Squared length of (a - b) x (c - d)."""
    ax, ay, az = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    bx, by, bz = c[0] - d[0], c[1] - d[1], c[2] - d[2]
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return x * x + y * y + z * z


@kernel
def _place_for(
    one: np.ndarray, distance: np.ndarray, count: int, point: np.ndarray, depth: float
) -> int:
    """Which point a new one takes the place of: one that is near, a free one, or the one whose
    loss costs least area, but never the deepest."""
    best, nearest = -1, BREAKING**2
    for k in range(count):
        gap = 0.0
        for i in range(3):
            gap += (one[k, i] - point[i]) ** 2
        if gap < nearest:
            nearest, best = gap, k
    if best >= 0:
        return best
    if count < POINTS:
        return count
    deepest, most = -1, depth
    for k in range(POINTS):
        if distance[k] < most:
            most, deepest = distance[k], k
    area, best = -1.0, 0
    others = ((1, 3, 2), (0, 3, 2), (0, 3, 1), (0, 2, 1))
    for k in range(POINTS):
        if k == deepest:
            continue
        a, b, c = others[k]
        size = _cross_size(point, one[a], one[b], one[c])
        if size > area:
            area, best = size, k
    return best


@kernel
def update_manifolds(
    m: Manifolds,
    step: int,
    shapes: np.ndarray,
    body: np.ndarray,
    point: np.ndarray,
    normal: np.ndarray,
    distance: np.ndarray,
    position: np.ndarray,
    rotation: np.ndarray,
) -> None:
    """Bring the manifolds up to date with the contacts found in this step.

    Args:
        m: see :class:`Manifolds`.
        step: number of the step.
        shapes: int64[c, 2] that touch; body: int64[g] of each shape.
        point: float64[c, 3], halfway between the surfaces [m].
        normal: float64[c, 3] from first to second; distance: float64[c] [m].
        position: float64[b, 3] [m]; rotation: float64[b, 3, 3].
    """
    one, two, end, gap = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for c in range(len(shapes)):
        i, j = shapes[c, 0], shapes[c, 1]
        a, b = body[i], body[j]
        row = m.slot[i, j]
        if row < 0:
            row = 0
            while row < len(m.count) and m.pair[row, 0] >= 0:
                row += 1
            if row == len(m.count):
                continue
            m.slot[i, j], m.count[row], m.since[row] = row, 0, step
            m.pair[row, 0], m.pair[row, 1] = i, j
        for k in range(3):
            end[k] = point[c, k] - 0.5 * distance[c] * normal[c, k]
        _local(end, position[a], rotation[a], one)
        for k in range(3):
            end[k] = point[c, k] + 0.5 * distance[c] * normal[c, k]
        _local(end, position[b], rotation[b], two)
        place = _place_for(m.one[row], m.distance[row], m.count[row], one, distance[c])
        m.one[row, place], m.two[row, place] = one, two
        m.normal[row, place], m.distance[row, place] = normal[c], distance[c]
        m.count[row] = max(m.count[row], place + 1)
    for row in range(len(m.count)):
        if m.pair[row, 0] < 0:
            continue
        a, b = body[m.pair[row, 0]], body[m.pair[row, 1]]
        k = m.count[row] - 1
        while k >= 0:
            _world(m.one[row, k], position[a], rotation[a], one)
            _world(m.two[row, k], position[b], rotation[b], two)
            along = 0.0
            for i in range(3):
                gap[i] = two[i] - one[i]
                along += gap[i] * m.normal[row, k, i]
            slid = 0.0
            for i in range(3):
                slid += (gap[i] - along * m.normal[row, k, i]) ** 2
            m.distance[row, k] = along
            if along > BREAKING or slid > BREAKING**2:
                last = m.count[row] - 1
                m.one[row, k], m.two[row, k] = m.one[row, last], m.two[row, last]
                m.normal[row, k], m.distance[row, k] = m.normal[row, last], m.distance[row, last]
                m.count[row] = last
            k -= 1
        if m.count[row] == 0:
            m.slot[m.pair[row, 0], m.pair[row, 1]] = -1
            m.pair[row, 0] = -1


@kernel
def touching_bodies(m: Manifolds, body: np.ndarray) -> np.ndarray:
    """int64[k, 2]: bodies of every pair."""
    rows = np.flatnonzero(m.pair[:, 0] >= 0)
    out = np.empty((len(rows), 2), np.int64)
    for k in range(len(rows)):
        out[k, 0], out[k, 1] = body[m.pair[rows[k], 0]], body[m.pair[rows[k], 1]]
    return out


@kernel
def contact_points(
    m: Manifolds, body: np.ndarray, position: np.ndarray, rotation: np.ndarray, awake: np.ndarray
) -> ContactPoints:
    """The contacts of bodies that are awake, bool[b], the youngest pairs first, as
    :class:`ContactPoints`."""
    rows = np.flatnonzero(m.pair[:, 0] >= 0)
    for r in range(len(rows)):
        if not (awake[body[m.pair[rows[r], 0]]] or awake[body[m.pair[rows[r], 1]]]):
            rows[r] = -1
    rows = rows[rows >= 0]
    rows = rows[np.argsort(-m.since[rows], kind="mergesort")]
    total = m.count[rows].sum()
    out = ContactPoints(
        np.empty(total, np.int64),
        np.empty(total, np.int64),
        np.empty((total, 3)),
        np.empty((total, 3)),
        np.empty((total, 3, 3)),
        np.empty(total),
    )
    c = 0
    for row in rows:
        a, b = body[m.pair[row, 0]], body[m.pair[row, 1]]
        for k in range(m.count[row]):
            out.first[c], out.second[c] = a, b
            _world(m.one[row, k], position[a], rotation[a], out.end_1[c])
            _world(m.two[row, k], position[b], rotation[b], out.end_2[c])
            out.distance[c] = m.distance[row, k]
            n = out.frame[c, 0]
            n[:] = m.normal[row, k]
            # A tangent in the plane of the normal's two largest entries, or nearly so.
            if abs(n[2]) > 0.7:
                size = np.sqrt(n[1] ** 2 + n[2] ** 2)
                out.frame[c, 1] = 0.0, -n[2] / size, n[1] / size
            else:
                size = np.sqrt(n[0] ** 2 + n[1] ** 2)
                out.frame[c, 1] = -n[1] / size, n[0] / size, 0.0
            t, last = out.frame[c, 1], out.frame[c, 2]
            last[0] = n[1] * t[2] - n[2] * t[1]
            last[1] = n[2] * t[0] - n[0] * t[2]
            last[2] = n[0] * t[1] - n[1] * t[0]
            c += 1
    return out
