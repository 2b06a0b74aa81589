"""What every placement of a state would bring: a one-step look-ahead without making any.

Validity by static physics, reward and end by the rules of a real step. Learning uses it for labels
of actions that were not taken, planning for what a policy overlooks.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.constants import HALF
from learn2assemble.kernels import kernel
from learn2assemble.tasks.physics.support import STABLE, UNDECIDED, classify_cube, classify_object
from learn2assemble.tasks.world.coverage import DepthFilter, add_box, count_cover
from learn2assemble.tasks.world.rules import (
    Rules,
    lay_action,
    reward_and_success,
)
from learn2assemble.tasks.world.state import State


class Outcomes(NamedTuple):
    """Outcome of P placements of every row; zeros beyond those it has.

    Neither ``valid`` nor ``terminal``: only the equilibrium program could tell.
    """

    reward: np.ndarray
    """float32[B, P]: -1 where the placement is invalid."""
    terminal: np.ndarray
    """bool[B, P]: the episode would end."""
    valid: np.ndarray
    """bool[B, P]: the object would stay."""
    gain: np.ndarray
    """float32[B, P]: change of F_pl, negative where it hides a side; 0 where invalid."""


@kernel
def _verdict(position: np.ndarray, object_id: np.ndarray, placed: int, count: int) -> int:
    """Static verdict on the object with cells ``position[placed:count]``."""
    # The column rule for cubes holds only where everything that stands is a cube, too.
    single = count == placed + 1
    for k in range(1, placed):
        single &= object_id[k] != object_id[k - 1]
    if single:
        p = position[placed]
        return classify_cube(position, placed, p[0], p[1], p[2], HALF)
    return classify_object(position, placed, count, HALF)


@kernel
def _cover(
    state: State,
    row: int,
    frames: np.ndarray,
    depths: DepthFilter,
    position: np.ndarray,
    placed: int,
    count: int,
    covered: np.ndarray,
    occluded: np.ndarray,
) -> tuple[int, int]:
    """Plane and complete cover with the cells ``position[placed:count]`` added."""
    first, last = state.mask_rows[row, 0], state.mask_rows[row, 1]
    plane, complete = 0, 0
    for side in range(covered.shape[0]):
        # Only rows with pixels of the mask count, so only these are copied.
        for r in range(first, last):
            for w in range(covered.shape[2]):
                covered[side, r, w] = state.covered[row, side, r, w]
                occluded[side, r, w] = state.occluded[row, side, r, w]
        # Boxes are drawn in the frame of the viewer of the side.
        c, s = frames[side, 0], frames[side, 1]
        for k in range(placed, count):
            wx, wy = position[k, 0] - frames[side, 2], position[k, 1] - frames[side, 3]
            x, y = c * wx + s * wy, c * wy - s * wx
            add_box(covered[side], occluded[side], x, y, position[k, 2], HALF, depths)
        p, q = count_cover(state.mask[row, side], covered[side], occluded[side], first, last)
        plane += p
        complete += q
    return plane, complete


@kernel
def _try_all(
    state: State,
    actions: np.ndarray,
    count: np.ndarray,
    rules: Rules,
    out: Outcomes,
    covered: np.ndarray,
    occluded: np.ndarray,
) -> None:
    spec, _, _, frames, depths, reward_kind, threshold = rules
    reward, terminal, valid, gain = out
    # The cells of a trial are written behind what stands.
    position = np.empty((state.position.shape[1] + 8, 3))
    for row in range(len(count)):
        placed = state.num_placed[row]
        position[:placed] = state.position[row, :placed]
        for n in range(count[row]):
            unplaced, reference, action = actions[row, n]
            end = placed + lay_action(
                state, row, unplaced, reference, action, spec, position[placed:]
            )
            verdict = _verdict(position, state.object_id[row], placed, end)
            # What only the program could tell stays zero in all fields.
            if verdict == UNDECIDED:
                continue
            if verdict != STABLE:
                reward[row, n] = -1.0
                terminal[row, n] = True
                continue
            valid[row, n] = True
            plane, complete = _cover(
                state, row, frames, depths, position, placed, end, covered, occluded
            )
            reward[row, n], success = reward_and_success(
                state.mask_pixels[row],
                state.initial_pixels[row],
                state.plane_pixels[row],
                plane,
                complete,
                True,
                reward_kind,
                threshold,
            )
            span = state.mask_pixels[row] - state.initial_pixels[row]
            gain[row, n] = (plane - state.plane_pixels[row]) / span
            terminal[row, n] = success or end >= state.num_blocks[row]


def outcomes(state: State, actions: np.ndarray, count: np.ndarray, rules: Rules) -> Outcomes:
    """Try placements of every row by static physics.

    Args:
        actions: int64[B, P, 3]: number of the unplaced block, of the reference block, action.
        count: int64[B]: how many of them each row has.
        rules: of a step; that of cubes is told from the blocks.
    """
    kinds = (np.float32, np.bool_, np.bool_, np.float32)
    out = Outcomes(*[np.zeros(actions.shape[:2], kind) for kind in kinds])
    covered, occluded = np.empty_like(state.covered[0]), np.empty_like(state.occluded[0])
    _try_all(state, actions, count, rules, out, covered, occluded)
    return out
