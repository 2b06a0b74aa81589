"""Contacts of edges and vertices: with faces, with one another, and with the ground.

Two convex bodies touch where a plane separates them and both reach it within the tolerance. The
planes looked at are those of the faces of both, and those along an edge of each (the cross product
of the edges is the normal); the one that separates best is taken. What both bodies have within the
tolerance of it, projected on it and intersected, is the patch: a point, a line or a polygon.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely
from shapely import MultiPoint
from shapely.geometry.base import BaseGeometry

from learn2assemble.assembly.blocks import Block
from learn2assemble.assembly.parts import convex_parts
from learn2assemble.geometry.hulls import area_vector

_library: Any = shapely
"""Decorated functions without types."""
LOOSE = 2.0
"""Widest gap and deepest overlap of such a contact, in those of two faces: poses that were measured
or that a simulation settled leave bodies that touch at a point farther apart than faces."""
_PARALLEL = 1e-3
"""Sine of the angle below which two edges have no normal in common."""
_ROUNDS = 100
"""In which the middle of more than two normals is found."""


class PointPatch(NamedTuple):
    """What two blocks share on the plane that separates them."""

    a: int
    """Index of the block that pushes back, or -1 for the ground."""
    b: int
    normal: np.ndarray
    """float64[3]: unit, from ``a`` to ``b``, in the middle of those that are possible."""
    points: np.ndarray
    """float64[k, 3]: corners [m, world]."""
    spread: float
    """Angle to the farthest of the possible normals [rad]; a right one where none is known."""
    gap: float
    """Along the normal, in tolerances; below 0 where they overlap."""


class _PointSolid(NamedTuple):
    vertices: np.ndarray
    normals: np.ndarray
    edges: np.ndarray


def between(blocks: Sequence[Block], pairs: np.ndarray, width: np.ndarray) -> list[PointPatch]:
    """Contacts of the pairs (int64[N, 2], a < b) of blocks.

    Args:
        width: float64[B], the tolerance of each block [m]; the smaller one of a pair counts.
    """
    bodies: dict[int, list[_PointSolid]] = {}
    found = list[PointPatch]()
    listed: list[list[int]] = pairs.tolist()
    for a, b in listed:
        for k in (a, b):
            if k not in bodies:
                block = blocks[k]
                parts = [block] if block.is_convex else convex_parts(block)
                bodies[k] = [_body(part) for part in parts]
        for one in bodies[a]:
            for two in bodies[b]:
                patch = _touch(one, two, float(min(width[a], width[b])))
                if patch is not None:
                    found.append(PointPatch(a, b, *patch))
    return found


def on_ground(blocks: Sequence[Block], indices: np.ndarray, width: np.ndarray) -> list[PointPatch]:
    """Contacts of the blocks with these indices with the plane z = 0."""
    found = list[PointPatch]()
    listed: list[int] = indices.tolist()
    for k in listed:
        vertices = blocks[k].vertices
        low = vertices[np.abs(vertices[:, 2]) <= width[k]]
        if len(low):
            flat = _corners(_hull(low[:, :2]))
            points = np.column_stack([flat, np.zeros(len(flat))])
            gap = float(vertices[:, 2].min() / width[k])
            found.append(PointPatch(-1, k, np.array([0.0, 0.0, 1.0]), points, 0.0, gap))
    return found


def _body(block: Block) -> _PointSolid:
    xyz = block.vertices
    centre = xyz.mean(0)
    normals, edges = list[np.ndarray](), list[tuple[int, int]]()
    for face in block.faces:
        corners = xyz[list(face)]
        normal = area_vector(corners)
        size = np.linalg.norm(normal)
        if size > 0:
            normal = normal / size
            normals.append(normal if normal @ (corners.mean(0) - centre) >= 0 else -normal)
        edges += [(min(p, q), max(p, q)) for p, q in zip(face, face[1:] + face[:1], strict=True)]
    ends = np.array(sorted(set(edges)))
    along = xyz[ends[:, 1]] - xyz[ends[:, 0]]
    length = np.linalg.norm(along, axis=1)
    along = along[length > 0] / length[length > 0, None]
    return _PointSolid(xyz, np.array(normals), along)


def _apart(one: _PointSolid, two: _PointSolid, axes: np.ndarray) -> np.ndarray:
    """Distance of two bodies along unit axes that point from the first to the second."""
    return (two.vertices @ axes.T).min(0) - (one.vertices @ axes.T).max(0)


def _touch(
    one: _PointSolid, two: _PointSolid, width: float
) -> tuple[np.ndarray, np.ndarray, float, float] | None:
    axes = np.concatenate([one.normals, -two.normals])
    apart = _apart(one, two, axes)
    if apart.max() > width:
        return None
    cross = np.cross(one.edges[:, None], two.edges[None]).reshape(-1, 3)
    size = np.linalg.norm(cross, axis=1)
    cross = cross[size > _PARALLEL] / size[size > _PARALLEL, None]
    away = two.vertices.mean(0) - one.vertices.mean(0)
    cross[cross @ away < 0] *= -1
    # A plane of edges has to be better than that of a face by more than rounding.
    axes = np.concatenate([axes, cross])
    apart = np.concatenate([apart, _apart(one, two, cross) - 1e-3 * width])
    best = int(np.argmax(apart))
    if apart[best] > width:
        return None
    normal = axes[best]
    near_one, near_two = one.vertices @ normal, two.vertices @ normal
    top, bottom = near_one.max(), near_two.min()
    helper = np.eye(3)[np.argmin(np.abs(normal))]
    u = np.cross(helper, normal)
    u /= np.linalg.norm(u)
    basis = np.stack([u, np.cross(normal, u)])
    left = _hull(one.vertices[near_one >= top - width] @ basis.T)
    right = _hull(two.vertices[near_two <= bottom + width] @ basis.T)
    shared = shapely.intersection(left, right)
    if shared.is_empty:
        line = _library.shortest_line(left, right)
        if np.hypot(_library.length(line), max(bottom - top, 0.0)) > width:
            return None
        shared = _library.centroid(line)
    flat = _corners(shared.convex_hull)
    points = flat @ basis + (top + bottom) / 2 * normal
    middle, spread = middle_of(axes[apart > apart[best] - width / 2])
    gap = float(apart[best] / width)
    # So deep in one another they may have come from anywhere.
    return middle, points, spread if gap >= -1 else np.pi / 2, gap


def middle_of(axes: np.ndarray) -> tuple[np.ndarray, float]:
    """The middle of some unit vectors float64[n, 3], and the angle to the farthest [rad]."""
    first, second = divmod(int(np.argmin(axes @ axes.T)), len(axes))
    middle = axes[first] + axes[second]
    for k in range(_ROUNDS):
        size = np.linalg.norm(middle)
        if size < 1e-6:
            return axes[first], np.pi  # They point against one another.
        middle = middle / size
        farthest = axes[np.argmin(axes @ middle)]
        if k == 0 and middle @ farthest > middle @ axes[first] - 1e-9:
            break  # The two that are farthest apart have all others between them.
        middle = middle + (farthest - middle) / (k + 3)
    cosine = float((axes @ middle).min() / np.linalg.norm(middle))
    return middle / np.linalg.norm(middle), float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _hull(points: np.ndarray) -> BaseGeometry:
    return MultiPoint(points).convex_hull


def _corners(shape: BaseGeometry) -> np.ndarray:
    """float64[k, 2]: corners of a point, a line or a polygon, each once."""
    corners = shapely.get_coordinates(shape)
    return corners[:-1] if shape.geom_type == "Polygon" else corners
