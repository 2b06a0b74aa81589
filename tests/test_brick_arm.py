"""Bricks that clutch, pressed home by an arm: order and grasps, and what is built beside."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.bricks.model import Brick, BrickModel, assembly_of
from learn2assemble.assembly.joints import Joint
from learn2assemble.assembly.kit import load_kit
from learn2assemble.cell.bricks import BrickStates
from learn2assemble.cell.reach import ReachReport
from learn2assemble.cell.workcell import ROOMS
from learn2assemble.errors import InputError
from learn2assemble.export.robot_programs import export_program, read_program
from learn2assemble.handling.dry_run import play
from learn2assemble.handling.dynamic_cell import DynamicCell
from learn2assemble.kinematics.cell import KinematicCell
from learn2assemble.motion.files import read_record, write_record
from learn2assemble.motion.program import PRESS_SHARE
from learn2assemble.motion.record import find_fault
from learn2assemble.planning.plan import Plan
from learn2assemble.progress import Detail
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.holding import LEAST_GRIP, PAD, STUD_ROOM, holds_of
from learn2assemble.robot.moves import Move, Scene
from learn2assemble.statics.proofs import CLUTCH
from learn2assemble.team.members import TeamReach
from learn2assemble.viewer.arm import arm_section, object_name
from learn2assemble.viewer.errors import MOST, truth_data
from learn2assemble.viewer.playback import Playback

DUPLO = load_kit("duplo")


def duplo(*given: tuple[tuple[int, int], tuple[int, int, int]]) -> Assembly:
    """Large bricks of some extents at corners in studs and layers."""
    made = [Brick(at, (a, b, 1), f"brick {k}") for k, ((a, b), at) in enumerate(given)]
    return assembly_of(BrickModel(tuple(made)), DUPLO, "test")


STAIR = duplo(((4, 2), (0, 0, 0)), ((2, 2), (0, 0, 1)), ((2, 2), (1, 0, 2)), ((2, 2), (2, 0, 3)))
"""Its last brick alone tips the one below it when it is pressed home."""
WALL = duplo(
    ((2, 4), (0, 0, 0)),
    ((2, 4), (0, 4, 0)),
    ((2, 4), (0, 2, 1)),
    ((2, 2), (0, 0, 1)),
    ((2, 2), (0, 6, 1)),
)


def test_what_tips_when_it_is_pressed_is_built_beside() -> None:
    told: list[str] = []
    plan = l2a.build(STAIR, arm="panda", physics="kinematic", progress=told.append)
    # A line of its own for each block would fill a terminal.
    orders = [line for line in told if line.startswith("an order the arm can reach: ")]
    assert orders
    assert all(isinstance(line, Detail) for line in orders)
    assert plan.complete
    assert plan.arm is not None
    assert plan.arm.tool == "gripper"
    assert [step.way for step in plan.steps] == ["above", "above", "beside", "beside"]
    # The two that are built beside come in one more move.
    assert plan.arm.attempts == len(plan.steps) + 1
    assert plan.arm.error_worst is None
    states = BrickStates(STAIR)
    three = frozenset({0, 1, 2})
    assert states.stands(three | {3})
    assert not states.stands_pressed([3], three)
    assert states.stands_pressed([2, 3], frozenset({0, 1}))


def test_steps_of_an_arm_are_proven_also_in_the_order_in_which_bricks_are_listed() -> None:
    """Of cells: the plan of the arm says as much of the design as that without one."""
    cells = np.ones((2, 1, 2), bool)
    alone = l2a.build(cells, kit="lego")
    plan = l2a.build(cells, kit="lego", arm="panda", physics="kinematic")
    assert plan.complete, plan.reason
    assert (plan.kit, plan.cells) == (alone.kit, alone.cells)
    assert plan.without_margin == alone.without_margin == 0
    assert [step.proof for step in plan.steps] == [CLUTCH] * len(plan.steps)
    assert plan.margin_g == pytest.approx(alone.margin_g, rel=1e-3)


@pytest.fixture(scope="module")
def stair() -> Plan:
    plan = l2a.build(STAIR, arm="panda")
    assert plan.complete, plan.reason
    return plan


def test_a_build_with_a_part_beside_becomes_a_program_that_presses(
    stair: Plan, tmp_path: Path
) -> None:
    """Played without looking, bricks come home on their studs: by pushes alone."""
    assert stair.record is not None
    assert find_fault(stair.record) is None
    write_record(stair.record, tmp_path / "trajectory.json")
    again = read_record(tmp_path / "trajectory.json")
    assert again.studs is not None
    assert stair.record.studs is not None
    assert len(again.studs.joints) == len(stair.record.studs.joints) == 4
    for name in ("program.csv", "program.mcap"):
        file = tmp_path / name
        export_program(tmp_path, "csv" if name.endswith("csv") else "ros2", file)
        program, arm = read_program(file, "panda")
        assert [len(step.cells) for step in program.steps] == [1, 1, 1, 1, 2]
        pushes = sorted({state.press for state in program.states})
        assert pushes == pytest.approx([0.0, PRESS_SHARE * DUPLO.joint.press])
        done = play(program, arm)
        assert done.same, done.fault
    gently = tuple(state._replace(press=state.press / 4) for state in program.states)
    done = play(replace(program, states=gently), arm)
    assert not done.same
    assert "loose on its studs" in done.fault


def test_a_page_names_all_that_is_brought_as_one(stair: Plan) -> None:
    names = [block.id for block in STAIR.blocks]
    told = [object_name(step, names) for step in stair.record.steps] if stair.record else []
    assert told == [*names, f"{names[2]} and {names[3]}"]
    page = arm_section(Playback(stair.records, stair), names)
    assert page.count(f"<td>{told[-1]}</td>") == 1


def test_small_errors_are_not_drawn_as_large_as_blocks(stair: Plan) -> None:
    """They were drawn 2,478 times as large where none was more than 0.02 mm."""
    assert stair.record is not None
    off = np.zeros((len(STAIR.blocks), 7))
    off[:, 0] = 1e-6
    steps = tuple(replace(step, truth=step.after + off) for step in stair.record.steps)
    drawn = truth_data(Playback((replace(stair.record, steps=steps),), stair))
    assert drawn is not None
    assert drawn["scale"] == MOST


def test_a_run_presses_what_is_built_beside(stair: Plan) -> None:
    """It knew no studs: "left_finger touches b4"."""
    ran = l2a.run(stair)
    assert ran.complete, ran.reason
    assert ran.blocks == len(STAIR.blocks)


def test_what_is_built_beside_comes_as_it_is() -> None:
    """A part of two bricks of which one is turned by a quarter, pressed home as one."""
    bridge = duplo(
        ((4, 2), (0, 3, 0)),
        ((4, 2), (0, 5, 0)),
        ((2, 2), (1, 4, 1)),
        ((4, 2), (0, 4, 2)),
        ((2, 2), (1, 2, 1)),
        ((2, 4), (1, 0, 2)),
    )
    plan = l2a.build(bridge, arm="panda", physics="dynamic")
    assert plan.complete
    assert plan.arm is not None
    assert [step.way for step in plan.steps].count("beside") == 2
    assert plan.arm.attempts == len(plan.steps) + 1
    assert (plan.arm.error_worst or 0.0) <= 5e-4


FRAME = duplo(
    ((2, 2), (0, 0, 0)),
    ((2, 2), (2, 1, 0)),
    ((4, 2), (4, 1, 0)),
    ((2, 4), (3, 0, 1)),
    ((2, 4), (1, 0, 1)),
    ((2, 4), (6, 0, 1)),
    ((4, 2), (2, 1, 2)),
    ((4, 2), (2, 1, 3)),
    ((2, 2), (2, 3, 2)),
)
"""Product 48 of the fourth tier of WorkBenchMark (CC BY 4.0)."""


def test_what_is_over_a_brick_is_brought_with_it_where_no_single_one_can_be_pressed() -> None:
    """All states that single bricks lead to, from the finished structure, are looked at: the empty
    one is not among them."""
    states = BrickStates(FRAME)
    over = [set(above.tolist()) for above in states.mates.over]
    seen = {frozenset(range(len(FRAME.blocks)))}
    queue = list(seen)
    while queue:
        there = queue.pop()
        for b in there:
            rest = there - {b}
            if rest in seen or over[b] & rest or states.loose(rest):
                continue
            if states.stands(rest) and states.stands_pressed([b], rest):
                seen.add(rest)
                queue.append(rest)
    assert min(map(len, seen)) > 0
    plan = l2a.build(FRAME, arm="panda", physics="kinematic")
    assert plan.complete
    assert [step.way for step in plan.steps].count("beside") >= 2


def test_order_and_grasps_are_chosen_together() -> None:
    plan = l2a.build(WALL, arm="panda", physics="kinematic")
    assert plan.complete
    assert plan.blocks.used == 5
    present: set[int] = set()
    states = BrickStates(WALL)
    for step in plan.steps:
        assert states.stands_pressed([step.block], frozenset(present))
        present.add(step.block)
        assert states.stands(frozenset(present))


def test_fingers_hold_bricks_above_the_studs_beside_them() -> None:
    half = (0.032, 0.016, 0.0096)
    for name in ("panda", "ur5e"):
        gripper = get_arm(name, "gripper").gripper
        shape = (Part((0.0, 0.0, 0.0), half),)
        found = [
            hold
            for hold in holds_of(get_arm(name, "gripper"), shape, np.array([0, 0, 1.0]))
            if hold.axis[2] < -0.9
        ]
        along = {round(hold.point[0], 6) for hold in found if abs(hold.across[1]) > 0.9}
        assert along == {0.0, *(s * k * (0.032 - PAD) / 2 for s in (1, -1) for k in (1, 2))}
        for hold in found:
            tip = hold.point[2] - gripper.tip
            assert tip >= -half[2] + STUD_ROOM - 1e-9
            assert tip <= half[2] - LEAST_GRIP + 1e-9
        assert found[0].point[:2] == (0.0, 0.0)


@pytest.mark.parametrize("tilt", [0.0, 0.6])
def test_a_hand_that_turns_about_its_axis_holds_where_it_did(tilt: float) -> None:
    hand = Attitude(yaw=0.4, tilt=tilt, depth=0.003, aside=(0.0085, 0.002, 0.0))
    turned = hand.spun(np.pi)
    assert turned.rotation()[:, 0] == pytest.approx(-hand.rotation()[:, 0])
    assert turned.tool_point(np.zeros(3)) == pytest.approx(hand.tool_point(np.zeros(3)))


def test_a_hand_may_have_to_keep_away_from_others() -> None:
    """Beside a brick that stands in line, fingers that reach past the edge just fit."""
    cell, half = KinematicCell(get_arm("panda", "gripper", (-0.5, 0, 0, 0))), (0.016, 0.016, 0.0096)
    narrower = 0.0155, 0.016, 0.0096
    centres = np.array([[0.0, 0.032, 0.0096], [0.0, -0.2, 0.0096]])
    level = np.tile([1.0, 0, 0, 0], (2, 1))
    halves, density = np.array([narrower, half]), np.full(2, 500.0)
    scene = Scene(centres, np.zeros(2), np.arange(2), 1, halves, density, level)
    hand = Attitude(yaw=np.pi / 2, depth=0.003, aside=(0.0085, 0.0, 0.0))
    assert hand.tool_point(np.zeros(3))[1] == pytest.approx(0.0085)
    reached = {}
    for cell.apart in (0.0, *ROOMS):
        found = cell.attempt(scene, Move(1, np.array([0.0, 0.0, 0.0096]), hand, hand))
        reached[cell.apart] = found.reached
    assert reached == {ROOMS[0]: False, 0.0: True}


def test_what_an_arm_cannot_press_is_refused() -> None:
    with pytest.raises(InputError, match="does not hold on studs"):
        l2a.build(WALL, arm="panda", tool="suction")
    mortar = replace(WALL, joint=Joint("mortar", tensile=1e5, shear=1e5))
    with pytest.raises(InputError, match="lays no mortar"):
        l2a.build(mortar, arm="panda")


def test_what_one_arm_finds_no_order_for_is_told_what_would_help(tmp_path: Path) -> None:
    """A tower whose top leans out by two studs a layer, and comes down again on nothing: it has to
    be held while bricks are pressed on, or one put on from below."""
    at = [(8, k) for k in range(1, 9)] + [(6, 9), (4, 10), (2, 11), (0, 10)]
    (tmp_path / "cliff.txt").write_text("\n".join(f"2x4 (0,{y},{z})" for y, z in at))
    cliff = l2a.read_assembly(tmp_path / "cliff.txt", kit="lego")
    plan = l2a.build(cliff, arm="panda", tool="gripper")
    assert plan.status == "refused"
    with_hands = l2a.build(cliff, hands=True)
    assert with_hands.complete
    held = sum(step.action == "hold" for step in with_hands.steps)
    assert held
    assert "; no other tool of the arm does: socket" in (plan.reason or "")
    said = f"; without an arm, with hands it is built (`hands=`), which hold {held} times"
    assert (plan.reason or "").endswith(said)


SIDE_BY_SIDE = [
    ((4, 2), (0, 0, 0)),
    ((2, 2), (0, 0, 1)),
    ((2, 2), (2, 0, 1)),
    *(((1, 2), (x, 0, 2)) for x in range(4)),
]


def test_a_socket_builds_what_fingers_have_no_room_for() -> None:
    """Bricks one stud wide side by side, in the dynamic cell."""
    bricks = [
        Brick((x, y, 3 * z), (a, b, 3), f"brick {k}")
        for k, ((a, b), (x, y, z)) in enumerate(SIDE_BY_SIDE)
    ]
    design = assembly_of(BrickModel(tuple(bricks)), load_kit("lego"), "side by side")
    refused = l2a.build(design, arm="panda")
    assert refused.status == "refused"
    said = "with `tool=socket` there is an order in which the arm does every step"
    assert said in (refused.reason or "")
    _is_built(design, "socket", 0)


@pytest.mark.parametrize(("design", "beside"), [(STAIR, 1), (WALL, 0)], ids=["stair", "wall"])
def test_a_large_socket_builds_large_bricks(design: Assembly, beside: int) -> None:
    _is_built(design, "socket-large", beside)


def _is_built(design: Assembly, tool: str, beside: int) -> None:
    """At the first try, with so many parts that are built beside."""
    plan = l2a.build(design, arm="panda", tool=tool)
    assert plan.complete, plan.reason
    assert plan.arm is not None
    assert plan.arm.attempts == len(plan.steps) + beside
    assert plan.arm.error_worst is not None
    assert plan.arm.error_worst < 1e-4


def test_a_socket_holds_studs_that_nothing_covers() -> None:
    socket, z = get_arm("panda", "socket"), np.array([0.0, 0.0, 1.0])
    brick = Part((0.0, 0.0, 0.0), (0.016, 0.008, 0.0048))
    on_top = Part((0.004, 0.004, 0.0096), (0.012, 0.004, 0.0048))
    alone = {hold.point[:2] for hold in holds_of(socket, (brick,), z)}
    rows = np.array([-0.012, -0.004, 0.004, 0.012])
    assert {(round(x, 9), round(y, 9)) for x, y in alone} == {
        (x, y) for x in rows.round(9).tolist() for y in (-0.004, 0.004)
    }
    both = [hold for hold in holds_of(socket, (brick, on_top), z) if hold.part == 0]
    left = {(round(x, 9), round(y, 9)) for x, y, _ in (hold.point for hold in both)}
    assert left == {(x, -0.004) for x in rows.round(9).tolist()} | {(-0.012, 0.004)}


@pytest.mark.parametrize(
    ("aside", "taken"), [((0.0, 0.0), True), ((5e-4, 5e-4), True), ((1.2e-3, 0.0), False)]
)
def test_a_socket_beside_a_stud_does_not_close(aside: tuple[float, float], taken: bool) -> None:
    cell = DynamicCell(get_arm("panda", "socket"), precheck=False)
    half = np.array([0.008, 0.008, 0.0048])
    position = np.array([[0.05, -0.3, 0.0048]])
    hand = Attitude(depth=0.0048, aside=(0.004 + aside[0], 0.004 + aside[1], 0.0))
    scene = Scene(position, np.zeros(1), np.zeros(1, int), 0, half[None])
    found = cell.attempt(scene, Move(0, np.array([0.0, 0.1, 0.0048]), hand, hand))
    assert found.reached == taken, found
    assert taken or "the socket does not close on block 0" in found.detail


@pytest.mark.parametrize(
    ("design", "tool", "said"),
    [
        (WALL, "socket", "tool: got 'socket', expected .*socket-large.*: studs are 16 mm apart"),
        (None, "socket", "tool: got 'socket', expected .*suction.*: blocks have no studs"),
    ],
)
def test_a_socket_is_for_studs_of_its_size(design: Assembly | None, tool: str, said: str) -> None:
    what = np.ones((2, 1, 1), bool) if design is None else design
    with pytest.raises(InputError, match=said):
        l2a.build(what, arm="panda", tool=tool)


def test_what_is_asked_of_an_arm_that_its_build_does_not_take_is_refused() -> None:
    """What it reaches of bricks is asked with the fingers that build them."""
    found = l2a.reach(STAIR, arm="panda")
    assert isinstance(found, ReachReport)
    assert (found.tool, found.complete) == ("gripper", True)
    with pytest.raises(InputError, match="cup does not hold on studs"):
        l2a.reach(STAIR, arm="panda", tool="suction")
    found = l2a.reach(STAIR, arm="ur5e", tool="socket-large")
    assert isinstance(found, ReachReport)
    assert found.complete
    both = l2a.reach(STAIR, arm=("ur5e", "panda"), tool="socket-large")
    assert isinstance(both, TeamReach)
    assert not both.out
    with pytest.raises(InputError, match="holds: got 2, expected none with one arm"):
        l2a.build(STAIR, arm="panda", holds=2)
