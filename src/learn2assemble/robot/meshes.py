"""Triangle meshes for pictures: simple solids, and normals that keep sharp edges sharp."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

_CREASE = np.cos(np.radians(60.0))
"""Faces that meet at a larger angle do not share a normal."""
_SAME = 1e-6
"""Corners nearer than this are one [m]."""
_AROUND = 24
"""Sides of what is round."""


class Mesh(NamedTuple):
    """Triangles with a normal at every vertex; counter-clockwise as seen from outside."""

    vertices: np.ndarray
    """float64[v, 3] [m]."""
    normals: np.ndarray
    """float64[v, 3], unit."""
    faces: np.ndarray
    """int32[f, 3], indices of vertices."""


def shaded(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """A mesh with normals: means over the faces round a vertex that meet smoothly.

    Args:
        vertices: float64[v, 3] [m]; equal ones are merged first.
        faces: int[f, 3].
    """
    _, first, same = np.unique(
        np.round(vertices / _SAME).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    points, faces = vertices[first], same.reshape(-1)[faces]
    a, b, c = (points[faces[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)
    size = np.linalg.norm(area, axis=1)
    kept = size > 1e-14
    faces, area, size = faces[kept], area[kept], size[kept]
    unit = area / size[:, None]
    corner = faces.ravel()
    face = np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(corner, kind="stable")
    corner, face = corner[order], face[order]
    total = np.zeros((len(corner), 3))
    # Corners at one vertex lie side by side: compare each with those 0, 1, 2, ... places on.
    for shift in range(int(np.bincount(corner).max(initial=0))):
        i = np.arange(len(corner) - shift)
        i = i[corner[i] == corner[i + shift]]
        j = i + shift
        near = (unit[face[i]] * unit[face[j]]).sum(1) > _CREASE
        i, j = i[near], j[near]
        total[i] += area[face[j]]
        if shift:
            total[j] += area[face[i]]
    total /= np.linalg.norm(total, axis=1)[:, None]
    key = np.column_stack([corner, np.round(total * 1000).astype(np.int64)])
    _, first, which = np.unique(key, axis=0, return_index=True, return_inverse=True)
    found = np.empty(len(corner), np.int32)
    found[order] = which.reshape(-1)
    return Mesh(points[corner[first]], total[first], found.reshape(-1, 3))


def box(half: np.ndarray) -> Mesh:
    """A box with these half extents, float64[3] [m], about the origin."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    faces = [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6),
        (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ]  # fmt: skip
    return shaded(signs * half, np.array(faces))


def capsule(radius: float, half: float, rounded: bool = True) -> Mesh:
    """A capsule along z, or a cylinder where it is not ``rounded``; half length [m] without the
    round ends. A sphere is a capsule of half length 0."""
    if rounded:
        angle = np.linspace(-np.pi / 2, np.pi / 2, _AROUND // 2 + 1)
        profile = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        profile[:, 1] += np.where(angle < 0, -half, half)
        lower = np.column_stack([profile[angle <= 0, 0], profile[angle <= 0, 1]])
        lower[-1, 1] = -half
        profile = np.vstack([lower, [radius, half], profile[angle > 1e-9]])
    else:
        profile = np.array([[0, -half], [radius, -half], [radius, half], [0, half]])
    turn = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)
    rings = np.array([[r * np.cos(turn), r * np.sin(turn), np.full_like(turn, z)]
                      for r, z in profile]).transpose(0, 2, 1)  # fmt: skip
    k = np.arange(_AROUND)
    after = (k + 1) % _AROUND
    faces = []
    for ring in range(len(profile) - 1):
        low, high = ring * _AROUND, (ring + 1) * _AROUND
        faces += [np.stack([low + k, low + after, high + after], 1),
                  np.stack([low + k, high + after, high + k], 1)]  # fmt: skip
    return shaded(rings.reshape(-1, 3), np.concatenate(faces))
