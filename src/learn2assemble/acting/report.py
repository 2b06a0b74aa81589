"""What came of a build: the plan as it was carried out, and what the arm did.

Where the plant is a simulation, this is the one place that asks it how things really are, when the
build is over; whoever decides has seen none of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.acting.building import ASIDE, ATTACH, Building
from learn2assemble.acting.state import Done
from learn2assemble.assembly.blocks import AssemblyStep
from learn2assemble.cell.pieces import PROP_ROOM, planed_props
from learn2assemble.cell.workcell import Job, StepOf, Workcell
from learn2assemble.cell.world import STANDING
from learn2assemble.geometry.hulls import separation
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.motion.record import BuildRecord
from learn2assemble.planning.plan import LARGEST, Plan, Status, Step
from learn2assemble.planning.reports import ArmFailure, ArmReport
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.bodies import Shape, Solid, solids
from learn2assemble.robot.moves import Outcome
from learn2assemble.statics.proofs import LEVEL
from learn2assemble.values import rounded

EXACT = 1e-6
"""Poses that differ by less are the same [m]."""


def words_of(job: Job, workcell: Workcell) -> str:
    """What the outcomes of a build come from."""
    import mujoco

    if workcell.physics == "kinematic":
        return "kinematic cell: reach and collisions"
    holds = "friction of the fingers"
    if job.arm.suction is not None:
        holds = "a socket on a stud" if job.arm.suction.studs else "a suction cup"
    return f"MuJoCo {mujoco.__version__}, arm and blocks together, held by {holds}"


class Attempted(NamedTuple):
    """What came of an attempt, of several arms."""

    arm: int
    """Number of the arm."""
    done: Done


def arm_report(
    job: Job,
    workcell: Workcell,
    building: Building | None,
    plant: object = None,
    others: frozenset[StepOf] = frozenset(),
) -> ArmReport:
    """What the arm did, and how far the blocks really are from their places where a simulation can
    tell.

    Args:
        others: steps that other arms have done.
    """
    x, y, z = map(rounded, job.arm.base_position.tolist())
    base = x, y, z, rounded(job.arm.base_yaw - get_arm(workcell.arm).base_yaw)
    if building is None:
        return ArmReport(workcell.arm, 0.0, 0, (), 0.0, workcell.tool, base, len(job.sources))
    failures = tuple(
        ArmFailure(
            d.number,
            d.outcome,
            f"{', '.join(filter(None, (moved, d.stage)))}: {d.detail}",
            False,
        )
        for d in building.known.attempts()
        for moved in (f"{d.what} {building.world.pieces[d.block].id}",)
        if d.outcome != Outcome.REACHED.label
    )
    attempts = len(building.known.attempts())
    satisfied = sum(
        building.known.satisfied(step)
        for step in building.known.planned
        if step not in building.known.by_hand and (step if step.group else step.plain) not in others
    )
    told = plant if workcell.strays else None  # Else nothing can be off, which tells nothing.
    measured = measure(building, told, {step.block for step in others})
    seconds = round(building.recording.recorder.now, 2)
    planed = len(planed_props(job.assembly))
    return ArmReport(
        workcell.arm,
        _pitch(job),
        attempts,
        failures,
        seconds if seconds or workcell.physics != "kinematic" else None,
        workcell.tool,
        base,
        len(job.sources),
        round(attempts / max(satisfied, 1), 4),
        measured.mean,
        measured.worst,
        belief_error=measured.belief,
        overlap=measured.overlap,
        error_on_table=measured.on_table,
        planed_props=planed,
        planed_off=PROP_ROOM if planed else 0.0,
    )


class Witness:
    """What a simulation says of itself after every attempt; nobody looks at it before the build is
    over.

    Args:
        plant: which may be none that tells.
    """

    def __init__(self, plant: object) -> None:
        self.truth: Callable[[], dict[str, np.ndarray]] | None = getattr(plant, "truth", None)
        self.told: list[dict[str, np.ndarray]] = []

    def __call__(self) -> None:
        if self.truth is not None:
            self.told.append(self.truth())


class Measured(NamedTuple):
    """Of a simulation when a build is over [m]; None where nothing can be measured."""

    mean: float | None = None
    """Mean distance of the blocks from their places, and ..."""
    worst: float | None = None
    """... the largest."""
    belief: float | None = None
    """Largest distance of a block from where it is believed to be."""
    overlap: float | None = None
    """By which two blocks overlap at most, as they really are; at most 0: they do not."""
    on_table: float | None = None
    """Largest distance of a block from its place on the table as it really is, where that is not
    as it should be."""


def measure(building: Building, plant: object, others: set[int]) -> Measured:
    """What a simulation says of itself; the build is over and has seen none of it.

    Args:
        others: blocks of which other arms tell.
    """
    world, every = building.world, sorted(building.known.standing())
    shown: Any = plant
    there = [k for k in every if k not in others and not world.pieces[k].fixed]
    if not hasattr(plant, "truth") or not there:
        return Measured()
    shapes: dict[str, Shape] = getattr(plant, "shapes", dict)()
    truth, worst = shown.truth(), None
    away = np.array([0.0, 0.0, -1.0, 1.0, 0.0, 0.0, 0.0])
    poses = {k: truth.get(world.names[k], away) for k in every}
    poses |= {k: world.drawn(k) for k in every if world.pieces[k].fixed}
    errors = [float(np.linalg.norm(poses[k][:3] - world.drawn(k)[:3])) for k in there]
    table = getattr(plant, "table", None)
    if table is not None and (table[:3].any() or table[3] != 1.0):
        meant = np.array([world.drawn(k)[:3] for k in there])
        meant = table[:3] + meant @ quaternion_matrix(table[3:]).T
        off = np.array([poses[k][:3] for k in there]) - meant
        worst = round(float(np.linalg.norm(off, axis=1).max()), 6)
    belief = [float(np.linalg.norm(poses[k][:3] - world.pose[k, :3])) for k in there]
    bodies = [solids(shapes.get(world.names[k], world.pieces[k].shape), poses[k]) for k in every]
    deepest = deepest_overlap(bodies)
    overlap = None if deepest is None else round(deepest, 6)
    return Measured(
        round(float(np.mean(errors)), 6),
        round(max(errors), 6),
        round(max(belief), 6),
        overlap,
        worst,
    )


def deepest_overlap(bodies: Sequence[list[Solid]]) -> float | None:
    """By which two blocks overlap at most [m], below 0 where there is room between all of them;
    None where no two are within a millimetre of each other.

    Args:
        bodies: the parts of every block where it is, see :func:`~.bodies.solids`.
    """
    ends = [
        (np.min([part[0].min(0) for part in body], 0), np.max([part[0].max(0) for part in body], 0))
        for body in bodies
    ]
    deepest = [
        -separation(a, b)[0]
        for n, (one, (low, high)) in enumerate(zip(bodies, ends, strict=True))
        for other, (least, most) in zip(bodies[n + 1 :], ends[n + 1 :], strict=True)
        if (least < high + 1e-3).all() and (most > low - 1e-3).all()
        for a in one
        for b in other
    ]
    return max(deepest, default=None)


def _pitch(job: Job) -> float:
    """Horizontal distance of neighbouring cells: the smallest block and a joint [m]."""
    return round(2 * min(float(p.half[:2].min()) for p in job.pieces) + job.joint, 6)


class Worked(NamedTuple):
    """An arm when its build is over."""

    building: Building
    workcell: Workcell
    witness: Witness
    name: str | None = None
    """As steps call it; None: there is no other one."""


def none_placed(plan: Plan, reason: str, status: Status = "refused") -> Plan:
    """What comes of a plan of which nothing is placed."""
    assert plan.assembly is not None
    blocks = replace(plan.blocks, used=0)
    assembly = replace(plan.assembly, steps=(), not_built=())
    return replace(
        plan, status=status, reason=reason, steps=(), coverage=0.0, blocks=blocks, assembly=assembly
    )


def carried_out(
    plan: Plan,
    arms: Sequence[Worked],
    reason: str | None,
    seconds: float,
    plant: object,
    attempted: Sequence[Attempted] | None = None,
) -> Plan:
    """The plan with what really happened.

    Args:
        arms: all of them; each knows where everything is.
        attempted: what came of their attempts, in the order in which these ended; of one arm as
            it tells itself.
    """
    building = arms[0].building
    job, world = building.job, building.world
    assert plan.assembly is not None
    if attempted is None:
        attempted = [Attempted(0, done) for done in building.known.done]
    last = {
        d.step: (number, arms[who], d)
        for number, (who, d) in enumerate(attempted)
        if d.outcome == Outcome.REACHED.label and d.what not in ASIDE
    }
    every = dict.fromkeys(chain.from_iterable(one.building.known.planned for one in arms))
    order = [step for step in every if not step.group]
    brought = _brought(every, attempted)
    apart = {step.block for step in order if step.beside is not None}
    done = [step.plain for step in order if building.known.satisfied(step)]
    moved = [s for s in plan.steps if s.action in ("place", "remove")]
    proven = {StepOf(s.block, s.action == "remove"): s for s in moved}
    if len(moved) < len(plan.steps):
        # An attempt of which the block is held ends when that is let go.
        done = [step for step in proven if step in done]
    else:
        # What was done though its attempt failed in something else was done in that one.
        ended = {d.step: n for n, (_, d) in enumerate(attempted) if d.what not in ASIDE}
        ended |= {step: one[0] for step, one in last.items()}
        came = {k: when for step, (when, _) in brought.items() for k in (step.block, *step.group)}

        def when(step: StepOf) -> tuple[int, int]:
            itself = ended.get(step, -1)
            return max(came.get(step.block, -1), itself), itself

        done.sort(key=when)
    # What is only listed, not proven, has to be: of bricks an arm finds the order.
    same = done == list(proven) and all(step.proof for step in moved)
    standing = set(job.there)
    covered = before = _covered_first(job)
    steps: list[Step] = []
    share = {s.block: 0.0 for s in moved}
    for step in moved:
        share[step.block] += step.coverage - before if step.action == "place" else 0.0
        before = step.coverage
    for number, step in enumerate(done, 1):
        standing = standing - {step.block} if step.remove else standing | {step.block}
        old, (_, by, attempt) = proven[step], last.get(step, (0, arms[0], None))
        covered += 0.0 if step.remove else share[step.block]
        if not same:
            shown = building.known.structure.proof(frozenset(standing))
            old = old.with_proof(*(shown or ("carried out", None)))
        there = not step.remove and world.state[step.block] == STANDING
        pose = world.pose[step.block] if there else world.target(step.block)
        x, y, z, w, a, b, c = (rounded(v) for v in pose)
        above = "above" if attempt is None or not attempt.sideways else "the side"
        tool = by.building.job.arm.suction
        how = "fingers" if tool is None else "socket" if tool.studs else f"suction from {above}"
        hand = attempt is not None and attempt.hand
        steps.append(
            replace(
                old,
                step=number,
                position=(x, y, z),
                quaternion=(w, a, b, c),
                coverage=round(covered, 6),
                outcome=attempt.outcome if attempt and not hand else None,
                way="beside" if step.block in apart else old.way,
                grasp="by hand" if hand else how,
                by_hand=hand,
                arm=None if hand else by.name,
            )
        )
    made = [
        AssemblyStep(
            place=None if s.remove else plan.assembly.blocks[s.block].id,
            remove=plan.assembly.blocks[s.block].id if s.remove else None,
            by_hand=step.by_hand or None,
            way="beside" if step.way == "beside" else None,
        )
        for s, step in zip(done, steps, strict=True)
    ]
    numbers = {step: n for n, step in enumerate(done, 1)}
    if len(moved) < len(plan.steps):
        steps, made = _with_holds(plan, steps, made)
        of = [StepOf(s.block, s.action == "remove") for s in steps]
        numbers = {step: n for n, step in reversed([*enumerate(of, 1)])}
    assembly = replace(plan.assembly, steps=tuple(made), not_built=())
    assembly = assembly.as_far_as_placed(plan.assembly.blocks[k].id for k in job.standing)
    ranges: dict[str, Any] = {}
    if not same:
        # The ranges of the planner hold for its states; these were proven for one friction and one
        # joint, but for loads that level joints pass down without friction, as the planner says it.
        whole = all(step.margin_g is not None for step in steps)
        free = all(step.proof in LEVEL for step in steps)
        ranges = {
            "friction_range": (0.0, LARGEST) if free else (job.friction, job.friction),
            "gap_range": (job.joint, job.joint),
        }
        ranges = ranges if whole else dict.fromkeys(ranges)
        ranges["margin_friction"] = job.friction
    taken_by = [
        last[StepOf(k)][1] if StepOf(k) in last else arms[0] for k in range(len(job.pieces))
    ]
    waiting = tuple(_waiting(one.building, k) for k, one in enumerate(taken_by))
    by_whom = {step: by for step, (_, by, _) in last.items()}
    by_whom |= {step: arms[who] for step, (_, who) in brought.items()}
    reports = [
        arm_report(
            one.building.job,
            one.workcell,
            one.building,
            plant if len(arms) == 1 or any(by is one for by in by_whom.values()) else None,
            frozenset(step for step, by in by_whom.items() if by is not one),
        )
        for one in arms
    ]
    told = [replace(arm, did=did) for arm, did in zip(plan.arms, reports, strict=False)]
    used = sum(not job.pieces[k].fixed for k in building.known.standing())
    return replace(
        plan,
        status="incomplete" if reason else "complete",
        reason=reason,
        steps=tuple(steps),
        coverage=steps[-1].coverage if steps else 0.0,
        seconds=round(plan.seconds + seconds, 3),
        blocks=replace(plan.blocks, used=used, waiting=waiting),
        verified_by=f"{plan.verified_by}, and {words_of(job, arms[0].workcell)}",
        arm=None if told else reports[0],
        arms=tuple(told),
        records=tuple(_recorded(one, numbers) for one in arms if one.building.recorded),
        assembly=assembly,
        **ranges,
    )


def _brought(
    steps: Iterable[StepOf], attempted: Sequence[Attempted]
) -> dict[StepOf, tuple[int, int]]:
    """Of pieces that were built beside: which attempt has brought them at last, and which arm.

    Args:
        steps: of all arms, in an order in which what is brought to a larger piece comes before it.
    """
    found = {
        done.block: (number, who)
        for number, (who, done) in enumerate(attempted)
        if done.what == ATTACH and done.outcome == Outcome.REACHED.label
    }
    each = sorted(steps, key=lambda step: found.get(step.block, (-1, 0)))
    return {step: found[step.block] for step in each if step.group and step.block in found}


def _covered_first(job: Job) -> float:
    """The share of what stands at last that does so before the first step."""
    removed = {step.block for step in job.steps if step.remove}
    last = {*job.standing, *(step.block for step in job.steps)} - removed
    return round(len(last & set(job.standing)) / max(len(last), 1), 6)


def _with_holds(
    plan: Plan, steps: Sequence[Step], made: Sequence[AssemblyStep]
) -> tuple[list[Step], list[AssemblyStep]]:
    """Steps that were carried out in the order of the plan, as far as that came, with those that
    hold a block and let go of it; of the plan and of its assembly.

    Args:
        steps: those that place a block or take it away.
        made: the same of the assembly.
    """
    assert plan.assembly is not None
    told = {(s.block, s.action): (s, one) for s, one in zip(steps, made, strict=True)}
    found, placed = list[tuple[Step, AssemblyStep]](), set[int]()
    for step, one in zip(plan.steps, plan.assembly.steps, strict=True):
        if step.action in ("hold", "release"):
            found += [(step, one)] if step.block in placed else []
        elif (step.block, step.action) in told:
            found.append(told[step.block, step.action])
            placed.add(step.block)
    numbered = [replace(step, step=n) for n, (step, _) in enumerate(found, 1)]
    return numbered, [one for _, one in found]


def _recorded(arm: Worked, numbers: dict[StepOf, int]) -> BuildRecord:
    """What an arm did, with where things really were.

    Args:
        numbers: of the steps of the plan.
    """
    building, record = arm.building, arm.building.recording.record()
    # Of a build that was gone on with, what was before it is not told any more.
    told = [None] * (len(record.steps) - len(arm.witness.told)) + arm.witness.told
    return replace(
        record,
        steps=tuple(
            replace(
                step,
                plan_step=None if d.what in ASIDE else numbers.get(d.step),
                truth=_really(building, step.after, poses),
            )
            for step, d, poses in zip(record.steps, building.known.attempts(), told, strict=True)
        ),
    )


def _really(
    building: Building, seen: np.ndarray, poses: dict[str, np.ndarray] | None
) -> np.ndarray | None:
    """float64[C, 7]: where all cells really were, None where nobody told or all was seen so."""
    if poses is None:
        return None
    found = building.recording.cells_at(poses, seen)
    return found if np.abs(found - seen).max() > EXACT else None


def _waiting(building: Building, k: int) -> Any:
    """Where an arm takes a block from [m]."""
    world = building.world
    number = world.source[k] if world.source[k] is not None else world.magazine(k)
    pose = world.target(k) if number is None else world.presented(k, number)
    return tuple(rounded(v) for v in pose[:3])
