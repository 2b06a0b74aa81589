r"""Loads passed down a stack, block by block: compiled.

The bed faces of a block answer its load with the smallest change of their forces that balances it
and stays non-negative, a quadratic program in three multipliers solved by Newton's method.

**Mending.** Where a block cannot answer on its own, those that load it can shift their load to
others: it is balanced together with the blocks on it, the other blocks that carry those, and so on
outwards, as few as it takes, by the method of :mod:`.elastic` with dense matrices. Forces from
blocks that are not among them are held, and blocks below them answer afterwards.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.kernels import kernel
from learn2assemble.statics.elastic import HALVINGS, LEAK, LEAST_LEAK, MOST_LEAK, ROUNDING, STEPS

MOST_MENDED, MOST_MENDINGS = 48, 60
"""Blocks that are balanced together at most, and how often in one change of a stack."""
_ITERATIONS = 40
_POINTS = 256
"""Under one block, at most."""


class StackLoad(NamedTuple):
    """A stack under one load: points and centres are sheared by it."""

    px: np.ndarray
    py: np.ndarray
    """float64[P]: points between blocks [m]."""
    cx: np.ndarray
    cy: np.ndarray
    """float64[n]: centres of mass [m]."""
    weight: np.ndarray
    """float64[n]."""
    share: np.ndarray
    """float64[P]: area that belongs to the point."""
    start: np.ndarray
    """int64[n + 1]: block b rests on the points ``start[b]:start[b + 1]``."""
    upper: np.ndarray
    lower: np.ndarray
    """int64[P]: the blocks above and below the point, -1 for the table."""
    above: np.ndarray
    """int64: points that rest on each block, at ``above_start[b]:above_start[b + 1]``."""
    above_start: np.ndarray
    order: np.ndarray
    """int64: all blocks that are in no ring, each before those it rests on."""
    turn: np.ndarray
    """int64[n]: where each block is in ``order``."""
    unit: float
    """Of lever arms [m]."""


@kernel
def settle(
    load: StackLoad, force: np.ndarray, placed: np.ndarray, dirty: np.ndarray, mends: bool
) -> bool:
    """Balance every block that is ``dirty``, from above; True where all could be.

    Args:
        force: float64[P], changed in place also where it fails.
        placed, dirty: bool[n]; blocks that have to answer are added to ``dirty``.
        mends: whether a block that cannot answer is balanced together with others.
    """
    # Joints of blocks that are not there carry nothing.
    live = load.share.copy()
    for p in range(len(force)):
        a = load.lower[p]
        if not placed[load.upper[p]] or (a >= 0 and not placed[a]):
            force[p] = 0.0
            live[p] = 0.0
    trial, target = np.empty(_POINTS), np.empty(3)
    row, members = np.full(len(placed), -1), np.empty(MOST_MENDED, np.int64)
    left, mended, k = np.sum(dirty), 0, 0
    while left > 0 and k < len(load.order):
        b = load.order[k]
        k += 1
        if not dirty[b]:
            continue
        first, last = load.start[b], load.start[b + 1]
        before = force[first:last].copy()
        _load_on(load, force, b, row, target)
        if _answer(load, force, live, b, target, trial):
            members[0], row[b], count = b, 0, 1
        elif mends and mended < MOST_MENDINGS:
            before, first, mended = force.copy(), 0, mended + 1
            count = _mend(load, force, live, members, row, b)
        else:
            count = 0
        if count == 0:
            return False
        for j in range(count):
            c = members[j]
            if dirty[c]:
                dirty[c] = False
                left -= 1
        for j in range(count):
            c = members[j]
            for p in range(load.start[c], load.start[c + 1]):
                a = load.lower[p]
                moved = abs(force[p] - before[p - first]) > 1e-12 * target[0]
                if a >= 0 and moved and row[a] < 0 and not dirty[a]:
                    dirty[a] = True
                    left += 1
                    k = min(k, load.turn[a])
        for j in range(count):
            row[members[j]] = -1
    return left == 0  # else blocks in rings are left


@kernel
def _load_on(
    load: StackLoad, force: np.ndarray, b: int, row: np.ndarray, target: np.ndarray
) -> None:
    """Weight of a block and what rests on it, in blocks without a ``row``: force and moments."""
    target[0], target[1], target[2] = load.weight[b], 0.0, 0.0
    for k in range(load.above_start[b], load.above_start[b + 1]):
        p = load.above[k]
        if force[p] > 0.0 and row[load.upper[p]] < 0:
            target[0] += force[p]
            target[1] += force[p] * (load.px[p] - load.cx[b]) / load.unit
            target[2] += force[p] * (load.py[p] - load.cy[b]) / load.unit


@kernel
def _answer(
    load: StackLoad,
    force: np.ndarray,
    live: np.ndarray,
    b: int,
    target: np.ndarray,
    trial: np.ndarray,
) -> bool:
    """Smallest change of the forces under a block that balances ``target``, in place.

    Args:
        live: float64[P], shares of joints that carry.
        target: force and moments about the centre of the block.
        trial: float64 to work in.

    Returns:
        whether it was found.
    """
    first, count = load.start[b], load.start[b + 1] - load.start[b]
    if count > _POINTS:
        return False
    cx, cy, unit = load.cx[b], load.cy[b], load.unit
    xs, ys = load.px[first : first + count], load.py[first : first + count]
    share, force = live[first : first + count], force[first : first + count]
    scale = target[0]
    mean = 0.0
    for p in range(count):
        mean += share[p]
    if mean <= 0.0:
        return False
    mean /= count
    l0 = l1 = l2 = 0.0
    for p in range(count):
        trial[p] = force[p]
    r0, r1, r2 = target[0], target[1], target[2]
    for p in range(count):
        u, v = (xs[p] - cx) / unit, (ys[p] - cy) / unit
        r0 -= trial[p]
        r1 -= trial[p] * u
        r2 -= trial[p] * v
    size = abs(r0) + abs(r1) + abs(r2)
    for _ in range(_ITERATIONS):
        if size <= 1e-9 * scale:
            for p in range(count):
                force[p] = trial[p]
            return True
        h00 = h01 = h02 = h11 = h12 = h22 = 0.0
        for p in range(count):
            u, v, w = (xs[p] - cx) / unit, (ys[p] - cy) / unit, share[p] / mean
            if force[p] + w * (l0 + l1 * u + l2 * v) >= 0.0:
                h00 += w
                h01 += w * u
                h02 += w * v
                h11 += w * u * u
                h12 += w * u * v
                h22 += w * v * v
        damp = 1e-10 * (h00 + h11 + h22) + 1e-14
        h00 += damp
        h11 += damp
        h22 += damp
        c00 = h11 * h22 - h12 * h12
        c01 = h02 * h12 - h01 * h22
        c02 = h01 * h12 - h02 * h11
        c11 = h00 * h22 - h02 * h02
        c12 = h01 * h02 - h00 * h12
        c22 = h00 * h11 - h01 * h01
        det = h00 * c00 + h01 * c01 + h02 * c02
        if det <= 0.0:
            return False
        s0 = (c00 * r0 + c01 * r1 + c02 * r2) / det
        s1 = (c01 * r0 + c11 * r1 + c12 * r2) / det
        s2 = (c02 * r0 + c12 * r1 + c22 * r2) / det
        step, better = 1.0, False
        for _ in range(12):
            t0, t1, t2 = target[0], target[1], target[2]
            m0, m1, m2 = l0 + step * s0, l1 + step * s1, l2 + step * s2
            for p in range(count):
                u, v = (xs[p] - cx) / unit, (ys[p] - cy) / unit
                trial[p] = max(0.0, force[p] + share[p] / mean * (m0 + m1 * u + m2 * v))
                t0 -= trial[p]
                t1 -= trial[p] * u
                t2 -= trial[p] * v
            found = abs(t0) + abs(t1) + abs(t2)
            if found < size * (1.0 - 1e-3 * step):
                l0, l1, l2, r0, r1, r2, size = m0, m1, m2, t0, t1, t2, found
                better = True
                break
            step /= 2
        if not better:
            return False
    return False


# ---------------------------------------------------------------- mending


@kernel
def _mend(
    load: StackLoad,
    force: np.ndarray,
    live: np.ndarray,
    members: np.ndarray,
    row: np.ndarray,
    b: int,
) -> int:
    """Balance a block with as few others as it takes.

    Args:
        members: int64[MOST_MENDED]: filled with the blocks, of which there are as many as returned.
        row: int64[n], -1: filled with where each of them is in ``members``.

    Returns:
        how many blocks were balanced; 0 where they could not be.
    """
    members[0], row[b], count, known = b, 0, 1, 0
    while True:
        end = count
        for j in range(known, end):
            c = members[j]
            for k in range(load.above_start[c], load.above_start[c + 1]):
                point: int = load.above[k]
                if live[point] > 0.0:
                    top: int = load.upper[point]
                    count = _join(members, row, count, top)
                    for p in range(load.start[top], load.start[top + 1]):
                        if live[p] > 0.0 and load.lower[p] >= 0:
                            count = _join(members, row, count, load.lower[p])
        known = end
        if count == end:  # Nothing rests on any of them.
            break
        if _balance(load, force, live, members[:count], row):
            return count
        if count == MOST_MENDED:
            break
    return 0


@kernel
def _join(members: np.ndarray, row: np.ndarray, count: int, block: int) -> int:
    """Add a block to the members where it is none, and there is room; how many there are."""
    if row[block] >= 0 or count == len(members):
        return count
    members[count], row[block] = block, count
    return count + 1


@kernel
def _balance(
    load: StackLoad, force: np.ndarray, live: np.ndarray, members: np.ndarray, row: np.ndarray
) -> bool:
    """The forces under ``members`` nearest to those they have that balance them, in place.

    See :func:`learn2assemble.statics.elastic.balance`, which this is for few blocks.
    """
    point, arm, at, right = _equations(load, force, live, members, row)
    n, m = len(point), len(right)
    if n == 0:
        return False
    share: np.ndarray = live[point]
    near: np.ndarray = force[point]
    share /= share.mean()
    most, largest = m / 3 * right[::3].sum(), np.abs(right).max()
    motion, pull, there = np.zeros(m), np.zeros(n), np.maximum(near, 0.0)
    left = _left(right, arm, at, there)
    value, leak = 0.5 * (there**2 / share).sum(), LEAK
    for _ in range(STEPS):
        worst = np.abs(left).max()
        if worst <= ROUNDING * largest:
            force[point] = there
            return True
        soft = np.where(near + share * pull >= 0.0, share, leak * share)
        found, change = _newton(arm, at, soft, left)
        slope = (left * change).sum()
        if not found or not slope > 0.0:
            return False
        along, step, better = _opening(arm, at, change), 1.0, False
        after, other = value, left
        for _ in range(HALVINGS):
            there = np.maximum(near + share * (pull + step * along), 0.0)
            after = 0.5 * (there**2 / share).sum() - (right * (motion + step * change)).sum()
            other = _left(right, arm, at, there)
            # Close to the end the value is too coarse to tell.
            better = after <= value - 1e-4 * step * slope or np.abs(other).max() <= 0.5 * worst
            if better:
                break
            step /= 2
        if not better:
            if leak >= MOST_LEAK:
                return False
            leak = min(100 * leak, MOST_LEAK)
            continue
        leak = max(0.1 * leak, LEAST_LEAK) if step == 1.0 else min(3 * leak, MOST_LEAK)
        motion, pull = motion + step * change, pull + step * along
        value, left = after, other
        if (right * motion).sum() > most * max(pull.max(), 0.0):
            return False  # No forces balance them.
    return False


@kernel
def _equations(
    load: StackLoad, force: np.ndarray, live: np.ndarray, members: np.ndarray, row: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points under ``members`` (int64[k]), their lever arms on the block above and the one below
    (float64[k, 6]), the first rows of the two (int64[k, 2]; -1: held), and the loads."""
    most, k = 0, 0
    for b in members:
        most += load.start[b + 1] - load.start[b]
    point, arm = np.empty(most, np.int64), np.zeros((most, 6))
    at, right = np.full((most, 2), -1), np.empty(3 * len(members))
    for i, b in enumerate(members):
        _load_on(load, force, b, row, right[3 * i : 3 * i + 3])
        for p in range(load.start[b], load.start[b + 1]):
            if live[p] > 0.0:
                point[k], at[k, 0], arm[k, 0] = p, 3 * i, 1.0
                arm[k, 1] = (load.px[p] - load.cx[b]) / load.unit
                arm[k, 2] = (load.py[p] - load.cy[b]) / load.unit
                a = load.lower[p]
                if a >= 0 and row[a] >= 0:
                    at[k, 1], arm[k, 3] = 3 * row[a], -1.0
                    arm[k, 4] = (load.cx[a] - load.px[p]) / load.unit
                    arm[k, 5] = (load.cy[a] - load.py[p]) / load.unit
                k += 1
    return point[:k], arm[:k], at[:k], right


