"""Systems of equations of bodies that touch: matrices of 6 x 6 blocks, factored without fill.

The matrices that Newton's method on joints meets (:mod:`.elastic_joints`) have a block for every
pair of bodies that touch, and the same ones for as long as the bodies are the same; only numbers
change. So where factors have blocks is found once, from an order of least fill (minimum degree, of
SuperLU), and a factorisation is then a few products of dense matrices for every body. Pivots stay
inside the 6 x 6 blocks on the diagonal: matrices are nearly symmetric, with springs to the ground.
Beside SuperLU on the single numbers this takes a fifth of the time.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numba import njit
from numpy.typing import NDArray
from scipy.sparse.linalg import splu


class BlockMatrix:
    """A square matrix of 6 x 6 blocks, of which those of bodies that touch are not zero.

    Bodies are numbered anew in the order in which they are eliminated. Each block has its place in
    ``data``, and so has what elimination fills in.

    Args:
        count: bodies, n.
        pairs: int64[2, c], those that touch; -1 stands for none.
    """

    def __init__(self, count: int, pairs: np.ndarray) -> None:
        self.count = count
        some = pairs[:, (pairs >= 0).all(0) & (pairs[0] != pairs[1])]
        self._rank = _ranks(count, some)
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

    def solve(self, right: np.ndarray) -> np.ndarray | None:
        """float64[n, 6] that the matrix takes to ``right``, or None where it is singular.

        The factors take the place of ``data``.
        """
        split = self.count + len(self._later)
        left_of, right_of = self.data[self.count : split], self.data[split:]
        answer = np.empty_like(right)
        answer[self._rank] = right
        ends = self._start, self._later
        blocks = self.data[: self.count], left_of, right_of
        return answer[self._rank] if _solve(*ends, *blocks, answer, self._work) else None


def _ranks(count: int, pairs: np.ndarray) -> np.ndarray:
    """int64[n]: when each body is eliminated, those with few neighbours first."""
    if not pairs.shape[1]:
        return np.arange(count)
    ones = np.ones(pairs.shape[1])
    graph = sp.coo_matrix((ones, (pairs[0], pairs[1])), (count, count)).tocsc()
    graph = graph + graph.T
    # Any numbers on the diagonal that need no pivots will do: only the order is wanted.
    graph = (graph + sp.diags(1.0 + graph.sum(0).A1)).tocsc()
    options = {"SymmetricMode": True}
    return splu(graph, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).perm_c.astype(int)


# ---------------------------------------------------------------- compiled


@njit(cache=True)
def _fill(start, later):
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


@njit(cache=True)
def _solve(start, later, diagonal, left_of, right_of, x, work):
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


@njit(cache=True)
def _invert(block, inverse):
    """The inverse of a 6 x 6 ``block``, which is lost; False where it has none."""
    for r in range(6):
        for c in range(6):
            inverse[r, c] = 1.0 if r == c else 0.0
    for p in range(6):
        best = p
        for r in range(p + 1, 6):
            if abs(block[r, p]) > abs(block[best, p]):
                best = r
        if not abs(block[best, p]) > 0.0:
            return False
        for c in range(6):
            block[p, c], block[best, c] = block[best, c], block[p, c]
            inverse[p, c], inverse[best, c] = inverse[best, c], inverse[p, c]
        share = 1.0 / block[p, p]
        for c in range(6):
            block[p, c] *= share
            inverse[p, c] *= share
        for r in range(6):
            by = block[r, p]
            if r != p and by != 0.0:
                for c in range(6):
                    block[r, c] -= by * block[p, c]
                    inverse[r, c] -= by * inverse[p, c]
    return True
