"""Posts: upright prisms that carry blocks from the ground or from a block below them.

A post stands below the centre of mass of the block it is for, or as near to that as a free face of
the block allows, and is wide enough for its height where there is room. Its top is cut to the face,
and to those of the neighbours it would reach into. It is a block like others, marked as a prop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import shapely
from shapely import Polygon

from learn2assemble.assembly.blocks import Block
from learn2assemble.assembly.contacts import GROUND, Contacts
from learn2assemble.assembly.cuts import POST
from learn2assemble.errors import InputError
from learn2assemble.geometry.hulls import area_vector
from learn2assemble.planning.clearance import Parts, overlap, parts_of

_library: Any = shapely
"""Decorated functions without types."""
DENSITY = 600.0
"""Of timber [kg/m³]."""
_SLENDER = (4.0, 8.0, 2.0)
"""Heights over widths: of a post, of one that takes less room, of one that is not pushed over."""
_NAMES = ("", "-b", "-c")
_WIDTHS = (0.7, 0.5, 0.35, 0.25)
"""Widths that are tried where none of these has room, in square roots of the area of the face as
seen from above."""
_LEAST = 0.02
"""Free part of a face that is looked at."""
DOWN, _FLAT = -0.1, 0.999
"""A face looks down, or is a floor for a post, where its normal does so."""
_LEVEL = 1e-6
"""Horizontal part of the normal of a face up to which it has no slope."""
_SHORTEST = 0.05
"""Of a post, in its width."""
_DEPTH = 1e-3
"""Overlap with another block, in the width of a post, that is rounding."""
_BOX = ((3, 2, 1, 0), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))


class Post(NamedTuple):
    """A post that could be used."""

    carries: int
    """Index of the block it is for."""
    base: int
    """Index of the block it stands on, or GROUND."""
    block: Block


class Face(NamedTuple):
    """Of a block."""

    outline: Polygon
    """Seen from above."""
    normal: np.ndarray
    """float64[3]: unit, outwards."""
    foot: np.ndarray
    """float64[3]: a point of it."""


def find_posts(
    blocks: Sequence[Block], contacts: Contacts, ground: float | None = 0.0
) -> list[Post]:
    """The posts that could carry each block where all the others are as well.

    Args:
        blocks: where they stand.
        contacts: of these blocks; faces in contact carry already.
        ground: height of the ground [m]; None where there is none.

    Returns:
        At most three posts a block, of different widths, in the order of the blocks.
    """
    site = PostSite(blocks, contacts, ground)
    return [post for k, block in enumerate(blocks) if not block.support for post in site.posts(k)]


def with_own_ids(blocks: Sequence[Block], posts: Sequence[Block]) -> list[Block]:
    """The posts with ids that neither a block nor another post has."""
    ids = {block.id for block in blocks}
    made = list[Block]()
    for post in posts:
        name = post.id
        while name in ids:
            name += "'"
        ids.add(name)
        made.append(replace(post, id=name))
    return made


class PostSite:
    """What is in the way of posts, and what they can stand on."""

    def __init__(self, blocks: Sequence[Block], contacts: Contacts, ground: float | None) -> None:
        self.blocks = blocks
        self.contacts = contacts
        self.ground = ground
        self.lower: np.ndarray = np.array([block.vertices.min(0) for block in blocks])
        self.upper: np.ndarray = np.array([block.vertices.max(0) for block in blocks])
        self.faces: list[list[Face]] = [_faces(block) for block in blocks]
        self._parts: dict[int, Parts] = {}
        self.foot: np.ndarray = contacts.points[contacts.start[:-1]]

    def over(self, outline: Polygon) -> list[int]:
        """Blocks whose boxes are above, below or in a part of the ground."""
        low, high = np.reshape(outline.bounds, (2, 2))
        meets = (self.lower[:, :2] < high).all(1) & (self.upper[:, :2] > low).all(1)
        return np.flatnonzero(meets).tolist()

    def posts(self, k: int) -> list[Post]:
        """Those that have room under the free face that is nearest below the centre of a block."""
        middle = shapely.Point(self.blocks[k].centroid[:2])
        free = [
            part
            for face in self.faces[k]
            if face.normal[2] < DOWN
            for part in self.free_parts(k, face)
        ]
        free.sort(key=lambda face: (face.outline.distance(middle), -face.outline.area))
        for face in free:
            found = self._under(k, face, middle)
            if found:
                return found
        return []

    def _under(self, k: int, face: Face, middle: shapely.Point) -> list[Post]:
        ring = shapely.get_coordinates(face.outline.minimum_rotated_rectangle)
        sides = ring[1:3] - ring[:2]
        length = np.linalg.norm(sides, axis=1)
        if length.min() <= 0:
            return []
        axes = sides / length[:, None]
        size = float(np.sqrt(face.outline.area))
        height = float(face.foot[2] - (self.ground or 0.0))
        slope = np.abs(axes @ face.normal[:2])
        # Of a level face rounding must not choose: its longer side.
        steep = int(np.argmax(slope if slope.max() > _LEVEL else length))
        found: list[Post] = []
        extents: list[np.ndarray] = []
        widths = [height / slender for slender in _SLENDER] + [share * size for share in _WIDTHS]
        for number, width in enumerate(widths):
            if found and number >= len(_SLENDER):
                break
            # Wider than the face only across the slope of it, where it needs the width.
            extent = np.minimum(0.9 * length, max(width, _WIDTHS[2] * size))
            extent[steep] = max(extent[steep], width)
            if any(np.allclose(extent, known) for known in extents):
                continue
            room = face.outline.buffer(-min(width, 0.9 * length.min()) / 2)
            at = face.outline.centroid if room.is_empty else room
            at = shapely.get_coordinates(_library.shortest_line(at, middle))[0]
            u, v = axes * extent[:, None] / 2
            square = at + np.array([-u - v, u - v, u + v, v - u])
            if u[0] * v[1] < u[1] * v[0]:
                square = square[::-1]
            name = f"post-{self.blocks[k].id}" + (_NAMES[len(found)] if found else "")
            post = self._prism(k, face, square, name)
            if post is not None:
                found.append(post)
                extents.append(extent)
        return found

    def free_parts(self, k: int, face: Face) -> list[Face]:
        """The parts of a face of a block that no other block touches."""
        contacts, size = self.contacts, float((self.upper[k] - self.lower[k]).max())
        own = (contacts.a == k) | (contacts.b == k)
        turned = np.abs(contacts.normal @ face.normal) > 1 - 1e-3
        near = np.abs((self.foot - face.foot) @ face.normal) < 1e-2 * size
        left = face.outline
        for patch in np.flatnonzero(own & turned & near).tolist():
            corners = contacts.points[contacts.start[patch] : contacts.start[patch + 1], :2]
            left = left.difference(shapely.MultiPoint(corners).convex_hull.buffer(1e-3 * size))
        parts = [part for part in getattr(left, "geoms", [left]) if isinstance(part, Polygon)]
        return [
            face._replace(outline=part) for part in parts if part.area > _LEAST * face.outline.area
        ]

    def _prism(self, k: int, face: Face, square: np.ndarray, name: str) -> Post | None:
        """A post of that outline on the highest floor below it, unless something is in its way."""
        top = face.foot[2] - (square - face.foot[:2]) @ face.normal[:2] / face.normal[2]
        outline = Polygon(square)
        width = float(np.linalg.norm(np.diff(square[:3], axis=0), axis=1).min())
        meets = (self.lower[:, :2] < square.max(0)).all(1) & (self.lower[:, 2] < top.max())
        meets &= (self.upper[:, :2] > square.min(0)).all(1)
        meets[k] = False
        others = np.flatnonzero(meets).tolist()
        floors = [] if self.ground is None else [(self.ground, GROUND)]
        for n in others:
            floors += [
                (float(floor.foot[2]), n)
                for floor in self.faces[n]
                if floor.normal[2] > _FLAT and floor.outline.covers(outline)
            ]
        for height, base in sorted(floors, reverse=True):
            if top.min() - height < _SHORTEST * width:
                continue
            bottom = np.column_stack([square, np.full(4, height)])
            vertices = np.concatenate([bottom, np.column_stack([square, top])])
            made: Block | None = Block(name, vertices, _BOX, POST, DENSITY, prop=True)
            parts = parts_of(made)
            for n in others:
                if made is not None and self._meets(parts, n, _DEPTH * width):
                    made = self._cut(made, n, _DEPTH * width)
                    parts = parts if made is None else parts_of(made)
            touches = made is not None and _reaches(made, face, _DEPTH * width)
            if made is not None and touches:
                return Post(k, base, made)
        return None

    def _meets(self, post: Parts, other: int, depth: float) -> bool:
        if other not in self._parts:
            self._parts[other] = parts_of(self.blocks[other])
        return overlap(post, self._parts[other], depth)

    def _cut(self, post: Block, other: int, depth: float) -> Block | None:
        """A post without what reaches above a face of another block that looks down, or None."""
        down = [face for face in self.faces[other] if face.normal[2] < DOWN]
        cuts = [made for face in down if (made := _below(post, face)) is not None]
        fits = (
            made
            for made in sorted(cuts, key=lambda made: -made.volume)
            if not self._meets(parts_of(made), other, depth)
        )
        return next(fits, None)


def _reaches(post: Block, face: Face, depth: float) -> bool:
    """Whether some of the top of a post is on a face: at least a triangle of corners."""
    return int((np.abs((post.vertices - face.foot) @ face.normal) < depth).sum()) >= 3


def _below(post: Block, plane: Face) -> Block | None:
    """What of a convex block is outside of a face of another, or None."""
    faces, rim = list[np.ndarray](), list[np.ndarray]()
    outside = (post.vertices - plane.foot) @ plane.normal
    if outside.max() <= 0 or outside.min() >= 0:
        return None  # The plane does not cut it.
    for face in post.faces:
        corners, side = post.vertices[list(face)], outside[list(face)]
        kept = list[np.ndarray]()
        for i, j in zip(range(len(face)), (*range(1, len(face)), 0), strict=True):
            if side[i] >= 0:
                kept.append(corners[i])
            if side[i] * side[j] < 0:
                at = corners[i] + side[i] / (side[i] - side[j]) * (corners[j] - corners[i])
                kept.append(at)
                rim.append(at)
        if len(kept) >= 3:
            faces.append(np.array(kept))
    if len(rim) < 3:
        return None
    rim = np.array(rim)
    middle = rim.mean(0)
    u = np.cross(plane.normal, [1.0, 0.0, 0.0] if abs(plane.normal[0]) < 0.9 else [0.0, 1.0, 0.0])
    v = np.cross(plane.normal, u)
    angle = np.arctan2((rim - middle) @ v, (rim - middle) @ u)
    # The cut looks at the other block: against its normal.
    faces.append(rim[np.argsort(-angle)])
    points = np.concatenate(faces)
    _, first, number = np.unique(points.round(9), axis=0, return_index=True, return_inverse=True)
    number, at, made = number.reshape(-1), 0, list[tuple[int, ...]]()
    for face in faces:
        index: list[int] = number[at : at + len(face)].tolist()
        at += len(face)
        index = [k for k, after in zip(index, (*index[1:], index[0]), strict=True) if k != after]
        if len(index) >= 3:
            made.append(tuple(index))
    try:
        return Block(post.id, points[first], tuple(made), POST, DENSITY, prop=True)
    except InputError:
        return None


def _faces(block: Block) -> list[Face]:
    """The faces of a block that are not upright."""
    found = list[Face]()
    for face in block.faces:
        corners = block.vertices[list(face)]
        normal = area_vector(corners)
        normal = normal / max(float(np.linalg.norm(normal)), 1e-300)
        outline = Polygon(corners[:, :2])
        if outline.is_valid and outline.area > 0:
            found.append(Face(outline, normal, corners.mean(0)))
    return found
