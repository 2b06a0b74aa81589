r"""A bound on the return of problems that takes no search: no gain without a cell of a face plane.

A step with the discrete reward is worth 1 when the plane-filtered cover grows. With n steps that
can, :math:`R \le 1 + \gamma + \dots + \gamma^{n-1}`.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from learn2assemble.constants import EDGE, HALF
from learn2assemble.errors import InputError
from learn2assemble.tasks.task import Task
from learn2assemble.tasks.world.coverage import NARROW, ROWS, WORDS, add_box, clear_to_ground
from learn2assemble.tasks.world.state import State

MAX_COLUMN, NUM_LEVELS = 7, 12
"""Columns of cells on a side run from -MAX_COLUMN to MAX_COLUMN, levels from 0 to NUM_LEVELS - 1;
their faces are inside the view."""


@lru_cache(maxsize=1)
def cell_pixels() -> np.ndarray:
    """Pixels each cell in the face plane of a side fills that the table does not, by the complete
    filter: ``uint64[2 MAX_COLUMN + 1, NUM_LEVELS, ROWS, WORDS]``, read-only.

    Index ``k + MAX_COLUMN`` is column ``k``, at local ``x = EDGE k``. Two neighbouring cells may
    both fill a pixel that sees their common edge.
    """
    table, unused = np.zeros((2, ROWS, WORDS), np.uint64)
    clear_to_ground(table, unused, NARROW)
    cells = np.zeros((2 * MAX_COLUMN + 1, NUM_LEVELS, ROWS, WORDS), np.uint64)
    for index in range(len(cells)):
        for level in range(NUM_LEVELS):
            x, z = EDGE * (index - MAX_COLUMN), HALF + EDGE * level
            add_box(cells[index, level], unused, x, 0.0, z, HALF)
    cells &= ~table
    cells.setflags(write=False)
    return cells


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
    """Upper bound on the discounted return from fresh states, float64[B] (discrete reward).

    A cell of the face planes can make the cover grow only once: there are no more gains than
    :func:`open_cells`. For cubes that touch.
    """
    return (1 - discount ** open_cells(state)) / (1 - discount)


def quick_bound(task: Task, state: State) -> np.ndarray:
    """The same for cubes of any task: where blocks do not touch, every waiting one may gain.

    Raises:
        InputError: for other objects and rewards.
    """
    if task.objects != "cubes" or task.reward != "discrete":
        raise InputError("task", task.name, "one of cubes with the discrete reward")
    steps = state.num_blocks - state.num_placed
    if task.touching:
        steps = np.minimum(steps, open_cells(state))
    return (1 - task.discount**steps) / (1 - task.discount)
