"""Centring: boards on edge that carry many blocks each and stay until all blocks are there.

A board stands across the slope of the faces it carries, from the first of them to the last, and is
nearly as thick as one of these blocks. Its upper edge is cut to all of them. As blocks from both
sides lean on one board, nothing pushes it over, which a post under a steep block needs much room
for.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import shapely
from shapely import LineString, MultiPoint, Polygon

from learn2assemble.assembly.blocks import Block
from learn2assemble.assembly.contacts import GROUND, Contacts
from learn2assemble.assembly.cuts import POST
from learn2assemble.planning.posts import DENSITY, DOWN, Face, Post, PostSite

_THICK = 0.9
"""Thickness of a board, in the width of the face that it is made for."""
_LEVEL = 0.05
"""Horizontal part of the normal of a face up to which it has no slope."""
_ACROSS = 1e-3
"""Part of the normal of a face, across a board, up to which that can be cut to it."""
_LEAST = 0.1
"""Part of a face that has to lie on a board which carries it."""
_NEAR = 1e-3
"""Distances that are rounding, in the thickness of a board."""


class _Board(NamedTuple):
    made: Post
    outline: Polygon
    """Seen from above."""
    carried: frozenset[int]
    """Indices of the blocks that lie on it."""


class _Strip(NamedTuple):
    """Where a board may stand: all points ``x`` with ``low <= x @ side <= high``."""

    along: np.ndarray
    """float64[2]: unit vector in which it is long."""
    side: np.ndarray
    """float64[2]: unit vector across it."""
    low: float
    high: float

    @property
    def key(self) -> tuple[float, ...]:
        """Equal for strips in one place."""
        return tuple(np.round([*self.along, self.low, self.high], 4).tolist())

    @property
    def depth(self) -> float:
        """Distances that are rounding [m]."""
        return _NEAR * (self.high - self.low)

    def seen(self, points: np.ndarray) -> np.ndarray:
        """float64[n, 2]: how far along and how high points float64[n, 3] are."""
        return np.column_stack([points[:, :2] @ self.along, points[:, 2]])

    def corners(self, start: float, stop: float) -> np.ndarray:
        """float64[4, 2]: of its part between two distances along it, seen from above."""
        ends = np.array(
            [(start, self.low), (stop, self.low), (stop, self.high), (start, self.high)]
        )
        return ends @ np.stack([self.along, self.side])


def find_centring(
    blocks: Sequence[Block], contacts: Contacts, ground: float = 0.0
) -> tuple[list[Post], list[int]]:
    """Boards that do not meet and that together carry many blocks, and which blocks they carry.

    Args:
        blocks: where they stand.
        contacts: of these blocks; faces in contact carry already.
        ground: height of the ground [m].

    Returns:
        The one that carries the most blocks first, then always the one that carries the most
        others.
    """
    left: list[_Board] = list(_boards(PostSite(blocks, contacts, ground), ground))
    carried: set[int] = set()
    found: list[Post] = []
    while left:
        best = max(left, key=lambda board: len(board.carried - carried))
        if best.carried <= carried:
            break
        found.append(best.made)
        carried |= best.carried
        left = [board for board in left if not board.outline.intersects(best.outline)]
    return found, sorted(carried)


def _boards(site: PostSite, ground: float) -> Iterator[_Board]:
    """One for each strip in which a face lies free."""
    known: dict[tuple[float, ...], list[frozenset[int]]] = {}
    for k, block in enumerate(site.blocks):
        for face in site.faces[k] if not block.support else ():
            strip = _strip(face) if face.normal[2] < DOWN else None
            some = [] if strip is None else known.setdefault(strip.key, [])
            if strip is None or any(k in carried for carried in some):
                continue
            if not site.free_parts(k, face):
                continue
            board = _board(site, k, face, strip, ground)
            if board is not None:
                some.append(board.carried)
                yield board


def _strip(face: Face) -> _Strip | None:
    """Across the slope of a face, or None where it has none."""
    slope = float(np.hypot(*face.normal[:2]))
    if slope < _LEVEL:
        return None
    # Of two opposite directions one, so that faces on both sides have the same strip.
    along = face.normal[:2] / slope
    along = along * np.sign(along[np.argmax(np.abs(along) > _ACROSS)])
    side = np.array([-along[1], along[0]])
    across = shapely.get_coordinates(face.outline) @ side
    middle, half = (across.max() + across.min()) / 2, _THICK * np.ptp(across) / 2
    return _Strip(along, side, float(middle - half), float(middle + half)) if half > 0 else None


def _board(site: PostSite, k: int, face: Face, strip: _Strip, ground: float) -> _Board | None:
    """A board below a face, as long as it carries something over all of its thickness, or None."""
    depth, (seed,) = strip.depth, strip.seen(face.foot[None])
    corners = np.concatenate([strip.seen(site.lower), strip.seen(site.upper)])
    (first, _), (last, top) = corners.min(0), corners.max(0)
    profile = np.array([(first, ground), (last, ground), (last, top), (first, top)])
    profile = _clipped(profile, seed, strip.seen(face.normal[None])[0])
    # From near to far: what is cut off for the nearest blocks meets few others.
    middle = (site.lower + site.upper) @ np.append(strip.along, 0.0) / 2
    order: list[int] = np.argsort(np.abs(middle - seed[0])).tolist()
    for n in order:
        points = site.blocks[n].vertices
        across = points[:, :2] @ strip.side
        if n == k or across.max() < strip.low + depth or across.min() > strip.high - depth:
            continue
        made = _beside(profile, seed, strip.seen(points), site.faces[n], strip)
        if made is None:
            return None
        profile = made
    carried, low, high = _carried(site, profile, strip)
    if k not in carried or high - low < strip.high - strip.low:
        return None
    for end, way in ((low, 1.0), (high, -1.0)):
        profile = _clipped(profile, np.array([end, 0.0]), np.array([way, 0.0]))
    profile = profile[np.linalg.norm(profile - np.roll(profile, 1, 0), axis=1) > depth]
    carried, _, _ = _carried(site, profile, strip)
    if k not in carried:
        return None
    made = _upright(site.blocks[k].id, profile, strip)
    return _Board(Post(k, GROUND, made), Polygon(strip.corners(low, high)), frozenset(carried))


def _beside(
    profile: np.ndarray, seed: np.ndarray, points: np.ndarray, faces: Sequence[Face], strip: _Strip
) -> np.ndarray | None:
    """As much of a profile as one cut leaves that does not meet a block, or None.

    Args:
        profile: float64[n, 2], convex, counter-clockwise.
        seed: float64[2], what it has to keep.
        points: float64[m, 2], the corners of the block.
        faces: of the block.
    """
    if Polygon(profile).intersection(MultiPoint(points).convex_hull).area < strip.depth**2:
        return profile
    cuts = [
        (points[points[:, 0].argmax()], np.array([1.0, 0.0])),
        (points[points[:, 0].argmin()], np.array([-1.0, 0.0])),
    ]
    for face in faces:
        if face.normal[2] < DOWN and abs(face.normal[:2] @ strip.side) < _ACROSS:
            foot, normal = strip.seen(np.stack([face.foot, face.normal]))
            # A block that is not convex may reach over the plane of a face of it.
            if ((points - foot) @ normal).max() < strip.depth:
                cuts.append((foot, normal))
    kept = [cut for cut in cuts if (seed - cut[0]) @ cut[1] > -strip.depth]
    left = [_clipped(profile, foot, normal) for foot, normal in kept]
    return max(left, key=lambda one: Polygon(one).area if len(one) > 2 else 0.0, default=None)


def _clipped(profile: np.ndarray, foot: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """float64[k, 2]: what of a convex outline float64[n, 2] lies where the normal points."""
    side = (profile - foot) @ normal
    kept = list[np.ndarray]()
    for k, (here, after) in enumerate(zip(side, np.roll(side, -1), strict=True)):
        if here >= 0:
            kept.append(profile[k])
        if here * after < 0:
            way = profile[(k + 1) % len(profile)] - profile[k]
            kept.append(profile[k] + here / (here - after) * way)
    return np.array(kept).reshape(-1, 2)


def _carried(site: PostSite, profile: np.ndarray, strip: _Strip) -> tuple[set[int], float, float]:
    """The blocks that lie on a profile, and from where to where it carries on both of its sides."""
    found: set[int] = set()
    ends = np.array([[np.inf, -np.inf]] * 2)
    way = np.roll(profile, -1, 0) - profile
    length = np.linalg.norm(way, axis=1)
    for start, along, size in zip(profile, way, length, strict=True):
        if along[0] > -_NEAR * size:
            continue  # Counter-clockwise, upper edges go back.
        normal = np.array([along[1], -along[0]]) / size
        s0, s1 = start[0] + along[0], start[0]
        ring = strip.corners(s0, s1)
        box, edges = Polygon(ring), (LineString(ring[:2]), LineString(ring[2:]))
        for n in site.over(box):
            for face in site.faces[n]:
                (foot,), (turned,) = strip.seen(face.foot[None]), strip.seen(face.normal[None])
                flush = turned @ normal < -1 + _ACROSS**2
                if not flush or abs((foot - start) @ normal) > strip.depth:
                    continue
                part = face.outline.intersection(box)
                if part.area < _LEAST * face.outline.area:
                    continue
                found.add(n)
                for end, line in zip(ends, edges, strict=True):
                    at = shapely.get_coordinates(part.intersection(line)) @ strip.along
                    end[:] = at.min(initial=end[0]), at.max(initial=end[1])
    return found, float(ends[:, 0].max()), float(ends[:, 1].min())


def _upright(name: str, profile: np.ndarray, strip: _Strip) -> Block:
    """The board with a profile, all over the thickness of a strip."""
    count = len(profile)
    flat = profile[:, :1] * strip.along
    vertices = np.concatenate(
        [np.column_stack([flat + at * strip.side, profile[:, 1]]) for at in (strip.low, strip.high)]
    )
    # Seen from the side to which `side` points, which is to the left of `along`, the profile is
    # clockwise.
    near, far = tuple(range(count)), tuple(range(2 * count - 1, count - 1, -1))
    around = [(k, count + k, count + (k + 1) % count, (k + 1) % count) for k in range(count)]
    return Block(f"centring-{name}", vertices, (near, far, *around), POST, DENSITY, prop=True)
