"""From an exact plan to a build by an arm: set up, find an order, carry it out, report."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.blocks import Step as AssemblyStep
from learn2assemble.errors import InputError
from learn2assemble.planning.plan import ArmFailure, ArmReport, Plan, Step
from learn2assemble.planning.workcell import (
    STANDING,
    Arranged,
    Disturbance,
    Job,
    Progress,
    StepOf,
    Structure,
    arrange,
)
from learn2assemble.planning.workcell_build import Building, PhysicalCell
from learn2assemble.planning.workcell_reach import cells_of, set_up
from learn2assemble.planning.workcell_site import Site, pieces_of
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.kinematic.cell import KinematicCell
from learn2assemble.robot.moves import Outcome

if TYPE_CHECKING:
    from learn2assemble.assembly.kit import Kit

FINGER_ROOMS = (0.011, 0.02, 0.03, 0.036)
"""Gaps between blocks that are tried where fingers have no room [m]."""


@dataclass(frozen=True)
class Workcell:
    """How an arm builds."""

    arm: str
    tool: str = "suction"
    site: Site = dataclasses.field(default_factory=Site)
    physics: str = "dynamic"
    seed: int = 0
    noise: tuple[float, float] = (0.0, 0.0)
    """Standard deviations of what is read back: x and y [m], yaw [rad]."""
    disturbance: Disturbance | None = None
    log: Path | None = None
    """What is appended to after every attempt; where it exists, the build goes on from it."""


def job_of(plan: Plan, arm: str, joint: float) -> Job:
    """What a complete exact plan asks of an arm.

    Raises:
        InputError: for blocks that are no boxes.
    """
    assert plan.assembly is not None
    steps = tuple(StepOf(step.block, step.action == "remove") for step in plan.steps)
    placed = {step.block for step in steps}
    kept = [k for k in range(len(plan.assembly.blocks)) if k in placed]
    if len(kept) < len(plan.assembly.blocks):
        raise InputError("design", "blocks that stand before the first step", "none, for an arm")
    return Job(
        pieces_of(plan.assembly), steps, plan.assembly, get_arm(arm), (),
        friction=plan.assembly.friction, joint=joint,
    )  # fmt: skip


def wider(kit: Kit, gap: float) -> Kit:
    """The kit with vertical joints of this width [m]: blocks as they are, farther apart."""
    dx, dy, dz = kit.pitch
    room = gap - kit.joint_gap
    return replace(kit, pitch=(dx + room, dy + room, dz), joint_gap=gap)


def prepare(
    plan: Plan, workcell: Workcell, joint: float, progress: Progress = lambda text: None
) -> tuple[Job, Structure, Arranged, KinematicCell]:
    """The job, what rests on what, an order, and the cell that found it.

    Raises:
        InputError: for what cannot be held or reached, and for a layout that does not work.
    """
    job = set_up(job_of(plan, workcell.arm, joint), workcell.arm, workcell.tool, workcell.site)
    structure = Structure(job)
    cell = KinematicCell(job.arm, cells_of(job))
    return job, structure, arrange(job, structure, cell, progress), cell


def carry_out(
    plan: Plan, workcell: Workcell, *, joint: float = 1e-4, progress: Progress = lambda text: None,
    found: tuple[Job, Structure, Arranged, KinematicCell] | None = None,
) -> Plan:  # fmt: skip
    """A complete exact plan, carried out by an arm.

    Args:
        joint: width of a vertical joint [m].
        found: of :func:`prepare`, where that has been called.

    Raises:
        InputError: for what cannot be held or reached, and for a layout that does not work.
    """
    if not plan.complete or plan.assembly is None:
        return plan
    started = time.perf_counter()
    job, structure, order, cell = found or prepare(plan, workcell, joint, progress)
    if order.stuck:
        number, why = next(iter(order.stuck.items()))
        blocks = [job.pieces[k].id for k in order.stuck]
        listed = ", ".join(blocks[:3]) + (f" and {len(blocks) - 3} more" if blocks[3:] else "")
        gone = any(step.block == number and step.remove for step in job.steps)
        gone = gone and StepOf(number) in order.steps
        what = "take away" if gone else "place"
        reason = f"the arm cannot {what} {listed}: {job.pieces[number].id}: {why}"
        if gone and not (job.arm.suction and job.arm.suction.cups[1:]):
            reason += "; a tool that also takes hold of side faces, --tool suction-side, may"
        report = _report(job, workcell, None)
        return replace(plan, status="refused", reason=reason, steps=(), coverage=0.0, arm=report,
                       blocks=replace(plan.blocks, used=0),
                       assembly=replace(plan.assembly, steps=()))  # fmt: skip
    building = Building(
        job, order.steps, structure, cell, _physical(job, workcell), seed=workcell.seed,
        noise=workcell.noise, disturbance=workcell.disturbance, log=workcell.log,
        key=_key(plan, workcell), words=_words(job, workcell),
    )  # fmt: skip
    reason = building.run(progress)
    return _carried_out(plan, building, workcell, reason, time.perf_counter() - started)


def carry_out_cells(
    plan: Plan, kit: Kit, workcell: Workcell, progress: Progress,
    plan_again: Callable[[Kit], Plan],
) -> Plan:  # fmt: skip
    """As :func:`carry_out`, with the blocks farther apart where fingers have no room otherwise.

    Args:
        kit: of the plan.
        plan_again: plans the same cells with another kit.
    """
    if not plan.complete:
        return plan
    found = prepare(plan, workcell, kit.joint_gap, progress)
    gap = kit.joint_gap
    for room in FINGER_ROOMS:
        if not found[2].stuck or found[0].arm.suction is not None or room <= kit.joint_gap:
            continue
        progress(f"fingers have no room between the blocks: trying {1e3 * room:g} mm")
        other = plan_again(wider(kit, room))
        if other.complete:
            again = prepare(other, workcell, room, progress)
            if len(again[2].steps) > len(found[2].steps):
                plan, found, gap = other, again, room
    return carry_out(plan, workcell, joint=gap, progress=progress, found=found)


def _physical(job: Job, workcell: Workcell) -> PhysicalCell | None:
    if workcell.physics == "kinematic":
        return None
    from learn2assemble.robot.dynamic.cell import DynamicCell

    change = workcell.disturbance.friction if workcell.disturbance else 0.0
    return DynamicCell(job.arm, recover=True, friction=job.friction * (1 + change))


def _words(job: Job, workcell: Workcell) -> str:
    import mujoco

    if workcell.physics == "kinematic":
        return "kinematic cell: reach and collisions"
    holds = "a suction cup" if job.arm.suction else "friction of the fingers"
    return f"MuJoCo {mujoco.__version__}, arm and blocks together, held by {holds}"


def _key(plan: Plan, workcell: Workcell) -> str:
    """What a build must have in common with the one it goes on from."""
    import hashlib

    steps = [(s.block, s.action, s.kind, s.position) for s in plan.steps]
    # A magazine that ran empty may have been filled again.
    filled = tuple(magazine._replace(count=None) for magazine in workcell.site.magazines)
    site = replace(workcell.site, magazines=filled, source="")
    told = (steps, workcell.arm, workcell.tool, site, workcell.physics, workcell.seed,
            workcell.noise)  # fmt: skip
    return hashlib.sha256(repr(told).encode()).hexdigest()[:24]


def _report(job: Job, workcell: Workcell, building: Building | None) -> ArmReport:
    x, y, z = job.arm.base_position.tolist()
    facing = float(job.arm.base_yaw - get_arm(workcell.arm).base_yaw)
    base = round(x, 6), round(y, 6), round(z, 6), round(facing, 6)
    if building is None:
        return ArmReport(workcell.arm, 0.0, 0, (), 0.0, workcell.tool, base, len(job.sources))
    failures = tuple(
        ArmFailure(d.number, d.outcome, f"{d.what} {building.world.pieces[d.block].id}, {d.stage}: "
                   f"{d.detail}", False)
        for d in building.known.done if d.outcome != Outcome.REACHED.label
    )  # fmt: skip
    satisfied = sum(building.known.satisfied(step) for step in building.known.order)
    errors = [float(np.linalg.norm(building.world.pose[k, :3] - building.world.target(k)[:3]))
              for k in building.known.standing()]  # fmt: skip
    return ArmReport(
        workcell.arm, _pitch(job), len(building.known.done), failures,
        round(building.book.recorder.now, 2), workcell.tool, base, len(job.sources),
        round(len(building.known.done) / max(satisfied, 1), 4),
        round(float(np.mean(errors)), 6) if errors else None,
        round(max(errors), 6) if errors else None,
    )  # fmt: skip


def _pitch(job: Job) -> float:
    """Horizontal distance of neighbouring cells: the smallest block and a joint [m]."""
    return round(2 * min(float(p.half[:2].min()) for p in job.pieces) + job.joint, 6)


def _carried_out(
    plan: Plan, building: Building, workcell: Workcell, reason: str | None, seconds: float
) -> Plan:
    """The plan with what really happened."""
    job, world = building.job, building.world
    assert plan.assembly is not None
    last = {(d.block, d.what == "remove"): d for d in building.known.done
            if d.outcome == Outcome.REACHED.label and d.what != "away"}  # fmt: skip
    done = [step for step in building.known.order if building.known.satisfied(step)]
    done.sort(key=lambda step: last[step].number if step in last else 0)
    proven = {(s.block, s.action == "remove"): s for s in plan.steps}
    standing: set[int] = set()
    same = [(s.block, s.remove) for s in done] == [
        (s.block, s.action == "remove") for s in plan.steps
    ]
    steps: list[Step] = []
    share = {s.block: 0.0 for s in plan.steps}
    before = 0.0
    for step in plan.steps:
        share[step.block] += step.coverage - before if step.action == "place" else 0.0
        before = step.coverage
    covered = 0.0
    for number, step in enumerate(done, 1):
        standing = standing - {step.block} if step.remove else standing | {step.block}
        old, attempt = proven[step.block, step.remove], last.get((step.block, step.remove))
        covered += 0.0 if step.remove else share[step.block]
        stands = same or building.known.structure.stands(frozenset(standing))
        there = not step.remove and world.state[step.block] == STANDING
        pose = world.pose[step.block] if there else world.target(step.block)
        x, y, z, w, a, b, c = (round(float(v), 6) for v in pose)
        above = "above" if attempt is None or not attempt.sideways else "the side"
        how = f"suction from {above}" if job.arm.suction else "fingers"
        steps.append(
            replace(
                old, step=number, position=(x, y, z), quaternion=(w, a, b, c),
                coverage=round(covered, 6), margin_g=old.margin_g if same else None,
                tilt_deg=old.tilt_deg if same else None,
                proof=old.proof if same else "bed faces" if stands else "carried out",
                outcome=attempt.outcome if attempt else None, grasp=how,
            )
        )  # fmt: skip
    complete = reason is None
    made = tuple(
        AssemblyStep(remove=plan.assembly.blocks[s.block].id) if s.remove
        else AssemblyStep(place=plan.assembly.blocks[s.block].id) for s in done
    )  # fmt: skip
    assembly = Assembly(plan.assembly.blocks, made, plan.assembly.friction, plan.assembly.name)
    record = building.book.record() if building.physical is not None else None
    if record is not None:
        numbers = {(step.block, step.remove): n for n, step in enumerate(done, 1)}
        named = [
            dataclasses.replace(step, plan_step=numbers.get((d.block, d.what == "remove"))
                                if d.what in ("place", "again", "remove") else None)
            for step, d in zip(record.steps, building.known.done, strict=True)
        ]  # fmt: skip
        record = dataclasses.replace(record, steps=tuple(named))
    return replace(
        plan, status="complete" if complete else "incomplete", reason=reason, steps=tuple(steps),
        coverage=steps[-1].coverage if steps else 0.0, seconds=round(plan.seconds + seconds, 3),
        blocks=replace(plan.blocks, used=len(building.known.standing()),
                       waiting=_waiting(building)),
        verified_by=f"{plan.verified_by}, and {_words(job, workcell)}",
        arm=_report(job, workcell, building), record=record, assembly=assembly,
    )  # fmt: skip


def _waiting(building: Building) -> tuple[Any, ...]:
    """Where every block is taken from."""
    world, out = building.world, []
    for k in range(len(building.job.pieces)):
        number = world.source[k] if world.source[k] is not None else world.magazine(k)
        pose = world.presented(k, number or 0)
        out.append(tuple(round(float(v), 6) for v in pose[:3]))
    return tuple(out)
