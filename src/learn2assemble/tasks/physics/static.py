"""Exact overlap and static equilibrium, compiled and batched.

A cube on the ground or straight on another is proven stable by the column rule; it decides every
lattice placement of cubes. Where objects of several cells are involved,
:mod:`learn2assemble.tasks.physics.support` looks at columns and centres of mass. What neither can
decide (supports that overhang or have drifted) goes to the equilibrium program of
:mod:`learn2assemble.tasks.physics.equilibrium`.
"""

from __future__ import annotations

import numpy as np

from learn2assemble.constants import EDGE, HALF
from learn2assemble.kernels import kernel
from learn2assemble.tasks.physics.protocol import PlacementVerdict
from learn2assemble.tasks.physics.support import (
    BALANCE_TOLERANCE,
    OVERLAP,
    UNDECIDED,
    classify_cube,
    classify_object,
)
from learn2assemble.tasks.world.blocks import DIRECTIONS, ActionSpec
from learn2assemble.tasks.world.rules import (
    last_object,
    lay_action,
    object_span,
    target_cell,
)
from learn2assemble.tasks.world.state import State

NUM_RELATIONS = len(DIRECTIONS)


@kernel
def _only_cubes(object_id: np.ndarray, row: int, count: int) -> bool:
    only = True
    for k in range(1, count):
        only &= object_id[row, k] != object_id[row, k - 1]
    return only


@kernel
def classify_last(state: State, row: int) -> int:
    """Verdict of the compiled rules on the object of a row that was placed last."""
    count = state.num_placed[row]
    if _only_cubes(state.object_id, row, count):
        p = state.position[row, count - 1]
        return classify_cube(state.position[row], count - 1, p[0], p[1], p[2], HALF)
    return classify_object(state.position[row], last_object(state, row), count, HALF)


@kernel
def _settle(state: State, rows: np.ndarray, verdict: np.ndarray) -> None:
    for n in range(len(rows)):
        verdict[n] = classify_last(state, rows[n])


@kernel
def _survey(state: State, pitch: float, verdict: np.ndarray) -> int:
    """Returns how many are undecided."""
    undecided = 0
    for row in range(len(state.num_placed)):
        placed = state.num_placed[row]
        for reference in range(verdict.shape[1]):
            for relation in range(NUM_RELATIONS):
                found = OVERLAP
                if reference < placed:
                    x, y, z = target_cell(state, row, reference, relation, pitch)
                    found = classify_cube(state.position[row], placed, x, y, z, HALF)
                verdict[row, reference, relation] = found
                undecided += found == UNDECIDED
    return undecided


def _equilibrium(centres: np.ndarray, object_id: np.ndarray) -> int:
    # Rarely needed, and training runs on machines without the solver.
    from learn2assemble.tasks.physics.equilibrium import is_stable

    stable = is_stable(centres, object_id, slack=BALANCE_TOLERANCE)
    return int(PlacementVerdict.STABLE if stable else PlacementVerdict.UNSTABLE)


class StaticPhysics:
    """See the module's docstring. Blocks never move."""

    name = "static"
    moves_blocks = False

    def prepare(self, state: State, rows: np.ndarray, actions: np.ndarray) -> None:
        """Nothing: only where the object comes to matters."""

    def settle(self, state: State, rows: np.ndarray) -> np.ndarray:
        """Verdict on the object placed last of each row; see :class:`Physics`."""
        verdict = np.empty(len(rows), np.int8)
        _settle(state, rows, verdict)
        for n in np.flatnonzero(verdict == UNDECIDED):
            row, count = rows[n], state.num_placed[rows[n]]
            verdict[n] = _equilibrium(state.position[row, :count], state.object_id[row, :count])
        return verdict


