"""Blocks taken apart: into closed shells, into convex parts; and as solids of a library."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from learn2assemble.assembly.blocks import FLAT, Block
from learn2assemble.errors import InputError
from learn2assemble.geometry.crossings import find_crossing

if TYPE_CHECKING:
    import manifold3d

MAX_PARTS = 200
"""Convex parts of one block."""
_SAME = 1e-5
"""Corners that differ by less along an axis lie in one plane [m]."""
_CROSSING = 0.05
"""How deep an edge passes through a face of its own block, in extents, to be an error."""


def shells(block: Block) -> list[Block]:
    """The closed shells of a block, each as a block of its own.

    Faces belong to one shell when they share an edge in opposite directions; where two shells
    share an edge, the pairing is by the order of the faces.
    """
    open_edges: dict[tuple[int, int], list[int]] = {}
    parent = list(range(len(block.faces)))

    def root(k: int) -> int:
        while parent[k] != k:
            parent[k] = k = parent[parent[k]]
        return k

    for number, face in enumerate(block.faces):
        for start, end in zip(face, (*face[1:], face[0]), strict=True):
            partner = open_edges.get((end, start))
            if partner:
                parent[root(partner.pop(0))] = root(number)
            else:
                open_edges.setdefault((start, end), []).append(number)
    groups: dict[int, list[tuple[int, ...]]] = {}
    for number, face in enumerate(block.faces):
        groups.setdefault(root(number), []).append(face)
    if len(groups) == 1:
        return [block]
    return [_part(block, f"{block.id}/{k}", faces) for k, faces in enumerate(groups.values())]


def convex_parts(block: Block) -> tuple[Block, ...]:
    """The block as convex blocks that fill it without overlap.

    Shells are taken apart first; one that is not convex is cut along planes of its faces.

    Raises:
        InputError: where that takes more than MAX_PARTS parts.
    """
    parts: list[Block] = []
    for shell in shells(block):
        if shell.is_convex:
            parts.append(shell)
            continue
        pieces = _cut(shell, MAX_PARTS - len(parts))
        parts += [replace(piece, id=f"{shell.id}/{k}") for k, piece in enumerate(pieces)]
    return (block,) if len(parts) == 1 and parts[0] is block else tuple(parts)


def check_simple(block: Block, width: float) -> None:
    """Refuse a block whose surface crosses itself, or whose shells share a volume or are apart.

    Args:
        width: widest gap of shells that touch [m].

    Raises:
        InputError: naming the block.
    """
    parts = shells(block)
    for part in parts:
        if part.is_convex:
            continue
        faces = part.faces
        triangles = np.array([t for face in faces for t in _triangulate(part.vertices, face)])
        edges = {(min(e), max(e)) for f in faces for e in zip(f, (*f[1:], f[0]), strict=True)}
        depth = _CROSSING * float(np.ptp(part.vertices, axis=0).max())
        ends = np.array(sorted(edges))
        through = find_crossing(part.vertices, ends, triangles, depth, -1e-9)
        if through is not None:
            where = part.vertices[through].mean(0).round(6).tolist()
            got = f"a surface crossing itself near {where}"
            raise InputError(f"block {block.id!r}", got, "a simple surface")
    several = len(parts) > 1
    if several and abs(to_manifold(block).volume() - block.volume) > 1e-3 * block.volume:
        raise InputError(f"block {block.id!r}", "shells that overlap", "parts that only touch")
    if several and len(_joined_to_first(parts, width)) < len(parts):
        got, expected = f"{len(parts)} parts, not all of which touch", "one body under one name"
        raise InputError(f"block {block.id!r}", got, expected)


def _joined_to_first(parts: Sequence[Block], width: float) -> set[int]:
    """Which parts hang together with the first one, over gaps of at most ``width`` [m]."""
    solids = [to_manifold(part) for part in parts]
    low = np.array([part.vertices.min(0) for part in parts]) - width
    high = np.array([part.vertices.max(0) for part in parts])
    reached, left, fresh = {0}, np.arange(1, len(parts)), [0]
    while fresh:
        one = fresh.pop()
        meet = ((low[left] <= high[one]) & (high[left] >= low[one])).all(1)
        near: list[int] = left[meet].tolist()
        found = [k for k in near if solids[one].min_gap(solids[k], 2 * width) <= width]
        reached |= set(found)
        left, fresh = np.setdiff1d(left, found), fresh + found
    return reached


def to_manifold(block: Block) -> manifold3d.Manifold:
    """The block as solid of the library ``manifold3d``, in the world frame.

    Raises:
        InputError: where its surface is no manifold.
    """
    import manifold3d

    total = manifold3d.Manifold()
    for shell in shells(block):
        triangles = [t for face in shell.faces for t in _triangulate(shell.vertices, face)]
        mesh = manifold3d.Mesh64(shell.vertices.copy(), np.array(triangles, np.uint64))
        solid = manifold3d.Manifold(mesh)
        if solid.status() != manifold3d.Error.NoError:
            raise InputError(f"block {block.id!r}", solid.status().name, "a closed simple surface")
        total += solid
    return total


def upright_boxes(points: np.ndarray, faces: Sequence[tuple[int, ...]]) -> list[np.ndarray]:
    """A block whose faces all are along the axes as boxes without overlap; none where one is not.

    Args:
        points: float64[V, 3], its corners [m].
        faces: of it.

    Returns:
        float64[3, 2] each: where a box begins and ends along every axis [m].
    """
    import shapely

    areas: Any = shapely
    planes, numbers = list[np.ndarray](), np.empty(points.shape, int)
    for axis, values in enumerate(points.T):
        order = np.argsort(values)
        steps = np.concatenate([[True], np.diff(values[order]) > _SAME])
        planes.append(values[order][steps])
        numbers[order, axis] = np.cumsum(steps) - 1
    x, y = np.indices([len(p) - 1 for p in planes[:2]])
    columns = areas.box(x, y, x + 1, y + 1)
    begins = np.zeros((*x.shape, len(planes[2])))
    for face in faces:
        corners = numbers[list(face)]
        flat = (corners == corners[0]).all(0)
        if not flat.any():
            return []
        if flat[2]:
            area = areas.make_valid(areas.Polygon(corners[:, :2]))
            sign = -1 if areas.LinearRing(corners[:, :2]).is_ccw else 1
            begins[:, :, corners[0, 2]] += sign * areas.area(areas.intersection(columns, area))
    return _merged(planes, np.cumsum(begins, 2)[:, :, :-1] > 0.5)


def _merged(planes: list[np.ndarray], left: np.ndarray) -> list[np.ndarray]:
    """Boxes that fill cells bool[X, Y, Z] between planes, as long along x as possible, then along
    y and z."""
    found: list[np.ndarray] = []
    while left.any():
        low = np.argwhere(left)[0]
        high = low + 1
        for axis in range(3):
            slab, limit = [slice(*end) for end in zip(low, high, strict=True)], left.shape[axis]
            while high[axis] < limit:
                slab[axis] = slice(high[axis], high[axis] + 1)
                if not left[tuple(slab)].all():
                    break
                high[axis] += 1
        left[tuple(slice(*end) for end in zip(low, high, strict=True))] = False
        found.append(np.array([[p[a], p[b]] for p, a, b in zip(planes, low, high, strict=True)]))
    return found


def _part(block: Block, id_: str, faces: Sequence[tuple[int, ...]]) -> Block:
    """Some faces of a block with the vertices they use."""
    used = sorted({k for face in faces for k in face})
    number = {old: new for new, old in enumerate(used)}
    renamed = tuple(tuple(number[k] for k in face) for face in faces)
    return replace(block, id=id_, vertices=block.vertices[used], faces=renamed)


def _triangulate(vertices: np.ndarray, face: tuple[int, ...]) -> list[tuple[int, int, int]]:
    """A face as triangles; a face that is not convex is triangulated in its plane."""
    if len(face) == 3:
        return [(face[0], face[1], face[2])]
    corners = vertices[list(face)] - vertices[face[0]]
    ahead = np.roll(corners, -1, 0)
    normal = np.cross(corners, ahead).sum(0)
    turns = np.cross(ahead - corners, np.roll(ahead, -1, 0) - ahead) @ normal
    if (turns >= -1e-12 * normal @ normal).all():
        return [(face[0], face[k], face[k + 1]) for k in range(1, len(face) - 1)]
    import manifold3d

    library: Any = manifold3d
    axis = int(np.argmax(np.abs(normal)))
    u, v = (axis + 1) % 3, (axis + 2) % 3
    flat = corners[:, [u, v] if normal[axis] > 0 else [v, u]]
    # Mirrored coordinates of a face that looks down keep it counter-clockwise.
    return [(face[a], face[b], face[c]) for a, b, c in library.triangulate([flat]).tolist()]


def _cut(shell: Block, most: int) -> list[Block]:
    """Convex pieces of one shell, cut recursively along planes of its faces.

    A piece is convex when its hull is hardly larger; the hull is what is returned. Slivers, which
    rounding leaves beside a cut, are dropped.
    """
    sliver = FLAT * shell.volume
    left, done = [to_manifold(shell)], list[Block]()
    while left:
        solid = left.pop()
        hull = solid.hull()
        if hull.volume() - solid.volume() <= sliver:
            done.append(_from_mesh(shell, hull.to_mesh64()))
            continue
        if len(left) + len(done) >= most:
            raise InputError(f"block {shell.id!r}", "a shape", f"at most {MAX_PARTS} convex parts")
        pieces = _split(solid, sliver)
        left += [part for part in pieces if part.volume() > sliver]
    return done


def _split(solid: manifold3d.Manifold, sliver: float) -> list[manifold3d.Manifold]:
    """The solid cut by the plane of the face over which it stands farthest out."""
    points, triangles = _arrays(solid.to_mesh64())
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    offset = np.einsum("ij,ij->i", normal, corners[:, 0])
    over = (points @ normal.T - offset).max(0)
    core = solid.hull()
    for k in np.argsort(-over):
        ahead, behind = solid.split_by_plane(normal[k].tolist(), float(offset[k]))
        if min(ahead.volume(), behind.volume()) > sliver:
            return [*ahead.decompose(), *behind.decompose()]
        if ahead.volume() <= sliver:
            core = core.trim_by_plane((-normal[k]).tolist(), float(-offset[k]))
    # No plane cuts it: it is convex but for fins without thickness, which earlier cuts leave.
    return [core.hull()]


def _arrays(mesh: manifold3d.Mesh64) -> tuple[np.ndarray, np.ndarray]:
    fields: Any = mesh
    return np.asarray(fields.vert_properties)[:, :3], np.asarray(fields.tri_verts)


def _from_mesh(block: Block, mesh: manifold3d.Mesh64) -> Block:
    """A block of the same kind with another surface."""
    points, triangles = _arrays(mesh)
    rows: list[list[int]] = triangles.tolist()
    return replace(block, vertices=points, faces=tuple(map(tuple, rows)))
