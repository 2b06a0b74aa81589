"""Blocks of which it is not known where they are, found among what a picture shows and nothing that
is known explains.

What is above the table and is neither a block whose place is known nor too large falls into
patches. Each lost shape is tried on each patch on every face on which it rests by itself, turned as
the patch is long; the pose that explains most of the pixels and contradicts fewest wins.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, cast

import numpy as np

from learn2assemble.geometry.hulls import resting_turns
from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix, yaw_matrix
from learn2assemble.kernels import kernel
from learn2assemble.robot.bodies import Shape, Solid, body_of, overlaps, solids
from learn2assemble.sensing.faceted import faceted
from learn2assemble.sensing.registration import LEAST, Believed, Look, Seen, register
from learn2assemble.sensing.residuals import PreparedPicture, ray_meets, window_of

ABOVE = 0.008
"""What is higher than this is not the table [m], beyond four standard deviations of a reading."""
TOO_LARGE = 1.4
"""A patch longer than this many diagonals of a block is not that block."""
ROUGH = (0.012, 0.25)
"""How far the first guess of a pose may be off: standard deviations [m], [rad]."""
EXPLAINS = 0.7
"""Share of the pixels of a patch that a block has to explain."""
INTO = 0.004
"""Bodies are not found farther in one another than this [m], beyond what poses are off."""


class Patch(NamedTuple):
    """What is seen and not explained, in one piece."""

    points: np.ndarray
    """float64[n, 3]: in the world [m]."""
    number: int
    """Of the picture."""


@kernel
def _explain(
    depth: np.ndarray,
    rays: np.ndarray,
    window: np.ndarray,
    origin: np.ndarray,
    between: np.ndarray,
    faces: tuple[np.ndarray, np.ndarray, np.ndarray],
    slack: float,
    mask: np.ndarray,
) -> None:
    """Strike from a mask what a block shows, and what borders on it."""
    normals, offsets, starts = faces
    rows, columns = depth.shape
    way = np.zeros(3)
    for v in range(window[0], window[1]):
        for u in range(window[2], window[3]):
            for i in range(3):
                way[i] = (
                    between[i, 0] * rays[v, u, 0]
                    + between[i, 1] * rays[v, u, 1]
                    + between[i, 2] * rays[v, u, 2]
                )
            there, face, _ = ray_meets(origin, way, normals, offsets, starts)
            if face >= 0 and abs(depth[v, u] - there) < slack:
                for a in range(max(0, v - 2), min(rows, v + 3)):
                    for b in range(max(0, u - 2), min(columns, u + 3)):
                        if abs(depth[a, b] - there) < 3 * slack:
                            mask[a, b] = False


def patches(
    views: Sequence[PreparedPicture], known: Sequence[tuple[Shape, np.ndarray]]
) -> list[Patch]:
    """What is above the table and belongs to no block whose pose is known.

    Args:
        views: pictures.
        known: blocks and their poses float64[7].
    """
    from scipy.ndimage import (  # pyright: ignore[reportMissingTypeStubs]
        find_objects,  # pyright: ignore[reportUnknownVariableType]
        label,  # pyright: ignore[reportUnknownVariableType]
    )

    found = list[Patch]()
    for number, view in enumerate(views):
        camera = view.device
        points = camera.points(view.depth)
        sigma = view.noise[0] + view.noise[1] * view.depth**2
        mask = (view.depth > 0) & (points[..., 2] > ABOVE + 4 * sigma)
        place, turn, _, _ = view.camera
        for shape, pose in known:
            arrays, attitude = faceted(shape), quaternion_matrix(pose[3:])
            window = window_of(view, pose[:3] + arrays.corners @ attitude.T)
            if window is None:
                continue
            slack = 0.004 + 4 * camera.sigma(float(camera.project(pose[:3])[2]))
            between = np.ascontiguousarray(attitude.T @ turn)
            faces = arrays.normals, arrays.offsets, arrays.starts
            origin = attitude.T @ (place - pose[:3])
            _explain(view.depth, view.rays, window, origin, between, faces, slack, mask)
        marks = np.zeros(mask.shape, np.int32)
        label(mask, np.ones((3, 3)), marks)
        boxes = cast("list[tuple[slice, slice]]", find_objects(marks))
        for k, box in enumerate(boxes, 1):
            inside = marks[box] == k
            if inside.sum() >= LEAST:
                found.append(Patch(points[box][inside], number))
    return found


def guesses(believed: Believed, patch: Patch) -> list[np.ndarray]:
    """Poses float64[7] in which a block may lie where a patch is, of those that look the same one;
    none where the patch is too large."""
    import shapely

    body = body_of(believed.shape)
    size = float(np.linalg.norm(2 * body.half))
    # Pixels that mix a block with what is behind it lie outside of it.
    low, high = np.percentile(patch.points, (3, 97), axis=0)
    if np.linalg.norm(high - low) > TOO_LARGE * size:
        return []
    inside = ((patch.points >= low) & (patch.points <= high)).all(1)
    flat = shapely.MultiPoint(patch.points[inside, :2]).minimum_rotated_rectangle
    if not isinstance(flat, shapely.Polygon):
        return []
    corners = np.array(flat.exterior.coords)[:4]
    sides = np.roll(corners, -1, 0) - corners
    along = sides[np.argmax(np.linalg.norm(sides, axis=1))]
    yaw, middle = float(np.arctan2(along[1], along[0])), corners.mean(0)
    found: list[np.ndarray] = []
    seen: list[np.ndarray] = []
    for rest in resting_turns(body.hull, body.centre):
        for quarter in range(4):
            turn = yaw_matrix(yaw + quarter * np.pi / 2) @ rest.turn
            if any(
                np.abs(turn @ same - old).max() < 1e-3 for same in believed.turns for old in seen
            ):
                continue
            seen.append(turn)
            # It lies as high as what is seen of it; that may be on others.
            height = float((body.points @ turn[2]).max())
            found.append(np.array([*middle, high[2] - height, *matrix_quaternion(turn)]))
    return found


def find(
    views: Sequence[PreparedPicture],
    lost: Sequence[Believed],
    known: Sequence[tuple[Shape, np.ndarray]],
    hidden: Sequence[tuple[Shape, np.ndarray]] = (),
) -> list[Seen]:
    """Where blocks are of which nothing is known.

    Args:
        views: pictures.
        lost: blocks; of equal shapes it does not matter which is which.
        known: bodies that are seen where they are said to be, see :func:`patches`; no block is
            found inside of them.
        hidden: those of which nobody sees whether they are there.

    Returns:
        those that were found.
    """
    known, left, found = list(known), list(lost), list[Seen]()
    while left:
        best: tuple[int, Seen, Believed] | None = None
        there = [solids(*body) for body in known]
        for patch in patches(views, [*known, *hidden]):
            tried: set[Shape] = set()
            for one in left:
                if one.shape in tried:
                    continue
                tried.add(one.shape)
                for pose in guesses(one, patch):
                    seen = register(views, one._replace(pose=pose, search=ROUGH))
                    if seen.look != Look.SEEN or _inside(seen, one, there):
                        continue
                    worth = seen.pixels - 2 * seen.behind
                    if worth > EXPLAINS * len(patch.points) and (not best or worth > best[0]):
                        best = worth, seen, one
        if best is None:
            return found
        seen, one = best[1:]
        closer = register(views, one._replace(pose=seen.pose))
        seen = seen if closer.look != Look.SEEN or _inside(closer, one, there) else closer
        known.append((one.shape, seen.pose))
        found.append(seen)
        left.remove(one)
    return found


def _inside(seen: Seen, believed: Believed, there: Sequence[list[Solid]]) -> bool:
    """Whether a block would be inside of other bodies where it seems to be."""
    body = solids(believed.shape, seen.pose)
    return any(overlaps(body, other, INTO) for other in there)
