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
from functools import cached_property
from itertools import count, islice, product
from typing import Any

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.assembly.contacts import Contacts, find_contacts
from learn2assemble.assembly.hands import Hand
from learn2assemble.cell.arrange import ends_of
from learn2assemble.cell.pieces import Piece, pieces_of, with_rests
from learn2assemble.cell.structure import ways_in
from learn2assemble.cell.workcell import DOWN, Direction, Job, StepOf
from learn2assemble.cell.world import (
    STANDING,
    Rows,
    WorkcellBlocks,
    moves,
    rows_of,
)
from learn2assemble.geometry.hulls import cross_product
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.kinematics.capsules import Capsules, capsules_of, in_hand, solid_capsules
from learn2assemble.kinematics.cell import KinematicCell
from learn2assemble.kinematics.sweeps import Sweep, clear, sweep
from learn2assemble.planning.crew import Bringing
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.grasps import FIRST, WAY
from learn2assemble.robot.hand import hand_limits
from learn2assemble.robot.moves import Attempt, Move, carried, turned
from learn2assemble.statics.states import State
from learn2assemble.team.traffic import APART as KEPT

APART = KEPT + 0.002
"""What arms keep from one another where one holds [m]: more than what they keep while they build,
as blocks are not placed where they were planned to the last bit."""
MOST_GRIPS = 16
"""Grasps of an arm that are offered for a block, for each of :data:`OUT`."""
OUT = (0.0, 0.12, 0.2)
"""Where blocks lean, an arm that holds may lean over the place of the next one: so far a hand keeps
to the way by which its block comes, and to its own axis when it leaves, before it goes straight up
[m]; 0: as everywhere."""
FINE = 0.008
"""Half of what of a block is in one capsule [m]: next to a block that another hand holds, one that
comes is as near to that hand as it ever is, and rounder than it is it would not come by."""
ALIKE = 1e-3
"""An arm whose joints differ by less holds a block in the same way [rad]."""
LIP_ROOM = 0.002
"""Between the lip of a cup that is moved aside and the edges of a face [m]."""
LEANING = 0.02
"""A joint leans where the height of its normal is neither 0 nor 1 by more."""


@dataclass(frozen=True, eq=False)
class Reached:
    """How an arm brings a block, and where it is then."""

    member: int
    """Number of the arm."""
    part: int
    """Number of the part of the block that is held."""
    move: Move
    hand: Hand
    arm: Arm
    over: tuple[np.ndarray, np.ndarray]
    """Its joints float64[k, n] over the place of the block, upwards, and over where it waits
    [rad]."""
    held: Capsules
    """The arm with the block."""

    @property
    def joints(self) -> np.ndarray:
        """float64[n], with the block in its place [rad]."""
        return self.over[0][0]

    @cached_property
    def ways(self) -> tuple[Sweep, ...]:
        """Of the arm with the block, over its place and over where it waits."""
        return tuple(sweep(self.arm, self.held, way) for way in self.over)

    @cached_property
    def stands(self) -> Sweep:
        """The arm alone, where it is then."""
        return sweep(self.arm, capsules_of(self.arm), self.over[0][:1])


@dataclass(frozen=True, eq=False)
class Member:
    """One of the arms of a cell."""

    name: str
    job: Job
    """What it could build alone, with the places that it takes blocks from."""

    @property
    def rests(self) -> dict[str, np.ndarray]:
        """Rotations float64[3, 3] in which blocks wait for it, by name."""
        return {piece.id: piece.rest for piece in self.job.pieces}


