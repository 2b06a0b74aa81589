"""Contact patches between blocks: where facets of opposite normals lie on one plane.

Blocks whose boxes meet are paired, then their facets by normal and distance, and the polygons of
the facets are intersected in their common plane. What two blocks share on one plane is one patch:
the convex hull of it, because forces at the corners of the hull produce exactly the wrenches that
a pressure on the patch with friction can.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely

from learn2assemble.assembly import point_contacts
from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.assembly.cuts import ground_of_each
from learn2assemble.assembly.parts import check_simple, to_manifold
from learn2assemble.errors import InputError

_library: Any = shapely
"""Decorated functions without types."""
GROUND = -1
TOLERANCE = 5e-3
"""Width of a gap that counts as contact, in the edge of a cube as large as the smaller block."""
_ANGLE = 1e-2
"""Between normals of two facets in contact [rad]; warped facets have more."""
SIDE = 0.02
"""A patch is vertical when the vertical part of its normal is at most this."""
_TOUCHES = 0.1
"""Of the tolerance: edges and points that are farther apart may not touch."""
_NARROWEST, _WIDEST = 1e-3, 1.5
"""Of the angle of friction about a normal: less is none, more is any direction [rad]."""
_MOST_PAIRS = 4_000_000
"""Of facets looked at together."""


class Contacts(NamedTuple):
    """Patches of contact and the corners at which their forces act.

    P patches, C corners; corner ``k`` belongs to patch ``patch[k]``, and the corners of a patch
    follow each other round it.
    """

    a: np.ndarray
    """int64[P]: index of the block that pushes back, or GROUND."""
    b: np.ndarray
    """int64[P]: index of the block that is pushed along the normal; a < b."""
    normal: np.ndarray
    """float64[P, 3]: unit, from ``a`` to ``b``."""
    area: np.ndarray
    """float64[P]: of what is in contact [m²]."""
    points: np.ndarray
    """float64[C, 3]: corners of the hulls [m, world]."""
    patch: np.ndarray
    """int64[C]."""
    spread: np.ndarray
    """float64[P]: how far from the normal that along which the blocks push may be [rad]; 0 for
    faces. Below 0 they push in every direction so near, as :func:`widened` says."""

    def friction(self, coefficient: float) -> np.ndarray:
        """float64[C]: coefficients about the normals, for forces along whatever the blocks push.

        A force within the angle of friction of a direction that is only known to be near the normal
        is certainly possible if it is nearer to the normal by :attr:`spread`.
        """
        angle = np.arctan(coefficient) - self.spread
        return np.tan(np.clip(angle, 0.0, _WIDEST))[self.patch]

    def known(self, coefficient: float) -> Contacts:
        """The patches that can push for certain with this coefficient of friction."""
        return self.only(self.spread <= max(np.arctan(coefficient) - _NARROWEST, 0.0))

    @property
    def start(self) -> np.ndarray:
        """int64[P + 1]: the first corner of each patch, then C."""
        return np.searchsorted(self.patch, np.arange(len(self.a) + 1))

    def only(self, keep: np.ndarray) -> Contacts:
        """The patches where ``keep`` (bool[P]) is true."""
        corner = keep[self.patch]
        number = np.cumsum(keep) - 1
        return Contacts(
            self.a[keep],
            self.b[keep],
            self.normal[keep],
            self.area[keep],
            self.points[corner],
            number[self.patch[corner]],
            self.spread[keep],
        )


def shrunk(contacts: Contacts, distance: float) -> Contacts:
    """The contacts with the edges of every patch moved inwards by ``distance`` [m].

    Patches that nothing is left of are dropped.
    """
    basis = across(contacts.normal)
    foot = contacts.points[np.minimum(contacts.start[:-1], len(contacts.points) - 1)]
    flat = np.einsum("kij,kj->ki", basis[contacts.patch], contacts.points - foot[contacts.patch])
    shapes = shapely.polygons(shapely.linearrings(flat, indices=contacts.patch))
    shapes = np.asarray(shapely.buffer(shapes, -distance, join_style="mitre")).reshape(-1)
    left = np.flatnonzero(_library.area(shapes) > 0)
    # The first corner of a ring is its last, too.
    rings = [shapely.get_coordinates(shapes[k])[:-1] for k in left]
    patch = np.repeat(np.arange(len(left)), [len(ring) for ring in rings])
    corners = np.concatenate([*rings, np.empty((0, 2))])
    points = foot[left][patch] + np.einsum("kji,kj->ki", basis[left][patch], corners)
    area = _library.area(shapes[left])
    a, b, normal, spread = contacts.a, contacts.b, contacts.normal, contacts.spread
    return Contacts(a[left], b[left], normal[left], area, points, patch, spread[left])


class _Facets(NamedTuple):
    """All faces of all blocks; face f has corners ``xyz[start[f]:start[f + 1]]``."""

    block: np.ndarray
    normal: np.ndarray
    centre: np.ndarray
    warp: np.ndarray
    """Largest distance of a corner from the plane."""
    area: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    start: np.ndarray
    xyz: np.ndarray
    width: np.ndarray
    """Gap that counts as contact, of the block of each face [m]."""


def contact_tolerance(blocks: Sequence[Block]) -> np.ndarray:
    """float64[B]: the default width [m] of a gap that counts as contact, for each block."""
    return TOLERANCE * np.cbrt([block.volume for block in blocks])


def find_contacts(assembly: Assembly, tolerance: float | None = None) -> Contacts:
    """Contact patches between the blocks of an assembly, and with the ground.

    Without any support block, the plane z = 0 is the ground: what stands on it touches it. With
    some, these carry the blocks, and props alone stand on the ground (:func:`ground_of_each`).
    Patches between two supports are left out, and so are strips thinner than the tolerance.

    Args:
        assembly: the blocks where they stand.
        tolerance: widest gap, and deepest overlap, of a contact [m]; by default the smaller
            :func:`contact_tolerance` of the two blocks.

    Raises:
        InputError: where the tolerance is not a positive number.
    """
    width = _width(assembly, tolerance)
    facets = _facets(assembly.blocks, width)
    lower, upper = _bounds(facets, len(assembly.blocks))
    pairs = near_pairs(lower, upper, float(width.max()))
    support = np.array([block.support for block in assembly.blocks])
    pairs = pairs[~(support[pairs[:, 0]] & support[pairs[:, 1]])]
    first, second = _opposite(facets, pairs, lower, upper)
    between = _patches(facets, first, second)
    bed = np.abs(between.normal[:, 2]) > SIDE
    upper = np.where(between.normal[:, 2] > 0, between.b, between.a)[bed]
    height = ground_of_each(assembly.blocks, upper)
    if np.isnan(height).all():
        return between
    ground = _on_ground(facets, height)
    ground = ground._replace(patch=ground.patch + len(between.a))
    return Contacts(*[np.concatenate(two) for two in zip(between, ground, strict=True)])


def add_point_contacts(
    assembly: Assembly, contacts: Contacts, tolerance: float | None = None
) -> Contacts:
    """Add contacts of edges and vertices, between blocks that share no patch of faces.

    Args:
        assembly: the blocks where they stand.
        contacts: of :func:`find_contacts`.
        tolerance: as in :func:`find_contacts`; by default ``point_contacts.LOOSE`` times as wide.

    Returns:
        All contacts, the given ones first. Patches of points and lines have no area and fewer than
        three corners.
    """
    width = _width(assembly, tolerance) * (point_contacts.LOOSE if tolerance is None else 1.0)
    blocks = assembly.blocks
    lower = np.array([block.vertices.min(0) for block in blocks])
    upper = np.array([block.vertices.max(0) for block in blocks])
    support = np.array([block.support for block in blocks])
    pairs = near_pairs(lower, upper, float(width.max()))
    pairs = pairs[~(support[pairs[:, 0]] & support[pairs[:, 1]])]
    count = len(blocks)
    known = contacts.a * count + contacts.b
    pairs = pairs[~np.isin(pairs[:, 0] * count + pairs[:, 1], known)]
    found = point_contacts.between(blocks, pairs, width)
    if not support.any():
        lying = np.isin(np.arange(count), contacts.b[contacts.a == GROUND])
        found += point_contacts.on_ground(blocks, np.flatnonzero(~lying), width)
    if not found:
        return contacts
    sizes = [len(patch.points) for patch in found]
    more = Contacts(
        np.array([patch.a for patch in found]),
        np.array([patch.b for patch in found]),
        np.array([patch.normal for patch in found]),
        np.zeros(len(found)),
        np.concatenate([patch.points for patch in found]),
        len(contacts.a) + np.repeat(np.arange(len(found)), sizes),
        np.where(_met(contacts, found), [patch.spread for patch in found], np.pi / 2),
    )
    return Contacts(*map(np.concatenate, zip(contacts, more, strict=True)))


def _met(faces: Contacts, found: Sequence[point_contacts.PointPatch]) -> np.ndarray:
    """bool[n]: whether the blocks of each contact touch, or do when they have come down.

    What is a little above all that it lies on comes down on that; what touches some of it need not
    come to touch the rest, and where it rolls or slides instead, that carries nothing.
    """
    gap = np.array([patch.gap for patch in found])
    bed = np.array([abs(patch.normal[2]) > SIDE for patch in found])
    upper = np.array([patch.b if patch.normal[2] > 0 else patch.a for patch in found])
    above = np.where(faces.normal[:, 2] > 0, faces.b, faces.a)[np.abs(faces.normal[:, 2]) > SIDE]
    lowest = np.full(max(int(upper.max()), int(above.max(initial=0))) + 1, np.inf)
    np.minimum.at(lowest, upper[bed], gap[bed])
    lowest[above] = 0.0
    return gap - np.where(bed, np.maximum(lowest[upper], 0.0), 0.0) <= _TOUCHES


def widened(contacts: Contacts, distance: float) -> Contacts:
    """All that contacts whose corners are known to a distance [m] can be.

    Every corner is replaced by eight round it in the plane of its patch, and the blocks push along
    all directions along which they may.
    """
    angle = np.arange(8) * np.pi / 4
    ring = distance * np.stack([np.cos(angle), np.sin(angle)], 1)
    offsets = np.einsum("ki,pij->pkj", ring, across(contacts.normal))[contacts.patch]
    points = (contacts.points[:, None] + offsets).reshape(-1, 3)
    return contacts._replace(
        points=points, patch=np.repeat(contacts.patch, 8), spread=-np.abs(contacts.spread)
    )


def check_overlaps(assembly: Assembly, tolerance: float | None = None) -> None:
    """Refuse blocks that share a volume, and blocks that cross themselves.

    Two blocks that a plane of a facet separates do not; what is left is intersected as solids.
    The thickness of the intersection, twice its volume over its surface, is what counts. Blocks
    that are never there at the same time may have one place.

    Args:
        assembly: the blocks where they stand.
        tolerance: as in :func:`find_contacts`.

    Raises:
        InputError: naming two blocks that overlap by more.
    """
    width = _width(assembly, tolerance)
    for block, gap in zip(assembly.blocks, width.tolist(), strict=True):
        check_simple(block, gap)
    blocks, facets = assembly.blocks, _facets(assembly.blocks, width)
    lower, upper = _bounds(facets, len(blocks))
    first = np.searchsorted(facets.block, np.arange(len(blocks) + 1))
    warp = np.maximum.reduceat(facets.warp, first[:-1])
    solids: dict[int, Any] = {}
    pairs: list[list[int]] = near_pairs(lower, upper, -float(width.min())).tolist()
    for i, j in pairs:
        depth = float(min(width[i], width[j]))
        if any(
            _separates(facets, slice(first[p], first[p + 1]), blocks[p], blocks[q], depth)
            for p, q in ((i, j), (j, i))
        ):
            continue
        for k in (i, j):
            if k not in solids:
                solids[k] = to_manifold(blocks[k])
        common = solids[i] ^ solids[j]
        surface = common.surface_area()
        deep = 2 * common.volume() > (depth + warp[i] + warp[j]) * surface
        if deep and _together(assembly, i, j):
            names = f"{blocks[i].id!r} and {blocks[j].id!r}"
            share = common.volume() / min(blocks[i].volume, blocks[j].volume)
            raise InputError(f"blocks {names}", f"{share:.1%} overlap", "blocks that only touch")


def _together(assembly: Assembly, *pair: int) -> bool:
    """Whether two blocks are there at the same time, before a step or after one."""
    there = np.array(assembly.at_first)
    met = not assembly.steps or bool(there[[*pair]].all())
    for step in assembly.steps:
        there[assembly.index(step.block)] = step.action != "remove"
        met = met or bool(there[[*pair]].all())
    return met


def near_pairs(lower: np.ndarray, upper: np.ndarray, tolerance: float) -> np.ndarray:
    """int64[N, 2]: pairs i < j of boxes whose gap is at most the tolerance along every axis.

    Args:
        lower: float64[B, 3].
        upper: float64[B, 3].
        tolerance: [m]; negative asks for overlap.
    """
    spread = upper.max(0) - lower.min(0)
    w, u, v = np.argsort(spread)
    half = tolerance / 2
    low, high = lower - half, upper + half
    boxes = shapely.box(low[:, u], low[:, v], high[:, u], high[:, v])
    pairs = shapely.STRtree(boxes).query(boxes).T
    pairs = pairs[pairs[:, 0] < pairs[:, 1]]
    i, j = pairs.T
    meet = (low[i] <= high[j]) & (low[j] <= high[i])
    pairs = pairs[meet.all(1) & meet[:, w]]
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def _width(assembly: Assembly, tolerance: float | None) -> np.ndarray:
    if tolerance is None:
        return contact_tolerance(assembly.blocks)
    if not (np.isfinite(tolerance) and tolerance > 0):
        raise InputError("tolerance", tolerance, "a length > 0 [m]")
    return np.full(len(assembly.blocks), float(tolerance))


def _facets(blocks: Sequence[Block], width: np.ndarray) -> _Facets:
    index = [np.fromiter((k for f in block.faces for k in f), np.int64) for block in blocks]
    sizes = np.array([len(face) for block in blocks for face in block.faces])
    xyz = np.concatenate([b.vertices[k] for b, k in zip(blocks, index, strict=True)])
    start = np.concatenate([[0], np.cumsum(sizes)])
    begin, face = start[:-1], np.repeat(np.arange(len(sizes)), sizes)
    centre = np.add.reduceat(xyz, begin) / sizes[:, None]
    arm = xyz - centre[face]
    ahead = np.arange(len(xyz)) + 1
    ahead[start[1:] - 1] = begin
    normal = np.add.reduceat(np.cross(arm, arm[ahead]), begin) / 2
    area = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(area, 1e-300)[:, None]
    warp = np.maximum.reduceat(np.abs(np.einsum("ij,ij->i", arm, normal[face])), begin)
    owner = np.repeat(np.arange(len(blocks)), [len(block.faces) for block in blocks])
    lower, upper = np.minimum.reduceat(xyz, begin), np.maximum.reduceat(xyz, begin)
    return _Facets(owner, normal, centre, warp, area, lower, upper, start, xyz, width[owner])


def _bounds(facets: _Facets, count: int) -> tuple[np.ndarray, np.ndarray]:
    first = np.searchsorted(facets.block, np.arange(count))
    return np.minimum.reduceat(facets.lower, first), np.maximum.reduceat(facets.upper, first)


def _ranges(start: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of ranges ``start[k] .. start[k] + count[k]``, all their members, and whose each is."""
    owner = np.repeat(np.arange(len(count)), count)
    first = np.cumsum(count) - count
    return start[owner] + np.arange(len(owner)) - first[owner], owner


