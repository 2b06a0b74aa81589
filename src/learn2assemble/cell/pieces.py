"""Blocks as an arm carries them: which may stand for which, how they wait, and where they go.

Blocks whose corners are the same up to a rotation and a shift have one shape, whatever their poses
in the structure, and come from one magazine. There a block lies on a face on which it rests by
itself: the one from which the tool has to be tilted least to turn it into its pose.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.assembly.instructions.appearance import millimetres
from learn2assemble.assembly.parts import convex_parts, upright_boxes
from learn2assemble.errors import InputError
from learn2assemble.geometry.hulls import (
    hull_of,
    resting_turns,
    rotations_onto,
)
from learn2assemble.geometry.rotations import (
    matrix_quaternion,
    quaternion_matrix,
    yaw_matrix,
)
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.bodies import Part, Shape, body_of
from learn2assemble.robot.grasps import UPRIGHT as STRAIGHT
from learn2assemble.robot.holding import ways_to_turn
from learn2assemble.values import three

AWAY = 90.0
"""No structure that an arm builds is farther from the origin [m]."""
CENTRED = 0.15
"""A structure whose middle is nearer to the origin stands there [m]."""
QUARTER = math.pi / 2
GRAIN = 2e-6
"""Corners that differ by less are one [m]."""
_EXACT = 1e-5
"""A turn that is off one along the axes by less is that one [rad]."""
_DOWN = 1 - 1e-9
"""Of the normal of a face that points down."""
ON_TABLE = 1e-3
"""What begins, or ends, no farther from it does so at the table [m]."""


class Pose(NamedTuple):
    """Where something stands on the table."""

    x: float
    """[m], like y."""
    y: float
    yaw: float = 0.0
    """[rad]"""


@dataclass(frozen=True, eq=False)
class Piece:
    """A block of the plan, as parts that are glued together."""

    id: str
    kind: str
    prop: bool
    density: float
    """[kg/m³]"""
    shape: Shape
    """Its parts; equal for all blocks that can stand for one another."""
    target: np.ndarray
    """float64[3]: origin of the shape's frame in the finished structure [m]."""
    turn: np.ndarray
    """float64[3, 3]: rotation of that frame there."""
    rest: np.ndarray
    """float64[3, 3]: rotation of that frame as the block waits, at yaw 0."""
    fixed: bool = False
    """Whether it is a support: it stands there from the first, and nothing moves it."""

    @property
    def sunk(self) -> bool:
        """Whether it is a support that ends at the table: arms know it as that."""
        return self.fixed and self.top <= ON_TABLE

    @property
    def half(self) -> np.ndarray:
        """float64[3]: half extents of the bounding box in the frame of the shape [m]."""
        return body_of(self.shape).half

    @property
    def mass(self) -> float:
        """[kg]"""
        return self.density * body_of(self.shape).volume

    @property
    def yaw(self) -> float:
        """Of the shape's frame in the structure [rad]."""
        return math.atan2(self.turn[1, 0], self.turn[0, 0])

    @cached_property
    def pose(self) -> np.ndarray:
        """float64[7]: in the finished structure: position [m] and quaternion (w, x, y, z)."""
        return np.array([*self.target, *matrix_quaternion(self.turn)])

    @property
    def waits(self) -> np.ndarray:
        """float64[7]: the pose in which it waits, at the origin."""
        return self.waiting(Pose(0.0, 0.0))

    @cached_property
    def extent(self) -> tuple[np.ndarray, np.ndarray]:
        """Its bounds there: lowest and highest coordinates, float64[3] each [m]."""
        points = self.corners(self.pose)
        return points.min(0), points.max(0)

    @property
    def top(self) -> float:
        """Of it in the finished structure [m]."""
        return float(self.extent[1][2])

    def waiting(self, at: Pose) -> np.ndarray:
        """float64[7]: its pose where it waits at a place on the table."""
        return waiting(self.shape, at, self.rest)

    def corners(self, pose: np.ndarray) -> np.ndarray:
        """float64[V, 3]: its corners at a pose float64[7] [m]."""
        return pose[:3] + body_of(self.shape).points @ quaternion_matrix(pose[3:]).T

    def face(self) -> Any:
        """What it covers in the finished structure, as a shapely area."""
        return covered(self.shape, self.pose)

    def foot(self) -> Any:
        """What of it lies on what is below its lowest point in the finished structure, as a shapely
        area."""
        import shapely

        points = self.corners(self.pose)
        low = points[:, 2] < points[:, 2].min() + ON_TABLE
        return shapely.MultiPoint(points[low, :2]).convex_hull

    @property
    def name(self) -> str:
        """What messages call its kind."""
        return self.kind or millimetres(*(2 * self.half))

    def turns(self) -> tuple[np.ndarray, ...]:
        """Rotations that leave the shape as it is, the one that does nothing first."""
        return symmetries(self.shape)

    def lean(self, quaternion: np.ndarray, wanted: np.ndarray) -> float:
        """Angle between the vertical in its frame at an orientation and at the one it should have
        [rad]."""
        now, then = quaternion_matrix(quaternion)[2], quaternion_matrix(wanted)[2]
        cosine = max(float(now @ (then @ turn.T)) for turn in self.turns())
        return math.acos(min(1.0, cosine))

    def turned_by(self, quaternion: np.ndarray, wanted: np.ndarray) -> float:
        """Angle between an orientation and the one it should have [rad]; orientations in which it
        looks the same are one."""
        between = quaternion_matrix(wanted).T @ quaternion_matrix(quaternion)
        trace = max(float((between * turn).sum()) for turn in self.turns())
        return math.acos(float(np.clip((trace - 1) / 2, -1.0, 1.0)))


