"""Instructions to build an assembly by hand: what cards and PDF both draw.

Lengths are told from one corner, *O*: the front left lower corner of the box round what stands in
the end; x goes to the right, y to the back, z up. A block is told by its shape, a position and a
turn, which are enough to put it exactly where it belongs (:func:`corners_at`).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import product

import numpy as np

from learn2assemble.assembly.appearance import (
    is_prism,
    is_square,
    joint_width,
    kinds_and_colours,
    sections,
)
from learn2assemble.assembly.blocks import Assembly, Block

MOST_TOGETHER = 6
"""Blocks of one step of the instructions."""
_COVERED = 0.98
"""Share of a bed face that rests on what is below, where a block is carried straight down; the rest
is open joints."""
_GRAIN = 1e-5
"""Shapes that differ by less are one [m]."""
_QUARTERS = tuple(
    (x, y, z) for (x, y), z in product(
        ((0, 0), (90, 0), (180, 0), (270, 0), (0, 90), (0, 270)), (0, 90, 180, 270)
    )
)  # fmt: skip
"""The 24 ways to lay a block on one of its sides, as turns about x, y and z [deg]."""


@dataclass(frozen=True, eq=False)
class Shape:
    """A kind of block of one size."""

    letter: str
    kind: str
    colour: str
    """``#rrggbb``, or a name of :data:`~learn2assemble.assembly.appearance.COLOURS`."""
    corners: np.ndarray
    """float64[V, 3]: unturned, from the first corner [m]."""
    faces: tuple[tuple[int, ...], ...]
    """Indices of corners, counter-clockwise from outside."""
    is_box: bool
    nominal: tuple[float, float, float]
    """Extents with the joint that belongs to the block [m]."""
    mass: float
    """[kg]"""

    @property
    def size(self) -> np.ndarray:
        """float64[3]: extents of the block itself, unturned [m]."""
        return np.ptp(self.corners, axis=0)


@dataclass(frozen=True, eq=False)
class Placement:
    """Where a block goes, or where a prop is taken away."""

    number: int
    """The step of the assembly, from 1; 0: it stands from the start."""
    block: int
    """Index in the assembly."""
    shape: Shape
    position: tuple[float, float, float]
    """From O [m]: of a block that is turned by quarters, the front left lower corner of the box
    round it; of a block that leans, its corner 1."""
    turn: tuple[float, float, float]
    """Turns about x, then y, then z, counter-clockwise against the axis [deg]."""
    remove: bool = False
    prop: bool = False

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

    @property
    def wanted(self) -> list[tuple[Shape, int]]:
        """Shapes and how many of each the step takes."""
        count = Counter(id(p.shape) for p in self.placements if not p.remove)
        shapes = {id(p.shape): p.shape for p in self.placements}
        return [(shapes[key], number) for key, number in count.items()]


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
    shapes: tuple[Shape, ...]
    start: tuple[Placement, ...]
    """What stands from the start."""
    groups: tuple[Group, ...]

    @property
    def bill(self) -> list[tuple[Shape, int, int]]:
        """Every shape, how many are built in, and how many serve as props at one time."""
        built: Counter[str] = Counter()
        props: Counter[str] = Counter()
        most: Counter[str] = Counter()
        for placement in (p for group in self.groups for p in group.placements):
            letter = placement.shape.letter
            if placement.prop:
                props[letter] += -1 if placement.remove else 1
                most |= props
            else:
                built[letter] += 1
        used = [s for s in self.shapes if built[s.letter] or most[s.letter]]
        return [(s, built[s.letter], most[s.letter]) for s in used]


