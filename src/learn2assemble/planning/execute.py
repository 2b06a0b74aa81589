"""A build as it really goes: what the arm did, where everything stands, what is left to build.

A build that an arm carries out: attempt by attempt, and anew from what really happened.

The main job with an arm: plan on the kinematic cell, carry out on the dynamic one, replan from
what really happened.
"""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from learn2assemble.geometry.coverage import FILTERS
from learn2assemble.geometry.rotations import yaw_quaternion
from learn2assemble.networks.agent import Agent
from learn2assemble.physics.equilibrium import stability_margin
from learn2assemble.physics.scene import rotation_matrix
from learn2assemble.planning.discover import (
    STAGES,
    Placement,
    PlanningAttempt,
    Progress,
    Sequence,
    make,
    plan_sequences,
    replay,
)
from learn2assemble.planning.plan import ArmFailure, ArmReport, Plan
from learn2assemble.planning.problem import Problem, placement_key
from learn2assemble.planning.supply import taking_order
from learn2assemble.planning.verify import Proof, VerifiedStep, make_plan
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.checker import ArmPhysics, scene_of
from learn2assemble.robot.dynamic.cell import DynamicCell
from learn2assemble.robot.grasps import QUARTER, get_grasps
from learn2assemble.robot.kinematic.cell import KinematicCell
from learn2assemble.robot.moves import OPENING, Attempt, Move, Outcome, Scene
from learn2assemble.robot.recorder import BuildRecorder
from learn2assemble.simulator import Simulator
from learn2assemble.world.blocks import HALF
from learn2assemble.world.rules import count_row, recover_all
from learn2assemble.world.state import State

STANDS = 0.02
"""A block farther from its place than this does not stand there any more [m]."""
ON_TABLE = 0.01
"""Nor is a block whose centre is this much higher than on the table on the table [m]."""
UPRIGHT = np.cos(np.deg2rad(5.0))
"""Cosine of the largest lean of a block that stands."""


class RealCell:
    """A robot cell in which a build goes on: it remembers the arm, and every block's full pose.

    Implements :class:`learn2assemble.robot.checker.Cell` on a :class:`DynamicCell`.

    Args:
        cell: carries the moves out; it should recover from failures.
        state: a batch of one, before the build; object numbers are the numbers of the cubes.
    """

    name = "real"

    def __init__(self, cell: DynamicCell, state: State) -> None:
        count = int(state.num_blocks[0])
        self.cell, self.joints = cell, cell.arm.home.copy()
        self.poses = np.empty((count, 7))
        """float64[C, 7]: x, y, z [m], quaternion (w, x, y, z) of every block by its number."""
        self.poses[state.object_id[0, :count]] = np.hstack(
            [state.position[0, :count], state.quaternion[0, :count]]
        )
        words = "dynamic cell: MuJoCo, friction grasp, all collisions"
        objects = [[number] for number in range(count)]
        self.log = BuildRecorder(cell.arm, self.joints, OPENING, self.poses, objects, words)

    def attempt(self, scene: Scene, move: Move) -> Attempt:
        """Carry out a move from where the arm is, with the blocks where they are."""
        numbers = scene.object_id
        real = scene._replace(position=self.poses[numbers, :3])
        found = self.cell.attempt(
            real, move, joints=self.joints, quaternion=self.poses[numbers, 3:]
        )
        order = self.log.add_attempt(found, real, move, numbers)
        if found.after is not None and found.quaternion is not None:
            self.poses[order] = np.hstack([found.after.position, found.quaternion])
        if found.joints is not None:
            self.joints = found.joints
        return found


def replan_from(
    problem: Problem, before: State, target: np.ndarray, action: np.ndarray, poses: np.ndarray,
    cell: KinematicCell,
) -> Problem:  # fmt: skip
    """What is left to build after an action has failed.

    What still stands where it belongs, or lies on something, is the structure; what lies on the
    table waits, what is in the way of the site first. The same placement is not tried again.

    Args:
        problem: as it was planned.
        before: the state before the action.
        target: float64[3] the block should have come to [m].
        action: the one that failed.
        poses: float64[C, 7] of all blocks now, by number.
        cell: of the arm, to find out what it can take.
    """
    placed, count = int(before.num_placed[0]), int(before.num_blocks[0])
    numbers = before.object_id[0, :count]
    moved = int(numbers[placed + action[0]])
    meant = {int(n): before.position[0, k] for k, n in enumerate(numbers[:placed])}
    meant[moved] = target
    fallen = [n for n in meant if not _stands(poses[n], meant[n])]
    standing = [n for n in meant if n not in fallen]
    lying = [n for n in map(int, numbers) if n not in standing and not _on_table(poses[n])]
    kept = [*standing, *lying] or [int(numbers[0])]
    loose = [n for n in fallen if n not in kept]
    waiting = [*loose, *(int(n) for n in numbers if n not in kept and n not in loose)]
    key = placement_key(target, int(action[2]) % problem.task.rotations)
    state = _state(problem, before, kept, waiting, poses)
    order = _taking(state, cell, problem.task.grasps)
    return dataclasses.replace(
        problem, state=_state(problem, before, kept, order, poses), avoid=problem.avoid | {key}
    )


