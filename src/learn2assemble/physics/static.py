"""Exact overlap and static equilibrium, compiled and batched.

A cube on the ground or straight on another is proven stable by the column rule; it decides every
lattice placement. What it cannot decide (overhangs, drifted supports) goes to the equilibrium
program of :mod:`learn2assemble.physics.equilibrium`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from learn2assemble.geometry.boxes import UNDECIDED, classify_cube
from learn2assemble.physics.protocol import Verdict
from learn2assemble.world.actions import DIRECTIONS
from learn2assemble.world.blocks import EDGE, HALF
from learn2assemble.world.rules import target_cell
from learn2assemble.world.state import State

NUM_RELATIONS = len(DIRECTIONS)


@njit(cache=True)
def _settle(state, rows, verdict):
    for n in range(len(rows)):
        row = rows[n]
        last = state.num_placed[row] - 1
        p = state.position[row, last]
        verdict[n] = classify_cube(state.position[row], last, p[0], p[1], p[2], HALF)


@njit(cache=True)
def _survey(state, verdict):
    for row in range(len(state.num_placed)):
        placed = state.num_placed[row]
        for reference in range(placed):
            for relation in range(NUM_RELATIONS):
                x, y, z = target_cell(state, row, reference, relation)
                verdict[row, reference, relation] = classify_cube(
                    state.position[row], placed, x, y, z, HALF
                )


def _equilibrium(centres: np.ndarray) -> int:
    # Rarely needed, and training runs on machines without the solver.
    from learn2assemble.physics.equilibrium import is_stable

    stable = is_stable(centres, np.arange(len(centres)))
    return int(Verdict.STABLE if stable else Verdict.UNSTABLE)


class StaticPhysics:
    """See the module's docstring. Blocks never move."""

    name = "static"
    moves_blocks = False

    def settle(self, state: State, rows: np.ndarray) -> np.ndarray:
        """Verdict on the last placed block of each row; see :class:`Physics`."""
        verdict = np.empty(len(rows), np.int8)
        _settle(state, rows, verdict)
        for n in np.flatnonzero(verdict == UNDECIDED):
            row = rows[n]
            verdict[n] = _equilibrium(state.position[row, : state.num_placed[row]])
        return verdict


def survey(state: State) -> np.ndarray:
    """Verdict of placing a block next to every placed block, by static physics.

    Returns:
        int8[B, M, 5]: :class:`Verdict` for (reference, relation); OVERLAP for references beyond
        ``num_placed``, so ``survey(state) == STABLE`` is a mask of the good placements.
    """
    batch, blocks = state.position.shape[:2]
    verdict = np.full((batch, blocks, NUM_RELATIONS), int(Verdict.OVERLAP), np.int8)
    _survey(state, verdict)
    if not (verdict == UNDECIDED).any():
        return verdict
    for row, reference, relation in np.argwhere(verdict == UNDECIDED):
        placed = state.position[row, : state.num_placed[row]]
        cell = placed[reference] + EDGE * DIRECTIONS[relation]
        verdict[row, reference, relation] = _equilibrium(np.vstack([placed, cell]))
    return verdict
