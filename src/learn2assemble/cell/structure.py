"""What rests on what in a structure that is built or taken apart, and what of it stands."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from learn2assemble.cell.workcell import DOWN, Direction, Job, Offset, StepOf
from learn2assemble.cell.world import Rows, WorkcellBlocks, direction_of
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.clearance import ways_out
from learn2assemble.robot.studs import Studs
from learn2assemble.statics.proofs import BED, TIGHT
from learn2assemble.statics.states import State

if TYPE_CHECKING:
    from learn2assemble.assembly.contacts import Contacts
    from learn2assemble.statics.laws import ByLoads

LEANING = 0.02
"""A joint leans where the height of its normal is neither 0 nor 1 by more."""
STEEP_JOINT = 0.9
"""Where the height of its normal is less, a block does not come straight down on a joint."""
LOW_WAY, MORE_WAYS = 0.3, 2
"""Height of the directions from which a block may come, at least, and how many further ones are
tried where blocks lean."""
OPENING = 0.15
"""A block that leans and comes beside others comes on a way that leads so far away from all of them
for each length of it, if one does, the most upright one: straight down it slides along them."""


class Structure:
    """What rests on what, and whether a state stands.

    Args:
        job: its assembly is proven.
    """

    job: Job
    contacts: Contacts
    leans: bool

    def __init__(self, job: Job) -> None:
        from learn2assemble.assembly.contacts import add_point_contacts, find_contacts
        from learn2assemble.planning.rebuilding.changeover import overlapping
        from learn2assemble.statics.rigid_blocks import bed_patches

        self.job, self.contacts = job, find_contacts(job.assembly)
        self.lying: Contacts = self.contacts.only(bed_patches(self.contacts))
        count = len(job.pieces)
        self.overlaps: list[frozenset[int]] = [frozenset()] * count
        """Of each piece, those in whose places it is, too: of what goes before it comes."""
        if job.standing:
            self.overlaps = overlapping(job.assembly.blocks)
        self.below: list[set[int]] = [set() for _ in range(count)]
        self.above: list[set[int]] = [set() for _ in range(count)]
        self._there = _stood_before(job)
        self._take_up()
        last = {*job.there, *(step.block for step in job.steps)} - {
            step.block for step in job.steps if step.remove
        }
        if self._pressing(frozenset(last)) is None:
            # Edges and points carry.
            self.contacts = add_point_contacts(job.assembly, self.contacts)
            self._take_up()
            self.leans = True
        standing = set(job.there)
        self._proven = {frozenset(standing)}
        for step in job.steps:
            standing = standing - {step.block} if step.remove else standing | {step.block}
            self._proven.add(frozenset(standing))

    def _take_up(self) -> None:
        """Take up what rests on what, and whether anything leans.

        A block rests on what stands when the plan places it: what touches it from below and comes
        later, as a post for what comes next, or is gone by then, is nothing that it waits for.
        """
        ends = zip(self.contacts.a.tolist(), self.contacts.b.tolist(), strict=True)
        self.leans = False
        for (a, b), up in zip(ends, self.contacts.normal[:, 2].tolist(), strict=True):
            if abs(up) <= LEANING:
                continue
            self.leans = self.leans or abs(up) < 1 - LEANING
            lower, upper = (int(a), int(b)) if up > 0 else (int(b), int(a))
            if lower >= 0 and upper >= 0 and lower in self._there[upper]:
                self.below[upper].add(lower)
                self.above[lower].add(upper)

    def ways_in(self, block: int, standing: set[int]) -> tuple[Direction, ...]:
        """Unit vectors along which a block may come to its place, the best ones first: straight
        down, or at right angles to the joints on which it comes to lean where these are steep;
        where blocks lean also others that lead away from all it touches."""
        return ways_in(self.contacts, block, standing) if self.leans else (DOWN,)

    def stands(self, standing: frozenset[int]) -> bool:
        """Whether these pieces stand without the others, by the proof of the plan or another."""
        if standing not in self._proven and (
            self._loads.stands(self._state(standing)) or self._pressing(standing) is not None
        ):
            self._proven.add(standing)
        return standing in self._proven

    def takes(self, step: StepOf, standing: frozenset[int], world: WorkcellBlocks) -> bool:
        """Whether what stands bears that a block comes to it or is taken away: everything stands
        then, and while a block is set down.

        Args:
            step: which does so.
            standing: pieces in their places, some of which may not be there yet in the world.
            world: which of them are built beside now.
        """
        moved = {step.block}
        return self.stands(standing - moved if step.remove else standing | moved)

    def made_by(self, block: int, world: WorkcellBlocks) -> set[tuple[int, int]]:
        """The joints of studs that come home when a block is placed, as
        :attr:`WorkcellBlocks.home` has them."""
        return set()

    def proof(self, standing: frozenset[int]) -> tuple[str, float] | None:
        """What shows that these pieces stand without the others, and the sideways acceleration
        in every direction [g] that they withstand; None where nothing shows it.

        States that are asked for in the order of a build are proven from one another.
        """
        from learn2assemble.statics.forces.equilibrium import margin

        state = self._state(standing)
        if self._loads.stands(state):
            shown = self._loads.report(state)
            if shown.margin_g:
                return shown.proof, shown.margin_g
        pressing = self._pressing(standing)
        if pressing is None:
            return None
        worth = margin(self.job.assembly, pressing, self.job.friction, present=state.present)
        return BED if pressing is self.lying else TIGHT, worth

    def _pressing(self, standing: frozenset[int]) -> Contacts | None:
        """The joints whose forces can hold these pieces: horizontal ones alone, or all."""
        from learn2assemble.statics.forces.equilibrium import solve

        present = self._state(standing).present
        for contacts in (self.lying, self.contacts.known(self.job.friction)):
            if solve(self.job.assembly, contacts, self.job.friction, present=present).stands:
                return contacts
        return None

    def _state(self, standing: frozenset[int]) -> State:
        present = np.zeros(len(self.job.pieces), bool)
        present[list(standing)] = True
        return State(present, np.zeros_like(present))

    @cached_property
    def _loads(self) -> ByLoads:
        """Loads passed down through level joints: enough for most states, and much faster than
        programs over all blocks."""
        from learn2assemble.statics.laws import ByLoads

        # No clock: what is proven must not depend on it.
        clock = Clock(math.inf)
        return ByLoads.of_contacts(self.job.assembly, self.lying, self.job.friction, clock)

    def joints_of(
        self,
        world: WorkcellBlocks,
        rows: Rows,
        placing: bool,
        group: tuple[int, ...] = (),
        to: Offset = (0.0, 0.0, 0.0),
    ) -> Studs | None:
        """The joints of studs of a scene, in its rows; None: there are no studs."""
        return None

    def studs(self) -> Studs | None:
        """All joints of studs, whose cells are pieces; None: there are none."""
        return None

    def loose(self, block: int, world: WorkcellBlocks) -> bool:
        """Whether a block in its place is not pressed home."""
        return False

    def press_at(
        self, block: int, group: tuple[int, ...], standing: set[int]
    ) -> tuple[float, float] | None:
        """Where a block that comes to its place, perhaps with others, is pressed home, x and y from
        its own middle [m]; None: it is not pressed."""
        return None

    def loads(self, block: int, standing: set[int]) -> list[int]:
        """Pieces among ``standing`` that rest on a piece, directly or not, the topmost first."""
        found, queue = list[int](), [block]
        for one in queue:
            for upper in sorted(self.above[one] & standing):
                if upper not in found:
                    found.append(upper)
                    queue.append(upper)
        return sorted(found, key=lambda k: -self.job.pieces[k].target[2])


def _stood_before(job: Job) -> dict[int, frozenset[int]]:
    """By block, what stands when it is placed, or before the first step where it does, too."""
    standing = frozenset(job.there)
    found = dict.fromkeys(standing, standing)
    for step in job.steps:
        if step.remove:
            standing -= {step.block}
        else:
            found.setdefault(step.block, standing)
            standing |= {step.block}
    return found


def ways_in(faces: Contacts, block: int, standing: set[int]) -> tuple[Direction, ...]:
    """The same of blocks that lean on one another at faces that touch."""
    touched = [
        normal if b == block else -normal
        for a, b, normal in zip(faces.a.tolist(), faces.b.tolist(), faces.normal, strict=True)
        if block in (a, b) and (a if b == block else b) in {*standing, -1}
    ]
    carried = [normal for normal in touched if normal[2] > LEANING]
    if not carried and all(normal[2] > -LEANING for normal in touched):
        return (DOWN,)
    normals, up = np.array(touched), np.array([0.0, 0.0, 1.0])
    best: list[np.ndarray] = []
    least = min((float(normal[2]) for normal in carried), default=1.0)
    if carried:
        mean = np.sum(carried, axis=0)
        best = [mean / np.linalg.norm(mean), up]
        if least > STEEP_JOINT:
            best.reverse()
        best = [way for way in best if way is up or (normals @ way).min() > -1e-6]
    # What nothing carries, as it is held, comes past what hangs over it.
    others = ways_out(normals)
    others = others[others[:, 2] > LOW_WAY]
    room = (others @ normals.T).min(1)
    roomy = others[np.argsort(-room, kind="stable")[:MORE_WAYS]]
    beside = (np.abs(normals[:, 2]) <= LEANING).any() and least < 1 - LEANING
    best = [*others[room > OPENING][:1], *roomy, *best] if beside else [*best, *roomy]
    return tuple(direction_of(-way) for way in best)
