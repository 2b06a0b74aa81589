"""Small holes of a mesh and the triangles that close them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from learn2assemble.geometry.hulls import area_vector

MAX_HOLES, WIDEST = 1000, 0.25
"""Most holes that are closed, and the widest, as a share of the largest side of the mesh."""


class Mended(NamedTuple):
    """A mesh whose holes are closed."""

    mesh: tuple[np.ndarray, np.ndarray]
    """Vertices ``float64[V, 3]`` and triangles ``int64[T, 3]``."""
    widths: tuple[float, ...]
    """Of every hole, in units of the mesh: the diagonal of the box round it."""

    @property
    def words(self) -> str:
        """What is done."""
        return f"closes {in_words(len(self.widths))} up to {max(self.widths):.3g} units wide"


def in_words(holes: int) -> str:
    """``1 hole``, ``2 holes``."""
    return f"{holes} hole{'s' * (holes != 1)}"


def close_holes(vertices: np.ndarray, faces: np.ndarray) -> Mended | None:
    """A mesh closed by triangles; None where what is open is no small hole.

    A hole is closed where one ring of edges bounds it that touches no other. The triangles are
    those of its ring as seen along the normal of its area.

    Args:
        vertices: ``float64[V, 3]``.
        faces: ``int64[T, 3]``, no two corners equal.
    """
    rings = _rings(faces)
    if rings is None or len(rings) > MAX_HOLES:
        return None
    widest = WIDEST * float(np.ptp(vertices, axis=0).max())
    made, widths = [faces], list[float]()
    for ring in rings:
        points = vertices[ring]
        widths.append(float(np.linalg.norm(np.ptp(points, axis=0))))
        filled = _filled(points) if widths[-1] <= widest else None
        if filled is None:
            return None
        made.append(ring[filled])
    return Mended((vertices, np.concatenate(made)), tuple(widths))


def _rings(faces: np.ndarray) -> list[np.ndarray] | None:
    """Rings of vertices round the holes, in the direction in which triangles that close them run;
    None where rings touch or edges are shared by several faces."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], -1).reshape(-1, 2)
    size = int(faces.max()) + 1
    key, back = ends[:, 0] * size + ends[:, 1], ends[:, 1] * size + ends[:, 0]
    if len(np.unique(key)) < len(key):
        return None
    start, end = ends[~np.isin(key, back)].T
    if len(np.unique(start)) < len(start) or len(np.unique(end)) < len(end):
        return None
    before = dict(zip(end.tolist(), start.tolist(), strict=True))
    rings = list[np.ndarray]()
    while before:
        at, previous = before.popitem()
        ring = [at]
        while previous != ring[0]:
            ring.append(previous)
            following = before.pop(previous, None)
            if following is None:
                return None
            previous = following
        rings.append(np.array(ring))
    return rings


def _filled(points: np.ndarray) -> np.ndarray | None:
    """``int64[T, 3]``: triangles between the points of a ring, ``float64[V, 3]``; None where it
    has no area, or crosses itself as seen along its normal."""
    import manifold3d
    import shapely

    library: Any = manifold3d
    moved = points - points.mean(0)
    normal = area_vector(points)
    length = float(np.linalg.norm(normal))
    if length <= 1e-12 * float(np.ptp(points, axis=0).max()) ** 2:
        return None
    normal /= length
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    flat = np.stack([moved @ across, moved @ np.cross(normal, across)], -1)
    if not shapely.Polygon(flat).is_valid:
        return None
    made: np.ndarray = np.asarray(library.triangulate([flat]), np.int64)
    return made if len(made) == len(points) - 2 else None
