"""Blocks taken by their side: props below what they have carried.

Centring of given blocks: boards that carry many of them, and vaults built on them.
"""

from __future__ import annotations

import math
import re
import runpy
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import learn2assemble as l2a
from cell_shapes import wall
from learn2assemble.acting.carry_out import Workcell, advise, carry_out
from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.contacts import Contacts, find_contacts
from learn2assemble.assembly.cuts import POST
from learn2assemble.assembly.kit import Kit, load_kit
from learn2assemble.cell.pieces import PROP_ROOM, pieces_of, planed_props
from learn2assemble.cell.site import Obstacle, Site
from learn2assemble.cell.world import Rows, way_out
from learn2assemble.constants import GRAVITY
from learn2assemble.design.cells import CellDesign
from learn2assemble.errors import InputError
from learn2assemble.handling.dynamic_cell import DynamicCell
from learn2assemble.handling.load import Payload, peak_load
from learn2assemble.kinematics.cell import KinematicCell
from learn2assemble.kinematics.chain import get_chain
from learn2assemble.kinematics.shape import arm_shape
from learn2assemble.planning.centring import find_centring
from learn2assemble.planning.clearance import FreeWays, overlap, parts_of
from learn2assemble.planning.given import plan_assembly
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.robot.arm import Arm, get_arm
from learn2assemble.robot.grasps import WAY, Attitude
from learn2assemble.robot.moves import Move, Outcome, Scene, overload
from learn2assemble.robot.registry import TOOLS
from learn2assemble.robot.tool import load_suction
from learn2assemble.statics.forces.equilibrium import solve
from robot_scenes import hands

ARMS = [get_arm(name, "suction-side", (-0.5, 0.0, 0.0, 0.0)) for name in ("panda", "ur5e")]
TOOL = ARMS[0].suction
assert TOOL is not None
SIDE, PARTS = TOOL.cups[1], TOOL.parts


# ---------------------------------------------------------------- the tool


def test_a_part_between_two_points_is_where_the_file_says() -> None:
    """From the flange: the model of the arm has every part where tool.toml puts it."""
    import mujoco

    from learn2assemble.robot.arm import arm_model

    for arm in ARMS:
        model = arm_model(arm)
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        site, tool = data.site(arm.tool), arm.suction
        assert tool is not None
        turn = site.xmat.reshape(3, 3)
        for k, part in enumerate(tool.parts):
            geom = data.geom(f"{arm.gripper.hand}_c_tool{k}")
            length = float(model.geom(geom.id).size[1])
            ends = [geom.xpos + s * length * geom.xmat.reshape(3, 3)[:, 2] for s in (-1, 1)]
            for end, told in zip(ends, (part.begin, part.end), strict=True):
                here = turn.T @ (end - site.xpos) + [0, 0, tool.length]
                np.testing.assert_allclose(here, told, atol=1e-9)


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_the_side_cup_is_drawn_where_it_is(arm: Arm) -> None:
    shape = arm_shape(arm)
    drawn = {part.name: part for part in shape.parts if "tool" in part.name}
    assert len(drawn) == len(PARTS)
    position, rotation = shape.tool(arm.home)
    frames, turns = shape.frames(arm.home, 0.0)
    cup = drawn[f"{arm.gripper.hand}_v_tool{len(PARTS) - 1}"]
    points = (frames[cup.frame] + cup.mesh.vertices @ turns[cup.frame].T - position) @ rotation
    # It ends just short of its lip, around its axis.
    assert 0.0 < SIDE.lip.at[0] - points[:, 0].max() < 0.002
    across = points[:, 1:] - SIDE.lip.at[1:]
    assert np.linalg.norm(across, axis=1).max() == pytest.approx(PARTS[-1].radius, abs=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("axis = [1.0, 0.0, 0.0]", "axis = [0.0, 0.0, 0.0]", r"sides\[0\]: got .* a direction"),
        ("at = [0.120", "at = [9.0", r"sides\[0\]: got .* within 0.6 m"),
        ("[[sides]]", "[sides]", r"sides: got .* tables \[\[sides\]\]"),
        ("shear = 21.2\ntorsion = 0.21\n", "shear = 21.2\ntorsion = 9\n", r"sides\[0\], torsion"),
        ("to = [0.075, 0.0, 0.045]", "to = [0.0, 0.0, 0.045]", r"parts\[3\]: got"),
        ("to = [0.075, 0.0, 0.045]", "to = [0.0, 0.045]", r"parts\[3\], to.*3 numbers"),
        ("to = [0.075, 0.0, 0.045]", "to = [0.0, 0.0, inf]", r"parts\[3\], to.*3 numbers"),
    ],
)
def test_impossible_side_cups_are_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    text = TOOLS["suction-side"].read_text(encoding="utf-8")
    assert old in text
    file = tmp_path / "mine" / "tool.toml"
    file.parent.mkdir()
    file.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=words):
        load_suction(file)


