r"""Contact forces as functions of how rigid blocks move, and the motions at which they balance.

A block moves by :math:`\lambda_b` (velocity, and turn times radius). At a corner :math:`p` of a
joint the motion of the two blocks is :math:`e_p = (W \lambda)_p`, along the normal and across, and
elastic joints with springs :math:`k` answer with a force in Coulomb's cone. Two laws are used:

* *coupled*: :math:`f_n = \max(0, k_n e_n)`, and across :math:`k_t e_t`, cut to length
  :math:`\mu f_n`. Where such forces balance, :math:`W^T f(\lambda) = w`, they are a fixed point of
  the coupled analysis (:mod:`.block_forces`), exactly.
* *nearest*: the point of the cone nearest to :math:`m + k e`. Where such forces balance, they are,
  of all forces that do, those nearest to the given ones :math:`m`, measured in the springs
  :math:`k`: the multipliers of that program are the motion.

Both are solved by Newton's method with the derivatives of the laws, one factorisation a step; it
starts from the motion or the forces of the state before and then takes few steps. The coupled law
is not the gradient of anything, so that Newton's method may stall. Then the limits of friction are
those of the round before (Haslinger 1983), which makes every round convex, until they agree.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numba import njit
from scipy.sparse.linalg import splu

_SPRING = 1e-10
"""Of the ground spring that keeps every block somewhere; what it bears is far below rounding."""
_FAR = 1e6
"""The largest motion that is not a fall."""
_LEAK, _LEAST_LEAK, _MOST_LEAK = 1.0, 1e-9, 1.0
"""How much an open or sliding corner still resists in a step, as a share of its springs: at first,
at least and at most. Without it a block that lifts off would move without bounds."""
_STEPS, _HALVINGS = 40, 8
_STALLS = 3
"""Steps in a row that bring forces no nearer to balance, after which limits of friction are kept
for a round."""
_ROUNDS = 30
_STEP, _MIX = 0.5, (-3.0, 0.5)
"""Damping of the rounds, and bounds of how the round before is mixed in (Anderson 1965)."""
_SLIP = 1e-3
"""Violation of Coulomb's law at a block taken for rounding, in its normal forces."""
_DENSE = 30
"""Blocks up to which matrices are not sparse."""
_COUPLED, _NEAREST, _LIMITED = 0, 1, 2


class ElasticAnswer(NamedTuple):
    """Forces that balance, and the motion they come from."""

    forces: np.ndarray
    """float64[c, 3], normal and across, in the frame of their patch."""
    motion: np.ndarray
    """float64[n, 6]"""


