"""Where a block goes, as those about it are believed to stand: on what carries it, and with room to
those beside it, which stand a little beside their places or are still to come.

What is known of a place has a standard deviation, and so has a placement. A block that is put where
the drawing says meets a neighbour that stands nearer than that, and a gap is left elsewhere that
the block to come does not find. So the shifts of a block and of those to come in its row are found
together, as the smallest for which all joints between them stay open: least squares, in which a
joint that is too narrow counts by how well its width can be known.

A block beside a corner of another one runs into it only where it is past that on two sides. Which
of the two joints is kept open is left to whichever asks for less.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from learn2assemble.acting.belief import step_between
from learn2assemble.cell.pieces import Piece
from learn2assemble.cell.structure import LEANING
from learn2assemble.cell.world import WorkcellBlocks, on_table
from learn2assemble.geometry.hulls import separation
from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix, rotation_of
from learn2assemble.robot.bodies import Solid, solids

WITHIN = 0.02
"""What is farther from the place of a block than this leaves it all the room it needs [m]."""
ON_FACE = 1e-4
"""Corners that are so near to the foremost one along an axis are on the face ahead [m]."""
OPEN = 2.0
"""A joint should be open by so many standard deviations of its width."""
STRAYS = 1e-3
"""Shifts of this size are as bad as a joint that is narrower than it should be by one standard
deviation [m]."""
SHARP, SHARP_TURN = 2e-5, 3e-4
"""Nothing is known better than by these standard deviations [m], [rad]."""
TABLE, LEAN = 2e-3, math.radians(0.5)
"""By which a table may be off: standard deviations [m], [rad]."""
SIZE = 3e-4
"""By which the height of a block may be off: standard deviation [m]."""
CERTAIN = 16.3
"""Chi-square distance of three numbers from 0 that chance exceeds once in a thousand times."""
ROUNDS = 40
"""Most often it is asked anew which joints are too narrow."""


MEETS, RUNS_INTO = 1e-3, 3e-3
"""Blocks have so much opposite each other where one meets the other [m], if it is moved so far
across the gap between them."""
SAME_AXIS = 1 - 1e-6
"""Unit vectors with a larger product are one axis."""
MOST_CORNERS = 6
"""Of so many corners that are too near both joints are tried, of the others the wider one."""


class Near(NamedTuple):
    """A neighbour along one axis that parts it from a block, where both are in their places."""

    other: int
    gap: float
    """[m]"""
    way: np.ndarray
    """float64[3]: unit vector towards it."""
    points: np.ndarray
    """float64[m, 3]: corners of what they have opposite each other, world frame [m]."""


Corner = tuple[Near, ...]
"""A neighbour that is met only past all of these joints; one of them has to stay open."""


def neighbours(pieces: Sequence[Piece], k: int) -> tuple[Corner, ...]:
    """What a block would run into if it were moved, in the order of their numbers: one joint where
    they face each other, several where one stands beside a corner of the other."""
    piece, found = pieces[k], list[Corner]()
    mine, (low, high) = solids(piece.shape, piece.pose), piece.extent
    for n, other in enumerate(pieces):
        ends = np.maximum(other.extent[0], low), np.minimum(other.extent[1], high)
        if n == k or (ends[0] - ends[1] > WITHIN).any():
            continue
        for one, two in product(mine, solids(other.shape, other.pose)):
            joints = tuple(Near(n, *rest) for rest in _joints(one, two))
            if joints and joints[0].gap <= WITHIN:
                found.append(joints)
    return tuple(found)


def _joints(one: Solid, two: Solid) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """The gaps between two bodies [m], the ways across them and what is opposite there, the widest
    first: one where they face each other; where one is above the other, but for a corner, none."""
    widest, way = separation(one, two)
    ahead = one[0] + way * (widest + RUNS_INTO), one[1], one[2]
    if separation(ahead, two)[0] < -MEETS:
        return [(widest, way, _opposite(one, two, way))]
    found: list[tuple[float, np.ndarray, np.ndarray]] = []
    for axis in np.vstack([one[1], -two[1]]):
        gap = float((two[0] @ axis).min() - (one[0] @ axis).max())
        if gap <= -MEETS or any(axis @ known > SAME_AXIS for _, known, _ in found):
            continue
        if abs(float(axis[2])) >= LEANING:
            return []
        found.append((gap, axis, _opposite(one, two, axis)))
    return sorted(found, key=lambda joint: -joint[0])


def _opposite(one: Solid, two: Solid, way: np.ndarray) -> np.ndarray:
    """float64[m, 3]: corners of the face of one body ahead, as far as the other is opposite [m]."""
    ahead = one[0] @ way
    face = one[0][ahead > ahead.max() - ON_FACE]
    return np.clip(face, two[0].min(0), two[0].max(0))


class Fitting:
    """Where blocks go.

    Args:
        world: where they are believed to be, and how well that is known.
        studs: whether they are pressed on knobs, which draw each to its place on those below.
    """

    world: WorkcellBlocks
    studs: bool

    def __init__(self, world: WorkcellBlocks, studs: bool = False) -> None:
        self.world, self.studs = world, studs
        self._near: dict[int, tuple[Corner, ...]] = {}

    def near(self, k: int) -> tuple[Corner, ...]:
        """See :func:`neighbours`."""
        if k not in self._near:
            self._near[k] = neighbours(self.world.job.pieces, k)
        return self._near[k]

    def facing(self, k: int) -> Iterator[Near]:
        """Neighbours that a block faces."""
        return (joints[0] for joints in self.near(k) if len(joints) == 1)

    def goal(self, k: int, standing: Collection[int], coming: Collection[int]) -> np.ndarray:
        """Where a block goes.

        Args:
            k: the block.
            standing: pieces in the structure, without the block itself.
            coming: pieces that are still to come, without it.

        Returns:
            float64[7]: in its own orientation, shifted with what carries it, and between those
            beside it.
        """
        goal = self.home(k, standing) if self.studs else self.world.target(k)
        beds, off = list[np.ndarray](), list[float]()
        for near in self.facing(k):
            if near.other in standing and near.way[2] < -LEANING:
                beds.append(near.way)
                off.append(float(np.mean(self.moved(near) @ near.way)))
        if beds and not self.studs:
            goal[:3] += np.linalg.pinv(np.array(beds), rcond=1e-3) @ np.array(off)
        shift = goal[:3] - self.world.target(k)[:3]
        aside = self._aside(k, set(standing), set(coming), shift)
        for way in beds:
            # What carries it gives no room: the last block of an arch would be put into it.
            aside = aside - max(float(aside @ way), 0.0) * way
        goal[:3] += aside
        return goal

    def home(self, k: int, standing: Collection[int]) -> np.ndarray:
        """float64[7]: where knobs draw a brick that is pressed on those that stand below it; as it
        is drawn where there are none."""
        goal = self.world.target(k)
        beds = (near for near in self.facing(k) if near.way[2] < -LEANING and near.gap < MEETS)
        below = {near.other for near in beds} & set(standing)
        if not below:
            return goal
        steps = list[np.ndarray]()
        for other in sorted(below):
            meant = self.world.target(other)
            step = self._step(other, meant)
            arm = goal[:3] - meant[:3]
            step[:3] += rotation_of(step[3:]) @ arm - arm
            steps.append(step)
        step = np.mean(steps, 0)
        turn = rotation_of(step[3:]) @ quaternion_matrix(goal[3:])
        return np.array([*(goal[:3] + step[:3]), *matrix_quaternion(turn)])

    def table(self, standing: Collection[int]) -> np.ndarray:
        """float64[3]: how the table is, as blocks that stand on it say: its height at the origin
        [m] and by how much it leans about x and y [rad]; zeros, as long as they may just as well
        say that it is as it should be."""
        found, known = self._table(standing)
        return found if found @ known @ found > CERTAIN else np.zeros(3)

    def _table(self, standing: Collection[int]) -> tuple[np.ndarray, np.ndarray]:
        """The table as :meth:`table` has it, but where nothing says so, too, and the inverse of the
        covariance of that, float64[3, 3]."""
        world, known = self.world, np.diag([TABLE**-2, LEAN**-2, LEAN**-2])
        seen, before = np.zeros(3), world.table
        world.table = np.zeros(3)
        for k in sorted(standing):
            if not self._on_table(k):
                continue
            meant, (place, turn) = world.target(k), world.spread[k]
            off = self._step(k, meant)
            height, size = _height(meant), max(float(place), SHARP)
            known += np.outer(height, height) / size**2
            seen += height * off[2] / size**2
            size = max(float(turn), SHARP_TURN)
            known[[1, 2], [1, 2]] += 1 / size**2
            seen[1:] += off[3:5] / size**2
        world.table = before
        return np.linalg.solve(known, seen), known

    def _on_table(self, k: int) -> bool:
        low = self.world.job.pieces[k].extent[0][2]
        return abs(float(low)) <= ON_FACE and not self.world.beside[k].any()

    def height(self, k: int, standing: Collection[int]) -> float:
        """Standard deviation of the height of what carries a block in its place [m].

        Args:
            standing: pieces in the structure, without the block itself.
        """
        below = [
            float(self.world.spread[near.other, 0])
            for near in self.facing(k)
            if near.other in standing and near.way[2] < -LEANING
        ]
        if not below and not self._on_table(k):
            return TABLE
        if not below:
            height = _height(self.world.target(k))
            below = [math.sqrt(height @ np.linalg.solve(self._table(standing)[1], height))]
        return math.hypot(max(below), SIZE)

    def tight(self, k: int, standing: Collection[int]) -> list[int]:
        """Neighbours that leave a block less room than it needs, the nearest one first."""
        found: dict[int, float] = {}
        for joints in self.near(k):
            near = joints[0]
            if near.other in standing and abs(float(near.way[2])) < LEANING:
                room = max(self.width(one) for one in joints)
                if room < OPEN * math.hypot(self.world.placing, self.world.spread[near.other, 0]):
                    found[near.other] = room
        return sorted(found, key=lambda n: found[n])

    def width(self, near: Near) -> float:
        """Of a joint, if the block is in its place and the neighbour where it is believed to be
        [m]."""
        return near.gap + float(np.min(self.moved(near) @ near.way))

    def _step(self, k: int, meant: np.ndarray) -> np.ndarray:
        """float64[6]: from where a block should be to where it is; turns in which it looks the same
        are one."""
        now = self.world.pose[k]
        there = quaternion_matrix(now[3:])
        steps = (
            step_between(meant, np.array([*now[:3], *matrix_quaternion(there @ same)]))
            for same in self.world.pieces[k].turns()
        )
        return min(steps, key=lambda one: round(float(np.linalg.norm(one[3:])), 6))

    def moved(self, near: Near) -> np.ndarray:
        """float64[m, 3]: how far the points of a neighbour are from where they should be [m]."""
        world, n = self.world, near.other
        meant = world.target(n)
        step = self._step(n, meant)
        arm = on_table(world.table, near.points) + world.beside[n] - meant[:3]
        return step[:3] + arm @ (rotation_of(step[3:]) - np.eye(3)).T

    def _aside(self, k: int, standing: set[int], coming: set[int], shift: np.ndarray) -> np.ndarray:
        """float64[3]: by how much a block is moved out of what stands beside it, and away from
        where others shall come [m].

        Args:
            shift: float64[3] by which it is moved anyway [m].
        """
        world, later, row = self.world, self.world.placing, [k]
        joints, corners = list[_Opening](), list[list[_Opening]]()
        for number, one in enumerate(row):  # It grows on the way.
            for near, *others in self.near(one):
                other, level = near.other, abs(float(near.way[2])) < LEANING
                if not -LEANING <= near.way[2] < 1 - LEANING or not (level or one == k):
                    continue
                size = math.hypot(
                    later, float(world.spread[other, 0]) if other in standing else later
                )
                if other in standing:
                    sides = [
                        _Opening(number, -1, side.way, self.width(side), size)
                        for side in (near, *others)
                    ]
                    joints += [] if others else sides
                    corners += [sides] if others else []
                elif other in coming and level and later and not others:
                    if other not in row:
                        row.append(other)
                    if number < row.index(other):
                        joints.append(_Opening(number, row.index(other), near.way, near.gap, size))
        told = [one.told(len(row), world.job.joint / 2, shift) for one in joints]
        sides = [
            [one.told(len(row), world.job.joint / 2, shift) for one in corner] for corner in corners
        ]
        return _passing(3 * len(row), told, sides)[:3]


class _Opening(NamedTuple):
    """What has to stay open when the blocks of a row are moved."""

    number: int
    """Of the block in its row."""
    to: int
    """The same of the block across the joint; -1: that stands."""
    way: np.ndarray
    """float64[3]: unit vector across."""
    gap: float
    """[m]"""
    size: float
    """Standard deviation of its width [m]."""

    def told(self, count: int, joint: float, shift: np.ndarray) -> _Bound:
        """As a bound of the moves of so many blocks, float64[3 * count] [m].

        Args:
            count: of blocks in the row.
            joint: how wide it has to stay in any case [m].
            shift: float64[3] by which the first block is moved anyway [m].
        """
        ahead, gap = np.zeros((count, 3)), self.gap
        ahead[self.number] = self.way
        if self.to >= 0:
            ahead[self.to] = -self.way
        elif self.number == 0:
            gap -= float(self.way @ shift)
        size = max(self.size, SHARP)
        return ahead.ravel() / size, (gap - joint - OPEN * self.size) / size


_Bound = tuple[np.ndarray, float]
"""A row and what its product with the moves must not exceed."""


def _passing(count: int, bounds: list[_Bound], corners: list[list[_Bound]]) -> np.ndarray:
    """float64[count]: the least moves that keep all bounds, and one of each corner."""
    tight: list[list[_Bound]] = []
    while True:
        choices = [sides[: None if k < MOST_CORNERS else 1] for k, sides in enumerate(tight)]
        _, found = min(
            (_least(count, [*bounds, *chosen]) for chosen in product(*choices)),
            key=lambda one: one[0],
        )
        more = [c for c in corners if all(row @ found > room for row, room in c)]
        more = [c for c in more if not any(c is known for known in tight)]
        if not more:
            return found
        tight += more


def _height(place: np.ndarray) -> np.ndarray:
    """float64[3]: how the height of the table at a place float64[3+] [m] depends on it."""
    return np.array([1.0, place[1], -place[0]])


def _least(count: int, bounds: list[_Bound]) -> tuple[float, np.ndarray]:
    """The least |x|² / STRAYS² + |max(0, rows x - room)|², and its x float64[count]."""
    rows = np.array([row for row, _ in bounds]).reshape(-1, count)
    room = np.array([most for _, most in bounds])
    found, tight = np.zeros(count), np.zeros(len(rows), bool)
    for _ in range(ROUNDS):
        now = rows @ found > room
        if (now == tight).all():
            break
        tight = now
        a, b = rows[tight], room[tight]
        found = np.linalg.solve(a.T @ a + np.eye(count) / STRAYS**2, a.T @ b)
    lacks = np.maximum(rows @ found - room, 0.0)
    return float(found @ found / STRAYS**2 + lacks @ lacks), found
