"""What bricks lack of a balance, passed on from each to those nearer to what is held.

Of every brick, from the farthest one on, the pushes to those nearer take over what it lacks, each
as if it were a spring as stiff as the push is large; what they then push the other way is lacking
there.
"""

from __future__ import annotations

import math

import numpy as np

from learn2assemble.kernels import kernel

PARTS = np.array([2, 3, 4])
"""Of the six rows of a block: its weight, and the couples about the level axes."""


class JointSums:
    """Pushes by block, to pass on from block to block what is not balanced.

    Args:
        sides: float64[2, n, 6], of :func:`~learn2assemble.statics.forces.block_factors.sides_of`.
        bodies: int64[n] each, the lower block of a push, or GROUND, and the upper one.
        count: of the blocks.
    """

    def __init__(
        self, sides: np.ndarray, bodies: tuple[np.ndarray, np.ndarray], count: int
    ) -> None:
        a, b = bodies
        n = len(b)
        on_a, on_b = np.ascontiguousarray(sides[..., PARTS])
        self._sides = a, b, on_a, on_b
        real = np.flatnonzero(a >= 0)
        of = np.concatenate([a[real], b])
        self._pushes = np.concatenate([real, np.arange(n)])[np.argsort(of, kind="stable")]
        self._start = np.append(0, np.cumsum(np.bincount(of, minlength=count)))

    def pass_on(self, free: np.ndarray, on: np.ndarray, lack: np.ndarray, size: np.ndarray) -> None:
        """Pass on what blocks lack to those nearer to what is held, and change ``size`` by it."""
        a, b, _, _ = self._sides
        order, rank = ranked(self._start, self._pushes, a, b, on, free)
        part = np.ascontiguousarray(lack[:, PARTS])
        _pass_on(order, rank, self._start, self._pushes, self._sides, on, part, size)


@kernel
def ranked(  # pragma: no cover
    start: np.ndarray,
    columns: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    on: np.ndarray,
    free: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Blocks that nothing holds, from what is held outwards, and how many joints they are from
    it."""
    count = len(free)
    rank = np.zeros(count, np.int64)
    order, known = np.empty(count, np.int64), 0
    for m in range(count):
        if free[m]:
            rank[m] = -1
            for i in range(start[m], start[m + 1]):
                k = columns[i]
                o = a[k] if b[k] == m else b[k]
                if on[k] and (o < 0 or not free[o]):
                    rank[m] = 1
                    order[known] = m
                    known += 1
                    break
    first = 0
    while first < known:
        m = order[first]
        first += 1
        for i in range(start[m], start[m + 1]):
            k = columns[i]
            o = a[k] if b[k] == m else b[k]
            if on[k] and o >= 0 and rank[o] < 0:
                rank[o] = rank[m] + 1
                order[known] = o
                known += 1
    return order[:known], rank


@kernel
def _solve(  # pragma: no cover
    matrix: np.ndarray, right: np.ndarray, found: np.ndarray
) -> None:
    """Cholesky's factors of a matrix, in its place, and the solution."""
    for i in range(3):
        for j in range(i + 1):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            if i == j:
                matrix[i, i] = math.sqrt(max(rest, 1e-14))
            else:
                matrix[i, j] = rest / matrix[j, j]
    for i in range(3):
        found[i] = right[i]
        for k in range(i):
            found[i] -= matrix[i, k] * found[k]
        found[i] /= matrix[i, i]
    for i in range(2, -1, -1):
        for k in range(i + 1, 3):
            found[i] -= matrix[k, i] * found[k]
        found[i] /= matrix[i, i]


@kernel
def _pass_on(  # pragma: no cover
    order: np.ndarray,
    rank: np.ndarray,
    start: np.ndarray,
    columns: np.ndarray,
    sides: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    on: np.ndarray,
    lack: np.ndarray,
    size: np.ndarray,
) -> None:
    a, b, on_a, on_b = sides
    normal, motion = np.empty((3, 3)), np.empty(3)
    for position in range(len(order) - 1, -1, -1):
        m = order[position]
        if max(abs(lack[m, 0]), abs(lack[m, 1]), abs(lack[m, 2])) < 1e-13:
            continue
        normal[:] = 0.0
        for i in range(start[m], start[m + 1]):
            k = columns[i]
            mine = b[k] == m
            o = a[k] if mine else b[k]
            if on[k] and (o < 0 or rank[o] < rank[m]):
                w = on_b[k] if mine else on_a[k]
                for p in range(3):
                    for q in range(3):
                        normal[p, q] += size[k] * w[p] * w[q]
        _solve(normal, lack[m], motion)
        for i in range(start[m], start[m + 1]):
            k = columns[i]
            mine = b[k] == m
            o = a[k] if mine else b[k]
            if on[k] and (o < 0 or rank[o] < rank[m]):
                w = on_b[k] if mine else on_a[k]
                more = size[k] * (w[0] * motion[0] + w[1] * motion[1] + w[2] * motion[2])
                size[k] += more
                for p in range(3):
                    lack[m, p] -= w[p] * more
                if o >= 0 and rank[o] > 0:
                    other = on_a[k] if mine else on_b[k]
                    for p in range(3):
                        lack[o, p] -= other[p] * more