def leaning(contacts: Contacts) -> np.ndarray:
    """bool[C]: whether joints lean."""
    steep = np.abs(contacts.normal[:, 2])
    return (steep > LEANING) & (steep < 1 - LEANING)


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
            pieces = with_rests(pieces_of(whole), job.arm, member.rests)
            job = replace(job, pieces=pieces, assembly=whole)
            self.worlds.append(WorkcellBlocks(job))
            self.cells.append(KinematicCell(job.arm))
        self._begin = [(list(w.state), w.pose.copy()) for w in self.worlds]
        self._contacts: Contacts = find_contacts(whole)
        self._leans = bool(leaning(self._contacts).any())
        self._holding: dict[bytes, Reached] = {}
        """By the hand, how the arm holds."""
        self._known: dict[tuple[int, int, bytes], tuple[list[Reached], Iterator[Reached]]] = {}
        """By arm, block and what is there: ways that were found, and those that may be yet."""
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
            known: set[bytes] = set()
            for found in self._reached(number, block, state):
                # However it comes there, a hand is the same one.
                if found.hand.key not in known and self._clear(found, block, state):
                    known.add(found.hand.key)
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

    def _reached(self, number: int, block: int, state: State) -> Iterator[Reached]:
        """Ways in which an arm brings a block among what is there, if it were alone."""
        key = number, block, state.present.tobytes()
        if key not in self._known:
            self._known[key] = [], self._find(number, block, state)
        some, more = self._known[key]
        for k in count():
            if k == len(some):
                some += islice(more, 1)
            if k == len(some):
                return
            yield some[k]

    def _find(self, number: int, block: int, state: State) -> Iterator[Reached]:
        world, cell, member = self.worlds[number], self.cells[number], self.members[number]
        into: tuple[Direction, ...] = (DOWN,)
        if self._leans:
            standing = set(np.flatnonzero(state.present).tolist())
            into = ways_in(self._contacts, block, standing)
        open_ = self._towards_missing(block, state)
        seen: set[tuple[Any, ...]] = set()
        hands: dict[tuple[Any, ...], Reached] = {}
        for at, goal in list(ends_of(world, StepOf(block))):
            assert at is not None
            self._stand(number, state)  # Others may have been looked at since the last one.
            world.pose[block] = at
            rows = rows_of(world, world.pose, block)
            ways = list(moves(world, rows, block, goal, into))
            held = (one for way in ways for one in self._held(number, block, way, open_))
            for move, turn, out in product(held, (0.0, *cell.arm.turns), self._outs):
                move = move._replace(place=move.place._replace(way=max(out, move.place.way)))
                hand = _lip(move), turn
                point = *hand, move.place.way, move.place.insertion().round(3).tobytes()
                if point in seen:
                    continue
                one = turned(rows.scene, move, turn)
                found = cell.attempt(rows.scene, one)
                if not found.reached:
                    self.why[block] = f"{member.name}: {found.outcome.label} ({found.stage})"
                    continue
                seen.add(point)
                made = self._as_reached(number, rows, one, found)
                same = hands.setdefault(hand, made)
                if np.abs(same.joints - made.joints).max() < ALIKE:
                    made = replace(made, hand=same.hand)
                yield made
                if len(seen) == MOST_GRIPS * len(self._outs):
                    return
        if not seen:
            self.why.setdefault(block, f"{member.name}: no supply")

    def _held(self, number: int, block: int, move: Move, open_: np.ndarray) -> Iterator[Move]:
        """A move, and with a cup the same held elsewhere on the face: nearer to the base of the
        arm, where there is more room for a second arm beside, and farther from where blocks are
        missing, which come past the hand.

        Args:
            open_: of :meth:`_towards_missing`.
        """
        for home in (True, False):
            for away in (True, False) if open_.any() else (False,):
                aside = self._aside(number, block, move, home, -open_ if away else None)
                if aside is not None:
                    yield aside

    def _towards_missing(self, block: int, state: State) -> np.ndarray:
        """float64[3]: sum of the normals of a block towards those beside it that are missing."""
        found, joints = np.zeros(3), self._contacts
        for a, b, normal in zip(joints.a.tolist(), joints.b.tolist(), joints.normal, strict=True):
            other = a if b == block else b
            if block in (a, b) and other >= 0 and not state.present[other]:
                found += normal if a == block else -normal
        return found

    def _aside(
        self, number: int, block: int, move: Move, home: bool, away: np.ndarray | None
    ) -> Move | None:
        """A move with the cup elsewhere on the face, None where it is not moved much."""
        if not home and away is None:
            return move
        arm, piece = self.members[number].job.arm, self.worlds[number].pieces[block]
        if arm.suction is None or len(piece.shape) > 1 or move.place.lip != FIRST:
            return None
        place, tool = move.place, move.place.rotation()
        point, approach = place.tool_point(move.target), place.approach()
        inside = arm.suction.cups[0].radius + LIP_ROOM
        moved = point
        for way in (arm.base_position - point if home else None, away):
            if way is None:
                continue
            way = way - approach * (approach @ way)
            if np.linalg.norm(way) < 1e-3:
                return None
            way = way / np.linalg.norm(way)
            there = _farthest(piece, moved, approach, way, inside)
            if there is None or np.linalg.norm(there - moved) < 2 * LIP_ROOM:
                return None
            moved = there
        u, v, w = (np.array(place.aside) + tool.T @ (moved - point)).tolist()
        grasp, there = (one._replace(aside=(u, v, w)) for one in (move.grasp, place))
        return move._replace(grasp=grasp, place=there)

    def _as_reached(self, number: int, rows: Rows, move: Move, found: Attempt) -> Reached:
        assert found.pick is not None
        assert found.place is not None
        member = self.members[number]
        cells = rows.scene.members(move.cell)
        place, quaternion = carried(rows.scene, move, cells)
        tool, point = move.place.rotation(), move.place.tool_point(move.target)
        held, pieces = capsules_of(member.job.arm), self.worlds[number].pieces
        for centre, turn, cell in zip(place, quaternion, cells.tolist(), strict=True):
            part = pieces[rows.owner[cell]].shape[rows.part[cell]]
            axes = tool.T @ quaternion_matrix(turn)
            alone = part._replace(centre=(0.0, 0.0, 0.0))
            block = solid_capsules([alone], tool.T @ (centre - point), axes, FINE)
            held = held.add(in_hand(member.job.arm, block))
        at, limits, most = hand_limits(member.job.arm, move, found.place[0])
        hand = Hand.within(at.tolist(), limits, most, member.name)
        part, over = int(rows.part[move.cell]), (found.place, found.pick)
        return Reached(number, part, move, hand, member.job.arm, over, held)

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
        arm, place = self.members[other.member].job.arm, other.move.place
        for out in dict.fromkeys((place.way, *self._outs)):
            leaves = place._replace(way=out or WAY)
            still = other.move._replace(cell=row, grasp=leaves, place=leaves)
            left = cell.let_go(rows.scene, still, other.joints)
            if left.place is not None and clear(
                sweep(arm, capsules_of(arm), left.place), found.stands, APART
            ):
                return True
        return False

    def _stand(self, number: int, state: State) -> None:
        """Everything stands where it should that is there, and the rest waits."""
        world, (states, poses) = self.worlds[number], self._begin[number]
        for k, there in enumerate(state.present.tolist()):
            world.state[k] = STANDING if there else states[k]
            world.pose[k] = world.target(k) if there else poses[k]


