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

from learn2assemble.networks.build import Network
from learn2assemble.planning.backtracking import depth_first
from learn2assemble.planning.problem import Problem
from learn2assemble.planning.sequence import Placement, block_of, strip
from learn2assemble.planning.world_model import WorldModel
from learn2assemble.search.config import SearchConfig
from learn2assemble.search.mcts import search
from learn2assemble.search.model import ActionValues
from learn2assemble.simulator import Simulator
from learn2assemble.world.state import State

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
        block = block_of(state, action)
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
