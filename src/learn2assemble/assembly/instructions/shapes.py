"""Shapes of blocks, and how a block is turned from its shape, so that numbers on paper tell it.

A block is told by its shape, a position and a turn, which are enough to put it exactly where it
belongs (:func:`corners_at`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Block
from learn2assemble.assembly.cuts import POST, Cut, cut_of
from learn2assemble.assembly.instructions.appearance import (
    colour_words,
    drawn_as,
    is_square,
    spread,
)

_GRAIN = 2e-5
"""Blocks that a turn by quarters brings together but for so much are of one shape [m]."""
_FINE = 1e-7
"""Blocks that differ by less are not looked at twice [m]."""
_ALIKE = 1e-4
"""So much may the corners of a block be off those of its shape, where it leans [m]."""
_SLIM = 0.05
"""But no more than this, in the height of the triangle of corners by which a turn is found."""
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
    """``#rrggbb``, or a name of :data:`~.appearance.COLOURS`."""
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
    round it; of a block that is turned otherwise, its corner 1."""
    turn: Turn


class Named(NamedTuple):
    """A block and what it is called; blocks of one shape have one name and one colour."""

    block: Block
    kind: str
    colour: str


class Shapes:
    """The shapes of blocks, and how each block is turned from its shape.

    A shape is drawn as :func:`~.appearance.drawn_as` says, so that a block
    that just stands has no turn. Its corners are numbered from the lowest, of these from the front,
    of these from the left.

    Args:
        origin: O, float64[3] [m, world].
        joint: width of vertical joints of a lattice [m].
        named: the blocks; shapes have letters in the order in which these come.
    """

    def __init__(self, origin: np.ndarray, joint: float, named: Sequence[Named]) -> None:
        self.origin = origin
        self.joint = joint
        told = dict[str, tuple[_KindShape, _Match]]()
        for members in _may_be_alike(named):
            self._tell(members, told)
        # Letters follow the blocks, whichever of them a shape is drawn by.
        letters = dict[int, BlockShape]()
        examples: list[tuple[_KindShape, Block]] = []
        for one in named:
            model, _ = told[one.block.id]
            if id(model) not in letters:
                letters[id(model)] = replace(model.shape, letter=_letter(len(letters)))
                examples.append((model, one.block))
        self.found: list[BlockShape] = list(letters.values())
        self._of: dict[str, tuple[BlockShape, _Match]] = {
            block: (letters[id(model)], match) for block, (model, match) in told.items()
        }
        self._examples = examples

    def _tell(self, members: list[list[Named]], told: dict[str, tuple[_KindShape, _Match]]) -> None:
        """Find the shapes of blocks that may be alike.

        Args:
            members: blocks that differ in their place alone, in a list each.
            told: of every block by its id, filled.
        """
        while members:
            left = list[list[Named]]()
            blocks = [one.block for same in members for one in same]
            drawn, turning = drawn_as(blocks)
            model = _model(members[0][0], blocks[drawn], turning, self.joint)
            for same in members:
                match = _turned(model, same[0].block)
                if match is None:
                    left.append(same)  # A mirror image, or another order of the same corners.
                else:
                    told.update((one.block.id, (model, match)) for one in same)
            assert len(left) < len(members)
            members = left

    def shape(self, block: Block) -> BlockShape:
        """The shape of one of the blocks."""
        return self._of[block.id][0]

    def but_for_colour(self) -> dict[str, BlockShape]:
        """Of the letter of every shape, the first shape that is the same but for its colour."""
        found = dict[str, BlockShape]()
        first: list[tuple[BlockShape, _KindShape]] = []
        for shape, (model, block) in zip(self.found, self._examples, strict=True):
            same = (
                one
                for one, other in first
                if (one.kind, len(one.corners)) == (shape.kind, len(shape.corners))
                and one.colour != shape.colour
                and _turned(other, block) is not None
            )
            found[shape.letter] = next(same, shape)
            if found[shape.letter] is shape:
                first.append((shape, model))
        return found

    def pose(self, block: Block) -> ToldPose:
        """How one of the blocks is told."""
        shape, (turn, first) = self._of[block.id]
        at = block.vertices.min(0) if first is None else block.vertices[first]
        x, y, z = (at - self.origin).tolist()
        return ToldPose(shape, (x, y, z), turn)


def _may_be_alike(named: Sequence[Named]) -> list[list[list[Named]]]:
    """Blocks of one name and colour, one volume and the same distances of corners: mirror images
    may be among them. Blocks that differ in their place alone are in a list of their own."""
    placed: dict[object, list[Named]] = {}
    for one in named:
        points = one.block.vertices - one.block.vertices.min(0)
        key = one.kind, one.colour, one.block.faces, (points / _FINE).round().tobytes()
        placed.setdefault(key, []).append(one)
    like: dict[object, list[tuple[np.ndarray, float, list[list[Named]]]]] = {}
    for same in placed.values():
        block = same[0].block
        apart, volume = spread(block.vertices), block.volume
        known = like.setdefault((same[0].kind, same[0].colour, len(block.vertices)), [])
        for distances, size, members in known:
            near = np.abs(distances - apart).max() <= _ALIKE
            if near and abs(size - volume) <= 1e-3 * volume:
                members.append(same)
                break
        else:
            known.append((apart, volume, [same]))
    return [members for known in like.values() for *_, members in known]


def _letter(number: int) -> str:
    """A to Z, then AA to AZ and so on."""
    letter, left = "", number
    while not letter or left >= 0:
        letter, left = chr(65 + left % 26) + letter, left // 26 - 1
    return letter


@dataclass(frozen=True, eq=False)
class _KindShape:
    """A shape with its corners in the order of the block by which it is drawn."""

    shape: BlockShape
    corners: np.ndarray
    """float64[V, 3]: unturned, from the corner that is the first of the shape [m]."""
    faces: tuple[tuple[int, ...], ...]
    first: int
    """Which corner is the first of the shape."""


def _model(named: Named, block: Block, turning: np.ndarray, joint_width: float) -> _KindShape:
    """A shape without a letter.

    Args:
        named: what it is called.
        block: by which it is drawn.
        turning: of that block.
        joint_width: of vertical joints of a lattice [m].
    """
    corners = block.vertices @ turning.T
    rows = ((corners - corners.min(0)) / _GRAIN).round()
    order = np.lexsort((rows[:, 0], rows[:, 1], rows[:, 2]))
    first, place = int(order[0]), np.argsort(order).tolist()
    corners = corners - corners[first]
    size = np.ptp(corners, axis=0)
    is_box = abs(size.prod() - block.volume) <= 1e-6 * size.prod() and block.is_convex
    joint = np.array([joint_width, joint_width, 0.0])
    square = is_square(block) and block.kind != POST
    x, y, z = (size + (joint if square else 0)).tolist()
    shape = BlockShape(
        "",
        named.kind,
        named.colour,
        named.colour == colour_words(block),
        corners[order],
        tuple(tuple(place[k] for k in face) for face in block.faces),
        bool(is_box),
        (x, y, z),
        block.volume,
        block.mass,
    )
    return _KindShape(shape, corners, block.faces, first)


class _Match(NamedTuple):
    """How a block is turned from its shape."""

    turn: Turn
    first: int | None
    """Of a block that is turned by other than quarters: its vertex at which the first corner of the
    shape lies."""


def _turned(model: _KindShape, block: Block) -> _Match | None:
    """How a block is turned from a shape; None where it is another shape, such as its mirror image.

    Quarters come before other turns, and small turns before large ones.
    """
    points = block.vertices - block.vertices.min(0)
    size = points.max(0)
    for turn in _QUARTERS:
        turned = model.corners @ rotation(turn).T
        turned = turned - turned.min(0)
        # What is as near as that is as large; most turns are none by this.
        alike = np.abs(turned.max(0) - size).max() <= 3 * _GRAIN
        if alike and _apart(turned, points) <= _GRAIN:
            return _Match(turn, None)
    found = list[tuple[float, Turn, int | None]]()
    for first, turning in _alignments(model, block):
        turn = _angles(turning)
        leans = any(angle % 90 for angle in turn)
        found.append((sum(map(abs, turn)), turn, first if leans else None))
    if not found:
        return None
    _, turn, first = min(found, key=lambda one: one[:2])
    return _Match(turn, first)


def _apart(some: np.ndarray, others: np.ndarray) -> float:
    """The largest distance of a point of either set from the nearest of the other [m]."""
    from scipy import spatial  # pyright: ignore[reportMissingTypeStubs]

    library: Any = spatial
    there = library.KDTree(others).query(some)[0]
    back = library.KDTree(some).query(others)[0]
    return float(max(there.max(), back.max()))


def _alignments(model: _KindShape, block: Block) -> Iterator[tuple[int, np.ndarray]]:
    """The ways to lay a shape on a block: where its first corner comes to lie, and the rotation."""
    corners, vertices, a = model.corners, block.vertices, model.first
    away = np.linalg.norm(corners, axis=1)
    b = int(away.argmax())
    twice = np.linalg.norm(np.cross(corners, corners[b]), axis=1)
    c = int(twice.argmax())
    # Not so much that corners of a small block stand for one another.
    alike = min(_ALIKE, _SLIM * float(twice[c] / away[b]))
    if model.faces == block.faces:
        turning = _rotation_between(corners, vertices - vertices[a])
        if np.abs(corners @ turning.T - (vertices - vertices[a])).max() <= alike:
            yield a, turning
    if not block.is_convex or len(corners) > _MOST_TRIED:
        return  # The corners alone do not say what it is, or there are too many to try.
    # Three corners of the shape, and all corners of the block as far from one another.
    apart = np.linalg.norm(vertices[:, None] - vertices, axis=-1)
    near = 2 * alike
    for i, j in np.argwhere(np.abs(apart - away[b]) <= near).tolist():
        third = np.abs(apart[i] - away[c]) <= near
        third &= np.abs(apart[j] - np.linalg.norm(corners[b] - corners[c])) <= near
        for k in np.flatnonzero(third).tolist():
            sides = vertices[j] - vertices[i], vertices[k] - vertices[i]
            if np.linalg.norm(np.cross(*sides)) <= _SLIM * twice[c]:
                continue  # They lie on a line, and say no turn about it.
            turning = _frame(*vertices[[i, j, k]]) @ _frame(*corners[[a, b, c]]).T
            turned = corners @ turning.T + vertices[i]
            if _apart(turned, vertices) > 3 * alike:
                continue
            # All corners together say the turn better than three.
            order = np.linalg.norm(turned[:, None] - vertices, axis=-1).argmin(1)
            turning = _rotation_between(corners, vertices[order] - vertices[i])
            if np.abs(corners @ turning.T + vertices[i] - vertices[order]).max() <= alike:
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