def rotation(turn: tuple[float, float, float]) -> np.ndarray:
    """float64[3, 3]: turns about x, then y, then z [deg]."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def corners_at(
    corners: np.ndarray, position: tuple[float, float, float], turn: tuple[float, float, float]
) -> np.ndarray:
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
    so that whatever is placed first stands. At most :data:`MOST_TOGETHER`. All others are steps of
    their own. Blocks without steps are told one by one in the order they are given.
    """
    finished = np.concatenate([block.vertices for block in assembly.finished.blocks])
    origin, high = finished.min(0), finished.max(0)
    joint = joint_width(assembly)
    shapes = _Shapes(origin, joint)
    for block, (kind, colour) in zip(assembly.blocks, kinds_and_colours(assembly), strict=True):
        shapes.add(block, kind, colour)
    steps = [(assembly.index(s.place or s.remove or ""), s.remove is not None)
             for s in assembly.steps]  # fmt: skip
    steps = steps or [(k, False) for k, b in enumerate(assembly.blocks) if not b.support]
    placed = {index for index, _ in steps}
    start = tuple(shapes.placement(k, 0, assembly.blocks[k], False)
                  for k in range(len(assembly.blocks)) if k not in placed)  # fmt: skip
    upright = _carried_straight_down(assembly)
    return Instructions(
        assembly, origin, high - origin, joint, tuple(shapes.found), start,
        tuple(_groups(assembly, steps, shapes, upright)),
    )  # fmt: skip


def _groups(
    assembly: Assembly, steps: list[tuple[int, bool]], shapes: _Shapes, upright: np.ndarray
) -> list[Group]:
    bottoms = np.array([block.vertices[:, 2].min() for block in assembly.blocks])
    heights = bottoms - shapes.origin[2]
    layers: list[float] = []
    for height in np.sort(heights[[index for index, _ in steps]]).tolist():
        if not layers or height > layers[-1] + 1e-4:
            layers.append(height)
    together: list[list[tuple[int, int, bool]]] = []
    free = False
    for number, (index, remove) in enumerate(steps, 1):
        block = assembly.blocks[index]
        alone = remove or block.prop or not upright[index]
        last = together[-1][-1][1] if together else index
        joins = free and not alone and abs(heights[index] - heights[last]) <= 1e-4
        if joins and len(together[-1]) < MOST_TOGETHER:
            together[-1].append((number, index, remove))
        else:
            together.append([(number, index, remove)])
        free = not alone
    found, seen = [], set()
    for number, members in enumerate(together, 1):
        height = float(heights[members[0][1]])
        layer = int(np.searchsorted(np.array(layers) - 1e-9, height, side="right"))
        placements = tuple(shapes.placement(index, at, assembly.blocks[index], remove)
                           for at, index, remove in members)  # fmt: skip
        first = layer not in seen and not members[0][2]
        seen |= {layer} if first else set()
        found.append(Group(number, placements, layer, height, first))
    return found


def _carried_straight_down(assembly: Assembly) -> np.ndarray:
    """bool[B]: whether the column below a block is filled down to the ground.

    Its weight then goes straight down, whatever else stands, so no order can make it fall.
    """
    import shapely

    prisms = [is_prism(block) for block in assembly.blocks]
    areas = [sections(b)[0].area if good else shapely.Point()
             for b, good in zip(assembly.blocks, prisms, strict=True)]  # fmt: skip
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
        below = [j for j in tree.query(areas[k]).tolist()
                 if filled[j] and abs(high[j] - low[k]) <= 1e-5]  # fmt: skip
        carried = sum(areas[k].intersection(areas[j]).area for j in below)
        filled[k] = carried >= _COVERED * areas[k].area
    return filled