class Joined:
    """Free blocks and the corners at which they touch one another and what bears them.

    Args:
        body: int64[2, c], the two blocks of every corner; -1 for what bears any load.
        wrench: float64[2, c, 3, 6], of unit forces at the corners on these blocks.
        stiffness: float64[c], along the normal.
        weight: float64[n]; forces that are missing are measured in it.
    """

    def __init__(
        self, body: np.ndarray, wrench: np.ndarray, stiffness: np.ndarray, weight: np.ndarray
    ) -> None:
        self.body, self.wrench = body, wrench
        self.stiffness, self.weight = stiffness, weight
        self.count, self.corners = len(weight), body.shape[1]
        self._layout = _Layout(self.count, body)
        self._force = np.zeros((2, self.corners, 3))
        self._slope = np.zeros((2, self.corners, 3, 3))

    def coupled(
        self,
        load: np.ndarray,
        friction: np.ndarray,
        ratio: float,
        balanced: float,
        motion: np.ndarray | None = None,
    ) -> tuple[bool, ElasticAnswer]:
        """Forces of the coupled law that balance a load, or what was reached.

        Args:
            load: float64[n, 6].
            friction: float64[c], Coulomb coefficients.
            ratio: of the springs across to those along the normal.
            balanced: force that may be missing at every block, in its weight.
            motion: float64[n, 6] to start from.
        """
        zero = np.zeros((self.corners, 3))
        springs = np.stack([self.stiffness, ratio * self.stiffness])
        law = _JointResponse(_COUPLED, zero, springs, friction, friction)
        still = np.zeros((self.count, 6))
        for start in (still,) if motion is None else (motion, still):
            balances, found = self._newton(load, law, start, balanced)
            if balances:
                return True, found
        balances, near = self.nearest(load, friction, zero, balanced)
        if not balances:
            return False, found
        return self.settled(load, friction, ratio, balanced, near.forces)

    def settled(
        self,
        load: np.ndarray,
        friction: np.ndarray,
        ratio: float,
        balanced: float,
        forces: np.ndarray,
    ) -> tuple[bool, ElasticAnswer]:
        """As coupled, by rounds: friction is limited by the normal forces of the round before,
        at first by those of given ones (float64[c, 3])."""
        zero = np.zeros((self.corners, 3))
        springs = np.stack([self.stiffness, ratio * self.stiffness])
        found = ElasticAnswer(zero, np.zeros((self.count, 6)))
        limit, before, failed = friction * np.maximum(forces[:, 0], 0), None, 0
        for _ in range(_ROUNDS):
            kept = _JointResponse(_LIMITED, zero, springs, friction, limit)
            balances, found = self._newton(load, kept, found.motion, balanced)
            if balances and self._slip(found.forces, friction) <= _SLIP:
                return True, found
            failed = 0 if balances else failed + 1
            if failed == _STALLS or np.abs(found.motion).max() > _FAR:
                break
            change = friction * np.maximum(found.forces[:, 0], 0) - limit
            ahead, mix = limit + _STEP * change, 0.0
            last_ahead, last_change = before or (ahead, change)
            if before is not None:
                turn = change - last_change
                mix = float(np.clip(change @ turn / max(turn @ turn, 1e-300), *_MIX))
            before = ahead, change
            limit = np.maximum((1 - mix) * ahead + mix * last_ahead, 0)
        return False, found

    def nearest(
        self, load: np.ndarray, friction: np.ndarray, near: np.ndarray, balanced: float
    ) -> tuple[bool, ElasticAnswer]:
        """The forces in Coulomb's cone nearest to given ones that balance a load, or what was
        reached: where there are none, a motion that nothing holds back."""
        springs = np.stack([self.stiffness, self.stiffness])
        law = _JointResponse(_NEAREST, near, springs, friction, np.zeros(self.corners))
        return self._newton(load, law, np.zeros((self.count, 6)), balanced)

    def _slip(self, forces: np.ndarray, friction: np.ndarray) -> float:
        """Largest violation of Coulomb's law at a block, in its normal forces or its weight."""
        normal = np.maximum(forces[:, 0], 0)
        excess = np.maximum(np.hypot(forces[:, 1], forces[:, 2]) - friction * normal, 0)
        sums = [
            sum(np.bincount(body[body >= 0], value[body >= 0], self.count) for body in self.body)
            for value in (excess, normal)
        ]
        return float((sums[0] / np.maximum(sums[1], self.weight)).max(initial=0.0))

    def _newton(
        self, load: np.ndarray, law: _JointResponse, motion: np.ndarray, balanced: float
    ) -> tuple[bool, ElasticAnswer]:
        force, slope, layout = self._force, self._slope, self._layout
        bodies = self.body, self.wrench
        left = np.empty((2, self.count, 6))
        limit = (balanced * self.weight) ** 2
        value = _respond(motion, load, *bodies, *law, force[0], slope[0], left[0])
        now, stalls, leak = 0, 0, _LEAK
        for number in range(_STEPS):
            if ((left[now] ** 2).sum(1) <= limit).all():
                break
            matrix = layout.matrix(bodies, slope[now], leak, law.springs)
            change = layout.solve(matrix, left[now])
            if change is None or not np.isfinite(change).all():
                break
            size, rate = float((left[now] ** 2).sum()), float((left[now] * change).sum())
            step, nearer = 1.0, False
            for _ in range(_HALVINGS):
                there = motion + step * change
                after = _respond(
                    there, load, *bodies, *law, force[1 - now], slope[1 - now], left[1 - now]
                )
                found = float((left[1 - now] ** 2).sum())
                # Close to the end the energy is too coarse to tell.
                nearer = found < (1 - 0.2 * step) * size or (
                    law.kind != _COUPLED and after <= value - 1e-4 * step * rate
                )
                if nearer:
                    break
                step /= 2
            leak = max(0.01 * leak, _LEAST_LEAK) if step == 1 else min(10 * leak, _MOST_LEAK)
            stalls = 0 if nearer else stalls + 1
            motion, now, value = there, 1 - now, after
            # What is soft comes back from far in the first steps.
            if (number >= _STALLS and np.abs(motion).max() > _FAR) or stalls == _STALLS:
                break
        # What the ground springs bear is not balanced.
        near = np.abs(motion).max(initial=0.0) <= _FAR
        balances = bool(near and ((left[now] ** 2).sum(1) <= limit).all())
        return balances, ElasticAnswer(force[now].copy(), motion)


