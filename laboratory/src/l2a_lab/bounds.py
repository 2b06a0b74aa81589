r"""Upper bounds on the return of problems, for physics that moves no blocks.

**Towers**: cubes on one or two sides, discrete reward. A structure is the list of tower heights
:math:`h` (int64[n]) in the face planes. It grows by one block on a tower, or on the table beside
one. What it shows is a sum over towers and pairs of neighbours, because a ray meets the cubes of
two places of a side at most. With :math:`c(h)` the mask pixels shown, all heights are swept once
for

.. math::  V(h) = \max_n\ [c(h + e_n) > c(h)] + \gamma V(h + e_n),

and :math:`V = 0` where the episode has ended. On the lattice only a block in a face plane can raise
the plane cover (``tests/test_exact.py`` tries all others). Delete the blocks outside the towers
from any sequence: every gain stays and comes no later, and success comes no earlier. What is lost
is only how a place was reached. A block outside touches one place at most, and two that touch each
other belong to the same or to neighbouring places, so a place none of whose neighbours stands takes
a detour of three blocks or more; it may be used for the price of three steps, paid once. Where
there are too many structures, :func:`tower_bound` takes the place of the sweep.

**Quick**: cubes on any number of sides, see :func:`return_bound`.

**Packing**: objects of several cells, scaled reward. With :math:`x_p` a shape at a pose,
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
from numba import njit

from l2a_lab.builder.tasks import MAX_COLUMN, NUM_LEVELS, cell_pixels
from learn2assemble.constants import EDGE, HALF
from learn2assemble.errors import InputError, Learn2AssembleError
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import Task
from learn2assemble.tasks.world.coverage import ROWS, WORDS, add_box, to_pixels
from learn2assemble.tasks.world.layouts import to_world
from learn2assemble.tasks.world.rules import DISCRETE, SCALED_GAIN, reward_and_success
from learn2assemble.tasks.world.state import State

MAX_STRUCTURES = 1_000_000
"""Structures swept at most: 8 bytes and about 0.7 us each, in up to three sweeps."""
DETOUR = 3
"""Blocks outside the face planes it takes at least to get around an empty place."""
ROUNDING = 1e-12
"""Returns that differ by less are equal."""
MAX_NODES = 2000
"""Nodes of branch and bound for each F(t), after which its proven bound is taken."""
FRONT = 2
"""Cells in front of a face plane whose hiding is counted: as far as the published shapes reach."""


def has_bound(task: Task) -> bool:
    """Whether a bound is known: cubes with the discrete, anything with the scaled reward, where
    blocks touch."""
    return task.touching and (task.reward == "scaled" or task.objects == "cubes")


def best_returns(simulator: Simulator, count: int, rng: np.random.Generator) -> np.ndarray:
    """Upper bound on the return of each of ``count`` fresh problems, float64[count].

    Problems are those of the evaluation episodes of the same generator.
    """
    task, state = simulator.task, simulator.new(count, rng)
    if task.reward == "scaled":
        return np.array(
            [
                object_return_bound(
                    state,
                    row,
                    simulator.frames,
                    task.discount,
                    task.success_threshold,
                    task.rotations,
                )
                for row in range(count)
            ]
        )
    if task.num_sides <= 2:
        return np.array([best_return(simulator, state, row) for row in range(count)])
    return return_bound(state, task.discount)


@lru_cache(maxsize=1)
def tower_pixels() -> np.ndarray:
    """Pixels of a tower of ``h`` blocks in each column: ``uint64[2 MAX_COLUMN + 1, NUM_LEVELS + 1,
    ROWS, WORDS]``, read-only; ``h = 0`` is the empty set."""
    cells = cell_pixels()
    towers = np.zeros((len(cells), NUM_LEVELS + 1, ROWS, WORDS), np.uint64)
    towers[:, 1:] = np.bitwise_or.accumulate(cells, axis=1)
    towers.setflags(write=False)
    return towers


# ---------------------------------------------------------------- cubes


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

    A step is worth 1 when the plane-filtered cover grows, and a cell of the face planes can make
    it grow only once: with k :func:`open_cells`, ``R <= 1 + gamma + ... + gamma^(k-1)``.
    """
    return (1 - discount ** open_cells(state)) / (1 - discount)