def _opposite(
    facets: _Facets, pairs: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Facets that may touch: those of ``first`` are of the first block of a pair."""
    begin = np.searchsorted(facets.block, np.arange(len(lower) + 1))
    count = np.diff(begin)
    most = max(1, int(count.max(initial=1)) ** 2)
    found: list[tuple[np.ndarray, np.ndarray]] = []
    for chunk in np.array_split(pairs, max(1, -(-len(pairs) * most // _MOST_PAIRS))):
        near = list[tuple[np.ndarray, np.ndarray, np.ndarray]]()
        for side, other in ((chunk[:, 0], chunk[:, 1]), (chunk[:, 1], chunk[:, 0])):
            face, pair = _ranges(begin[side], count[side])
            box, wide = other[pair], facets.width[face]
            meet = facets.lower[face] <= upper[box] + wide[:, None]
            meet &= facets.upper[face] >= lower[box] - wide[:, None]
            keep = meet.all(1) & (facets.area[face] > wide**2)
            number = np.bincount(pair[keep], minlength=len(chunk))
            near.append((face[keep], np.cumsum(number) - number, number))
        (left, left_start, left_count), (right, right_start, right_count) = near
        member, pair = _ranges(left_start, left_count)
        inner, outer = _ranges(right_start[pair], right_count[pair])
        found.append(_touching(facets, left[member[outer]], right[inner]))
    return np.concatenate([f for f, _ in found]), np.concatenate([s for _, s in found])


def _touching(
    facets: _Facets, first: np.ndarray, second: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Those pairs of facets whose normals are opposite and whose planes are one."""
    warp = facets.warp[first] + facets.warp[second]
    # The plane of the larger facet is known better; the smaller one lies on it or does not.
    swap = facets.area[first] < facets.area[second]
    large, small = np.where(swap, second, first), np.where(swap, first, second)
    limit = _ANGLE + 2 * warp / np.sqrt(facets.area[small])
    cosine = np.einsum("ij,ij->i", facets.normal[first], facets.normal[second])
    keep = cosine < -np.cos(np.minimum(limit, 0.5))
    arm = facets.centre[small] - facets.centre[large]
    distance = np.abs(np.einsum("ij,ij->i", arm, facets.normal[large]))
    width = np.minimum(facets.width[first], facets.width[second])
    keep &= distance <= width + warp
    keep &= (facets.lower[first] <= facets.upper[second] + width[:, None]).all(1)
    keep &= (facets.lower[second] <= facets.upper[first] + width[:, None]).all(1)
    return first[keep], second[keep]


def across(normal: np.ndarray) -> np.ndarray:
    """float64[n, 2, 3]: two unit vectors across each unit normal."""
    axis = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    u = np.cross(axis, normal)
    u /= np.linalg.norm(u, axis=1)[:, None]
    return np.stack([u, np.cross(normal, u)], 1)


def _polygons(facets: _Facets, face: np.ndarray, basis: np.ndarray, foot: np.ndarray) -> np.ndarray:
    """The facets in the coordinates ``basis`` about ``foot``, as valid shapely geometries."""
    corner, owner = _ranges(facets.start[face], facets.start[face + 1] - facets.start[face])
    flat = np.einsum("kij,kj->ki", basis[owner], facets.xyz[corner] - foot[owner])
    shapes = np.asarray(shapely.polygons(shapely.linearrings(flat, indices=owner)))
    bad = ~shapely.is_valid(shapes)
    shapes[bad] = shapely.make_valid(shapes[bad])
    return shapes


def _patches(facets: _Facets, first: np.ndarray, second: np.ndarray) -> Contacts:
    """Intersect pairs of facets and unite what two blocks share on one plane."""
    normal = facets.normal[first] - facets.normal[second]
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    foot = (facets.centre[first] + facets.centre[second]) / 2
    basis = across(normal)
    shapes = shapely.intersection(
        _polygons(facets, first, basis, foot), _polygons(facets, second, basis, foot)
    )
    area = _library.area(shapes)
    # Twice the area over the perimeter is the width of a strip.
    width = np.minimum(facets.width[first], facets.width[second])
    wide = 2 * area > width * _library.length(shapes)
    shapes, area, width = shapes[wide], area[wide], width[wide]
    normal, foot, basis = normal[wide], foot[wide], basis[wide]
    block_a, block_b = facets.block[first[wide]], facets.block[second[wide]]
    leader = _same_plane(block_a, block_b, normal, foot, width)
    order = np.argsort(leader, kind="stable")
    heads, start = np.unique(leader[order], return_index=True)
    # Corners of all intersections of a patch, in the plane of its first one.
    flat, owner = shapely.get_coordinates(shapes[order], return_index=True)
    piece = order[owner]
    points = foot[piece] + np.einsum("ki,kij->kj", flat, basis[piece])
    head = leader[piece]
    local = np.einsum("kij,kj->ki", basis[head], points - foot[head])
    clouds = shapely.multipoints(local, indices=np.searchsorted(heads, head))
    hulls = shapely.simplify(shapely.convex_hull(clouds), width[heads] / 100)
    rings, patch = shapely.get_coordinates(hulls, return_index=True)
    last = np.append(patch[1:] != patch[:-1], True) if len(patch) else np.empty(0, bool)
    rings, patch = rings[~last], patch[~last]
    total = np.add.reduceat(area[order], start) if len(start) else area
    corners = foot[heads[patch]] + np.einsum("ki,kij->kj", rings, basis[heads[patch]])
    a, b, known = block_a[heads], block_b[heads], np.zeros(len(heads))
    return Contacts(a, b, normal[heads], total, corners, patch, known)


def _same_plane(
    a: np.ndarray, b: np.ndarray, normal: np.ndarray, foot: np.ndarray, width: np.ndarray
) -> np.ndarray:
    """int64[n]: for each intersection the first one of the same two blocks and plane."""
    pair = np.unique(np.stack([a, b], 1), axis=0, return_inverse=True)[1].reshape(-1)
    leader = np.full(len(a), -1)
    left = np.arange(len(a))
    while len(left):
        names, where = np.unique(pair[left], return_index=True)
        head = left[where][np.searchsorted(names, pair[left])]
        same = np.einsum("ij,ij->i", normal[left], normal[head]) > np.cos(_ANGLE)
        arm = np.einsum("ij,ij->i", foot[left] - foot[head], normal[head])
        same &= np.abs(arm) <= width[left]
        leader[left[same]] = head[same]
        left = left[~same]
    return leader


def _on_ground(facets: _Facets, height: np.ndarray) -> Contacts:
    """Patches between facets that look down and the ground.

    Args:
        height: float64[B] of the ground for each block [m]; NaN: it does not stand there.
    """
    down = facets.normal[:, 2] < -np.cos(_ANGLE)
    # Where there is no height, no distance is small.
    down &= np.abs(facets.centre[:, 2] - height[facets.block]) <= facets.width
    down &= facets.area > facets.width**2
    face = np.flatnonzero(down)
    corner, owner = _ranges(facets.start[face], facets.start[face + 1] - facets.start[face])
    block, patch = np.unique(facets.block[face], return_inverse=True)
    clouds = shapely.multipoints(facets.xyz[corner, :2], indices=np.sort(patch[owner]))
    hulls = shapely.simplify(shapely.convex_hull(clouds), facets.width[face].min(initial=1) / 100)
    flat, owner = shapely.get_coordinates(hulls, return_index=True)
    last = np.append(owner[1:] != owner[:-1], True) if len(owner) else np.empty(0, bool)
    points = np.column_stack([flat[~last], height[block[owner[~last]]]])
    up = np.tile([0.0, 0.0, 1.0], (len(block), 1))
    area = np.bincount(patch, facets.area[face], minlength=len(block))
    ground, known = np.full(len(block), GROUND), np.zeros(len(block))
    return Contacts(ground, block, up, area, points, owner[~last], known)


def _separates(facets: _Facets, faces: slice, block: Block, other: Block, tolerance: float) -> bool:
    """Whether the plane of a facet of a block has the block behind it and the other before it."""
    normal, foot = facets.normal[faces], facets.centre[faces]
    offset = np.einsum("ij,ij->i", normal, foot)
    behind = (block.vertices @ normal.T).max(0) <= offset + facets.warp[faces] + tolerance
    before = (other.vertices @ normal.T).min(0) >= offset - facets.warp[faces] - tolerance
    return bool((behind & before).any())
