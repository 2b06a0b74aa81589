"""Whole evaluation episodes and the paper's metrics."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from learn2assemble.errors import InputError, check_arguments, is_number, is_whole
from learn2assemble.registry import Registry, add_plugin
from learn2assemble.tasks.checkers import resolve_checker
from learn2assemble.tasks.learning.run import provenance
from learn2assemble.tasks.networks.agent import (
    Agent,
    Network,
    default_agent,
    load_agent,
    one_thread,
)
from learn2assemble.tasks.physics.protocol import Physics, PlacementVerdict
from learn2assemble.tasks.search.config import SEARCHES, SearchConfig
from learn2assemble.tasks.search.mcts import search
from learn2assemble.tasks.search.tree import SearchModel
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import Task, get_task
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import WorldModel, lookahead_actions

EVALUATION_STREAM = 2
"""First word of every evaluation seed; training uses another (``trainer.TRAINING_STREAM``)."""
BATCH = 50
"""Episodes played side by side."""
DISCOUNTS = (0.8, 0.95)
"""Returns are also counted at these: the published code's discount and the paper's."""


@runtime_checkable
class Player(Protocol):
    """What is no agent of the paper and plays tasks all the same."""

    @property
    def name(self) -> str: ...

    def world_model(self, simulator: Simulator) -> WorldModel:
        """The model that a search or a greedy policy asks.

        Raises:
            InputError: for a task that it cannot play.
        """
        ...


class PlayerKind(Protocol):
    """A kind of players that have names or files."""

    def knows(self, name_or_path: str) -> bool: ...

    def load(self, name_or_path: str | Path) -> Player: ...


PLAYERS: Registry[PlayerKind] = Registry("player", {})
"""Kinds of players by name; the laboratory adds its own where it is installed."""
add_plugin("l2a_lab.builder", "player", optional=True)
Policy = Callable[[State, np.random.Generator], np.ndarray]
"""Actions int64[B, 3] (local indices) for every row of a state."""


class Episodes(NamedTuple):
    """What happened in each of E whole episodes."""

    returns: np.ndarray
    """float64[E]: discounted with the task's gamma."""
    returns_at: np.ndarray
    """float64[E, 2]: discounted with each of ``DISCOUNTS``."""
    actions: np.ndarray
    """int64[E]: number of actions."""
    failed: np.ndarray
    """bool[E]: ended by an invalid action."""
    success: np.ndarray
    """bool[E]."""
    coverage: np.ndarray
    """float64[E]: final F_co."""
    verdict: np.ndarray
    """int8[E] of :class:`PlacementVerdict`, on the last action."""


@dataclass(frozen=True)
class Metrics:
    """Means over episodes."""

    R: float
    R_ci95: float
    """Half width of the 95 % interval of R; not a number for one episode."""
    a: float
    """Actions an episode."""
    f: float
    """Share of episodes ended by an invalid action."""
    b: float
    """Share that ran out of blocks without success."""
    success: float
    coverage: float
    """Mean final F_co."""
    episodes: int
    seconds: float
    physics: str
    failures: dict[str, int]
    """How often each verdict ended an episode; empty without failures."""

    def to_dict(self) -> dict[str, Any]:
        """The content of a result file; what is not a number is None."""
        interval = None if math.isnan(self.R_ci95) else self.R_ci95
        return {**asdict(self), "R_ci95": interval}


def sometimes_random(
    choose: Callable[[State], np.ndarray], num_actions: int, epsilon: float
) -> Policy:
    """What ``choose`` chooses, int64[B, 3], with a uniform legal action in every row at the rate
    ``epsilon``."""

    def act(state: State, rng: np.random.Generator) -> np.ndarray:
        actions = choose(state)
        for row in np.flatnonzero(rng.random(len(actions)) < epsilon):
            shape = (state.num_unplaced[row], state.num_placed[row], num_actions)
            actions[row] = [int(rng.integers(n)) for n in shape]
        return actions

    return act


def greedy_policy(model: WorldModel, epsilon: float, num_actions: int = 5) -> Policy:
    """The Q-policy (the paper's DQN)."""
    return sometimes_random(lambda state: model.best(state)[1], num_actions, epsilon)


def lookahead_policy(task: Task, epsilon: float) -> Policy:
    """The exact one-step look-ahead."""
    return sometimes_random(partial(lookahead_actions, Simulator(task)), task.num_actions, epsilon)


def random_policy(num_actions: int) -> Policy:
    """A uniform legal action always."""
    return sometimes_random(
        lambda state: np.zeros((state.batch_size, 3), np.int64), num_actions, 1.0
    )


def search_policy(model: SearchModel, config: SearchConfig) -> Policy:
    """A search before every action."""

    def act(state: State, rng: np.random.Generator) -> np.ndarray:
        return np.stack([decision.action for decision in search(model, state, config, rng)])

    return act


def load_player(name_or_path: str | Path) -> Agent | Player:
    """An agent of the paper's kind or another player, by name or file."""
    for kind in PLAYERS.values():
        if kind.knows(str(name_or_path)):
            return kind.load(name_or_path)
    return load_agent(name_or_path)


