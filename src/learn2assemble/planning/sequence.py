"""A plan as a list of placements: making it, replaying it, leaving out what nothing needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from learn2assemble.planning.problem import Problem
from learn2assemble.simulator import Simulator
from learn2assemble.world.actions import DIRECTIONS, step_sizes
from learn2assemble.world.state import State

TOLERANCE = 3e-3
"""Two cells are the same when their centres agree within this [m]; an arm leaves blocks beside
their places by a fraction of it."""


@dataclass(frozen=True)
class Placement:
    """One step of a plan: block ``block`` of the heap goes next to the block that was the
    ``reference``-th to be placed, counted from 0 as in :class:`State`."""

    block: int
    reference: int
    action: int
    """Relation and way, see :mod:`learn2assemble.world.actions`."""


def block_of(state: State, action: np.ndarray) -> int:
    """Number in the heap of the block an action takes (block 0 is the one placed first)."""
    return int(state.object_id[0, state.num_placed[0] + action[0]])


def replay(
    problem: Problem, simulator: Simulator, placements: list[Placement]
) -> tuple[State, bool, bool]:
    """Make the placements in order: final state, whether all held, whether the target is filled.

    Stops at the first placement that does not hold, and at success.
    """
    state = problem.state.copy()
    for placement in placements:
        success, held = make(simulator, state, placement)
        if not held or success:
            return state, held, success and problem.accepts(state)
    return state, True, False


def make(simulator: Simulator, state: State, placement: Placement) -> tuple[bool, bool]:
    """Make one placement in place; returns whether the target is filled and the block held."""
    waiting = state.object_id[0, state.num_placed[0] : state.num_blocks[0]]
    unplaced = int(np.flatnonzero(waiting == placement.block)[0])
    step = simulator.step(
        state, np.array([[unplaced, placement.reference, placement.action]], np.int64)
    )
    return bool(step.success[0]), bool(step.verdict[0] == 0)


def strip(problem: Problem, simulator: Simulator, placements: list[Placement]) -> list[Placement]:
    """A shorter plan to the same end: without the blocks that neither fill nor carry nor guide.

    Blocks are tried for removal from the last to the first; references to a removed block are
    moved to another neighbour where there is one.
    """
    for number in range(len(placements) - 1, -1, -1):
        shorter = _without(problem, placements, number)
        if shorter is not None and replay(problem, simulator, shorter)[1:] == (True, True):
            placements = shorter
    state, _, _ = replay(problem, simulator, placements)
    return placements[: int(state.num_placed[0] - problem.state.num_placed[0])]


def _without(problem: Problem, placements: list[Placement], number: int) -> list[Placement] | None:
    """``placements`` without step ``number`` (0-based), or ``None`` where a step loses its only
    neighbour."""
    ways, steps = problem.task.rotations, DIRECTIONS * step_sizes(problem.task.pitch)
    there = int(problem.state.num_placed[0])
    cells = list(problem.state.position[0, :there])
    for placement in placements:
        cells.append(cells[placement.reference] + steps[placement.action // ways])
    kept = cells[:there]
    out: list[Placement] = []
    for step, placement in enumerate(placements):
        if step == number:
            continue
        found = _reference(kept, cells[there + step], steps)
        if found is None:
            return None
        reference, relation = found
        action = relation * ways + placement.action % ways
        out.append(Placement(placement.block, reference, action))
        kept.append(cells[there + step])
    return out


def _reference(
    placed: list[np.ndarray], cell: np.ndarray, steps: np.ndarray
) -> tuple[int, int] | None:
    """A placed block and relation that lead to ``cell``; the block below where there is one."""
    offsets = cell - np.array(placed)
    for relation, step in enumerate(steps):
        match = np.abs(offsets - step).max(1) < TOLERANCE
        if match.any():
            return int(np.flatnonzero(match)[-1]), relation
    return None
