r"""Upper bounds on the return of problems of objects of several cells, with the scaled reward.

With :math:`x_p` a shape at a pose,
:math:`y_j` a group of pixels of weight :math:`w_j`, the most pixels that :math:`t` objects gain is

.. math::

    F(t) = \max \textstyle\sum_j w_j y_j \quad \text{s.t.}\quad
    & y_j \le \textstyle\sum_{p \text{ gains } j} x_p, \quad
      \textstyle\sum_{p \ni c} x_p \le 1 \;\forall c, \\
    & \textstyle\sum_{p \in s} x_p \le n_s \;\forall s, \quad
      \textstyle\sum_p x_p \le t, \quad x_p \in \{0, 1\},\ 0 \le y_j \le 1 .

A pixel enters the plane cover once at most, when it is first covered, and not where the same object
hides it. So after ``t`` steps of any play at most ``F(t)`` pixels have been gained, and the scaled
reward is bounded by :func:`discounted_bound`. Where the solver stops early, its own bound takes the
place of the optimum. Left out, so this bound need not be reachable: support, balance, touching the
structure, later blocks that hide pixels, and that one order has to be best at every ``t`` at once.

All cells lie at the first block plus whole block edges, because placements are relative and turns
are quarter turns.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import highspy
import numpy as np

from learn2assemble.assembly.kit import Cell, turned_cells
from learn2assemble.constants import EDGE, HALF
from learn2assemble.errors import Learn2AssembleError
from learn2assemble.linear_programs import pass_columns
from learn2assemble.tasks.evaluation.bounds import MAX_COLUMN, NUM_LEVELS
from learn2assemble.tasks.world.coverage import ROWS, WORDS, add_box, to_pixels
from learn2assemble.tasks.world.layouts import to_world
from learn2assemble.tasks.world.rules import SCALED_GAIN
from learn2assemble.tasks.world.state import State

MAX_NODES = 2000
"""Nodes of branch and bound for each F(t), after which its proven bound is taken."""


FRONT = 2
"""Cells in front of a face plane whose hiding is counted: as far as the published shapes reach."""


class Lattice(NamedTuple):
    """The cells that matter and what they do to the mask pixels that are still open."""

    cells: np.ndarray
    """int64[C, 3]: x, y, z [block edges]."""
    shows: np.ndarray
    """bool[C, P]: pixels a block in the cell covers."""
    hides: np.ndarray
    """bool[C, P]: pixels it hides from the plane filter. Cells without a row do neither, which
    can only raise the bound as far as they would have hidden something."""
    taken: np.ndarray
    """int64[K, 3]: cells that hold blocks already."""


class Inventory(NamedTuple):
    """The objects at hand."""

    shapes: Sequence[np.ndarray]
    """int64[m, 3] each: cells of a shape as offsets [block edges], in any order and frame."""
    counts: Sequence[int]
    """How many objects of each shape there are."""


class ShapePose(NamedTuple):
    """One shape at one place."""

    shape: int
    cells: frozenset[tuple[int, int, int]]
    gains: np.ndarray
    """bool[P]."""


def turns_of(shape: np.ndarray, rotations: int) -> list[tuple[Cell, ...]]:
    """A shape (int64[m, 3]) after every number of quarter turns about z, below ``rotations``."""
    cells = tuple((int(x), int(y), int(z)) for x, y, z in shape)
    return [turned_cells(cells, turns) for turns in range(rotations)]


def gaining_poses(lattice: Lattice, inventory: Inventory, rotations: int = 4) -> list[ShapePose]:
    """Every pose of every shape that gains pixels, above the table and off the taken cells.

    Args:
        rotations: 4 for quarter turns about z, 1 where objects keep their attitude.
    """
    row = {(x, y, z): n for n, (x, y, z) in enumerate(lattice.cells.tolist())}
    taken = {(x, y, z) for x, y, z in lattice.taken.tolist()}
    active = [cell for cell, n in row.items() if (lattice.shows[n] & ~lattice.hides[n]).any()]
    poses: list[ShapePose] = []
    for number, shape in enumerate(inventory.shapes):
        places = {
            frozenset((x, y, z) for x, y, z in (offsets + np.array(cell) - anchor).tolist())
            for offsets in map(np.array, turns_of(shape, rotations))
            for cell in active
            for anchor in offsets
        }
        for cells in sorted(places, key=sorted):
            if cells & taken or min(z for _, _, z in cells) < 0:
                continue
            rows = [row[cell] for cell in cells if cell in row]
            gains = np.asarray(lattice.shows[rows].any(0) & ~lattice.hides[rows].any(0))
            if gains.any():
                poses.append(ShapePose(number, cells, gains))
    return poses


def most_pixels(
    lattice: Lattice, inventory: Inventory, rotations: int = 4, max_nodes: int = MAX_NODES
) -> np.ndarray:
    """F(0), F(1), ... up to the number of objects: int64[T + 1], never less than the optimum.

    Raises:
        Learn2AssembleError: where the solver fails.
    """
    poses = gaining_poses(lattice, inventory, rotations)
    found = np.zeros(sum(inventory.counts) + 1, np.int64)
    if not poses:
        return found
    gains = np.stack([pose.gains for pose in poses])
    # Pixels that the same poses gain are one group: bool[poses, J].
    groups, weight = np.unique(gains[:, gains.any(0)], axis=1, return_counts=True)
    reachable, limit, solver = int(weight.sum()), *_packing(poses, groups, weight, inventory.counts)
    solver.setOptionValue("mip_max_nodes", max_nodes)
    states = highspy.HighsModelStatus
    for t in range(1, len(found)):
        # Only the limit on the number of objects changes.
        solver.changeRowBounds(limit, -highspy.kHighsInf, float(t))
        solver.run()
        status = solver.getModelStatus()
        if status not in (states.kOptimal, states.kSolutionLimit, states.kIterationLimit):
            raise Learn2AssembleError(f"packing program: the solver stopped with {status}")
        bound = min(float(solver.getInfo().mip_dual_bound), float(reachable))
        found[t] = math.floor(bound + 1e-6)
        if found[t] == reachable:
            found[t:] = reachable
            break
    return found


def _packing(
    poses: list[ShapePose], groups: np.ndarray, weight: np.ndarray, counts: Sequence[int]
) -> tuple[int, highspy.Highs]:
    """The integer program, and its row that limits the number of objects."""
    cells = sorted({cell for pose in poses for cell in pose.cells})
    number = {cell: n for n, cell in enumerate(cells)}
    # Rows: one a pixel group, one a cell, one a shape, the number of objects.
    first_cell = len(weight)
    first_shape = first_cell + len(cells)
    limit = first_shape + len(counts)
    rows: list[list[int]] = []
    values: list[list[float]] = []
    for pose, gained in zip(poses, groups, strict=True):
        seen = np.flatnonzero(gained).tolist()
        used = [first_cell + number[cell] for cell in sorted(pose.cells)]
        used += [first_shape + pose.shape, limit]
        rows.append(seen + used)
        values.append([-1.0] * len(seen) + [1.0] * len(used))
    rows += [[j] for j in range(len(weight))]
    values += [[1.0]] * len(weight)
    start = np.cumsum([0] + [len(r) for r in rows])
    upper = [0.0] * len(weight) + [1.0] * len(cells) + [float(n) for n in counts] + [0.0]
    solver = highspy.Highs()
    # Pixels are whole, so less than one of them is no difference.
    options = {"output_flag": False, "threads": 1, "mip_rel_gap": 0.0, "mip_abs_gap": 0.99}
    for option, value in options.items():
        solver.setOptionValue(option, value)
    pass_columns(
        solver,
        np.concatenate([np.zeros(len(poses)), weight.astype(float)]),
        (np.zeros(len(rows)), np.ones(len(rows))),
        (np.full(len(upper), -highspy.kHighsInf), np.array(upper)),
        (start, np.concatenate(rows), np.concatenate(values)),
        np.repeat([True, False], [len(poses), len(weight)]),
        highspy.ObjSense.kMaximize,
    )
    return limit, solver


def discounted_bound(most: np.ndarray, span: int, discount: float, threshold: float) -> float:
    r"""Upper bound on the discounted scaled return.

    With :math:`C_t \le F(t)` the share gained by step ``t`` and the episode over after ``s``,

    .. math:: \sum_{t=1}^{s} \gamma^{t-1} (C_t - C_{t-1})
              = \gamma^{s-1} C_s + (1 - \gamma) \sum_{t=1}^{s-1} \gamma^{t-1} C_t .

    Before success :math:`C_t` is at most the threshold. The best ``s`` counts, with the bonus, or
    no success at all.

    Args:
        most: int64[T + 1], F of :func:`most_pixels`.
        span: A - c0, mask pixels that count.
    """
    share = np.minimum(np.asarray(most, float) / span, 1.0)
    steps = len(share) - 1
    if steps == 0:
        return 0.0
    before = np.minimum(share, threshold)
    weight = discount ** np.arange(steps)
    # earlier[s - 1]: the sum over t < s of the formula.
    earlier = (1 - discount) * np.concatenate([[0.0], np.cumsum(weight[:-1] * before[1:-1])])
    ended = SCALED_GAIN * (weight * share[1:] + earlier) + weight
    # Any step may bring success here: blocks that only hide a side bring it too.
    unended = SCALED_GAIN * (weight[-1] * before[-1] + earlier[-1])
    return float(max(ended.max(), unended))


def object_return_bound(
    state: State,
    row: int,
    frames: np.ndarray,
    discount: float,
    threshold: float,
    rotations: int = 4,
) -> float:
    """Upper bound on the discounted scaled return from a state (proven, see the module).

    Args:
        frames: float64[S, 4], the sides (:func:`learn2assemble.tasks.world.layouts.side_frames`).
        threshold: Delta.
        rotations: 4 where objects may be turned about z (20 actions), 1 where not (5 actions).
    """
    lattice, inventory = state_lattice(state, row, frames), state_inventory(state, row, rotations)
    span = int(state.mask_pixels[row] - state.initial_pixels[row])
    return discounted_bound(most_pixels(lattice, inventory, rotations), span, discount, threshold)


def state_lattice(state: State, row: int, frames: np.ndarray) -> Lattice:
    """Cells in and in front of the face planes, with the mask pixels still open on every side."""
    cells, images = _cell_images(tuple(tuple(map(float, frame)) for frame in frames))
    open_pixels = state.mask[row] & ~state.covered[row]
    reached = (images[0] & open_pixels).any((-1, -2, -3))
    wanted = to_pixels(open_pixels)
    covered, hidden = (to_pixels(image[reached])[:, wanted] for image in images)
    placed = state.position[row, : state.num_placed[row]]
    taken = np.rint((placed - [0, 0, HALF]) / EDGE).astype(np.int64)
    return Lattice(cells[reached], covered, hidden, taken)


@lru_cache(maxsize=4)
def _cell_images(frames: tuple[tuple[float, ...], ...]) -> tuple[np.ndarray, np.ndarray]:
    """Cells int64[C, 3] and their (covered, occluded) images uint64[2, C, S, ROWS, WORDS]."""
    columns = EDGE * np.arange(-MAX_COLUMN, MAX_COLUMN + 1)
    depths = EDGE * np.arange(-FRONT, 1)
    x, y, z = np.meshgrid(columns, depths, EDGE * np.arange(NUM_LEVELS), indexing="ij")
    points = [to_world(np.array(frame), x, y, z).reshape(-1, 3) for frame in frames]
    cells = np.unique(np.rint(np.concatenate(points) / EDGE).astype(np.int64), axis=0)
    images = np.zeros((2, len(cells), len(frames), ROWS, WORDS), np.uint64)
    for n, cell in enumerate(cells):
        for side, (c, s, tx, ty) in enumerate(frames):
            wx, wy = EDGE * cell[0] - tx, EDGE * cell[1] - ty
            covered, occluded = images[:, n, side]
            add_box(
                covered, occluded, c * wx + s * wy, c * wy - s * wx, HALF + EDGE * cell[2], HALF
            )
    return cells, images


def state_inventory(state: State, row: int, rotations: int = 4) -> Inventory:
    """The unplaced objects; with ``rotations`` those equal after quarter turns count as one shape.

    Their waiting positions show their shapes.
    """
    waiting = slice(int(state.num_placed[row]), int(state.num_blocks[row]))
    position, number = state.position[row, waiting], state.object_id[row, waiting]
    found: Counter[tuple[tuple[int, ...], ...]] = Counter()
    for name in np.unique(number):
        cells = position[number == name]
        shape = np.rint((cells - cells[0]) / EDGE).astype(np.int64)
        found[min(turns_of(shape, rotations))] += 1
    return Inventory([np.array(shape) for shape in found], list(found.values()))
