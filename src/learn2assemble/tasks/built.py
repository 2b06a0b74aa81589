"""What came of a problem that was built, as a plan."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from learn2assemble.assembly.blocks import Assembly, AssemblyStep, Block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.constants import EDGE, FRICTION, HALF, MASS
from learn2assemble.design.drawings import SIDES
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.motion.record import BuildRecord
from learn2assemble.planning import plan as plans
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.reports import ArmFailure, ArmReport
from learn2assemble.robot.moves import Outcome
from learn2assemble.tasks.playing import BUDGETS, STAGES
from learn2assemble.tasks.standing import RealCell
from learn2assemble.tasks.task import Task
from learn2assemble.tasks.world.layouts import side_frames, to_world
from learn2assemble.tasks.world.state import State


@dataclass
class Made:
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


@dataclass
class Built:
    """A problem as far as it has been built."""

    task: Task
    start: State
    real: RealCell | None = None
    """The cell of the arm, where one builds."""
    made: list[Made] = field(default_factory=list[Made])
    filled: bool = False
    stage: int = 0
    """The widest search that was needed, index into ``STAGES``."""
    tried: list[plans.SearchStage] = field(default_factory=list[plans.SearchStage])


def plan_of(build: Built, agent: str, source: str, started: float) -> Plan:
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
    steps, known = list[plans.Step](), {first: 0}
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
        ArmFailure(step.number, step.outcome.label, step.detail, step.replanned)
        for step in real.log.steps
        if step.outcome != Outcome.REACHED
    )
    report = ArmReport(
        real.cell.arm.name, task.pitch, len(real.log.steps), failures, round(real.log.now, 2)
    )
    record = _renumbered(real.log.record(), list(known))
    others = [""] * (len(record.objects) - len(blocks))
    named = replace(
        record,
        names=(*(block.id for block in blocks), *others),
        kinds=(*(block.kind for block in blocks), *others),
    )
    return replace(plan, arm=report, records=(named,))


def _target(name: str, frame: np.ndarray, outline: np.ndarray) -> plans.PlanTarget:
    """A side of a target whose outline is float64[V, 2], local (x, z) [m]."""
    x, z = outline.T
    corners = to_world(frame, x, np.full_like(x, -HALF), z).round(6).tolist()
    return plans.PlanTarget(name, tuple((x, y, z) for x, y, z in corners))


def object_kind(cells: int) -> str:
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
    return Block(name, np.concatenate(vertices), faces, object_kind(len(poses)), MASS / EDGE**3)


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
