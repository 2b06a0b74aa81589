"""Fresh problems: where sides stand, where unplaced objects wait, random targets (compiled).

Side ``i`` is the image of side 1 under ``p_world = R_z(angle) p_local + t``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from learn2assemble.constants import EDGE, HALF
from learn2assemble.errors import InputError, check_name
from learn2assemble.kernels import kernel
from learn2assemble.tasks.world.blocks import Inventory, draw_objects
from learn2assemble.tasks.world.coverage import NARROW, DepthFilter, paper_mask
from learn2assemble.tasks.world.rules import count_row, recover_all

if TYPE_CHECKING:
    from learn2assemble.tasks.world.state import State

_SIDES = (((1, 0), (0, 0)), ((-1, 0), (0, 2)), ((0, 1), (1, 1)), ((0, -1), (-1, 1)))
"""Cosine and sine of the angle of each side, and where it stands [spacings]."""


def side_frames(num_sides: int, spacing: float = EDGE, aisle: int = 0) -> np.ndarray:
    """Frames of the sides as rows ``(cos, sin, t_x, t_y)``: ``float64[S, 4]``.

    Two sides are two parallel walls with ``aisle`` empty rows of cells between them, touching
    without; three and four are faces of a footprint of 3x3 cells centred at ``(0, spacing)``.
    ``spacing`` [m] is the block pitch.

    Raises:
        InputError: for a number of sides outside 1..4.
    """
    if num_sides not in (1, 2, 3, 4):
        raise InputError("num_sides", num_sides, "1, 2, 3 or 4")
    frames = [(*turn, spacing * x, spacing * y) for turn, (x, y) in _SIDES[:num_sides]]
    if num_sides == 2:
        frames[1] = (-1, 0, 0, spacing * (1 + aisle))
    return np.asarray(frames, np.float64)


def to_world(frame: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Local coordinates of a side [m] to world points ``float64[..., 3]``."""
    c, s, tx, ty = frame
    return np.stack([c * x - s * y + tx, s * x + c * y + ty, z + 0 * x], -1)


def sobol(count: int) -> np.ndarray:
    """The first ``count`` one-dimensional Sobol numbers in Gray-code order, starting at 0.5."""
    value, out = 0, np.empty(count)
    for k in range(count):
        lowest_zero = (~k & (k + 1)).bit_length()
        value ^= 1 << (53 - lowest_zero)
        out[k] = value / 2.0**53
    return out


def _line(count: int, share: float = 1.0) -> np.ndarray:
    x = (2 * sobol(count) - 1) * 20.5 * EDGE * share
    return np.stack([x, np.full(count, -EDGE), np.zeros(count)], -1)


def _six(count: int, y: float, row: float = 0.0, slant: float = 0.0, z: float = HALF) -> np.ndarray:
    """Rows of six that an arm standing to the left can reach, the next ``row`` farther away and
    ``slant`` to the left [m]."""
    number = np.arange(count) // 6
    x = (2 * sobol(6)[np.arange(count) % 6] - 1) * 7.6875 * EDGE - 1.5375 * EDGE
    return np.stack([x - slant * number, y - row * number, np.full(count, z)], -1)


def _rows(count: int) -> np.ndarray:
    return _six(count, -0.2, 0.125)


def _around(count: int) -> np.ndarray:
    """Rows of five, in turn before and behind two walls with an aisle, the nearest first."""
    k = np.arange(count)
    row, behind = k // 10, (k // 5) % 2 == 1
    y = np.where(behind, 0.26, -0.14) + 0.09 * row * np.where(behind, 1, -1)
    return np.stack([0.09 * (k % 5) - 0.27, y, np.full(count, HALF)], -1)


OBJECTS_APART = 0.07
"""Least distance of the cells of two waiting objects, and of none to the wall [m]."""
CUBES_APART = 0.095
"""Least distance of two cubes that wait at random places: room for the fingers [m]."""

LAYOUTS: dict[str, tuple[Callable[[int], np.ndarray], float]] = {
    "line": (_line, 0.0),
    "rows": (_rows, 0.0),
    "field": (_line, OBJECTS_APART),
    "narrow-field": (lambda count: _line(count, 0.25), OBJECTS_APART),
    "slanted-rows": (lambda count: _six(count, -0.15, 0.1, 0.025), 0.0),
    "around": (_around, 0.0),
    # The published code counts heights from the table here, not from the centres of cells.
    "columns": (lambda count: _six(count, -0.15, z=0.0), OBJECTS_APART),
    "random": (_rows, CUBES_APART),
}
"""Positions of the k-th object, and how far apart the cells of objects are kept [m]."""
RANDOM = "random"
"""The layout whose places are drawn anew for every problem."""


