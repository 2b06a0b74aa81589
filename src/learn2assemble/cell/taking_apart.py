"""In which order an arm presses bricks together, and how it holds each, found by taking them apart.

From the finished structure bricks are taken off upwards, one by one: the highest first, where what
is left stands, stood while the brick was pressed home, and the arm can bring it there among what is
left; order and grasp are chosen together. Where a brick cannot be pressed on alone, it is taken off
together with what it carries, or with all that is over it: that part is built beside, on the table,
and brought as one. Read backwards, that is an order of building.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from learn2assemble.assembly.bricks.lattice import GROUND
from learn2assemble.cell.arrange import Arranged, Hands, try_step, where_pressed
from learn2assemble.cell.bricks import BrickStates, BrickStructure
from learn2assemble.cell.workcell import ROOMS, Offset, Progress, StepOf
from learn2assemble.cell.world import STANDING, WorkcellBlocks
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.sequence import depth_first
from learn2assemble.progress import Detail, silent

if TYPE_CHECKING:
    from learn2assemble.planning.plan import Plan

TRIES = 300, 10
"""Bricks taken off before the search gives up: so many, and so many for each one there is."""
MOST_BESIDE, MOST_PLACES = 12, 6
"""Bricks of a part that is built beside, and places on the table that are tried for it."""
_NO_ORDER = "no order is known in which what stands before it bears that it is pressed home"
APART, GRID = 0.05, 0.04
"""Between what is built beside and everything else, and between places that are tried [m]."""


class _Subassembly(NamedTuple):
    """What is taken apart: all, or a part that is built beside."""

    bricks: tuple[int, ...]
    states: BrickStates
    number: dict[int, int]
    """Of each brick in the states."""
    beside: Offset | None = None
    rest: frozenset[int] = frozenset()
    """What stands in the structure meanwhile."""

    def of(self, bricks: frozenset[int]) -> frozenset[int]:
        """The same bricks as the states number them."""
        return frozenset(self.number[b] for b in bricks)


class _TakenOff(NamedTuple):
    """A state after something was taken off, and the steps that put it there."""

    present: frozenset[int]
    steps: tuple[StepOf, ...]


def arrange_bricks(
    arms: Sequence[Hands],
    structure: BrickStructure,
    progress: Progress = lambda text: None,
) -> Arranged:
    """The first order in which one of the arms presses every brick home; else why there is none.

    Args:
        arms: of one cell, who build the same pieces.
        structure: of these.
    """
    every = tuple(range(len(arms[0].job.pieces)))
    part = _Subassembly(every, structure.states, {k: k for k in every})
    search = None
    for room in ROOMS:
        for one in arms:
            one.cell.apart = room
        search = _Disassembly(arms, structure, progress)
        steps = search.take_apart(part)
        if steps is not None:
            break
    else:
        assert search is not None
        told = sorted(search.stuck, key=lambda k: k not in search.why)
        stuck = {k: search.why.get(k, _NO_ORDER) for k in told}
        return Arranged((), stuck or dict.fromkeys(every, "it falls"))
    return Arranged(tuple(steps), {})


def plan_in_order(plan: Plan, steps: tuple[StepOf, ...]) -> Plan:
    """The plan of bricks in the order in which an arm brings them."""
    old = {step.block: step for step in plan.steps}
    order = [step for step in steps if not step.group]
    made = tuple(
        replace(
            old[step.block],
            step=number,
            coverage=round(number / len(order), 6),
            way="above" if step.beside is None else "beside",
        )
        for number, step in enumerate(order, 1)
    )
    return replace(plan, steps=made)


def _order_in_a_level(low: np.ndarray, bases: Sequence[np.ndarray]) -> np.ndarray:
    """float64[B]: of bricks of one height, those with less are taken off first: those near to one
    arm, which builds from the far side to the near one; those in the middle between two arms' ends
    of the structure, as each builds from its own.

    Args:
        low: float64[B, 2], corners of the bricks [m].
        bases: float64[2] of each arm [m].
    """
    if len(bases) == 1:
        return np.linalg.norm(low - bases[0], axis=1).round(4)
    way = bases[1] - bases[0]
    across = np.array([-way[1], way[0]]) / max(float(np.linalg.norm(way)), 1e-9)
    along = low @ across
    return np.abs(along - (along.min() + along.max()) / 2).round(4)


class _Removals:
    """What is taken off next of a part; rules of a search
    (:class:`~learn2assemble.planning.sequence.OrderRules`)."""

    patient = True

    def __init__(self, arm: _Disassembly, part: _Subassembly) -> None:
        self.arm, self.part, start = arm, part, frozenset(part.bricks)
        self.first, self.tries = _TakenOff(start, ()), TRIES[0] + TRIES[1] * len(start)

    def moves(self, last: _TakenOff) -> Iterator[_TakenOff]:
        return self.arm.removals(self.part, last.present)

    def settled(self, move: _TakenOff) -> _TakenOff:
        return move

    def key(self, move: _TakenOff) -> frozenset[int]:
        return move.present

    def left(self, move: _TakenOff) -> tuple[int, int]:
        return len(move.present), 0


class _Disassembly:
    """What arms can take off, and bring back."""

    def __init__(
        self, arms: Sequence[Hands], structure: BrickStructure, progress: Progress
    ) -> None:
        self.arms, self.structure, self.progress = arms, structure, progress
        self.worlds = [WorkcellBlocks(one.job) for one in arms]
        self._waits = [(world.pose.copy(), list(world.state)) for world in self.worlds]
        low = np.array([piece.extent[0] for piece in arms[0].job.pieces])
        away = _order_in_a_level(low[:, :2], [one.job.base for one in arms])
        self.rank = np.lexsort((away, -low[:, 2].round(4))).tolist()
        self.why: dict[int, str] = {}
        """By brick, why the arm cannot bring it, as was last found."""
        self.stuck: tuple[int, ...] = ()
        self._known: dict[tuple[Any, ...], bool] = {}

    def take_apart(self, part: _Subassembly) -> list[StepOf] | None:
        """The steps of building a part, or None."""
        tell = self.progress if part.beside is None else silent
        order = depth_first(
            _Removals(self, part),
            Clock(math.inf),
            lambda text: tell(Detail(f"an order the arm can reach: {text}")),
        )
        if order.complete:
            return [step for one in reversed(order.path) for step in one.steps]
        if part.beside is None:
            self.stuck = tuple(sorted(order.last.present))
        return None

    def removals(self, part: _Subassembly, present: frozenset[int]) -> Iterator[_TakenOff]:
        """What may be taken off: alone, then with what it carries."""
        over, covered = [set(a.tolist()) for a in self.structure.states.mates.over], list[int]()
        for b in (b for b in self.rank if b in present):
            rest = present - {b}
            loose = part.states.loose(part.of(rest))
            if over[b] & present or loose:
                covered.append(b)
            elif self._pressed(part, (b,), rest):
                step = StepOf(b, beside=part.beside)
                if self._fits(step, rest, part):
                    yield _TakenOff(rest, (step,))
        if part.beside is not None:
            return
        tried = {frozenset({b}) for b in present}
        hanging = (frozenset({b, *part.states.loose(present - {b})}) for b in covered)
        over_it = (self._over(part, b, present) for b in covered)
        # What stands on others, too, is brought with a brick only where nothing else goes on.
        for groups in (hanging, over_it):
            for group in sorted(groups, key=len):
                rest = present - group
                free = not any(over[g] & rest for g in group)
                if group not in tried and rest and free and len(group) <= MOST_BESIDE:
                    tried.add(group)
                    yield from self._beside(part, group, rest)

    def _over(self, part: _Subassembly, b: int, present: frozenset[int]) -> frozenset[int]:
        """A brick with all that is over it, and what hangs on that."""
        over, group, more = self.structure.states.mates.over, frozenset[int](), frozenset({b})
        while more:
            group |= more
            above = {k for g in group for k in over[g].tolist()} & present
            more = frozenset({*above, *part.states.loose(present - group)}) - group
        return group

    def _pressed(self, part: _Subassembly, group: tuple[int, ...], rest: frozenset[int]) -> bool:
        """Whether what is left stands, and what comes to it, also while that is pressed home."""
        states, left = part.states, part.of(rest)
        own = tuple(part.number[b] for b in group)
        if not any(a == GROUND or a in left for b in own for a in states.mates.lower[b]):
            return False
        if left and not states.stands(left):
            return False
        return states.stands(left | set(own)) and states.stands_pressed(own, left)

    def _beside(
        self, part: _Subassembly, group: frozenset[int], rest: frozenset[int]
    ) -> Iterator[_TakenOff]:
        """Bricks that are built beside and brought together."""
        if not self._pressed(part, tuple(sorted(group)), rest):
            return
        bricks = tuple(sorted(group))
        table = self.structure.states.on_table(bricks)
        if not table.need.stands:
            return
        holders = [g for g in self.rank if g in group and part.states.stands(group, g)]
        holders.sort(key=lambda g: self._lever(g, bricks, rest))
        for place in self._places(bricks, rest):
            own = _Subassembly(bricks, table, {b: n for n, b in enumerate(bricks)}, place, rest)
            for g in holders:
                step = StepOf(g, group=tuple(b for b in bricks if b != g))
                if not self._fits(step, rest, own):
                    continue
                steps = self.take_apart(own)
                if steps is not None:
                    yield _TakenOff(rest, (*steps, step))
                    return
                break

    def _lever(self, g: int, bricks: tuple[int, ...], rest: frozenset[int]) -> float:
        """How far a brick by which others are brought is from where they are pressed [m]."""
        others = tuple(b for b in bricks if b != g)
        at = self.structure.press_at(g, others, set(rest))
        return 0.0 if at is None else round(math.hypot(*at), 3)

    def _places(self, bricks: tuple[int, ...], rest: frozenset[int]) -> Iterator[Offset]:
        """Where on the table some bricks may be built, the nearest places first."""
        import shapely

        jobs = [one.job for one in self.arms]
        pieces = jobs[0].pieces
        lying = [pieces[k].face() for k in range(len(pieces))]
        lying += [source.area for job in jobs for source in job.sources]
        taken = shapely.union_all(lying).buffer(APART)
        face = shapely.union_all([pieces[b].face() for b in bricks])
        ground = min(float(pieces[b].extent[0][2]) for b in bricks)
        middle = np.array([face.centroid.x, face.centroid.y])
        steps = np.arange(-15, 16) * GRID
        shifts = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
        there = np.array([np.linalg.norm(middle + shifts - job.base, axis=1) for job in jobs])
        shifts = shifts[(there > 0.3).all(0) & (there < 0.65).any(0)]
        shifts = shifts[np.argsort(np.linalg.norm(shifts, axis=1), kind="stable")]
        found = 0
        for x, y in shifts.round(6).tolist():
            if not shapely.affinity.translate(face, x, y).intersects(taken):
                yield x, y, -ground
                found += 1
                if found >= MOST_PLACES:
                    return

    # ------------------------------------------------------------ the arm

    def _fits(self, step: StepOf, rest: frozenset[int], part: _Subassembly) -> bool:
        """Whether an arm can do a step when ``rest`` stands: of the structure, or, where a part is
        built beside, of that."""
        staged = frozenset[int]()
        standing = rest
        if part.beside is not None:
            staged = frozenset(part.bricks) if step.group else rest
            standing = part.rest
        key = step, standing, staged, part.beside
        if key not in self._known:
            self._known[key] = any(
                self._reached(number, step, standing, staged, part.beside)
                for number in range(len(self.arms))
            )
        return self._known[key]

    def _reached(
        self,
        number: int,
        step: StepOf,
        standing: frozenset[int],
        staged: frozenset[int],
        beside: Offset | None,
    ) -> bool:
        """Whether one of the arms can."""
        world = self.worlds[number]
        pose, state = self._waits[number]
        world.pose[:], world.state[:] = pose, state
        world.beside[:] = 0.0
        for k in staged:
            world.beside[k] = beside or 0.0
        if step.beside is not None:
            world.beside[step.block] = step.beside
        for k in standing | staged:
            world.pose[k], world.state[k] = world.target(k), STANDING
        press = where_pressed(self.structure, world, step, standing | staged)
        why = try_step(world, self.arms[number].cell, step, press=press)
        if why is not None:
            self.why[step.block] = why
        return why is None
