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
starts from the motion or the forces of the state before and then takes few steps.

The nearest law is the gradient of a convex energy, so that steps are shortened until it falls. The
coupled law is the gradient of nothing, and its residual has valleys in which such a search stalls.
Its steps are those of an implicit relaxation in time instead: corners that are open or slide keep a
share of their springs, which falls as the residual does and rises where it does (pseudo-transient
continuation, Kelley and Keyes 1998), and the residual may rise on the way. Where that fails from
the motions at hand, motions of the nearest law are tried: it opens a joint by :math:`\mu` times the
slip, and with this subtracted round by round the two laws become one (Cadoux 2009).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from learn2assemble.blas import by_one_thread
from learn2assemble.kernels import kernel
from learn2assemble.statics.forces.block_factors import BlockMatrix
from learn2assemble.statics.forces.hands import STIFFNESS, HandSprings, HeldBlock

_SPRING = 1e-10
"""Of the ground spring that keeps every block somewhere; what it bears is far below rounding."""
_FAR = 1e6
"""The largest motion that is not a fall."""
_LEAK, _LEAST_LEAK, _MOST_LEAK = 1.0, 1e-9, 1.0
"""How much an open or sliding corner still resists in a step, as a share of its springs: at first,
at least and at most. Without it a block that lifts off would move without bounds."""
_STEPS, _HALVINGS = 40, 8
_STALLS = 3
"""Steps in a row that bring nearest forces no nearer to balance, after which there are none."""
_RELAXED, _SHORTER = 60, 4
"""Steps of the coupled law, and how often one is halved."""
_WORSE = 3.0
"""By how much a step of the coupled law may raise the sum of squares of what is left."""
_WAIT = 12
"""Steps of the coupled law that need not halve that sum, and after which motions may not be far:
what is soft comes back from there in the first steps."""
_TRIED, _TRIED_OF_MANY = (0, 1, 2, 3, 5, 7, 10, 14), (0, 1, 3)
"""Rounds of the nearest law after which the coupled law is tried, also where blocks are many: these
touch with faces as a rule, and of such nothing more was found by later ones."""
_FEW = 30
"""Blocks that are not many."""
_COUPLED, _NEAREST = 0, 1


class ElasticAnswer(NamedTuple):
    """Forces that balance, and the motion they come from."""

    forces: np.ndarray
    """float64[c, 3], normal and across, in the frame of their patch."""
    motion: np.ndarray
    """float64[n, 6]"""
    wrenches: np.ndarray
    """float64[h, 6]: of the hands."""


