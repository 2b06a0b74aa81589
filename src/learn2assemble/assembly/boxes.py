"""Axis-aligned boxes as blocks, one and by the thousand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import LARGEST, THINNEST, Block
from learn2assemble.assembly.values import Colour
from learn2assemble.errors import InputError

_BOX_FACES = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
"""Of a box whose vertex number has bit 0 for x, bit 1 for y and bit 2 for z."""
_BOX_CORNERS = np.arange(8)[:, None] >> np.arange(3) & 1
"""int64[8, 3]: which end of the box a vertex has along x, y and z."""


def box_block(id: str, lower: Sequence[float], upper: Sequence[float], **kwargs: Any) -> Block:
    """An axis-aligned box as a block.

    Args:
        id: of the block.
        lower: smallest x, y, z [m].
        upper: largest x, y, z [m].
        kwargs: further fields of :class:`Block`.

    Raises:
        InputError: for corners that are none, or no box.
    """
    try:
        bounds = np.array([lower, upper], float)
    except (TypeError, ValueError):
        expected = "two corners of three numbers"
        raise InputError(f"block {id!r}: box", [lower, upper], expected) from None
    if bounds.shape != (2, 3) or not (bounds[1] > bounds[0]).all():
        raise InputError(f"block {id!r}: box", bounds.tolist(), "lower < upper in x, y and z")
    return Block(id, bounds[_BOX_CORNERS, np.arange(3)], _BOX_FACES, **kwargs)


class BoxFields(NamedTuple):
    """What :func:`box_blocks` makes a block of; fields as those of :class:`Block`."""

    id: str
    kind: str
    density: float
    colour: Colour | None = None


def box_blocks(boxes: Sequence[BoxFields], lower: np.ndarray, upper: np.ndarray) -> list[Block]:
    """Axis-aligned boxes as blocks: as :func:`box_block` of each, but all are looked at together,
    as models have thousands.

    Args:
        boxes: n of them.
        lower: float64[n, 3], smallest x, y, z [m].
        upper: float64[n, 3], largest x, y, z [m].
    """
    edges = upper - lower
    volumes, middles, extents = edges.prod(1), (lower + upper) / 2, edges.max(1)
    far = np.maximum(np.abs(lower), np.abs(upper)).max(1, initial=0.0)
    thin = volumes <= THINNEST * extents**3
    odd = ~((edges > 0).all(1) & ~thin & (far <= LARGEST))
    densities = np.array([box.density for box in boxes], float)
    odd |= ~((densities > 0) & (densities <= LARGEST))
    odd |= np.array([not 0 < len(box.id) <= 200 for box in boxes], bool)
    wrong: list[int] = np.flatnonzero(odd)[:1].tolist()
    for number in wrong:  # Says what is wrong.
        id_, kind, density, colour = boxes[number]
        low, high = lower[number], upper[number]
        box_block(id_, low.tolist(), high.tolist(), kind=kind, density=density, colour=colour)
    corners = np.where(_BOX_CORNERS, upper[:, None], lower[:, None])
    corners.setflags(write=False)
    rest: dict[str, Any] = {"faces": _BOX_FACES, "support": False, "prop": False}
    made = list[Block]()
    sizes = volumes.tolist(), extents.tolist()
    for box, vertices, middle, volume, extent in zip(boxes, corners, middles, *sizes, strict=True):
        block = object.__new__(Block)
        known: dict[str, Any] = {
            "vertices": vertices,
            "extent": extent,
            "_moments": (volume, middle),
        }
        block.__dict__.update(box._asdict(), **rest, **known)
        made.append(block)
    return made
