"""In which order an arm presses bricks together, and how it holds each, found by taking them apart.

From the finished structure bricks are taken off upwards, one by one: the highest first, where what
is left stands, stood while the brick was pressed home, and the arm can bring it there among what is
left; order and grasp are chosen together. Where a brick cannot be pressed on alone, it is taken off
together with what it carries, or with all that is over it: that part is built beside, on the table,
and brought as one. Such a part is taken apart in the same manner, so it may have parts of its own:
what juts out step by step, and tips when it is pressed on out there, is built from its end inwards,
every part pressed on where the next brick stands on the table. Read backwards, that is an order of
building.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import AssemblyStep
from learn2assemble.assembly.bricks.lattice import GROUND
from learn2assemble.cell.arrange import Arranged, Hands, from_end_to_end, try_step, where_pressed
from learn2assemble.cell.bricks import BrickStates, BrickStructure
from learn2assemble.cell.workcell import ROOMS, Job, Offset, Progress, StepOf
from learn2assemble.cell.world import STANDING, WorkcellBlocks
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.sequence import depth_first
from learn2assemble.progress import Detail, silent

if TYPE_CHECKING:
    from learn2assemble.planning.plan import Plan

TRIES = 300, 10
"""Bricks taken off before the search gives up: so many, and so many for each one there is."""
MOST_BESIDE, MOST_PLACES, PLACES_WITHIN = 12, 6, 2
"""Bricks of a part that is built beside, places on the table that are tried for it, and for a part
of such a part."""
FIRM = 0.001
"""The centre of mass of what is built beside is over what stands on the table, and so far from the
edge of that at least [m]."""
TRIES_BESIDE = 200
"""Bricks taken off a part before it counts as one that cannot be built by itself."""
_NO_ORDER = "no order is known in which what stands before it bears that it is pressed home"
LEVEL = 1e-4
"""Bricks whose lowest points differ by less in height stand on one level [m]."""
APART, GRID = 0.05, 0.04
"""Between what is built beside and everything else, and between places that are tried [m]."""

OWN_SIDE = 0.1, 0.18
"""What one of two arms builds beside is so far on its own side of the middle, and rather farther
[m]: wrists are so wide."""


There = tuple[tuple[Offset | None, frozenset[int]], ...]
"""Bricks that stand, by how far from their places: None for the structure."""


class _Subassembly(NamedTuple):
    """What is taken apart: all, or a part that is built beside."""

    bricks: tuple[int, ...]
    states: BrickStates
    number: dict[int, int]
    """Of each brick in the states."""
    beside: Offset | None = None
    around: There = ()
    """What stands meanwhile, but of the part."""
    within: _Subassembly | None = None
    """What it is a part of."""

    def of(self, bricks: Iterable[int]) -> frozenset[int]:
        """The same bricks as the states number them."""
        return frozenset(self.number[b] for b in bricks)

    def loose(self, bricks: frozenset[int]) -> frozenset[int]:
        """Those of its bricks that hang on nothing that stands, if only these are there."""
        return frozenset(self.bricks[n] for n in self.states.loose(self.of(bricks)))


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
    for within, room in itertools.product((False, True), ROOMS):
        for one in arms:
            one.cell.apart = room
        search = _Disassembly(arms, structure, within, progress)
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
    """The plan of bricks in the order in which an arm brings them: what is built beside comes when
    all of it is brought."""
    assert plan.assembly is not None
    old = {step.block: step for step in plan.steps}
    came = {k: n for n, step in enumerate(steps) for k in (step.block, *step.group)}
    order = sorted((step for step in steps if not step.group), key=lambda step: came[step.block])
    made = tuple(
        replace(
            old[step.block],
            step=number,
            coverage=round(number / len(order), 6),
            way="above" if step.beside is None else "beside",
        )
        for number, step in enumerate(order, 1)
    )
    ids = [block.id for block in plan.assembly.blocks]
    told = [AssemblyStep(place=ids[s.block], way="beside" if s.beside else None) for s in order]
    return replace(plan, steps=made, assembly=replace(plan.assembly, steps=tuple(told)))


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
    (:class:`~learn2assemble.planning.sequence.OrderRules`).

    Args:
        part: that is taken apart.
        removals: what may be taken off where some of it is there.
        tries: bricks that are taken off before the search gives up.
    """

    patient = True

    def __init__(
        self,
        part: _Subassembly,
        removals: Callable[[_Subassembly, frozenset[int]], Iterator[_TakenOff]],
        tries: int,
    ) -> None:
        self.part, self.removals, self.tries = part, removals, tries
        self.first = _TakenOff(frozenset(part.bricks), ())

    def moves(self, last: _TakenOff) -> Iterator[_TakenOff]:
        return self.removals(self.part, last.present)

    def settled(self, move: _TakenOff) -> _TakenOff:
        return move

    def key(self, move: _TakenOff) -> frozenset[int]:
        return move.present

    def left(self, move: _TakenOff) -> tuple[int, int]:
        return len(move.present), 0


