"""Agreement of the kinematic cell with the dynamic one: the same moves in the same scenes."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from learn2assemble.checkers import resolve_checker
from learn2assemble.learning.run import provenance
from learn2assemble.networks.agent import Agent
from learn2assemble.physics.static import StaticPhysics
from learn2assemble.planning.world_model import WorldModel
from learn2assemble.robot.checker import ArmPhysics
from learn2assemble.robot.moves import Attempt
from learn2assemble.simulator import Simulator
from learn2assemble.tasks import Task
from learn2assemble.world.state import State

EPSILON = 0.3
"""Share of random steps in the builds the moves are drawn from, so that states differ."""
STREAM = 5
"""First word of the seeds: neither training's nor evaluation's stream."""


@dataclass
class Comparison:
    """Moves that balance allows, tried in both cells."""

    task: str
    arm: str
    agent: str
    seed: int
    actions: int = 0
    agree: int = 0
    """Both reach the target, or neither does."""
    same_outcome: int = 0
    outcomes: Counter[tuple[str, str]] = field(default_factory=Counter[tuple[str, str]])
    """Kinematic and dynamic outcome, by name."""
    kinematic_seconds: float = 0.0
    dynamic_seconds: float = 0.0
    disagreements: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])

    @property
    def share(self) -> float:
        return self.agree / self.actions if self.actions else float("nan")

    @property
    def faster(self) -> float:
        """How many times faster the kinematic cell is."""
        return self.dynamic_seconds / max(self.kinematic_seconds, 1e-9)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, with what it was measured on."""
        return {
            "task": self.task, "arm": self.arm, "agent": self.agent, "seed": self.seed,
            "actions": self.actions, "agree": self.agree, "share": round(self.share, 4),
            "same_outcome": self.same_outcome,
            "outcomes": {f"{a} / {b}": n for (a, b), n in sorted(self.outcomes.items())},
            "kinematic_ms": round(1000 * self.kinematic_seconds / max(self.actions, 1), 3),
            "dynamic_ms": round(1000 * self.dynamic_seconds / max(self.actions, 1), 1),
            "times_faster": round(self.faster, 1), "disagreements": self.disagreements,
            **provenance("cpu"),
        }  # fmt: skip


def compare(
    task: Task,
    agent: Agent,
    actions: int,
    seed: int = 0,
    progress: Callable[[int], object] = lambda done: None,
) -> Comparison:
    """Try random moves from builds in both cells.

    An agent builds with the arm, a share of its steps at random. In every state one placement that
    physics holds is drawn and tried in both cells, from the same scene; the build goes on with the
    agent's own step.

    Args:
        task: one with an arm.
        actions: how many moves.
        progress: told how many have been compared.
    """
    rng = np.random.default_rng([STREAM, seed])
    real, without_arm = Simulator(task), Simulator(task.replace(arm="none"))
    model, static = WorldModel(real, agent.network), StaticPhysics()
    cells = [_arm(task, name) for name in ("kinematic", "dynamic")]
    found = Comparison(task.name, task.arm, agent.name, seed)
    while found.actions < actions:
        state = real.new(1, rng)
        while not state.terminated[0] and found.actions < actions:
            action = _held(without_arm, static, model, state, rng)
            if action is not None:
                _try_both(found, cells, without_arm, state, action)
                progress(found.actions)
            best = model.best(state)[1] if rng.random() > EPSILON else None
            real.step(state, model.random_actions(state, rng) if best is None else best)
    return found


def _arm(task: Task, name: str) -> ArmPhysics:
    checker = resolve_checker(name, task)
    assert isinstance(checker, ArmPhysics)
    return checker


def _held(
    without_arm: Simulator, static: StaticPhysics, model: WorldModel, state: State,
    rng: np.random.Generator, tries: int = 200,
) -> np.ndarray | None:  # fmt: skip
    """A random action int64[1, 3] that physics holds; None where none is found."""
    for _ in range(tries):
        action = model.random_actions(state, rng)
        if without_arm.step(state.copy(), action).verdict[0] == 0:
            return action
    return None


def _try_both(
    found: Comparison,
    cells: list[ArmPhysics],
    without_arm: Simulator,
    state: State,
    action: np.ndarray,
) -> None:
    attempts: list[Attempt] = []
    seconds: list[float] = []
    row = np.zeros(1, np.int64)
    for checker in cells:
        after = state.copy()
        checker.prepare(after, row, action)
        without_arm.step(after, action)
        scene, move = checker.order(after, row, 0)
        started = time.perf_counter()
        attempts.append(checker.cell.attempt(scene, move))
        seconds.append(time.perf_counter() - started)
    first, second = attempts
    found.actions += 1
    if found.actions > 1:  # the first one compiles
        found.kinematic_seconds += seconds[0]
        found.dynamic_seconds += seconds[1]
    agree = first.reached == second.reached
    found.agree += agree
    found.same_outcome += first.outcome == second.outcome
    found.outcomes[first.outcome.label, second.outcome.label] += 1
    if not agree:
        found.disagreements.append({
            "kinematic": f"{first.outcome.label}: {first.detail}",
            "dynamic": f"{second.outcome.label}: {second.detail}",
        })  # fmt: skip