def survey(state: State, pitch: float = EDGE) -> np.ndarray:
    """Verdict of placing a block next to every placed block, by static physics; cubes only.

    Args:
        pitch: horizontal distance of the centres of neighbouring cells [m].

    Returns:
        int8[B, M, 5]: :class:`PlacementVerdict` for (reference, relation); OVERLAP for those beyond
        ``num_placed``, so ``survey(state) == STABLE`` is a mask of the good placements.
    """
    batch, blocks = state.position.shape[:2]
    verdict = np.empty((batch, blocks, NUM_RELATIONS), np.int8)
    if not _survey(state, pitch, verdict):
        return verdict
    for row, reference, relation in np.argwhere(verdict == UNDECIDED):
        placed = state.position[row, : state.num_placed[row]]
        cell = target_cell(state, row, reference, relation, pitch)
        verdict[row, reference, relation] = _equilibrium(
            np.vstack([placed, cell]), np.arange(len(placed) + 1)
        )
    return verdict


@kernel
def _try_object(
    state: State,
    row: int,
    unplaced: int,
    reference: int,
    action: int,
    spec: ActionSpec,
    position: np.ndarray,
) -> tuple[int, int]:
    """Verdict on one placement; its cells follow the placed ones in ``position``: (verdict, n)."""
    placed = state.num_placed[row]
    count = placed + lay_action(state, row, unplaced, reference, action, spec, position[placed:])
    return classify_object(position, placed, count, HALF), count


@kernel
def _same_object(state: State, row: int, a: int, b: int) -> bool:
    """Whether two waiting blocks have the same cells around them, in the same order."""
    placed, blocks = state.num_placed[row], state.num_blocks[row]
    object_id, position = state.object_id, state.position[row]
    low, high = object_span(object_id, row, placed, blocks, placed + a)
    other, end = object_span(object_id, row, placed, blocks, placed + b)
    if high - low != end - other or placed + a - low != placed + b - other:
        return False
    for k in range(high - low):
        for axis in range(3):
            mine = position[low + k, axis] - position[placed + a, axis]
            theirs = position[other + k, axis] - position[placed + b, axis]
            if abs(mine - theirs) > HALF:
                return False
    return True


@kernel
def _try_objects(
    state: State, row: int, spec: ActionSpec, position: np.ndarray, verdict: np.ndarray
) -> None:
    for unplaced in range(verdict.shape[0]):
        for earlier in range(unplaced):
            if _same_object(state, row, unplaced, earlier):
                verdict[unplaced] = verdict[earlier]
                break
        else:
            for reference in range(verdict.shape[1]):
                for action in range(verdict.shape[2]):
                    verdict[unplaced, reference, action], _ = _try_object(
                        state, row, unplaced, reference, action, spec, position
                    )


def survey_objects(state: State, spec: ActionSpec) -> np.ndarray:
    """Verdict of every placement of every waiting block with its object, by static physics.

    Args:
        spec: what the actions mean.

    Returns:
        int8[B, M, M, 5 * R]: :class:`PlacementVerdict` for (unplaced, reference, action), counted
        as in :meth:`Simulator.step`; OVERLAP beyond the blocks there are.
    """
    batch, blocks = state.position.shape[:2]
    shape = (batch, blocks, blocks, NUM_RELATIONS * len(spec.turns))
    verdict = np.full(shape, int(PlacementVerdict.OVERLAP), np.int8)
    for row in range(batch):
        placed, waiting = state.num_placed[row], int(state.num_unplaced[row])
        position = np.concatenate([state.position[row, :placed], np.empty((blocks, 3))])
        found = verdict[row, :waiting, :placed]
        _try_objects(state, row, spec, position, found)
        known: dict[bytes, int] = {}
        for choice in np.argwhere(found == UNDECIDED):
            unplaced, reference, action = choice
            _, count = _try_object(state, row, unplaced, reference, action, spec, position)
            cells = position[placed:count]
            key = np.unique(np.rint(cells * 1e6), axis=0).tobytes()
            if key not in known:
                ids = np.append(state.object_id[row, :placed], np.full(len(cells), -1))
                known[key] = _equilibrium(position[:count], ids)
            found[tuple(choice)] = known[key]
    return verdict
