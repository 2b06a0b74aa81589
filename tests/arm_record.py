"""Records of builds without dynamics, for tests of what is written and drawn: joint positions of
the kinematic cell, joined by smooth motions within the limits."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.blocks import AssemblyStep as Placed
from learn2assemble.assembly.boxes import box_block
from learn2assemble.kinematics.cell import KinematicCell
from learn2assemble.motion.record import RATE, BuildRecord, Stage
from learn2assemble.motion.recorder import BuildRecorder, StepMotion, upright
from learn2assemble.planning import plan as plans
from learn2assemble.planning.plan import Plan
from learn2assemble.robot.arm import Arm, get_arm
from learn2assemble.robot.grasps import get_grasps
from learn2assemble.robot.moves import OPENING, Move, Outcome, Scene
from learn2assemble.tasks.world.layouts import sobol

EDGE, PITCH = 0.05, 0.06
WALL = (6, 6, 4, 2, 2)
"""Blocks per level."""


def wall(count: int) -> list[np.ndarray]:
    """Centres of the first blocks of a gable wall, level by level, the first one at the origin."""
    cells = [
        (x, level)
        for level, wide in enumerate(WALL)
        for x in sorted(range(1 - wide // 2, 1 + wide // 2), key=lambda x: (abs(x), x))
    ]
    return [np.array([PITCH * x, 0.0, EDGE * (z + 0.5)]) for x, z in cells[:count]]


def waiting(count: int) -> np.ndarray:
    """Rows of six in front of the wall: float64[count, 3] [m]."""
    k = np.arange(count)
    x = (2 * sobol(6)[k % 6] - 1) * 0.384375 - 0.076875 - 0.025 * (k // 6)
    return np.stack([x, -0.15 - 0.1 * (k // 6), np.full(count, EDGE / 2)], -1)


def arm_plan(count: int = 20) -> Plan:
    """The plan of the wall: a task with one side."""
    goals = wall(count)
    blocks = tuple(
        box_block(f"b{k}", (goal - EDGE / 2).tolist(), (goal + EDGE / 2).tolist(), kind="cube")
        for k, goal in enumerate(goals)
    )
    steps = []
    for k, goal in enumerate(goals[1:], 1):
        below = [j for j in range(k) if np.allclose(goals[j], goal - [0, 0, EDGE])]
        beside = [
            j
            for j in range(k)
            if abs(abs(goals[j] - goal)[0] - PITCH) < 1e-6 and goals[j][2] == goal[2]
        ]
        reference, relation = (
            (below[0], "top")
            if below
            else (beside[0], "right" if goal[0] > goals[beside[0]][0] else "left")
        )
        x, y, z = goal.tolist()
        steps.append(
            plans.Step(
                k,
                k,
                (x, y, z),
                (1.0, 0.0, 0.0, 0.0),
                kind="cube",
                reference=reference,
                relation=relation,
                coverage=k / (count - 1),
                sides=(k / (count - 1),),
                margin_g=round(1 / (1 + goal[2] / EDGE), 3),
                proof="arm",
            )
        )
    outline = [(-0.145, 0.0), (-0.145, 0.1), (0.0, 0.25), (0.06, 0.25), (0.205, 0.1), (0.205, 0.0)]
    target = plans.PlanTarget("front", tuple((x, -EDGE / 2, z) for x, z in outline))
    return Plan(
        design=plans.PlanDesign("Gable wall", "gable_wall.json", EDGE, (target,), 0.75),
        status="complete",
        reason=None,
        blocks=plans.BlockSupply(count, count),
        steps=tuple(steps),
        coverage=1.0,
        seconds=12.0,
        agent="test",
        planner="agent",
        search=plans.SearchReport("agent alone", 0),
        verified_by="MuJoCo 4.0.0",
        assembly=Assembly(blocks, tuple(Placed(f"b{k}") for k in range(1, count)), 1.0, "wall"),
    )


def pose(position: Any, yaw: float) -> np.ndarray:
    return upright(np.array([position]), np.array([yaw]))[0]


class Recorder:
    """Appends motions to a recording, sample by sample."""

    def __init__(self, arm: Arm, plan: Plan) -> None:
        self.arm, self.cell = arm, KinematicCell(arm, 40)
        places = np.array([[0.0, 0.0, EDGE / 2], *waiting(len(plan.steps))])
        self.joints, self.width = arm.home.copy(), OPENING
        self.recording = BuildRecorder(
            arm,
            self.joints,
            self.width,
            upright(places, np.zeros(len(places))),
            [[k] for k in range(len(places))],
            "a kinematic sketch for tests",
        )
        self.rows, self.stages = [], []

    @property
    def poses(self) -> np.ndarray:
        return self.recording.poses

    @property
    def now(self) -> float:
        """Since the step began [s]."""
        return len(self.rows) / RATE

    def move(self, stage: str, *joints: np.ndarray) -> None:
        """Through joint positions to the last one, from rest to rest."""
        path = np.array([self.joints, *joints])
        pace = np.abs(np.diff(path, axis=0)) / self.arm.velocity
        knots = np.concatenate([[0.0], np.cumsum(pace.max(1) + 1e-3)])
        curve, length = PchipInterpolator(knots, path), knots[-1]
        u = np.linspace(0, 1, 400)
        rise, push = 30 * (u * (1 - u)) ** 2, 60 * u * (1 + u * (2 * u - 3))
        at = u**3 * (10 + u * (6 * u - 15)) * length
        slope, bend = curve(at, 1) * length, curve(at, 2) * length**2
        fast = np.abs(slope * rise[:, None]) / self.arm.velocity
        hard = np.abs(slope * push[:, None] + bend * rise[:, None] ** 2) / self.arm.acceleration
        n = math.ceil(1.7 * max(fast.max(), math.sqrt(hard.max())) * RATE)
        start = self.now
        for u in np.arange(1, n + 1) / n:
            at = u**3 * (10 + u * (6 * u - 15)) * length
            rate = 30 * (u * (1 - u)) ** 2 * length * RATE / n
            self.rows.append((curve(at), curve(at, 1) * rate, self.width))
        self.joints = path[-1]
        self.stages.append(Stage(stage, start, self.now))

    def open_to(self, stage: str, width: float) -> None:
        """The fingers at 0.1 m/s, then a moment of rest."""
        start, before = self.now, self.width
        n = math.ceil(abs(width - before) / 0.1 * RATE)
        for k in range(1, n + 11):
            self.width = before + (width - before) * min(k / n, 1)
            self.rows.append((self.joints, np.zeros_like(self.joints), self.width))
        self.stages.append(Stage(stage, start, self.now))

    def finish(
        self,
        plan_step: int | None,
        cell: int,
        target: np.ndarray,
        outcome: Outcome,
        held: tuple[float | None, float | None],
        after: np.ndarray,
        detail: str = "",
    ) -> None:
        poses = self.poses.copy()
        poses[cell] = after
        motion = None
        if self.rows:
            joints, velocity, width = map(np.array, zip(*self.rows, strict=True))
            motion = StepMotion(joints, velocity, width, width, self.stages, *held)
        self.recording.add(
            plan_step=plan_step,
            cells=[cell],
            target=target,
            outcome=outcome,
            detail=detail,
            motion=motion,
            after=poses,
        )
        if outcome != Outcome.REACHED:
            self.recording.replanned()
        self.rows, self.stages = [], []

    def attempt(self, plan_step: int, cell: int, goal: np.ndarray, result: Outcome) -> None:
        """One step; ``result`` is made up, all else follows the kinematic cell."""
        target = upright(goal[None], np.zeros(1))[0]
        if result == Outcome.UNREACHABLE:
            self.finish(
                plan_step,
                cell,
                target,
                result,
                (None, None),
                self.poses[cell],
                "place: tool at (0.06, 0, 0.23): out of reach",
            )
            return
        scene, moved = self._scene(cell)
        for grasp, place in get_grasps("paper"):
            turned = grasp._replace(yaw=grasp.yaw + scene.yaw[moved])
            found = self.cell.attempt(scene, Move(moved, goal, turned, place))
            if found.reached:
                break
        assert found.pick is not None, found
        assert found.place is not None
        pick, place, home = found.pick, found.place, self.arm.home
        self.move("approach", pick[-1])
        self.move("pick", *pick[-2::-1])
        if result == Outcome.GRASP_LOST:
            self.open_to("pick", 0.0)
            self.move("lift", *pick[1:])
            self.open_to("release", OPENING)
            self.move("home", home)
            after = pose(self.poses[cell, :3] + [0.012, 0.02, 0], 0.4)
            self.finish(
                plan_step,
                cell,
                target,
                result,
                (None, None),
                after,
                "the fingers closed on nothing",
            )
            return
        self.open_to("pick", EDGE)
        grip = self.stages[-1].end
        self.move("lift", *pick[1:])
        self.move("cross", place[-1])
        if result == Outcome.DROPPED:
            over, after = self.stages[-1], pose([-0.21, -0.08, EDGE / 2], 0.7)
            self.open_to("release", OPENING)
            self.move("home", home)
            held = (grip, (over.start + over.end) / 2)
            self.finish(plan_step, cell, target, result, held, after, "lost on the way across")
            return
        self.move("place", *place[-2::-1])
        self.open_to("release", OPENING)
        release = self.stages[-1].start + 0.04
        self.move("retreat", *place[1:])
        self.move("home", home)
        error = 4e-4 * np.array([math.sin(cell), math.cos(cell), 0])
        after = pose(goal + error, 2e-3 * math.sin(3 * cell))
        self.finish(plan_step, cell, target, result, (grip, release), after)

    def _scene(self, cell: int) -> tuple[Scene, int]:
        """The cells as a scene, the placed ones first, and the row of ``cell``."""
        placed = [0, *(s.cells[0] for s in self.recording.steps if s.outcome == Outcome.REACHED)]
        order = placed + [k for k in range(len(self.poses)) if k not in placed]
        poses = self.poses[order]
        ids = np.arange(len(order))
        return Scene(
            poses[:, :3].copy(), 2 * np.arctan2(poses[:, 6], poses[:, 3]), ids, len(placed)
        ), order.index(cell)


@lru_cache(maxsize=8)
def arm_record(name: str = "panda", count: int = 20, failures: bool = True) -> BuildRecord:
    """The build of the wall; with ``failures`` three steps fail once and are tried again."""
    plan = arm_plan(count)
    recorder = Recorder(get_arm(name), plan)
    trouble = {2: Outcome.GRASP_LOST, 4: Outcome.UNREACHABLE, 5: Outcome.DROPPED}
    for step in plan.steps:
        goal = np.array(step.position)
        if failures and step.step in trouble:
            recorder.attempt(step.step, step.block, goal, trouble[step.step])
        recorder.attempt(step.step, step.block, goal, Outcome.REACHED)
    return recorder.recording.record()
