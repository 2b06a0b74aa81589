"""What every placement of a state would bring, without making it: a one-step look-ahead.

The exact model is cheap without a robot, so all (reference, relation) can be tried: validity by
the column rule, reward and end by the same rules as a real step. Learning uses it to learn from
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


class Prospects(NamedTuple):
    """Outcome of placing the next block at every (reference, relation)."""

    reward: np.ndarray
    """float32[B, M, 5]: -1 where the placement is invalid; references beyond the placed: 0."""
    terminal: np.ndarray
    """bool[B, M, 5]: the episode would end."""
    valid: np.ndarray
    """bool[B, M, 5]: the block would stay."""
    gain: np.ndarray
    """float32[B, M, 5]: change of F_pl, negative where it hides a side; 0 where invalid."""


@njit(cache=True)
def _try_all(
    state, frames, reward_kind, threshold, reward, terminal, valid, gain, covered, occluded
):
    sides, words = covered.shape[0], covered.shape[2]
    for row in range(len(state.num_placed)):
        first, last = state.mask_rows[row, 0], state.mask_rows[row, 1]
        placed = state.num_placed[row]
        is_last = placed + 1 >= state.num_blocks[row]
        for reference in range(placed):
            for relation in range(valid.shape[2]):
                x, y, z = target_cell(state, row, reference, relation)
                if classify_cube(state.position[row], placed, x, y, z, HALF) != STABLE:
                    reward[row, reference, relation] = -1.0
                    terminal[row, reference, relation] = True
                    continue
                valid[row, reference, relation] = True
                plane, complete = 0, 0
                for side in range(sides):
                    for r in range(first, last):
                        for w in range(words):
                            covered[side, r, w] = state.covered[row, side, r, w]
                            occluded[side, r, w] = state.occluded[row, side, r, w]
                    c, s = frames[side, 0], frames[side, 1]
                    wx, wy = x - frames[side, 2], y - frames[side, 3]
                    add_box(
                        covered[side], occluded[side], c * wx + s * wy, c * wy - s * wx, z, HALF
                    )
                    p, q = count_cover(
                        state.mask[row, side], covered[side], occluded[side], first, last
                    )
                    plane += p
                    complete += q
                gained, success = judge_counts(
                    state.mask_pixels[row], state.initial_pixels[row], state.plane_pixels[row],
                    plane, complete, True, reward_kind, threshold,
                )  # fmt: skip
                reward[row, reference, relation] = gained
                span = state.mask_pixels[row] - state.initial_pixels[row]
                gain[row, reference, relation] = (plane - state.plane_pixels[row]) / span
                terminal[row, reference, relation] = success or is_last


def prospects(state: State, frames: np.ndarray, reward: str, threshold: float) -> Prospects:
    """Try every placement of every row.

    Placements that only the equilibrium program could judge count as invalid here; on a lattice
    there are none.
    """
    batch, blocks = state.position.shape[:2]
    out = Prospects(
        np.zeros((batch, blocks, 5), np.float32),
        np.zeros((batch, blocks, 5), np.bool_),
        np.zeros((batch, blocks, 5), np.bool_),
        np.zeros((batch, blocks, 5), np.float32),
    )
    _try_all(
        state, frames, REWARDS[reward], threshold, *out,
        np.empty_like(state.covered[0]), np.empty_like(state.occluded[0]),
    )  # fmt: skip
    return out
