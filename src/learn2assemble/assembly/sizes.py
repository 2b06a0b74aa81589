"""Sizes of blocks that tell of a mistake in their unit."""

from __future__ import annotations

import numpy as np

from learn2assemble.assembly.appearance import millimetres
from learn2assemble.assembly.blocks import Assembly

ODD = 100.0
"""A block is of an odd size if it is this many times longer than the median, or more."""
HUGE = 10.0
"""Blocks that are all longer than this are [m]."""


def unit_doubt(assembly: Assembly) -> str:
    """A question in one line where the sizes of blocks look as if their unit were wrong, such as
    ``blocks from 100 mm to 100000 mm long: is the unit right?``; else nothing."""
    blocks = [block for block in assembly.blocks if not (block.prop or block.support)]
    if not blocks:
        return ""
    longest = [block.extent for block in blocks]
    low, high = min(longest), max(longest)
    if low <= HUGE and high <= ODD * float(np.median(longest)):
        return ""
    named = blocks[int(np.argmax(longest))].id
    which = f" ({named})" if low <= HUGE else ""
    return f"blocks from {_length(low)} to {_length(high)}{which} long: is the unit right?"


def _length(value: float) -> str:
    return f"{value:.4g} m" if value >= 1 else millimetres(value)