# ---------------------------------------------------------------- grasps


@given(st.tuples(*(st.floats(0.012, 0.1) for _ in range(3))), st.floats(-3.0, 3.0))
@settings(deadline=None)
def test_a_side_cup_meets_a_side_face(size: tuple[float, ...], yaw: float) -> None:
    half, centre = np.array(size), np.array([0.1, 0.2, size[2]])
    found = hands(ARMS[0], half, side=True)
    seals = [min(half[1 - k], half[2]) >= SIDE.radius for k in (0, 1)]
    assert len(found) <= 2 * sum(seals)
    for hand in found:
        hand = hand._replace(yaw=hand.yaw + yaw)
        turn = hand.rotation()
        assert hand.sideways
        lip = hand.tool_point(centre) + turn @ np.array(SIDE.lip.at)
        c, s = math.cos(yaw), math.sin(yaw)
        x, y, z = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ (lip - centre)
        on = [
            math.isclose(abs(x), half[0]) and abs(y) < 1e-9,
            math.isclose(abs(y), half[1]) and abs(x) < 1e-9,
        ]
        assert sum(on) == 1
        assert abs(z) <= half[2] - SIDE.radius
        # Out of the cup is into the block, and the whole tool stays above the table.
        np.testing.assert_allclose(
            hand.approach()[:2], (centre - lip)[:2] / np.linalg.norm((centre - lip)[:2]), atol=1e-9
        )
        assert hand.tool_point(centre)[2] > 4e-3


@given(st.floats(0.0, 0.3), st.integers(0, 3), st.floats(0.02, 0.1))
@settings(deadline=None)
def test_a_block_is_drawn_out_until_nothing_is_above_it(over: float, way: int, size: float) -> None:
    """A slab reaches ``over`` beyond the block in the direction it is drawn out."""
    direction = np.round([math.cos(way * math.pi / 2), math.sin(way * math.pi / 2), 0.0])
    half = np.array([[size, size, 0.02], [size + over, size + over, 0.02]])
    position = np.array([[0.0, 0, 0.02], [0.0, 0, 0.06]])
    scene = Scene(position, np.zeros(2), np.arange(2), 1, half)
    rows = Rows(scene, np.arange(2), np.zeros(2, int))
    found = way_out(rows, np.array([0]), direction)
    least = max(2 * size + over + 0.005, WAY)
    # Distances that are tried end below half a metre.
    assert found is None if least > 0.5 else found is not None or least > 0.49
    assert found is None or least - 1e-9 <= found <= least + 0.0101


def test_a_block_that_hangs_by_its_side_loads_the_cup_as_by_hand() -> None:
    """Its weight along the face, and half its width times it as a tilting moment."""
    half, mass = np.array([0.05, 0.03, 0.02]), 0.4
    load = Payload(mass, np.add(SIDE.lip.at, (half[1], 0.0, 0.0)), np.zeros((3, 3)))
    still = np.tile(ARMS[0].home, (4, 1))
    off, slip = peak_load(SIDE, get_chain(ARMS[0]), load, still, 0.01)
    weight = mass * GRAVITY
    assert off == pytest.approx(weight * half[1] / SIDE.radius / SIDE.pull_off, rel=0.01)
    assert slip == pytest.approx(weight / SIDE.shear, rel=0.01)
    hand = next(a for a in hands(ARMS[0], half, side=True) if math.isclose(a.depth, half[1]))
    heavy = np.array([2 * SIDE.pull_off * SIDE.radius / half[1] / GRAVITY / (8 * half.prod())])
    scene = Scene(np.array([[0.0, 0, 0.02]]), np.zeros(1), np.zeros(1, int), 0, half[None], heavy)
    words = overload(ARMS[0], scene, Move(0, np.array([0, 0.2, 0.02]), hand, hand))
    # Twice what pulls it off is more than the payload already.
    assert words is not None


# ---------------------------------------------------------------- the two cells


