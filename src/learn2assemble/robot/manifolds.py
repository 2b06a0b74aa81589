"""Contact points that live on from step to step, at most four for each pair of shapes.

The published simulator keeps a point while its two ends stay together, with the normal it began
with; a block that slips off an edge is dragged by such points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from learn2assemble.robot.impulses import Contacts

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
    count: np.ndarray
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


def empty(shapes: int, pairs: int) -> Manifolds:
    """Room for so many shapes and touching pairs."""
    return Manifolds(
        np.full((shapes, shapes), -1), np.full((pairs, 2), -1), np.zeros(pairs, np.int64),
        np.zeros((pairs, POINTS, 3)), np.zeros((pairs, POINTS, 3)), np.zeros((pairs, POINTS, 3)),
        np.zeros((pairs, POINTS)), np.zeros(pairs, np.int64),
    )  # fmt: skip


@njit(cache=True)
def _local(point, position, rotation, out):
    for i in range(3):
        out[i] = 0.0
        for k in range(3):
            out[i] += rotation[k, i] * (point[k] - position[k])


@njit(cache=True)
def _cross_size(a, b):
    x = a[1] * b[2] - a[2] * b[1]
    y = a[2] * b[0] - a[0] * b[2]
    z = a[0] * b[1] - a[1] * b[0]
    return x * x + y * y + z * z


@njit(cache=True)
def _place_for(one, distance, count, point, depth):
    """Which point a new one takes the place of: one that is near, a free one, or the one whose
    loss costs least area, but never the deepest."""
    best, nearest = -1, BREAKING**2
    for k in range(count):
        gap = np.sum((one[k] - point) ** 2)
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
        size = _cross_size(point - one[a], one[b] - one[c])
        if size > area:
            area, best = size, k
    return best


@njit(cache=True)
def update(m, step, shapes, body, point, normal, distance, position, rotation):
    """Bring the manifolds up to date with the contacts found in this step.

    Args:
        m: see :class:`Manifolds`.
        step: number of the step.
        shapes: int64[c, 2] that touch; body: int64[g] of each shape.
        point: float64[c, 3], halfway between the surfaces [m].
        normal: float64[c, 3] from first to second; distance: float64[c] [m].
        position: float64[b, 3] [m]; rotation: float64[b, 3, 3].
    """
    one, two, end = np.empty(3), np.empty(3), np.empty(3)
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
            first = position[a] + rotation[a] @ m.one[row, k]
            second = position[b] + rotation[b] @ m.two[row, k]
            gap = second - first
            along = 0.0
            for i in range(3):
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


@njit(cache=True)
def touching(m, body):
    """int64[k, 2]: bodies of every pair."""
    rows = np.flatnonzero(m.pair[:, 0] >= 0)
    out = np.empty((len(rows), 2), np.int64)
    for k in range(len(rows)):
        out[k, 0], out[k, 1] = body[m.pair[rows[k], 0]], body[m.pair[rows[k], 1]]
    return out


@njit(cache=True)
def points(m, body, position, rotation, awake):
    """The contacts of bodies that are awake, bool[b], the youngest pairs first, as
    :class:`~.impulses.Contacts`."""
    rows = np.flatnonzero(m.pair[:, 0] >= 0)
    for r in range(len(rows)):
        if not (awake[body[m.pair[rows[r], 0]]] or awake[body[m.pair[rows[r], 1]]]):
            rows[r] = -1
    rows = rows[rows >= 0]
    rows = rows[np.argsort(-m.since[rows], kind="mergesort")]
    total = m.count[rows].sum()
    out = Contacts(
        np.empty(total, np.int64), np.empty(total, np.int64), np.empty((total, 3)),
        np.empty((total, 3)), np.empty((total, 3, 3)), np.empty(total),
    )  # fmt: skip
    c = 0
    for row in rows:
        a, b = body[m.pair[row, 0]], body[m.pair[row, 1]]
        for k in range(m.count[row]):
            out.first[c], out.second[c] = a, b
            out.end_1[c] = position[a] + rotation[a] @ m.one[row, k]
            out.end_2[c] = position[b] + rotation[b] @ m.two[row, k]
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
            out.frame[c, 2] = np.cross(n, out.frame[c, 1])
            c += 1
    return out