@kernel
def _left(right: np.ndarray, arm: np.ndarray, at: np.ndarray, there: np.ndarray) -> np.ndarray:
    """float64[m]: what the forces ``there`` leave of the loads."""
    left = right.copy()
    for k in range(len(there)):
        for side in range(2):
            row = at[k, side]
            if row >= 0:
                for e in range(3):
                    left[row + e] -= arm[k, 3 * side + e] * there[k]
    return left


@kernel
def _opening(arm: np.ndarray, at: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """float64[n]: how far a motion of the blocks presses every point together."""
    pull = np.zeros(len(at))
    for k in range(len(at)):
        for side in range(2):
            row = at[k, side]
            if row >= 0:
                for e in range(3):
                    pull[k] += arm[k, 3 * side + e] * motion[row + e]
    return pull


@kernel
def _newton(
    arm: np.ndarray, at: np.ndarray, soft: np.ndarray, left: np.ndarray
) -> tuple[bool, np.ndarray]:
    """The motion that balances ``left`` on springs ``soft``, and whether there is one."""
    m = len(left)
    matrix, change = np.zeros((m, m)), np.zeros(m)
    for k in range(len(at)):
        for s in range(2):
            for t in range(2):
                if at[k, s] >= 0 and at[k, t] >= 0:
                    for e in range(3):
                        for f in range(3):
                            value = soft[k] * arm[k, 3 * s + e] * arm[k, 3 * t + f]
                            matrix[at[k, s] + e, at[k, t] + f] += value
    stiff, low = 0.0, np.arange(m)  # low: the first column that is not 0
    for i in range(m):
        stiff = max(stiff, matrix[i, i])
        for j in range(i):
            if matrix[i, j] != 0.0:
                low[i] = j
                break
    # Cholesky's factors, in the lower half.
    for i in range(m):
        matrix[i, i] += 1e-11 * stiff + 1e-14
        for j in range(low[i], i + 1):
            value = matrix[i, j]
            for k in range(max(low[i], low[j]), j):
                value -= matrix[i, k] * matrix[j, k]
            if i > j:
                matrix[i, j] = value / matrix[j, j]
            elif value > 0.0:
                matrix[i, i] = np.sqrt(value)
            else:
                return False, change
    for i in range(m):
        value = left[i]
        for k in range(low[i], i):
            value -= matrix[i, k] * change[k]
        change[i] = value / matrix[i, i]
    for i in range(m - 1, -1, -1):
        value = change[i]
        for k in range(i + 1, m):
            value -= matrix[k, i] * change[k]
        change[i] = value / matrix[i, i]
    return True, change
