"""Systems of equations of bodies that touch: matrices of 6 x 6 blocks, factored without fill.

The matrices that Newton's method on joints meets (:mod:`.elastic_joints`) have a block for every
pair of bodies that touch, and the same ones for as long as the bodies are the same; only numbers
change. So where factors have blocks is found once, from an order of least fill (minimum degree, of
SuperLU), and a factorisation is then a few products of dense matrices for every body. Pivots stay
inside the 6 x 6 blocks on the diagonal: matrices are nearly symmetric, with springs to the ground.
Beside SuperLU on the single numbers this takes a fifth of the time.

Forces between bodies that grow with how far they give way make such a matrix, too, a symmetric one
(:class:`Springs`). States that have some of the bodies keep the order of elimination of all of
them, so that only where blocks are, and their numbers, are found anew.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from learn2assemble.kernels import kernel

_ROUNDING = 1e-15
"""Pivots of less than this share of the largest entry are none."""


class BlockMatrix:
    """A square matrix of 6 x 6 blocks, of which those of bodies that touch are not zero.

    Bodies are numbered anew in the order in which they are eliminated. Each block has its place in
    ``data``, and so has what elimination fills in.

    Args:
        count: bodies, n.
        pairs: int64[2, c], those that touch; -1 stands for none.
        rank: int64[n], of :func:`elimination_ranks`, or of some bodies of it; found by default.
    """

    def __init__(self, count: int, pairs: np.ndarray, rank: np.ndarray | None = None) -> None:
        self.count = count
        self._rank = elimination_ranks(count, pairs) if rank is None else rank
        some = pairs[:, (pairs >= 0).all(0) & (pairs[0] != pairs[1])]
        lower, upper = np.sort(self._rank[some], axis=0)
        code = np.unique(lower * count + upper)
        start = np.searchsorted(code, np.arange(count + 1) * count)
        self._start, self._later = _fill(start, code % max(count, 1))
        blocks = len(self._later)
        # The diagonal, the blocks left of it, and those right of it, these turned: what one body
        # does to all later ones, and they to it, is then a matrix of six columns each.
        self.data: NDArray[np.float64] = np.zeros((count + 2 * blocks, 6, 6))
        self._code = np.repeat(np.arange(count), np.diff(self._start)) * count + self._later
        widest = int(np.diff(self._start).max(initial=0))
        self._work = np.empty(36 * widest * (widest + 1))

    def places(self, row: np.ndarray, column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where blocks are.

        Args:
            row: int64[...], bodies.
            column: int64[...], bodies that are the same or touch these; elsewhere no place is said.

        Returns:
            int64[...], their numbers in ``data``, and bool[...], whether they are turned there.
        """
        row, column = np.broadcast_arrays(self._rank[row], self._rank[column])
        first, last = np.minimum(row, column), np.maximum(row, column)
        at = np.searchsorted(self._code, first * self.count + last)
        at = np.minimum(at, max(len(self._code) - 1, 0))
        beside = self.count + at + np.where(row < column, len(self._code), 0)
        return np.where(row == column, row, beside), row < column

    def diagonal(self, body: np.ndarray) -> np.ndarray:
        """int64[...]: the numbers of the blocks of bodies with themselves."""
        return self._rank[body]

    def solve(self, right: np.ndarray, symmetric: bool = False) -> np.ndarray | None:
        """float64[n, 6] that the matrix takes to ``right``, or None where it is singular.

        The factors take the place of ``data``.

        Args:
            symmetric: it is, so that half of it says all; on the diagonal it is positive.
        """
        split = self.count + len(self._later)
        left_of, right_of = self.data[self.count : split], self.data[split:]
        answer = np.empty_like(right)
        answer[self._rank] = right
        ends = self._start, self._later
        diagonal = self.data[: self.count]
        if not symmetric:
            solved = _solve(*ends, diagonal, left_of, right_of, answer, self._work)
        elif solved := _factor_springs(*ends, diagonal, left_of, self._work):
            _solve_springs(*ends, diagonal, left_of, answer)
        return answer[self._rank] if solved else None


def elimination_ranks(count: int, pairs: np.ndarray) -> np.ndarray:
    """int64[n]: when each body is eliminated, those with few neighbours first.

    Args:
        pairs: int64[2, c], bodies that touch; -1 stands for none.
    """
    a, b = pairs[:, (pairs >= 0).all(0) & (pairs[0] != pairs[1])]
    if not len(a):
        return np.arange(count)
    own = np.arange(count)
    code = np.concatenate([a * count + b, b * count + a, own * count + own])
    column, row = np.divmod(np.unique(code), count)
    degree = np.bincount(column, minlength=count)
    # Any numbers on the diagonal that need no pivots will do: only the order is wanted.
    number = np.where(row == column, degree[column], 1).astype(float)
    start = np.append(0, np.cumsum(degree))
    graph = sp.csc_matrix((number, row.astype(np.intc), start), (count, count))
    options = {"SymmetricMode": True}
    return splu(graph, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).perm_c.astype(int)