def gate(room: float, mass: float = 1.0) -> tuple[Scene, np.ndarray]:
    """Two piers with a lintel on them, and a prop below it, lower by ``room``; and where the prop
    goes. The lintel is ``mass`` times as dense as the others."""
    position = [[-0.1, 0.1, 0.02], [0.1, 0.1, 0.02], [0.0, 0.1, 0.06], [0.0, 0.1, 0.02 - room / 2]]
    half = [
        [0.03, 0.02, 0.02],
        [0.03, 0.02, 0.02],
        [0.13, 0.02, 0.02],
        [0.04, 0.02, 0.02 - room / 2],
    ]
    density = np.array([800.0, 800.0, 800.0 * mass, 800.0])
    scene = Scene(np.array(position), np.zeros(4), np.arange(4), 3, np.array(half), density)
    return scene, np.array([0.2, -0.12, 0.02 - room / 2])


def drawn() -> list[Attitude]:
    """The hand that draws the prop towards the arm."""
    found = hands(ARMS[0], np.array([0.04, 0.02, 0.02]), side=True)
    return [hand for hand in found if hand.approach()[1] > 0.9]


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_a_prop_is_drawn_out_from_below_a_lintel(name: str) -> None:
    arm = get_arm(name, "suction-side", (0.0, -0.6, 0.0, math.pi / 2))
    scene, goal = gate(PROP_ROOM)
    (hand,) = drawn()
    move = Move(3, goal, hand, hand)
    above = hands(arm, np.array([0.04, 0.02, 0.02]))[0]
    blocked = KinematicCell(arm).attempt(scene, Move(3, goal, above, above))
    assert blocked.outcome == Outcome.GRASP_COLLISION
    assert KinematicCell(arm).attempt(scene, move).reached
    found = DynamicCell(arm).attempt(scene, move)
    assert found.reached, (found.stage, found.detail)
    assert found.error < 5e-4
    assert found.after is not None
    assert np.abs(found.after.position[:3] - scene.position[:3]).max() < 3e-4


def test_a_prop_under_a_load_that_is_too_heavy_comes_off_and_the_report_says_so() -> None:
    """Without room and under 20 kg, friction holds it with more than the cup pulls off with."""
    arm = get_arm("panda", "suction-side", (0.0, -0.6, 0.0, math.pi / 2))
    scene, goal = gate(-2e-4, 60.0)
    (hand,) = drawn()
    found = DynamicCell(arm, precheck=False).attempt(scene, Move(3, goal, hand, hand))
    assert found.outcome == Outcome.GRASP_LOST
    assert re.search(r"pulled off by|slipped out under", found.detail)


# ---------------------------------------------------------------- a build


@pytest.fixture(scope="module")
def bridge() -> tuple[Plan, Kit]:
    """A bridge whose deck takes a prop until it stands by itself."""
    kit = load_kit("bricks").at_pitch((0.04, 0.04, 0.04))
    arch = wall(10, 1, 4, (3, 7, 0, 2))
    cells = CellDesign("bridge", arch, kit.pitch, None, 0.0, None, "", None)
    plan = plan_cells(cells, kit, seconds=600)
    assert plan.complete
    assert any(step.action == "remove" for step in plan.steps)
    return plan, kit


@pytest.mark.parametrize("arm", ["panda", "ur5e"])
def test_props_of_a_bridge_are_taken_away(bridge: tuple[Plan, Kit], arm: str) -> None:
    plan, kit = bridge
    done = carry_out(plan, Workcell(arm, "suction-side", physics="kinematic"), joint=kit.joint_gap)
    assert done.complete, done.reason
    gone = [step for step in done.steps if step.action == "remove"]
    assert {step.grasp for step in gone[:1]} == {"suction from the side"}
    assert len(gone) == sum(s.prop and s.action == "place" for s in done.steps)
    assert done.arm is not None
    assert plan.assembly is not None
    assert done.arm.planed_props == len(planed_props(plan.assembly)) > 0
    assert "0.3 mm lower than" in done.arm.planed_words
    if arm == "ur5e":
        return
    refused = carry_out(plan, Workcell(arm, "suction", physics="kinematic"), joint=kit.joint_gap)
    assert refused.status == "refused"
    assert "take away prop" in (refused.reason or "")
    # The other tool was tried; that it does is what the first half of this test says.
    assert (refused.reason or "").endswith(
        "; with `tool=suction-side` there is an order in which the arm does every step"
    )


