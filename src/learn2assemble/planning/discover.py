"""A plan as a list of placements: making it, replaying it, leaving out what nothing needs.

The widest search for a plan: every legal placement, depth first, with backtracking.

From a problem to a sequence of placements that fills the target, widening as needed.

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
from learn2assemble.networks.agent import Network
from learn2assemble.planning.problem import Problem
from learn2assemble.planning.world_model import WorldModel
from learn2assemble.robot.arm import get_arm
from learn2assemble.search.config import SearchConfig
from learn2assemble.search.mcts import search
from learn2assemble.search.tree import ActionValues
from learn2assemble.simulator import Simulator
from learn2assemble.world.blocks import DIRECTIONS, EDGE, HALF, step_sizes
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
    """Relation and way, see :mod:`learn2assemble.world.blocks`."""


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
    spec, steps = problem.task.rotations, DIRECTIONS * step_sizes(problem.task.pitch)
    there = int(problem.state.num_placed[0])
    cells = list(problem.state.position[0, :there])
    for placement in placements:
        cells.append(cells[placement.reference] + steps[placement.action // spec])
    kept = cells[:there]
    out: list[Placement] = []
    for step, placement in enumerate(placements):
        if step == number:
            continue
        found = _reference(kept, cells[there + step], steps)
        if found is None:
            return None
        reference, relation = found
        action = relation * spec + placement.action % spec
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
    placements = distinct_placements(graph, simulator.action_spec)
    outcomes = simulator.outcomes(state, graph, placements, without_arm=True)
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


BUDGETS = (10, 40)
"""Search budgets of the agent's attempts, in order, before every placement is tried."""
STAGES = (
    *(f"agent with search, budget {budget}" for budget in BUDGETS),
    "every legal placement, with backtracking",
)
"""What is tried, in order of rising effort."""
PATIENCE = 6
"""Placements in a row that fill nothing after which an attempt of the agent is given up."""


@dataclass
class PlanningAttempt:
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
    attempts: list[PlanningAttempt] = field(default_factory=list)
    backtracks: int = 0
    dropped: int = 0
    """Blocks the plan had placed and nothing needed."""


class _AllowedModel(WorldModel):
    """A world model that leaves out what the problem does not allow."""

    def __init__(self, problem: Problem, simulator: Simulator, network: Network) -> None:
        super().__init__(simulator, network)
        self.problem = problem
        self._free = problem.supports and not problem.avoid

    def action_values(self, states: State) -> list[ActionValues]:
        values = super().action_values(states)
        if self._free:
            return values
        return [self._filter(states, row, v) for row, v in enumerate(values)]

    def best(self, states: State) -> tuple[np.ndarray, np.ndarray]:
        if self._free:
            return super().best(states)
        rows = self.action_values(states)
        picks = [int(np.argmax(row.values)) for row in rows]
        value = np.array([row.values[p] for row, p in zip(rows, picks, strict=True)])
        return value, np.stack([row.actions[p] for row, p in zip(rows, picks, strict=True)])

    def _filter(self, states: State, row: int, values: ActionValues) -> ActionValues:
        one = states.take(np.array([row]))
        keep = np.array([self.problem.allows(one, action) for action in values.actions])
        if not keep.any():
            # A search needs something to choose from, but there is nothing to be had any more.
            return ActionValues(values.actions, np.zeros_like(values.values), values.group)
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
    attempts: list[PlanningAttempt] = []
    for stage, budget in zip(STAGES[:-1], BUDGETS, strict=True):
        started = time.perf_counter()
        progress(stage)
        config = SearchConfig(budget=budget, epsilon=0.0, distinct=True)
        placements, success = _play(problem, simulator, model, config, seed)
        yield _finish(problem, simulator, placements, success, stage, budget, attempts, started, 0)
    started = time.perf_counter()
    stage = STAGES[-1]
    progress(stage)
    placements, success, backtracks = depth_first(problem, simulator, model, seconds)
    yield _finish(problem, simulator, placements, success, stage, 0, attempts, started, backtracks)


def _finish(
    problem: Problem,
    simulator: Simulator,
    placements: list[Placement],
    success: bool,
    stage: str,
    budget: int,
    attempts: list[PlanningAttempt],
    started: float,
    backtracks: int,
) -> Sequence:
    dropped = 0
    if success:
        kept = strip(problem, simulator, placements)
        dropped = len(placements) - len(kept)
        placements = kept
    result = "fills the target" if success else "does not fill the target"
    attempts.append(PlanningAttempt(stage, result, time.perf_counter() - started))
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
        action = search(model, state, config, rng)[0].action
        if not problem.allows(state, action):
            return placements, False
        block = block_of(state, action)
        step = simulator.step(state, action[None])
        if step.verdict[0] != 0:
            return placements, False
        placements.append(Placement(block, int(action[1]), int(action[2])))
        idle = idle + 1 if step.reward[0] <= 0 else 0
        if step.success[0]:
            return placements, problem.accepts(state)
    return placements, False