class Joined:
    """Free blocks and the corners at which they touch one another and what bears them.

    Args:
        body: int64[2, c], the two blocks of every corner; -1 for what bears any load.
        wrench: float64[2, c, 3, 6], of unit forces at the corners on these blocks.
        stiffness: float64[c], along the normal.
        weight: float64[n]; forces that are missing are measured in it.
        held: blocks that bounded hands hold.
        rank: int64[n], when each block is eliminated; found by default.
    """

    def __init__(
        self,
        body: np.ndarray,
        wrench: np.ndarray,
        stiffness: np.ndarray,
        weight: np.ndarray,
        held: Sequence[HeldBlock] = (),
        rank: np.ndarray | None = None,
    ) -> None:
        self.body = body
        self.wrench = wrench
        self.stiffness = stiffness
        self.weight = weight
        self.count: int = len(weight)
        self.corners: int = body.shape[1]
        self._matrix = BlockMatrix(self.count, body, rank)
        known = np.maximum(body, 0)
        self._places = self._matrix.places(known[:, None], known[None])
        self._force = np.zeros((2, self.corners, 3))
        self._slope = np.zeros((2, self.corners, 3, 3))
        self._left = np.empty((2, self.count, 6))
        self.hands: HandSprings = HandSprings(held)
        self._hand = [self.hands.none, self.hands.none]
        self._hand_slope = [np.zeros((len(held), 6, 6))] * 2

    @by_one_thread
    def coupled(
        self,
        load: np.ndarray,
        friction: np.ndarray,
        ratio: float,
        balanced: float,
        starts: Sequence[np.ndarray] = (),
    ) -> tuple[bool, ElasticAnswer]:
        """Forces of the coupled law that balance a load, or what was reached.

        Args:
            load: float64[n, 6].
            friction: float64[c], Coulomb coefficients.
            ratio: of the springs across to those along the normal.
            balanced: force that may be missing at every block, in its weight.
            starts: motions float64[n, 6] to start from, in turn; one of none by default.
        """
        springs = np.stack([self.stiffness, ratio * self.stiffness])
        none = self.hands.none
        law = _JointResponse(_COUPLED, np.zeros((self.corners, 3)), springs, friction, none)
        found = ElasticAnswer(law.near, np.zeros((self.count, 6)), none)
        for start in starts or (found.motion,):
            balances, found = self._relaxed(load, law, start, balanced)
            if balances:
                return True, found
        return False, found

    @by_one_thread
    def coupled_by_rounds(
        self,
        load: np.ndarray,
        friction: np.ndarray,
        ratio: float,
        balanced: float,
        found: ElasticAnswer,
    ) -> tuple[bool, ElasticAnswer]:
        """As coupled, from motions of the nearest law: of ``found``, at first."""
        balances = True
        tried = _TRIED if self.count <= _FEW else _TRIED_OF_MANY
        for number in range(tried[-1] + 1):
            if not balances or np.abs(found.motion).max(initial=0.0) > _FAR:
                break
            if number in tried:
                done, answer = self.coupled(load, friction, ratio, balanced, (found.motion,))
                if done:
                    return True, answer
            # What the cone cuts off across has opened the joint by friction times as much.
            force = self.stiffness[:, None] * self._strain(found.motion)[:, 1:]
            cut = np.hypot(*force.T) - np.hypot(*found.forces[:, 1:].T)
            near = np.zeros((self.corners, 3))
            near[:, 0] = -friction * np.maximum(cut, 0)
            balances, found = self.nearest(load, friction, near, balanced, found.motion)
        return False, found

    @by_one_thread
    def nearest(
        self,
        load: np.ndarray,
        friction: np.ndarray,
        near: np.ndarray,
        balanced: float,
        motion: np.ndarray | None = None,
        wrenches: np.ndarray | None = None,
    ) -> tuple[bool, ElasticAnswer]:
        """The forces in Coulomb's cone nearest to given ones that balance a load, or what was
        reached: where there are none, a motion that nothing holds back.

        Args:
            wrenches: float64[h, 6], those of the hands that are given; by default none.
        """
        given = self.hands.none if wrenches is None else wrenches
        law = _JointResponse(_NEAREST, near, np.stack([self.stiffness] * 2), friction, given)
        motion = np.zeros((self.count, 6)) if motion is None else motion
        return self._descended(load, law, motion, balanced)

    def _strain(self, motion: np.ndarray) -> np.ndarray:
        """float64[c, 3]: how the two blocks at every corner move into one another."""
        known = np.concatenate([motion, np.zeros((1, 6))])
        return np.einsum("scrw,scw->cr", self.wrench, known[self.body])

    def _descended(
        self, load: np.ndarray, law: _JointResponse, motion: np.ndarray, balanced: float
    ) -> tuple[bool, ElasticAnswer]:
        """Newton's method where the law has an energy that falls."""
        limit = (balanced * self.weight) ** 2
        now, stalls, leak = 0, 0, _LEAK
        value = self._respond(motion, load, law, now)
        left = self._left
        for number in range(_STEPS):
            if ((left[now] ** 2).sum(1) <= limit).all():
                break
            change = self._change(law, now, leak)
            if change is None:
                break
            size, rate = float((left[now] ** 2).sum()), float((left[now] * change).sum())
            step, nearer, there, after = 1.0, False, motion, value
            for _ in range(_HALVINGS):
                there = motion + step * change
                after = self._respond(there, load, law, 1 - now)
                found = float((left[1 - now] ** 2).sum())
                # Close to the end the energy is too coarse to tell.
                nearer = found < (1 - 0.2 * step) * size or after <= value - 1e-4 * step * rate
                if nearer:
                    break
                step /= 2
            leak = max(0.01 * leak, _LEAST_LEAK) if step == 1 else min(10 * leak, _MOST_LEAK)
            stalls = 0 if nearer else stalls + 1
            motion, now, value = there, 1 - now, after
            # What is soft comes back from far in the first steps.
            if (number >= _STALLS and np.abs(motion).max() > _FAR) or stalls == _STALLS:
                break
        return self._answer(motion, limit, now)

    def _relaxed(
        self, load: np.ndarray, law: _JointResponse, motion: np.ndarray, balanced: float
    ) -> tuple[bool, ElasticAnswer]:
        """Newton's method where the law has no energy: a relaxation in time, with large steps."""
        limit = (balanced * self.weight) ** 2
        now, waited, leak, left = 0, 0, _LEAK, self._left
        self._respond(motion, load, law, now)
        size = best = float((left[now] ** 2).sum())
        for number in range(_RELAXED):
            if ((left[now] ** 2).sum(1) <= limit).all():
                break
            change = self._change(law, now, leak)
            if change is None:
                break
            step, there, found = 1.0, motion, size
            for _ in range(_SHORTER):
                there = motion + step * change
                self._respond(there, load, law, 1 - now)
                found = float((left[1 - now] ** 2).sum())
                if found <= _WORSE * size:
                    break
                step /= 2
            if step == 1 and found < 0.64 * size:
                leak *= 0.01
            else:
                leak *= 0.5 if found < size else 10
            leak = min(max(leak, _LEAST_LEAK), _MOST_LEAK)
            motion, now, size = there, 1 - now, found
            best, waited = (size, 0) if size < 0.5 * best else (best, waited + 1)
            if waited > _WAIT or (number > _WAIT and np.abs(motion).max() > _FAR):
                break
        return self._answer(motion, limit, now)

    def _respond(
        self, motion: np.ndarray, load: np.ndarray, law: _JointResponse, now: int
    ) -> float:
        """The energy at a motion; forces, derivatives and what is left go to place ``now``."""
        place = self._force[now], self._slope[now], self._left[now]
        energy = _respond(motion, load, self.body, self.wrench, *law[:4], *place)
        if not self.hands.held:
            return energy
        self._hand[now], self._hand_slope[now], more = self.hands.respond(motion, law.hands)
        self._left[now][self.hands.body] -= self._hand[now]
        return energy + more

    def _change(self, law: _JointResponse, now: int, leak: float) -> np.ndarray | None:
        """The change of motion of a step of Newton's method, or None."""
        data, hands = self._matrix.data, self._matrix.diagonal(self.hands.body)
        _assemble(self.body, self.wrench, self._slope[now], leak, law.springs, *self._places, data)
        for body, slope in zip(hands, self._hand_slope[now], strict=True):
            data[body] += slope + leak * STIFFNESS * np.eye(6)
        along = np.arange(6)
        # Blocks that nothing holds have springs to the ground, and rounding does not undo these.
        diagonal = data[: self.count, along, along]
        data[: self.count, along, along] += _SPRING + 1e-12 * diagonal.max(initial=0.0)
        change = self._matrix.solve(self._left[now], symmetric=law.kind == _NEAREST)
        return change if change is not None and np.isfinite(change).all() else None

    def _answer(
        self, motion: np.ndarray, limit: np.ndarray, now: int
    ) -> tuple[bool, ElasticAnswer]:
        # What the ground springs bear is not balanced.
        near = np.abs(motion).max(initial=0.0) <= _FAR
        balances = bool(near and ((self._left[now] ** 2).sum(1) <= limit).all())
        return balances, ElasticAnswer(self._force[now].copy(), motion, self._hand[now].copy())