class _Disassembly:
    """What arms can take off, and bring back.

    Args:
        within: whether what is built beside may have parts of its own.
    """

    def __init__(
        self, arms: Sequence[Hands], structure: BrickStructure, within: bool, progress: Progress
    ) -> None:
        self.arms, self.structure, self.progress = arms, structure, progress
        self.within = within
        self.worlds = [WorkcellBlocks(one.job) for one in arms]
        self._waits = [(world.pose.copy(), list(world.state)) for world in self.worlds]
        low = np.array([piece.extent[0] for piece in arms[0].job.pieces])
        away = _order_in_a_level(low[:, :2], [one.job.base for one in arms])
        self.rank = np.lexsort((away, -low[:, 2].round(4))).tolist()
        self.why: dict[int, str] = {}
        """By brick, why the arm cannot bring it, as was last found."""
        self.stuck: tuple[int, ...] = ()
        self._known: dict[tuple[Any, ...], bool] = {}
        self._tables: dict[tuple[int, ...], BrickStates] = {}
        """Of parts that are built beside."""
        self._alone: dict[tuple[int, ...], bool] = {}
        """Whether such a part can be built, whatever the arms reach."""
        self._firm: dict[tuple[tuple[int, ...], frozenset[int]], bool] = {}
        """Whether some of it stand on the table."""

    def take_apart(self, part: _Subassembly) -> list[StepOf] | None:
        """The steps of building a part, or None."""
        tell = self.progress if part.beside is None else silent
        tries = TRIES[0] + TRIES[1] * len(part.bricks)
        order = depth_first(
            _Removals(part, self.removals, tries),
            Clock(math.inf),
            lambda text: tell(Detail(f"an order the arm can reach: {text}")),
        )
        if order.complete:
            return [step for one in reversed(order.path) for step in one.steps]
        if part.beside is None:
            self.stuck = tuple(sorted(order.last.present))
        return None

    def removals(self, part: _Subassembly, present: frozenset[int]) -> Iterator[_TakenOff]:
        """What may be taken off and brought by an arm: alone, then with what it carries."""
        for group in self._groups(part, present):
            rest = present - group
            if len(group) > 1:
                yield from self._beside(part, group, rest)
                continue
            step = StepOf(next(iter(group)), beside=part.beside)
            if self._fits(step, (*part.around, (part.beside, rest))):
                yield _TakenOff(rest, (step,))

    def _groups(self, part: _Subassembly, present: frozenset[int]) -> Iterator[frozenset[int]]:
        """What may be taken off, whatever the arms reach: one brick, then several."""
        over, covered = [set(a.tolist()) for a in self.structure.states.mates.over], list[int]()
        for b in (b for b in self.rank if b in present):
            if over[b] & present or part.loose(present - {b}):
                covered.append(b)
            elif self._pressed(part, (b,), present - {b}):
                yield frozenset({b})
        if not (self.within or part.states is self.structure.states):
            return
        tried = {frozenset({b}) for b in present}
        hanging = (frozenset({b, *part.loose(present - {b})}) for b in covered)
        over_it = (self._over(part, b, present) for b in covered)
        # What stands on others, too, is brought with a brick only where nothing else goes on.
        for groups in (hanging, over_it):
            for group in sorted(groups, key=len):
                rest = present - group
                free = not any(over[g] & rest for g in group)
                if group not in tried and rest and free and len(group) <= MOST_BESIDE:
                    tried.add(group)
                    if self._pressed(part, tuple(sorted(group)), rest) and self._made(group):
                        yield group

    def _made(self, group: frozenset[int]) -> bool:
        """Whether a part can be built beside, whatever the arms reach."""
        bricks = tuple(sorted(group))
        if bricks not in self._alone:
            part = self._part(bricks)

            def removals(part: _Subassembly, present: frozenset[int]) -> Iterator[_TakenOff]:
                return (_TakenOff(present - one, ()) for one in self._groups(part, present))

            self._alone[bricks] = self._stands(part, frozenset(bricks)) and (
                depth_first(_Removals(part, removals, TRIES_BESIDE), Clock(math.inf)).complete
            )
        return self._alone[bricks]

    def _part(
        self,
        bricks: tuple[int, ...],
        beside: Offset | None = None,
        around: There = (),
        within: _Subassembly | None = None,
    ) -> _Subassembly:
        """Bricks that are built beside."""
        if bricks not in self._tables:
            self._tables[bricks] = self.structure.states.on_table(bricks)
        number = {b: n for n, b in enumerate(bricks)}
        return _Subassembly(bricks, self._tables[bricks], number, beside, around, within)

    def _over(self, part: _Subassembly, b: int, present: frozenset[int]) -> frozenset[int]:
        """A brick with all that is over it, and what hangs on that."""
        over, group, more = self.structure.states.mates.over, frozenset[int](), frozenset({b})
        while more:
            group |= more
            above = {k for g in group for k in over[g].tolist()} & present
            more = frozenset({*above, *part.loose(present - group)}) - group
        return group

    def _pressed(self, part: _Subassembly, group: tuple[int, ...], rest: frozenset[int]) -> bool:
        """Whether what is left stands, and what comes to it, also while that is pressed home."""
        states, left = part.states, part.of(rest)
        own = tuple(part.number[b] for b in group)
        if not any(a == GROUND or a in left for b in own for a in states.mates.lower[b]):
            return False
        if left and not self._stands(part, rest):
            return False
        return states.stands(left | set(own)) and states.stands_pressed(own, left)

    def _stands(self, part: _Subassembly, bricks: frozenset[int]) -> bool:
        """Whether some of a part stand; on a table, where nothing grips them, not on an edge."""
        states, own = part.states, part.of(bricks)
        if states is self.structure.states:
            return states.stands(own)
        key = part.bricks, own
        if key not in self._firm:
            self._firm[key] = states.stands(own) and self._firmly(bricks)
        return self._firm[key]

    def _firmly(self, bricks: frozenset[int]) -> bool:
        """See :data:`FIRM`."""
        import shapely

        pieces = [self.arms[0].job.pieces[b] for b in bricks]
        ground = min(float(piece.extent[0][2]) for piece in pieces)
        under = [piece.face() for piece in pieces if piece.extent[0][2] < ground + LEVEL]
        mass = np.array([piece.mass for piece in pieces])
        middle = np.array([piece.target for piece in pieces])
        at = shapely.Point((mass @ middle / mass.sum())[:2])
        return bool(shapely.union_all(under).convex_hull.buffer(-FIRM).contains(at))

    def _beside(
        self, part: _Subassembly, group: frozenset[int], rest: frozenset[int]
    ) -> Iterator[_TakenOff]:
        """Bricks that are built beside and brought together."""
        bricks = tuple(sorted(group))
        around = *part.around, (part.beside, rest)
        holders = [
            g
            for g in self.rank
            if g in group and part.states.stands(part.of(group), part.number[g])
        ]
        holders.sort(key=lambda g: self._lever(g, bricks, rest))
        for place in self._places(bricks, part):
            own = self._part(bricks, place, around, part)
            for g in holders:
                others = tuple(b for b in bricks if b != g)
                step = StepOf(g, beside=part.beside, group=others, whence=place)
                if not self._fits(step, (*around, (place, group))):
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

    def _places(self, bricks: tuple[int, ...], part: _Subassembly) -> Iterator[Offset]:
        """Where on the table some bricks of a part may be built: between two arms some on the side
        of one of them, then the nearest places."""
        import shapely
        from shapely.affinity import translate

        jobs = [one.job for one in self.arms]
        pieces = jobs[0].pieces
        lying = [pieces[k].face() for k in range(len(pieces))]
        lying += [source.area for job in jobs for source in job.sources]
        most, outer = MOST_PLACES, part
        while outer.beside is not None and outer.within is not None:
            x, y, _ = outer.beside
            lying += [translate(pieces[k].face(), x, y) for k in outer.bricks]
            most, outer = PLACES_WITHIN, outer.within
        taken = shapely.union_all(lying).buffer(APART)
        face = shapely.union_all([pieces[b].face() for b in bricks])
        ground = min(float(pieces[b].extent[0][2]) for b in bricks)
        middle = np.array([face.centroid.x, face.centroid.y])
        steps = np.arange(-15, 16) * GRID
        shifts = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
        there = np.array([np.linalg.norm(middle + shifts - job.base, axis=1) for job in jobs])
        shifts = shifts[(there > 0.3).all(0) & (there < 0.65).any(0)]
        shifts = shifts[np.argsort(np.linalg.norm(shifts, axis=1), kind="stable")]
        free = [s for s in shifts.round(6).tolist() if not translate(face, *s).intersects(taken)]
        if len(jobs) == 2:
            side = _on_own_side(middle, jobs, middle + np.array(free).reshape(-1, 2))
            own = np.argsort(-side.clip(*OWN_SIDE), kind="stable")[: most // 2].tolist()
            free = [free[k] for k in dict.fromkeys([*own, *range(len(free))])]
        yield from ((x, y, -ground) for x, y in free[:most])

    # ------------------------------------------------------------ the arm

    def _fits(self, step: StepOf, there: There) -> bool:
        """Whether an arm can do a step when some bricks stand."""
        key = step, there
        if key not in self._known:
            arms = range(len(self.arms))
            self._known[key] = any(self._reached(number, step, there) for number in arms)
        return self._known[key]

    def _reached(self, number: int, step: StepOf, there: There) -> bool:
        """Whether one of the arms can."""
        world, standing = self.worlds[number], set[int]()
        pose, state = self._waits[number]
        world.pose[:], world.state[:] = pose, state
        world.beside[:] = 0.0
        if step.beside is not None and not step.group:
            world.beside[step.block] = step.beside
        for beside, bricks in there:
            standing |= bricks
            for k in bricks:
                world.beside[k] = beside or 0.0
                world.pose[k], world.state[k] = world.target(k), STANDING
        press = where_pressed(self.structure, world, step, standing)
        why = try_step(world, self.arms[number].cell, step, press=press)
        if why is not None:
            self.why[step.block] = why
        return why is None


def _on_own_side(part: np.ndarray, jobs: Sequence[Job], there: np.ndarray) -> np.ndarray:
    """float64[k]: how far places on the table are on the side of the arm that builds from the end
    of the structure at which a part is, so that the other arm may build another part meanwhile [m].

    Args:
        part: float64[2], middle of the part in its place [m].
        jobs: of both arms.
        there: float64[k, 2], of the places [m].
    """
    first, second = (job.base for job in jobs)
    way = (second - first) / max(float(np.linalg.norm(second - first)), 1e-9)
    ends = np.array([piece.extent for piece in jobs[0].pieces])[..., :2]
    middle = (ends[:, 0].min(0) + ends[:, 1].max(0)) / 2
    end = (part - middle) @ from_end_to_end(jobs[0]) > 1e-6
    return (there - (first + second) / 2) @ (way if end else -way)