def make_policy(
    task: Task,
    player: Network | Player,
    config: SearchConfig | None,
    epsilon: float,
    *,
    search_model: Callable[[WorldModel], SearchModel] | None = None,
    look_ahead: str | Physics | None = None,
) -> Policy:
    """The policy of a network or another player: plain Q without ``config``, with search otherwise.

    The search looks ahead with static physics, whatever judges the episode, or with
    ``look_ahead``. ``search_model`` may put another model of the world around the exact one.
    """
    copies = Simulator(task, look_ahead)
    model = player.world_model(copies) if isinstance(player, Player) else WorldModel(copies, player)
    if config is None or config.budget == 0:
        return greedy_policy(model, epsilon, task.num_actions)
    return search_policy(search_model(model) if search_model else model, config)


def episode_generators(
    seed: int, first: int = 0
) -> tuple[np.random.Generator, np.random.Generator]:
    """Generators of the problems and of the policy of an evaluation from problem ``first`` on.

    Those of the problems do not depend on ``first``: the ones before it are to be drawn, too.
    """
    words = [EVALUATION_STREAM, seed]
    problems, policy = (np.random.default_rng(s) for s in np.random.SeedSequence(words).spawn(2))
    if first:
        policy = np.random.default_rng(np.random.SeedSequence([*words, first]))
    return problems, policy