def test_what_no_tool_does_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """A high wall close in front of a row of bricks, on the side of the arm."""
    kit = load_kit("bricks").at_pitch((0.04, 0.04, 0.04))
    plan = plan_cells(CellDesign("row", wall(8, 1, 1), kit.pitch, None, 0.0, None, "", None), kit)
    front = Obstacle((0.0, -0.1), (0.6, 0.02, 0.5))
    workcell = Workcell("panda", site=Site(base=(0.0, -0.5, 0.0, math.pi / 2), obstacles=(front,)))
    said = advise(plan, workcell, kit.joint_gap, lambda text: None)
    assert said == "no other tool of the arm does: suction-side, suction-wide, gripper"
    monkeypatch.setattr("learn2assemble.acting.carry_out.MOST_STEPS", len(plan.steps) - 1)
    assert advise(plan, workcell, kit.joint_gap, lambda text: None) == ""


def test_only_what_carries_is_lower(bridge: tuple[Plan, Kit]) -> None:
    plan, _ = bridge
    assert plan.assembly is not None
    pieces = pieces_of(plan.assembly)
    high = [np.ptp(block.vertices[:, 2]) for block in plan.assembly.blocks]
    lower = [p for p, h in zip(pieces, high, strict=True) if abs(2 * p.half[2] - h) > 1e-6]
    tops = [p for p in pieces if p.prop and p.target[2] > 0.05]
    assert lower == tops
    assert all(math.isclose(2 * p.half[2], 0.04 - PROP_ROOM, abs_tol=1e-6) for p in lower)
    assert all(math.isclose(p.target[2] - p.half[2], 0.04, abs_tol=1e-5) for p in lower)


SCRIPTS = Path(__file__).resolve().parents[1] / "examples" / "structures"


def made(script: str, function: str, **arguments: object) -> Assembly:
    return runpy.run_path(str(SCRIPTS / f"{script}.py"))[function](**arguments)


