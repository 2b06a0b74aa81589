"""Agreement of the kinematic cell with the dynamic one: the same moves in the same scenes."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.robot.moves import Attempt
from learn2assemble.tasks.checkers import ArmPhysics, resolve_checker
from learn2assemble.tasks.learning.run import provenance
from learn2assemble.tasks.networks.agent import Agent
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import Task
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import WorldModel

EPSILON = 0.3
"""Share of random steps in the builds the moves are drawn from, so that states differ."""
STREAM = 5
"""First word of the seeds: neither training's nor evaluation's stream."""
TRIES = 200
"""Random actions looked at for one that physics holds."""


class Trial(NamedTuple):
    """One move in both cells: what became of it, and how long it took [s]."""

    kinematic: Attempt
    dynamic: Attempt
    seconds: tuple[float, float]

    @property
    def agrees(self) -> bool:
        """Both reach the target, or neither does."""
        return self.kinematic.reached == self.dynamic.reached


@dataclass
class Comparison:
    """Moves that balance allows, tried in both cells."""

    task: str
    arm: str
    agent: str
    seed: int
    trials: list[Trial] = field(default_factory=list[Trial])

    @property
    def outcomes(self) -> Counter[tuple[str, str]]:
        """How often what came of a move in the kinematic cell and in the dynamic one, by name."""
        return Counter((t.kinematic.outcome.label, t.dynamic.outcome.label) for t in self.trials)

    @property
    def share(self) -> float:
        """Share of the moves that agree."""
        return float(np.mean([trial.agrees for trial in self.trials]))

    def to_dict(self) -> dict[str, Any]:
        """Plain data, with what it was measured on."""
        count = len(self.trials)
        # The first one compiles.
        kinematic, dynamic = np.array([trial.seconds for trial in self.trials])[1:].sum(0).tolist()
        return {
            "task": self.task,
            "arm": self.arm,
            "agent": self.agent,
            "seed": self.seed,
            "actions": count,
            "agree": sum(trial.agrees for trial in self.trials),
            "share": round(self.share, 4),
            "same_outcome": sum(t.kinematic.outcome == t.dynamic.outcome for t in self.trials),
            "outcomes": {f"{a} / {b}": n for (a, b), n in sorted(self.outcomes.items())},
            "kinematic_ms": round(1000 * kinematic / count, 3),
            "dynamic_ms": round(1000 * dynamic / count, 1),
            "times_faster": round(dynamic / max(kinematic, 1e-9), 1),
            "disagreements": [
                {
                    "kinematic": f"{one.outcome.label}: {one.detail}",
                    "dynamic": f"{two.outcome.label}: {two.detail}",
                }
                for one, two, _ in self.trials
                if one.reached != two.reached
            ],
            **provenance("cpu"),
        }


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
    model = WorldModel(real, agent.network)
    cells = [_arm(task, name) for name in ("kinematic", "dynamic")]
    found = Comparison(task.name, task.arm, agent.name, seed)
    while len(found.trials) < actions:
        state = real.new(1, rng)
        while not state.terminated[0] and len(found.trials) < actions:
            action = _held(without_arm, model, state, rng)
            if action is not None:
                found.trials.append(_try_both(cells, without_arm, state, action))
                progress(len(found.trials))
            best = model.best(state)[1] if rng.random() > EPSILON else None
            real.step(state, model.random_actions(state, rng) if best is None else best)
    return found


def _arm(task: Task, name: str) -> ArmPhysics:
    checker = resolve_checker(name, task)
    assert isinstance(checker, ArmPhysics)
    return checker


def _held(
    without_arm: Simulator, model: WorldModel, state: State, rng: np.random.Generator
) -> np.ndarray | None:
    """A random action int64[1, 3] that physics holds; None where none is found."""
    for _ in range(TRIES):
        action = model.random_actions(state, rng)
        if without_arm.step(state.copy(), action).verdict[0] == 0:
            return action
    return None


def _try_both(
    cells: list[ArmPhysics], without_arm: Simulator, state: State, action: np.ndarray
) -> Trial:
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
    return Trial(attempts[0], attempts[1], (seconds[0], seconds[1]))
