"""Shapes as arrays, which compiled code takes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from learn2assemble.robot.bodies import Shape


@dataclass(frozen=True)
class Faceted:
    """A shape as arrays: its faces, and its edges with the faces that meet there."""

    normals: np.ndarray
    """float64[F, 3], in the frame of the shape."""
    offsets: np.ndarray
    """float64[F] [m]"""
    starts: np.ndarray
    """int64[P + 1]: faces of each convex part."""
    edges: np.ndarray
    """float64[E, 2, 3]: their ends [m]."""
    beside: np.ndarray
    """int64[E, 2]: faces on both sides."""
    corners: np.ndarray
    """float64[V, 3] [m]"""


@lru_cache(maxsize=1024)
def faceted(shape: Shape) -> Faceted:
    """A shape as arrays."""
    normals, offsets, starts = list[np.ndarray](), list[np.ndarray](), [0]
    edges, beside = list[np.ndarray](), list[list[int]]()
    for part in shape:
        solid, centre = part.solid, np.array(part.centre)
        meets: dict[tuple[int, int], list[int]] = {}
        for number, face in enumerate(solid.faces):
            for a, b in zip(face, (*face[1:], face[0]), strict=True):
                meets.setdefault((min(a, b), max(a, b)), []).append(starts[-1] + number)
        for (a, b), faces in meets.items():
            if len(faces) == 2:
                edges.append(solid.points[[a, b]] + centre)
                beside.append(faces)
        normals.append(solid.normals)
        offsets.append(solid.offsets + solid.normals @ centre)
        starts.append(starts[-1] + len(solid.faces))
    return Faceted(
        np.ascontiguousarray(np.vstack(normals)),
        np.concatenate(offsets),
        np.array(starts),
        np.array(edges).reshape(-1, 2, 3),
        np.array(beside).reshape(-1, 2),
        np.vstack([part.points for part in shape]),
    )