Turn = tuple[tuple[float, ...], ...]
"""Rows of a rotation from the frame of a shape."""
UPRIGHT: tuple[Turn, ...] = (((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),)
"""Of a block that lies as its frame has it."""


def turn_key(turn: np.ndarray) -> Turn:
    """A rotation as a value."""
    return tuple(map(tuple, (turn.round(9) + 0.0).tolist()))


def waiting(shape: Shape, at: Pose, rest: np.ndarray) -> np.ndarray:
    """float64[7]: the pose of a block that waits at a place on the table.

    Args:
        rest: float64[3, 3]: rotation in which it waits at yaw 0.
    """
    turn = yaw_matrix(at.yaw) @ rest
    height = -float((body_of(shape).points @ turn[2]).min())
    return np.array([at.x, at.y, height, *matrix_quaternion(turn)])


def covered(shape: Shape, pose: np.ndarray) -> Any:
    """What a block covers at a pose float64[7], as a shapely area."""
    import shapely

    turn = quaternion_matrix(pose[3:])
    return shapely.union_all(
        [shapely.MultiPoint((pose[:3] + part.points @ turn.T)[:, :2]).convex_hull for part in shape]
    )


def footprint(shape: Shape, at: Pose, rest: np.ndarray) -> Any:
    """What a block that waits covers, as a shapely area.

    Args:
        at: where.
        rest: float64[3, 3]: rotation in which it waits at yaw 0.
    """
    turn = matrix_quaternion(yaw_matrix(at.yaw) @ rest)
    return covered(shape, np.array([at.x, at.y, 0.0, *turn]))


@lru_cache(maxsize=4096)
def symmetries(shape: Shape) -> tuple[np.ndarray, ...]:
    """Rotations about the origin that leave a shape as it is, the one that does nothing first."""
    points = body_of(shape).hull.points
    middle, solid = points.mean(0), _solid(shape) if len(shape) > 1 else None
    found = list[np.ndarray]()
    for turn in map(_exact, rotations_onto(points, points, GRAIN)):
        if np.linalg.norm(turn @ middle - middle) > GRAIN:
            continue  # It is one about another point.
        if solid is not None:
            there = solid.transform(np.column_stack([turn, np.zeros(3)]))
            if (solid ^ there).volume() < (1 - 1e-4) * solid.volume():
                continue
        found.append(turn)
    found.sort(key=lambda turn: tuple((-turn[[2, 0, 1], [2, 0, 1]]).round(6)))
    return tuple(found)


def _solid(shape: Shape) -> Any:
    """A shape as solid of the library ``manifold3d``."""
    import manifold3d

    solid: Any = manifold3d.Manifold
    whole = solid()
    for part in shape:
        whole += solid.hull_points(part.points)
    return whole


# ---------------------------------------------------------------- from an assembly

PROP_ROOM = 3e-4
"""A prop is lower than the gap that it fills by this [m]: what it carries leans on it until enough
stands around, and then lifts off, so that the prop can be drawn out; builders have wedges for it.
With room from 0.1 to 0.5 mm a bridge of span 6 is built alike, without any it falls (measured)."""


class _Known(NamedTuple):
    kind: str
    shape: Shape
    corners: np.ndarray
    """float64[V, 3]: of the block in the shape's frame [m]."""
    volume: float


def pieces_of(assembly: Assembly) -> tuple[Piece, ...]:
    """The blocks of an assembly as an arm carries them, waiting as they stand in the structure
    where they rest so, else on their most stable face; level tops of props that others lie on are
    lower by :data:`PROP_ROOM`.

    Raises:
        InputError: for a block of too many convex parts.
    """
    planed, known = planed_props(assembly), list[_Known]()
    return tuple(_piece(b, PROP_ROOM if b.id in planed else 0.0, known) for b in assembly.blocks)


def planed_props(assembly: Assembly) -> frozenset[str]:
    """The props that are lower than their kind by :data:`PROP_ROOM`: those that carry others."""
    bottoms = [(b.vertices.min(0), b.vertices.max(0)) for b in assembly.blocks if not b.prop]
    return frozenset(b.id for b in assembly.blocks if b.prop and _carries(b, bottoms))


def _carries(block: Block, others: list[tuple[np.ndarray, np.ndarray]]) -> bool:
    """Whether a block of these bounds (low, high) begins where this one ends, above it."""
    low, high = block.vertices.min(0), block.vertices.max(0)
    return any(
        abs(a[2] - high[2]) < 1e-4 and (np.minimum(b, high) - np.maximum(a, low) > 1e-4)[:2].all()
        for a, b in others
    )


def _piece(block: Block, room: float, known: list[_Known]) -> Piece:
    if room:
        lower = np.array(block.vertices)
        lower[lower[:, 2] > lower[:, 2].max() - 1e-5, 2] -= room
        block = replace(block, vertices=lower)
    points = np.array(block.vertices)
    for one in known:
        if abs(one.volume - block.volume) > 1e-4 * one.volume:
            continue
        turns = [
            _exact(_fitted(one.corners, points, turn))
            for turn in rotations_onto(one.corners, points, GRAIN)
        ]
        if one.kind != block.kind:
            # Kinds that are one only when they are turned over wait in places of their own.
            turns = [turn for turn in turns if turn[2, 2] > _DOWN]
        if turns:
            break
    else:
        one, turn = _new_shape(block)
        known.append(one)
        turns = [turn]
    # Of several that look the same the most upright one, then the one with the least turn.
    turn = max(turns, key=lambda t: (round(float(t[2, 2]), 6), round(float(t[0, 0]), 6)))
    target = points.mean(0) - turn @ one.corners.mean(0)
    own = block.id, block.kind, block.prop, block.density
    piece = Piece(*own, one.shape, target, turn, np.eye(3), block.support)
    return replace(piece, rest=ways_to_rest(piece)[0])


def _fitted(one: np.ndarray, two: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """The rotation that brings the points best onto the others, from one that nearly does."""
    a, b = one - one.mean(0), two - two.mean(0)
    pairs = np.linalg.norm((a @ turn.T)[:, None] - b, axis=2).argmin(1)
    u, _, v = np.linalg.svd(b[pairs].T @ a)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v


def _exact(turn: np.ndarray) -> np.ndarray:
    """A rotation, exactly along the axes where it nearly is."""
    near = np.rint(turn)
    return near + 0.0 if np.abs(turn - near).max() < _EXACT else turn


def _new_shape(block: Block) -> tuple[_Known, np.ndarray]:
    """A shape from the first block of it, and the rotation from its frame to the world."""
    turn = _frame(block)
    corners = np.array(block.vertices) @ turn
    middle = (corners.min(0) + corners.max(0)) / 2
    parts = list[Part]()
    for ends in upright_boxes(corners - middle, block.faces):
        centre, half = ends.mean(1).round(9) + 0.0, (np.diff(ends)[:, 0] / 2).round(9)
        parts.append(Part(three(centre.tolist()), three(half.tolist())))
    for part in () if parts else [block] if block.is_convex else convex_parts(block):
        points = np.array(part.vertices) @ turn - middle
        low, high = points.min(0), points.max(0)
        centre, half = ((low + high) / 2).round(9) + 0.0, ((high - low) / 2).round(9)
        parts.append(Part(three(centre.tolist()), three(half.tolist()), hull_of(points - centre)))
    parts.sort(key=lambda part: part.centre)
    return _Known(block.kind, tuple(parts), corners - middle, block.volume), turn


def _frame(block: Block) -> np.ndarray:
    """float64[3, 3]: axes of a block's frame as columns: z up where it has a face that is level,
    else out of the face opposite to its largest; x along its longer side."""
    normals, areas, edges = list[np.ndarray](), list[float](), list[np.ndarray]()
    for face in block.faces:
        corners = np.array(block.vertices[list(face)])
        across = np.cross(corners - corners[0], np.roll(corners, -1, 0) - corners[0]).sum(0)
        size = float(np.linalg.norm(across))
        if size > 0:
            normals.append(across / size)
            areas.append(size)
        edges += list(np.roll(corners, -1, 0) - corners)
    unit = np.array(normals)
    if unit[:, 2].min() < -_DOWN:
        up = np.array([0.0, 0.0, 1.0])
    else:
        up = -unit[int(np.argmax(np.array(areas).round(9)))]
    along = np.array(edges)
    along = along - np.outer(along @ up, up)
    length = np.linalg.norm(along, axis=1)
    along = along[length > 0.2 * length.max()] / length[length > 0.2 * length.max(), None]
    return _exact(_squared(np.array(block.vertices), up, along))


def _squared(points: np.ndarray, up: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Axes of the smallest box about points that has an edge along one of some directions, the
    longer level side first."""
    best: tuple[tuple[float, ...], np.ndarray] | None = None
    for way in along:
        x, y = way, np.cross(up, way)
        a, b = float(np.ptp(points @ x)), float(np.ptp(points @ y))
        if b > a + 1e-7:
            x, y, a, b = y, -x, b, a
        if x[0] < -1e-9 or (abs(x[0]) <= 1e-9 and x[1] < 0):
            x, y = -x, -y
        key = (round(a * b, 9), round(-float(x[0]), 6), round(-float(x[1]), 6))
        if best is None or key < best[0]:
            best = key, np.stack([x, y, up], 1)
    assert best is not None
    return best[1]


# ---------------------------------------------------------------- how blocks wait


def ways_to_rest(piece: Piece) -> list[np.ndarray]:
    """Rotations in which a block can wait, as in the structure first if it rests so, then the most
    stable ones."""
    return [turn for turn, _ in _resting(piece.shape, three(piece.turn[2].round(6).tolist()))]


@lru_cache(maxsize=4096)
def _resting(shape: Shape, up: tuple[float, float, float]) -> tuple[tuple[np.ndarray, float], ...]:
    """Rotations and the margins with which a block rests, that nearest to ``up`` first."""
    body = body_of(shape)
    found = [
        (_levelled(shape, one.turn), one.margin) for one in resting_turns(body.hull, body.centre)
    ]
    as_built = [one for one in found if one[0][2] @ np.array(up) > math.cos(STRAIGHT)]
    return tuple(as_built + [one for one in found if not any(one is o for o in as_built)])


def _levelled(shape: Shape, turn: np.ndarray) -> np.ndarray:
    """A rotation with the yaw at which the block is longest along x: none where it lies on the
    face that its frame has below."""
    if turn[2, 2] > 1 - 1e-9:
        return np.eye(3)
    points = body_of(shape).points @ turn.T
    edges = np.array([turn @ edge for part in shape for edge in part.solid.edges])
    flat = edges - np.outer(edges[:, 2], [0, 0, 1])
    length = np.linalg.norm(flat, axis=1)
    ways = flat[length > 0.2] / length[length > 0.2, None]
    axes = _squared(points, np.array([0.0, 0.0, 1.0]), ways)
    return _exact(axes.T @ turn)


def with_rests(
    pieces: Sequence[Piece], arm: Arm, rests: Mapping[str, np.ndarray] = MappingProxyType({})
) -> tuple[Piece, ...]:
    """The pieces, waiting on the faces from which the tool of an arm turns them into their poses
    with the least tilt.

    Args:
        rests: rotations in which some of them wait all the same, by name.
    """
    known: dict[tuple[Shape, tuple[float, float, float]], np.ndarray] = {}
    out = list[Piece]()
    for piece in pieces:
        rest = rests.get(piece.id)
        if rest is None:
            key = piece.shape, three(piece.turn[2].round(6).tolist())
            if key not in known:
                known[key] = _best_rest(piece, arm)
            rest = known[key]
        out.append(replace(piece, rest=rest))
    return tuple(out)


def _best_rest(piece: Piece, arm: Arm) -> np.ndarray:
    goals = [piece.turn @ turn for turn in piece.turns()]
    best: tuple[tuple[float, float], np.ndarray] | None = None
    for turn in ways_to_rest(piece):
        ways = ways_to_turn(arm, piece.shape, turn, goals)
        if not ways:
            continue
        cost = float(ways[0].aside), float(round(math.degrees(ways[0].tilt)))
        if best is None or cost < best[0]:
            best = cost, turn
    return piece.rest if best is None else best[1]


def middle_of(pieces: Sequence[Piece]) -> np.ndarray:
    """float64[2]: where a structure stands, to the millimetre [m]: at the origin, as designs do, or
    elsewhere, as blocks may that are given.

    Raises:
        InputError: for one that is too far away for an arm to be said to stand there.
    """
    ends = np.array([piece.extent for piece in pieces])
    middle = (ends[:, 0].min(0) + ends[:, 1].max(0))[:2] / 2
    if np.linalg.norm(middle) > AWAY:
        got = f"blocks {np.linalg.norm(middle):.0f} m from the origin"
        raise InputError("design", got, f"blocks within {AWAY:g} m of it, for an arm")
    return np.zeros(2) if np.linalg.norm(middle) < CENTRED else middle.round(3)