class _JointResponse(NamedTuple):
    """How corners answer to motion."""

    kind: int
    near: np.ndarray
    """float64[c, 3]: forces without motion."""
    springs: np.ndarray
    """float64[2, c]: along the normal and across."""
    friction: np.ndarray
    limit: np.ndarray
    """float64[c]: longest forces across, where they do not follow the normal ones."""


class _Layout:
    """Where the 6 x 6 blocks of the derivative of all forces are in its matrix."""

    def __init__(self, count: int, joined: np.ndarray) -> None:
        self.count = count
        body = np.arange(count)
        if count <= _DENSE:
            self._place = lambda row, column: 6 * (row + 6 * count * column)
            self._stride = lambda column: np.full(len(column), 6 * count)
            self.size = (6 * count) ** 2
        else:
            self._sparse(count, *joined)
        known = np.maximum(joined, 0)
        row, column = np.broadcast_arrays(known[:, None], known[None])
        self.at = self._place(row.reshape(-1), column.reshape(-1)).reshape(row.shape)
        self.stride = self._stride(column.reshape(-1)).reshape(row.shape)
        along = (self._stride(body)[:, None] + 1) * np.arange(6)
        self.diagonal: np.ndarray = (self._place(body, body)[:, None] + along).reshape(-1)
        self.data = np.zeros(self.size)

    def _sparse(self, count: int, a: np.ndarray, b: np.ndarray) -> None:
        both = (a >= 0) & (b >= 0)
        codes = (np.arange(count) * (count + 1), (b * count + a)[both], (a * count + b)[both])
        known = np.unique(np.concatenate(codes))
        column, row = known // count, known % count
        first = np.searchsorted(column, np.arange(count + 1))
        tall = 6 * np.diff(first)
        offset = 36 * first[column] + 6 * (np.arange(len(known)) - first[column])
        self._place = lambda row, column: offset[
            np.minimum(np.searchsorted(known, column * count + row), len(known) - 1)
        ]
        self._stride = lambda column: tall[column]
        self.size = 36 * len(known)
        at = offset[:, None, None] + tall[column][:, None, None] * np.arange(6)[:, None]
        self.index = np.empty(self.size, np.int32)
        self.index[at + np.arange(6)] = (6 * row[:, None] + np.arange(6))[:, None]
        self.start = np.concatenate([[0], np.cumsum(np.repeat(tall, 6))]).astype(np.int32)

    def matrix(
        self,
        bodies: tuple[np.ndarray, np.ndarray],
        slope: np.ndarray,
        leak: float,
        springs: np.ndarray,
    ) -> np.ndarray:
        """The derivative, a little of every spring included."""
        _assemble(*bodies, slope, leak, springs, self.at, self.stride, self.data)
        self.data[self.diagonal] += _SPRING + 1e-12 * self.data[self.diagonal].max(initial=0.0)
        return self.data

    def solve(self, data: np.ndarray, right: np.ndarray) -> np.ndarray | None:
        """The change of motion float64[n, 6] by which a derivative gives ``right``, or None."""
        size, flat = 6 * self.count, right.reshape(-1)
        try:
            if self.count <= _DENSE:
                return np.linalg.solve(data.reshape(size, size).T, flat).reshape(-1, 6)
            # Nearly symmetric: pivots are taken from the diagonal while they are not small.
            factors = splu(
                sp.csc_matrix((data, self.index, self.start), (size, size)),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=1e-3,
                options={"SymmetricMode": True},
            )
        except (np.linalg.LinAlgError, RuntimeError):  # exactly singular
            return None
        return factors.solve(flat).reshape(-1, 6)


