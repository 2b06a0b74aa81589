"""A build that an arm carries out: attempt by attempt, and anew from what really happened."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from learn2assemble.networks.agent import Agent
from learn2assemble.physics.equilibrium import stability_margin
from learn2assemble.planning.planner import (
    STAGES,
    Attempt,
    Progress,
    Sequence,
    plan_sequences,
)
from learn2assemble.planning.problem import Problem
from learn2assemble.planning.reality import RealCell, replan_from
from learn2assemble.planning.sequence import Placement, make, replay
from learn2assemble.planning.verify import VerifiedStep
from learn2assemble.robot.dynamic import DynamicCell
from learn2assemble.robot.grasps import get_grasps
from learn2assemble.robot.judge import ArmPhysics
from learn2assemble.robot.kinematic import KinematicCell
from learn2assemble.simulator import Simulator
from learn2assemble.world.state import State

MAX_REPLANS = 12
"""Failures after which a build is given up."""


@dataclass
class _Done:
    """A placement whose block stands where it should."""

    attempt: int
    """Number of the attempt, from 1."""
    reference: int
    """Number of the block it was placed against."""
    step: VerifiedStep


class ArmBuild:
    """A build that goes on.

    Args:
        problem: before the first attempt.
        cell: carries the plans out.
    """

    def __init__(self, problem: Problem, cell: DynamicCell) -> None:
        self.start, self.problem = problem, problem
        self.real = RealCell(cell, problem.state)
        self.kinematic = KinematicCell(cell.arm, int(problem.state.num_blocks[0]))
        self.physics = ArmPhysics(self.real, get_grasps(problem.task.grasps))
        self.simulator = Simulator(problem.task, self.physics)
        self.plans: list[Sequence] = []
        self.said: list[Attempt] = []
        self.done: list[_Done] = []
        self.filled = False

    def carry_out(self, agent: Agent, seed: int, seconds: float, progress: Progress) -> None:
        """Plan and act until the target is filled or no plan leads any further."""
        for replans in range(MAX_REPLANS + 1):
            plan = _plan(self.problem, agent, seed, seconds, progress)
            self.plans.append(plan)
            self.said += plan.attempts
            if replans and plan.placements:
                self.real.log.replanned()
            as_planned = self._follow(plan, progress)
            left = self.problem.state.num_unplaced[0] > 0 and plan.placements
            if self.filled or not left or (as_planned and not plan.success):
                return

    def _follow(self, plan: Sequence, progress: Progress) -> bool:
        """Attempt by attempt, until the target is filled or something else happens than planned.

        Returns:
            whether every placement went as planned.
        """
        state = self.problem.state.copy()
        for number, placement in enumerate(plan.placements, 1):
            before, action = state.copy(), _action(state, placement)
            _, held = make(self.simulator, state, placement)
            outcome = self.real.log.steps[-1].outcome.label
            progress(f"block {number} of {len(plan.placements)}: {outcome}")
            if held:
                # Reality may show less than a plan has counted on: the world goes on then.
                state.terminated[0] = False
                self.problem = replace(self.problem, state=state)
            else:
                self._recover(before, action)
            self._note(placement, int(before.object_id[0, placement.reference]))
            self.filled = self.problem.accepts(self.problem.state)
            if self.filled or not held:
                return held
        return True

    def _recover(self, before: State, action: np.ndarray) -> None:
        """What is left is the problem now."""
        step, target = self.real.log.steps[-1], self.problem.target(before, action)
        what = f"attempt {step.number}: {step.outcome.label}"
        self.said.append(Attempt(what, step.detail or "failed", 0.0))
        self.problem = replan_from(
            self.problem, before, target, action, self.real.poses, self.kinematic
        )

    def _note(self, placement: Placement, reference: int) -> None:
        """Keep what stands; after a failure, too, where the block is where it should be."""
        state = self.problem.state
        standing = set(state.object_id[0, : state.num_placed[0]].tolist())
        self.done = [item for item in self.done if item.step.placement.block in standing]
        if placement.block in standing:
            step = _verified(self.problem, state, placement)
            self.done.append(_Done(len(self.real.log.steps), reference, step))

    def steps(self) -> list[VerifiedStep]:
        """The steps that were not undone, referring to one another by number."""
        known = {int(self.start.state.object_id[0, 0]): 0}
        out = []
        for number, item in enumerate(self.done, 1):
            placement = item.step.placement
            # A block that fell and is part of the structure all the same has no step of its own.
            reference = known.get(item.reference, number - 1)
            out.append(replace(item.step, placement=replace(placement, reference=reference)))
            known[placement.block] = number
        return out

    def step_numbers(self) -> list[int | None]:
        """For every attempt the step it made, if it still stands."""
        numbers = {item.attempt: number for number, item in enumerate(self.done, 1)}
        return [numbers.get(step.number) for step in self.real.log.steps]

    def summary(self, steps: list[VerifiedStep]) -> Sequence:
        """All plans as one; what it needed is the widest search that any of them did."""
        placements = [step.placement for step in steps]
        if not self.plans:
            return Sequence(placements, False, "none: refused before planning", 0)
        widest = max(self.plans, key=lambda plan: STAGES.index(plan.stage))
        return Sequence(
            placements, self.filled, widest.stage, widest.budget, self.said,
            sum(plan.backtracks for plan in self.plans), sum(plan.dropped for plan in self.plans),
        )  # fmt: skip


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