def turned(assembly: Assembly, angle: float) -> Assembly:
    """The same blocks, turned about the vertical and moved aside."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    blocks = [replace(b, vertices=b.vertices @ turn + [3.0, -2.0, 0.0]) for b in assembly.blocks]
    return replace(assembly, blocks=tuple(blocks))


def touched(post: Block, assembly: Assembly) -> set[int]:
    """Blocks that share a face with a post."""
    contacts = find_contacts(Assembly((*assembly.blocks, replace(post, prop=False))))
    return set(contacts.a[contacts.b == len(assembly.blocks)].tolist()) - {-1}


def assert_built(plan: Plan) -> None:
    """Every state has forces that balance it, blocks come one by one, and no post is left."""
    assert plan.complete, plan.reason
    assembly = plan.assembly
    assert assembly is not None
    contacts, there = find_contacts(assembly), np.zeros(len(assembly.blocks), bool)
    index = {block.id: k for k, block in enumerate(assembly.blocks)}
    for step in assembly.steps:
        assert there[index[step.block]] == (step.action == "remove")
        there[index[step.block]] = step.action == "place"
        assert solve(assembly, contacts, present=there, coupled=False).stands, step
    assert [block.prop for block in assembly.blocks] == (~there).tolist()


@pytest.mark.parametrize("angle", [0.0, 2.5])
@pytest.mark.parametrize(
    ("script", "function", "arguments"),
    [
        ("arch", "arch", {"voussoirs": 11}),
        ("vaults", "barrel_vault", {"courses": 3, "bond": True}),
        ("vaults", "cross_vault", {"voussoirs": 7}),
    ],
)
def test_boards_lie_against_what_they_carry_and_meet_nothing(
    script: str, function: str, arguments: dict[str, int], angle: float
) -> None:
    assembly = turned(made(script, function, **arguments), angle)
    boards, carried = find_centring(assembly.blocks, find_contacts(assembly))
    # A few between two boards lie on none, as do those that stand on the ground.
    high = {k for k, b in enumerate(assembly.blocks) if b.vertices[:, 2].min() > 0.1}
    assert len(high & set(carried)) > 0.75 * len(high)
    assert len(boards) < len(high) / 4
    for board in boards:
        assert board.block.prop
        assert board.block.kind == POST
        assert board.block.vertices[:, 2].min() == 0.0
        for block in assembly.blocks:
            assert not overlap(parts_of(board.block), parts_of(block), 1e-4)
    for one, two in combinations(boards, 2):
        assert not overlap(parts_of(one.block), parts_of(two.block), 0.0)
    assert set().union(*(touched(board.block, assembly) for board in boards)) >= set(carried)


def test_a_board_ends_at_what_stands_in_its_way() -> None:
    assembly = made("arch", "arch", voussoirs=11)
    [board], carried = find_centring(assembly.blocks, find_contacts(assembly))
    wall = box_block("wall", (0.1, -0.3, 0.0), (0.12, 0.3, 0.1))
    halved = replace(assembly, blocks=(*assembly.blocks, wall))
    [left, right], both = find_centring(halved.blocks, find_contacts(halved))
    assert left.block.vertices[:, 0].max() <= 0.1 + 1e-9 or right.block.vertices[:, 0].min() >= 0.12
    assert left.block.volume + right.block.volume < board.block.volume
    assert set(both) <= set(carried)
    # A pillar under the crown itself leaves nothing to carry there, but both haunches.
    for block in (left.block, right.block):
        assert not overlap(parts_of(block), parts_of(wall), 1e-9)


def test_blocks_without_slope_get_no_board() -> None:
    beam = Assembly(
        (box_block("foot", (0, 0, 0), (1, 1, 1)), box_block("beam", (0, 0, 1), (3, 1, 2)))
    )
    assert find_centring(beam.blocks, find_contacts(beam)) == ([], [])


def test_an_arch_of_many_voussoirs_is_built_on_one_board() -> None:
    plan = plan_assembly(made("arch", "arch", voussoirs=21, radius=0.5, thickness=0.14))
    assert_built(plan)
    assert plan.assembly is not None
    [board] = [block for block in plan.assembly.blocks if block.prop]
    steps = [step for step in plan.assembly.steps if step.block == board.id]
    assert steps == [plan.assembly.steps[0], plan.assembly.steps[-1]]
    assert [step.action for step in steps] == ["place", "remove"]


def test_a_cross_vault_is_built() -> None:
    """From posts that stand alone it is not: those under its steep stones are pushed over."""
    vault = made("vaults", "cross_vault", voussoirs=5, course=0.3)
    plan = plan_assembly(vault, seconds=300)
    assert_built(plan)


def test_the_last_block_of_a_vault_comes_between_faces_that_are_rounded() -> None:
    """Straight up is its one way, which faces rounded to a micrometre leave by 40 microradians."""
    corners = np.array([(x, y, z) for x in (0, 0.025) for y in (0, 0.025) for z in (0, 0.05)])
    key = l2a.hull_block("key", corners)
    beside = []
    for k, (x, y) in enumerate([(0.025, 0), (-0.025, 0), (0, 0.025), (0, -0.025)]):
        moved = corners + np.array([x, y, 0])
        # Its upper edge leans over the key.
        upper = moved[:, 2] > 0.01
        moved[upper] -= 1e-6 * np.sign([x, y, 0])
        beside.append(l2a.hull_block(f"b{k}", moved))
    blocks = (key, *beside)
    contacts = find_contacts(Assembly(blocks))
    ways = FreeWays(blocks, contacts, 1e-4, len(blocks))
    assert ways.free(0, np.ones(5, bool))


@pytest.mark.parametrize(("corners", "free"), [(1, True), (2, True), (4, False)])
def test_what_touches_at_a_corner_shuts_no_way(corners: int, free: bool) -> None:
    """The stones in the middle of a cross vault have one with the opposite one, and the normal that
    is found for it may be straight down; of faces it is the only one."""
    cube = np.array([(x, y, z) for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)])
    places = [(0, 0, 0), (0.1, 0, 0), (-0.1, 0, 0), (0, 0.1, 0), (0, -0.1, 0), (0.1, 0.1, 0)]
    blocks = [l2a.hull_block(f"b{k}", cube + np.array(at)) for k, at in enumerate(places)]
    contacts = find_contacts(Assembly(tuple(blocks)))
    corner = Contacts(
        a=np.array([0]),
        b=np.array([5]),
        normal=np.array([[0.0, 0.0, 1.0]]),
        area=np.zeros(1),
        points=np.array([[0.1, 0.1, 0.05]] * corners),
        patch=np.full(corners, len(contacts.a)),
        spread=np.zeros(1),
    )
    both = Contacts(*map(np.concatenate, zip(contacts, corner, strict=True)))
    ways = FreeWays(blocks, both, 1e-4, len(blocks))
    assert ways.free(0, np.ones(6, bool)) == free
