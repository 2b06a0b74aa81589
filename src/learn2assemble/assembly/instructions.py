"""Instructions to build an assembly by hand: what cards and PDF both draw.

Lengths are told from one corner, *O*: the front left lower corner of the box round what stands in
the end; x goes to the right, y to the back, z up. A block is told by its shape, a position and a
turn, which are enough to put it exactly where it belongs (:func:`corners_at`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from learn2assemble.assembly.appearance import (
    colour_words,
    is_prism,
    is_square,
    joint_width,
    kinds_and_colours,
    laid_down,
    sections,
    spread,
)
from learn2assemble.assembly.blocks import Action, Assembly, AssemblyStep, Block
from learn2assemble.assembly.cuts import POST, Cut, cut_of

MOST_TOGETHER = 6
"""Blocks of one step of the instructions."""
_COVERED = 0.98
"""Share of a bed face that rests on what is below, where a block is carried straight down; the rest
is open joints."""
_GRAIN = 2e-5
"""Blocks that a turn by quarters brings together but for so much are of one shape [m]."""
_FINE = 1e-7
"""Blocks that differ by less are not looked at twice [m]."""
_ALIKE = 1e-4
"""So much may the corners of a block be off those of its shape, where it leans [m]."""
_MOST_TRIED = 60
"""Corners of a block whose order is sought."""
_CHANGE = {"place": 1, "remove": -1}
"""What actions change the number of blocks by that stand."""
Turn = tuple[float, float, float]
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


@dataclass(frozen=True, eq=False)
class Placement:
    """What a step does to a block, and where that is."""

    number: int
    """The step of the assembly, from 1; 0: it stands from the start."""
    block: int
    """Index in the assembly."""
    shape: BlockShape
    position: tuple[float, float, float]
    """From O [m]: of a block that is turned by quarters, the front left lower corner of the box
    round it; of a block that leans, its corner 1."""
    turn: Turn
    """Turns about x, then y, then z, counter-clockwise against the axis [deg]."""
    action: Action = "place"
    prop: bool = False
    by_hand: bool = False
    """Whether a person does it while an arm waits."""
    way: str | None = None
    """Whence a brick comes that does not come from above: ``below`` or ``beside``."""
    wait: float | None = None
    """Hours that one waits before it, until mortar holds."""

    @property
    def leans(self) -> bool:
        """Whether it is turned by other than quarters."""
        return any(angle % 90 for angle in self.turn)


@dataclass(frozen=True)
class Group:
    """One step of the instructions."""

    number: int
    placements: tuple[Placement, ...]
    layer: int
    """From 1."""
    level: float
    """Height of the layer over O [m]."""
    first: bool
    """Whether the layer begins with it."""
    held: frozenset[int] = frozenset()
    """Blocks that hands hold when it is done."""

    @property
    def wanted(self) -> list[tuple[BlockShape, int]]:
        """Shapes and how many of each the step takes."""
        count = Counter(id(p.shape) for p in self.placements if p.action == "place")
        shapes = {id(p.shape): p.shape for p in self.placements}
        return [(shapes[key], number) for key, number in count.items()]


class BillLine(NamedTuple):
    """How many blocks of a shape there have to be."""

    shape: BlockShape
    built: int
    """Placed, and there in the end."""
    props: int
    """The most that serve as props at one time."""
    standing: int
    """There from the start."""


@dataclass(frozen=True, eq=False)
class Instructions:
    """How an assembly is built by hand."""

    assembly: Assembly
    origin: np.ndarray
    """float64[3]: O [m, world]."""
    extent: np.ndarray
    """float64[3]: of what stands in the end [m]."""
    joint: float
    """Width of vertical joints of a lattice [m]; 0 where there are none."""
    shapes: tuple[BlockShape, ...]
    start: tuple[Placement, ...]
    """What stands from the start."""
    groups: tuple[Group, ...]

    @property
    def in_order(self) -> bool:
        """Whether blocks of one step are placed in the order of their numbers, not in any."""
        return self.assembly.joint.law == "clutch"

    @property
    def bill(self) -> list[BillLine]:
        """What is needed of every shape."""
        built: Counter[str] = Counter()
        props: Counter[str] = Counter()
        most: Counter[str] = Counter()
        needed: Counter[str] = Counter()
        there = Counter(placement.shape.letter for placement in self.start)
        for placement in (p for group in self.groups for p in group.placements):
            letter = placement.shape.letter
            change = _CHANGE.get(placement.action, 0)
            if placement.prop:
                props[letter] += change
                most |= props
            else:
                # What has been taken away may come again elsewhere.
                built[letter] += change
                needed |= built
        lines = [
            BillLine(s, needed[s.letter], most[s.letter], there[s.letter]) for s in self.shapes
        ]
        return [line for line in lines if any(line[1:])]

    @property
    def placements(self) -> list[Placement]:
        """What is done to which block, in order."""
        return [placement for group in self.groups for placement in group.placements]


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
        position: as :class:`Placement` says.
        turn: as :class:`Placement` says [deg].
    """
    turned = corners @ rotation(turn).T
    if all(angle % 90 == 0 for angle in turn):
        turned = turned - turned.min(0)
    return turned + np.array(position)