def _stands(pose: np.ndarray, meant: np.ndarray) -> bool:
    return bool(np.linalg.norm(pose[:3] - meant) < STANDS and _lean(pose) > UPRIGHT)


def _on_table(pose: np.ndarray) -> bool:
    return bool(abs(pose[2] - HALF) < ON_TABLE and _lean(pose) > UPRIGHT)


def _lean(pose: np.ndarray) -> float:
    """Cosine of the angle between the vertical and the nearest axis of a cube."""
    return float(np.abs(rotation_matrix(pose[3:])[2]).max())


def _yaw(pose: np.ndarray) -> float:
    """Turn about the vertical of a cube, on whichever face it lies, within an eighth."""
    axes = rotation_matrix(pose[3:])
    flat = np.argmin(np.abs(axes[2]))
    yaw = np.arctan2(axes[1, flat], axes[0, flat])
    return float(yaw - QUARTER * np.rint(yaw / QUARTER))


def _state(
    problem: Problem, before: State, placed: list[int], waiting: list[int], poses: np.ndarray
) -> State:
    """The state with these blocks in this order, where they are."""
    state = before.copy()
    order = [*placed, *waiting]
    yaw = np.array([_yaw(poses[n]) for n in order])
    count = len(order)
    state.object_id[0, :count] = order
    state.position[0, :count] = poses[order, :3]
    state.quaternion[0, :count] = yaw_quaternion(yaw)
    state.num_placed[0] = len(placed)
    state.terminated[0] = False
    recover_all(state, 0, problem.frames, FILTERS[problem.task.cover_filter])
    count_row(state, 0)
    return state


def _taking(state: State, cell: KinematicCell, grasps: str) -> list[int]:
    """Numbers of the waiting blocks in an order the arm can take them; the stuck ones last."""
    count, placed = int(state.num_blocks[0]), int(state.num_placed[0])
    numbers = state.object_id[0, :count]
    scene = scene_of(state.position[0, :count], state.quaternion[0, :count], numbers, placed)
    order, stuck = taking_order(cell, get_grasps(grasps), scene)
    return [int(numbers[k]) for k in [*order, *stuck]]


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
        self.said: list[PlanningAttempt] = []
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
        self.said.append(PlanningAttempt(what, step.detail or "failed", 0.0))
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
    """The first plan that fills the target, else the one that fills most.

    What failed once may succeed with the blocks where they are now: where nothing else leads to a
    full target, it is tried again.
    """
    plan = _best_plan(problem, agent, seed, seconds, progress)
    if plan.success or not problem.avoid:
        return plan
    again = _best_plan(replace(problem, avoid=frozenset()), agent, seed, seconds, progress)
    again.attempts = [*plan.attempts, *again.attempts]
    return again if again.success else plan


def _best_plan(
    problem: Problem, agent: Agent, seed: int, seconds: float, progress: Progress
) -> Sequence:
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


CLOSING = ("along x", "along y")
"""The axis on which the fingers close, in words."""


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
) -> Plan:
    """The plan of a build by an arm, with the record of what the arm did.

    Every step is an attempt of the cell. After one that fails, the rest is planned anew from where
    arm and blocks really are, without the placement that failed.

    Args:
        problem: its blocks wait where the arm can take them, see
            :func:`learn2assemble.planning.supply.set_out`.
        source: where the problem comes from, for the report.
        cell: carries the plan out.
        seconds: limit of the last, widest search of each plan.
        progress: told what is going on.
    """
    started = time.perf_counter()
    build = ArmBuild(problem, cell)
    if problem.refusal is None:
        build.carry_out(agent, seed, seconds, progress)
    steps, real = build.steps(), build.real
    real.log.number_steps(build.step_numbers())
    found, proof = build.summary(steps), Proof(steps, build.filled)
    plan = make_plan(problem, agent, source, found, proof, started, method())
    return _with_arm(plan, problem, steps, real)


def _with_arm(plan: Plan, problem: Problem, steps: list[VerifiedStep], real: RealCell) -> Plan:
    """The plan with what concerns the arm."""
    pairs = get_grasps(problem.task.grasps)
    attempts = {s.plan_step: s.outcome for s in real.log.steps if s.plan_step is not None}
    made = []
    for entry, step in zip(plan.steps, steps, strict=True):
        grasp, place = (
            CLOSING[int(abs(np.cos(attitude.yaw)) > 0.5)]
            for attitude in pairs[step.placement.action % len(pairs)]
        )
        outcome = attempts[entry.step].label
        made.append(replace(entry, outcome=outcome, grasp=grasp, place=place, proof="arm"))
    failures = tuple(
        ArmFailure(step.number, step.outcome.label, step.detail, step.replanned)
        for step in real.log.steps
        if step.outcome != Outcome.REACHED
    )
    arm = ArmReport(
        real.cell.arm.name, problem.task.pitch, len(real.log.steps), failures,
        round(real.log.now, 2),
    )  # fmt: skip
    return replace(plan, steps=tuple(made), arm=arm, record=real.log.record())
