"""The main job with an arm: plan on the kinematic cell, carry out on the dynamic one, replan from
what really happened."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from learn2assemble.networks.agent import Agent
from learn2assemble.physics.equilibrium import stability_margin
from learn2assemble.planning.planner import Attempt, Progress, Sequence, plan_sequences
from learn2assemble.planning.problem import Problem
from learn2assemble.planning.reality import RealCell, replan_from
from learn2assemble.planning.report import report
from learn2assemble.planning.sequence import Placement, make, replay
from learn2assemble.planning.verify import Proof, VerifiedStep
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.dynamic import DynamicCell
from learn2assemble.robot.grasps import get_grasps
from learn2assemble.robot.judge import ArmPhysics
from learn2assemble.robot.kinematic import KinematicCell
from learn2assemble.robot.outcome import Outcome
from learn2assemble.robot.record import BuildRecord
from learn2assemble.simulator import Simulator
from learn2assemble.world.state import State

MAX_REPLANS = 12
"""Failures after which a build is given up."""
CLOSING = ("along x", "along y")
"""The axis on which the fingers close, in words."""


@dataclass
class _Done:
    """A placement whose block stands where it should."""

    attempt: int
    """Number of the attempt, from 0."""
    reference: int
    """Number of the block it was placed against."""
    step: VerifiedStep


def real_cell(arm: Arm) -> DynamicCell:
    """The cell builds are carried out in."""
    return DynamicCell(arm, recover=True)


def method() -> str:
    """One line on how steps are verified."""
    return f"MuJoCo {mujoco.__version__}, arm and blocks simulated together, grasps by friction"


def build_with_arm(
    problem: Problem,
    agent: Agent,
    source: str,
    cell: DynamicCell,
    *,
    seed: int = 0,
    seconds: float = 20.0,
    progress: Progress = lambda text: None,
) -> tuple[dict[str, Any], BuildRecord]:
    """Build with an arm; the content of ``plan.json`` and what the arm did.

    Every step is an attempt of the cell. After one that fails, the rest is planned anew from where
    arm and blocks really are, without the placement that failed.

    Args:
        problem: its blocks wait where the arm can take them, see :mod:`~.site`.
        source: where the problem comes from, for the report.
        cell: carries the plan out.
        seconds: limit of the last, widest search of each plan.
        progress: told what is going on.
    """
    started = time.perf_counter()
    start, real = problem, RealCell(cell, problem.state)
    if problem.refusal is not None:
        nothing = Sequence([], False, "none: refused before planning", 0)
        plan = report(problem, agent, source, nothing, Proof([], False), started, method())
        return plan, real.log.record()
    kinematic = KinematicCell(cell.arm, int(problem.state.num_blocks[0]))
    physics = ArmPhysics(real, get_grasps(problem.task.grasps))
    simulator = Simulator(problem.task, physics)
    said: list[Attempt] = []
    done: list[_Done] = []
    first: Sequence | None = None
    filled, dropped, backtracks = False, 0, 0
    for _ in range(MAX_REPLANS + 1):
        sequence = _plan(problem, agent, seed, seconds, progress)
        first = first or sequence
        said += sequence.attempts
        dropped, backtracks = dropped + sequence.dropped, backtracks + sequence.backtracks
        state, failed = problem.state.copy(), False
        for number, placement in enumerate(sequence.placements, 1):
            before, reference = state.copy(), int(state.object_id[0, placement.reference])
            target = problem.target(state, _action(state, placement))
            success, held = make(simulator, state, placement)
            attempt = physics.last_attempts[0]
            assert attempt is not None
            outcome = attempt.outcome.label
            progress(f"block {number} of {len(sequence.placements)}: {outcome}")
            if not held:
                what = f"attempt {len(real.log.steps)}: {outcome}"
                said.append(Attempt(what, attempt.detail or "failed", 0.0))
                problem = replan_from(
                    problem, before, target, _action(before, placement), real.poses, kinematic
                )
                standing = _placed(problem.state)
                done = [d for d in done if d.step.placement.block in standing]
                if placement.block in standing:
                    # It fell, or others moved, but it stands where it should.
                    step = _verified(problem, problem.state, placement)
                    done.append(_Done(len(real.log.steps) - 1, reference, step))
                failed = True
                break
            step = _verified(problem, state, placement)
            done.append(_Done(len(real.log.steps) - 1, reference, step))
            if success and problem.accepts(state):
                filled = True
                break
        if filled or not sequence.placements:
            break
        if not failed:
            # Everything went as planned, but reality shows less than the plan had counted on.
            problem = replace(problem, state=state)
            if not sequence.success:
                break
        real.log.replanned()
    assert first is not None
    steps = _renumber(start, done)
    real.log.number_steps(_step_numbers(len(real.log.steps), done))
    words = Sequence(
        [step.placement for step in steps], filled, first.stage, first.budget, said, backtracks,
        dropped,
    )  # fmt: skip
    plan = report(start, agent, source, words, Proof(steps, filled), started, method())
    return _with_arm(plan, start, steps, real), real.log.record()


def _plan(
    problem: Problem, agent: Agent, seed: int, seconds: float, progress: Progress
) -> Sequence:
    """The first plan that fills the target, else the one that fills most."""
    simulator = Simulator(problem.task)
    best: Sequence | None = None
    most = -1.0
    for sequence in plan_sequences(problem, agent.network, seed, seconds, progress):
        state, _, success = replay(problem, simulator, sequence.placements)
        cover = float(min(state.complete_coverage[0], state.plane_coverage[0]))
        if best is None or success or cover > most:
            best, most = sequence, cover
        best.attempts = sequence.attempts
        if success:
            break
    assert best is not None
    return best


def _action(state: State, placement: Placement) -> np.ndarray:
    waiting = state.object_id[0, state.num_placed[0] : state.num_blocks[0]]
    unplaced = int(np.flatnonzero(waiting == placement.block)[0])
    return np.array([unplaced, placement.reference, placement.action])


def _placed(state: State) -> set[int]:
    return set(state.object_id[0, : state.num_placed[0]].tolist())


def _verified(problem: Problem, state: State, placement: Placement) -> VerifiedStep:
    """The step that has just been made, as it really stands."""
    count = int(state.num_placed[0])
    centres = state.position[0, :count]
    row = int(np.flatnonzero(state.object_id[0, :count] == placement.block)[0])
    return VerifiedStep(
        placement=placement,
        position=centres[row].copy(),
        quaternion=state.quaternion[0, row].copy(),
        coverage=float(state.complete_coverage[0]),
        plane_coverage=float(state.plane_coverage[0]),
        stability_margin=stability_margin(centres, state.object_id[0, :count]),
        speed_sum=float("inf"),
        stable=True,
        outside=problem.is_outside(centres[row]),
    )


def _renumber(problem: Problem, done: list[_Done]) -> list[VerifiedStep]:
    """The steps that were not undone, referring to one another by number."""
    known = {int(problem.state.object_id[0, 0]): 0}
    out = []
    for number, item in enumerate(done, 1):
        placement = item.step.placement
        # A block that fell and is part of the structure all the same has no step of its own.
        reference = known.get(item.reference, number - 1)
        out.append(replace(item.step, placement=replace(placement, reference=reference)))
        known[placement.block] = number
    return out


def _step_numbers(attempts: int, done: list[_Done]) -> list[int | None]:
    numbers: list[int | None] = [None] * attempts
    for number, item in enumerate(done, 1):
        numbers[item.attempt] = number
    return numbers


def _with_arm(
    plan: dict[str, Any], problem: Problem, steps: list[VerifiedStep], real: RealCell
) -> dict[str, Any]:
    """The plan with what concerns the arm (``docs/plan.md``)."""
    pairs = get_grasps(problem.task.grasps)
    attempts = {s.plan_step: s.outcome for s in real.log.steps if s.plan_step is not None}
    for entry, step in zip(plan["steps"], steps, strict=True):
        pair = pairs[step.placement.action % len(pairs)]
        entry["outcome"] = attempts[entry["step"]].label
        entry["grasp"], entry["place"] = (
            CLOSING[int(abs(np.cos(attitude.yaw)) > 0.5)] for attitude in pair
        )
    plan["arm"] = {
        "name": real.cell.arm.name,
        "pitch": problem.task.pitch,
        "attempts": len(real.log.steps),
        "failures": [
            {"attempt": step.number, "outcome": step.outcome.label, "detail": step.detail,
             "replanned": step.replanned}
            for step in real.log.steps if step.outcome != Outcome.REACHED
        ],
        "seconds": round(real.log.now, 2),
    }  # fmt: skip
    return plan
