"""Convex polyhedra: their plane faces, on which faces they rest, and when two are one shape.

Lengths are metres. A hull is a value: equal corners are one hull, whatever has been computed of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

ONE_PLANE = 1e-7
"""How far a point of a hull may be from a plane to lie in it, in extents of the hull."""


def convex_hull(points: np.ndarray) -> tuple[np.ndarray, tuple[tuple[int, ...], ...]]:
    """The convex hull of points, each of its plane faces as one polygon.

    Args:
        points: float64[N, 3], at least four that lie in no plane [m].

    Returns:
        float64[V, 3] corners, and vertex numbers of each face, counter-clockwise from outside.

    Raises:
        ValueError: where all points lie in a plane.
    """
    from scipy.spatial import ConvexHull, QhullError  # pyright: ignore[reportMissingTypeStubs]

    try:
        hull = ConvexHull(points - points[0])
    except QhullError:
        raise ValueError("points in a plane") from None
    corners = points[hull.vertices]
    triangles = np.searchsorted(hull.vertices, hull.simplices)
    a, b, c = np.moveaxis(corners[triangles], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    width = ONE_PLANE * float(np.ptp(corners, axis=0).max())
    # Planes of large triangles are known best; slivers along an edge lie in two of them.
    left, planes = np.ones(len(triangles), bool), list[tuple[np.ndarray, np.ndarray]]()
    for k in np.argsort(-area):
        if left[k]:
            normal = hull.equations[k, :3]
            inside = np.abs((corners - corners[triangles[k, 0]]) @ normal) < width
            left &= ~inside[triangles].all(1)
            planes.append((normal, inside))
    # What fewer than three planes meet in is a point of a face or of an edge.
    corner = np.sum([inside for _, inside in planes], axis=0) >= 3
    number, faces = np.cumsum(corner) - 1, list[tuple[int, ...]]()
    for normal, inside in planes:
        face = np.flatnonzero(inside & corner)
        arm = corners[face] - corners[face].mean(0)
        turn = np.arctan2(arm @ np.cross(normal, arm[0]), arm @ arm[0])
        faces.append(tuple(number[face[np.argsort(turn)]].tolist()))
    return corners[corner], tuple(faces)


@dataclass(frozen=True, order=True)
class Hull:
    """A convex polyhedron.

    Args:
        corners: of it, in any order [m]; points inside are left out.
    """

    corners: tuple[tuple[float, float, float], ...]

    @cached_property
    def _surface(self) -> tuple[np.ndarray, tuple[tuple[int, ...], ...]]:
        return convex_hull(np.array(self.corners, float))

    @property
    def points(self) -> np.ndarray:
        """float64[V, 3]: its corners."""
        return self._surface[0]

    @property
    def faces(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the corners of each face, counter-clockwise from outside."""
        return self._surface[1]

    @cached_property
    def normals(self) -> np.ndarray:
        """float64[F, 3]: unit vectors out of the faces."""
        normals = np.array([area_vector(self.points[list(face)]) for face in self.faces])
        return normals / np.linalg.norm(normals, axis=1, keepdims=True)

    @cached_property
    def offsets(self) -> np.ndarray:
        """float64[F]: distances of the planes of the faces from the origin, along the normals."""
        middles = [self.points[list(face)].mean(0) for face in self.faces]
        return np.einsum("fi,fi->f", self.normals, np.array(middles))

    @cached_property
    def edges(self) -> np.ndarray:
        """float64[E, 3]: unit vectors along its edges, one of each two that are opposite."""
        pairs = {
            (min(p, q), max(p, q))
            for face in self.faces
            for p, q in zip(face, (*face[1:], face[0]), strict=True)
        }
        along = np.array([self.points[q] - self.points[p] for p, q in sorted(pairs)])
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        first = np.argmax(np.abs(along) > 1e-6, axis=1)
        along *= np.sign(along[np.arange(len(along)), first])[:, None]
        return np.unique(along.round(9), axis=0)

    @cached_property
    def _moments(self) -> tuple[float, np.ndarray]:
        origin, six, moment = self.points.mean(0), 0.0, np.zeros(3)
        for face in self.faces:
            corners = self.points[list(face)] - origin
            for k in range(1, len(face) - 1):
                a, b, c = corners[0], corners[k], corners[k + 1]
                part = float(a @ np.cross(b, c))
                six, moment = six + part, moment + part * (a + b + c)
        return six / 6, origin + moment / (4 * six)

    @property
    def volume(self) -> float:
        """[m³]"""
        return self._moments[0]

    @property
    def centroid(self) -> np.ndarray:
        """float64[3]: of its volume."""
        return self._moments[1]

    def polygon(self, face: int) -> np.ndarray:
        """float64[n, 3]: corners of a face."""
        return self.points[list(self.faces[face])]

    def triangles(self) -> np.ndarray:
        """float64[t, 3, 3]: its faces as triangles [m]."""
        return np.array(
            [
                self.points[[face[0], face[k], face[k + 1]]]
                for face in self.faces
                for k in range(1, len(face) - 1)
            ]
        )

    def shrunk(self, room: float) -> Hull:
        """The hull with every face moved inwards [m]; itself where nothing would be left."""
        from scipy import spatial  # pyright: ignore[reportMissingTypeStubs]

        planes = np.column_stack([self.normals, room - self.offsets])
        inside = self.centroid
        if (planes[:, :3] @ inside + planes[:, 3]).max() > -1e-9:
            return self
        try:
            return hull_of(spatial.HalfspaceIntersection(planes, inside).intersections)
        except (spatial.QhullError, ValueError):
            return self