class _Shapes:
    """The shapes of an assembly, and how each block is turned from its shape."""

    def __init__(self, origin: np.ndarray, joint: float) -> None:
        self.origin, self.joint = origin, joint
        self.found: list[Shape] = []
        self._quarters: dict[tuple, tuple[Shape, tuple[float, float, float]]] = {}
        self._distances: dict[tuple, list[Shape]] = {}
        self._of: dict[str, tuple[Shape, tuple[float, float, float]]] = {}
        self._known: dict[tuple, tuple[Shape, tuple[float, float, float]]] = {}

    def add(self, block: Block, kind: str, colour: str) -> None:
        """Find the shape and the turn of a block."""
        words = kind, colour
        points = block.vertices - block.vertices.min(0)
        as_given = (*words, block.faces, np.round(points / _GRAIN).tobytes())
        if as_given not in self._known:
            self._known[as_given] = self._match(block, points, words)
        self._of[block.id] = self._known[as_given]

    def _match(
        self, block: Block, points: np.ndarray, words: tuple[str, str]
    ) -> tuple[Shape, tuple[float, float, float]]:
        key = (*words, *_key(points, block.volume))
        if key in self._quarters:
            return self._quarters[key]
        apart = np.linalg.norm(block.vertices[:, None] - block.vertices[None], axis=-1)
        alike = (*words, block.faces, np.round(apart / 1e-4).tobytes())
        for shape in self._distances.get(alike, []):
            turn = _turn_between(shape.corners, block.vertices)
            if turn is not None:
                return shape, turn
        corners = block.vertices @ _laid_down(block).T
        corners = corners - corners[0]
        shape = self._new(block, corners, *words)
        self._distances.setdefault(alike, []).append(shape)
        for turn in _QUARTERS:
            turned = corners @ rotation(turn).T
            variant = (*words, *_key(turned - turned.min(0), block.volume))
            self._quarters.setdefault(variant, (shape, turn))
        if key in self._quarters:
            return self._quarters[key]
        turn = _turn_between(corners, block.vertices)
        assert turn is not None
        return shape, turn

    def _new(self, block: Block, corners: np.ndarray, kind: str, colour: str) -> Shape:
        size = np.ptp(corners, axis=0)
        is_box = abs(size.prod() - block.volume) <= 1e-6 * size.prod() and block.is_convex
        joint = np.array([self.joint, self.joint, 0.0])
        x, y, z = (size + (joint if is_square(block) else 0)).tolist()
        letter, left = "", len(self.found)
        while not letter or left >= 0:
            letter, left = chr(65 + left % 26) + letter, left // 26 - 1
        nominal = (x, y, z)
        made = Shape(letter, kind, colour, corners, block.faces, bool(is_box), nominal, block.mass)
        self.found.append(made)
        return made

    def placement(self, index: int, number: int, block: Block, remove: bool) -> Placement:
        shape, turn = self._of[block.id]
        leans = any(angle % 90 for angle in turn)
        at = block.vertices[0] if leans else block.vertices.min(0)
        x, y, z = (at - self.origin).tolist()
        return Placement(number, index, shape, (x, y, z), turn, remove, block.prop)


def _key(points: np.ndarray, volume: float) -> tuple:
    whole = np.unique(np.round(points / _GRAIN).astype(np.int64), axis=0)
    return whole.tobytes(), round(volume / 1e-9)


def _laid_down(block: Block) -> np.ndarray:
    """float64[3, 3]: turns a block onto its largest face, its longest edge along x; a block that
    has a level face below, or edges along the axes, is left as it is."""
    if is_square(block) or is_prism(block):
        return np.eye(3)
    normals = []
    for face in block.faces:
        corners = block.vertices[list(face)]
        normals.append(np.cross(corners - corners[0], np.roll(corners, -1, 0) - corners[0]).sum(0))
    largest = int(np.argmax([np.linalg.norm(n) for n in normals]))
    down = normals[largest] / np.linalg.norm(normals[largest])
    corners = block.vertices[list(block.faces[largest])]
    edges = np.roll(corners, -1, 0) - corners
    edge = edges[int(np.argmax(np.linalg.norm(edges, axis=1)))]
    edge = edge - (edge @ down) * down
    along = edge / np.linalg.norm(edge)
    return np.stack([along, np.cross(-down, along), -down])


def _turn_between(corners: np.ndarray, vertices: np.ndarray) -> tuple[float, float, float] | None:
    """Turns about x, y and z [deg] from a shape to a block; None for one that is not congruent."""
    goal = vertices - vertices[0]
    u, _, vt = np.linalg.svd(corners.T @ goal)
    turn = vt.T @ np.diag([1, 1, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    if np.abs(corners @ turn.T - goal).max() > 1e-4:
        return None
    about_y = float(np.degrees(np.arcsin(np.clip(-turn[2, 0], -1, 1))))
    if abs(turn[2, 0]) < 1 - 1e-9:
        about_x = float(np.degrees(np.arctan2(turn[2, 1], turn[2, 2])))
        about_z = float(np.degrees(np.arctan2(turn[1, 0], turn[0, 0])))
    else:
        about_x, about_z = 0.0, float(np.degrees(np.arctan2(-turn[0, 1], turn[1, 1])))
    x, y, z = (round(angle, 3) + 0.0 for angle in (about_x, about_y, about_z))
    return x, y, z