class _JointResponse(NamedTuple):
    """How corners answer to motion."""

    kind: int
    near: np.ndarray
    """float64[c, 3]: forces without motion."""
    springs: np.ndarray
    """float64[2, c]: along the normal and across."""
    friction: np.ndarray
    hands: np.ndarray
    """float64[h, 6]: wrenches of hands without motion."""


# ---------------------------------------------------------------- compiled


@kernel
def _respond(
    motion: np.ndarray,
    load: np.ndarray,
    body: np.ndarray,
    wrench: np.ndarray,
    kind: int,
    near: np.ndarray,
    springs: np.ndarray,
    friction: np.ndarray,
    force: np.ndarray,
    slope: np.ndarray,
    left: np.ndarray,
) -> float:
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
        # Both blocks move; the wrench of the other one has the opposite sign already.
        for side in range(2):
            block = body[side, p]
            if block >= 0:
                for r in range(3):
                    for w in range(6):
                        e[r] += wrench[side, p, r, w] * motion[block, w]
        k, kt, mu, d = springs[0, p], springs[1, p], friction[p], slope[p]
        n, u, v = near[p, 0] + k * e[0], near[p, 1] + kt * e[1], near[p, 2] + kt * e[2]
        size = np.sqrt(u * u + v * v)
        f, most = n, mu * n
        if kind == _NEAREST and size > most:
            # The nearest point of the cone lies on its side, and presses more than the spring:
            # a corner that is pulled apart while it slides may still be in contact.
            f = (n + mu * size) / (1.0 + mu * mu)
            most = mu * f
        if f <= 0.0:
            continue  # open: no force, and no derivative
        d[0, 0] = k if n > 0.0 else 0.0
        if kind == _NEAREST:
            energy += (f * f + min(size, most) ** 2) / (2 * k)
        if size <= most:
            # It sticks: springs in all directions.
            force[p, 0], force[p, 1], force[p, 2] = f, u, v
            d[1, 1] = d[2, 2] = kt
        else:
            # It slides: the force across turns with the motion and grows with the normal force
            # alone, not with how far it slides.
            u, v = u / size, v / size
            force[p, 0], force[p, 1], force[p, 2] = f, most * u, most * v
            turn = most / size * kt
            d[1, 1], d[2, 2] = turn * (1 - u * u), turn * (1 - v * v)
            d[1, 2] = d[2, 1] = -turn * u * v
            if kind == _COUPLED:
                # Friction follows the normal force, not the other way round: not symmetric.
                d[1, 0], d[2, 0] = mu * u * k, mu * v * k
            else:
                # On the side of the cone forces change along its line through the tip.
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


