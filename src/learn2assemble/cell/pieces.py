"""Blocks as upright boxes glued together: what an arm carries, and which may stand for which."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.assembly.appearance import millimetres
from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.errors import InputError

QUARTER = math.pi / 2
_GRAIN = 1e-6
"""Shapes that differ by less are one [m]."""
_FLAT = 1e-5
"""Vertices that differ by less along an axis lie in one plane [m]."""
Part = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Centre and half extents of a box [m]."""


class Pose(NamedTuple):
    """Where something stands on the table."""

    x: float
    """[m], like y."""
    y: float
    yaw: float = 0.0
    """[rad]"""


@dataclass(frozen=True, eq=False)
class Piece:
    """A block of the plan as boxes that are glued together."""

    id: str
    kind: str
    prop: bool
    density: float
    """[kg/m³]"""
    target: np.ndarray
    """float64[3]: middle of its bounding box in the finished structure [m]."""
    turn: int
    """Quarter turns about z from the frame of its shape."""
    shape: tuple[Part, ...]
    """Its boxes about the middle of the bounding box, turned so that it is longest along x; equal
    for all blocks that can stand for one another."""

    @property
    def half(self) -> np.ndarray:
        """float64[3]: half extents of the bounding box in the frame of the shape [m]."""
        return np.max([np.abs(centre) + np.array(half) for centre, half in self.shape], axis=0)

    @property
    def yaw(self) -> float:
        """Of the shape's frame in the structure [rad]."""
        return self.turn * QUARTER

    @property
    def top(self) -> float:
        """Of it in the finished structure [m]."""
        return float(self.target[2] + self.half[2])

    def face(self) -> Any:
        """What it covers in the finished structure, as a shapely area."""
        return footprint(self.shape, Pose(self.target[0], self.target[1], self.yaw))

    @property
    def name(self) -> str:
        """What messages call its kind."""
        return self.kind or millimetres(*(2 * self.half))

    def turns(self) -> list[int]:
        """Quarter turns that leave the shape as it is."""
        return [k for k in range(4) if _recut(_turned(self.shape, k)) == self.shape]

    def boxes(self, centre: np.ndarray, yaw: float) -> list[tuple[np.ndarray, np.ndarray]]:
        """Bounding boxes (low, high) of its parts at a quarter yaw [rad], float64[3] each [m]."""
        parts = _turned(self.shape, round(yaw / QUARTER) % 4)
        return [(centre + c - np.array(h), centre + c + np.array(h)) for c, h in parts]


PROP_ROOM = 3e-4
"""A prop is lower than the gap that it fills by this [m]: what it carries leans on it until enough
stands around, and then lifts off, so that the prop can be drawn out; builders have wedges for it.
With room from 0.1 to 0.5 mm a bridge of span 6 is built alike, without any it falls (measured)."""


def pieces_of(assembly: Assembly) -> tuple[Piece, ...]:
    """The blocks of an assembly as boxes; those of a prop that others lie on are lower by
    :data:`PROP_ROOM`.

    Raises:
        InputError: for a block that is not made of upright boxes.
    """
    bottoms = [(b.vertices.min(0), b.vertices.max(0)) for b in assembly.blocks if not b.prop]
    return tuple(
        _piece(b, PROP_ROOM if b.prop and _carries(b, bottoms) else 0.0) for b in assembly.blocks
    )


def _carries(block: Block, others: list[tuple[np.ndarray, np.ndarray]]) -> bool:
    """Whether a block of these bounds (low, high) begins where this one ends, above it."""
    low, high = block.vertices.min(0), block.vertices.max(0)
    return any(
        abs(a[2] - high[2]) < 1e-4 and (np.minimum(b, high) - np.maximum(a, low) > 1e-4)[:2].all()
        for a, b in others
    )


def _piece(block: Block, room: float) -> Piece:
    low, high = block.vertices.min(0), block.vertices.max(0) - [0.0, 0.0, room]
    middle = (low + high) / 2
    planes, solid = _grid(block)
    planes[2][-1] -= room
    at = [np.round((p - m) / _GRAIN) * _GRAIN for p, m in zip(planes, middle, strict=True)]
    parts = tuple(_box(at, cell, cell + 1) for cell in np.argwhere(solid))
    turned = [(_recut(_turned(parts, k)), k) for k in range(4)]
    shape, k = min(turned, key=lambda one: (-_extent(one[0])[0], one[0]))
    return Piece(block.id, block.kind, block.prop, block.density, middle, -k % 4, shape)


