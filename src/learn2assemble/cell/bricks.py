"""Bricks that clutch, as an arm builds them: what is pressed on what, and whether a state stands.

A state is proven with the law of its joints, and again while a brick is pressed home
(:mod:`learn2assemble.statics.holding`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.bricks.lattice import GROUND, StudLattice, grip
from learn2assemble.cell.workcell import STANDING, Job, Rows, Structure, WorkcellBlocks
from learn2assemble.errors import InputError
from learn2assemble.robot.studs import StudJoint, Studs
from learn2assemble.statics.holding import Push
from learn2assemble.statics.holding_check import stands_by_joints
from learn2assemble.statics.proofs import CLUTCH, CLUTCH_TIGHT


class Knobs(NamedTuple):
    """A joint of two bricks."""

    count: int
    middle: tuple[float, float]
    """Of its knobs in the structure [m]."""


class BrickStates:
    """Answers whether states of bricks stand, also while they are pressed; answers are kept.

    Args:
        assembly: bricks on a lattice of studs whose joints clutch.

    Raises:
        InputError: for joints of several laws, and for blocks that are no bricks on one lattice.
    """

    def __init__(self, assembly: Assembly) -> None:
        joint = assembly.joint
        if joint.law != "clutch" or assembly.joints:
            raise InputError("joints", "several laws", "one clutch for all, for an arm")
        self.assembly, self.joint = assembly, joint
        found = stands_by_joints(assembly)
        self.need, self.tight, self.balance = found.need, found.tight, found.balance
        self.lattice = lattice = StudLattice(assembly.blocks, joint.pitch)
        self.count = count = len(assembly.blocks)
        self.lower: list[set[int]] = [set() for _ in range(count)]
        """Of each brick those it is pressed on, GROUND among them."""
        self.upper: list[set[int]] = [set() for _ in range(count)]
        self.knobs: dict[tuple[int, int], Knobs] = {}
        """By lower and upper brick."""
        clutches = lattice.clutches(ground=True)
        middle = (clutches.first + clutches.last) / 2 * joint.pitch[0] + lattice.offset[:2]
        many = (clutches.last - clutches.first).prod(1)
        for a, b, n, (x, y) in zip(
            clutches.lower.tolist(),
            clutches.upper.tolist(),
            many.tolist(),
            middle.tolist(),
            strict=True,
        ):
            self.knobs[a, b] = Knobs(n, (x, y))
            self.lower[b].add(a)
            if a != GROUND:
                self.upper[a].add(b)
        low, high = lattice.low, lattice.high
        meet = (low[:, None, :2] < high[None, :, :2]).all(2)
        meet &= (high[:, None, :2] > low[None, :, :2]).all(2)
        over = meet & (low[None, :, 2] >= high[:, None, 2])
        self.over = [set(np.flatnonzero(row).tolist()) for row in over]
        """Of each brick those that are above it, wherever."""
        self._known: dict[tuple[frozenset[int], int, Push | None], bool] = {}

    def stands(self, present: frozenset[int], held: int = GROUND, push: Push | None = None) -> bool:
        """Whether a state stands.

        Args:
            present: bricks that are there.
            held: one that a hand holds; none by default.
            push: a further force.
        """
        key = present, held, push
        if key not in self._known:
            there, fixed = np.zeros(self.count, bool), np.zeros(self.count, bool)
            there[list(present)] = True
            if held != GROUND:
                fixed[held] = True
            self._known[key] = self.balance.stands(there, fixed, push)
        return self._known[key]

    def stands_pressed(self, group: Iterable[int], rest: frozenset[int]) -> bool:
        """Whether bricks that come to the rest together are carried while they are pressed."""
        group = tuple(group)
        push = self.press_on(group, rest)
        return push is not None and self.stands(rest | set(group), GROUND, push)

    def press_on(self, group: tuple[int, ...], rest: frozenset[int]) -> Push | None:
        """The press that brings some bricks home on what is there: over the middle of their knobs,
        on the one with most of them. None where they meet no knobs."""
        most, chosen, total, where = 0, group[0], 0, np.zeros(2)
        for b in group:
            mates = [a for a in self.lower[b] if a in rest or a == GROUND]
            own = [self.knobs[a, b] for a in mates]
            count = sum(one.count for one in own)
            total += count
            where += sum((one.count * np.array(one.middle) for one in own), np.zeros(2))
            if count > most:
                most, chosen = count, b
        if not total:
            return None
        x, y = (round(v, 9) for v in (where / total).tolist())
        return Push(chosen, self.joint.press, (x, y))

    def loose(self, present: frozenset[int]) -> frozenset[int]:
        """Bricks that hang on nothing that stands."""
        reached = [b for b in present if GROUND in self.lower[b]]
        found = set(reached)
        for b in reached:
            for other in (*self.lower[b], *self.upper[b]):
                if other in present and other not in found:
                    found.add(other)
                    reached.append(other)
        return present - found

    def on_table(self, group: Iterable[int]) -> BrickStates:
        """The same of some bricks that stand on a table, where nothing grips them; they are
        numbered in the order in which they are given."""
        blocks = [self.assembly.blocks[k] for k in group]
        ground = min(float(block.vertices[:, 2].min()) for block in blocks)
        down = np.array([0.0, 0.0, ground])
        lowered = tuple(replace(block, vertices=block.vertices - down) for block in blocks)
        joint = replace(self.joint, base="table")
        return BrickStates(replace(self.assembly, blocks=lowered, steps=(), joint=joint))

    def proof(self) -> str:
        """What shows that its states stand."""
        return CLUTCH_TIGHT if self.tight else CLUTCH

    def stud_joint(self, lower: int, upper: int) -> StudJoint:
        """A joint of two bricks where they are in the structure, as a simulation takes it; its
        cells are the numbers of the bricks."""
        lattice, (stud, layer) = self.lattice, self.joint.pitch
        corner = lattice.low[upper, :2]
        first, last = corner, lattice.high[upper, :2]
        if lower != GROUND:
            first = np.maximum(first, lattice.low[lower, :2])
            last = np.minimum(last, lattice.high[lower, :2])
        (a, b), (x, y) = lattice.size[upper, :2].tolist(), (first - corner).tolist()
        found = grip(x, y, *(last - first).tolist(), (a, b))
        middle = np.array([a, b]) / 2
        unit = np.array([stud, stud, layer])
        at = lattice.offset + (lattice.low[upper] + lattice.size[upper] / 2) * unit
        if lower != GROUND:
            at = at - lattice.offset - (lattice.low[lower] + lattice.size[lower] / 2) * unit
        u, v = ((np.array(found.middle) - middle) * stud).tolist()
        return StudJoint(
            lower,
            upper,
            (float(at[0]), float(at[1]), float(at[2])),
            found.pull * self.joint.capacity,
            (u, v),
            tuple((float(p), float(q)) for p, q in (found.corners - middle) * stud),
            (_point((first - corner - middle) * stud), _point((last - corner - middle) * stud)),
            False,
        )


def _point(at: np.ndarray) -> tuple[float, float]:
    x, y = at.tolist()
    return x, y


class BrickStructure(Structure):
    """What is pressed on what, and whether a state stands.

    Args:
        job: its assembly is proven.

    Raises:
        InputError: as :class:`BrickStates`.
    """

    def __init__(self, job: Job) -> None:
        self.job, self.leans = job, False
        self.states = states = BrickStates(job.assembly.finished)
        self.below = [lower - {GROUND} for lower in states.lower]
        self.above = states.upper
        self._proven = {frozenset[int]()}
        self._joints = {
            pair: states.stud_joint(*pair)
            for pair in states.knobs
            if pair[0] != GROUND or states.joint.base == "grips"
        }

    def studs(self) -> Studs:
        """All joints of studs, whose cells are pieces."""
        return Studs(tuple(self._joints.values()), self.states.joint.press)

    def joints_of(
        self, world: WorkcellBlocks, rows: Rows, placing: bool, group: tuple[int, ...] = ()
    ) -> Studs:
        """The joints of a scene, in its rows.

        Args:
            rows: the scene, in which a brick waits, perhaps with what it brings along.
            placing: whether it comes to its place.
            group: what it brings along.
        """
        row = {k: n for n, k in enumerate(rows.owner.tolist()) if 0 <= k < self.states.count}
        moving = {int(rows.owner[-1]), *group, *rows.owner[rows.scene.num_placed :].tolist()}
        beside = world.beside.copy()
        if group:
            beside[list(moving)] = 0.0
        found = []
        for (a, b), joint in self._joints.items():
            there = [k for k in (a, b) if k != GROUND]
            if any(k not in row for k in there) or not all(
                k in moving or world.state[k] == STANDING for k in there
            ):
                continue
            home = (a, b) in world.home
            apart = beside[b].any() if a == GROUND else (beside[a] != beside[b]).any()
            if home or (placing and not apart):
                lower = GROUND if a == GROUND else row[a]
                found.append(joint._replace(lower=lower, upper=row[b], home=home))
        return Studs(tuple(found), self.states.joint.press)

    def press_at(
        self, block: int, group: tuple[int, ...], standing: set[int]
    ) -> tuple[float, float] | None:
        """Where a brick that comes to its place, perhaps with others, is pressed home, x and y from
        its own middle [m]; None: it is not pressed."""
        push = self.states.press_on((block, *group), frozenset(standing))
        if push is None:
            return None
        x, y = self.job.pieces[block].target[:2].tolist()
        return push.at[0] - x, push.at[1] - y

    def loose(self, block: int, world: WorkcellBlocks) -> bool:
        """Whether a brick in its place is pressed home on nothing that stands under it. One joint
        that has opened beside others is left: to take the brick off would open more."""
        own = [(a, block) for a in self.states.lower[block] if (a, block) in self._joints]
        there = [
            (a, b)
            for a, b in own
            if (not world.beside[b].any() if a == GROUND else world.together(b)[a])
            and (a == GROUND or world.state[a] == STANDING)
        ]
        return bool(there) and not any(pair in world.home for pair in there)

    def prove(self, standing: frozenset[int]) -> None:
        """A state that is known to stand, however."""
        self._proven.add(standing)

    def stands(self, standing: frozenset[int]) -> bool:
        """Whether these bricks stand without the others."""
        return standing in self._proven or self.states.stands(standing)

    def proof(self, standing: frozenset[int]) -> tuple[str, float] | None:
        """What shows that these bricks stand without the others, and the sideways acceleration in
        every direction [g] that they withstand; None where nothing shows it."""
        if not self.states.stands(standing):
            return None
        present = np.zeros(self.states.count, bool)
        present[list(standing)] = True
        return self.states.proof(), self.states.balance.margin_g(present)