class Waiting(NamedTuple):
    """Where objects wait."""

    position: np.ndarray
    """float64[n, 3]: origin of the k-th waiting object [m], before it is moved apart."""
    apart: float
    """An object steps back by one edge in y until its cells are at least this far from those of
    every earlier one, and in front of the wall [m]; 0: it never does."""
    random: bool = False
    """Cubes wait at random places on both sides of the structure instead, ``apart`` from each
    other."""


def waiting_places(layout: str, count: int) -> Waiting:
    """Where up to ``count`` objects wait.

    ``line`` spreads cubes on a line in front of side 1 (no-robot environments), ``rows`` in rows
    of six (the one-sided robot cell and its twin). ``field`` (bars) and ``narrow-field`` (objects)
    start on a line, too, and move objects of several cells apart. With a robot, ``slanted-rows``
    are rows of six each a little to the left of the one before, ``columns`` (objects) start at six
    places of one row, ``around`` (ours) keeps to what an arm can reach beside walls five cells
    wide, and ``random`` scatters cubes before and behind the structure. The published
    code drops some of these for ten simulation steps and draws again where something moved;
    waiting objects are positions only here, so nothing can move (D18).

    Raises:
        UnknownNameError: for a layout that does not exist.
    """
    check_name("layout", layout, LAYOUTS)
    place, apart = LAYOUTS[layout]
    return Waiting(place(count), apart, layout == RANDOM)


MAX_DRAWS = 100_000
"""Draws after which a reset gives up (a task whose shapes can never be accepted)."""
TRAINING_BOX = (0.075, 0.15)
"""Half width and height of the 3x3 box that 'unseen' shapes must leave [m]."""
FREE_STRIP = 0.075
"""Objects that are kept apart also wait at least this far in front of the structure [m]."""
RANDOM_X, RANDOM_Y = (-0.07, 0.28828), (0.15, 0.35)
"""Random places: middle and half width in x, distance from the x axis in y [m]."""


class Problems(NamedTuple):
    """The distribution problems are drawn from; see :class:`Task`."""

    frames: np.ndarray
    """float64[S, 4] of the sides."""
    stock: Inventory
    waiting: Waiting
    grid: int
    num_nodes: int
    min_pixels: int
    max_initial: float
    unseen_only: bool
    pitch: float
    depths: DepthFilter
    normalise: bool


@kernel(inline="always")
def _cross(ax: float, az: float, bx: float, bz: float, px: float, pz: float) -> float:
    return (bx - ax) * (pz - az) - (bz - az) * (px - ax)


@kernel
def sample_outline(rng: np.random.Generator, grid: int, vertices: np.ndarray) -> int:
    """Draw an outline of 3, 4 or 5 vertices into ``vertices`` (local x, z [m]); gives the count."""
    a, height = HALF * grid, EDGE * grid
    count = 3 + int(rng.random() * 3)
    vertices[0, 0], vertices[0, 1] = -rng.random() * a, 0.0
    vertices[count - 1, 0], vertices[count - 1, 1] = rng.random() * a, 0.0
    if count == 3:
        vertices[1, 0] = (2 * rng.random() - 1) * a
        vertices[1, 1] = rng.random() * height
        return count
    right = count - 2
    vertices[1, 0], vertices[1, 1] = -rng.random() * a, rng.random() * height
    vertices[right, 0], vertices[right, 1] = rng.random() * a, rng.random() * height
    if count == 5:
        lb, lt, rt, rb = vertices[0], vertices[1], vertices[3], vertices[4]
        for _ in range(MAX_DRAWS):
            x = lt[0] + rng.random() * (rt[0] - lt[0])
            z = rng.random() * height
            if (
                _cross(rb[0], rb[1], rt[0], rt[1], x, z) > 0
                and _cross(lb[0], lb[1], lt[0], lt[1], x, z) < 0
            ):
                vertices[2, 0], vertices[2, 1] = x, z
                break
    return count


@kernel
def leaves_training_box(rng: np.random.Generator, vertices: np.ndarray, count: int) -> bool:
    """Whether an outline has a vertex outside the 3x3 training box, as unseen shapes do."""
    half, height = TRAINING_BOX
    low = height * rng.random()
    if vertices[0, 0] < -half or vertices[count - 1, 0] > half:
        return True
    if count == 3:
        return abs(vertices[1, 0]) > half or vertices[1, 1] > height
    right = count - 2
    if vertices[1, 0] < -half or vertices[1, 1] > low:
        return True
    if vertices[right, 0] > half or vertices[right, 1] > height:
        return True
    return count == 5 and vertices[2, 1] > height


@kernel
def _step_back(position: np.ndarray, first: int, start: int, stop: int, apart: float) -> None:
    """Move cells ``start:stop`` in -y until they keep their distance from ``first:start``."""
    clear = False
    while not clear:
        clear = True
        for k in range(start, stop):
            if position[k, 1] > -FREE_STRIP:
                clear = False
            for j in range(first, start):
                square = 0.0
                for axis in range(3):
                    square += (position[k, axis] - position[j, axis]) ** 2
                if square < apart * apart:
                    clear = False
        if not clear:
            for k in range(start, stop):
                position[k, 1] -= EDGE


