"""What fills cells: a solid on a lattice, and where the lattice fits it best.

A solid is the closed surface around it, triangles ``float64[N, 3, 3]`` counter-clockwise as seen
from outside. Surfaces that are parallel to z have no share in a volume, so they may be missing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

MAX_CELLS = 64
"""Largest number of cells along an axis."""
HALF = 0.5 - 1e-6
"""A cell is filled from this share of its volume on; the slack is for rounding."""
_SLACK = 1e-9
"""Rounding of a coordinate [cells]."""
_SYMMETRIC = 1e-3
"""A place about the middle of a design is kept unless another misfits by so much less, as a share
of its volume."""
_MIRRORED = 5e-3
"""The same where cells that are their own mirror image about the middle would become cells that
are not: a symmetric wall with a notch at one end is what nobody drew."""
_PLANES = 3
"""So many of the largest faces across an axis are tried as planes of the lattice."""


def shares(triangles: np.ndarray, shape: Sequence[int]) -> np.ndarray:
    """Share of every cell that is inside, ``float64[X, Y, Z]``; exact but for rounding.

    Triangles are cut along the planes of the lattice; what is below a piece counts positive where
    it faces up and negative where it faces down (divergence theorem). Where surfaces overlap or
    are inside out, shares are above 1 or below 0.

    Args:
        triangles: in cells, within ``[0, shape]``.
    """
    pieces = triangles[np.abs(_seen_from_above(triangles)) > 1e-15]
    for axis in range(3):
        pieces = _cut(pieces, axis)
    area, middle = _seen_from_above(pieces), pieces.mean(1)
    index = np.clip(np.floor(middle).astype(np.int64), 0, np.array(shape) - 1)
    flat, size = np.ravel_multi_index(tuple(index.T), tuple(shape)), int(np.prod(shape))
    height = middle[:, 2] - index[:, 2]
    own = np.bincount(flat, area * height, size).reshape(shape)
    column = np.bincount(flat, area, size).reshape(shape)
    above = np.cumsum(column[:, :, ::-1], 2)[:, :, ::-1] - column
    return own + above


def _seen_from_above(triangles: np.ndarray) -> np.ndarray:
    """Areas projected along z, positive where a triangle faces up."""
    u, v = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def _cut(triangles: np.ndarray, axis: int) -> np.ndarray:
    """The triangles in pieces, each between two neighbouring planes across ``axis``."""
    done = list[np.ndarray]()
    while len(triangles):
        along = triangles[:, :, axis]
        low, high = np.floor(along.min(1) + _SLACK), np.ceil(along.max(1) - _SLACK)
        wide = high - low > 1
        done.append(triangles[~wide])
        triangles, plane = triangles[wide], ((low + high) // 2)[wide]
        above = triangles[:, :, axis] > plane[:, None]
        single = above.sum(1) == 1
        lone = above.argmin(1)
        lone[single] = above[single].argmax(1)
        turned = (lone[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(triangles, turned[:, :, None], 1), 1, 0)
        p, q = (_crossing(a, end, axis, plane) for end in (b, c))
        triangles = np.concatenate(
            [np.stack(corners, 1) for corners in ((a, p, q), (p, b, c), (p, c, q))]
        )
    return np.concatenate(done) if done else triangles


def _crossing(start: np.ndarray, end: np.ndarray, axis: int, plane: np.ndarray) -> np.ndarray:
    t = (plane - start[:, axis]) / (end[:, axis] - start[:, axis])
    point = start + (end - start) * t[:, None]
    point[:, axis] = plane
    return point


# ---------------------------------------------------------------- where the lattice lies


def fit(triangles: np.ndarray, free: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Shares of the cells of the lattice that fits best, and where its first cell begins.

    The lattice may be moved along the axes ``free``. It is put where cells that are filled from
    half their volume on differ least from the solid (symmetric difference); about the middle of
    the solid where that makes no difference, or hardly any and the cells there are symmetric, so
    that a symmetric solid stays so.

    Args:
        triangles: in cells.

    Returns:
        ``float64[X, Y, Z]``, and the lower corner of cell (0, 0, 0), ``float64[3]`` [cells].
    """
    places = {axis: _places(triangles, axis) for axis in free}
    offset = np.array([places[axis][0] if axis in places else 0.0 for axis in range(3)])
    best = _laid(triangles, offset)
    for axis in free:
        for place in places[axis][1:]:
            moved = offset.copy()
            moved[axis] = place
            found = _laid(triangles, moved)
            volume = max(float(found[0].sum()), _SLACK)
            least = _SYMMETRIC
            if _mirrored(best[0], axis) and not _mirrored(found[0], axis):
                least = _MIRRORED
            if misfit(found[0]) < misfit(best[0]) - least * volume:
                offset, best = moved, found
    return best


def misfit(share: np.ndarray) -> float:
    """Volume by which the filled cells and the solid differ [cells]."""
    return float(np.where(share >= HALF, np.abs(1 - share), np.abs(share)).sum())


def _mirrored(share: np.ndarray, axis: int) -> bool:
    """Whether the filled cells are their own mirror image along an axis."""
    filled = np.moveaxis(share >= HALF, axis, 0)
    used = np.flatnonzero(filled.any((1, 2)))
    filled = filled[used[0] : used[-1] + 1] if len(used) else filled
    return bool((filled == filled[::-1]).all())


def _laid(triangles: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    moved = triangles - offset
    points = moved.reshape(-1, 3)
    first = np.floor(points.min(0) + _SLACK)
    shape = np.maximum(np.ceil(points.max(0) - _SLACK) - first, 1).astype(np.int64)
    return shares(moved - first, shape.tolist()), first + offset


def _places(triangles: np.ndarray, axis: int) -> list[float]:
    """Where a plane of the lattice may lie, all in [0, 1): the most natural first."""
    along = triangles[:, :, axis]
    middle = (along.min() + along.max()) / 2
    u, v = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(u, v)
    across = np.abs(normal[:, axis]) > 0.999 * np.linalg.norm(normal, axis=1)
    weight = np.abs(normal[across, axis])
    middles = np.asarray(along[across].mean(1) % 1, float).round(6) % 1
    position, group = np.unique(middles, return_inverse=True)
    order = np.argsort(-np.bincount(group, weight, len(position)), kind="stable")
    # Whole cells about the middle, then half a cell further, then faces on planes.
    wanted = [middle, middle + 0.5, *position[order[:_PLANES]]]
    if round(float(np.ptp(along))) % 2:
        wanted[:2] = wanted[1::-1]
    kept: list[float] = []
    for place in (float(place % 1) for place in wanted):
        if all(min(abs(place - k), 1 - abs(place - k)) > 1e-6 for k in kept):
            kept.append(place)
    return kept