def ranks_of(rank: np.ndarray, bodies: np.ndarray) -> np.ndarray:
    """int64[m]: ranks of some bodies (int64[m]) among themselves."""
    found = np.empty(len(bodies), np.int64)
    found[np.argsort(rank[bodies])] = np.arange(len(bodies))
    return found


def sides_of(
    matrix: sp.csr_matrix, bodies: tuple[np.ndarray, np.ndarray], count: int
) -> np.ndarray:
    """float64[2, n, 6]: what unit forces do to their first and to their second body.

    Args:
        matrix: [6 count, n], wrenches of unit forces on bodies.
        bodies: int64[n] each, the first body of a force, or -1, and the second.
        count: of the bodies.
    """
    sides = np.zeros((2, len(bodies[1]), 6))
    entries = matrix.tocoo()
    body, part = np.divmod(entries.row, 6)
    for those, side in zip(bodies, sides, strict=True):
        mine = those[entries.col] == body
        side[entries.col[mine], part[mine]] = entries.data[mine]
    return sides


class Springs:
    """Forces between bodies as springs.

    Args:
        sides: float64[2, n, 6], of :func:`sides_of`.
        bodies: int64[n] each, the first body of a force, or -1, and the second.
        count: of the bodies.
    """

    def __init__(
        self, sides: np.ndarray, bodies: tuple[np.ndarray, np.ndarray], count: int
    ) -> None:
        self._sides, self._bodies = sides, bodies
        a, b = bodies
        code, self._pair = np.unique((a + 1) * count + b, return_inverse=True)
        self._pairs = np.stack([code // count - 1, code % count])
        self._rank = elimination_ranks(count, self._pairs)
        self._parts: dict[tuple[int, ...], np.ndarray] = {}

    def factors(
        self,
        free: np.ndarray,
        columns: np.ndarray,
        stiff: np.ndarray,
        parts: tuple[int, ...],
        soft: float,
    ) -> Factors | None:
        """Factors of a state; None where it has no answer.

        Args:
            free: bool[count], bodies that may move.
            columns: int64[m], forces that there are.
            stiff: float64[m], of these.
            parts: of the six motions of a body those that there are.
            soft: how stiff each body stands on the ground beside them.
        """
        if parts not in self._parts:
            self._parts[parts] = np.ascontiguousarray(self._sides[..., parts])
        bodies = np.flatnonzero(free)
        bodies = bodies[np.argsort(self._rank[bodies])]
        place = np.full(len(free) + 1, -1)  # The last entry: of no body.
        place[bodies] = np.arange(len(bodies))
        there = np.unique(self._pair[columns])
        first, last = np.sort(place[self._pairs[:, there]], axis=0)
        inner = first >= 0
        code = np.unique(first[inner] * len(bodies) + last[inner])
        start = np.searchsorted(code, np.arange(len(bodies) + 1) * len(bodies))
        start, later = _fill(start, code % max(len(bodies), 1))
        known = np.repeat(np.arange(len(bodies)), np.diff(start)) * len(bodies) + later
        at = np.full(len(self._pairs[0]), -1)
        at[there[inner]] = np.searchsorted(known, first[inner] * len(bodies) + last[inner])
        size = len(parts)
        diagonal = np.zeros((len(bodies), size, size))
        beside = np.zeros((len(later), size, size))
        a, b = place[self._bodies[0][columns]], place[self._bodies[1][columns]]
        on_a, on_b = self._parts[parts][:, columns]
        pair = at[self._pair[columns]]
        _fill_in(a, b, on_a, on_b, pair, stiff, soft, diagonal, beside)
        widest = size * int(np.diff(start).max(initial=0))
        work = np.empty(widest * (widest + size))
        if not _factor_springs(start, later, diagonal, beside, work):
            return None
        return Factors(bodies, list(parts), start, later, diagonal, beside, a, b, on_a, on_b, stiff)


class Factors(NamedTuple):
    """Of the matrix of a state; see :meth:`Springs.factors`."""

    bodies: np.ndarray
    parts: list[int]
    start: np.ndarray
    later: np.ndarray
    diagonal: np.ndarray
    beside: np.ndarray
    a: np.ndarray
    b: np.ndarray
    on_a: np.ndarray
    on_b: np.ndarray
    stiff: np.ndarray

    def spread(self, load: np.ndarray) -> np.ndarray:
        """float64[m]: how much more the springs push under a load float64[count, 6]."""
        motion = np.ascontiguousarray(load[self.bodies][:, self.parts])
        _solve_springs(self.start, self.later, self.diagonal, self.beside, motion)
        return _stretched(self.a, self.b, self.on_a, self.on_b, motion) * self.stiff


# ---------------------------------------------------------------- compiled


@kernel
def _fill(start: np.ndarray, later: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the factors have blocks: of each body the later ones that it still touches when its
    turn comes, as ``start`` int64[n + 1] and ``later`` int64[m], ascending.

    What a body touches is handed on to the first of these (its parent in the elimination tree).
    """
    count = len(start) - 1
    found = np.empty(max(4 * len(later), 16), np.int64)
    ends = np.zeros(count + 1, np.int64)
    mark = np.full(count, -1)
    child, sibling = np.full(count, -1), np.full(count, -1)
    for k in range(count):
        mark[k] = k
        begin = end = ends[k]
        if end + count - k > len(found):
            more = np.empty(2 * len(found) + count, np.int64)
            more[:end] = found[:end]
            found = more
        for at in range(start[k], start[k + 1]):
            mark[later[at]] = k
            found[end] = later[at]
            end += 1
        c = child[k]
        while c >= 0:
            for at in range(ends[c], ends[c + 1]):
                if mark[found[at]] != k:
                    mark[found[at]] = k
                    found[end] = found[at]
                    end += 1
            c = sibling[c]
        found[begin:end] = np.sort(found[begin:end])
        ends[k + 1] = end
        if end > begin:
            parent = found[begin]
            sibling[k], child[parent] = child[parent], k
    return ends, found[: ends[count]].copy()


@kernel
def _solve(
    start: np.ndarray,
    later: np.ndarray,
    diagonal: np.ndarray,
    left_of: np.ndarray,
    right_of: np.ndarray,
    x: np.ndarray,
    work: np.ndarray,
) -> bool:
    """Factor in place, and solve for ``x`` in place. Returns whether no pivot is zero.

    ``diagonal`` becomes its own inverses, ``left_of`` the factor left of it; ``right_of`` holds
    blocks that are turned.
    """
    count = len(start) - 1
    inverse = np.empty((6, 6))
    for k in range(count):
        if not _invert(diagonal[k], inverse):
            return False
        diagonal[k] = inverse
        a, b = start[k], start[k + 1]
        m = b - a
        if m == 0:
            continue
        mine = left_of[a:b].reshape(6 * m, 6)
        factor = work[: 36 * m].reshape(6 * m, 6)
        np.dot(mine, inverse, factor)
        mine[:] = factor
        update = work[36 * m : 36 * m * (m + 1)].reshape(6 * m, 6 * m)
        np.dot(mine, right_of[a:b].reshape(6 * m, 6).T, update)
        for e in range(m):
            i = later[a + e]
            for r in range(6):
                for c in range(6):
                    x[i, r] -= mine[6 * e + r, c] * x[k, c]
                    diagonal[i, r, c] -= update[6 * e + r, 6 * e + c]
            # What touches k later than i touches i as well, in the same order.
            at = start[i]
            for g in range(e + 1, m):
                while later[at] != later[a + g]:
                    at += 1
                for r in range(6):
                    for c in range(6):
                        left_of[at, r, c] -= update[6 * g + r, 6 * e + c]
                        right_of[at, r, c] -= update[6 * e + c, 6 * g + r]
    solved = np.empty(6)
    for k in range(count - 1, -1, -1):
        for e in range(start[k], start[k + 1]):
            j = later[e]
            for c in range(6):
                for r in range(6):
                    x[k, r] -= right_of[e, c, r] * x[j, c]
        for r in range(6):
            solved[r] = 0.0
            for c in range(6):
                solved[r] += diagonal[k, r, c] * x[k, c]
        x[k] = solved
    return True


@kernel
def _invert(block: np.ndarray, inverse: np.ndarray) -> bool:
    """The inverse of a square ``block``, which is lost; False where it has none."""
    size = len(block)
    for r in range(size):
        for c in range(size):
            inverse[r, c] = 1.0 if r == c else 0.0
    for p in range(size):
        best = p
        for r in range(p + 1, size):
            if abs(block[r, p]) > abs(block[best, p]):
                best = r
        if not abs(block[best, p]) > 0.0:
            return False
        for c in range(size):
            block[p, c], block[best, c] = block[best, c], block[p, c]
            inverse[p, c], inverse[best, c] = inverse[best, c], inverse[p, c]
        share = 1.0 / block[p, p]
        for c in range(size):
            block[p, c] *= share
            inverse[p, c] *= share
        for r in range(size):
            by = block[r, p]
            if r != p and by != 0.0:
                for c in range(size):
                    block[r, c] -= by * block[p, c]
                    inverse[r, c] -= by * inverse[p, c]
    return True


@kernel
def _fill_in(  # pragma: no cover
    a: np.ndarray,
    b: np.ndarray,
    on_a: np.ndarray,
    on_b: np.ndarray,
    pair: np.ndarray,
    stiff: np.ndarray,
    soft: float,
    diagonal: np.ndarray,
    beside: np.ndarray,
) -> None:
    """The matrix of springs. Blocks beside the diagonal have the rows of the later body."""
    size = diagonal.shape[1]
    for k in range(len(diagonal)):
        for r in range(size):
            diagonal[k, r, r] = soft
    for i in range(len(a)):
        for body, on in ((a[i], on_a[i]), (b[i], on_b[i])):
            if body >= 0:
                for r in range(size):
                    push = stiff[i] * on[r]
                    if push != 0.0:
                        for c in range(size):
                            diagonal[body, r, c] += push * on[c]
        at = pair[i]
        if at >= 0:
            last, first = (on_b[i], on_a[i]) if a[i] < b[i] else (on_a[i], on_b[i])
            for r in range(size):
                push = stiff[i] * last[r]
                if push != 0.0:
                    for c in range(size):
                        beside[at, r, c] += push * first[c]


@kernel
def _factor_springs(  # pragma: no cover
    start: np.ndarray, later: np.ndarray, diagonal: np.ndarray, beside: np.ndarray, work: np.ndarray
) -> bool:
    """Cholesky's factors in place. Returns whether there are any.

    Inverses of the blocks on the diagonal would take less time to apply, but where some bodies
    hang on the others by little they lose all digits.
    """
    size = diagonal.shape[1]
    largest = 0.0
    for k in range(len(diagonal)):
        for r in range(size):
            largest = max(largest, diagonal[k, r, r])
    for k in range(len(diagonal)):
        block = diagonal[k]
        for r in range(size):
            for c in range(r + 1):
                rest = block[r, c]
                for q in range(c):
                    rest -= block[r, q] * block[c, q]
                if r > c:
                    block[r, c] = rest * block[c, c]
                elif not rest > _ROUNDING * largest:
                    return False
                else:
                    block[r, r] = 1.0 / np.sqrt(rest)  # Only ever divided by.
        first, last = start[k], start[k + 1]
        rows = size * (last - first)
        if rows == 0:
            continue
        mine = beside[first:last].reshape(rows, size)
        for row in range(rows):
            for c in range(size):
                rest = mine[row, c]
                for q in range(c):
                    rest -= mine[row, q] * block[c, q]
                mine[row, c] = rest * block[c, c]
        update = work[: rows * rows].reshape(rows, rows)
        np.dot(mine, mine.T, update)
        for e in range(last - first):
            i = later[first + e]
            # What is later than i and touches k touches i as well, in the same order.
            at = start[i]
            for g in range(e, last - first):
                if g > e:
                    while later[at] != later[first + g]:
                        at += 1
                    target = beside[at]
                else:
                    target = diagonal[i]
                for r in range(size):
                    for c in range(size):
                        target[r, c] -= update[size * g + r, size * e + c]
    return True


@kernel
def _solve_springs(  # pragma: no cover
    start: np.ndarray, later: np.ndarray, diagonal: np.ndarray, beside: np.ndarray, x: np.ndarray
) -> None:
    """Solve in place with factors."""
    count, size = x.shape
    for k in range(count):
        for r in range(size):
            for c in range(r):
                x[k, r] -= diagonal[k, r, c] * x[k, c]
            x[k, r] *= diagonal[k, r, r]
        for e in range(start[k], start[k + 1]):
            i = later[e]
            for r in range(size):
                for c in range(size):
                    x[i, r] -= beside[e, r, c] * x[k, c]
    for k in range(count - 1, -1, -1):
        for e in range(start[k], start[k + 1]):
            i = later[e]
            for r in range(size):
                for c in range(size):
                    x[k, c] -= beside[e, r, c] * x[i, r]
        for r in range(size - 1, -1, -1):
            for c in range(r + 1, size):
                x[k, r] -= diagonal[k, c, r] * x[k, c]
            x[k, r] *= diagonal[k, r, r]


@kernel
def _stretched(  # pragma: no cover
    a: np.ndarray, b: np.ndarray, on_a: np.ndarray, on_b: np.ndarray, motion: np.ndarray
) -> np.ndarray:
    """How far springs are stretched."""
    size = motion.shape[1]
    found = np.zeros(len(a))
    for i in range(len(a)):
        for r in range(size):
            if a[i] >= 0:
                found[i] += on_a[i, r] * motion[a[i], r]
            if b[i] >= 0:
                found[i] += on_b[i, r] * motion[b[i], r]
    return found