@kernel
def scatter(rng: np.random.Generator, position: np.ndarray, apart: float) -> bool:
    """Draw random places for cubes before and behind the structure.

    Args:
        position: float64[n, 3], written: centres [m].
        apart: least distance of two of them [m]; who is nearer to an earlier one is moved away
            from the structure, and drawn again where that leads too far.

    Returns:
        whether places were found for all.
    """
    middle, width = RANDOM_X
    nearest, farthest = RANDOM_Y
    for k in range(len(position)):
        for _ in range(MAX_DRAWS):
            x = middle + (2 * rng.random() - 1) * width
            y = nearest + (farthest - nearest) * rng.random()
            side = 1.0 if rng.random() < 0.5 else -1.0
            near = True
            while near and y <= farthest:
                near = False
                for j in range(k):
                    dx, dy = x - position[j, 0], side * y - position[j, 1]
                    near |= dx * dx + dy * dy < apart * apart
                y += EDGE if near else 0.0
            if not near:
                position[k, 0], position[k, 1], position[k, 2] = x, side * y, HALF
                break
        else:
            return False
    return True


@kernel
def _spread(
    position: np.ndarray,
    object_id: np.ndarray,
    waiting: Waiting,
    frame: np.ndarray,
    num_blocks: int,
) -> int:
    """First object to the bottom centre of a side, the others to their places; gives its cells."""
    x, y, apart = frame[2], frame[3], 0.0 if waiting.random else waiting.apart
    placed = 0
    while placed < num_blocks and object_id[placed] == object_id[0]:
        position[placed, 0] += x
        position[placed, 1] += y
        position[placed, 2] += HALF
        placed += 1
    start, number = placed, 0
    while start < num_blocks:
        stop = start
        while stop < num_blocks and object_id[stop] == object_id[start]:
            position[stop] += waiting.position[number]
            stop += 1
        if apart > 0:
            _step_back(position, placed, start, stop, apart)
        start, number = stop, number + 1
    return placed


@kernel
def start_objects(
    state: State,
    row: int,
    frames: np.ndarray,
    waiting: Waiting,
    side: int,
    num_blocks: int,
    depths: DepthFilter = NARROW,
) -> None:
    """First object at the bottom centre of ``side``, the others waiting; pixel sets and counts.

    ``position`` and ``object_id`` hold the objects as :func:`draw_objects` leaves them.
    """
    state.num_blocks[row] = num_blocks
    state.terminated[row] = False
    state.quaternion[row, :, 0] = 1.0
    state.quaternion[row, :, 1:] = 0.0
    state.num_placed[row] = _spread(
        state.position[row],
        state.object_id[row],
        waiting,
        frames[side],
        num_blocks,
    )
    first, last = state.mask.shape[2], 0
    for s in range(state.mask.shape[1]):
        for r in range(state.mask.shape[2]):
            for w in range(state.mask.shape[3]):
                if state.mask[row, s, r, w] != 0:
                    first, last = min(first, r), max(last, r + 1)
    state.mask_rows[row, 0], state.mask_rows[row, 1] = first, last
    recover_all(state, row, frames, depths)
    count_row(state, row)
    state.initial_pixels[row] = state.plane_pixels[row]


@kernel
def sample_problem(
    state: State,
    row: int,
    rng: np.random.Generator,
    problems: Problems,
) -> int:
    """Draw a fresh problem into a row; returns the number of draws, 0 where it gave up.

    Shapes and objects are redrawn while the masks hold fewer than ``min_pixels`` pixels or
    the first object covers more than ``max_initial`` of them.
    """
    sides = problems.frames.shape[0]
    for draw in range(1, MAX_DRAWS + 1):
        nodes, pixels = 0, 0
        for side in range(sides):
            outline, count = state.vertices[row, side], 0
            for _ in range(MAX_DRAWS):
                count = sample_outline(rng, problems.grid, outline)
                if not problems.unseen_only or leaves_training_box(rng, outline, count):
                    break
            state.num_vertices[row, side] = count
            nodes += count
            pixels += paper_mask(state.vertices[row, side], count, state.mask[row, side])
        if pixels < problems.min_pixels:
            continue
        state.mask_pixels[row] = pixels
        side, blocks = int(rng.random() * sides), problems.num_nodes - nodes
        position = state.position[row]
        draw_objects(rng, problems.stock, blocks, position, state.object_id[row], problems.pitch)
        start_objects(state, row, problems.frames, problems.waiting, side, blocks, problems.depths)
        if state.initial_pixels[row] > problems.max_initial * pixels:
            continue
        if not problems.normalise:
            state.initial_pixels[row] = 0
        if problems.waiting.random:
            first = state.num_placed[row]
            if not scatter(rng, position[first:blocks], problems.waiting.apart):
                return 0
        return draw
    return 0
