"""The arms of one cell as who builds: which of them brings a block, with which grasp, and what its
hand can give while it holds.

An arm that holds does not place. A block comes where an arm that is free reaches it with a grasp
whose ways meet nothing that stands, past the arms that hold, which are obstacles where they are;
and they must be able to let go with the block and the other arm there. Grasps and postures are
those of the kinematic cell of each arm.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.assembly.contacts import Contacts, find_contacts
from learn2assemble.assembly.hands import Hand
from learn2assemble.cell.arrange import ends_of, ways_in
from learn2assemble.cell.pieces import Piece, pieces_of, with_rests
from learn2assemble.cell.reach import cells_of
from learn2assemble.cell.traffic import APART as KEPT
from learn2assemble.cell.workcell import DOWN, Direction, Job, StepOf
from learn2assemble.cell.world import (
    STANDING,
    Rows,
    WorkcellBlocks,
    moves,
    rows_of,
)
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.planning.crew import Bringing
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.capsules import capsules_of, in_hand, solid_capsules
from learn2assemble.robot.grasps import FIRST
from learn2assemble.robot.hand import hand_limits
from learn2assemble.robot.kinematic import KinematicCell
from learn2assemble.robot.moves import Attempt, Move, carried, turned
from learn2assemble.robot.sweeps import Sweep, clear, sweep
from learn2assemble.statics.states import State

APART = KEPT + 0.002
"""What arms keep from one another where one holds [m]: more than what they keep while they build,
as blocks are not placed where they were planned to the last bit."""
MOST_GRIPS = 8
"""Grasps of an arm that are offered for a block, for each of :data:`OUT`."""
OUT = (0.0, 0.12, 0.2)
"""Where blocks lean, an arm that holds may lean over the place of the next one: so far a hand keeps
to the way by which its block comes, and to its own axis when it leaves, before it goes straight up
[m]; 0: as everywhere."""
LIP_ROOM = 0.002
"""Between the lip of a cup that is moved aside and the edges of a face [m]."""
LEANING = 0.02
"""A joint leans where the height of its normal is neither 0 nor 1 by more."""


class Reached(NamedTuple):
    """How an arm brings a block, and where it is then."""

    member: int
    """Number of the arm."""
    part: int
    """Number of the part of the block that is held."""
    move: Move
    joints: np.ndarray
    """float64[n], with the block in its place [rad]."""
    ways: tuple[Sweep, ...]
    """Of the arm with the block, over its place and over where it waits."""
    stands: Sweep
    """The arm alone, where it is then."""
    hand: Hand


@dataclass(frozen=True, eq=False)
class Member:
    """One of the arms of a cell."""

    name: str
    job: Job
    """What it could build alone, with the places that it takes blocks from."""


class ArmCrew:
    """The arms of a cell and some blocks.

    Args:
        members: one or two arms, whose jobs have the first of the blocks.
        blocks: all of them.
    """

    def __init__(self, members: Sequence[Member], blocks: Sequence[Block]) -> None:
        whole = Assembly(tuple(replace(b, support=False) for b in blocks))
        self.members = members
        self.worlds: list[WorkcellBlocks] = []
        self.cells: list[KinematicCell] = []
        for member in members:
            job = member.job
            pieces = with_rests(pieces_of(whole), job.arm)
            job = replace(job, pieces=pieces, assembly=whole)
            self.worlds.append(WorkcellBlocks(job))
            self.cells.append(KinematicCell(job.arm, cells_of(job)))
        self._begin = [(list(w.state), w.pose.copy()) for w in self.worlds]
        self._contacts: Contacts = find_contacts(whole)
        steep = np.abs(self._contacts.normal[:, 2])
        self._leans = bool(((steep > LEANING) & (steep < 1 - LEANING)).any())
        self._holding: dict[bytes, Reached] = {}
        """By the hand, how the arm holds."""
        self._known: dict[tuple[int, int, bytes], list[Reached]] = {}
        self._outs = OUT if self._leans else OUT[:1]
        self.why: dict[int, str] = {}
        """Of blocks, why an arm could not bring them, the last time."""

    # ------------------------------------------------------------ a crew

    def grips(self, block: int, state: State) -> Iterator[Bringing]:
        busy = {hand.name: hand for hand in state.hands.values()}
        for number in self._nearest(block, state):
            member = self.members[number]
            if member.name in busy:
                continue
            for found in self._reached(number, block, state):
                if self._clear(found, block, state):
                    self._holding[found.hand.key] = found
                    yield Bringing(member.name, found.hand)

    def reached(
        self, block: int, state: State, name: str, hand: Hand | None = None
    ) -> Iterator[Reached]:
        """As :meth:`grips`, how one arm brings a block.

        Args:
            name: of the arm.
            hand: what it has to be able to give the block; None: nothing.
        """
        number = [member.name for member in self.members].index(name)
        for found in self._reached(number, block, state):
            alike = hand is None or found.hand.key == hand.key
            if alike and self._clear(found, block, state):
                self._holding.setdefault(found.hand.key, found)
                yield found

    def takes(self, block: int, state: State) -> Iterator[Bringing]:
        return self.grips(block, state.change(remove=[block]))

    def _nearest(self, block: int, state: State) -> list[int]:
        """Numbers of the arms, the one nearest to the place of a block first; of those as near as
        one another, they take turns."""
        at, there = self.worlds[0].pieces[block].target[:2], int(state.present.sum())

        def key(number: int) -> tuple[float, int]:
            away = float(np.linalg.norm(self.members[number].job.base - at))
            return round(away, 2), (number + there) % len(self.members)

        return sorted(range(len(self.members)), key=key)

    # ------------------------------------------------------------ ways

    def _reached(self, number: int, block: int, state: State) -> list[Reached]:
        """Ways in which an arm brings a block among what is there, if it were alone."""
        key = number, block, state.present.tobytes()
        if key not in self._known:
            self._known[key] = list(self._find(number, block, state))
        return self._known[key]

    def _find(self, number: int, block: int, state: State) -> Iterator[Reached]:
        world, cell, member = self.worlds[number], self.cells[number], self.members[number]
        self._stand(number, state)
        into: tuple[Direction, ...] = (DOWN,)
        if self._leans:
            standing = set(np.flatnonzero(state.present).tolist())
            into = ways_in(self._contacts, block, standing)
        count, seen = 0, set[object]()
        for at, goal in ends_of(world, StepOf(block)):
            assert at is not None
            world.pose[block] = at
            rows = rows_of(world, world.pose, block)
            ways = moves(world, rows, block, goal, into)
            held = (one for way in ways for one in self._held(number, block, way))
            for move, turn, out in product(held, (0.0, *cell.arm.turns), self._outs):
                move = move._replace(place=move.place._replace(way=out or move.place.way))
                point = _lip(move), turn, out
                if point in seen:
                    continue
                one = turned(rows.scene, move, turn)
                found = cell.attempt(rows.scene, one)
                if not found.reached:
                    self.why[block] = f"{member.name}: {found.outcome.label} ({found.stage})"
                    continue
                seen.add(point)
                yield self._as_reached(number, rows, one, found)
                count += 1
                if count == MOST_GRIPS * len(self._outs):
                    return
        if not count:
            self.why.setdefault(block, f"{member.name}: no supply")

    def _held(self, number: int, block: int, move: Move) -> Iterator[Move]:
        """A move, and with a cup the same held nearer to the base of the arm, where there is more
        room for a second arm beside."""
        aside = self._aside(number, block, move)
        yield from (move,) if aside is None else (aside, move)

    def _aside(self, number: int, block: int, move: Move) -> Move | None:
        arm, piece = self.members[number].job.arm, self.worlds[number].pieces[block]
        if arm.suction is None or len(piece.shape) > 1 or move.place.lip != FIRST:
            return None
        place, point = move.place, move.place.tool_point(move.target)
        approach, tool = place.approach(), place.rotation()
        way = arm.base_position - point
        way = way - approach * (approach @ way)
        if np.linalg.norm(way) < 1e-3:
            return None
        way /= np.linalg.norm(way)
        radius = arm.suction.cups[0].radius
        far = _room(piece, point, approach, way, radius + LIP_ROOM)
        if far < 2 * LIP_ROOM:
            return None
        u, v, w = (np.array(place.aside) + far * (tool.T @ way)).tolist()
        grasp, there = (one._replace(aside=(u, v, w)) for one in (move.grasp, place))
        return move._replace(grasp=grasp, place=there)

    def _as_reached(self, number: int, rows: Rows, move: Move, found: Attempt) -> Reached:
        assert found.pick is not None
        assert found.place is not None
        member = self.members[number]
        cells = rows.scene.members(move.cell)
        place, quaternion = carried(rows.scene, move, cells)
        tool, point = move.place.rotation(), move.place.tool_point(move.target)
        held = capsules_of(member.job.arm)
        for centre, turn, cell in zip(place, quaternion, cells.tolist(), strict=True):
            box = Part((0.0, 0.0, 0.0), tuple(rows.scene.halves[cell].tolist()))
            axes = tool.T @ quaternion_matrix(turn)
            block = solid_capsules([box], tool.T @ (centre - point), axes)
            held = held.add(in_hand(member.job.arm, block))
        at, limits, most = hand_limits(member.job.arm, move, found.place[0])
        hand = Hand.within(at.tolist(), limits, most, member.name)
        arm, part = member.job.arm, int(rows.part[move.cell])
        ways = tuple(sweep(arm, held, way) for way in (found.place, found.pick))
        stands = sweep(arm, capsules_of(arm), found.place[:1])
        return Reached(number, part, move, found.place[0], ways, stands, hand)

    def _clear(self, found: Reached, block: int, state: State) -> bool:
        """Whether an arm comes past those that hold, and these could let go then."""
        after = state.change(place=[block])
        for held, hand in state.hands.items():
            other = self._holding[hand.key]
            if not all(clear(way, other.stands, APART) for way in found.ways):
                self.why[block] = f"{hand.name}, which holds, is in the way"
                return False
            if not self._lets_go(held, other, found, after):
                self.why[block] = f"{hand.name}, which holds, could not let go"
                return False
        return True

    def _lets_go(self, held: int, other: Reached, found: Reached, state: State) -> bool:
        """Whether an arm that holds can let go where another one has brought the next block."""
        world, cell = self.worlds[other.member], self.cells[other.member]
        self._stand(other.member, state)
        rows = rows_of(world, world.pose, held)
        row = int(np.flatnonzero((rows.owner == held) & (rows.part == other.part))[0])
        still = other.move._replace(cell=row, grasp=other.move.place)
        left = cell.let_go(rows.scene, still)
        if left.place is None:
            return False
        arm = self.members[other.member].job.arm
        return clear(sweep(arm, capsules_of(arm), left.place), found.stands, APART)

    def _stand(self, number: int, state: State) -> None:
        """Everything stands where it should that is there, and the rest waits."""
        world, (states, poses) = self.worlds[number], self._begin[number]
        for k, there in enumerate(state.present.tolist()):
            world.state[k] = STANDING if there else states[k]
            world.pose[k] = world.target(k) if there else poses[k]


def _room(
    piece: Piece, point: np.ndarray, approach: np.ndarray, way: np.ndarray, inside: float
) -> float:
    """How far a point of a face of a block in its place may be moved along a way in the face until
    it is as near to an edge as ``inside`` [m]; 0 where it is on none."""
    solid, turn = piece.shape[0].solid, piece.turn
    middle = piece.pose[:3] + turn @ np.array(piece.shape[0].centre)
    for face, normal in enumerate(solid.normals):
        outward = turn @ normal
        if outward @ approach > -1 + 1e-6:
            continue
        corners = middle + solid.polygon(face) @ turn.T
        inwards = np.cross(outward, np.roll(corners, -1, 0) - corners)
        inwards /= np.linalg.norm(inwards, axis=1)[:, None]
        away, slope = ((point - corners) * inwards).sum(1), inwards @ way
        ahead = [(a - inside) / -s for a, s in zip(away, slope, strict=True) if s < -1e-6]
        return max(min(ahead, default=0.0), 0.0)
    return 0.0


def _lip(move: Move) -> tuple[float, ...]:
    """Where and how a block is held, roughly."""
    point = move.place.tool_point(move.target)
    return tuple(np.concatenate([point, move.place.approach()]).round(3).tolist())
