"""A random problem of a task, built by the agent of the paper: an episode, planned and carried out.

The agent with a small search plays the problem in the simulator; where that does not fill the
target, a larger budget follows, then every legal placement with backtracking. What was found is
carried out placement by placement, in rigid-body simulation or by the arm of the task in its
dynamic workcell, and after one that fails the rest is planned anew from what really stands.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from learn2assemble.assembly.blocks import Assembly, AssemblyStep, Block, box_block
from learn2assemble.constants import EDGE, FRICTION, HALF, MASS
from learn2assemble.design.drawings import SIDES
from learn2assemble.errors import InputError
from learn2assemble.geometry.rotations import quaternion_matrix, yaw_quaternion
from learn2assemble.motion.record import BuildRecord, BuildRecorder
from learn2assemble.planning import plan as plans
from learn2assemble.planning.plan import Plan
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.grasps import QUARTER, along
from learn2assemble.robot.grasps import get_grasps as grasps_of
from learn2assemble.robot.kinematic import KinematicCell
from learn2assemble.robot.moves import OPENING, Attempt, Move, Outcome, Scene
from learn2assemble.robot.scene import rotation_matrix
from learn2assemble.simulation.cell import DynamicCell, WorldForces
from learn2assemble.tasks.checkers import ArmPhysics, scene_of
from learn2assemble.tasks.graph.features import node_offset
from learn2assemble.tasks.graph.placements import distinct_placements
from learn2assemble.tasks.networks.agent import (
    Agent,
    Network,
    default_agent,
    load_agent,
    one_thread,
)
from learn2assemble.tasks.physics.equilibrium import stability_margin
from learn2assemble.tasks.search.config import SearchConfig
from learn2assemble.tasks.search.mcts import search
from learn2assemble.tasks.search.tree import ActionValues
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import Task, check_actions, get_task
from learn2assemble.tasks.world.blocks import GRAVITY, RELATIONS
from learn2assemble.tasks.world.coverage import FILTERS
from learn2assemble.tasks.world.layouts import side_frames, to_world
from learn2assemble.tasks.world.rules import count_row, recover_all, target_cell
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import WorldModel, placement_cost

PROBLEM_STREAM = 3
"""First word of the seed of a problem: neither training's nor evaluation's stream."""
BUDGETS = (10, 40)
"""Search budgets of the agent, in order, before every placement is tried."""
STAGES = (
    *(f"agent with search, budget {budget}" for budget in BUDGETS),
    "every legal placement, with backtracking",
)
"""What is tried, in order of rising effort."""
PATIENCE = 6
"""Placements in a row that fill nothing after which the agent is given up."""
MAX_REPLANS = 12
"""Failures after which a build is given up."""
STANDS, ON_TABLE = 0.02, 0.01
"""A block farther from its place does not stand there any more; one whose centre is this much
higher than on the table is not on it [m]."""
UPRIGHT = float(np.cos(np.deg2rad(5.0)))
"""Cosine of the largest lean of a block that stands."""

Progress = Callable[[str], None]
Key = tuple[int, int, int, int]


def sample_problem(task: Task, seed: int) -> State:
    """A random problem of a task, a batch of one, with the masks and the blocks of the paper."""
    return Simulator(task).new(1, np.random.default_rng([PROBLEM_STREAM, seed]))


def placement_key(task: Task, state: State, action: np.ndarray, row: int = 0) -> Key:
    """A placement in a row with another of its kind nearby: target in half edges, and the way."""
    relation, way = divmod(int(action[2]), task.rotations)
    x, y, z = target_cell(state, row, int(action[1]), relation, task.pitch)
    return round(x / HALF), round(y / HALF), round(z / HALF), way


# ---------------------------------------------------------------- planning


@dataclass(frozen=True)
class Found:
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
) -> Found:
    """The first episode that fills the target, else the one that fills most.

    Args:
        simulator: of the world as it is planned for.
        state: a batch of one, left alone.
        seconds: limit of the last, widest search.
        avoid: placements to leave out, see :func:`placement_key`.
        progress: told what is being tried.
    """
    model, tried = _Without(simulator, network, avoid), []
    best, most = Found([], False, 0, []), -np.inf
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
            best, most = Found(actions, success, stage, tried), cover
        if success:
            break
    return best


def _play(
    model: _Without, start: State, config: SearchConfig, rng: np.random.Generator
) -> tuple[list[np.ndarray], float, bool]:
    """Let the agent play with a search before every step: what it did, coverage, success."""
    state, actions, idle, task = start.copy(), [], 0, model.simulator.task
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
    stack, seen = [(state, [], _candidates(simulator, state, avoid))], {_filled(state)}
    best, most = [], float(state.complete_coverage[0])
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


# ---------------------------------------------------------------- carrying out


class RealCell:
    """A robot cell in which a build goes on: it remembers the arm, and every cube's full pose.

    Implements :class:`learn2assemble.tasks.checkers.Cell` on a :class:`DynamicCell`.

    Args:
        cell: carries the moves out; it should recover from failures.
        state: a batch of one, before the build; object numbers are the numbers of the cubes.
    """

    name = "real"

    def __init__(self, cell: DynamicCell, state: State) -> None:
        count = int(state.num_blocks[0])
        self.cell, self.joints = cell, cell.arm.home.copy()
        self.poses = np.empty((count, 7))
        """float64[C, 7]: x, y, z [m], quaternion (w, x, y, z) of every cube by its number."""
        self.poses[state.object_id[0, :count]] = np.hstack(
            [state.position[0, :count], state.quaternion[0, :count]]
        )
        words = "dynamic cell: MuJoCo, friction grasp, all collisions"
        cubes = [[number] for number in range(count)]
        self.log = BuildRecorder(cell.arm, self.joints, OPENING, self.poses, cubes, words)

    def attempt(self, scene: Scene, move: Move) -> Attempt:
        """Carry out a move from where the arm is, with the cubes where they are."""
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


def left_to_build(
    task: Task, before: State, action: np.ndarray, poses: np.ndarray, cell: KinematicCell
) -> State:
    """The state after an action of an arm has failed.

    What still stands where it belongs, or lies on something, is the structure; what lies on the
    table waits, first what is loose and can be taken: it may be in the way.

    Args:
        before: the state before the action, a batch of one.
        action: the one that failed.
        poses: float64[C, 7] of all cubes now, by number.
        cell: of the arm, to find out what it can take.
    """
    placed, count = int(before.num_placed[0]), int(before.num_blocks[0])
    numbers = before.object_id[0, :count].tolist()
    target = target_cell(before, 0, int(action[1]), int(action[2]) // task.rotations, task.pitch)
    meant = {n: before.position[0, k] for k, n in enumerate(numbers[:placed])}
    meant[numbers[placed + action[0]]] = np.array(target)
    upright = {n: bool(_lean(poses[n]) > UPRIGHT) for n in numbers}
    off = {n: np.linalg.norm(poses[n, :3] - place) for n, place in meant.items()}
    standing = [n for n in meant if upright[n] and off[n] < STANDS]
    on_table = {n for n in numbers if upright[n] and abs(poses[n, 2] - HALF) < ON_TABLE}
    kept = [*standing, *(n for n in numbers if n not in standing and n not in on_table)]
    kept = kept or numbers[:1]
    waiting = list(dict.fromkeys(n for n in [*meant, *numbers] if n not in kept))
    state = _standing(task, before, kept, waiting, poses)
    loose = [n for n in meant if n in waiting]
    stuck = [n for n in loose if not _can_take(state, n, cell, task.grasps)]
    order = [*(n for n in waiting if n not in stuck), *stuck]
    return _standing(task, before, kept, order, poses)


def _standing(
    task: Task, before: State, placed: list[int], waiting: list[int], poses: np.ndarray
) -> State:
    """The state with these cubes in this order, where they are."""
    state, order = before.copy(), [*placed, *waiting]
    state.object_id[0, : len(order)] = order
    state.position[0, : len(order)] = poses[order, :3]
    state.quaternion[0, : len(order)] = yaw_quaternion(np.array([_yaw(poses[n]) for n in order]))
    state.num_placed[0] = len(placed)
    state.terminated[0] = False
    frames = side_frames(task.num_sides, task.pitch, task.aisle)
    recover_all(state, 0, frames, FILTERS[task.cover_filter])
    count_row(state, 0)
    return state


def _can_take(state: State, number: int, cell: KinematicCell, grasps: str) -> bool:
    """Whether the arm can lift a waiting cube by any grasp of its set."""
    count, placed = int(state.num_blocks[0]), int(state.num_placed[0])
    scene = scene_of(
        state.position[0, :count], state.quaternion[0, :count], state.object_id[0, :count], placed
    )
    row = int(np.flatnonzero(scene.object_id == number)[0])
    high = np.array([0.0, 0.0, scene.position[:placed, 2].max() + EDGE])
    for pair in grasps_of(grasps):
        turned = along(pair.grasp, float(scene.yaw[row]))
        if cell.pick(scene, Move(row, high, turned, turned)).reached:
            return True
    return False


def _lean(pose: np.ndarray) -> float:
    """Cosine of the angle between the vertical and the nearest axis of a cube."""
    return float(np.abs(rotation_matrix(pose[3:])[2]).max())


def _yaw(pose: np.ndarray) -> float:
    """Turn about the vertical of a cube, on whichever face it lies, within an eighth."""
    axes = rotation_matrix(pose[3:])
    flat = np.argmin(np.abs(axes[2]))
    yaw = np.arctan2(axes[1, flat], axes[0, flat])
    return float(yaw - QUARTER * np.rint(yaw / QUARTER))


@dataclass
class _Made:
    """A placement whose object stands."""

    number: int
    """Of the object."""
    reference: int
    """Number of the object it was placed against."""
    cells: np.ndarray
    """float64[n, 7]: poses of its cells, the chosen one first."""
    coverage: float
    step: plans.Step
    """What the plan says of it, but for the numbers of blocks."""
    attempt: int
    """Number of the attempt of the arm, from 1."""


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
    return _plan(build, agent.name, f"task {task.name}, seed {seed}", started)


class _Build:
    """A build that goes on: planned in one simulator, carried out in another."""

    def __init__(self, task: Task, seed: int, cell: DynamicCell | None) -> None:
        self.task, self.simulator = task, Simulator(task)
        self.start = sample_problem(task, seed)
        self.real = None
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
        self.state, self.filled, self.failed = self.start.copy(), False, 0
        self.made: list[_Made] = []
        self.stage = 0
        self.tried: list[plans.SearchStage] = []

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
            kind=_kind(len(cells)),
            relation=RELATIONS[int(action[2]) // task.rotations],
            coverage=round(coverage, 6),
            sides=tuple(sides.round(6).tolist()),
            margin_g=round(margin, 4),
            proof="arm" if self.real else "rigid bodies",
            outcome=attempts[-1].outcome.label if attempts else None,
        )
        reference = int(before.object_id[0, action[1]])
        self.made.append(_Made(number, reference, poses, coverage, step, len(attempts)))


# ---------------------------------------------------------------- the plan


def _plan(build: _Build, agent: str, source: str, started: float) -> Plan:
    """What came of it."""
    task, start, made, real = build.task, build.start, build.made, build.real
    count = int(start.num_blocks[0])
    available = len(np.unique(start.object_id[0, :count]))
    first = int(start.object_id[0, 0])
    reached = made[-1].coverage if made else 0.0
    reason = None
    if not build.filled:
        needed = f"{task.success_threshold:.1%}"
        reason = f"filled {reached:.1%} of the target, more than {needed} is needed"
        reason += f"; all {available} blocks are used" * (len(made) + 1 == available)
    simulated = "arm and blocks together, grasps by friction" if real else "rigid bodies at rest"
    steps, known = [], {first: 0}
    for number, item in enumerate(made, 1):
        # A block that fell and is part of the structure all the same has no step of its own.
        reference = known.get(item.reference, number - 1)
        known[item.number] = number
        steps.append(replace(item.step, step=number, block=number, reference=reference))
    cells = np.flatnonzero(start.object_id[0, : start.num_placed[0]] == first)
    stands = np.hstack([start.position[0, cells], start.quaternion[0, cells]])
    placed = [stands, *(item.cells for item in made)]
    blocks = [_block(f"b{number}", poses) for number, poses in enumerate(placed)]
    order = tuple(AssemblyStep(place=block.id) for block in blocks[1:])
    frames = side_frames(task.num_sides, task.pitch, task.aisle)
    outlines = [start.vertices[0, side, :n] for side, n in enumerate(start.num_vertices[0])]
    plan = Plan(
        design=plans.PlanDesign(
            name=source.removeprefix("task "),
            source=source,
            block_edge=EDGE,
            targets=tuple(map(_target, SIDES, frames, outlines)),
            success_threshold=task.success_threshold,
        ),
        status="complete" if build.filled else "incomplete",
        reason=reason,
        blocks=plans.BlockSupply(available, len(made) + 1),
        steps=tuple(steps),
        coverage=reached,
        seconds=round(time.perf_counter() - started, 3),
        agent=agent,
        planner="agent",
        search=plans.SearchReport(
            STAGES[build.stage], (*BUDGETS, 0)[build.stage], tuple(build.tried)
        ),
        verified_by=f"MuJoCo {mujoco.__version__}, {simulated}",
        assembly=Assembly(tuple(blocks), order, FRICTION, source),
    )
    if real is None:
        return plan
    real.log.number_steps(
        [
            next((n for n, item in enumerate(made, 1) if item.attempt == step.number), None)
            for step in real.log.steps
        ]
    )
    failures = tuple(
        plans.ArmFailure(step.number, step.outcome.label, step.detail, step.replanned)
        for step in real.log.steps
        if step.outcome != Outcome.REACHED
    )
    report = plans.ArmReport(
        real.cell.arm.name, task.pitch, len(real.log.steps), failures, round(real.log.now, 2)
    )
    return replace(plan, arm=report, record=_renumbered(real.log.record(), list(known)))


def _target(name: str, frame: np.ndarray, outline: np.ndarray) -> plans.PlanTarget:
    """A side of a target whose outline is float64[V, 2], local (x, z) [m]."""
    x, z = outline.T
    corners = to_world(frame, x, np.full_like(x, -HALF), z).round(6).tolist()
    return plans.PlanTarget(name, tuple((x, y, z) for x, y, z in corners))


def _kind(cells: int) -> str:
    """What a page and a bill call an object of so many cells."""
    return "cube" if cells == 1 else f"{cells} cubes"


def _block(name: str, poses: np.ndarray) -> Block:
    """A rigid object of cubes as one block of an assembly.

    Args:
        poses: float64[n, 7] of its cubes: x, y, z [m], quaternion (w, x, y, z).
    """
    box = box_block("cube", [-HALF] * 3, [HALF] * 3)
    turns = quaternion_matrix(poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True))
    vertices = [pose[:3] + box.vertices @ turn.T for pose, turn in zip(poses, turns, strict=True)]
    faces = tuple(tuple(8 * k + v for v in face) for k in range(len(poses)) for face in box.faces)
    return Block(name, np.concatenate(vertices), faces, _kind(len(poses)), MASS / EDGE**3)


def _renumbered(record: BuildRecord, first: list[int]) -> BuildRecord:
    """A record of single cubes with these objects first, and the others as they were."""
    order = [*first, *(k for k in range(record.num_cells) if k not in first)]
    number = {old: new for new, old in enumerate(order)}
    steps = tuple(
        replace(
            step,
            cells=tuple(number[cell] for cell in step.cells),
            before=step.before[order],
            after=step.after[order],
        )
        for step in record.steps
    )
    return replace(record, steps=steps)
