"""The rules of the world as compiled functions on one row of a :class:`State`: placement geometry,
coverage, reward and end of an episode, each defined here and nowhere else."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from learn2assemble.constants import EDGE, HALF
from learn2assemble.kernels import kernel
from learn2assemble.tasks.world.blocks import DIRECTIONS, ActionSpec, quarter_turn
from learn2assemble.tasks.world.coverage import (
    NARROW,
    DepthFilter,
    add_box,
    clear_to_ground,
    count_cover,
)

if TYPE_CHECKING:
    from learn2assemble.tasks.world.state import State

DISCRETE, SCALED = 0, 1
REWARDS = {"discrete": DISCRETE, "scaled": SCALED}
STABILITY = {"block": 0.5, "sum": 1.0, "object": 0.5}
"""Rules by which a simulated placement holds, with their published limits on V [m/s]: of the
fastest block, of all blocks together (cubes), of the fastest block while objects keep their
attitude and nothing shifts (objects of several cells)."""
Rules = tuple[ActionSpec, bool, bool, np.ndarray, DepthFilter, int, float]
"""What a step is told besides the state: actions, whether blocks are cubes and compiled rules
decide, frames float64[S, 4] of the sides, filter, reward, threshold."""
SCALED_GAIN = 3.0
"""c1 of the scaled reward (paper, equation 6 of the appendix)."""


@kernel(inline="always")
def rotate(
    quaternion: np.ndarray, vector: np.ndarray | tuple[float, float, float]
) -> tuple[float, float, float]:
    """Rotate ``vector`` by the unit quaternion (w, x, y, z)."""
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    a, b, c = vector[0], vector[1], vector[2]
    ux, uy, uz = y * c - z * b, z * a - x * c, x * b - y * a
    return (
        a + 2 * (w * ux + y * uz - z * uy),
        b + 2 * (w * uy + z * ux - x * uz),
        c + 2 * (w * uz + x * uy - y * ux),
    )


@kernel
def target_cell(
    state: State, row: int, reference: int, relation: int, pitch: float = EDGE
) -> tuple[float, float, float]:
    """Centre [m] of the cell next to placed block ``reference`` in direction ``relation``.

    Args:
        pitch: horizontal distance of the centres of neighbouring cells [m]; above each other
            blocks always touch.
    """
    dx, dy, dz = rotate(state.quaternion[row, reference], DIRECTIONS[relation])
    p = state.position[row, reference]
    step = pitch if relation else EDGE
    return p[0] + step * dx, p[1] + step * dy, p[2] + step * dz


@kernel(inline="always")
def object_span(
    object_id: np.ndarray, row: int, start: int, stop: int, block: int
) -> tuple[int, int]:
    """First and one past the last cell of the object of ``block`` among ``start:stop`` of a row.

    Args:
        object_id: of the whole state; views of a row cost as much as the search.
    """
    low, high = block, block + 1
    while low > start and object_id[row, low - 1] == object_id[row, block]:
        low -= 1
    while high < stop and object_id[row, high] == object_id[row, block]:
        high += 1
    return low, high


@kernel(inline="always")
def waiting_level(z: float) -> float:
    """How far a waiting cell with node height ``z`` stands above those on the table [m].

    Some layouts count heights from the table, some from the centres of the cells on it.
    """
    return EDGE * np.floor(z / EDGE + 0.25)


@kernel
def lay_object(
    state: State,
    row: int,
    unplaced: int,
    reference: int,
    x: float,
    y: float,
    z: float,
    turns: int,
    cells: np.ndarray,
    pitch: float = EDGE,
) -> int:
    """Where the cells of a waiting object would go.

    Unplaced block number ``unplaced`` goes to (x, y, z) [m]. The other cells of its object keep
    their places relative to it after ``turns`` quarter turns about its vertical axis, in the
    frame of the placed block ``reference``.

    Args:
        cells: float64[C, 3], written: the chosen cell, then the others in list order [m].
        pitch: horizontal distance of the centres of neighbouring cells [m].

    Returns:
        the number of cells.
    """
    placed = state.num_placed[row]
    source = placed + unplaced
    low, high = object_span(state.object_id, row, placed, state.num_blocks[row], source)
    cells[0, 0], cells[0, 1], cells[0, 2] = x, y, z
    n = 1
    for k in range(low, high):
        if k == source:
            continue
        # Cells are on one lattice; rounding keeps the drift of waiting places out.
        dx = round((state.position[row, k, 0] - state.position[row, source, 0]) / pitch)
        dy = round((state.position[row, k, 1] - state.position[row, source, 1]) / pitch)
        dz = round((state.position[row, k, 2] - state.position[row, source, 2]) / EDGE)
        dx, dy = quarter_turn(dx, dy, turns)
        dx, dy, dz = rotate(state.quaternion[row, reference], (pitch * dx, pitch * dy, EDGE * dz))
        cells[n, 0], cells[n, 1], cells[n, 2] = x + dx, y + dy, z + dz
        n += 1
    return n


@kernel
def lay_action(
    state: State,
    row: int,
    unplaced: int,
    reference: int,
    action: int,
    spec: ActionSpec,
    cells: np.ndarray,
) -> int:
    """The same where an action puts it, which counts relation and way."""
    relation, way = divmod(action, len(spec.turns))
    x, y, z = target_cell(state, row, reference, relation, spec.pitch)
    if spec.level:
        z += waiting_level(state.position[row, state.num_placed[row] + unplaced, 2])
    turns = spec.turns[way]
    return lay_object(state, row, unplaced, reference, x, y, z, turns, cells, spec.pitch)


@kernel
def move_cell(
    state: State, row: int, source: int, reference: int, x: float, y: float, z: float
) -> None:
    """Make block number ``source`` the last placed one, at (x, y, z) [m]; those between shift.

    It takes the orientation of ``reference``. All there is to placing a cube; of a larger object
    it leaves the other cells behind.
    """
    placed = state.num_placed[row]
    moved = state.object_id[row, source]
    for k in range(source, placed, -1):
        for axis in range(3):
            state.position[row, k, axis] = state.position[row, k - 1, axis]
        for n in range(4):
            state.quaternion[row, k, n] = state.quaternion[row, k - 1, n]
        state.object_id[row, k] = state.object_id[row, k - 1]
    state.object_id[row, placed] = moved
    state.position[row, placed, 0] = x
    state.position[row, placed, 1] = y
    state.position[row, placed, 2] = z
    for k in range(4):
        state.quaternion[row, placed, k] = state.quaternion[row, reference, k]
    state.num_placed[row] = placed + 1


@kernel
def move_block(
    state: State,
    row: int,
    unplaced: int,
    reference: int,
    x: float,
    y: float,
    z: float,
    turns: int = 0,
    pitch: float = EDGE,
) -> None:
    """Move the object of unplaced block ``unplaced``, that block to (x, y, z).

    Its cells become the last placed ones, the chosen one first, see :func:`lay_object`, and take
    the orientation of ``reference``; the unplaced blocks before them shift.
    """
    placed = state.num_placed[row]
    source = placed + unplaced
    low, high = object_span(state.object_id, row, placed, state.num_blocks[row], source)
    cells = np.empty((high - low, 3))
    lay_object(state, row, unplaced, reference, x, y, z, turns, cells, pitch)
    for n in range(high - low):
        # Whichever cell comes next has by then been shifted to place low + n.
        k = low + n if n else source
        move_cell(state, row, k, reference, cells[n, 0], cells[n, 1], cells[n, 2])


@kernel(inline="always")
def last_object(state: State, row: int) -> int:
    """First cell of the object placed last; it reaches to ``num_placed``."""
    placed = state.num_placed[row]
    return object_span(state.object_id, row, 0, placed, placed - 1)[0]


@kernel
def cover_block(
    state: State, row: int, frames: np.ndarray, block: int, depths: DepthFilter = NARROW
) -> None:
    """Add one placed block to the pixel sets of every side."""
    p = state.position[row, block]
    for side in range(frames.shape[0]):
        c, s, tx, ty = frames[side, 0], frames[side, 1], frames[side, 2], frames[side, 3]
        wx, wy = p[0] - tx, p[1] - ty
        x, y = c * wx + s * wy, c * wy - s * wx
        add_box(state.covered[row, side], state.occluded[row, side], x, y, p[2], HALF, depths)


@kernel
def recover_all(state: State, row: int, frames: np.ndarray, depths: DepthFilter = NARROW) -> None:
    """Recompute the pixel sets of a row from every placed block (needed once blocks have moved)."""
    for side in range(frames.shape[0]):
        clear_to_ground(state.covered[row, side], state.occluded[row, side], depths)
    for block in range(state.num_placed[row]):
        cover_block(state, row, frames, block, depths)


@kernel
def count_row(state: State, row: int) -> None:
    """Refresh ``plane_pixels`` and ``complete_pixels`` from the pixel sets."""
    plane, complete = 0, 0
    first, last = state.mask_rows[row, 0], state.mask_rows[row, 1]
    for side in range(state.mask.shape[1]):
        p, c = count_cover(
            state.mask[row, side], state.covered[row, side], state.occluded[row, side], first, last
        )
        plane += p
        complete += c
    state.plane_pixels[row] = plane
    state.complete_pixels[row] = complete


@kernel
def reward_and_success(
    mask_pixels: int,
    initial_pixels: int,
    previous_plane: int,
    plane: int,
    complete: int,
    valid: bool,
    reward_kind: int,
    threshold: float,
) -> tuple[float, bool]:
    """Reward and success of a step from pixel counts: ``(reward, success)``."""
    span = mask_pixels - initial_pixels
    gain = (plane - previous_plane) / span
    success = valid and (complete - initial_pixels) / span > threshold
    if not valid:
        reward = -1.0
    elif reward_kind == DISCRETE:
        reward = 1.0 if gain > 0 else 0.0
    else:
        reward = SCALED_GAIN * max(gain, 0.0) + (1.0 if success else 0.0)
    return reward, success


@kernel
def reward_and_end(
    state: State, row: int, previous_plane: int, valid: bool, reward_kind: int, threshold: float
) -> tuple[float, bool, bool]:
    """Reward and end of the step that led to the current row.

    ``previous_plane`` is c_pl before the step. Returns ``(reward, terminated, success)``.
    """
    reward, success = reward_and_success(
        state.mask_pixels[row],
        state.initial_pixels[row],
        previous_plane,
        state.plane_pixels[row],
        state.complete_pixels[row],
        valid,
        reward_kind,
        threshold,
    )
    terminated = (not valid) or success or state.num_placed[row] >= state.num_blocks[row]
    return reward, terminated, success
