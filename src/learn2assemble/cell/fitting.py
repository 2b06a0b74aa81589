"""Where a block goes, as those about it are believed to stand: on what carries it, and with room to
those beside it, which stand a little beside their places or are still to come.

What is known of a place has a standard deviation, and so has a placement. A block that is put where
the drawing says meets a neighbour that stands nearer than that, and a gap is left elsewhere that
the block to come does not find. So the shifts of a block and of those to come in its row are found
together, as the smallest for which all joints between them stay open: least squares, in which a
joint that is too narrow counts by how well its width can be known.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from learn2assemble.cell.arrange import LEANING
from learn2assemble.cell.belief import step_between
from learn2assemble.cell.pieces import Piece
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


class Near(NamedTuple):
    """A neighbour, where both are in their places."""

    other: int
    gap: float
    """[m]"""
    way: np.ndarray
    """float64[3]: unit vector towards it."""
    points: np.ndarray
    """float64[m, 3]: corners of what they have opposite each other, world frame [m]."""


def neighbours(pieces: Sequence[Piece], k: int) -> tuple[Near, ...]:
    """What a block would run into if it were moved, in the order of their numbers."""
    piece, found = pieces[k], list[Near]()
    mine, (low, high) = solids(piece.shape, piece.pose), piece.extent
    for n, other in enumerate(pieces):
        ends = np.maximum(other.extent[0], low), np.minimum(other.extent[1], high)
        if n == k or (ends[0] - ends[1] > WITHIN).any():
            continue
        for one, two in product(mine, solids(other.shape, other.pose)):
            gap, way = separation(one, two)
            if gap <= WITHIN and _faces(one, two, gap, way):
                ahead = one[0] @ way
                face = one[0][ahead > ahead.max() - ON_FACE]
                found.append(Near(n, gap, way, np.clip(face, two[0].min(0), two[0].max(0))))
    return tuple(found)


def _faces(one: Solid, two: Solid, gap: float, way: np.ndarray) -> bool:
    """Whether a body would run into another one on the axis that parts them, not past it."""
    ahead = one[0] + way * (gap + 3e-3), one[1], one[2]
    return separation(ahead, two)[0] < -1e-3


class Fitting:
    """Where blocks go.

    Args:
        world: where they are believed to be, and how well that is known.
    """

    def __init__(self, world: WorkcellBlocks) -> None:
        self.world = world
        self._near: dict[int, tuple[Near, ...]] = {}

    def near(self, k: int) -> tuple[Near, ...]:
        """See :func:`neighbours`."""
        if k not in self._near:
            self._near[k] = neighbours(self.world.job.pieces, k)
        return self._near[k]

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
        goal, beds, off = self.world.target(k), list[np.ndarray](), list[float]()
        for near in self.near(k):
            if near.other in standing and near.way[2] < -LEANING:
                beds.append(near.way)
                off.append(float(np.mean(self.moved(near) @ near.way)))
        if beds:
            goal[:3] += np.linalg.pinv(np.array(beds), rcond=1e-3) @ np.array(off)
        shift = goal[:3] - self.world.target(k)[:3]
        goal[:3] += self._aside(k, set(standing), set(coming), shift)
        return goal

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
            for near in self.near(k)
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
        for near in self.near(k):
            if near.other in standing and abs(float(near.way[2])) < LEANING:
                room = near.gap + float(np.min(self.moved(near) @ near.way))
                if room < OPEN * math.hypot(self.world.placing, self.world.spread[near.other, 0]):
                    found[near.other] = room
        return sorted(found, key=lambda n: found[n])

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
        row, rows, room = [k], list[np.ndarray](), list[float]()
        world, later = self.world, self.world.placing
        joints: list[tuple[int, int, np.ndarray, float, float]] = []
        for number, one in enumerate(row):  # It grows on the way.
            for near in self.near(one):
                other, level = near.other, abs(float(near.way[2])) < LEANING
                if not -LEANING <= near.way[2] < 1 - LEANING or not (level or one == k):
                    continue
                if other in standing:
                    gap = near.gap + float(np.min(self.moved(near) @ near.way))
                    size = math.hypot(later, float(world.spread[other, 0]))
                    joints.append((number, -1, near.way, gap, size))
                elif other in coming and level and later:
                    if other not in row:
                        row.append(other)
                    if number < row.index(other):
                        size = math.hypot(later, later)
                        joints.append((number, row.index(other), near.way, near.gap, size))
        if not joints:
            return np.zeros(3)
        for number, to, way, gap, sharp in joints:
            size, ahead = max(sharp, SHARP), np.zeros((len(row), 3))
            ahead[number] = way
            if to >= 0:
                ahead[to] = -way
            elif number == 0:
                gap -= float(way @ shift)
            rows.append(ahead.ravel() / size)
            room.append((gap - world.job.joint / 2 - OPEN * sharp) / size)
        return _least(np.array(rows), np.array(room))[:3]


def _height(place: np.ndarray) -> np.ndarray:
    """float64[3]: how the height of the table at a place float64[3+] [m] depends on it."""
    return np.array([1.0, place[1], -place[0]])


def _least(rows: np.ndarray, room: np.ndarray) -> np.ndarray:
    """float64[n]: the x for which |x|² / STRAYS² + |max(0, rows x - room)|² is least."""
    found, tight = np.zeros(rows.shape[1]), np.zeros(len(rows), bool)
    for _ in range(ROUNDS):
        now = rows @ found > room
        if (now == tight).all():
            break
        tight = now
        a, b = rows[tight], room[tight]
        found = np.linalg.solve(a.T @ a + np.eye(rows.shape[1]) / STRAYS**2, a.T @ b)
    return found
