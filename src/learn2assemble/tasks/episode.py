"""A random problem of a task, built by the agent of the paper: an episode, planned and carried out.

The agent with a small search plays the problem in the simulator; where that does not fill the
target, a larger budget follows, then every legal placement with backtracking. What was found is
carried out placement by placement, in rigid-body simulation or by the arm of the task in its
dynamic workcell, and after one that fails the rest is planned anew from what really stands.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.handling.dynamic_cell import DynamicCell
from learn2assemble.kinematics.cell import KinematicCell
from learn2assemble.planning import plan as plans
from learn2assemble.planning.plan import Plan
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.grasps import get_grasps as grasps_of
from learn2assemble.simulation.worlds import WorldForces
from learn2assemble.tasks.built import Built, Made, object_kind, plan_of
from learn2assemble.tasks.checkers import ArmPhysics
from learn2assemble.tasks.networks.agent import (
    Agent,
    Network,
    default_agent,
    load_agent,
    one_thread,
)
from learn2assemble.tasks.physics.equilibrium import stability_margin
from learn2assemble.tasks.playing import Key, Progress, placement_key, plan_episode
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.standing import RealCell, left_to_build
from learn2assemble.tasks.task import Task, check_actions, get_task
from learn2assemble.tasks.world.blocks import GRAVITY, RELATIONS
from learn2assemble.tasks.world.state import State

PROBLEM_STREAM = 3
"""First word of the seed of a problem: neither training's nor evaluation's stream."""
MAX_REPLANS = 12
"""Failures after which a build is given up."""


def sample_problem(task: Task, seed: int) -> State:
    """A random problem of a task, a batch of one, with the masks and the blocks of the paper."""
    return Simulator(task).new(1, np.random.default_rng([PROBLEM_STREAM, seed]))


# ---------------------------------------------------------------- carrying out


def build_task(
    task: str | Task,
    *,
    arm: str | None = None,
    agent: str | Path | Agent | None = None,
    seed: int = 0,
    seconds: float = 20.0,
    progress: Progress = lambda text: None,
    cell: DynamicCell | None = None,
) -> Plan:
    """Build a random problem of a task.

    Args:
        task: a task or its name.
        arm: builds in place of the task's own, or ``none``; for tasks with a robot.
        agent: an agent, a shipped one by name, a ``.safetensors`` file or the folder of a training;
            by default the shipped one for tasks like this.
        seed: of the problem and of the search.
        seconds: limit of the widest search of each plan.
        progress: told what is going on.
        cell: carries the moves of an arm out, in place of its own.

    Returns:
        The plan with what has really been built; with an arm its motion is ``plan.record``.

    Raises:
        InputError: for names that do not exist, an agent of other actions, and an arm that would
            have to place objects of several cells.
    """
    started, task = time.perf_counter(), get_task(task, arm)
    if seed < 0:
        raise InputError("seed", seed, "a whole number of at least 0")
    if task.has_arm and task.objects != "cubes":
        raise InputError("task", task.name, "one of cubes, for a build by an arm (or `arm=none`)")
    if not isinstance(agent, Agent):
        agent = load_agent(str(agent or default_agent(task.name)))
    network = agent.network.config
    check_actions(network.num_actions, network.action_mode, task)
    with one_thread():
        build = _Build(task, seed, cell)
        build.run(agent.network, seed, seconds, progress)
    return plan_of(build, agent.name, f"task {task.name}, seed {seed}", started)


class _Build(Built):
    """A build that goes on: planned in one simulator, carried out in another."""

    def __init__(self, task: Task, seed: int, cell: DynamicCell | None) -> None:
        super().__init__(task, sample_problem(task, seed))
        self.simulator = Simulator(task)
        if task.has_arm:
            self.real = RealCell(
                cell
                or DynamicCell(
                    get_arm(task.arm), recover=True, forces=WorldForces(gravity=GRAVITY)
                ),
                self.start,
            )
            self.kinematic = KinematicCell(get_arm(task.arm), int(self.start.num_blocks[0]))
            self.judge = Simulator(task, ArmPhysics(self.real, grasps_of(task.grasps)))
        else:
            self.judge = Simulator(task, "rigid")
        self.state, self.failed = self.start.copy(), 0

    def run(self, network: Network, seed: int, seconds: float, progress: Progress) -> None:
        """Plan and act until the target is filled or no plan leads any further."""
        avoid: frozenset[Key] = frozenset()
        while not self.filled and self.failed <= MAX_REPLANS and self.state.num_unplaced[0]:
            found = plan_episode(
                self.simulator,
                self.state,
                network,
                seed=seed,
                seconds=seconds,
                avoid=avoid,
                progress=progress,
            )
            self.stage = max(self.stage, found.stage)
            self.tried += found.tried
            if avoid and not found.success:
                # What failed once may succeed with things where they are now.
                avoid = frozenset()
                continue
            if self.real and self.failed and found.actions:
                self.real.log.replanned()
            key = self._follow(found.actions, progress)
            if key is not None:
                avoid |= {key}
            elif not (found.success and found.actions):
                return

    def _follow(self, actions: list[np.ndarray], progress: Progress) -> Key | None:
        """Carry placements out, up to one that fails or the end; the one that failed."""
        for number, action in enumerate(actions, 1):
            before = self.state.copy()
            step = self.judge.step(self.state, action[None])
            held = step.verdict[0] == 0
            what, why = "stands" if held else "does not stand", "in rigid-body simulation"
            if self.real is not None:
                last = self.real.log.steps[-1]
                what, why = last.outcome.label, last.detail or "failed"
            progress(f"block {number} of {len(actions)}: {what}")
            if not held:
                self.failed += 1
                key = placement_key(self.task, before, action)
                self.tried.append(plans.SearchStage(f"failure {self.failed}: {what}", why, 0.0))
                self._recover(before, action)
                return key
            self._note(before, action)
            self.filled = bool(step.success[0])
            # Reality may show less than was planned; the world goes on then.
            self.state.terminated[0] = False
            if self.filled:
                return None
        return None

    def _recover(self, before: State, action: np.ndarray) -> None:
        """Go on from what really stands."""
        self.state = before
        if self.real is None:
            return
        self.state = left_to_build(self.task, before, action, self.real.poses, self.kinematic)
        standing = self.state.object_id[0, : self.state.num_placed[0]].tolist()
        self.made = [item for item in self.made if item.number in standing]
        moved = int(before.object_id[0, before.num_placed[0] + action[0]])
        if moved in standing:
            self._note(before, action)
            self.filled = bool(self.state.complete_coverage[0] > self.task.success_threshold)

    def _note(self, before: State, action: np.ndarray) -> None:
        """Keep what has just been placed, as it stands."""
        state, count, task = self.state, int(self.state.num_placed[0]), self.task
        number = int(before.object_id[0, before.num_placed[0] + action[0]])
        ids = state.object_id[0, :count]
        cells = np.flatnonzero(ids == number)
        poses = np.hstack([state.position[0, cells], state.quaternion[0, cells]])
        seen = np.bitwise_count(state.covered[0] & state.mask[0]).sum((1, 2))
        sides = seen / np.maximum(np.bitwise_count(state.mask[0]).sum((1, 2)), 1)
        coverage = float(state.complete_coverage[0])
        margin = stability_margin(state.position[0, :count], ids)
        x, y, z, *turn = (round(float(v), 6) for v in poses[0])
        attempts = self.real.log.steps if self.real else []
        step = plans.Step(
            0,
            0,
            (x, y, z),
            (turn[0], turn[1], turn[2], turn[3]),
            kind=object_kind(len(cells)),
            relation=RELATIONS[int(action[2]) // task.rotations],
            coverage=round(coverage, 6),
            sides=tuple(sides.round(6).tolist()),
            margin_g=round(margin, 4),
            proof="arm" if self.real else "rigid bodies",
            outcome=attempts[-1].outcome.label if attempts else None,
        )
        reference = int(before.object_id[0, action[1]])
        self.made.append(Made(number, reference, poses, coverage, step, len(attempts)))
