"""What perfect play could score: an upper bound on the return of a problem with cubes.

With the discrete reward a step is worth 1 when the plane-filtered cover grows, and a cell of the
face planes can make it grow only once, when it is filled. With k cells whose faces show mask
pixels that the first block leaves open, at most k steps are rewarded, so
``R <= 1 + gamma + ... + gamma^(k-1)``. The bound ignores that the episode ends at the success
threshold and that supports cost steps, so it need not be reachable;
:mod:`learn2assemble.evaluation.exact` does count them, on one and two sides.
"""

from __future__ import annotations

import numpy as np

from learn2assemble.world.design_pixels import cell_pixels
from learn2assemble.world.state import State


def open_cells(state: State) -> np.ndarray:
    """k of every row: cells of the face planes that show mask pixels not yet covered, int64[B]."""
    open_pixels = state.mask & ~state.covered
    cells = cell_pixels()
    counts = np.zeros(state.batch_size, np.int64)
    for side in range(open_pixels.shape[1]):
        # Looped over rows: the table of all cells times all rows would not fit in memory.
        for row, pixels in enumerate(open_pixels[:, side]):
            counts[row] += int(((cells & pixels) != 0).any((-1, -2)).sum())
    return counts


def return_bound(state: State, discount: float) -> np.ndarray:
    """Upper bound on the discounted return from fresh states, float64[B] (discrete reward)."""
    return (1 - discount ** open_cells(state)) / (1 - discount)
