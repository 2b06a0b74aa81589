"""The widest search for a plan: every legal placement, depth first, with backtracking."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from learn2assemble.graph.features import node_offset
from learn2assemble.graph.placements import distinct_placements
from learn2assemble.planning.problem import Problem
from learn2assemble.planning.sequence import Placement, block_of, make
from learn2assemble.planning.world_model import WorldModel
from learn2assemble.robot.arm import get_arm
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
    """Placements to try, the best first; of those that rank the same, the agent's favourite."""
    graph = simulator.observe(state)
    placements = distinct_placements(graph, simulator.ways)
    outcomes = simulator.outcomes(state, graph, placements, by_hand=True)
    actions = placements.action[0] - node_offset(graph)
    values = model.action_values(state)[0]
    q = {tuple(action): value for action, value in zip(values.actions.tolist(), values.values,
                                                       strict=True)}  # fmt: skip
    rank = _rank_by_level if problem.task.has_arm else _rank_by_share
    ranks = rank(problem, state)
    ranked: list[tuple[float, float, np.ndarray]] = []
    for n in np.flatnonzero(outcomes.valid[0]):
        action = actions[n]
        if not problem.allows(state, action) or tuple(action.tolist()) not in q:
            continue
        gain = float(outcomes.gain[0, n]) if outcomes.reward[0, n] > 0 else 0.0
        score = ranks(problem.target(state, action), gain)
        ranked.append((score, float(q[tuple(action.tolist())]), action))
    return [action for *_, action in sorted(ranked, key=lambda item: (-item[0], -item[1]))]


Place = tuple[int, int, int]
"""A cell of the lattice: x, y and level."""
Rank = Callable[[np.ndarray, float], float]
"""How good it is to fill the cell with this centre [m], which gains that much coverage."""


def _rank_by_share(problem: Problem, state: State) -> Rank:
    """By hand: the largest share first, which needs the fewest blocks; then supports of open
    cells."""
    pitch, open_cells = problem.task.pitch, _open_cells(problem, state)
    carries = {(x, y) for x, y, _ in open_cells}

    def rank(cell: np.ndarray, gain: float) -> float:
        if gain > 0:
            return 2.0 + gain
        return float((round(cell[0] / pitch), round(cell[1] / pitch)) in carries)

    return rank


def _rank_by_level(problem: Problem, state: State) -> Rank:
    """With an arm: level by level and the farthest first, so that nothing tall stands between the
    arm and what is left; on a level what gains, then what leads to cells still to be filled, and
    last what would leave no way in to such a cell for the fingers."""
    pitch, open_cells = problem.task.pitch, _open_cells(problem, state)
    base = get_arm(problem.task.arm).base_position
    filled = _filled(problem, state)

    def rank(cell: np.ndarray, gain: float) -> float:
        x, y, level = _place(cell, pitch)
        wanted = {
            (a, b)
            for a, b, z in open_cells
            if z >= level and (a, b, level) not in filled and not _shut(filled, (a, b, level))
        }
        away = min((abs(x - a) + abs(y - b) for a, b in wanted), default=np.inf)
        if gain <= 0 and not np.isfinite(away):
            return -np.inf
        after = {*filled, (x, y, level)}
        shuts = sum(_shut(after, (a, b, level)) for a, b in wanted - {(x, y)})
        toward = 0.0 if gain > 0 else 1.0 + away
        far = float(np.hypot(*(cell[:2] - base[:2]))) / pitch
        return -1000.0 * level - 200.0 * shuts - 50.0 * toward + far

    return rank


def _shut(filled: set[Place], place: Place) -> bool:
    """Whether blocks beside a cell, on both axes, keep the fingers out."""
    x, y, z = place
    beside = (x - 1, y, z) in filled or (x + 1, y, z) in filled
    before = (x, y - 1, z) in filled or (x, y + 1, z) in filled
    return beside and before


def _place(centre: np.ndarray, pitch: float) -> Place:
    return round(centre[0] / pitch), round(centre[1] / pitch), round((centre[2] - HALF) / EDGE)


def _filled(problem: Problem, state: State) -> set[Place]:
    """Cells in which a block stands."""
    placed = state.position[0, : state.num_placed[0]]
    return {_place(centre, problem.task.pitch) for centre in placed}


def _open_cells(problem: Problem, state: State) -> set[Place]:
    """Needed cells that are not yet filled."""
    pitch, needed = problem.task.pitch, set()
    for frame, cells in zip(problem.frames, problem.needed, strict=True):
        c, s, tx, ty = frame
        for cell in cells:
            x, y = c * cell.column * pitch + tx, s * cell.column * pitch + ty
            needed.add((round(x / pitch), round(y / pitch), cell.level))
    return needed - _filled(problem, state)


def _key(state: State) -> frozenset[tuple[int, int, int]]:
    """The set of filled cells: two orders of the same structure are one."""
    placed = np.round(state.position[0, : state.num_placed[0]] / HALF).astype(int)
    return frozenset(map(tuple, placed.tolist()))
