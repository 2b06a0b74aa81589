"""Forces of one state of bricks, changed where something changes, as the proof of the next one.

Where bricks clutch, the contact points of a joint push as much as they can pull where nothing is
asked of it, so that weights and presses only shift what they push. States that follow each other
while one builds differ by a few bricks, and what those lack of a balance that lost or got a joint
is passed on, brick by brick, to those that are nearer to the ground, by pushes alone.

Where that does not do, a *base* is looked for: a state of which the highest bricks are left out,
and its forces as if all joints were elastic, level ones and couples about the vertical too, which
knobs bear without a limit. States that have a few bricks more pass on what these weigh to the base,
which bears it elastically; its factors are made once.

What comes of it is looked at whole: where every brick is balanced and no contact point pulls more
than it can, the state stands. Where all fails, nothing is said, and the program of all bricks
(:mod:`.program`) decides, which knows all forces.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.assembly.bricks.mates import hanging
from learn2assemble.statics.forces.block_factors import Factors, Springs, sides_of
from learn2assemble.statics.holding.forces import Forces
from learn2assemble.statics.holding.passing_on import PARTS, JointSums
from learn2assemble.statics.holding.program import Balance, Need, Push
from learn2assemble.statics.holding.solver import nearest

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
_LEVEL = 100.0
"""How stiff a level force, or a couple about the vertical, is beside a push in the middle."""
_SPARE = 0.02
"""Share of the push that a program of elastic joints leaves everywhere."""
_SHOWN = 0.1
"""Share of the strength that many bricks may need, of which no one looks for the least."""
_FEWER = 0.9
"""Share of the bricks at which pushes alone are tried again, once they did not do."""
_OPEN = 64
"""Bricks by which states may have more than their base."""


class _Balanced(NamedTuple):
    """What balances a state with all the strength of its joints."""

    present: np.ndarray
    held: np.ndarray
    size: np.ndarray
    """float64[n]: of pushes, level forces and couples [mean weights]."""


class _Base(NamedTuple):
    """A state, and how it bears more elastically."""

    state: _Balanced
    columns: np.ndarray
    """int64[n]: forces between its bricks."""
    factors: Factors
    """Of the springs that these are."""


class NearForces:
    """Proofs of states one after the other.

    Args:
        balance: the program of all bricks.
        forces: that it was made of.
        thorough: whether a program is asked for the forces of all bricks where spreading what they
            lack finds none; :meth:`need` asks one of its own.
    """

    def __init__(self, balance: Balance, forces: Forces, thorough: bool = True) -> None:
        self.balance = balance
        count = balance.count
        even, level = _even(balance, forces), np.isinf(balance.columns.lower)
        self._which = which = np.flatnonzero((even > 0) | level)
        self._even, self._level = even[which], level[which]
        self._least = np.where(self._level, -np.inf, _LEAST * self._even)
        unit = float(np.median(even[even > 0])) if (even > 0).any() else 1.0
        self._stiff = _LEVEL * unit
        a, b = balance.bodies
        self._bodies = a[which], b[which]
        self._matrix = balance.wrench[:, which].tocsr()
        sides = sides_of(self._matrix, self._bodies, count)
        self._joints = JointSums(sides, self._bodies, count)
        self._springs = Springs(sides, self._bodies, count)
        pairs = np.unique(np.column_stack(self._bodies)[~self._level], axis=0)
        self._pairs = pairs.T
        self._below: list[list[int]] = [[] for _ in range(count)]
        """Of each brick those that it is on."""
        on_others: list[list[int]] = pairs[pairs[:, 0] >= 0].tolist()
        for lower, upper in on_others:
            self._below[upper].append(lower)
        self._known: list[_Balanced] = []
        self._base: _Base | None = None
        self._pushed = count + 1
        """Bricks below which pushes alone are tried."""
        everything = np.ones(count, bool)
        self.begin(everything, ~everything, thorough)

    def begin(self, present: np.ndarray, held: np.ndarray, thorough: bool = True) -> None:
        """Go on from a state that stands, where it does so with strength to spare."""
        made = self._elastic(present, held, thorough)
        if made is not None:
            self._keep(present, held, made.state.size)

    def need(self, little: bool = False) -> Need | None:
        """Forces of all blocks, not those that need the least strength; None where none are found.

        Args:
            little: whether they need at most :data:`_SHOWN` of it, which takes a program.
        """
        balance, push, even = self.balance, self._even > 0, self._even
        size = self._known[-1].size if self._known else np.zeros(len(even))
        if not self._known and not little:
            return None
        if little and (size < (1.0 - _SHOWN) * even).any():
            rows = np.flatnonzero(np.repeat(~balance.fixed, 6))
            everything = np.ones(balance.count, bool)
            load = self._load(everything, None)
            lack = self._lack(load, even, ~balance.fixed).reshape(-1)[rows]
            lower = np.where(push, -_SHOWN * even, -np.inf)
            stiff = np.where(push, even, self._stiff)
            more = nearest(self._matrix[rows], lack, lower, stiff)
            if more is None:
                return None
            size = even + more
        share = 1.0 - float(np.min(size[push] / even[push], initial=1.0))
        found = np.zeros(len(balance.columns.b))
        found[self._which] = (size - (1.0 - share) * even) * balance.unit
        return Need(share, found, least=False)

    def _keep(self, present: np.ndarray, held: np.ndarray, size: np.ndarray) -> None:
        self._known = [_Balanced(present.copy(), held.copy(), size), *self._known[: _KEPT - 1]]

    def stands(self, present: np.ndarray, held: np.ndarray, push: Push | None = None) -> bool:
        """Whether a proof is found; where none is, the state may stand all the same.

        Args:
            present: bool[count], the blocks that are there.
            held: bool[count], those of them that a hand holds.
            push: a further force on a block.
        """
        if push is not None and push.force == 0:
            push = None
        if not self._known:
            return False
        differ = [int((k.present != present).sum() + (k.held != held).sum()) for k in self._known]
        closest = int(np.argmin(differ))
        known = self._known.pop(closest)
        self._known.insert(0, known)
        if push is None and differ[closest] == 0:
            return True
        load = self._load(present, push)
        made = self._passed(known, present, held, load)
        if made is None:
            # Of many, a press is not worth factors of its own.
            whole = push is None or int(present.sum()) <= 2 * _OPEN
            made = self._grown(present, held, load, whole)
        if made is not None and push is None:
            self._keep(present, held, made)
        return made is not None

    def _passed(
        self, known: _Balanced, present: np.ndarray, held: np.ndarray, load: np.ndarray
    ) -> np.ndarray | None:
        """Forces with what blocks lack passed on from each to those nearer to what is held; None
        where one of them cannot do that."""
        on, free = self._there(present, held)
        size = self._continued(known, on)
        lack = self._lack(load, size, free)
        if np.abs(lack[:, [0, 1, 5]]).max(initial=0.0) > _EXACT:
            return None
        self._joints.pass_on(free, on & ~self._level, lack, size)
        return size if self._balanced(size, on, free, load) else None

    def _there(self, present: np.ndarray, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which forces there are in a state, and which bricks nothing holds."""
        on = self.balance.on(self._bodies, present)
        return on, present & ~self.balance.fixed & ~held

    def _continued(self, known: _Balanced, on: np.ndarray) -> np.ndarray:
        """Forces of a known state where its joints are still there; joints of what has come push as
        much as they pull, until more is asked of them."""
        before = self.balance.on(self._bodies, known.present)
        return np.where(on, np.where(before, known.size, self._even), 0.0)

    def _grown(
        self, present: np.ndarray, held: np.ndarray, load: np.ndarray, whole: bool
    ) -> np.ndarray | None:
        """Forces of a base that is a part of a state, with what the rest needs; None where no base
        is found that bears it.

        Args:
            whole: whether all of the state may be its base, too.
        """
        base = self._base
        if base is not None and _within(base.state, present, held):
            made = self._borne(base, present, held, load)
            if made is not None or not whole:
                return made
        for some in (self._lower_part(present, held), present if whole else None):
            if some is None:
                continue
            base = self._elastic(some, held & some)
            if base is not None:
                self._base = base
                made = self._borne(base, present, held, load)
                if made is not None:
                    return made
        return None

    def _borne(
        self, base: _Base, present: np.ndarray, held: np.ndarray, load: np.ndarray
    ) -> np.ndarray | None:
        """Forces of a base with what a state needs that has all of it; None where some contact
        points would pull more than they can."""
        on, free = self._there(present, held)
        size = self._continued(base.state, on)
        more = free & ~base.state.present
        if more.any():
            lack = np.where(more[:, None], self._lack(load, size, free), 0.0)
            self._joints.pass_on(more, on & ~self._level, lack, size)
        for _ in range(2):  # Once more for what rounding leaves.
            size[base.columns] += base.factors.spread(self._lack(load, size, free))
        return size if self._balanced(size, on, free, load) else None

    def _lower_part(self, present: np.ndarray, held: np.ndarray) -> np.ndarray | None:
        """bool[count]: a state without the highest bricks that nothing is on and nothing hangs on
        alone, as one takes them away; None of a state of few."""
        free = present & ~self.balance.fixed & ~held
        if free.sum() <= 2 * _OPEN:
            return None
        lower, gone, count = present.copy(), 0, len(present)
        a, b = self._pairs
        on = present[b] & ((a < 0) | present[a])
        on_it = np.bincount(a[on & (a >= 0)], minlength=count)
        under_it = np.bincount(b[on], minlength=count)
        bricks: list[int] = self.balance.downwards[free[self.balance.downwards]].tolist()
        for brick in bricks:
            if on_it[brick]:
                continue
            below = [m for m in self._below[brick] if lower[m]]
            if any(on_it[m] == 1 and not under_it[m] and free[m] for m in below):
                continue
            lower[brick] = False
            on_it[below] -= 1
            gone += 1
            if gone == _OPEN * 3 // 4:
                break
        still = self.balance.fixed | held
        lower &= ~hanging(self._pairs[0], self._pairs[1], lower, still)
        return lower if int((present & ~lower).sum()) <= _OPEN else None

    def _elastic(
        self, present: np.ndarray, held: np.ndarray, thorough: bool = False
    ) -> _Base | None:
        """A state whose joints are elastic: pushes alone where these do, else with level forces,
        from those of the state before, else from even pushes.

        Args:
            thorough: whether a program is asked where spreading finds none.
        """
        on, free = self._there(present, held)
        bricks = int(free.sum())
        even = _Balanced(present.copy(), held.copy(), np.where(on, self._even, 0.0))
        if bricks < self._pushed:
            pushes = np.flatnonzero(on & ~self._level)
            found = self._spread(even, tuple(PARTS.tolist()), pushes)
            if found is not None:
                return found
            self._pushed = int(_FEWER * bricks)
        parts, columns = tuple(range(6)), np.flatnonzero(on)
        for known in self._known[:1]:
            start = even._replace(size=self._continued(known, on))
            found = self._spread(start, parts, columns)
            if found is not None:
                return found
        return self._spread(even, parts, columns, thorough)

    def _spread(
        self,
        state: _Balanced,
        parts: tuple[int, ...],
        columns: np.ndarray,
        thorough: bool = False,
    ) -> _Base | None:
        """What a state lacks spread over some forces, softest where they push most; None where some
        would have to pull more than they can.

        Args:
            parts: of the six rows of a brick those that count.
            thorough: whether a program is asked where it asks too much of some.
        """
        on, free = self._there(state.present, state.held)
        load, size = self._load(state.present, None), state.size.copy()
        level = self._level[columns]
        for turn in range(_SPREAD):
            push = np.where(level, self._stiff, size[columns])
            factors = self._springs.factors(free, columns, push, parts, _SOFT)
            if factors is None:
                return None
            lack = self._lack(load, size, free)
            more = factors.spread(lack)
            most = float(np.max(np.where(level, 0.0, -more / push), initial=0.0))
            if not np.isfinite(most) or (most > _LOST and not thorough):
                return None
            if turn == 0 and most > _NEAR and thorough:
                # Too much for some: with the least energy of all forces that leave some of it.
                rows = (6 * np.flatnonzero(free)[:, None] + np.array(parts)).reshape(-1)
                lower = np.where(level, -np.inf, (_SPARE - 1) * self._even[columns])
                matrix = self._matrix[rows][:, columns]
                found = nearest(matrix, lack.reshape(-1)[rows], lower, push)
                if found is None:
                    return None
                size[columns] += found
            else:
                size[columns] += min(1.0, _NEAR / max(most, 1e-12)) * more
            if self._balanced(size, on, free, load):
                return _Base(state._replace(size=size), columns, factors)
        return None

    def _balanced(
        self, size: np.ndarray, on: np.ndarray, free: np.ndarray, load: np.ndarray
    ) -> bool:
        """Whether forces keep within what joints can pull, and balance everything."""
        if not (size >= self._least)[on].all():
            return False
        return bool(np.abs(self._lack(load, size, free)).max(initial=0.0) <= _EXACT)

    def _load(self, present: np.ndarray, push: Push | None) -> np.ndarray:
        """float64[6 count]: what forces have to balance beside the preload [mean weights]."""
        balance = self.balance
        pulling = balance.on(balance.pull_bodies, present).astype(float)
        return balance.pushed(push) - balance.pulls @ pulling

    def _lack(self, load: np.ndarray, size: np.ndarray, free: np.ndarray) -> np.ndarray:
        """float64[count, 6]: what is not balanced yet of blocks that nothing holds."""
        lack = (load - self._matrix @ size).reshape(-1, 6)
        lack[~free] = 0.0
        return lack


def _within(known: _Balanced, present: np.ndarray, held: np.ndarray) -> bool:
    """Whether a state has all that a known one has, and not many bricks more."""
    missing = (known.present & ~present).any() or (known.held & ~held).any()
    return not missing and int((present & ~known.present).sum()) <= _OPEN


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
