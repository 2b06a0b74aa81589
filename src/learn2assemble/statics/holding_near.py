"""Forces of one state of bricks, changed where something changes, as the proof of the next one.

Where bricks clutch, the contact points of a joint push as much as they can pull where nothing is
asked of it, so that weights and presses only shift what they push: level forces and couples about
the vertical are left out. States that follow each other while one builds differ by a few bricks,
and what those lack of a balance that lost or got a joint is passed on, brick by brick, to those
that are nearer to the ground. What comes of it is looked at whole: where every brick is balanced
and no contact point pulls more than it can, the state stands. Where that fails, what is lacking is
spread over all joints at once as if they were elastic; and where that fails, too, nothing is said,
and the program of all bricks (:mod:`.holding`) decides, which knows all forces.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numba import njit
from scipy.sparse.linalg import splu

from learn2assemble.statics.holding import Balance, Push
from learn2assemble.statics.holding_forces import Forces
from learn2assemble.statics.holding_solver import by_cones

_KEPT = 4
"""States whose forces are kept to go on from."""
_EXACT = 1e-7
"""What forces, and couples over a length, may lack of a balance [mean weights]; the program of all
bricks leaves as much."""
_LEAST = 1e-6
"""Share of the push that balances their pull that contact points keep: rounding is never what a
state stands on."""
_SPREAD, _LOST, _NEAR = 8, 4.0, 0.9
"""How often what is lacking is spread, of how many times a push it is given up, and what share of a
push one step may take away."""
_SOFT = 1e-9
"""What keeps factors from being singular, and bricks without a joint from moving."""
_SYMMETRIC: Any = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.0,
    "options": {"SymmetricMode": True},
}
"""Factors of a positive definite matrix, without a search for pivots, which would fill them."""
_PARTS = 2, 3, 4
"""Of the six rows of a block: its weight, and the couples about the level axes."""


class _Balanced(NamedTuple):
    """What balances a state with all the strength of its joints."""

    present: np.ndarray
    held: np.ndarray
    size: np.ndarray
    """float64[n]: of the pushes [mean weights]."""


class NearForces:
    """Proofs of states one after the other.

    Args:
        balance: the program of all bricks.
        forces: that it was made of.
    """

    def __init__(self, balance: Balance, forces: Forces) -> None:
        self.balance, count = balance, balance.count
        even = _even(balance, forces)
        self._which = which = np.flatnonzero(even)
        self._even, self._least = even[which], _LEAST * even[which]
        a, b = balance.bodies
        self._bodies = a[which], b[which]
        self._rows = (6 * np.arange(count)[:, None] + _PARTS).reshape(-1)
        self._matrix = balance.wrench[:, which][self._rows].tocsr()
        self._joints = _JointSums(self._matrix, self._bodies, count)
        self._known: list[_Balanced] = []
        everything = np.ones(count, bool)
        self.begin(everything, ~everything, thorough=True)

    def begin(self, present: np.ndarray, held: np.ndarray, thorough: bool = False) -> None:
        """Go on from a state that stands, where it does so with strength to spare.

        Args:
            thorough: whether a program of these forces is asked where spreading finds none.
        """
        on = self.balance.on(self._bodies, present)
        free = present & ~self.balance.fixed & ~held
        size = np.where(on, self._even, 0.0)
        made = self._spread(size, on, free, self._load(present, None))
        if made is None and thorough:
            made = self._by_program(present, on, free)
        if made is not None:
            self._keep(present, held, made)

    def _keep(self, present: np.ndarray, held: np.ndarray, size: np.ndarray) -> None:
        self._known = [_Balanced(present.copy(), held.copy(), size), *self._known[: _KEPT - 1]]

    def stands(
        self,
        present: np.ndarray,
        held: np.ndarray,
        push: Push | None = None,
        thorough: bool = True,
    ) -> bool:
        """Whether a proof is found; where none is, the state may stand all the same.

        Args:
            present: bool[count], the blocks that are there.
            held: bool[count], those of them that a hand holds.
            push: a further force on a block.
            thorough: whether what is lacking is spread over all joints, too.
        """
        if push is not None and push.force == 0:
            push = None
        if not self._known:
            return False
        differ = [int((k.present != present).sum() + (k.held != held).sum()) for k in self._known]
        nearest = int(np.argmin(differ))
        known = self._known.pop(nearest)
        self._known.insert(0, known)
        if push is None and differ[nearest] == 0:
            return True
        on = self.balance.on(self._bodies, present)
        before = self.balance.on(self._bodies, known.present)
        # The joints of what has come push as much as they pull, until more is asked of them.
        size = np.where(on, np.where(before, known.size, self._even), 0.0)
        free = present & ~self.balance.fixed & ~held
        load = self._load(present, push)
        made = self._passed(size, on, free, load)
        if made is None and thorough:
            made = self._spread(size, on, free, load)
        if made is not None and push is None:
            self._keep(present, held, made)
        return made is not None

    def _passed(
        self, size: np.ndarray, on: np.ndarray, free: np.ndarray, load: np.ndarray
    ) -> np.ndarray | None:
        """Forces with what blocks lack passed on from each to those nearer to what is held; None
        where one of them cannot do that."""
        made, lack = size.copy(), self._lack(load, size, free)
        self._joints.pass_on(free, on, lack, made)
        return made if self._balanced(made, on, free, load) else None

    def _spread(
        self, size: np.ndarray, on: np.ndarray, free: np.ndarray, load: np.ndarray
    ) -> np.ndarray | None:
        """Forces with what they lack of a balance spread over all joints as if these were elastic,
        softest where they push most; None where some would have to pull more than they can."""
        rows, columns = np.flatnonzero(np.repeat(free, 3)), np.flatnonzero(on)
        matrix, size = self._matrix[rows][:, columns], size.copy()
        across = matrix.T.tocsr()
        for _ in range(_SPREAD):
            lack = self._lack(load, size, free).reshape(-1)[rows]
            push = size[columns]
            whole = matrix @ sp.diags(push) @ across + _SOFT * sp.identity(len(rows))
            more = push * (across @ splu(whole.tocsc(), **_SYMMETRIC).solve(lack))
            most = float(np.max(-more / push, initial=0.0))
            if not np.isfinite(most) or most > _LOST:
                return None
            size[columns] += min(1.0, _NEAR / max(most, 1e-12)) * more
            if self._balanced(size, on, free, load):
                return size
        return None

    def _by_program(
        self, present: np.ndarray, on: np.ndarray, free: np.ndarray
    ) -> np.ndarray | None:
        """Forces with the least share of the strength, and what balances the rest of it evenly, so
        that all contact points keep some; None where all of the strength is not enough."""
        rows, columns = np.flatnonzero(np.repeat(free, 3)), np.flatnonzero(on)
        if not len(rows) or not len(columns):
            return None
        load, even = self._load(present, None), self._even[columns]
        weights = self._load(np.zeros_like(present), None)
        # In shares of the even pushes: of pushes themselves the solver loses accuracy.
        unit = float(np.median(even))
        pull = sp.csc_matrix((weights - load)[rows].reshape(-1, 1))
        matrix = sp.hstack([self._matrix[rows][:, columns] @ sp.diags(even), pull]) / unit
        count = len(columns) + 1
        found = by_cones(matrix, weights[rows] / unit, np.zeros(count), np.full(count, np.inf))
        if found is None or found[-1] >= 1:
            return None
        size = np.zeros(len(on))
        size[columns] = even * (np.maximum(found[:-1], 0.0) + 1.0 - found[-1])
        return self._passed(size, on, free, load)

    def _balanced(
        self, size: np.ndarray, on: np.ndarray, free: np.ndarray, load: np.ndarray
    ) -> bool:
        """Whether forces keep within what joints can pull, and balance everything."""
        if not (size >= self._least)[on].all():
            return False
        return bool(np.abs(self._lack(load, size, free)).max(initial=0.0) <= _EXACT)

    def _load(self, present: np.ndarray, push: Push | None) -> np.ndarray:
        """float64[3 count]: what forces have to balance beside the preload [mean weights]."""
        balance = self.balance
        pulling = balance.on(balance.pull_bodies, present).astype(float)
        return (balance.pushed(push) - balance.pulls @ pulling)[self._rows]

    def _lack(self, load: np.ndarray, size: np.ndarray, free: np.ndarray) -> np.ndarray:
        """float64[count, 3]: what is not balanced yet of blocks that nothing holds."""
        lack = (load - self._matrix @ size).reshape(-1, 3)
        lack[~free] = 0.0
        return lack


class _JointSums:
    """Pushes by block, to pass on from block to block what is not balanced.

    Args:
        matrix: [3 count, n], weight and couples of unit pushes on blocks.
        bodies: int64[n] each, the lower block of a push, or GROUND, and the upper one.
    """

    def __init__(
        self, matrix: sp.csr_matrix, bodies: tuple[np.ndarray, np.ndarray], count: int
    ) -> None:
        a, b = bodies
        n = len(b)
        on_a, on_b = np.zeros((n, 3)), np.zeros((n, 3))
        entries = matrix.tocoo()
        block, part = np.divmod(entries.row, 3)
        for body, side in ((a, on_a), (b, on_b)):
            mine = body[entries.col] == block
            side[entries.col[mine], part[mine]] = entries.data[mine]
        self._sides = a, b, on_a, on_b
        real = np.flatnonzero(a >= 0)
        of = np.concatenate([a[real], b])
        self._pushes = np.concatenate([real, np.arange(n)])[np.argsort(of, kind="stable")]
        self._start = np.append(0, np.cumsum(np.bincount(of, minlength=count)))

    def pass_on(self, free: np.ndarray, on: np.ndarray, lack: np.ndarray, size: np.ndarray) -> None:
        """Pass on what blocks lack to those nearer to what is held, and change ``size`` by it."""
        a, b, _, _ = self._sides
        order, rank = _ranked(self._start, self._pushes, a, b, on, free)
        _pass_on(order, rank, self._start, self._pushes, self._sides, on, lack, size)


@njit(cache=True)
def _ranked(start, columns, a, b, on, free):  # pragma: no cover
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


@njit(cache=True)
def _solve(matrix, right, found):  # pragma: no cover
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


@njit(cache=True)
def _pass_on(order, rank, start, columns, sides, on, lack, size):  # pragma: no cover
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


def _even(balance: Balance, forces: Forces) -> np.ndarray:
    """float64[n]: pushes that balance the whole preload of their own joints, evenly; zero where
    there are none [mean weights]."""
    columns, preload, contacts = balance.columns, balance.preload, forces.contacts
    made = np.zeros(len(columns.b))
    corner = np.flatnonzero((columns.corner >= 0) & (columns.lower == 0))
    patch = contacts.patch[columns.corner[corner]]
    order = np.argsort(patch, kind="stable")
    corner, patch = corner[order], patch[order]
    of = contacts.patch[preload.corner]
    first, last = np.searchsorted(patch, of), np.searchsorted(patch, of, "right")
    for many in np.unique(last - first).tolist():
        joints = np.flatnonzero(last - first == many)
        if many == 0:
            continue
        which = corner[first[joints, None] + np.arange(many)]
        # A force and its couples about the two level axes, on which all of them agree.
        up, spot = columns.force[which][..., 2], columns.at[which][..., :2]
        middle = preload.at[joints, :2]
        rows = np.stack([up, *np.moveaxis((spot - middle[:, None]) * up[..., None], -1, 0)], 1)
        rows[:, 1:] /= max(float(np.abs(rows[:, 1:]).max()), 1e-12)
        wanted = np.zeros((len(joints), 3, 1))
        wanted[:, 0, 0] = -preload.force[joints, 2]
        share = (np.linalg.pinv(rows) @ wanted)[..., 0]
        good = (share >= 0).all(1) & (preload.corner[joints] >= 0)
        made[which[good]] = share[good] / balance.unit
    return made