class Towers(NamedTuple):
    """``n`` places in the face planes; ``H`` is the greatest height looked at."""

    place: np.ndarray
    """int64[n, 2]: x, y [block edges, world], side by side, each from left to right as seen."""
    cap: np.ndarray
    """int64[n]: blocks above this show no open pixels, or there are not so many; at least 1, as any
    place may be passed."""
    low: np.ndarray
    """int64[n]: height at the start, 1 for the first block's tower, else 0."""
    beside: np.ndarray
    """int64[n, 3]: neighbouring places, -1 where there is none."""
    own: np.ndarray
    """int64[n, H + 1]: open mask pixels that a tower of that height shows."""
    shared: np.ndarray
    """int64[n, H + 1, H + 1]: of these, shown by the place before it (second index) as well."""
    counts: np.ndarray
    """int64[4]: A, c0, c_co at the start, number of blocks."""
    threshold: float
    """Delta."""


def find_towers(simulator: Simulator, state: State, row: int) -> Towers:
    """The towers of a fresh problem.

    Open pixels are mask pixels not yet covered at the start. Places beyond the outermost ones with
    open pixels are left out: passing them is never shorter than staying.

    Raises:
        InputError: for more than two sides, a scaled reward, or a problem that is not fresh.
    """
    task = simulator.task
    if task.num_sides > 2:
        raise InputError("num_sides", task.num_sides, "1 or 2 for exact returns")
    if task.reward != "discrete":
        raise InputError("reward", task.reward, "'discrete' for exact returns")
    if state.num_placed[row] != 1:
        raise InputError("num_placed", int(state.num_placed[row]), "1, a fresh problem")
    seen = tower_pixels() & (state.mask[row] & ~state.covered[row])[:, None, None]
    own = np.bitwise_count(seen).sum((-1, -2), dtype=np.int64)
    useful = np.argmax(own == own[..., -1:], -1)
    x, y = _places(simulator.frames)
    start = np.rint(state.position[row, 0, :2] / EDGE).astype(np.int64)
    first = (x == start[0]) & (y == start[1])
    inside = x[(useful > 0) | first]
    kept = np.argwhere((x >= inside.min()) & (x <= inside.max()))
    side, column = kept.T
    place = np.stack([x[side, column], y[side, column]], -1)
    shared = np.zeros((len(kept), *own.shape[-1:] * 2), np.int64)
    for n in range(1, len(kept)):
        if side[n] == side[n - 1]:
            both = seen[side[n], column[n] - 1][:, None] & seen[side[n], column[n]][None]
            shared[n] = np.bitwise_count(both).sum((-1, -2))
    low = first[side, column].astype(np.int64)
    beside = np.full((len(place), 3), -1, np.int64)
    for n, here in enumerate(place):
        near = np.flatnonzero(np.abs(place - here).sum(-1) == 1)
        beside[n, : len(near)] = near
    return Towers(
        place=place,
        cap=np.minimum(np.maximum(useful[side, column], 1), low + state.num_blocks[row] - 1),
        low=low,
        beside=beside,
        own=own[side, column],
        shared=shared,
        counts=np.array(
            [
                state.mask_pixels[row],
                state.initial_pixels[row],
                state.complete_pixels[row],
                state.num_blocks[row],
            ]
        ),
        threshold=task.success_threshold,
    )