def _grid(block: Block) -> tuple[list[np.ndarray], np.ndarray]:
    """The planes of its faces along every axis [m], and bool[X, Y, Z]: what is filled between.

    Raises:
        InputError: for a face that is neither level nor upright along x or y.
    """
    import shapely

    planes, numbers = [], np.empty(block.vertices.shape, int)
    for axis, values in enumerate(block.vertices.T):
        order = np.argsort(values)
        steps = np.concatenate([[True], np.diff(values[order]) > _FLAT])
        planes.append(values[order][steps])
        numbers[order, axis] = np.cumsum(steps) - 1
    x, y = np.indices([len(p) - 1 for p in planes[:2]])
    columns = shapely.box(x, y, x + 1, y + 1)
    begins = np.zeros((*x.shape, len(planes[2])))
    for face in block.faces:
        corners = numbers[list(face)]
        flat = (corners == corners[0]).all(0)
        if not flat.any():
            raise InputError(f"block {block.id!r}", "another shape", "upright boxes, for an arm")
        if flat[2]:
            area = shapely.make_valid(shapely.Polygon(corners[:, :2]))
            sign = -1 if shapely.LinearRing(corners[:, :2]).is_ccw else 1
            begins[:, :, corners[0, 2]] += sign * shapely.area(shapely.intersection(columns, area))
    return planes, np.cumsum(begins, 2)[:, :, :-1] > 0.5


def _box(planes: Sequence[np.ndarray], first: np.ndarray, last: np.ndarray) -> Part:
    low, high = ([float(p[k]) for p, k in zip(planes, end, strict=True)] for end in (first, last))
    x, y, z = (round((a + b) / 2, 9) + 0.0 for a, b in zip(low, high, strict=True))
    u, v, w = (round((b - a) / 2, 9) for a, b in zip(low, high, strict=True))
    return (x, y, z), (u, v, w)


def _recut(parts: tuple[Part, ...]) -> tuple[Part, ...]:
    """The same solid cut along x, then y, then z, whichever way ``parts`` cut it, so that equal
    solids have equal boxes."""
    if len(parts) == 1:
        return parts
    ends = np.array([[np.subtract(c, h), np.add(c, h)] for c, h in parts]).round(9)
    planes = [np.unique(ends[:, :, axis]) for axis in range(3)]
    first, last = (
        np.stack([np.searchsorted(planes[k], ends[:, side, k]) for k in range(3)], -1)
        for side in (0, 1)
    )
    left = np.zeros([len(p) - 1 for p in planes], bool)
    for (i, j, k), (u, v, w) in zip(first, last, strict=True):
        left[i:u, j:v, k:w] = True
    found = []
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
        found.append(_box(planes, low, high))
    return tuple(sorted(found))


def _turned(parts: tuple[Part, ...], quarters: int) -> tuple[Part, ...]:
    for _ in range(quarters % 4):
        parts = tuple(((-c[1] + 0.0, c[0], c[2]), (h[1], h[0], h[2])) for c, h in parts)
    return tuple(sorted(parts))


def _extent(parts: tuple[Part, ...]) -> tuple[float, float]:
    x, y = (round(max(abs(c[k]) + h[k] for c, h in parts), 6) for k in (0, 1))
    return x, y


def footprint(shape: tuple[Part, ...], pose: Pose) -> Any:
    """What a shape covers at a pose, as a shapely area."""
    import shapely

    return shapely.union_all(
        [
            shapely.affinity.translate(
                shapely.affinity.rotate(
                    shapely.box(c[0] - h[0], c[1] - h[1], c[0] + h[0], c[1] + h[1]),
                    pose.yaw,
                    origin=(0, 0),
                    use_radians=True,
                ),
                pose.x,
                pose.y,
            )
            for c, h in shape
        ]
    )
