"""Where the program of :mod:`.program` begins: every brick borne by three pushes.

From the farthest brick to the nearest, what a brick weighs, and what is on it, is borne by three of
the pushes of joints that lead nearer to what is held: by three round the middle of the load where
there are such, which then push. Level forces, and the couple about the vertical, are those of one
of these joints. So many forces are the basis of a solution that is right but for the pushes that
would have to pull; where these are few, the program takes a few steps in place of one for each
row.
"""

from __future__ import annotations

import numpy as np

from learn2assemble.kernels import kernel
from learn2assemble.statics.holding.forces import Columns
from learn2assemble.statics.holding.passing_on import ranked

_MOST = 50
"""Bricks not borne by three pushes with which the program is as quick from nothing."""


def first_basis(
    columns: Columns, weight: np.ndarray, centre: np.ndarray, free: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """A basis: which forces are in it, bool[n], and which rows of blocks, bool[count, 6].

    Args:
        columns: of joints of bricks, whose pushes are all vertical.
        weight: float64[count].
        centre: float64[count, 3], where weights act.
        free: bool[count], blocks that have to be balanced.

    Returns:
        It, or None where there is none, as some brick has no three pushes, or none that helps.
    """
    count, n = len(weight), len(columns.b)
    a, b = columns.a, columns.b
    push = columns.lower == 0
    if not n or np.abs(columns.force[push, :2]).max(initial=0.0) > 0:
        return None
    real = np.flatnonzero(a >= 0)
    of = np.concatenate([a[real], b])
    touching = np.concatenate([real, np.arange(n)])[np.argsort(of, kind="stable")]
    start = np.append(0, np.cumsum(np.bincount(of, minlength=count)))
    order, rank = ranked(start, touching, a, b, np.ones(n, bool), free)
    if len(order) < free.sum():
        return None
    basic, rows = np.zeros(n, bool), np.zeros((count, 6), bool)
    rows[~free] = True
    if not _borne(order, rank, start, touching, a, b, columns.at, push, weight, centre, basic):
        return None
    # Level forces and couples: of one joint of each brick, best one that has a couple.
    level = np.flatnonzero(~push)
    lower = np.where(a[level] >= 0, rank[a[level]], 0)
    brick = np.where(lower < rank[b[level]], b[level], a[level])
    nearer = np.minimum(lower, rank[b[level]]) < np.maximum(lower, rank[b[level]])
    level, brick = level[nearer], brick[nearer]
    joint = (a[level] + 1) * (count + 1) + b[level]
    turns = columns.couple[level, 2] != 0
    whole = np.isin(joint, joint[turns])
    sort = np.lexsort((joint, ~whole, brick))
    level, brick, joint, whole = level[sort], brick[sort], joint[sort], whole[sort]
    known, first = np.unique(brick, return_index=True)
    if len(known) < free.sum():
        return None
    place = np.searchsorted(known, brick)
    mine = joint == joint[first][place]
    basic[level[mine]] = True
    rows[known[~whole[first]], 5] = True
    return (basic, rows) if basic.sum() + rows.sum() == 6 * count else None


@kernel
def _borne(  # pragma: no cover
    order: np.ndarray,
    rank: np.ndarray,
    start: np.ndarray,
    touching: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    at: np.ndarray,
    push: np.ndarray,
    weight: np.ndarray,
    centre: np.ndarray,
    basic: np.ndarray,
) -> bool:
    """Put three pushes of every brick into ``basic``; False where one has no three, or where many
    are not borne by pushes."""
    pulled = 0
    force = weight.copy()
    moment = np.empty((len(weight), 2))
    for m in range(len(weight)):
        for c in range(2):
            moment[m, c] = weight[m] * centre[m, c]
    widest = 1
    for m in range(len(weight)):
        widest = max(widest, start[m + 1] - start[m])
    x, y, up = np.empty(widest), np.empty(widest), np.empty(widest)
    column, other = np.empty(widest, np.int64), np.empty(widest, np.int64)
    chosen = np.zeros(3, np.int64)
    for position in range(len(order) - 1, -1, -1):
        m = order[position]
        count = 0
        for i in range(start[m], start[m + 1]):
            k = touching[i]
            o = a[k] if b[k] == m else b[k]
            if push[k] and (o < 0 or rank[o] < rank[m]):
                x[count], y[count] = at[k, 0], at[k, 1]
                up[count] = 1.0 if b[k] == m else -1.0
                column[count], other[count] = k, o
                count += 1
        if count < 3:
            return False
        around = False
        if force[m] > 0:
            around = _around(
                x, y, up, count, moment[m, 0] / force[m], moment[m, 1] / force[m], chosen
            )
        if not around:
            pulled += 1
            if pulled > _MOST or not _wide(x, y, count, chosen):
                return False
        p, q, r = chosen
        u, v = x[q] - x[p], y[q] - y[p]
        s, t = x[r] - x[p], y[r] - y[p]
        along = moment[m, 0] - force[m] * x[p], moment[m, 1] - force[m] * y[p]
        area = u * t - s * v
        second = (along[0] * t - along[1] * s) / area
        third = (u * along[1] - v * along[0]) / area
        for which, size in ((p, force[m] - second - third), (q, second), (r, third)):
            basic[column[which]] = True
            o = other[which]
            if o >= 0:
                force[o] += size
                moment[o, 0] += size * x[which]
                moment[o, 1] += size * y[which]
    return True


@kernel
def _around(  # pragma: no cover
    x: np.ndarray,
    y: np.ndarray,
    up: np.ndarray,
    count: int,
    at_x: float,
    at_y: float,
    chosen: np.ndarray,
) -> bool:
    """Three pushes from below around a point: the nearest one, and those that lie next to the line
    from it through the point, to its left and to its right; False where there are none."""
    nearest, least = -1, np.inf
    for i in range(count):
        far = (x[i] - at_x) ** 2 + (y[i] - at_y) ** 2
        if up[i] > 0 and 1e-12 < far < least:
            nearest, least = i, far
    if nearest < 0:
        return False
    way_x, way_y = at_x - x[nearest], at_y - y[nearest]
    left, right, most, fewest = -1, -1, np.inf, -np.inf
    for i in range(count):
        if up[i] > 0 and i != nearest:
            to_x, to_y = x[i] - at_x, y[i] - at_y
            angle = np.arctan2(way_x * to_y - way_y * to_x, way_x * to_x + way_y * to_y)
            if 0 <= angle < most:
                left, most = i, angle
            elif fewest < angle < 0:
                right, fewest = i, angle
    chosen[0], chosen[1], chosen[2] = nearest, left, right
    # Straight across would be no triangle.
    return left >= 0 and right >= 0 and 1e-6 < most - fewest < np.pi - 1e-6


@kernel
def _wide(  # pragma: no cover
    x: np.ndarray, y: np.ndarray, count: int, chosen: np.ndarray
) -> bool:
    """Three pushes far from one line; False where all are on one."""
    first, second, third, most = 0, 0, 0, 0.0
    for i in range(count):
        far = (x[i] - x[first]) ** 2 + (y[i] - y[first]) ** 2
        if far > most:
            second, most = i, far
    limit, most = 1e-6 * most, 0.0
    for i in range(count):
        far = abs(
            (x[i] - x[first]) * (y[second] - y[first]) - (y[i] - y[first]) * (x[second] - x[first])
        )
        if far > most:
            third, most = i, far
    chosen[0], chosen[1], chosen[2] = first, second, third
    return most > limit
