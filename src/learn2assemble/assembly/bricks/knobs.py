"""Where the knobs of bricks are, for those who draw them."""

from __future__ import annotations

import numpy as np

from learn2assemble.assembly.blocks import Block
from learn2assemble.assembly.joints import Joint

RADIUS, HEIGHT = 0.3, 0.21
"""Of a knob, as shares of the distance of studs."""
_OFF = 0.05
"""Sides are whole numbers of studs but for this share of one."""


def knobs_on(block: Block, joint: Joint) -> np.ndarray:
    """float64[k, 3]: the middles of the lower ends of the knobs of a block, from its smallest
    corner [m]; none where it is no upright box of whole studs, or its joints have none."""
    size = np.ptp(block.vertices, axis=0)
    studs = np.rint(size[:2] / joint.pitch[0])
    whole = np.abs(size[:2] / joint.pitch[0] - studs).max() <= _OFF and studs.min() >= 1
    box = block.is_convex and abs(float(size.prod()) - block.volume) <= 1e-6 * block.volume
    if joint.law != "clutch" or not whole or not box or block.prop:
        return np.empty((0, 3))
    x, y = ((np.arange(int(n)) + 0.5) * side / n for n, side in zip(studs, size[:2], strict=True))
    return np.array([(a, b, size[2]) for a in x for b in y])
