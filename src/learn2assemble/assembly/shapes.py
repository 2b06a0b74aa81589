"""Shapes of blocks, and how a block is turned from its shape, so that numbers on paper tell it.

A block is told by its shape, a position and a turn, which are enough to put it exactly where it
belongs (:func:`corners_at`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.assembly.appearance import colour_words, is_square, laid_down, spread
from learn2assemble.assembly.blocks import Block
from learn2assemble.assembly.cuts import POST, Cut, cut_of

_GRAIN = 2e-5
"""Blocks that a turn by quarters brings together but for so much are of one shape [m]."""
_FINE = 1e-7
"""Blocks that differ by less are not looked at twice [m]."""
_ALIKE = 1e-4
"""So much may the corners of a block be off those of its shape, where it leans [m]."""
_MOST_TRIED = 60
"""Corners of a block whose order is sought."""

Turn = tuple[float, float, float]
"""Turns about x, then y, then z, counter-clockwise against the axis [deg]."""
_QUARTERS = tuple(
    (x, y, z)
    for (x, y), z in product(
        ((0, 0), (90, 0), (180, 0), (270, 0), (0, 90), (0, 270)), (0, 90, 180, 270)
    )
)
"""The 24 ways to lay a block on one of its sides, as turns about x, y and z [deg]."""


@dataclass(frozen=True, eq=False)
class BlockShape:
    """A kind of block of one size."""

    letter: str
    kind: str
    colour: str
    """``#rrggbb``, or a name of :data:`~learn2assemble.assembly.appearance.COLOURS`."""
    asked: bool
    """Whether the design asks for this colour."""
    corners: np.ndarray
    """float64[V, 3]: unturned, from the first corner [m]."""
    faces: tuple[tuple[int, ...], ...]
    """Indices of corners, counter-clockwise from outside."""
    is_box: bool
    nominal: tuple[float, float, float]
    """Extents with the joint that belongs to the block [m]."""
    volume: float
    """[m³]"""
    mass: float
    """[kg]"""

    @property
    def size(self) -> np.ndarray:
        """float64[3]: extents of the block itself, unturned [m]."""
        return np.ptp(self.corners, axis=0)

    @property
    def cut(self) -> Cut | None:
        """Of a post: how it is cut."""
        return cut_of(self.corners, self.faces) if self.kind == POST else None


