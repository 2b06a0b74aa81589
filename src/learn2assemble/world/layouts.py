"""Where the unplaced blocks wait (protocol 1.4): positions of the graph's unplaced nodes."""

from __future__ import annotations

import numpy as np

from learn2assemble.errors import UnknownNameError
from learn2assemble.world.blocks import EDGE, HALF


def sobol(count: int) -> np.ndarray:
    """The first ``count`` one-dimensional Sobol numbers in Gray-code order, starting at 0.5."""
    value, out = 0, np.empty(count)
    for k in range(count):
        lowest_zero = (~k & (k + 1)).bit_length()
        value ^= 1 << (53 - lowest_zero)
        out[k] = value / 2.0**53
    return out


def _line(count: int) -> np.ndarray:
    x = (2 * sobol(count) - 1) * 20.5 * EDGE
    return np.stack([x, np.full(count, -EDGE), np.zeros(count)], -1)


def _rows(count: int) -> np.ndarray:
    k = np.arange(count)
    x = (2 * sobol(6)[k % 6] - 1) * 7.6875 * EDGE - 1.5375 * EDGE
    y = -0.2 - 0.125 * (k // 6)
    return np.stack([x, y, np.full(count, HALF)], -1)


LAYOUTS = {"line": _line, "rows": _rows}


def waiting_positions(layout: str, count: int) -> np.ndarray:
    """Positions of ``count`` waiting blocks [m]: ``float64[count, 3]``.

    ``line`` spreads them on a line in front of side 1 (no-robot environments), ``rows`` in rows
    of six (the one-sided twin of the robot cell).

    Raises:
        UnknownNameError: for a layout that does not exist.
    """
    if layout not in LAYOUTS:
        raise UnknownNameError("layout", layout, LAYOUTS)
    return LAYOUTS[layout](count)