def hull_of(points: np.ndarray) -> Hull:
    """The hull of points float64[N, 3], of which only the corners are kept.

    Raises:
        ValueError: where all points lie in a plane.
    """
    corners = convex_hull(np.asarray(points, float))[0]
    return Hull(tuple((x, y, z) for x, y, z in (corners.round(9) + 0.0).tolist()))


def box_hull(half: Sequence[float]) -> Hull:
    """A box with these half extents about the origin."""
    signs = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    return Hull(tuple((x * half[0], y * half[1], z * half[2]) for x, y, z in signs))


# ---------------------------------------------------------------- resting


@dataclass(frozen=True, eq=False)
class Rest:
    """A way in which something lies on a level ground."""

    turn: np.ndarray
    """float64[3, 3]: rotation from its own frame; z points up."""
    margin: float
    """By which it can be tilted before it falls over [rad]."""


def resting_turns(hull: Hull, centre: np.ndarray, least: float = math.radians(3.0)) -> list[Rest]:
    """The faces of a hull on which a body rests by itself, the most stable ones first.

    Args:
        hull: of the body.
        centre: float64[3], its centre of mass.
        least: margin [rad] below which it does not count as resting.
    """
    found = list[Rest]()
    for face, normal in enumerate(hull.normals):
        corners = hull.polygon(face)
        height = float((corners[0] - centre) @ normal)
        ahead = np.roll(corners, -1, 0) - corners
        out = np.cross(ahead, normal)
        out /= np.linalg.norm(out, axis=1, keepdims=True)
        inside = float(np.einsum("ki,ki->k", corners - centre, out).min())
        margin = math.atan2(inside, height)
        if margin >= least:
            found.append(Rest(turned_down(normal, ahead), margin))
    return sorted(found, key=lambda rest: -round(rest.margin, 9))


def turned_down(normal: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """float64[3, 3]: rotation that turns a face down, its longest edge along x.

    Args:
        normal: float64[3], unit vector out of the face.
        edges: float64[n, 3] of the face.
    """
    along = edges[np.argmax(np.linalg.norm(edges, axis=1).round(9))]
    along = along - normal * (along @ normal)
    along /= np.linalg.norm(along)
    return snapped(np.stack([along, np.cross(-normal, along), -normal]))


def snapped(turn: np.ndarray) -> np.ndarray:
    """A rotation, exactly along the axes where it is but for rounding."""
    near = np.rint(turn)
    return near + 0.0 if np.abs(turn - near).max() < 1e-9 else turn


# ---------------------------------------------------------------- one shape at any pose


def rotations_onto(one: np.ndarray, two: np.ndarray, grain: float) -> Iterator[np.ndarray]:
    """Rotations about the mean that bring a set of points onto another one.

    Args:
        one: float64[n, 3], not all on a line.
        two: float64[n, 3].
        grain: distance below which points are one [m].

    Yields:
        float64[3, 3], each once.
    """
    if len(one) != len(two):
        return
    a, b = one - one.mean(0), two - two.mean(0)
    size, other = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
    if np.abs(np.sort(size) - np.sort(other)).max() > grain:
        return
    # The points that say most about a turn: far from the middle, and far off the first one's line.
    p = int(np.argmax(size))
    q = int(np.argmax(np.linalg.norm(np.cross(a[p], a), axis=1)))
    first, seen = _frame(a[p], a[q]), list[np.ndarray]()
    apart = np.linalg.norm(a[p] - a[q])
    for i in np.flatnonzero(np.abs(other - size[p]) <= grain):
        there = np.abs(np.linalg.norm(b - b[i], axis=1) - apart) <= 2 * grain
        for j in np.flatnonzero(there & (np.abs(other - size[q]) <= grain)):
            turn = _frame(b[i], b[j]) @ first.T
            far = np.linalg.norm((a @ turn.T)[:, None] - b, axis=2)
            # A turn fitted to two points is off by their error over their distance.
            fits = (far.min(1) <= 4 * grain).all() and (far.min(0) <= 4 * grain).all()
            if fits and all(np.abs(turn - old).max() > 1e-6 for old in seen):
                seen.append(turn)
                yield turn


def _frame(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    x = a / np.linalg.norm(a)
    z = np.cross(a, b)
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], 1)


