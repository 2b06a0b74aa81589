"""Distances of two arms with what they hold, by a second library: against MuJoCo, and in builds."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import contextlib
import io
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import l2a_lab.stopped_arm as stopped_arm
import learn2assemble as l2a
from cell_shapes import wall
from l2a_lab import two_arms
from l2a_lab.arm_distances import MOMENTS, ArmDistances, Moment, WatchedCell
from l2a_lab.stopped_arm import Pressed, StoppedCell
from learn2assemble.acting import carry_out
from learn2assemble.assembly.kit import load_kit
from learn2assemble.cell.site import Site
from learn2assemble.cell.site_arms import SiteArm
from learn2assemble.cell.workcell import Workcell
from learn2assemble.cell.world import MISSING
from learn2assemble.cli import main
from learn2assemble.design.cells import CellDesign
from learn2assemble.errors import InputError
from learn2assemble.geometry.hulls import hull_of
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.motion.record import find_fault
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.plants.plant import (
    Motion,
    PlantError,
    Report,
    Stop,
)
from learn2assemble.plants.setup import Noise, Setup
from learn2assemble.robot.arm import arms_spec, get_arm, prefix_of
from learn2assemble.robot.bodies import Part, Shape
from learn2assemble.team.crew import Member
from learn2assemble.team.in_turn import build_by_two
from learn2assemble.team.members import plan_by_team, set_up_team
from learn2assemble.team.pair import Pair, gather
from learn2assemble.team.together import Together
from learn2assemble.team.traffic import Route, Traffic
from test_brick_team import Ordered, ordered_stair
from test_in_turn import beam_held_down
from test_together import crew_for, design

LEFT = get_arm("panda", "suction", (-0.35, 0.0, 0.0, 0.0))
RIGHT = get_arm("ur5e", "gripper", (0.35, 0.05, 0.0, np.pi))
ARMS = LEFT, RIGHT
CORNERS = np.array([[x, y, z] for x, y, z in np.ndindex(2, 2, 2)], float) * [0.06, 0.05, 0.04] - [
    0.03,
    0.025,
    0.02,
]
CORNERS[CORNERS[:, 2] > 0, 0] *= 0.6
SHAPES: dict[str, Shape] = {
    "wedge": (Part((0.0, 0.0, 0.0), (0.03, 0.025, 0.02), hull_of(CORNERS)),),
    "corner": (
        Part((0.03, 0.0, 0.0), (0.05, 0.02, 0.02)),
        Part((-0.04, 0.03, 0.0), (0.02, 0.05, 0.02)),
    ),
}
"""A hull that is no box, and two boxes in one."""
AGREED = 1e-4
"""By so much two libraries differ at most [m]; both go nearer step by step."""


class Truth:
    """Both arms, each with a block of its own, by MuJoCo."""

    def __init__(self) -> None:
        spec = arms_spec(ARMS)
        for name, shape in SHAPES.items():
            body = spec.worldbody.add_body(name=name)
            body.add_freejoint()
            for number, part in enumerate(shape):
                given = {"pos": part.centre}
                if part.hull is None:
                    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=part.half, **given)
                    continue
                mesh = spec.add_mesh(name=f"{name}{number}", uservert=part.hull.points.ravel())
                body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name, **given)
        self.model = m = spec.compile()
        self.data = mujoco.MjData(m)
        names = [m.body(int(b)).name for b in m.geom_bodyid]
        solid = (m.geom_contype | m.geom_conaffinity) > 0
        second = np.array([n.startswith(prefix_of(1)) or n == "corner" for n in names])
        self.sides = [np.flatnonzero(solid & (second == which)) for which in (False, True)]
        self.of = np.array(names)

    def __call__(self, moment: Moment) -> float:
        """[m]"""
        m, d = self.model, self.data
        d.qpos[: len(moment.joints)] = moment.joints
        for number, held in enumerate(moment.held):
            if held is not None:
                first = len(moment.joints) + 7 * number
                d.qpos[first : first + 7] = held[1]
        mujoco.mj_kinematics(m, d)
        there = {held[0] for held in moment.held if held is not None}
        one, two = (
            [g for g in side.tolist() if self.of[g] not in SHAPES or self.of[g] in there]
            for side in self.sides
        )
        return min(mujoco.mj_geomDistance(m, d, a, b, 2.0, None) for a in one for b in two)


def drawn(rng: np.random.Generator) -> Moment:
    """Arms somewhere around home, most of the time with a block near the hand of each."""
    joints: list[float] = []
    for arm in ARMS:
        joints += np.clip(arm.home + rng.normal(0, 0.5, len(arm.home)), *arm.limits()).tolist()
        joints += [0.01] * len(arm.gripper.joints)
    held: list[tuple[str, np.ndarray] | None] = []
    for name in SHAPES:
        turn = rng.normal(size=4)
        where = rng.uniform([-0.15, -0.2, 0.2], [0.15, 0.2, 0.5])
        pose = np.concatenate([where, turn / np.linalg.norm(turn)])
        held.append((name, pose) if rng.random() < 0.7 else None)
    return Moment(np.array(joints), tuple(held))


def test_distances_are_those_of_mujoco() -> None:
    """Of what overlaps the depth means little; that it does both say."""
    mine, truth, rng = ArmDistances(ARMS, SHAPES), Truth(), np.random.default_rng(0)
    moments = [drawn(rng) for _ in range(300)]
    found = np.array([mine.between(moment) for moment in moments])
    told = np.array([truth(moment) for moment in moments])
    apart = told > 1e-4
    assert 100 < apart.sum() < 290
    assert np.abs(found - told)[apart].max() < AGREED
    assert (found[told < -1e-3] <= 0).all()
    # Some are those of a block.
    bare = np.array([mine.between(moment._replace(held=(None, None))) for moment in moments])
    assert (bare[apart] - found[apart] > 1e-3).sum() > 20
    assert (bare >= found - AGREED).all()
    # Looked at together, nothing is lost by what is not looked at.
    some = [moment for moment, far in zip(moments, apart, strict=True) if far]
    assert mine.least(some).distance == pytest.approx(told[apart].min(), abs=AGREED)


def test_a_solid_that_nobody_knows_is_said() -> None:
    mine = ArmDistances(ARMS, {})
    mine.model.geom_type[0] = mujoco.mjtGeom.mjGEOM_ELLIPSOID
    with pytest.raises(ValueError, match="ELLIPSOID"):
        mine._geom(0)


def test_corners_of_a_block_are_where_they_are_drawn() -> None:
    """The frame of a held block is that of its pose."""
    mine = ArmDistances(ARMS, SHAPES)
    pose = np.array([0.1, 0.2, 0.9, *(np.array([0.9, 0.1, -0.3, 0.2]) / np.sqrt(0.95))])
    solids = mine._arm(0, ("corner", pose))
    wanted = (
        pose[:3] + np.array([p.centre for p in SHAPES["corner"]]) @ quaternion_matrix(pose[3:]).T
    )
    assert np.allclose(solids.place[-2:], wanted)


# ---------------------------------------------------------------- builds by two arms


@pytest.fixture(scope="module")
def crew() -> Pair:
    return crew_for(design(10, 2, 3), Workcell("ur5e"))


def counted(traffic: Traffic) -> list[bool]:
    """Of all that is announced from now on, whether it is behind what the other arm does."""
    found, announce = list[bool](), traffic.announce

    def told(who: int, route: Route, behind: bool = False) -> bool:
        fits = announce(who, route, behind)
        if fits:
            found.append(behind)
        return fits

    traffic.announce = told
    return found


def test_two_arms_build_by_two(crew: Pair) -> None:
    both = Together(crew, WatchedCell)
    told: list[str] = []
    announced = counted(both.traffic)
    assert both.run(told.append) is None
    assert both.complete
    assert {turn.arm for turn in both.turns} == {0, 1}
    first, second = ([t for t in both.turns if t.arm == who] for who in range(2))
    # Some are fetched while the other arm places what comes before them.
    assert len(announced) == len(both.turns)
    assert any(announced)
    # Both at the same time, and each one thing after the other.
    assert any(a.begin < b.end and b.begin < a.end for a in first for b in second)
    for mine in (first, second):
        assert all(a.end <= b.begin + 1e-9 for a, b in pairwise(mine))
    # No block came to where it would have been in the way of a lower one.
    placed = [turn.done.block for turn in sorted(both.turns, key=lambda turn: turn.end)]
    assert sorted(placed) == list(range(len(crew.found[0].job.pieces)))
    waits = [building.known.waits for building in both.buildings]
    assert all(waits)
    for step, lower in (item for under in waits for item in under.items()):
        assert all(placed.index(one.block) < placed.index(step.block) for one in lower)
    job = crew.found[0].job
    truth = both.plant.truth()
    for piece in job.pieces:
        assert np.linalg.norm(truth[piece.id][:3] - piece.pose[:3]) < 1e-3
    least = both.plant.least()
    assert least.moments == MOMENTS
    assert least.distance >= 0.010
    for record in both.records:
        assert find_fault(record) is None
        assert record.spans()[-1][1] <= both.seconds + 0.1


def test_two_arms_build_where_readings_are_not_exact() -> None:
    """It takes time to see a block that is presented, and both want the same one."""
    noise = Noise(5e-4, np.radians(0.2), 5e-4, missing=0.02)
    found = crew_for(design(8, 2, 2), Workcell("ur5e", noise=noise, seed=1))
    both = Together(found, WatchedCell)
    announced = counted(both.traffic)
    assert both.run() is None
    assert {turn.arm for turn in both.turns} == {0, 1}
    # Where the other arm's block will stand is not known before it does.
    assert not any(announced)
    assert both.plant.least().distance >= 0.010
    truth = both.plant.truth()
    for piece in found.found[0].job.pieces:
        assert np.linalg.norm(truth[piece.id][:3] - piece.pose[:3]) < 2e-3


def test_an_arm_that_is_stopped_leaves_the_other_one_safe(crew: Pair) -> None:
    """The first arm stops on its way across: it stands there, with what it holds, and the other one
    keeps its distance and does not place that block."""
    both = Together(crew, WatchedCell)
    mine, execute = both.plant.plants[0], both.plant.plants[0].execute

    def stopped(motion: Motion, *told: object) -> Report:
        if motion.stage == "cross" and len(both.turns) > 1:
            raise PlantError(Stop.PROTECTIVE, "somebody has pressed the button")
        return execute(motion, *told)  # pyright: ignore[reportArgumentType]

    mine.execute = stopped  # pyright: ignore[reportAttributeAccessIssue]
    why = both.run()
    assert why is not None
    assert "pressed the button" in why
    assert both.reasons[0] == why
    held = mine.held()
    assert held is not None
    # The other one knows that it is none of the plan any more, and does not look for it.
    world, like = both.buildings[1].world, both.buildings[1].recording.like
    spare = world.names.index(held)
    assert both.lost == {like[spare - len(crew.found[0].job.pieces)]}
    assert world.state[spare] == MISSING
    # The other one ends with a reason of its own, at rest.
    other = both.plant.plants[1]
    assert both.reasons[1]
    assert np.abs(other.sense().velocity).max() < 1e-2
    assert both.plant.least().distance >= 0.010
    # It hangs in the air: where it waits its middle is half of its height above the table.
    piece = crew.found[0].job.pieces[min(both.lost)]
    assert both.plant.truth()[held][2] > piece.half.min() + 0.02


def test_two_arms_are_measured_beside_the_faster_one() -> None:
    def one(seconds: float, least: float = 0.0) -> dict[str, Any]:
        told = {"status": "complete", "reason": None, "blocks": 5, "robot_s": seconds}
        return told | {"least_distance": least, "planning_s": 7.0}

    stuck = {"status": "refused", "reason": "why"}
    entries = {
        **{"others/a/ur5e": one(30.0), "others/a/panda": one(20.0)},
        **{"others/a/both": one(15.0, 0.0234)},
        # Of what one arm alone cannot build, the other one counts.
        **{"eight/b/ur5e": one(40.0), "eight/b/panda": stuck, "eight/b/both": one(10.0, 0.1)},
        "eight/c/ur5e": one(10.0),
        **{f"eight/d/{who}": stuck for who in ("ur5e", "panda")},
        "eight/d/both": one(5.0),
        "eight/e/both": stuck,
        "holds/arch of 9/0": one(80.0, 0.0167) | {"holds": 3, "posts": 1, "error_worst": 0.00042},
        "holds/arch of 9/1": one(70.0, 0.02) | {"holds": 2, "posts": 0, "error_worst": 0.0014},
        "holds/arch of 9/2": one(75.0, 0.02) | {"holds": 2, "posts": 0, "error_worst": 0.0002},
        "holds/arch of 9/3": {"status": "incomplete"},
        "stopped/a/0": {"status": "complete", "other_safe": True},
        "stopped/a/1": {"status": "incomplete", "other_safe": True},
    }
    rows = {what: got for what, _, got in two_arms.summary(entries)}
    assert rows == {
        "a": "5 blocks: 15.0 s over 20.0 s, 0.75, 23.4 mm apart at least, planned in 7.0 s",
        "b": "5 blocks: 10.0 s over 40.0 s, 0.25, 100.0 mm apart at least, planned in 7.0 s",
        "c": "not measured (None)",
        "d": "by two only",
        "e": "refused (why)",
        "arch of 9, one holds while the other one builds": "Of 4 builds of the arch of 9, 3 were "
        "complete, with 3 holds and 1 post set by hand at most, in 80.0 s at most. The block that "
        "was farthest from its place was 1.40 mm off at most, 0.42 mm in the middle of them; 2 "
        "kept 1 mm; the arms were 17 mm apart at least.",
        "two arms over one, others": "0.75 mean of 1",
        "two arms over one, eight": "0.25 mean of 1",
        "one arm stopped: other one safe, resumed and complete": "2 of 2, 1 of 2",
    }
    assert len(two_arms.EIGHT) == 8
    names = [name.split("/") for name in two_arms.names()]
    assert {name[2] for name in names if name[0] in two_arms.SETS} == {*two_arms.ARMS, "both"}


# ---------------------------------------------------------------- one holds, the other one builds


@pytest.fixture(scope="module")
def beam() -> tuple[Plan, list[Member]]:
    return beam_held_down()


OFF = 1e-3
"""So far from its place a block may be [m]."""


def built(beam: tuple[Plan, list[Member]]) -> tuple[Plan, WatchedCell]:
    cells: list[WatchedCell] = []

    def opened(setup: Any) -> WatchedCell:
        cells.append(WatchedCell(setup))
        cells[-1].places = {piece.id: piece.pose for piece in members[0].job.pieces}
        return cells[-1]

    plan, members = beam
    done = build_by_two(plan, members, Workcell("panda", hands=True), joint=0.0, opened=opened)
    return done, cells[0]


def off(plan: Plan, cell: WatchedCell) -> dict[str, float]:
    """How far blocks really are from their places [m]."""
    assert plan.assembly is not None
    middles = {b.id: (b.vertices.min(0) + b.vertices.max(0)) / 2 for b in plan.assembly.blocks}
    return {k: float(np.linalg.norm(p[:3] - middles[k])) for k, p in cell.truth().items()}


def test_one_arm_holds_until_the_other_one_has_placed_the_next_block(
    beam: tuple[Plan, list[Member]], tmp_path: Path
) -> None:
    done, cell = built(beam)
    assert done.complete, done.reason
    told = [(s.action, s.block, s.arm) for s in done.steps]
    assert told == [(s.action, s.block, s.arm) for s in beam[0].steps]
    assert ("hold", 1) in [one[:2] for one in told]
    away = off(done, cell)
    assert set(away) == {"pier", "beam", "stone"}
    assert max(away.values()) < OFF
    # Everything may move by then, and nothing does.
    cell.loosen()
    before = cell.truth()
    cell.come_to_rest()
    moved = [np.linalg.norm(p[:3] - before[k][:3]) for k, p in cell.truth().items()]
    assert max(moved) < 1e-4
    assert cell.least().distance >= 0.010
    assert [find_fault(record) for record in done.records] == [None, None]
    spans = {
        done.steps[one.plan_step - 1].block: (one.grip, one.release)
        for record in done.records
        for one in record.steps
        if one.plan_step is not None
    }
    (taken, left), (_, placed_at) = spans[1], spans[2]
    assert taken is not None
    assert left is not None
    assert placed_at is not None
    assert taken < placed_at < left
    done.save(tmp_path)
    again = l2a.load_plan(tmp_path)
    assert [s.action for s in again.steps] == [s.action for s in done.steps]


# ---------------------------------------------------------------- bricks that are pressed home


@pytest.fixture(scope="module")
def stair() -> Ordered:
    return ordered_stair()


def test_two_arms_build_bricks_and_a_part_beside(stair: Ordered) -> None:
    """Both work at the same time, and what one presses home the other one knows to be so."""
    plan, order, members = stair
    crew = gather(plan, members, Workcell("panda", "gripper"), 0.0, order)
    both = Together(crew, WatchedCell)
    presses: list[tuple[float, float]] = []
    enter, lets_go, begun = both.traffic.enter, both.traffic.lets_go, dict[int, float]()

    def entered(who: int, motion: Motion) -> bool:
        done = enter(who, motion)
        if done and both.traffic.lanes[who].loading:
            begun[who] = both.plant.time
        return done

    def let_go(who: int) -> None:
        if both.traffic.lanes[who].loading:
            presses.append((begun[who], both.plant.time))
        lets_go(who)

    both.traffic.enter, both.traffic.lets_go = entered, let_go
    assert both.run() is None
    assert both.complete
    assert {turn.arm for turn in both.turns} == {0, 1}
    assert [turn.done.what for turn in both.turns].count("attach") == 1
    assert any(a.end > b.begin for a, b in pairwise(sorted(both.turns, key=lambda t: t.begin)))
    # The first brick of the part is set down on the table.
    assert len(presses) == 4
    assert all(a[1] <= b[0] for a, b in pairwise(sorted(presses)))
    joints = {(-1, 0), (0, 1), (1, 2), (2, 3)}
    assert both.plant.home == joints
    for building in both.buildings:
        assert building.world.home == joints
        assert not building.world.beside.any()
    truth = both.plant.truth()
    for piece in crew.found[0].job.pieces:
        assert np.linalg.norm(truth[piece.id][:3] - piece.pose[:3]) < 1e-4
    assert both.plant.least().distance >= 0.010


def test_a_build_of_which_an_arm_was_stopped_while_it_pressed_goes_on(
    stair: Ordered, tmp_path: Path
) -> None:
    """The other arm presses on nothing then; when the build goes on, what was home is home."""
    plan, order, members = stair
    workcell = Workcell("panda", "gripper", hands=True, log=tmp_path / "build.jsonl")
    cells: list[WatchedCell] = []
    pressed: list[float] = []

    def opened(setup: Setup) -> WatchedCell:
        cells.append(cell := WatchedCell(setup))
        for who, plant in enumerate(cell.plants):
            plant.execute = told(cell, who, plant.execute)  # pyright: ignore
        return cell

    def told(cell: WatchedCell, who: int, execute: Any) -> Any:
        def executed(motion: Motion, commands: Any = (), guards: Any = ()) -> Report:
            report = execute(motion, commands, guards)
            if any(guard.bears for guard in guards) and cell.home and len(cells) == 1:
                assert not pressed, f"arm {who} presses though the other one was stopped"
                pressed.append(cell.time)
                raise PlantError(Stop.PROTECTIVE, "somebody has pressed the button")
            return report

        return executed

    stopped = build_by_two(plan, members, workcell, joint=0.0, order=order, opened=opened)
    assert stopped.status == "incomplete"
    assert "pressed the button" in (stopped.reason or "")
    done = build_by_two(plan, members, workcell, joint=0.0, order=order, opened=opened)
    assert done.complete, done.reason
    # What is built beside, and brought by one arm, is no step of the other one.
    worked = [arm.did for arm in done.arms if arm.did is not None and arm.did.attempts]
    assert worked
    assert all((one.attempts_per_step or 0.0) >= 1.0 for one in worked)
    assert cells[1].home == {(-1, 0), (0, 1), (1, 2), (2, 3)}
    assert min(cell.least().distance for cell in cells) >= 0.010


# ---------------------------------------------------------------- builds that were stopped


KIT = load_kit("bricks")


COUNT = 7
"""Blocks of the wall."""
STOP = 1, 12.0
"""The arm that is stopped, and when [s]."""


@pytest.fixture(scope="module")
def planned() -> tuple[Plan, list[Member]]:
    design = CellDesign("wall", wall(10, 2, 2), KIT.pitch, None, 0.0, None, "", None)
    plan = plan_cells(design, KIT)
    assert plan.assembly is not None
    members = set_up_team(plan.assembly, [SiteArm(a, a) for a in ("ur5e", "panda")], Site())
    options = {"friction": None, "gap": KIT.joint_gap, "seconds": 60.0}
    return plan_by_team(plan.assembly, members, options=options), members


def build(
    planned: tuple[Plan, list[Member]], log: Path, pressed: Pressed | None = None
) -> tuple[Plan, StoppedCell]:
    cells: list[StoppedCell] = []

    def opened(setup: Any) -> StoppedCell:
        cells.append(StoppedCell(setup, pressed))
        return cells[-1]

    plan, members = planned
    cell = Workcell("ur5e", log=log)
    return build_by_two(plan, members, cell, joint=KIT.joint_gap, opened=opened), cells[0]


@pytest.fixture(scope="module")
def stopped(
    planned: tuple[Plan, list[Member]], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Plan, StoppedCell, str]:
    """What came of a build of which an arm was stopped, its cell, and its file."""
    log = tmp_path_factory.mktemp("stopped") / "build.jsonl"
    return *build(planned, log, Pressed(*STOP)), log.read_text(encoding="utf-8")


def is_whole(plan: Plan, cell: WatchedCell) -> None:
    """Every block is where it shall be, each placed once."""
    assert plan.complete, plan.reason
    assert plan.assembly is not None
    truth = cell.truth()
    standing = [pose for pose in truth.values() if pose[2] > 0]
    for block in plan.assembly.blocks:
        middle = (block.vertices.min(0) + block.vertices.max(0)) / 2
        off = [np.linalg.norm(pose[:3] - middle) for pose in standing]
        assert sum(far < 1e-3 for far in off) == 1, block.id
    assert [step.step for step in plan.steps] == [*range(1, COUNT + 1)]
    assert sum(len(record.steps) for record in plan.records) >= COUNT
    for arm, record in zip(plan.arms, plan.records, strict=True):
        assert arm.did is not None
        assert arm.did.attempts == len(record.steps)


def test_a_build_whose_arm_was_stopped_is_gone_on_with(
    planned: tuple[Plan, list[Member]],
    stopped: tuple[Plan, StoppedCell, str],
    tmp_path: Path,
) -> None:
    log = tmp_path / "build.jsonl"
    first, cell, text = stopped
    log.write_text(text, encoding="utf-8")
    assert first.status == "incomplete"
    assert "pressed the button" in (first.reason or "")
    assert cell.stage
    # The other one does what it can, and stands then.
    assert np.abs(cell.plants[1 - STOP[0]].sense().velocity).max() < 1e-2
    assert cell.least().distance >= 0.010
    before = len(first.steps)
    assert before < COUNT
    again, cell = build(planned, log)
    is_whole(again, cell)
    assert cell.least().distance >= 0.010
    assert again.robot_s is not None
    assert first.robot_s is not None
    assert again.robot_s > first.robot_s


def test_a_build_that_was_ended_by_force_is_gone_on_with(
    planned: tuple[Plan, list[Member]], tmp_path: Path
) -> None:
    """While one arm ended an attempt the other one was in the middle of its own, which never
    happened then."""
    log = tmp_path / "build.jsonl"
    whole, cell = build(planned, log)
    is_whole(whole, cell)
    lines = log.read_text(encoding="utf-8").splitlines(keepends=True)
    assert len(lines) == 1 + COUNT
    log.write_text("".join(lines[:5]) + lines[5][:40], encoding="utf-8")
    again, cell = build(planned, log)
    is_whole(again, cell)
    assert len(log.read_text(encoding="utf-8").splitlines()) >= 1 + COUNT
    assert sum(len(record.steps) for record in again.records) == COUNT


def test_the_file_of_another_build_is_refused(
    planned: tuple[Plan, list[Member]],
    stopped: tuple[Plan, StoppedCell, str],
    tmp_path: Path,
) -> None:
    """That of the same plan by arms of other names is one."""
    log = tmp_path / "build.jsonl"
    plan, members = planned
    log.write_text(stopped[2], encoding="utf-8")
    other = [replace(members[0], name="left"), members[1]]
    with pytest.raises(InputError, match="--resume"):
        build((plan, other), log)


def test_the_command_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.save(tmp_path / "wall.npy", wall(6, 2, 2))
    words = ["build", str(tmp_path / "wall.npy"), "--arm", "ur5e", "--arm", "panda"]
    words += ["--no-video", "--out", str(tmp_path / "out")]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        with monkeypatch.context() as patch:
            patch.setattr(
                carry_out, "open_plant", lambda _, setup: StoppedCell(setup, Pressed(0, 3.0))
            )
            assert main(words) == 1
        state = tmp_path / "out" / "build.jsonl"
        assert state.exists()
        assert main([*words, "--resume"]) == 0
    assert not state.exists()
    plan = Plan.load(tmp_path / "out")
    assert plan.complete
    assert {step.arm for step in plan.steps} == {"ur5e", "panda"}


def test_stops_are_drawn_of_the_whole_build() -> None:
    found = stopped_arm.drawn(200, 40.0)
    assert {one.arm for one in found} == {0, 1}
    times = np.array([one.at for one in found])
    assert times.min() >= 0
    assert times.max() <= 40
    assert np.histogram(times, 4, (0, 40))[0].min() > 30
    assert stopped_arm.drawn(200, 40.0) == found
