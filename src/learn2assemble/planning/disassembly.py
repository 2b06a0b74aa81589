"""What may be taken away of a finished structure of bricks that clutch: an order, found backwards.

Bricks are taken one by one along their studs, upwards where nothing is over them; hands also take
them downwards, and take several as one where what hangs on a brick would come off with it. What
stands before, after, and while a brick is pressed home is proven each time; where it does not, a
hand holds one brick for as long as that is needed. Read backwards, that is an order of building:
hands put bricks in from below, and attach what they have built beside.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from learn2assemble.assembly.blocks import Assembly, AssemblyStep
from learn2assemble.assembly.bricks.lattice import GROUND
from learn2assemble.assembly.bricks.mates import BrickMates
from learn2assemble.planning.sequence import Doing, Supports, Transition, Way
from learn2assemble.statics.holding.program import Push
from learn2assemble.statics.laws import ByStrength
from learn2assemble.statics.states import State

_TRIES = 300, 10
"""Bricks taken away before the search gives up: so many, and so many for each one there is."""
_MANY = 500
"""Bricks up to which programs of all of them say what stands; of more, where hands help, what is
proven from the state before, and a hand holds what is pressed on where it is not."""
_LAYERS = 2
"""Bricks high: of many bricks, what is deeper below the highest one is taken away later."""
_NONE = np.empty(0, np.int64)
_HELPERS = 6
"""Bricks that are tried to be held for one that does not stand."""


class TakingApart:
    """Bricks taken away from above; the rules of a search (:class:`~.sequence.OrderRules`).

    Args:
        assembly: bricks on a lattice of studs; steps are not looked at.
        law: by which its states stand.
        supports: hands and holds that may help.

    Raises:
        InputError: for blocks that are no bricks on one lattice.
    """

    law: ByStrength
    help: Supports
    strength: float
    mates: BrickMates
    fixed: np.ndarray

    patient = True

    def __init__(self, assembly: Assembly, law: ByStrength, supports: Supports) -> None:
        self.law, self.help, self.strength = law, supports, assembly.joint.press
        self.mates = mates = BrickMates(assembly)
        self.fixed, low, high = mates.fixed, mates.lattice.low, mates.lattice.high
        self._hung: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        """Of bricks, what hung on them alone when that was last asked, and what was there then."""
        self.many: bool = mates.count > _MANY and supports.hands
        self.tries: int = _TRIES[0] + _TRIES[1] * mates.count
        nobody = np.zeros(mates.count, bool)
        self.first: Transition = Transition((), State(~nobody, nobody))
        self.ground: State = State(self.fixed, nobody)
        self.top: list[int] = high[:, 2].tolist()
        layers = _LAYERS * int((high[:, 2] - low[:, 2]).max(initial=1))
        self.near: int = layers if self.many else int(high[:, 2].max(initial=0))
        """What is deeper below the highest brick is far from it [lattice layers]."""
        self.rank: list[int] = np.lexsort((low[:, 1], low[:, 0], -high[:, 2])).tolist()

    def hanging(self) -> list[int]:
        """Bricks under which there is nothing to press them on."""
        return [k for k, lower in enumerate(self.mates.lower) if not lower and not self.fixed[k]]

    def key(self, move: Transition) -> bytes:
        """What is there and what is held."""
        return move.state.key

    def left(self, move: Transition) -> tuple[int, int]:
        """Bricks that are still there."""
        return int((move.state.present & ~self.fixed).sum()), 0

    def settled(self, move: Transition) -> Transition:
        """The move: what is held is let go within it."""
        return move

    @staticmethod
    def read(path: list[Transition]) -> list[Doing]:
        """The steps of building, where everything is taken away in the end."""
        return [step for move in reversed(path) for step in move.steps]

    def follow(self, state: State, step: AssemblyStep, block: int | None) -> Doing | str:
        """A step of building from a state, or why it cannot be done.

        Args:
            block: of the step; None where it is no brick.
        """
        if block is None or step.action != "place":
            return "places no brick"
        after = state.change(place=[block])
        way = self.way([block], after)
        if way is None:
            return f"({step.block}) has no free way"
        press = self.press_on([block], way, state)
        if not (self.law.stands(after) and self.law.stands(after, push=press)):
            return f"({step.block}) falls, or falls when it is pressed"
        return Doing("place", block, way)

    # ------------------------------------------------------------ moves

    def moves(self, last: Transition) -> Iterator[Transition]:
        """What may be taken away, the highest first: alone, with what hangs on it, at last where a
        hand has to hold another one from then on.

        Of many bricks, those far below the highest one have their turn after what comes off
        together up there: layer by layer, the proof of a state serves many behind it.
        """
        state = last.state
        held, free = state.held, state.present & ~self.fixed
        single: list[tuple[int, Way, State]] = []
        above, below = self.mates.open(state.present)
        below &= ~self.mates.based & self.help.hands
        loose = [b for b in self.rank if free[b] and (above[b] or below[b])]
        near = max((self.top[b] for b in loose), default=0) - self.near
        for upper in (True, False):
            highest: list[int] = []
            for b in [b for b in loose if (self.top[b] >= near) == upper]:
                way: Way = "above" if above[b] else "below"
                rest = _without(state, [b])
                if self._carries(b, rest):
                    highest += [b] if way == "above" and not held[b] else []
                elif held[b] or self._meets(b, way, rest):
                    single.append((b, way, rest))
                    yield from self._single(b, way, state, rest)
            if self.help.hands:
                groups = [group for b in highest if (group := self._together(b, state))]
                for group in sorted(groups, key=len):
                    yield from self._several(group, state)
        if held.sum() < self.help.holds:
            for b, way, rest in single:
                for helper in self._helpers(rest):
                    yield from self._single(b, way, state, rest, helper)

    def _carries(self, b: int, rest: State) -> bool:
        """Whether something hangs on nothing without a brick."""
        known, there = self._hung.get(b, (_NONE, rest.present))
        # What hung on it alone still does while fewer bricks are there.
        if rest.held.any() or not rest.present[known].any() or (rest.present & ~there).any():
            known = self._loose(rest)
            self._hung[b] = known, rest.present
        return len(known) > 0

    def _together(self, b: int, state: State) -> list[int]:
        """A brick with what has to come off with it: what hangs on it, and what is over that; empty
        where that is everything."""
        group = np.zeros(len(self.fixed), bool)
        group[b] = True
        more = group
        while more.any():
            over = np.zeros_like(group)
            for k in np.flatnonzero(more).tolist():
                over[self.mates.over[k]] = True
            grown = group | (over & state.present)
            rest = State(state.present & ~grown, state.held & ~grown)
            grown[self._loose(rest)] = True
            more, group = grown & ~group, grown
        if group[state.held | self.fixed].any() or (group == state.present).all():
            return []
        return [b, *(k for k in np.flatnonzero(group).tolist() if k != b)]

    def _single(
        self, b: int, way: Way, state: State, rest: State, helper: int | None = None
    ) -> Iterator[Transition]:
        """A brick, with the help it needs to be pressed home.

        Args:
            rest: the state without it, with the same hands.
            helper: a brick that a hand holds from then on, for the rest to stand.
        """
        if state.held[b]:
            left = rest.change(release=[b])
            if self.law.stands(left):
                # A hand that is there already may bring what the others come to.
                whence = way if self._meets(b, way, rest) else "beside"
                yield self._with([Doing("place", b, whence), Doing("hold", b)], left)
            return
        hand = rest if helper is None else rest.change(hold=[helper])
        if not self._stand(hand):
            return
        there = state if helper is None else state.change(hold=[helper])
        pressed = self._pressed([b], way, there, rest)
        if pressed is None:
            return
        mate, under = pressed
        middle = self.press_on([b], way, rest)._replace(at=self.mates.middle(b))
        steps = [Doing("place", b, way)]
        if self.help.holds > 0 and not self.law.stands(under, not self.many, middle):
            steps += [Doing("hold", b), Doing("release", b)]
        if helper is not None:
            steps.append(Doing("release", helper))
        yield self._with(_while_held(mate, steps), hand)

    def _pressed(
        self, group: list[int], way: Way, state: State, rest: State
    ) -> tuple[int | None, State] | None:
        """Who has to hold what while some bricks are pressed home: nobody, or a hand each brick
        they are pressed on, in turn; of these the one with the most knobs, and the state in which
        it is held. None where that is not enough."""
        press = self.press_on(group, way, rest)
        if self.law.stands(state, not self.many, press):
            return None, state
        mates = {
            m: b for b in group for m in self._mates(b) if rest.present[m] and not self.fixed[m]
        }
        # The hand that presses reaches round both; an arm needs another one.
        if not mates or not (self.help.hands or state.held.sum() < self.help.holds):
            return None
        for mate, b in mates.items():
            alone = State(np.zeros_like(rest.present), rest.held).change(place=[mate])
            press = self.press_on([b], way, alone)
            if not self.law.stands(state.change(hold=[mate]), not self.many, press):
                return None
        most = max(mates, key=lambda m: self._knobs(m, mates[m]))
        return most, state.change(hold=[most])

    def _knobs(self, one: int, other: int) -> int:
        knobs = self.mates.knobs
        return knobs[(one, other) if (one, other) in knobs else (other, one)].count

    def _helpers(self, rest: State) -> list[int]:
        """Bricks that a hand may hold where the rest falls: those that move first."""
        if self.law.stands(rest):
            return []
        moving = self.law.moving(rest)
        some = [b for b in moving if rest.present[b] and not self.fixed[b] and not rest.held[b]]
        return sorted(some, key=lambda b: -self.mates.lattice.high[b, 2])[:_HELPERS]

    def _several(self, group: list[int], state: State) -> Iterator[Transition]:
        """Bricks that come off together, built beside, where the first one is held, and attached as
        one."""
        b, way, rest = group[0], self.way(group, state), _without(state, group)
        if way is None or not self._stand(rest):
            return
        pressed = self._pressed(group, way, state, rest)
        if pressed is None:
            return
        nobody = np.zeros_like(state.held)
        there = State(nobody, nobody).change(place=group, hold=[b])
        layer, parts = self.mates.lattice.low[:, 2], list[list[Doing]]()
        while there.present.sum() > 1:
            left = [k for k in np.flatnonzero(there.present).tolist() if k != b]
            for k in sorted(left, key=lambda one: (-abs(layer[one] - layer[b]), one)):
                less = _without(there, [k])
                own = self.way([k], there)
                if own is None or not self._meets(k, own, less) or len(self._loose(less)):
                    continue
                inside = self._pressed([k], own, there, less)
                if inside is not None:
                    there = less
                    parts.append(_while_held(inside[0], [Doing("place", k, "beside")]))
                    break
            else:
                return
        steps = [step for part in parts[::-1] for step in part]
        made = [Doing("place", b, "beside"), Doing("hold", b), *steps, Doing("release", b)]
        yield self._with(_while_held(pressed[0], made), rest)

    def _with(self, steps: list[Doing], rest: State) -> Transition:
        """The move, without holds that the rest does not need."""
        first: list[Doing] = []
        for b in np.flatnonzero(rest.held).tolist():
            less = rest.change(release=[b])
            if self.law.stands(less):
                rest = less
                first.append(Doing("hold", b))
        return Transition((*first, *steps), rest)

    # ------------------------------------------------------------ questions

    def press_on(self, group: list[int], way: Way, rest: State) -> Push:
        """The press that brings some bricks home on what is there."""
        found = self.mates.press(group, rest.present, way == "below")
        force = self.strength if way == "above" else -self.strength
        return Push(found.brick, force if found.knobs else 0.0, found.at)

    def way(self, group: list[int], state: State) -> Way | None:
        """Along which way some bricks come off together."""
        rest, mates = _without(state, group).present, self.mates
        if not any(rest[mates.over[b]].any() for b in group):
            return "above"
        based = mates.based[group].any() or self.fixed[group].any()
        if self.help.hands and not based and not any(rest[mates.under[b]].any() for b in group):
            return "below"
        return None

    def _stand(self, state: State) -> bool:
        """Whether a state stands."""
        return self.law.stands(state, not self.many)

    def _meets(self, b: int, way: Way, rest: State) -> bool:
        """Whether a brick meets knobs, or its knobs meet a brick, where it comes to."""
        return bool(self.mates.meets(b, rest.present, way == "below"))

    def _loose(self, state: State) -> np.ndarray:
        """int64[n]: bricks that hang on nothing that stands."""
        return self.mates.loose(state.present, state.held)

    def _mates(self, block: int) -> list[int]:
        mates = self.mates
        return [m for m in (*mates.lower[block], *mates.upper[block]) if m != GROUND]


def _without(state: State, blocks: list[int]) -> State:
    """The state without some blocks, with the same hands."""
    present = state.present.copy()
    present[blocks] = False
    return State(present, state.held)


def _while_held(mate: int | None, steps: list[Doing]) -> list[Doing]:
    """Steps while a hand holds a brick."""
    return steps if mate is None else [Doing("hold", mate), *steps, Doing("release", mate)]
