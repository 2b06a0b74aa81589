"""Proving a plan step by step by rigid-body simulation, and its margin of stability."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from learn2assemble.networks.agent import Agent
from learn2assemble.physics.equilibrium import stability_margin
from learn2assemble.physics.rigid import SETTLE_STEPS, RigidPhysics
from learn2assemble.planning.discover import Placement, Sequence, make
from learn2assemble.planning.plan import (
    BlockSupply,
    FirstBlock,
    Plan,
    PlanDesign,
    PlanElevation,
    SearchReport,
    SearchStage,
    Step,
)
from learn2assemble.planning.problem import Problem
from learn2assemble.simulator import Simulator
from learn2assemble.world.blocks import EDGE, RELATIONS


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


def make_plan(
    problem: Problem,
    agent: Agent,
    source: str,
    sequence: Sequence,
    proof: Proof,
    started: float,
    verified_by: str | None = None,
) -> Plan:
    """What came of planning.

    Args:
        proof: its steps refer to one another by number, 0 is the first block.
        started: :func:`time.perf_counter` when planning began.
        verified_by: by default :func:`method`.
    """
    state, task = problem.state, problem.task
    count = int(state.num_blocks[0])
    waiting = np.empty((count, 3))
    waiting[state.object_id[0, :count]] = state.position[0, :count]
    held = [step for step in proof.steps if step.stable]
    status = "complete" if proof.stable and proof.filled else "incomplete"
    if problem.refusal is not None:
        status = "refused"
    coverage = held[-1].coverage if held else 0.0
    return Plan(
        design=PlanDesign(
            name=problem.name,
            source=source,
            block_edge=EDGE,
            num_sides=task.num_sides,
            frames=_rows(problem.frames),
            elevations=tuple(
                PlanElevation(name, _rows(outline))
                for name, outline in zip(problem.elevation_names, problem.outlines, strict=True)
            ),
            success_threshold=task.success_threshold,
        ),
        status=status,
        reason=_reason(problem, status, proof, coverage, count),
        blocks=BlockSupply(count, len(held) + 1, _rows(waiting)),
        steps=tuple(
            _step(number, step, task.rotations) for number, step in enumerate(proof.steps, 1)
        ),
        coverage=coverage,
        seconds=round(time.perf_counter() - started, 3),
        agent=agent.name,
        planner="agent",
        search=SearchReport(
            sequence.stage, sequence.budget,
            tuple(SearchStage(a.stage, a.result, round(a.seconds, 3)) for a in sequence.attempts),
            sequence.backtracks, sequence.dropped,
        ),
        first_block=FirstBlock(
            0, _row(state.position[0, 0]), _row(state.quaternion[0, 0]),
            round(float(state.complete_coverage[0]), 6), round(float(state.plane_coverage[0]), 6),
        ),
        verified_by=verified_by or method(),
    )  # fmt: skip


def _row(values: np.ndarray) -> Any:
    """An array[n] as n numbers."""
    return tuple(values.tolist())


def _rows(values: np.ndarray) -> Any:
    return tuple(map(_row, values))


def _step(number: int, step: VerifiedStep, rotations: int) -> Step:
    return Step(
        number, step.placement.block, _row(np.round(step.position, 6)),
        _row(np.round(step.quaternion, 6)),
        reference=step.placement.reference,
        relation=RELATIONS[step.placement.action // rotations],
        coverage=round(step.coverage, 6),
        plane_coverage=round(step.plane_coverage, 6),
        margin_g=round(step.stability_margin, 4),
        proof="rigid",
        speed_sum=round(step.speed_sum, 6) if math.isfinite(step.speed_sum) else None,
        stable=step.stable,
        outside=step.outside,
    )  # fmt: skip


def _reason(
    problem: Problem, status: str, proof: Proof, coverage: float, available: int
) -> str | None:
    """What is missing, in one sentence."""
    if status == "complete":
        return None
    if problem.refusal is not None:
        return problem.refusal
    threshold = problem.task.success_threshold
    text = f"filled {coverage:.1%} of the target, more than {threshold:.1%} is needed"
    if not proof.stable:
        return f"step {len(proof.steps)} does not hold in rigid-body simulation; {text}"
    if len(proof.steps) + 1 >= available:
        text += f"; all {available} blocks are used"
    return text