def _farthest(
    piece: Piece, point: np.ndarray, approach: np.ndarray, way: np.ndarray, inside: float
) -> np.ndarray | None:
    """Where on a face of a block in its place a cup is farthest along a way in the face, with its
    middle no nearer to an edge than ``inside`` [m]; None where it is on none. Of points as far as
    one another it is the one nearest to ``point``."""
    import shapely

    solid, turn = piece.shape[0].solid, piece.turn
    middle = piece.pose[:3] + turn @ np.array(piece.shape[0].centre)
    for face, normal in enumerate(solid.normals):
        if (turn @ normal) @ approach > -1 + 1e-6:
            continue
        axes = np.stack([way, cross_product(approach, way)])
        corners = (middle + solid.polygon(face) @ turn.T - point) @ axes.T
        room = shapely.get_coordinates(shapely.Polygon(corners).buffer(-inside))
        if not len(room):
            return None
        most = room[:, 0].max()
        edge = room[room[:, 0] > most - 1e-6, 1]
        across = float(np.clip(0.0, edge.min(), edge.max()))
        return point + np.array([most, across]) @ axes
    return None


def _lip(move: Move) -> tuple[float, ...]:
    """Where and how a block is held, roughly."""
    point = move.place.tool_point(move.target)
    return tuple(np.concatenate([point, move.place.approach()]).round(3).tolist())