def instructions(assembly: Assembly) -> Instructions:
    """The instructions to build an assembly, step by step.

    Several blocks are one step where nothing is at stake: blocks of one layer that follow one
    another in the order of building, none of them a prop, each carried straight down to the ground,
    so that whatever is placed first stands. Bricks that clutch are one step wherever they are in a
    layer, as they are placed in the order that is proven. At most :data:`MOST_TOGETHER`. All others
    are steps of their own. Blocks without steps are told one by one in the order they are given.
    """
    finished = np.concatenate([block.vertices for block in assembly.finished.blocks])
    origin, high = finished.min(0), finished.max(0)
    joint = joint_width(assembly)
    shapes = _Shapes(origin, joint)
    left_out = set(assembly.not_built)
    for block, (kind, colour) in zip(assembly.blocks, kinds_and_colours(assembly), strict=True):
        if block.id not in left_out:
            shapes.add(block, kind, colour)
    steps: list[tuple[int, Action]] = [(assembly.index(s.block), s.action) for s in assembly.steps]
    steps = steps or [(k, "place") for k, b in enumerate(assembly.blocks) if not b.support]
    told = assembly.at_first if assembly.steps else [b.support for b in assembly.blocks]
    start = tuple(
        shapes.placement(k, 0, assembly.blocks[k], "place") for k, there in enumerate(told) if there
    )
    upright = _carried_straight_down(assembly)
    return Instructions(
        assembly,
        origin,
        high - origin,
        joint,
        tuple(shapes.found),
        start,
        tuple(_groups(assembly, steps, shapes, upright)),
    )


def _groups(
    assembly: Assembly, steps: list[tuple[int, Action]], shapes: _Shapes, upright: np.ndarray
) -> list[Group]:
    bottoms = np.array([block.vertices[:, 2].min() for block in assembly.blocks])
    heights = bottoms - shapes.origin[2]
    layers: list[float] = []
    for height in np.sort(heights[[index for index, _ in steps]]).tolist():
        if not layers or height > layers[-1] + 1e-4:
            layers.append(height)
    said = dict(enumerate(assembly.steps, 1))
    alone_ = {n for n, step in said.items() if step.by_hand or step.way or step.wait}
    together: list[list[tuple[int, int, Action]]] = []
    free, clutches = False, assembly.joint.law == "clutch"
    # Where blocks of the structure go, what is below at last may not be there yet.
    goes = any(action == "remove" and not assembly.blocks[k].prop for k, action in steps)
    for number, (index, action) in enumerate(steps, 1):
        block = assembly.blocks[index]
        alone = action != "place" or block.prop or number in alone_ or goes
        # Bricks come in the proven order, so nothing is at stake however they stand.
        alone = alone or not (upright[index] or clutches)
        last = together[-1][-1][1] if together else index
        joins = free and not alone and abs(heights[index] - heights[last]) <= 1e-4
        if joins and len(together[-1]) < MOST_TOGETHER:
            together[-1].append((number, index, action))
        else:
            together.append([(number, index, action)])
        free = not alone
    found, seen, held = [], set(), frozenset[int]()
    for number, members in enumerate(together, 1):
        height = float(heights[members[0][1]])
        layer = int(np.searchsorted(np.array(layers) - 1e-9, height, side="right"))
        placements = tuple(
            _told(shapes.placement(index, at, assembly.blocks[index], action), said.get(at))
            for at, index, action in members
        )
        _, index, action = members[0]
        first = layer not in seen and action == "place"
        seen |= {layer} if first else set()
        held = held ^ {index} if action in ("hold", "release") else held
        found.append(Group(number, placements, layer, height, first, held))
    return found


def _told(placement: Placement, step: AssemblyStep | None) -> Placement:
    """With what a step says besides."""
    if step is None:
        return placement
    return replace(placement, by_hand=bool(step.by_hand), way=step.way, wait=step.wait)


def _carried_straight_down(assembly: Assembly) -> np.ndarray:
    """bool[B]: whether the column below a block is filled down to the ground.

    Its weight then goes straight down, whatever else stands, so no order can make it fall.
    """
    import shapely

    prisms = [is_prism(block) for block in assembly.blocks]
    areas = [
        sections(b)[0].area if good else shapely.Point()
        for b, good in zip(assembly.blocks, prisms, strict=True)
    ]
    low = np.array([block.vertices[:, 2].min() for block in assembly.blocks])
    high = np.array([block.vertices[:, 2].max() for block in assembly.blocks])
    floor = min(0.0, float(low.min())) if abs(low.min()) > 1e-6 else float(low.min())
    tree = shapely.STRtree(areas)
    filled = np.zeros(len(areas), bool)
    for k in np.argsort(low, kind="stable").tolist():
        block = assembly.blocks[k]
        if not prisms[k] or block.prop:
            continue
        if block.support or abs(low[k] - floor) <= 1e-5:
            filled[k] = True
            continue
        below = [
            j for j in tree.query(areas[k]).tolist() if filled[j] and abs(high[j] - low[k]) <= 1e-5
        ]
        carried = sum(areas[k].intersection(areas[j]).area for j in below)
        filled[k] = carried >= _COVERED * areas[k].area
    return filled


class _Shapes:
    """The shapes of an assembly, and how each block is turned from its shape."""

    def __init__(self, origin: np.ndarray, joint: float) -> None:
        self.origin, self.joint = origin, joint
        self.found: list[BlockShape] = []
        self._like: dict[tuple, list[tuple[BlockShape, np.ndarray]]] = {}
        self._of: dict[str, _Match] = {}
        self._known: dict[tuple, _Match] = {}

    def add(self, block: Block, kind: str, colour: str) -> None:
        """Find the shape and the turn of a block."""
        points = block.vertices - block.vertices.min(0)
        as_given = (kind, colour, block.faces, np.round(points / _FINE).tobytes())
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

    def placement(self, index: int, number: int, block: Block, action: Action) -> Placement:
        match = self._of[block.id]
        at = block.vertices.min(0) if match.first is None else block.vertices[match.first]
        x, y, z = (at - self.origin).tolist()
        return Placement(number, index, match.shape, (x, y, z), match.turn, action, block.prop)


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
    found = []
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
    from scipy.spatial import KDTree

    there, back = KDTree(others).query(some)[0], KDTree(some).query(others)[0]
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
