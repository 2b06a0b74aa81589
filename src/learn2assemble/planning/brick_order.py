"""In which order given bricks that clutch are put together, found by taking them apart.

From the finished structure bricks are taken one by one along their studs, upwards where nothing is
over them; hands also take them downwards, and take several as one where what hangs on a brick would
come off with it. What stands before, after, and while a brick is pressed home is proven each time;
where it does not, a hand holds one brick for as long as that is needed. Read backwards, that is an
order of building: hands put bricks in from below, and attach what they have built beside.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.bricks.lattice import GROUND, StudLattice
from learn2assemble.errors import InputError
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.sequence import Action, Sequenced, SequenceStep, list_ids
from learn2assemble.statics.holding import Balance, Push
from learn2assemble.statics.holding_check import JointAnswer, stands_by_joints, words_of
from learn2assemble.statics.holding_forces import forces_of
from learn2assemble.statics.proofs import CLUTCH, CLUTCH_TIGHT

_TRIES = 300, 10
"""Bricks taken away before the search gives up: so many, and so many for each one there is."""
_LARGE, _NARROW = 100, 0.75
"""Bricks from which programs are made anew, when so small a share of theirs is there."""
_HELPERS = 6
"""Bricks that are tried to be held for one that does not stand."""
Way = Literal["above", "below", "beside"]
Doing = tuple[Action, int, Way | None]
"""What is done to which brick, and whence it comes."""


@dataclass(frozen=True)
class BrickHelp:
    """What may help.

    Attributes:
        hands: whether bricks may come from below, and several as one.
        holds: how many bricks may be held meanwhile.
    """

    hands: bool = False
    holds: int = 0


class _Removed(NamedTuple):
    """Some bricks that are taken away, and the steps that put them there."""

    steps: tuple[Doing, ...]
    """Forward: from the state after the removal to the one before."""
    present: np.ndarray
    held: np.ndarray
    """bool[B]: what is there, and held, after it."""


def order_bricks(
    assembly: Assembly,
    help_: BrickHelp,
    clock: Clock,
    progress: Callable[[str], None] = lambda text: None,
) -> Sequenced:
    """An order in which bricks are put together, every state of which stands, pressed, too.

    Args:
        assembly: bricks on a lattice of studs whose joints clutch.
        help_: what may help.

    Raises:
        InputError: for blocks that are no bricks on one lattice.
    """
    found = stands_by_joints(assembly)
    blocks = assembly.blocks
    if not found.need.stands:
        moving = found.balance.holding().moving
        reason = f"the finished structure falls: {words_of(found.need)}"
        reason += f"; {list_ids(blocks, moving)} would move first" if moving else ""
        return Sequenced(blocks, (), "refused", reason, tuple(moving))
    search = _TakingApart(assembly, help_, found, clock, progress)
    hanging = search.hanging()
    if hanging and not help_.hands:
        names = list_ids(blocks, hanging)
        reason = f"{names} hang on bricks above: they have to come from below (`hands=`)"
        return Sequenced(blocks, (), "refused", reason, tuple(hanging))
    steps = search.run()
    proof = CLUTCH_TIGHT if found.tight else CLUTCH
    made = tuple(SequenceStep(action, block, proof, None, way) for action, block, way in steps)
    if search.done:
        return Sequenced(blocks, made, "complete")
    return Sequenced(blocks, (), "not found", search.why(), search.stuck)


def follow_bricks(
    assembly: Assembly, help_: BrickHelp, clock: Clock
) -> tuple[Sequenced | None, str | None]:
    """The order that an assembly comes with, where every state of it stands, pressed, too.

    Returns:
        The order, or None and a note of what its first fault is.
    """
    found = stands_by_joints(assembly.finished)
    if not found.need.stands:
        return None, None
    search = _TakingApart(assembly.finished, help_, found, clock, lambda text: None)
    index = {block.id: k for k, block in enumerate(search.blocks)}
    present = search.fixed.copy()
    nobody = np.zeros_like(present)
    proof = CLUTCH_TIGHT if found.tight else CLUTCH
    steps = []
    for number, step in enumerate(assembly.steps, 1):
        b = index.get(step.block)
        if b is None or step.action != "place":
            return None, f"step {number} of the file places no brick: another order was found"
        there = present.copy()
        there[b] = True
        way = search.way([b], there)
        fault = "has no free way" if way is None else "falls, or falls when it is pressed"
        if way is None or not search.stands_pressed(b, way, there, present, nobody):
            return (
                None,
                f"step {number} of the file ({step.block}) {fault}: another order was found",
            )
        steps.append(SequenceStep("place", b, proof, None, way))
        present = there
    return Sequenced(search.blocks, tuple(steps), "complete"), None


class _TakingApart:
    """Depth first over what is taken away next."""

    def __init__(
        self,
        assembly: Assembly,
        help_: BrickHelp,
        found: JointAnswer,
        clock: Clock,
        progress: Callable[[str], None],
    ) -> None:
        balance, sides = found.balance, found.tight
        joint = assembly.joint
        if joint.law != "clutch" or assembly.joints:
            raise InputError("joints", "several laws", "one clutch for all, for an order of bricks")
        self.blocks, self.help, self.balance = assembly.blocks, help_, balance
        self.clock, self.progress, self.press = clock, progress, joint.press
        self.fixed = balance.fixed
        self.lattice = lattice = StudLattice(assembly.blocks, joint.pitch)
        count = len(assembly.blocks)
        self.lower: list[list[int]] = [[] for _ in range(count)]
        self.upper: list[list[int]] = [[] for _ in range(count)]
        clutches = lattice.clutches(ground=not self.fixed.any())
        self.knobs: dict[tuple[int, int], tuple[float, np.ndarray]] = {}
        """Of the joint of a lower and an upper brick: how many, and their middle [m]."""
        middle = (clutches.first + clutches.last) / 2 * joint.pitch[0] + lattice.offset[:2]
        many = (clutches.last - clutches.first).prod(1)
        for a, b, n, at in zip(
            clutches.lower.tolist(), clutches.upper.tolist(), many.tolist(), middle, strict=True
        ):
            self.knobs[a, b] = float(n), at
            self.lower[b].append(a)
            if a != GROUND:
                self.upper[a].append(b)
        lower = np.where(clutches.lower == GROUND, count, clutches.lower)
        self._pairs = lower, clutches.upper
        self.based = np.array([GROUND in lower for lower in self.lower])
        low, high = lattice.low, lattice.high
        meet = (low[:, None, :2] < high[None, :, :2]).all(2) & (
            high[:, None, :2] > low[None, :, :2]
        ).all(2)
        over = meet & (low[None, :, 2] >= high[:, None, 2])
        self.over = [np.flatnonzero(row) for row in over]
        self.under = [np.flatnonzero(row) for row in over.T]
        self.rank = np.lexsort((low[:, 1], low[:, 0], -high[:, 2])).tolist()
        self.whole, self.sides = assembly, sides
        self._scope, self._narrow = np.arange(count), balance
        self.done = False
        self.stuck: tuple[int, ...] = ()
        self._known: dict[tuple[bytes, bytes, Push | None], bool] = {}

    # ------------------------------------------------------------ search

    def run(self) -> list[Doing]:
        """The steps of building, where everything is taken away in the end."""
        start = np.ones(len(self.blocks), bool)
        held = np.zeros_like(start)
        path: list[_Removed] = []
        queue, seen, tries = [self.removals(start, held)], set(), 0
        fewest = len(start) + 1
        most = _TRIES[0] + _TRIES[1] * len(start)
        while queue and self.clock.left > 0 and tries < most:
            removal = next(queue[-1], None)
            tries += 1
            if removal is None:
                queue.pop()
                if path:
                    path.pop()
                continue
            key = removal.present.tobytes() + removal.held.tobytes()
            if key in seen:
                continue
            seen.add(key)
            path.append(removal)
            left = np.flatnonzero(removal.present & ~self.fixed)
            if len(left) < fewest:
                fewest, self.stuck = len(left), tuple(left.tolist())
                self.progress(f"{len(start) - fewest} of {len(start)} bricks in order")
            if not len(left):
                self.done = True
                return [step for one in reversed(path) for step in one.steps]
            queue.append(self.removals(removal.present, removal.held))
        return []

    def hanging(self) -> list[int]:
        """Bricks under which there is nothing to press them on."""
        return [k for k, lower in enumerate(self.lower) if not lower and not self.fixed[k]]

    def why(self) -> str:
        """Why there is no order."""
        if self.clock.left <= 0:
            return f"time ran out after {self.clock.limit:g} s"
        names = list_ids(self.blocks, self.stuck)
        return f"no order found: none of {names} can be the last one put there"

    def removals(self, present: np.ndarray, held: np.ndarray) -> Iterator[_Removed]:
        """What may be taken away, the highest first: alone, with what hangs on it, at last where a
        hand has to hold another one from then on."""
        free = present & ~self.fixed
        some = [b for b in self.rank if free[b]]
        single: list[tuple[int, Way, np.ndarray]] = []
        covered: list[tuple[int, np.ndarray]] = []
        for b in some:
            way = self.way([b], present)
            rest = present.copy()
            rest[b] = False
            if way is None:
                covered.append((b, rest))
                continue
            loose = self.loose(rest, held)
            if len(loose):
                covered.append((b, rest))
            elif held[b] or self._meets(b, way, rest):
                single.append((b, way, rest))
                yield from self._single(b, way, present, rest, held)
        groups = []
        if self.help.hands:
            groups = [(b, self.loose(rest, held)) for b, rest in covered if not held[b]]
            groups = [(b, loose) for b, loose in groups if len(loose)]
        for b, loose in sorted(groups, key=lambda one: len(one[1])):
            yield from self._several(b, loose, present, held)
        if held.sum() < self.help.holds:
            for b, way, rest in single:
                for helper in self._helpers(rest, held):
                    yield from self._single(b, way, present, rest, held, helper)

    def _single(
        self,
        b: int,
        way: Way,
        present: np.ndarray,
        rest: np.ndarray,
        held: np.ndarray,
        helper: int | None = None,
    ) -> Iterator[_Removed]:
        """A brick, with the help it needs to be pressed home.

        Args:
            helper: a brick that a hand holds from then on, for the rest to stand.
        """
        if held[b]:
            left = held.copy()
            left[b] = False
            if self.stands(rest, left):
                # A hand that is there already may bring what the others come to.
                whence = way if self._meets(b, way, rest) else "beside"
                yield self._with([("place", b, whence), ("hold", b, None)], rest, left)
            return
        hand = held.copy()
        if helper is not None:
            hand[helper] = True
        if not self.stands(rest, hand):
            return
        press = self.press_on([b], way, rest)
        pressed = self._pressed([b], way, present, rest, hand)
        if pressed is None:
            return
        mate, under = pressed
        level = self.help.holds > 0 and not self.stands(present, under, self.middle(press))
        steps: list[Doing] = [("place", b, way)]
        if level:
            steps.append(("hold", b, None))
            steps.append(("release", b, None))
        if helper is not None:
            steps.append(("release", helper, None))
        if mate is not None:
            steps.insert(0, ("hold", mate, None))
            steps.append(("release", mate, None))
        yield self._with(steps, rest, hand)

    def _pressed(
        self, group: list[int], way: Way, present: np.ndarray, rest: np.ndarray, held: np.ndarray
    ) -> tuple[int | None, np.ndarray] | None:
        """Who has to hold what while some bricks are pressed home: nobody, or a hand each brick
        they are pressed on, in turn; of these the one with the most knobs, and bool[B] what is
        held. None where that is not enough."""
        if self.stands(present, held, self.press_on(group, way, rest)):
            return None, held
        mates = {m: b for b in group for m in self._mates(b) if rest[m] and not self.fixed[m]}
        # The hand that presses reaches round both; an arm needs another one.
        if not mates or not (self.help.hands or held.sum() < self.help.holds):
            return None
        for mate, b in mates.items():
            under = held.copy()
            under[mate] = True
            alone = np.zeros_like(rest)
            alone[mate] = True
            if not self.stands(present, under, self.press_on([b], way, alone)):
                return None
        most = max(mates, key=lambda m: self._knobs(m, mates[m]))
        under = held.copy()
        under[most] = True
        return most, under

    def _knobs(self, one: int, other: int) -> float:
        pair = (one, other) if (one, other) in self.knobs else (other, one)
        return self.knobs[pair][0]

    def _helpers(self, rest: np.ndarray, held: np.ndarray) -> Iterator[int]:
        """Bricks that a hand may hold where the rest falls: those that move first."""
        if self.stands(rest, held):
            return
        moving = self.balance.holding(rest, held).moving
        some = [b for b in moving if rest[b] and not self.fixed[b] and not held[b]]
        some.sort(key=lambda b: -self.lattice.high[b, 2])
        yield from some[:_HELPERS]

    def _several(
        self, b: int, loose: np.ndarray, present: np.ndarray, held: np.ndarray
    ) -> Iterator[_Removed]:
        """A brick with what comes off with it, built beside and attached as one."""
        group = [b, *loose.tolist()]
        way = self.way(group, present)
        if way is None or held[group].any():
            return
        rest = present.copy()
        rest[group] = False
        if not self.stands(rest, held):
            return
        pressed = self._pressed(group, way, present, rest, held)
        if pressed is None:
            return
        mate = pressed[0]
        hand = held.copy()
        hand[b] = True
        there = rest.copy()
        there[b] = True
        steps: list[Doing] = [("place", b, "beside"), ("hold", b, None)]
        left = set(loose.tolist())
        while left:
            ready = [k for k in left if there[self._mates(k)].any()]
            if not ready:
                return
            k = min(
                ready, key=lambda one: (abs(self.lattice.low[one, 2] - self.lattice.low[b, 2]), one)
            )
            there[k] = True
            below = any(m != GROUND and there[m] for m in self.lower[k])
            if not self.stands(
                there, hand, self.press_on([k], "above" if below else "below", there)
            ):
                return
            steps.append(("place", k, "beside"))
            left.discard(k)
        steps.append(("release", b, None))
        if mate is not None:
            steps.insert(0, ("hold", mate, None))
            steps.append(("release", mate, None))
        yield self._with(steps, rest, held)

    def _with(self, steps: list[Doing], rest: np.ndarray, held: np.ndarray) -> _Removed:
        """The removal, without holds that the rest does not need."""
        held = held.copy()
        first: list[Doing] = []
        for b in np.flatnonzero(held).tolist():
            less = held.copy()
            less[b] = False
            if self.stands(rest, less):
                held = less
                first.append(("hold", b, None))
        return _Removed((*first, *steps), rest, held)

    # ------------------------------------------------------------ questions

    def stands_pressed(
        self, b: int, way: Way, present: np.ndarray, rest: np.ndarray, held: np.ndarray
    ) -> bool:
        """Whether a brick that has come to the rest is carried, and was while it was pressed."""
        press = self.press_on([b], way, rest)
        return self.stands(present, held) and self.stands(present, held, press)

    def press_on(self, group: list[int], way: Way, rest: np.ndarray) -> Push:
        """The press that brings some bricks home on what is there: over the middle of their knobs.

        Whoever presses chooses where; a hand or a gripper does that without tilting the brick.
        """
        most, chosen, total, where = -1.0, group[0], 0.0, np.zeros(2)
        for b in group:
            own = 0.0
            for other in self.lower[b] if way == "above" else self.upper[b]:
                if rest[other] if other != GROUND else True:
                    many, at = self.knobs[(other, b) if way == "above" else (b, other)]
                    own, total, where = own + many, total + many, where + many * at
            if own > most:
                most, chosen = own, b
        if total == 0:
            return self.middle(Push(chosen, 0.0, (0.0, 0.0)))
        x, y = (round(v, 9) for v in (where / total).tolist())
        return Push(chosen, self.press if way == "above" else -self.press, (x, y))

    def middle(self, push: Push) -> Push:
        """The same force at the middle of the brick."""
        x, y = self.blocks[push.block].centroid[:2].tolist()
        return push._replace(at=(round(x, 9), round(y, 9)))

    def way(self, group: list[int], present: np.ndarray) -> Way | None:
        """Along which way some bricks come off together."""
        rest = present.copy()
        rest[group] = False
        if not any(rest[self.over[b]].any() for b in group):
            return "above"
        based = self.based[group].any() or self.fixed[group].any()
        if self.help.hands and not based and not any(rest[self.under[b]].any() for b in group):
            return "below"
        return None

    def _meets(self, b: int, way: Way, rest: np.ndarray) -> bool:
        """Whether a brick meets knobs, or its knobs meet a brick, where it comes to."""
        others = self.lower[b] if way == "above" else self.upper[b]
        return any(m == GROUND or rest[m] for m in others)

    def loose(self, present: np.ndarray, held: np.ndarray) -> np.ndarray:
        """int64[n]: bricks that hang on nothing that stands."""
        count = len(present)
        a, b = self._pairs
        on = present[b] & ((a == count) | present[np.minimum(a, count - 1)])
        still = np.flatnonzero(present & (self.fixed | held))
        first = np.concatenate([a[on], np.full(len(still), count)])
        last = np.concatenate([b[on], still])
        graph = sp.coo_matrix((np.ones(len(first)), (first, last)), (count + 1, count + 1))
        piece = connected_components(graph, directed=False)[1]
        return np.flatnonzero(present & (piece[:count] != piece[count]))

    def _mates(self, block: int) -> list[int]:
        return [m for m in (*self.lower[block], *self.upper[block]) if m != GROUND]

    def stands(self, present: np.ndarray, held: np.ndarray, push: Push | None = None) -> bool:
        """Whether a state stands; answers are kept."""
        key = present.tobytes(), held.tobytes(), push
        if key not in self._known:
            self._known[key] = self._asked(present, held, push)
        return self._known[key]

    def _asked(self, present: np.ndarray, held: np.ndarray, push: Push | None) -> bool:
        """The answer of a program over not many more bricks than are there."""
        scope = self._scope
        few = len(scope) > _LARGE and present.sum() < _NARROW * len(scope)
        if few or present[scope].sum() != present.sum():
            self._scope = scope = np.flatnonzero(present if few else np.ones_like(present))
            some = replace(self.whole, blocks=tuple(self.blocks[k] for k in scope.tolist()))
            self._narrow = Balance(some, forces_of(some), self.sides)
        if push is not None:
            push = push._replace(block=int(np.searchsorted(scope, push.block)))
        return self._narrow.stands(present[scope], held[scope], push)
