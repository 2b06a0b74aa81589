"""An episode that fills the target of a problem: the agent with its search, else all placements."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from learn2assemble.constants import HALF
from learn2assemble.planning import plan as plans
from learn2assemble.tasks.graph.features import node_offset
from learn2assemble.tasks.graph.placements import distinct_placements
from learn2assemble.tasks.networks.agent import (
    Network,
)
from learn2assemble.tasks.search.config import SearchConfig
from learn2assemble.tasks.search.mcts import search
from learn2assemble.tasks.search.tree import ActionValues
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import Task
from learn2assemble.tasks.world.rules import target_cell
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import WorldModel, placement_cost

BUDGETS = (10, 40)
"""Search budgets of the agent, in order, before every placement is tried."""


STAGES = (
    *(f"agent with search, budget {budget}" for budget in BUDGETS),
    "every legal placement, with backtracking",
)
"""What is tried, in order of rising effort."""


PATIENCE = 6
"""Placements in a row that fill nothing after which the agent is given up."""


Progress = Callable[[str], None]


Key = tuple[int, int, int, int]


def placement_key(task: Task, state: State, action: np.ndarray, row: int = 0) -> Key:
    """A placement in a row with another of its kind nearby: target in half edges, and the way."""
    relation, way = divmod(int(action[2]), task.rotations)
    x, y, z = target_cell(state, row, int(action[1]), relation, task.pitch)
    return round(x / HALF), round(y / HALF), round(z / HALF), way


@dataclass(frozen=True)
class PlayedEpisode:
    """The placements of one episode, as actions int64[3] of the simulator."""

    actions: list[np.ndarray]
    success: bool
    stage: int
    """Number of the stage that found them."""
    tried: list[plans.SearchStage]


class _Without(WorldModel):
    """A world model without the placements that failed when they were carried out."""

    def __init__(self, simulator: Simulator, network: Network, avoid: frozenset[Key]) -> None:
        super().__init__(simulator, network)
        self.avoid = avoid

    def action_values(self, states: State) -> list[ActionValues]:
        found, task = super().action_values(states), self.simulator.task
        for row, values in enumerate(found if self.avoid else ()):
            keys = [placement_key(task, states, action, row) for action in values.actions]
            keep = [key not in self.avoid for key in keys]
            if any(keep):  # a search needs something to choose from
                found[row] = ActionValues(*(field[keep] for field in values))
        return found


def plan_episode(
    simulator: Simulator,
    state: State,
    network: Network,
    *,
    seed: int = 0,
    seconds: float = 20.0,
    avoid: frozenset[Key] = frozenset(),
    progress: Progress = lambda text: None,
) -> PlayedEpisode:
    """The first episode that fills the target, else the one that fills most.

    Args:
        simulator: of the world as it is planned for.
        state: a batch of one, left alone.
        seconds: limit of the last, widest search.
        avoid: placements to leave out, see :func:`placement_key`.
        progress: told what is being tried.
    """
    model, tried = _Without(simulator, network, avoid), list[plans.SearchStage]()
    best, most = PlayedEpisode([], False, 0, []), -np.inf
    for stage, words in enumerate(STAGES):
        progress(words)
        started = time.perf_counter()
        if stage < len(BUDGETS):
            config = SearchConfig(budget=BUDGETS[stage], epsilon=0.0, distinct=True)
            actions, cover, success = _play(model, state, config, np.random.default_rng(seed))
        else:
            actions, cover, success = _try_all(simulator, state, avoid, seconds)
        result = "fills the target" if success else "does not fill the target"
        spent = round(time.perf_counter() - started, 3)
        tried.append(plans.SearchStage(words, result, spent))
        if success or cover > most:
            best, most = PlayedEpisode(actions, success, stage, tried), cover
        if success:
            break
    return best


def _play(
    model: _Without, start: State, config: SearchConfig, rng: np.random.Generator
) -> tuple[list[np.ndarray], float, bool]:
    """Let the agent play with a search before every step: what it did, coverage, success."""
    state, idle, task = start.copy(), 0, model.simulator.task
    actions = list[np.ndarray]()
    cover = float(state.complete_coverage[0])
    while state.num_unplaced[0] and idle < PATIENCE:
        action = search(model, state, config, rng)[0].action
        if placement_key(task, state, action) in model.avoid:
            break
        step = model.simulator.step(state, action[None])
        if step.verdict[0] != 0:
            break
        actions.append(action)
        cover = float(state.complete_coverage[0])
        idle = idle + 1 if step.reward[0] <= 0 else 0
        if step.terminated[0]:
            return actions, cover, bool(step.success[0])
    return actions, cover, False


def _try_all(
    simulator: Simulator, start: State, avoid: frozenset[Key], seconds: float
) -> tuple[list[np.ndarray], float, bool]:
    """Depth first over every legal placement, as :func:`_play`."""
    deadline = time.perf_counter() + seconds
    state = start.copy()
    begun = state, list[np.ndarray](), _candidates(simulator, state, avoid)
    stack, seen = [begun], {_filled(state)}
    best, most = list[np.ndarray](), float(state.complete_coverage[0])
    while stack and time.perf_counter() < deadline:
        state, path, candidates = stack[-1]
        if not candidates:
            stack.pop()
            continue
        action, after = candidates.pop(0), state.copy()
        step, path = simulator.step(after, action[None]), [*path, action]
        if step.verdict[0] != 0 or _filled(after) in seen:
            continue
        seen.add(_filled(after))
        if after.complete_coverage[0] > most:
            best, most = path, float(after.complete_coverage[0])
        if step.success[0]:
            return path, most, True
        if not step.terminated[0]:
            stack.append((after, path, _candidates(simulator, after, avoid)))
    return best, most, False


def _candidates(simulator: Simulator, state: State, avoid: frozenset[Key]) -> list[np.ndarray]:
    """Placements to try: what gains most first, then what could carry or lead to a gain."""
    graph = simulator.observe(state)
    placements = distinct_placements(graph, simulator.action_spec)
    outcomes = simulator.outcomes(state, graph, placements, without_arm=True)
    gains = outcomes.valid & (outcomes.reward > 0)
    cost = np.where(gains, -outcomes.gain, placement_cost(simulator, state, placements, 0))[0]
    cost[~outcomes.valid[0]] = np.inf
    actions = placements.action[0] - node_offset(graph)
    order = [n for n in np.argsort(cost, kind="stable").tolist() if np.isfinite(cost[n])]
    task = simulator.task
    return [actions[n] for n in order if placement_key(task, state, actions[n]) not in avoid]


def _filled(state: State) -> frozenset[tuple[int, ...]]:
    """The set of filled cells: two orders of the same structure are one."""
    placed = np.round(state.position[0, : state.num_placed[0]] / HALF).astype(int)
    return frozenset(map(tuple, placed.tolist()))