def run_episodes(
    task: Task,
    policy: Policy,
    episodes: int,
    seed: int,
    physics: Physics | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> Metrics:
    """Play ``episodes`` fresh problems of ``task`` to their end; means over them.

    Args:
        seed: of problems and policy; the same seed gives the same problems to every policy.
        physics: the judge of the episodes; static by default.
        progress: called with the number of episodes finished.
    """
    started = time.perf_counter()
    simulator = Simulator(task, physics)
    played = play_episodes(simulator, policy, episodes, seed, progress)
    spread = float(played.returns.std(ddof=1)) if episodes > 1 else math.nan
    return Metrics(
        R=float(played.returns.mean()),
        R_ci95=1.96 * spread / math.sqrt(episodes),
        a=float(played.actions.mean()),
        f=float(played.failed.mean()),
        b=float((~played.failed & ~played.success).mean()),
        success=float(played.success.mean()),
        coverage=float(played.coverage.mean()),
        episodes=episodes,
        seconds=time.perf_counter() - started,
        physics=simulator.physics.name,
        failures={
            PlacementVerdict(number).name.lower().replace("_", "-"): int(count)
            for number, count in zip(*np.unique(played.verdict, return_counts=True), strict=True)
            if number != PlacementVerdict.STABLE
        },
    )


def play_episodes(
    simulator: Simulator,
    policy: Policy,
    episodes: int,
    seed: int,
    progress: Callable[[int], None] = lambda done: None,
    first: int = 0,
) -> Episodes:
    """Play ``episodes`` fresh problems to their end, the first ``first`` of the seed left out;
    other arguments as in :func:`run_episodes`."""
    problem_rng, policy_rng = episode_generators(seed, first)
    if first:
        simulator.new(first, problem_rng)
    parts: list[Episodes] = []
    for start in range(0, episodes, BATCH):
        state = simulator.new(min(BATCH, episodes - start), problem_rng)
        parts.append(_play(simulator, state, policy, policy_rng))
        progress(start + state.batch_size)
    return Episodes(*[np.concatenate(column) for column in zip(*parts, strict=True)])


def _play(simulator: Simulator, state: State, policy: Policy, rng: np.random.Generator) -> Episodes:
    """Every row of ``state`` to its end."""
    batch, gammas = state.batch_size, np.array([simulator.task.discount, *DISCOUNTS])
    found = Episodes(
        np.zeros(batch),
        np.zeros((batch, len(gammas))),
        np.zeros(batch, np.int64),
        np.zeros(batch, np.bool_),
        np.zeros(batch, np.bool_),
        np.zeros(batch),
        np.zeros(batch, np.int8),
    )
    rows, discount = np.arange(batch), np.ones(len(gammas))
    while len(rows):
        step = simulator.step(state, policy(state, rng))
        found.returns_at[rows] += discount * step.reward[:, None]
        discount = discount * gammas
        found.actions[rows] += 1
        found.failed[rows] = step.verdict != 0
        found.verdict[rows] = step.verdict
        found.success[rows] = step.success
        found.coverage[rows] = state.complete_coverage
        going = np.flatnonzero(~step.terminated)
        rows, state = rows[going], state.take(going)
    returns = found.returns_at
    return found._replace(returns=returns[:, 0], returns_at=returns[:, 1:])


SEARCH_MODELS: Registry[Callable[[WorldModel], SearchModel]] = Registry("search model", {})
"""Models of the world that may be put around the exact one, for searches."""


@dataclass(frozen=True)
class Evaluation:
    """What an agent achieved, and under which conditions."""

    metrics: Metrics
    task: str
    agent: str
    search: str
    budget: int
    """Simulations before every decision; 0 without a search."""
    rollout: int
    distinct: bool
    legacy: bool
    """Whether the search looked ahead in copies with the published restore faults."""
    look_ahead: str
    """What checked the placements that the search tried; empty without a search."""
    epsilon: float
    seed: int
    provenance: dict[str, Any]
    """Versions, hardware and commit."""

    def to_dict(self) -> dict[str, Any]:
        """The content of a result file."""
        values = asdict(self)
        del values["metrics"]
        return {**self.metrics.to_dict(), **values}


def search_config(
    search: str | SearchConfig | None, **given: float | bool | None
) -> SearchConfig | None:
    """The named search with what is given in place of its own arguments; None for ``none``.

    Raises:
        InputError: for arguments of a search without one, and a search without simulations.
    """
    chosen = {name: value for name, value in given.items() if value is not None}
    if search is None or search == "none":
        for name, value in chosen.items():
            if value:
                raise InputError(name, value, "a search beside it")
        return None
    if isinstance(search, str):
        search = SEARCHES[search]
    if not isinstance(search, SearchConfig):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise InputError("search", search, "a name or a SearchConfig")
    if chosen.get("budget") == 0:
        raise InputError("budget", 0, "at least 1 simulation, or no search")
    return replace(search, **chosen)


def evaluate(
    task: str | Task,
    *,
    agent: str | Path | Agent | Player | None = None,
    search: str | SearchConfig | None = None,
    budget: int | None = None,
    rollout: int | None = None,
    distinct: bool | None = None,
    epsilon: float | None = None,
    episodes: int = 100,
    seed: int = 0,
    physics: str | Physics | None = None,
    arm: str | None = None,
    search_model: Callable[[WorldModel], SearchModel] | None = None,
    look_ahead: str | Physics | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> Evaluation:
    """Let an agent play whole episodes; the paper's metrics.

    Args:
        task: a task or its name.
        agent: an agent, a shipped one by name, a ``.safetensors`` file or the folder of a training;
            by default the shipped one for tasks like this. A builder of designs plays with
            outcomes from the exact model, where the laboratory is installed.
        search: its name, ``mcts`` for the paper's, or its arguments; by default none.
        budget: simulations before every decision, in place of the search's own.
        rollout: steps of a simulation, in place of the search's own.
        distinct: whether to expand only one of several placements that lead to the same structure,
            in place of the search's own.
        epsilon: how often a random action is taken; by default the search's own, without a search
            that of the paper's, 0.05.
        episodes: how many.
        seed: of problems and policy; the same seed gives the same problems to every agent.
        physics: checks the placements: ``static``, ``rigid`` or, with an arm, ``kinematic``,
            ``dynamic`` or ``published``.
        arm: builds in place of the task's own, for tasks with a robot.
        search_model: puts another model of the world around the exact one, for searches.
        look_ahead: checks the placements that a search tries, as ``physics`` does those that are
            made; by default the task's own, static physics or the kinematic workcell.
        progress: called with the number of episodes finished.

    Raises:
        InputError: for names that do not exist and numbers out of range.
    """
    check_arguments(
        {"episodes": episodes, "seed": seed, "epsilon": epsilon, "progress": progress},
        ("episodes", is_whole(episodes, 1, 10**9), "a whole number from 1 to 1000000000"),
        ("seed", is_whole(seed, 0), "a whole number of at least 0"),
        ("epsilon", epsilon is None or is_number(epsilon, 0, 1), "0 <= epsilon <= 1"),
        ("progress", callable(progress), "a function of a whole number"),
    )
    task = get_task(task, arm)
    checker = resolve_checker(physics, task)
    config = search_config(search, budget=budget, rollout=rollout, distinct=distinct)
    if config is None and search_model is not None:
        raise InputError("search_model", search_model, "a search beside it")
    if config is None and look_ahead is not None:
        raise InputError("look_ahead", look_ahead, "a search beside it")
    ahead = resolve_checker(look_ahead, task)
    if config is not None and epsilon is not None:
        config = replace(config, epsilon=epsilon)
    elif epsilon is None:
        epsilon = (config or SearchConfig()).epsilon
    if agent is None:
        agent = default_agent(task.name)
    if isinstance(agent, str | Path):
        agent = load_player(agent)
    if not isinstance(agent, Agent | Player):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise InputError("agent", agent, "an agent, its name or its file")
    with one_thread():
        player = agent.network if isinstance(agent, Agent) else agent
        policy = make_policy(
            task, player, config, epsilon, search_model=search_model, look_ahead=ahead
        )
        metrics = run_episodes(task, policy, episodes, seed, checker, progress)
        return Evaluation(
            metrics=metrics,
            task=task.name,
            agent=agent.name,
            search=search if isinstance(search, str) else "custom" if config else "none",
            budget=config.budget if config else 0,
            rollout=config.rollout if config else 0,
            distinct=bool(config and config.distinct),
            legacy=search_model is not None and search_model is SEARCH_MODELS.get("published"),
            look_ahead=ahead.name if config else "",
            epsilon=epsilon,
            seed=seed,
            provenance=provenance("cpu"),
        )
