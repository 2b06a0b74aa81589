"""Proving a plan step by step by rigid-body simulation, and its margin of stability."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from learn2assemble.physics.equilibrium import stability_margin
from learn2assemble.physics.rigid import SETTLE_STEPS, RigidPhysics
from learn2assemble.planning.problem import Problem
from learn2assemble.planning.sequence import Placement, make
from learn2assemble.simulator import Simulator


@dataclass(frozen=True)
class VerifiedStep:
    """One placement as the simulation left it."""

    placement: Placement
    position: np.ndarray
    """float64[3]: block centre after settling [m]."""
    quaternion: np.ndarray
    """float64[4]: (w, x, y, z)."""
    coverage: float
    """F_co."""
    plane_coverage: float
    """F_pl."""
    stability_margin: float
    """Smallest horizontal acceleration, in g, that would move something."""
    speed_sum: float
    """V_b of the fastest block, see :class:`RigidPhysics` [m/s]."""
    stable: bool
    outside: bool
    """Whether the block stands outside every outline."""


@dataclass(frozen=True)
class Proof:
    """The verified steps, up to the first that did not hold."""

    steps: list[VerifiedStep]
    filled: bool
    """Whether the target counts as filled after the last step."""

    @property
    def stable(self) -> bool:
        return all(step.stable for step in self.steps)


def method() -> str:
    """One line on how steps are verified."""
    return f"MuJoCo {mujoco.__version__}, {SETTLE_STEPS} steps of 4 ms after every placement"


def verify(problem: Problem, placements: list[Placement]) -> Proof:
    """Make every placement in rigid-body simulation, on what the ones before have become."""
    physics = RigidPhysics(problem.task.stability, pitch=problem.task.pitch)
    simulator = Simulator(problem.task, physics)
    state = problem.state.copy()
    steps: list[VerifiedStep] = []
    filled = False
    for placement in placements:
        filled, held = make(simulator, state, placement)
        filled = filled and problem.accepts(state)
        count = int(state.num_placed[0])
        speeds = physics.last_speed_sums[0]
        centres = state.position[0, :count]
        steps.append(
            VerifiedStep(
                placement=placement,
                position=centres[-1].copy(),
                quaternion=state.quaternion[0, count - 1].copy(),
                coverage=float(state.complete_coverage[0]),
                plane_coverage=float(state.plane_coverage[0]),
                stability_margin=stability_margin(centres, state.object_id[0, :count])
                if held
                else 0.0,
                speed_sum=float(speeds.max()) if len(speeds) else float("inf"),
                stable=held,
                outside=problem.is_outside(centres[-1]),
            )
        )
        if not held:
            break
    return Proof(steps, filled)