@kernel
def _assemble(
    body: np.ndarray,
    wrench: np.ndarray,
    slope: np.ndarray,
    leak: float,
    springs: np.ndarray,
    at: np.ndarray,
    turned: np.ndarray,
    data: np.ndarray,
) -> None:
    """Set a matrix to the sum of wrench.T @ slope @ wrench over both sides of every corner.

    A corner couples the two blocks it lies between, each with itself and with the other one: up to
    four blocks of 6 x 6, at places that depend on which blocks touch only and are known (``at``,
    ``turned``).
    """
    data[:] = 0.0
    d, moved = np.empty((3, 3)), np.empty((3, 6))
    for p in range(body.shape[1]):
        for r in range(3):
            for c in range(3):
                d[r, c] = slope[p, r, c]
            # Open and sliding corners resist a little, or a loose block would make it singular.
            d[r, r] += leak * springs[min(r, 1), p]
        for column in range(2):
            if body[column, p] < 0:
                continue
            for r in range(3):
                for c in range(6):
                    moved[r, c] = 0.0
                    for k in range(3):
                        moved[r, c] += d[r, k] * wrench[column, p, k, c]
            for row in range(2):
                if body[row, p] < 0:
                    continue
                block = data[at[row, column, p]]
                if turned[row, column, p]:
                    block = block.T
                for r in range(6):
                    for c in range(6):
                        for k in range(3):
                            block[r, c] += wrench[row, p, k, r] * moved[k, c]


@kernel
def add_wrenches(  # pragma: no cover
    body: np.ndarray, wrench: np.ndarray, forces: np.ndarray, result: np.ndarray
) -> None:
    """Add what forces at corners do to both of their blocks, in place."""
    for p in range(len(forces)):
        for r in range(3):
            force = forces[p, r]
            if force != 0.0:
                for side in range(2):
                    block = body[side, p]
                    if block >= 0:
                        for w in range(6):
                            result[block, w] += force * wrench[side, p, r, w]
