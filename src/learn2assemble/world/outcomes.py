"""What placements of a state would bring, without making them: a one-step look-ahead.

The exact model is cheap without a robot, so all distinct placements can be tried: validity by
static physics, reward and end by the same rules as a real step. Learning uses it for labels of
actions that were not taken, planning to find what a policy overlooks. It is help that the
paper's agent does not have; whoever uses it says so.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from learn2assemble.geometry.boxes import STABLE, classify_cube
from learn2assemble.geometry.coverage import add_box, count_cover
from learn2assemble.world.blocks import HALF
from learn2assemble.world.rules import REWARDS, judge_counts, target_cell
from learn2assemble.world.state import State


class Outcomes(NamedTuple):
    """Outcome of P placements of every row; zeros beyond those it has."""

    reward: np.ndarray
    """float32[B, P]: -1 where the placement is invalid."""
    terminal: np.ndarray
    """bool[B, P]: the episode would end."""
    valid: np.ndarray
    """bool[B, P]: the object would stay."""
    gain: np.ndarray
    """float32[B, P]: change of F_pl, negative where it hides a side; 0 where invalid."""


@njit(cache=True)
def _try_all(
    state, actions, count, frames, reward_kind, threshold,
    reward, terminal, valid, gain, covered, occluded,
):  # fmt: skip
    sides, words = covered.shape[0], covered.shape[2]
    for row in range(len(count)):
        first, last = state.mask_rows[row, 0], state.mask_rows[row, 1]
        placed = state.num_placed[row]
        is_last = placed + 1 >= state.num_blocks[row]
        for n in range(count[row]):
            x, y, z = target_cell(state, row, actions[row, n, 1], actions[row, n, 2])
            if classify_cube(state.position[row], placed, x, y, z, HALF) != STABLE:
                reward[row, n] = -1.0
                terminal[row, n] = True
                continue
            valid[row, n] = True
            plane, complete = 0, 0
            for side in range(sides):
                for r in range(first, last):
                    for w in range(words):
                        covered[side, r, w] = state.covered[row, side, r, w]
                        occluded[side, r, w] = state.occluded[row, side, r, w]
                c, s = frames[side, 0], frames[side, 1]
                wx, wy = x - frames[side, 2], y - frames[side, 3]
                add_box(covered[side], occluded[side], c * wx + s * wy, c * wy - s * wx, z, HALF)
                p, q = count_cover(
                    state.mask[row, side], covered[side], occluded[side], first, last
                )
                plane += p
                complete += q
            gained, success = judge_counts(
                state.mask_pixels[row], state.initial_pixels[row], state.plane_pixels[row],
                plane, complete, True, reward_kind, threshold,
            )  # fmt: skip
            reward[row, n] = gained
            span = state.mask_pixels[row] - state.initial_pixels[row]
            gain[row, n] = (plane - state.plane_pixels[row]) / span
            terminal[row, n] = success or is_last


def outcomes(
    state: State,
    actions: np.ndarray,
    count: np.ndarray,
    frames: np.ndarray,
    reward: str,
    threshold: float,
) -> Outcomes:
    """Try placements of every row by static physics.

    Placements that only the equilibrium program could judge count as invalid here.

    Args:
        actions: int64[B, P, 3]: number of the unplaced block, of the reference block, action.
        count: int64[B]: how many of them each row has.
        frames: float64[S, 4] of the sides.
    """
    shape = actions.shape[:2]
    out = Outcomes(
        np.zeros(shape, np.float32),
        np.zeros(shape, np.bool_),
        np.zeros(shape, np.bool_),
        np.zeros(shape, np.float32),
    )
    _try_all(
        state, actions, count, frames, REWARDS[reward], threshold, *out,
        np.empty_like(state.covered[0]), np.empty_like(state.occluded[0]),
    )  # fmt: skip
    return out
