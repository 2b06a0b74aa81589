"""Bricks that clutch, as an arm builds them: what is pressed on what, and whether a state stands.

A state is proven with the law of its joints, and again while a brick is pressed home
(:class:`~learn2assemble.statics.laws.ByStrength`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.bricks.lattice import GROUND, grip
from learn2assemble.assembly.bricks.mates import BrickMates, Press
from learn2assemble.cell.structure import Structure
from learn2assemble.cell.workcell import Job, Offset, StepOf
from learn2assemble.cell.world import STANDING, Rows, WorkcellBlocks
from learn2assemble.robot.studs import StudJoint, Studs
from learn2assemble.statics.holding.check import stands_by_joints
from learn2assemble.statics.holding.program import Balance, Need, Push
from learn2assemble.statics.laws import ByStrength
from learn2assemble.statics.states import State

if TYPE_CHECKING:
    from learn2assemble.assembly.joints import Joint


class BrickStates:
    """Answers whether states of bricks stand, also while they are pressed.

    Args:
        assembly: bricks on a lattice of studs whose joints clutch.

    Raises:
        InputError: as :class:`~learn2assemble.assembly.bricks.mates.BrickMates`.
    """

    assembly: Assembly
    joint: Joint
    need: Need
    balance: Balance

    def __init__(self, assembly: Assembly) -> None:
        self.mates: BrickMates = BrickMates(assembly)
        self.assembly, self.joint = assembly, assembly.joint
        found = stands_by_joints(assembly)
        self.need, self.balance = found.need, found.balance
        self.law: ByStrength = ByStrength(assembly, found)

    def present(self, bricks: frozenset[int]) -> np.ndarray:
        """bool[B]: bricks that are there."""
        there = np.zeros(self.mates.count, bool)
        there[list(bricks)] = True
        return there

    def stands(self, present: frozenset[int], held: int = GROUND, push: Push | None = None) -> bool:
        """Whether a state stands.

        Args:
            present: bricks that are there.
            held: one that a hand holds; none by default.
            push: a further force.
        """
        hand = self.present(frozenset() if held == GROUND else frozenset({held}))
        return self.law.stands(State(self.present(present), hand), push=push)

    def stands_pressed(self, group: Iterable[int], rest: frozenset[int]) -> bool:
        """Whether bricks that come to the rest together are carried while they are pressed."""
        group = tuple(group)
        found = self.press_on(group, rest)
        push = Push(found.brick, self.joint.press, found.at)
        return bool(found.knobs) and self.stands(rest | set(group), GROUND, push)

    def press_on(self, group: tuple[int, ...], rest: frozenset[int]) -> Press:
        """Where some bricks are pressed home on what is there."""
        return self.mates.press(group, self.present(rest))

    def loose(self, present: frozenset[int]) -> frozenset[int]:
        """Bricks that hang on nothing that stands."""
        return frozenset(self.mates.loose(self.present(present)).tolist())

    def on_table(self, group: Iterable[int]) -> BrickStates:
        """The same of some bricks that stand on a table, where nothing grips them; they are
        numbered in the order in which they are given."""
        blocks = [self.assembly.blocks[k] for k in group]
        ground = min(float(block.vertices[:, 2].min()) for block in blocks)
        down = np.array([0.0, 0.0, ground])
        lowered = tuple(replace(block, vertices=block.vertices - down) for block in blocks)
        joint = replace(self.joint, base="table")
        return BrickStates(replace(self.assembly, blocks=lowered, steps=(), joint=joint))

    def stud_joint(self, lower: int, upper: int) -> StudJoint:
        """A joint of two bricks where they are in the structure, as a simulation takes it; its
        cells are the numbers of the bricks."""
        lattice, (stud, layer) = self.mates.lattice, self.joint.pitch
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

    job: Job
    leans: bool
    states: BrickStates

    def __init__(self, job: Job) -> None:
        self.job, self.leans = job, False
        self.states = states = BrickStates(job.assembly.finished)
        self.below: list[set[int]] = [set(lower) - {GROUND} for lower in states.mates.lower]
        self.above: list[set[int]] = [set(upper) for upper in states.mates.upper]
        self._apart: dict[tuple[int, ...], BrickStates] = {}
        """Of bricks that are built beside."""
        self._known: dict[tuple[Any, ...], bool] = {}
        self._joints = {
            pair: states.stud_joint(*pair)
            for pair in states.mates.knobs
            if pair[0] != GROUND or states.joint.base == "grips"
        }

    def studs(self) -> Studs:
        """All joints of studs, whose cells are pieces."""
        return Studs(tuple(self._joints.values()), self.states.joint.press)

    def joints_of(
        self,
        world: WorkcellBlocks,
        rows: Rows,
        placing: bool,
        group: tuple[int, ...] = (),
        to: Offset = (0.0, 0.0, 0.0),
    ) -> Studs:
        """The joints of a scene, in its rows.

        Args:
            rows: the scene, in which a brick waits, perhaps with what it brings along.
            placing: whether it comes to its place.
            group: what it brings along, ...
            to: ... and how far from their places.
        """
        row = {k: n for n, k in enumerate(rows.owner.tolist()) if 0 <= k < self.states.mates.count}
        moving = {int(rows.owner[-1]), *group, *rows.owner[rows.scene.num_placed :].tolist()}
        beside = world.beside.copy()
        if group:
            beside[list(moving)] = to
        found = list[StudJoint]()
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
        found = self.states.press_on((block, *group), frozenset(standing))
        if not found.knobs:
            return None
        x, y = self.job.pieces[block].target[:2].tolist()
        return found.at[0] - x, found.at[1] - y

    def loose(self, block: int, world: WorkcellBlocks) -> bool:
        """Whether a brick in its place is pressed home on nothing that stands under it. One joint
        that has opened beside others is left: to take the brick off would open more."""
        own = [(a, block) for a in self.states.mates.lower[block] if (a, block) in self._joints]
        there = [
            (a, b)
            for a, b in own
            if (not world.beside[b].any() if a == GROUND else world.together(b)[a])
            and (a == GROUND or world.state[a] == STANDING)
        ]
        return bool(there) and not any(pair in world.home for pair in there)

    def made_by(self, block: int, world: WorkcellBlocks) -> set[tuple[int, int]]:
        """See :meth:`Structure.made_by`."""
        together = world.together(block)
        return {
            (a, b)
            for a, b in self._joints
            if block in (a, b)
            and all(
                k == block or (world.state[k] == STANDING and together[k])
                for k in (a, b)
                if k != GROUND
            )
            and not (a == GROUND and world.beside[block].any())
        }

    def stands(self, standing: frozenset[int]) -> bool:
        """Whether these bricks stand without the others."""
        return self._stands((), standing)

    def takes(self, step: StepOf, standing: frozenset[int], world: WorkcellBlocks) -> bool:
        """See :meth:`Structure.takes`: also while the brick, and what it brings along, is pressed
        home; every part of the structure by itself, as those that are built beside stand alone."""
        own = (step.block, *step.group)
        beside = world.beside[: self.states.mates.count].copy()
        if step.group:
            beside[list(own)] = step.to
        for there in np.unique(beside, axis=0):
            whole = np.flatnonzero((beside == there).all(1)).tolist()
            part = frozenset(whole) & (standing | set(own))
            table = tuple(whole) if there.any() else ()
            if part and not self._stands(table, part):
                return False
            if step.block in part and not self._bears(table, own, part - set(own)):
                return False
        return True

    def _stands(self, table: tuple[int, ...], part: frozenset[int]) -> bool:
        """Whether bricks stand: in the structure, or where those of ``table`` are built beside."""
        key = table, part
        if key not in self._known:
            states, number = self._part(table)
            self._known[key] = not part or states.stands(frozenset(number[k] for k in part))
        return self._known[key]

    def _bears(self, table: tuple[int, ...], own: tuple[int, ...], rest: frozenset[int]) -> bool:
        """Whether bricks that come together are carried while they are pressed home."""
        key = table, own, rest
        if key not in self._known:
            states, number = self._part(table)
            group, there = [number[k] for k in own], frozenset(number[k] for k in rest)
            self._known[key] = states.stands_pressed(group, there)
        return self._known[key]

    def _part(self, table: tuple[int, ...]) -> tuple[BrickStates, dict[int, int]]:
        """The states of a part, and the number of each of its bricks there."""
        if not table:
            return self.states, {k: k for k in range(self.states.mates.count)}
        if table not in self._apart:
            self._apart[table] = self.states.on_table(table)
        return self._apart[table], {k: n for n, k in enumerate(table)}

    def proof(self, standing: frozenset[int]) -> tuple[str, float] | None:
        """What shows that these bricks stand without the others, and the sideways acceleration in
        every direction [g] that they withstand; None where nothing shows it."""
        if not self.states.stands(standing):
            return None
        present = self.states.present(standing)
        return self.states.law.proof, self.states.balance.margin_g(present)