# ---------------------------------------------------------------- compiled


@njit(cache=True)
def _respond(motion, load, body, wrench, kind, near, springs, friction, limit, force, slope, left):
    """Forces of a law at a motion, their derivatives by the motion of the corners, and what is
    left of the load, all in place. Returns the energy, which the coupled law has none of."""
    energy = 0.0
    for b in range(len(load)):
        for w in range(6):
            held = _SPRING * motion[b, w]
            left[b, w] = load[b, w] - held
            energy += (held / 2 - load[b, w]) * motion[b, w]
    e, along = np.empty(3), np.empty(3)
    for p in range(body.shape[1]):
        for r in range(3):
            e[r] = force[p, r] = 0.0
            for c in range(3):
                slope[p, r, c] = 0.0
        for side in range(2):
            block = body[side, p]
            if block >= 0:
                for r in range(3):
                    for w in range(6):
                        e[r] += wrench[side, p, r, w] * motion[block, w]
        k, kt, mu, d = springs[0, p], springs[1, p], friction[p], slope[p]
        n, u, v = near[p, 0] + k * e[0], near[p, 1] + kt * e[1], near[p, 2] + kt * e[2]
        size = np.sqrt(u * u + v * v)
        most = limit[p] if kind == _LIMITED else mu * n
        f = n
        if kind == _NEAREST and size > most:
            f = (n + mu * size) / (1.0 + mu * mu)
            most = mu * f
        if f <= 0.0 and kind != _LIMITED:
            continue
        f = max(f, 0.0)
        d[0, 0] = k if n > 0.0 else 0.0
        if kind == _NEAREST:
            energy += (f * f + min(size, most) ** 2) / (2 * k)
        elif size <= most:
            energy += f * f / (2 * k) + size * size / (2 * kt)
        else:
            energy += f * f / (2 * k) + most * (size - most / 2) / kt
        if size <= most:
            force[p, 0], force[p, 1], force[p, 2] = f, u, v
            d[1, 1] = d[2, 2] = kt
        else:
            u, v = u / size, v / size
            force[p, 0], force[p, 1], force[p, 2] = f, most * u, most * v
            turn = most / size * kt
            d[1, 1], d[2, 2] = turn * (1 - u * u), turn * (1 - v * v)
            d[1, 2] = d[2, 1] = -turn * u * v
            if kind == _COUPLED:
                d[1, 0], d[2, 0] = mu * u * k, mu * v * k
            elif kind == _NEAREST:
                along[0], along[1], along[2] = 1.0, mu * u, mu * v
                d[0, 0] = 0.0
                for r in range(3):
                    for c in range(3):
                        d[r, c] += k / (1.0 + mu * mu) * along[r] * along[c]
        for side in range(2):
            block = body[side, p]
            if block >= 0:
                for r in range(3):
                    for w in range(6):
                        left[block, w] -= wrench[side, p, r, w] * force[p, r]

    return energy


@njit(cache=True)
def _assemble(body, wrench, slope, leak, springs, at, stride, data):
    """Add wrench.T @ slope @ wrench of both sides of every corner to the blocks of a matrix."""
    for k in range(len(data)):
        data[k] = 0.0
    d, turned = np.empty((3, 3)), np.empty((3, 6))
    for p in range(body.shape[1]):
        for r in range(3):
            for c in range(3):
                d[r, c] = slope[p, r, c]
            d[r, r] += leak * springs[min(r, 1), p]
        for column in range(2):
            if body[column, p] < 0:
                continue
            for r in range(3):
                for c in range(6):
                    turned[r, c] = 0.0
                    for k in range(3):
                        turned[r, c] += d[r, k] * wrench[column, p, k, c]
            for row in range(2):
                if body[row, p] < 0:
                    continue
                begin, step = at[row, column, p], stride[row, column, p]
                for c in range(6):
                    for r in range(6):
                        for k in range(3):
                            data[begin + step * c + r] += wrench[row, p, k, r] * turned[k, c]
