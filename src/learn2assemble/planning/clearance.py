"""Room to move: whether two blocks overlap, and along which way a block comes in or out.

Convex parts are told apart by the planes of their faces and those along an edge of each. A block
moves without turning, so each plane keeps it apart from another up to some distance and from
another distance on: what it meets on a straight way is known exactly, however thin it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from learn2assemble.assembly.blocks import Block
from learn2assemble.assembly.contacts import Contacts
from learn2assemble.assembly.parts import convex_parts
from learn2assemble.geometry.hulls import area_vector
from learn2assemble.kernels import kernel

_STEPS = 4
"""Places for every least extent of a block among which those are where it may turn off its way."""
_WAYS = 12
"""Directions that are tried."""
_TURNS = 6
"""Places along a way at which a block may turn off it."""
_ALONG = 1e-4
"""A direction along a face leaves it, up to this [rad]."""
_PARALLEL = 1e-6
"""Sine of the angle below which two edges have no normal in common."""


class _ConvexSolid(NamedTuple):
    vertices: np.ndarray
    normals: np.ndarray
    edges: np.ndarray


Parts = tuple[_ConvexSolid, ...]
"""The convex parts of a block."""


class _Solids(NamedTuple):
    """Those of many blocks, one after another."""

    vertices: np.ndarray
    normals: np.ndarray
    edges: np.ndarray
    start: np.ndarray
    """int64[3, parts + 1]: the first of each part's vertices, normals and edges."""
    part: np.ndarray
    """int64[blocks + 1]: the first of each block's parts."""


def parts_of(block: Block) -> Parts:
    """The convex parts of a block, as the tests below take them."""
    return tuple(_part(part) for part in ([block] if block.is_convex else convex_parts(block)))


def overlap(one: Parts, two: Parts, depth: float) -> bool:
    """Whether blocks overlap by more than ``depth`` [m] along every axis that could part them."""
    still = np.zeros(3)
    return any(_first_deep(a, b, still, still, depth, 0.0, np.inf) == 0 for a in one for b in two)


class Clearance:
    """The ways of the blocks of an assembly past one another.

    Args:
        blocks: where they stand.
        depth: overlap that is rounding [m].
    """

    def __init__(self, blocks: Sequence[Block], depth: float) -> None:
        self.blocks = blocks
        self.depth = depth
        self.lower: np.ndarray = np.array([block.vertices.min(0) for block in blocks])
        self.upper: np.ndarray = np.array([block.vertices.max(0) for block in blocks])

    def leaves(self, block: int, present: np.ndarray, ways: np.ndarray) -> bool:
        """Whether a block can be moved out from among the ``present`` ones (bool[B]).

        One straight way is looked for, then a way with one turn: along one of ``ways`` as far as
        that is free, and from there up, or along the ground.

        Args:
            ways: float64[n, 3], unit vectors in which it can begin to move.
        """
        others = present.copy()
        others[block] = False
        if not others.any():
            return True
        still = np.zeros(3)
        if any(self._out(block, way, others, still) for way in ways):
            return True
        size = float((self.upper[block] - self.lower[block]).min())
        reach = float((self.upper[others].max(0) - self.lower[others].min(0)).max())
        for way in ways:
            far = min(self._first_hit(block, way, others, still), reach)
            count = int(_STEPS * far / size)
            turns = {int(k) for k in np.geomspace(1, count, _TURNS)} if count else set[int]()
            for k in sorted(turns):
                offset = way * (k / _STEPS * size)
                if any(self._out(block, second, others, offset) for second in _SECOND):
                    return True
        return False

    def meets(self, block: int, present: np.ndarray) -> bool:
        """Whether a block where it stands overlaps any of the ``present`` ones (bool[B])."""
        others = present.copy()
        others[block] = False
        still = np.zeros(3)
        return not self._out(block, still, others, still)

    def _out(self, block: int, way: np.ndarray, others: np.ndarray, offset: np.ndarray) -> bool:
        """Whether a block, moved by ``offset``, can be drawn out straight along a unit vector; or
        stands clear where it is, along none."""
        return self._first_hit(block, way, others, offset, any_one=True) == np.inf

    def _first_hit(
        self,
        block: int,
        way: np.ndarray,
        others: np.ndarray,
        offset: np.ndarray,
        any_one: bool = False,
    ) -> float:
        """How far a block, moved by ``offset``, comes along a unit vector before it overlaps any of
        the others (bool[B]) [m]; infinite where it gets out.

        Args:
            any_one: whether any of those that it overlaps will do for the first one.
        """
        boxes = self.lower, self.upper
        path = np.stack([offset, way])
        return _first_hit(block, *boxes, others, path, self._solids, self.depth, any_one)

    @cached_property
    def _solids(self) -> _Solids:
        """The convex parts of all blocks."""
        parts = [parts_of(block) for block in self.blocks]
        every = [part for some in parts for part in some]
        return _Solids(
            np.concatenate([part.vertices for part in every]),
            np.concatenate([part.normals for part in every]),
            np.concatenate([part.edges for part in every]),
            np.array([np.cumsum([0, *(len(part[k]) for part in every)]) for k in range(3)]),
            np.cumsum([0, *map(len, parts)]),
        )