def _places(frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World x and y [block edges] of every column of every side: int64[S, NUM_COLUMNS] each."""
    column = EDGE * np.arange(-MAX_COLUMN, MAX_COLUMN + 1)
    points = np.stack([to_world(f, column, 0 * column, 0 * column) for f in frames])
    index = np.rint(points[..., :2] / EDGE).astype(np.int64)
    return index[..., 0], index[..., 1]


@njit(cache=True)
def has_ended(towers, heights):
    """Whether the episode is over: success, or no blocks left."""
    if heights.sum() >= towers.counts[3]:
        return True
    complete = towers.counts[2]
    for n in range(len(heights)):
        complete += towers.own[n, heights[n]]
        if n > 0:
            complete -= towers.shared[n, heights[n - 1], heights[n]]
    _, success = reward_and_success(
        towers.counts[0], towers.counts[1], 0, 0, complete, True, DISCRETE, towers.threshold
    )
    return success


@njit(cache=True)
def gains(towers, heights, n):
    """Whether one more block on tower ``n`` shows pixels that are not yet shown."""
    h = heights[n]
    new = towers.own[n, h + 1] - towers.own[n, h]
    if n > 0:
        left = heights[n - 1]
        new -= towers.shared[n, left, h + 1] - towers.shared[n, left, h]
    if n + 1 < len(heights):
        right = heights[n + 1]
        new -= towers.shared[n + 1, h + 1, right] - towers.shared[n + 1, h, right]
    return new > 0


@njit(cache=True)
def is_in_reach(towers, heights, n):
    """Whether tower ``n`` can take a block: it stands already, or a neighbour does."""
    if heights[n] > 0:
        return True
    for near in towers.beside[n]:  # noqa: SIM110 (compiled)
        if near >= 0 and heights[near] > 0:
            return True
    return False


def tower_bound(towers: Towers, discount: float) -> float:
    """Upper bound on the return in closed form: towers grow independently, none waits.

    The order of levels within a tower remains, so supports without pixels delay. The best order of
    independent chains under discounting is by falling index, the greatest reward rate
    ``sum gamma^i r_i / sum gamma^i`` of a chain's beginning (Gittins), and is found by sorting.
    Success and pixels shared by neighbours are left out; the number of blocks limits the rewards.
    """
    pieces: list[tuple[float, int, float]] = []
    for own, low, cap in zip(towers.own, towers.low, towers.cap, strict=True):
        bits = (own[low + 1 : cap + 1] > own[low:cap]).astype(float)
        while bits.any():
            weight = discount ** np.arange(len(bits))
            value = np.cumsum(weight * bits)
            rate = value / np.cumsum(weight)
            k = int(np.argmax(rate))
            # The index is negative, so that the greatest comes first.
            pieces.append((-float(rate[k]), k + 1, float(value[k])))
            bits = bits[k + 1 :]
    total, factor = 0.0, 1.0
    for _, length, value in sorted(pieces):
        total += factor * value
        factor *= discount**length
    left = int(towers.counts[3] - towers.low.sum())
    return min(total, (1 - discount**left) / (1 - discount) if discount < 1 else float(left))


def best_return(simulator: Simulator, state: State, row: int = 0) -> float:
    """Upper bound on the return of the fresh problem in ``row``, discounted by the task's gamma.

    It is the exact optimum but where a detour pays, which is nearly never.

    Raises:
        InputError: where :func:`find_towers` refuses the problem.
    """
    towers, discount = find_towers(simulator, state, row), simulator.task.discount
    closed = tower_bound(towers, discount)
    structures = math.prod((towers.cap - towers.low + 1).tolist())
    if structures > MAX_STRUCTURES:
        return closed
    own, free = np.empty(structures), np.empty(0)
    sweep(towers, discount, False, 0.0, free, own)
    if closed > own[0] + ROUNDING:
        free = np.empty(structures)
        sweep(towers, discount, True, 0.0, own[:0], free)
        # Where even free reach brings nothing, no detour does.
        if free[0] > own[0] + ROUNDING:
            sweep(towers, discount, False, discount**DETOUR, free, own)
    return float(own[0])


@njit(cache=True)
def sweep(towers, discount, free, toll, beyond, values):
    """Fill ``values`` (float64, index in mixed radix) from the highest structure down.

    ``free``: every place is in reach. ``toll`` > 0: a place out of reach may be used for that
    factor, after which everything is in reach: ``beyond`` holds the values from there on.
    """
    count = len(towers.cap)
    heights = towers.cap.copy()
    for index in range(len(values) - 1, -1, -1):
        best = 0.0
        if not has_ended(towers, heights):
            stride = 1
            for n in range(count):
                if heights[n] < towers.cap[n]:
                    reward = 1.0 if gains(towers, heights, n) else 0.0
                    if free or is_in_reach(towers, heights, n):
                        best = max(best, reward + discount * values[index + stride])
                    elif toll > 0:
                        best = max(best, toll * (reward + discount * beyond[index + stride]))
                stride *= towers.cap[n] - towers.low[n] + 1
        values[index] = best
        n = 0
        while n < count and heights[n] == towers.low[n]:
            heights[n] = towers.cap[n]
            n += 1
        if n < count:
            heights[n] -= 1


# ---------------------------------------------------------------- objects


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


class Pose(NamedTuple):
    """One shape at one place."""

    shape: int
    cells: frozenset[tuple[int, int, int]]
    gains: np.ndarray
    """bool[P]."""


def turned(shape: np.ndarray, turns: int) -> np.ndarray:
    """``shape`` (int64[m, 3]) after quarter turns about z."""
    x, y, z = np.asarray(shape, np.int64).T
    for _ in range(turns % 4):
        x, y = -y, x
    return np.stack([x, y, z], -1)


def gaining_poses(lattice: Lattice, inventory: Inventory, rotations: int = 4) -> list[Pose]:
    """Every pose of every shape that gains pixels, above the table and off the taken cells.

    Args:
        rotations: 4 for quarter turns about z, 1 where objects keep their attitude.
    """
    row = {tuple(cell): n for n, cell in enumerate(lattice.cells.tolist())}
    taken = set(map(tuple, lattice.taken.tolist()))
    active = [cell for cell, n in row.items() if (lattice.shows[n] & ~lattice.hides[n]).any()]
    poses = []
    for number, shape in enumerate(inventory.shapes):
        places = {
            frozenset(map(tuple, (offsets + np.array(cell) - anchor).tolist()))
            for offsets in (turned(shape, turns) for turns in range(rotations))
            for cell in active
            for anchor in offsets
        }
        for cells in sorted(places, key=sorted):
            if cells & taken or min(z for _, _, z in cells) < 0:
                continue
            rows = [row[cell] for cell in cells if cell in row]
            gains = np.asarray(lattice.shows[rows].any(0) & ~lattice.hides[rows].any(0))
            if gains.any():
                poses.append(Pose(number, cells, gains))
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
    poses: list[Pose], groups: np.ndarray, weight: np.ndarray, counts: Sequence[int]
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
    solver.passModel(
        len(rows),
        len(upper),
        int(start[-1]),
        int(highspy.MatrixFormat.kColwise),
        int(highspy.ObjSense.kMaximize),
        0.0,
        np.concatenate([np.zeros(len(poses)), weight.astype(float)]),
        np.zeros(len(rows)),
        np.ones(len(rows)),
        np.full(len(upper), -highspy.kHighsInf),
        np.array(upper),
        start.astype(np.int32),
        np.concatenate(rows).astype(np.int32),
        np.concatenate(values),
        np.repeat([1, 0], [len(poses), len(weight)]).astype(np.int32),
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
    cells, images = _cell_images(tuple(map(tuple, frames.tolist())))
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
        ways = [turned(shape, turns) for turns in range(rotations)]
        found[min(tuple(sorted(map(tuple, (way - way.min(0)).tolist()))) for way in ways)] += 1
    return Inventory([np.array(shape) for shape in found], list(found.values()))