# ---------------------------------------------------------------- room between two


def separation(
    one: tuple[np.ndarray, np.ndarray, np.ndarray], two: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> tuple[float, np.ndarray]:
    """How far two convex bodies are apart along the axis that parts them most.

    Args:
        one, two: points float64[V, 3], normals float64[F, 3] and edges float64[E, 3], unit
            vectors, of each where it is.

    Returns:
        the distance [m], below 0 where they overlap, and the unit vector from the first to the
        second; axes along edges of both count only where no face parts them.
    """
    cross = np.cross(one[2][:, None], two[2][None]).reshape(-1, 3)
    length = np.linalg.norm(cross, axis=1)
    best: tuple[float, np.ndarray] | None = None
    for axes in (np.vstack([one[1], two[1]]), cross[length > 1e-6] / length[length > 1e-6, None]):
        if best is not None and best[0] >= 0:
            break
        if not len(axes):
            continue
        a, b = one[0] @ axes.T, two[0] @ axes.T
        ahead, behind = b.min(0) - a.max(0), a.min(0) - b.max(0)
        gap = np.maximum(ahead, behind)
        k = int(np.argmax(gap.round(9)))
        way = axes[k] if ahead[k] >= behind[k] else -axes[k]
        if best is None or gap[k] > best[0] + 1e-9:
            best = float(gap[k]), way
    assert best is not None
    return best


def cross_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """float64[..., 3]: cross products of vectors, one float64[3] each or rows of them; quicker than
    numpy's for few of them."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], -1)


def area_vector(corners: np.ndarray) -> np.ndarray:
    """float64[3]: along the normal of a ring of corners, float64[n, 3], towards where it is
    counter-clockwise from, and twice as long as its area is large."""
    # From the middle: far from the origin rounding is larger than small faces.
    arm = corners - corners.mean(0)
    x, y, z = arm.T
    u, v, w = np.concatenate([arm[1:], arm[:1]]).T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], 1).sum(0)


def kern(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The kern of a convex section: where a push leaves no tension anywhere if stress varies
    linearly. Of a rectangle it is the rhombus a third as long and a third as wide.

    Args:
        corners: float64[n, 2], of the section, in turn.

    Returns:
        The centroid of the section float64[2], and the corners of the kern float64[m, 2], one for
        each side of the section; None of a section without a width.
    """
    start = corners - corners.mean(0)
    end = np.roll(start, -1, 0)
    turn = start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]
    area = float(turn.sum()) / 2
    side = end - start
    length = np.linalg.norm(side, axis=1)
    # The products of two doubles round by this share of the square of a length.
    if abs(area) <= 1e-9 * float(length.max()) ** 2:
        return None
    middle = (turn[:, None] * (start + end)).sum(0) / (6 * area)
    both = start[:, :, None] * start[:, None] + end[:, :, None] * end[:, None]
    mixed = start[:, :, None] * end[:, None]
    second = (turn[:, None, None] * (2 * both + mixed + mixed.transpose(0, 2, 1))).sum(0) / 24
    second -= area * np.outer(middle, middle)
    real = length > 1e-9 * length.max()
    out = np.stack([side[:, 1], -side[:, 0]], 1)[real] / length[real, None]
    distance = ((start[real] - middle) * out).sum(1)
    # A push there turns the stress to zero along the whole side; where corners follow each other to
    # the right, area, second moments and distances are all negative.
    spots = middle - out @ second / (area * distance[:, None])
    return middle + corners.mean(0), spots + corners.mean(0)
