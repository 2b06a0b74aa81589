"""From a problem to a sequence of placements that fills the target, widening as needed.

The agent with a small search goes first. Where its plan does not fill the target, larger budgets
follow, then a depth-first search over every legal placement with backtracking, ordered by the
one-step model and the agent's Q-values. Every plan is then stripped of blocks nothing needs.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from learn2assemble.graph.features import node_offset
from learn2assemble.graph.placements import distinct_placements
from learn2assemble.networks.build import Network
from learn2assemble.planning.problem import Problem
from learn2assemble.planning.world_model import WorldModel
from learn2assemble.search.config import SearchConfig
from learn2assemble.search.mcts import search
from learn2assemble.search.model import ActionValues
from learn2assemble.simulator import Simulator
from learn2assemble.world.actions import DIRECTIONS
from learn2assemble.world.blocks import EDGE, HALF
from learn2assemble.world.state import State

BUDGETS = (10, 40)
"""Search budgets of the agent's attempts, in order, before every placement is tried."""
PATIENCE = 6
"""Placements in a row that fill nothing after which an attempt of the agent is given up."""
TOLERANCE = 1e-3
"""Two cells are the same when their centres agree within this [m]."""


@dataclass(frozen=True)
class Placement:
    """One step of a plan: block ``block`` of the heap goes to the cell ``relation`` of
    ``reference`` (0 the first block, n the block placed in step n)."""

    block: int
    reference: int
    relation: int


@dataclass
class Attempt:
    """One attempt of the planner, for the report."""

    stage: str
    result: str
    seconds: float


@dataclass
class Sequence:
    """What the planner found."""

    placements: list[Placement]
    success: bool
    stage: str
    budget: int
    attempts: list[Attempt] = field(default_factory=list)
    backtracks: int = 0
    dropped: int = 0
    """Blocks the plan had placed and nothing needed."""


class _AllowedModel(WorldModel):
    """A world model that leaves out placements the design forbids (blocks outside it)."""

    def __init__(self, problem: Problem, simulator: Simulator, network: Network) -> None:
        super().__init__(simulator, network)
        self.problem = problem

    def action_values(self, states: State) -> list[ActionValues]:
        values = super().action_values(states)
        if self.problem.supports:
            return values
        return [self._filter(states, row, v) for row, v in enumerate(values)]

    def best(self, states: State) -> tuple[np.ndarray, np.ndarray]:
        if self.problem.supports:
            return super().best(states)
        rows = self.action_values(states)
        picks = [int(np.argmax(row.values)) for row in rows]
        value = np.array([row.values[p] for row, p in zip(rows, picks, strict=True)])
        return value, np.stack([row.actions[p] for row, p in zip(rows, picks, strict=True)])

    def _filter(self, states: State, row: int, values: ActionValues) -> ActionValues:
        placed = states.position[row, : states.num_placed[row]]
        cells = placed[:, None] + EDGE * DIRECTIONS
        good = np.array([[not self.problem.is_outside(c) for c in line] for line in cells])
        keep = good[values.actions[:, 1], values.actions[:, 2]]
        if not keep.any():
            return values
        return ActionValues(values.actions[keep], values.values[keep], values.group[keep])


Progress = Callable[[str], None]


def plan_sequences(
    problem: Problem,
    network: Network,
    seed: int = 0,
    seconds: float = 20.0,
    progress: Progress = lambda text: None,
) -> Iterator[Sequence]:
    """Plans in order of rising effort, each complete or the best of its stage.

    The caller takes the first one it can verify. ``seconds`` bounds the last stage.
    """
    simulator = Simulator(problem.task)
    model = _AllowedModel(problem, simulator, network)
    attempts: list[Attempt] = []
    for budget in BUDGETS:
        started = time.perf_counter()
        stage = f"agent with search, budget {budget}"
        progress(stage)
        config = SearchConfig(budget=budget, epsilon=0.0, distinct=True)
        placements, success = _play(problem, simulator, model, config, seed)
        yield _finish(problem, simulator, placements, success, stage, budget, attempts, started, 0)
    started = time.perf_counter()
    stage = "every legal placement, with backtracking"
    progress(stage)
    placements, success, backtracks = _depth_first(problem, simulator, model, seconds)
    yield _finish(problem, simulator, placements, success, stage, 0, attempts, started, backtracks)


def _finish(
    problem: Problem,
    simulator: Simulator,
    placements: list[Placement],
    success: bool,
    stage: str,
    budget: int,
    attempts: list[Attempt],
    started: float,
    backtracks: int,
) -> Sequence:
    dropped = 0
    if success:
        kept = strip(problem, simulator, placements)
        dropped = len(placements) - len(kept)
        placements = kept
    result = "fills the target" if success else "does not fill the target"
    attempts.append(Attempt(stage, result, time.perf_counter() - started))
    return Sequence(placements, success, stage, budget, list(attempts), backtracks, dropped)


def _play(
    problem: Problem, simulator: Simulator, model: WorldModel, config: SearchConfig, seed: int
) -> tuple[list[Placement], bool]:
    """Let the agent build with a search before every step, until the end."""
    rng = np.random.default_rng(seed)
    state = problem.state.copy()
    placements: list[Placement] = []
    idle = 0
    while not state.terminated[0] and idle < PATIENCE:
        before = state.copy()
        action = search(model, state, config, rng)[0].action
        block = _block_of(state, action)
        step = simulator.step(state, action[None])
        if step.verdict[0] != 0:
            return placements, False
        placements.append(Placement(block, int(action[1]), int(action[2])))
        idle = idle + 1 if step.reward[0] <= 0 else 0
        if problem.is_outside(state.position[0, before.num_placed[0]]) and not problem.supports:
            return placements[:-1], False
        if step.success[0]:
            return placements, problem.accepts(state)
    return placements, False


def _block_of(state: State, action: np.ndarray) -> int:
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
        state, np.array([[unplaced, placement.reference, placement.relation]], np.int64)
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
    return placements[: int(state.num_placed[0]) - 1]


def _without(problem: Problem, placements: list[Placement], number: int) -> list[Placement] | None:
    """``placements`` without step ``number`` (0-based), or ``None`` where a step loses its only
    neighbour."""
    cells = [problem.state.position[0, 0]]
    for placement in placements:
        cells.append(cells[placement.reference] + EDGE * DIRECTIONS[placement.relation])
    kept = [cells[0]]
    out: list[Placement] = []
    for step, placement in enumerate(placements):
        if step == number:
            continue
        found = _reference(kept, cells[step + 1])
        if found is None:
            return None
        out.append(Placement(placement.block, *found))
        kept.append(cells[step + 1])
    return out


def _reference(placed: list[np.ndarray], cell: np.ndarray) -> tuple[int, int] | None:
    """A placed block and relation that lead to ``cell``; the block below where there is one."""
    offsets = cell - np.array(placed)
    for relation, direction in enumerate(DIRECTIONS):
        match = np.abs(offsets - EDGE * direction).max(1) < TOLERANCE
        if match.any():
            return int(np.flatnonzero(match)[-1]), relation
    return None


def _depth_first(
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
        placement = Placement(_block_of(state, action), int(action[1]), int(action[2]))
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
    placements = distinct_placements(graph, simulator.task.num_actions)
    outcomes = simulator.outcomes(state, graph, placements)
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
