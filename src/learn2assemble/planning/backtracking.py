"""The widest search for a plan: every legal placement, depth first, with backtracking."""

from __future__ import annotations

import time

import numpy as np

from learn2assemble.graph.features import node_offset
from learn2assemble.graph.placements import distinct_placements
from learn2assemble.planning.problem import Problem
from learn2assemble.planning.sequence import Placement, block_of, make
from learn2assemble.planning.world_model import WorldModel
from learn2assemble.simulator import Simulator
from learn2assemble.world.blocks import EDGE, HALF
from learn2assemble.world.state import State


def depth_first(
    problem: Problem, simulator: Simulator, model: WorldModel, seconds: float
) -> tuple[list[Placement], bool, int]:
    """Search over every legal placement; returns the best plan, success and backtracks."""
    deadline = time.perf_counter() + seconds
    state = problem.state.copy()
    stack = [(state, _candidates(problem, simulator, model, state))]
    path: list[Placement] = []
    seen = {_key(state)}
    best: list[Placement] = []
    best_cover, backtracks = -1.0, 0
    while stack and time.perf_counter() < deadline:
        state, candidates = stack[-1]
        if not candidates:
            stack.pop()
            if path:
                path.pop()
            backtracks += 1
            continue
        action = candidates.pop(0)
        after = state.copy()
        placement = Placement(block_of(state, action), int(action[1]), int(action[2]))
        success, held = make(simulator, after, placement)
        key = _key(after)
        if not held or key in seen:
            continue
        seen.add(key)
        cover = float(after.complete_coverage[0])
        if cover > best_cover:
            best, best_cover = [*path, placement], cover
        if success and problem.accepts(after):
            return [*path, placement], True, backtracks
        if not after.terminated[0]:
            path.append(placement)
            stack.append((after, _candidates(problem, simulator, model, after)))
    return best, False, backtracks


def _candidates(
    problem: Problem, simulator: Simulator, model: WorldModel, state: State
) -> list[np.ndarray]:
    """Placements to try, one per cell: those that fill first, then supports of open cells, then
    the rest, by the agent's Q within each class."""
    graph = simulator.observe(state)
    placements = distinct_placements(graph, simulator.ways)
    outcomes = simulator.outcomes(state, graph, placements, by_hand=True)
    actions = placements.action[0] - node_offset(graph)
    values = model.action_values(state)[0]
    q = {tuple(action): value for action, value in zip(values.actions.tolist(), values.values,
                                                       strict=True)}  # fmt: skip
    carries = _open_columns(problem, state)
    ranked: list[tuple[float, np.ndarray]] = []
    for n in np.flatnonzero(outcomes.valid[0]):
        cells = placements.cells[0, placements.members[0, n][placements.members[0, n] >= 0]]
        if tuple(actions[n].tolist()) not in q:
            continue
        if not problem.supports and any(problem.is_outside(cell) for cell in cells):
            continue
        score = float(q[tuple(actions[n].tolist())])
        if outcomes.reward[0, n] > 0:
            # The largest share first: where blocks are scarce, it needs the fewest.
            score += 200.0 + 100.0 * float(outcomes.gain[0, n])
        elif any((round(x / EDGE), round(y / EDGE)) in carries for x, y, _ in cells.tolist()):
            score += 100.0
        ranked.append((score, actions[n]))
    return [action for _, action in sorted(ranked, key=lambda item: -item[0])]


def _open_columns(problem: Problem, state: State) -> set[tuple[int, int]]:
    """World columns (x, y in edges) in which some needed cell is not yet filled."""
    filled = {
        (round(x / EDGE), round(y / EDGE), round((z - HALF) / EDGE))
        for x, y, z in state.position[0, : state.num_placed[0]]
    }
    columns = set()
    for frame, cells in zip(Simulator(problem.task).frames, problem.needed, strict=True):
        c, s, tx, ty = frame
        for cell in cells:
            x, y = c * cell.column * EDGE + tx, s * cell.column * EDGE + ty
            place = (round(x / EDGE), round(y / EDGE))
            if (*place, cell.level) not in filled:
                columns.add(place)
    return columns


def _key(state: State) -> frozenset[tuple[int, int, int]]:
    """The set of filled cells: two orders of the same structure are one."""
    placed = np.round(state.position[0, : state.num_placed[0]] / HALF).astype(int)
    return frozenset(map(tuple, placed.tolist()))
