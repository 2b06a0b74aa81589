"""Bricks as boxes on a lattice of studs: which clutch which, and which stand side by side."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull  # pyright: ignore[reportMissingTypeStubs]

from learn2assemble.assembly.blocks import Block
from learn2assemble.errors import InputError

GROUND = -1
_OFF = 0.05
"""How far a box may be from the lattice, in studs and layers."""
_TRIANGLE = np.array([(-0.25, 0.0), (0.125, -0.125), (0.125, 0.125)])
"""Where a knob touches a brick two studs wide: a wall at -x, two tubes; from the knob [studs]."""
_CROSS = np.array([(0.25, 0.0), (-0.25, 0.0), (0.0, 0.25), (0.0, -0.25)])
"""Where it touches the four walls of a brick one stud wide."""


class Grip(NamedTuple):
    """The contact points of one joint, from the smallest corner of its upper brick [studs]."""

    pull: float
    """How many points pull."""
    middle: tuple[float, float]
    """Of their pulls."""
    corners: np.ndarray
    """float64[k, 2]: of the hull of the points."""


class Clutches(NamedTuple):
    """Joints of bricks that lie on one another."""

    lower: np.ndarray
    """int64[J]: GROUND for the base."""
    upper: np.ndarray
    """int64[J]."""
    first: np.ndarray
    """int64[J, 2]: the first knob."""
    last: np.ndarray
    """int64[J, 2]: the one after the last."""
    layer: np.ndarray
    """int64[J]: height of the joint."""


class Sides(NamedTuple):
    """Rectangles in which bricks stand side by side."""

    a: np.ndarray
    b: np.ndarray
    """int64[S]: b is beyond a along the axis."""
    axis: np.ndarray
    """int64[S]: 0 or 1."""
    low: np.ndarray
    high: np.ndarray
    """int64[S, 3]."""


class StudLattice:
    """Boxes of blocks in studs and layers.

    Args:
        blocks: where they stand.
        pitch: distance of studs, height of a layer [m].

    Raises:
        InputError: for blocks that are no upright boxes on one lattice, or that overlap.
    """

    low: np.ndarray
    size: np.ndarray
    offset: np.ndarray

    def __init__(self, blocks: Sequence[Block], pitch: tuple[float, float]) -> None:
        self.pitch = pitch
        self.low, self.size, self.offset = _boxes(blocks, pitch)
        self.high: np.ndarray = self.low + self.size
        self._owner, cells = _cells(self.low, self.size)
        low = cells.min(0) - 1
        self._stride = cells.max(0) - low + 3
        self._key = self._keys(cells, low)
        order = np.argsort(self._key, kind="stable")
        self._sorted, self._by_key = self._key[order], self._owner[order]
        twice = np.flatnonzero(np.diff(self._sorted) == 0)
        if len(twice):
            pair: list[int] = self._by_key[twice[0] : twice[0] + 2].tolist()
            i, j = sorted(pair)
            names = f"{blocks[i].id!r} and {blocks[j].id!r}"
            raise InputError(f"blocks {names}", "an overlap", "blocks that only touch")

    def clutches(self, ground: bool) -> Clutches:
        """The joints between bricks, and with the ground at layer 0 where there is one."""
        other = self._beside((0, 0, -1))
        pair = (other >= 0) & (other != self._owner)
        lower, upper = _pairs(other[pair], self._owner[pair], len(self.low))
        if ground:
            based = np.flatnonzero(self.low[:, 2] == 0)
            lower = np.concatenate([lower, np.full(len(based), GROUND)])
            upper = np.concatenate([upper, based])
        first, last = self.low[upper, :2].copy(), self.high[upper, :2].copy()
        real = lower >= 0
        first[real] = np.maximum(first[real], self.low[lower[real], :2])
        last[real] = np.minimum(last[real], self.high[lower[real], :2])
        return Clutches(lower, upper, first, last, self.low[upper, 2])

    def sides(self) -> Sides:
        """Where bricks stand side by side."""
        parts = list[tuple[np.ndarray, np.ndarray, np.ndarray]]()
        for axis, step in ((0, (1, 0, 0)), (1, (0, 1, 0))):
            other = self._beside(step)
            pair = (other >= 0) & (other != self._owner)
            a, b = _pairs(self._owner[pair], other[pair], len(self.low))
            parts.append((a, b, np.full(len(a), axis)))
        a, b, axis = (np.concatenate(part) for part in zip(*parts, strict=True))
        low = np.maximum(self.low[a], self.low[b])
        high = np.minimum(self.high[a], self.high[b])
        return Sides(a, b, axis, low, high)

    def _keys(self, cells: np.ndarray, low: np.ndarray) -> np.ndarray:
        x, y, z = (cells - low).T
        return (x * self._stride[1] + y) * self._stride[2] + z

    def _beside(self, step: tuple[int, int, int]) -> np.ndarray:
        """int64[cells]: the brick in the cell one step from each, or -1."""
        shift = (step[0] * self._stride[1] + step[1]) * self._stride[2] + step[2]
        wanted: np.ndarray = self._key + shift
        at = np.minimum(np.searchsorted(self._sorted, wanted), len(self._sorted) - 1)
        return np.where(self._sorted[at] == wanted, self._by_key[at], -1)


@lru_cache(maxsize=20_000)
def grip(x: int, y: int, across: int, along: int, size: tuple[int, int]) -> Grip:
    """The contact points of a joint.

    A knob under a brick that is one stud wide touches its four walls; else a long wall and two
    tubes: a triangle that is turned to the wall. Where both pairs of walls are as long as each
    other, half of the pull is in the triangle of either.

    Args:
        x, y: the first knob, from the smallest corner of the upper brick.
        across, along: number of knobs along x and y.
        size: of the upper brick.
    """
    points, weights = list[np.ndarray](), list[np.ndarray]()
    for i in range(x, x + across):
        for j in range(y, y + along):
            for local, weight in _knob((i, j), size):
                points.append(local + np.array((i + 0.5, j + 0.5)))
                weights.append(weight)
    spots, pulls = np.concatenate(points), np.concatenate(weights)
    hull = spots[ConvexHull(spots).vertices]
    middle = pulls @ spots / pulls.sum()
    hull.setflags(write=False)
    return Grip(float(pulls.sum()), (float(middle[0]), float(middle[1])), hull)


def _knob(knob: tuple[int, int], size: tuple[int, int]) -> list[tuple[np.ndarray, np.ndarray]]:
    narrow = min(size)
    if narrow < 2:
        return [(_CROSS, np.ones(4))]
    ways = list[tuple[np.ndarray, float]]()
    for axis in (0, 1):
        if size[axis] == narrow:
            middle = (size[axis] - 1) / 2
            signs = [
                s for s, fits in ((1, knob[axis] <= middle), (-1, knob[axis] >= middle)) if fits
            ]
            for sign in signs:
                turned = _TRIANGLE * [sign, 1]
                ways.append((turned if axis == 0 else turned[:, ::-1], 1 / len(signs)))
    total = sum(weight for _, weight in ways)
    return [(local, np.full(3, weight / total)) for local, weight in ways]


def _boxes(
    blocks: Sequence[Block], pitch: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Smallest corners and extents of boxes [studs, layers], and where the lattice begins [m]."""
    for block in blocks:
        if block.vertices.shape != (8, 3):
            _refuse(block, "another shape")
    corners = np.stack([block.vertices for block in blocks])
    low, high = corners.min(1), corners.max(1)
    middle = (low + high) / 2
    code = ((corners > middle[:, None]) * [1, 2, 4]).sum(2)
    edge = np.minimum(np.abs(corners - low[:, None]), np.abs(corners - high[:, None])).max((1, 2))
    unit = np.array([pitch[0], pitch[0], pitch[1]])
    bad = (np.sort(code, 1) != np.arange(8)).any(1) | (edge > 1e-3 * pitch[0])
    if bad.any():
        _refuse(blocks[int(np.argmax(bad))], "another shape")
    offset = np.array([*(low[0, :2] % pitch[0]), 0.0])
    cells, size = (low - offset) / unit, (high - low) / unit
    whole, extent = cells.round(), size.round()
    off = np.maximum(np.abs(cells - whole), np.abs(size - extent)).max(1)
    bad = (off > _OFF) | (extent < 1).any(1)
    if bad.any():
        first = int(np.argmax(bad))
        _refuse(blocks[first], f"{off[first]:.3g} studs or layers off the lattice")
    return whole.astype(np.int64), extent.astype(np.int64), offset


def _refuse(block: Block, got: str) -> None:
    expected = "an upright box on a lattice of studs, for clutch"
    raise InputError(f"block {block.id!r}", got, expected)


def _cells(low: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The brick of every cell, and int64[n, 3] the cells."""
    count = size.prod(1)
    owner = np.repeat(np.arange(len(low)), count)
    k = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    depth = size[owner, 2]
    column, z = np.divmod(k, depth)
    x, y = np.divmod(column, size[owner, 1])
    return owner, low[owner] + np.stack([x, y, z], 1)


def _pairs(a: np.ndarray, b: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Every pair once."""
    keys = np.unique(a * count + b)
    return keys // count, keys % count