def rotation(turn: Turn) -> np.ndarray:
    """float64[3, 3]: turns about x, then y, then z [deg]."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def corners_at(corners: np.ndarray, position: tuple[float, float, float], turn: Turn) -> np.ndarray:
    """float64[V, 3]: the corners of a shape where a block stands [m, from O].

    Args:
        corners: of the shape unturned, the first at zero.
        position: as :class:`ToldPose` says.
        turn: as :class:`ToldPose` says [deg].
    """
    turned = corners @ rotation(turn).T
    if all(angle % 90 == 0 for angle in turn):
        turned = turned - turned.min(0)
    return turned + np.array(position)


class ToldPose(NamedTuple):
    """A block as it is told on paper."""

    shape: BlockShape
    position: tuple[float, float, float]
    """From O [m]: of a block that is turned by quarters, the front left lower corner of the box
    round it; of a block that leans, its corner 1."""
    turn: Turn


class Shapes:
    """The shapes of an assembly, and how each block is turned from its shape."""

    def __init__(self, origin: np.ndarray, joint: float) -> None:
        self.origin = origin
        self.joint = joint
        self.found: list[BlockShape] = []
        self._like: dict[tuple[str, str, int], list[tuple[BlockShape, np.ndarray]]] = {}
        self._of: dict[str, _Match] = {}
        self._known: dict[tuple[str, str, tuple[tuple[int, ...], ...], bytes], _Match] = {}

    def add(self, block: Block, kind: str, colour: str) -> None:
        """Find the shape and the turn of a block."""
        points = block.vertices - block.vertices.min(0)
        as_given = (kind, colour, block.faces, (points / _FINE).round().tobytes())
        if as_given not in self._known:
            self._known[as_given] = self._match(block, kind, colour)
        self._of[block.id] = self._known[as_given]

    def _match(self, block: Block, kind: str, colour: str) -> _Match:
        apart = spread(block.vertices)
        like = self._like.setdefault((kind, colour, len(block.vertices)), [])
        for shape, distances in like:
            same = np.abs(distances - apart).max() <= _ALIKE
            if same and abs(shape.volume - block.volume) <= 1e-3 * block.volume:
                match = _turned(shape, block)
                if match is not None:
                    return match
        corners = block.vertices @ laid_down(block).T
        shape = self._new(block, corners - corners[0], kind, colour)
        like.append((shape, apart))
        match = _turned(shape, block)
        assert match is not None
        return match

    def _new(self, block: Block, corners: np.ndarray, kind: str, colour: str) -> BlockShape:
        size = np.ptp(corners, axis=0)
        is_box = abs(size.prod() - block.volume) <= 1e-6 * size.prod() and block.is_convex
        joint = np.array([self.joint, self.joint, 0.0])
        square = is_square(block) and block.kind != POST
        x, y, z = (size + (joint if square else 0)).tolist()
        letter, left = "", len(self.found)
        while not letter or left >= 0:
            letter, left = chr(65 + left % 26) + letter, left // 26 - 1
        asked = colour == colour_words(block)
        made = BlockShape(
            letter,
            kind,
            colour,
            asked,
            corners,
            block.faces,
            bool(is_box),
            (x, y, z),
            block.volume,
            block.mass,
        )
        self.found.append(made)
        return made

    def pose(self, block: Block) -> ToldPose:
        """How a block that was added is told."""
        match = self._of[block.id]
        at = block.vertices.min(0) if match.first is None else block.vertices[match.first]
        x, y, z = (at - self.origin).tolist()
        return ToldPose(match.shape, (x, y, z), match.turn)


class _Match(NamedTuple):
    """How a block is turned from its shape."""

    shape: BlockShape
    turn: Turn
    first: int | None
    """Of a block that leans: its vertex at which the first corner of the shape lies."""


def _turned(shape: BlockShape, block: Block) -> _Match | None:
    """How a block is turned from a shape; None where it is another shape, such as its mirror image.

    Quarters come before other turns, and small turns before large ones.
    """
    points = block.vertices - block.vertices.min(0)
    for turn in _QUARTERS:
        turned = shape.corners @ rotation(turn).T
        if _apart(turned - turned.min(0), points) <= _GRAIN:
            return _Match(shape, turn, None)
    found = list[tuple[float, Turn, int | None]]()
    for first, turning in _alignments(shape, block):
        turn = _angles(turning)
        leans = any(angle % 90 for angle in turn)
        found.append((sum(map(abs, turn)), turn, first if leans else None))
    if not found:
        return None
    _, turn, first = min(found, key=lambda one: one[:2])
    return _Match(shape, turn, first)


def _apart(some: np.ndarray, others: np.ndarray) -> float:
    """The largest distance of a point of either set from the nearest of the other [m]."""
    from scipy import spatial  # pyright: ignore[reportMissingTypeStubs]

    library: Any = spatial
    there = library.KDTree(others).query(some)[0]
    back = library.KDTree(some).query(others)[0]
    return float(max(there.max(), back.max()))


def _alignments(shape: BlockShape, block: Block) -> Iterator[tuple[int, np.ndarray]]:
    """The ways to lay a shape on a block: where its first corner comes to lie, and the rotation."""
    corners, vertices = shape.corners, block.vertices
    if shape.faces == block.faces:
        turning = _rotation_between(corners - corners[0], vertices - vertices[0])
        if np.abs(corners @ turning.T - (vertices - vertices[0])).max() <= _ALIKE:
            yield 0, turning
    if not block.is_convex or len(corners) > _MOST_TRIED:
        return  # The corners alone do not say what it is, or there are too many to try.
    # Three corners of the shape, and all corners of the block as far from one another.
    away = np.linalg.norm(corners, axis=1)
    b = int(away.argmax())
    c = int(np.linalg.norm(np.cross(corners, corners[b]), axis=1).argmax())
    apart = np.linalg.norm(vertices[:, None] - vertices, axis=-1)
    near = 2 * _ALIKE
    for i, j in np.argwhere(np.abs(apart - away[b]) <= near).tolist():
        third = np.abs(apart[i] - away[c]) <= near
        third &= np.abs(apart[j] - np.linalg.norm(corners[b] - corners[c])) <= near
        for k in np.flatnonzero(third).tolist():
            turning = _frame(*vertices[[i, j, k]]) @ _frame(*corners[[0, b, c]]).T
            turned = corners @ turning.T + vertices[i]
            if _apart(turned, vertices) > 3 * _ALIKE:
                continue
            # All corners together say the turn better than three.
            order = np.linalg.norm(turned[:, None] - vertices, axis=-1).argmin(1)
            turning = _rotation_between(corners, vertices[order] - vertices[i])
            if np.abs(corners @ turning.T + vertices[i] - vertices[order]).max() <= _ALIKE:
                yield i, turning


def _frame(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """float64[3, 3]: axes along the first side of a triangle, in its plane, and across it."""
    along = (b - a) / np.linalg.norm(b - a)
    across = np.cross(along, c - a)
    across = across / np.linalg.norm(across)
    return np.stack([along, np.cross(across, along), across], -1)


def _rotation_between(corners: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """float64[3, 3]: turns these corners onto those of the same order as well as can be."""
    u, _, vt = np.linalg.svd(corners.T @ goal)
    return vt.T @ np.diag([1, 1, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T


def _angles(turn: np.ndarray) -> Turn:
    """Turns about x, then y, then z, to a hundredth of a degree, above -180."""
    about_y = float(np.degrees(np.arcsin(np.clip(-turn[2, 0], -1, 1))))
    if abs(turn[2, 0]) < 1 - 1e-9:
        about_x = float(np.degrees(np.arctan2(turn[2, 1], turn[2, 2])))
        about_z = float(np.degrees(np.arctan2(turn[1, 0], turn[0, 0])))
    else:
        about_x, about_z = 0.0, float(np.degrees(np.arctan2(-turn[0, 1], turn[1, 1])))
    x, y, z = (round(angle, 2) + 0.0 for angle in (about_x, about_y, about_z))
    return (180.0 if x == -180 else x, y, 180.0 if z == -180 else z)