class Ways(Protocol):
    """Room to move."""

    def free(self, block: int, present: np.ndarray, sliding: bool = True) -> bool:
        """Whether a block can come to its place, or leave it, among the ``present`` ones
        (bool[B]).

        Args:
            sliding: also along its edges, where it may rub on others the whole way.
        """
        ...


class FreeWays:
    """Whether blocks come to their places, and leave them, past those that are there.

    Args:
        blocks: where they stand.
        contacts: of them.
        depth: overlap that is rounding [m].
        level: blocks from this one on are posts that may be used: they go along the ground first,
            which other props may, and only where no other post stands in their place.
    """

    def __init__(
        self, blocks: Sequence[Block], contacts: Contacts, depth: float, level: int
    ) -> None:
        self.contacts = contacts
        self.level = level
        self.props: list[bool] = [block.prop for block in blocks]
        self._clearance = Clearance(blocks, depth)
        self._known: dict[tuple[int, bytes], bool] = {}
        self._slides: dict[tuple[int, bytes], bool] = {}
        self._own_ways: dict[int, np.ndarray] = {}

    def free(self, block: int, present: np.ndarray, sliding: bool = True) -> bool:
        """Whether a way of a block to or from its place is free among ``present`` (bool[B]).

        Args:
            sliding: also along its edges, as a drawer goes; a prop does not slide.
        """
        key = block, present.tobytes()
        if self._comes_off(*key, present) or not sliding or self.props[block]:
            return self._known[key]
        if key not in self._slides:
            normals, _ = self._pushing(block, present)
            ways = slides(self._clearance.blocks[block], normals)
            self._slides[key] = self._clearance.leaves(block, present, ways)
        return self._slides[key]

    def _comes_off(self, block: int, there: bytes, present: np.ndarray) -> bool:
        """Whether a way is free that leads away from what the block touches.

        Args:
            there: of ``present``, by which it is known.
        """
        key = block, there
        if key not in self._known and block >= self.level:
            # Each post was found beside the given blocks alone: two of them may want one place.
            posts = present.copy()
            posts[: self.level] = False
            if self._clearance.meets(block, posts):
                self._known[key] = False
        if key not in self._known:
            normals, faces = self._pushing(block, present)
            ways = LEVEL[:0]
            if self.props[block]:
                if block not in self._own_ways:
                    self._own_ways[block] = _level_edges(self._clearance.blocks[block])
                ways = np.concatenate([LEVEL, self._own_ways[block]])
                ways = ways[(ways @ normals.T > -_ALONG).all(1)]
            if block < self.level:
                # Where corners alone touch, a normal is one of many that could part them.
                out = ways_out(normals)
                ways = np.concatenate([out if len(out) else ways_out(normals[faces]), ways])
            self._known[key] = self._clearance.leaves(block, present, ways)
        return self._known[key]

    def _pushing(self, block: int, present: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Normals of the contacts of a block with what is there, towards it (float64[n, 3]), and
        which of them are of faces (bool[n])."""
        contacts = self.contacts
        mine, other = contacts.a == block, contacts.b == block
        there = np.where(mine, contacts.b, contacts.a)
        live = (mine | other) & ((there < 0) | present[there])
        faces = np.diff(contacts.start)[live] >= 3
        return np.where(mine[live, None], -contacts.normal[live], contacts.normal[live]), faces


def ways_out(normals: np.ndarray) -> np.ndarray:
    """Directions in which a block that is pushed along these unit normals can move at all.

    Args:
        normals: float64[n, 3], of every contact, towards the block.

    Returns:
        float64[k, 3]: unit vectors, the most upright ones first.
    """
    if not len(normals):
        return _SPHERE[:1]
    mean = normals.sum(0)
    size = np.linalg.norm(mean)
    ways = np.concatenate([_SPHERE, normals, mean[None] / size if size > 1e-9 else normals[:0]])
    ways = ways[(ways @ normals.T > -_ALONG).all(1)]
    return ways[np.argsort(-ways[:, 2], kind="stable")][:_WAYS]


def slides(block: Block, normals: np.ndarray) -> np.ndarray:
    """Directions along edges of a block that no contact stops.

    Args:
        normals: float64[n, 3], of every contact, towards the block.

    Returns:
        float64[k, 3]: unit vectors, those along the longest edges first.
    """
    along = _edges(block)
    length = np.linalg.norm(along, axis=1).round(9)
    order = np.argsort(-length, kind="stable")
    unit = along[order[length[order] > 0]]
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    ways = np.stack([unit, -unit], 1).reshape(-1, 3)
    ways = ways[(ways @ normals.T > -_ALONG).all(1)]
    _, first = np.unique(ways.round(9), axis=0, return_index=True)
    return ways[np.sort(first)][:_WAYS]


def _level_edges(block: Block) -> np.ndarray:
    """float64[k, 3]: unit vectors along the level edges of a block, both ways, each once: the ways
    along the ground that turn with it."""
    along = _edges(block)
    length = np.linalg.norm(along, axis=1)
    unit = along[length > 0] / length[length > 0, None]
    unit = unit[np.abs(unit[:, 2]) < _ALONG]
    found = list[np.ndarray]()
    for way in np.concatenate([unit, -unit]):
        if all(way @ other < 1 - _ALONG for other in (*LEVEL, *found)):
            found.append(way)
    return np.array(found).reshape(-1, 3)


def _part(block: Block) -> _ConvexSolid:
    xyz = np.array(block.vertices)
    normals = [area_vector(xyz[list(face)]) for face in block.faces]
    return _ConvexSolid(xyz, _directions(np.array(normals)), _directions(_edges(block)))


def _edges(block: Block) -> np.ndarray:
    """float64[n, 3]: from one end of each edge to the other [m]."""
    xyz = np.array(block.vertices)
    ends = np.array(
        sorted(
            {
                (min(p, q), max(p, q))
                for face in block.faces
                for p, q in zip(face, face[1:] + face[:1], strict=True)
            }
        )
    )
    return xyz[ends[:, 1]] - xyz[ends[:, 0]]


def _directions(vectors: np.ndarray) -> np.ndarray:
    """Unit vectors along those that are not zero, one of each two that are opposite."""
    length = np.linalg.norm(vectors, axis=1)
    unit: np.ndarray = vectors[length > 1e-12] / length[length > 1e-12, None]
    first = np.argmax(np.abs(unit) > 1e-6, axis=1)
    unit = unit * np.sign(unit[np.arange(len(unit)), first])[:, None]
    return np.ascontiguousarray(np.unique(unit.round(9), axis=0))


@kernel
def _first_deep(
    one: _ConvexSolid,
    two: _ConvexSolid,
    offset: np.ndarray,
    way: np.ndarray,
    depth: float,
    start: float,
    end: float,
) -> float:
    """How far a part, moved by ``offset``, comes along ``way`` before it overlaps another one.

    The axes are those of the separating axis theorem: normals of faces, and cross products of
    edges. An axis along which the parts are at most ``depth`` deep keeps them apart, and where they
    are deeper along it is one interval of the way: the parts overlap where all intervals do.

    Args:
        offset, way: float64[3].
        depth: overlap that is rounding [m].
        start, end: what of the way is looked at [m].

    Returns:
        Where the overlap begins, ``start`` at least [m]; infinite without one.
    """
    first, second, third = len(one.normals), len(two.normals), len(two.edges)
    for number in range(first + second + len(one.edges) * third):
        if number < first:
            x, y, z = one.normals[number]
        elif number < first + second:
            x, y, z = two.normals[number - first]
        else:
            i, j = divmod(number - first - second, third)
            ax, ay, az = one.edges[i]
            bx, by, bz = two.edges[j]
            x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            length = np.sqrt(x * x + y * y + z * z)
            if length < _PARALLEL:
                continue
            x, y, z = x / length, y / length, z / length
        low = low2 = np.inf
        high = high2 = -np.inf
        for k in range(len(one.vertices)):
            at = one.vertices[k, 0] * x + one.vertices[k, 1] * y + one.vertices[k, 2] * z
            low, high = min(low, at), max(high, at)
        for k in range(len(two.vertices)):
            at = two.vertices[k, 0] * x + two.vertices[k, 1] * y + two.vertices[k, 2] * z
            low2, high2 = min(low2, at), max(high2, at)
        shift = offset[0] * x + offset[1] * y + offset[2] * z
        speed = way[0] * x + way[1] * y + way[2] * z
        start, end = _within(
            low2 - high - shift + depth, high2 - low - shift - depth, speed, start, end
        )
        if not start < end:
            return np.inf
    return start


@kernel
def _within(
    least: float, most: float, speed: float, start: float, end: float
) -> tuple[float, float]:
    """The part of ``start`` .. ``end`` where ``speed`` times the way is between two bounds; it is
    empty where the first number is not below the second."""
    if speed > 0:
        return max(start, least / speed), min(end, most / speed)
    if speed < 0:
        return max(start, most / speed), min(end, least / speed)
    return (start, end) if least < 0 < most else (start, start)


@kernel
def _first_hit(
    block: int,
    lower: np.ndarray,
    upper: np.ndarray,
    others: np.ndarray,
    path: np.ndarray,
    solids: _Solids,
    depth: float,
    any_one: bool,
) -> float:
    """See :meth:`Clearance._first_hit`: what is apart along x, y or z is apart, and only what is
    not is told apart by its faces and edges.

    Args:
        block: its number; lower, upper: float64[B, 3], boxes of all blocks [m].
        others: bool[B]; path: float64[2, 3], offset [m] and way; solids: see :class:`_Solids`.
        depth: overlap that is rounding [m]; any_one: stop at any that is hit.
    """
    vertices, normals, edges, begin, part = solids
    offset, way = path
    found = np.inf
    for n in range(len(lower)):
        if not others[n]:
            continue
        # What is met behind the first that is met so far does not matter.
        start, end = 0.0, found
        for c in range(3):
            least = lower[n, c] - upper[block, c] - offset[c]
            most = upper[n, c] - lower[block, c] - offset[c]
            start, end = _within(least, most, way[c], start, end)
        if not start < end:
            continue
        for a in range(part[block], part[block + 1]):
            one = _ConvexSolid(
                vertices[begin[0, a] : begin[0, a + 1]],
                normals[begin[1, a] : begin[1, a + 1]],
                edges[begin[2, a] : begin[2, a + 1]],
            )
            for b in range(part[n], part[n + 1]):
                two = _ConvexSolid(
                    vertices[begin[0, b] : begin[0, b + 1]],
                    normals[begin[1, b] : begin[1, b + 1]],
                    edges[begin[2, b] : begin[2, b + 1]],
                )
                found = min(
                    found, _first_deep(one, two, offset, way, depth, start, min(end, found))
                )
        if any_one and found < np.inf:
            break
    return found


def _sphere(count: int) -> np.ndarray:
    """float64[count + 1, 3]: up, and unit vectors evenly about it (Fibonacci's lattice)."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    turn = np.pi * (1 + 5**0.5) * k
    ring = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], 1)
    return np.concatenate([[[0.0, 0.0, 1.0]], ring])


_SPHERE = _sphere(200)
LEVEL = np.array([(np.cos(a), np.sin(a), 0.0) for a in np.arange(16) * np.pi / 8])
"""float64[16, 3]: ways along the ground."""
_SECOND = np.concatenate([_SPHERE[:1], LEVEL[::4]])
