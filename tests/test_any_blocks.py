"""An arm takes blocks of any shape at any pose: faces to hold and to rest on, hulls, hands."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import dataclasses
import math
import runpy
from pathlib import Path

import mujoco
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

import learn2assemble as l2a
from learn2assemble.acting.carry_out import Workcell, carry_out, prepare, setup_of
from learn2assemble.assembly.blocks import Assembly, Block, hull_block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.instructions.steps import instructions
from learn2assemble.assembly.instructions.words import facts
from learn2assemble.cell.pieces import Pose, pieces_of, ways_to_rest, with_rests
from learn2assemble.cell.reach import check_held
from learn2assemble.cell.site import Magazine, Site
from learn2assemble.cell.structure import Structure
from learn2assemble.cell.workcell import job_of
from learn2assemble.cli.commands import _print_plan
from learn2assemble.cli.output import Output
from learn2assemble.errors import InputError
from learn2assemble.export.robot_programs import export_program, replay_program
from learn2assemble.geometry.hulls import Hull, hull_of, resting_turns, rotations_onto
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.kinematics.collisions import BlockChecker
from learn2assemble.motion.files import read_record, write_record
from learn2assemble.motion.record import BuildRecord, find_fault
from learn2assemble.planning.given import plan_assembly
from learn2assemble.planning.plan import Plan
from learn2assemble.plants.setup import Disturbance
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.bodies import Part, Shape, body_of, overlaps, solids
from learn2assemble.robot.holding import PAD, attitudes, free_face, holds_of, ways_to_turn
from learn2assemble.robot.moves import Move, Scene, carried, put_down
from read_back import pdf_text
from robot_scenes import check_hit

STRUCTURES = Path(__file__).resolve().parents[1] / "examples/structures"
UR5E, PANDA = get_arm("ur5e", "suction"), get_arm("panda")
# A stair of three boxes: parts cover faces of one another.
STAIR: Shape = (
    Part((-0.04, 0.0, -0.02), (0.02, 0.03, 0.02)),
    Part((0.02, 0.0, 0.0), (0.04, 0.03, 0.04)),
)


def stone(seed: int) -> Hull:
    """The hull of some points in a box of 12 x 10 x 8 cm."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (int(rng.integers(5, 12)), 3)) * [0.06, 0.05, 0.04]
    found = hull_of(points)
    low, high = found.points.min(0), found.points.max(0)
    return hull_of(found.points - (low + high) / 2)


def turn_of(rng: np.random.Generator) -> np.ndarray:
    turn = rng.normal(size=4)
    return quaternion_matrix(turn / np.linalg.norm(turn))


# ---------------------------------------------------------------- hulls


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10**6))
def test_what_rests_lies_on_a_face_and_falls_when_it_is_tilted_by_more_than_its_margin(
    seed: int,
) -> None:
    hull = stone(seed)
    for rest in resting_turns(hull, hull.centroid, 0.0):
        points = (hull.points - hull.centroid) @ rest.turn.T
        ground = points[points[:, 2] < points[:, 2].min() + 1e-6]
        assert len(ground) >= 3
        foot = shapely.MultiPoint(ground[:, :2]).convex_hull
        assert foot.buffer(1e-9).contains(shapely.Point(0, 0))
        # The margin is the smallest tilt about an edge that brings the centre over it.
        height, inside = -points[:, 2].min(), foot.boundary.distance(shapely.Point(0, 0))
        assert math.tan(rest.margin) == pytest.approx(inside / height, abs=1e-6)


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10**6))
def test_a_stone_is_one_shape_in_every_pose_and_its_mirror_image_another(seed: int) -> None:
    rng, hull = np.random.default_rng(seed + 1), stone(seed)
    poses = [(turn_of(rng), rng.uniform(0.2, 1, 3)) for _ in range(3)]
    blocks = [hull_block(f"b{k}", hull.points @ t.T + p) for k, (t, p) in enumerate(poses)]
    mirrored = hull_block("mirrored", hull.points * [1, 1, -1] + [0.5, 0.5, 0.5])
    pieces = pieces_of(Assembly((*blocks, mirrored)))
    same = any(rotations_onto(hull.points, hull.points * [1, 1, -1], 1e-6))
    assert len({piece.shape for piece in pieces[:3]}) == 1
    assert (pieces[3].shape == pieces[0].shape) == same
    for piece, block in zip(pieces, (*blocks, mirrored), strict=True):
        far = np.linalg.norm(piece.corners(piece.pose)[:, None] - block.vertices, axis=2)
        assert max(far.min(0).max(), far.min(1).max()) < 1e-5
        assert piece.mass == pytest.approx(block.mass, rel=1e-4)


# ---------------------------------------------------------------- holds


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10**6), st.booleans())
def test_a_cup_lies_on_a_face_that_nothing_covers(seed: int, stair: bool) -> None:
    shape = STAIR if stair else (Part((0.0, 0.0, 0.0), (0.06, 0.05, 0.04), stone(seed)),)
    up = turn_of(np.random.default_rng(seed))[2]
    holds = holds_of(UR5E, shape, up)
    assert holds or not stair
    angle = np.linspace(0, 2 * np.pi, 24)
    for hold in holds:
        axis, across = np.array(hold.axis), np.array(hold.across)
        ring = np.outer(np.cos(angle), across) + np.outer(np.sin(angle), np.cross(axis, across))
        lip = np.array(hold.point) + 0.015 * ring
        solid, centre = shape[hold.part].solid, np.array(shape[hold.part].centre)
        depth = (lip - centre) @ solid.normals.T - solid.offsets
        assert depth.max() < 2e-6, "the lip is on the block"
        assert np.abs(depth.max(1)).max() < 2e-6, "and all of it on its surface"
        for other in shape:
            outside = (lip - 1e-3 * axis - np.array(other.centre)) @ other.solid.normals.T
            assert ((outside - other.solid.offsets).max(1) > 0).all(), "no part is in front of it"


def test_faces_that_other_parts_cover_are_left_out() -> None:
    """The riser of the stair: below the tread it is glued to the lower box."""
    for part, face in ((0, 0), (1, 3)):
        normals = STAIR[part].solid.normals
        assert {tuple(n) for n in normals.round(9).tolist()} >= {(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)}
        assert face < len(normals)
    inner = int(np.argmax(STAIR[0].solid.normals[:, 0]))
    assert free_face(STAIR, 0, inner).area < 1e-12
    riser = int(np.argmin(STAIR[1].solid.normals[:, 0]))
    assert free_face(STAIR, 1, riser).area == pytest.approx(0.06 * 0.04, rel=1e-6)


@settings(deadline=None, max_examples=15)
@given(st.floats(0.012, 0.05), st.floats(0.012, 0.034), st.floats(0.012, 0.05), st.floats(0, 0.3))
def test_fingers_close_on_two_parallel_faces(x: float, y: float, z: float, lean: float) -> None:
    """A prism whose upright ends lean: its two other sides stay parallel."""
    points = [
        (sx * x + sz * z * math.tan(lean), sy * y, sz * z)
        for sx in (-1, 1)
        for sy in (-1, 1)
        for sz in (-1, 1)
    ]
    hull = hull_of(np.array(points))
    half = np.abs(hull.points).max(0).tolist()
    shape = (Part((0.0, 0.0, 0.0), (half[0], half[1], half[2]), hull),)
    for hold in holds_of(PANDA, shape, np.array([0.0, 0.0, 1.0])):
        axis, across = np.array(hold.axis), np.array(hold.across)
        assert abs(axis @ across) < 1e-9
        ends = [np.array(hold.point) + side * hold.width / 2 * across for side in (-1, 1)]
        depth = np.array([(end @ hull.normals.T - hull.offsets).max() for end in ends])
        np.testing.assert_allclose(depth, 0, atol=1e-8)
        assert hold.width + 0.008 <= PANDA.gripper.max_width
    flat = [h for h in attitudes(PANDA, shape) if not h.tilt]
    if z > 0.012 and x > PAD:
        assert flat


def test_a_tilted_hand_turns_a_block_into_its_pose() -> None:
    """Whatever the hold, the move takes the block to its goal exactly."""
    rng = np.random.default_rng(5)
    hull = runpy.run_path(str(STRUCTURES / "stones.py"))["cut_stone"](rng, 0)
    piece = pieces_of(Assembly((dataclasses.replace(hull, vertices=hull.vertices + 0.3),)))[0]
    part = piece.shape[0]
    tried = 0
    for _ in range(30):
        now, goal = turn_of(rng), turn_of(rng)
        for way in ways_to_turn(UR5E, piece.shape, now, [goal])[:2]:
            tried += 1
            np.testing.assert_allclose(way.place @ way.grasp.T @ now, goal, atol=1e-9)
            np.testing.assert_allclose(way.grasp[:, 2], now @ np.array(way.hold.axis), atol=1e-9)
    assert tried > 10
    assert part.hull is not None


# ---------------------------------------------------------------- what collides


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10**9))
def test_hulls_collide_where_their_distances_say_so(seed: int) -> None:
    """On the table and in the hand: as every pair of geoms by itself shows."""
    rng = np.random.default_rng(seed)
    hulls = [stone(k) for k in rng.integers(0, 3, 5).tolist()]
    known = frozenset(stone(k) for k in range(3))
    model = CHECKERS.setdefault(
        "panda", BlockChecker(get_arm("panda", "suction"), 8, True, 4, known)
    )
    half = np.array([np.abs(hull.points).max(0) for hull in hulls])
    position = rng.uniform([-0.4, -0.3, 0.0], [0.2, 0.3, 0.5], (5, 3))
    turns = rng.normal(size=(5, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    scene = Scene(position, np.zeros(5), np.arange(5), 1, half, None, turns, (*hulls[:4], None))
    model.place(scene)
    model.hang(scene, np.zeros(1, np.int64), np.zeros((1, 3)), np.eye(3)[None])
    joints = rng.uniform(model.arm.lower, model.arm.upper)
    hit = model.check(joints)
    check_hit(model, hit, 1e-3)
    m, d = model.model, model.data
    # Where a hull is, its corners are.
    geom = next(g for g in range(m.ngeom) if m.body(m.geom_bodyid[g]).name == "block 0")
    assert m.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH
    corners = position[0] + hulls[0].points @ quaternion_matrix(turns[0]).T
    mesh = m.geom_dataid[geom]
    first, count = m.mesh_vertadr[mesh], m.mesh_vertnum[mesh]
    shown = (
        d.geom_xpos[geom] + m.mesh_vert[first : first + count] @ d.geom_xmat[geom].reshape(3, 3).T
    )
    far = np.linalg.norm(corners[:, None] - shown, axis=2)
    assert far.min(1).max() < 1e-6


CHECKERS: dict[str, BlockChecker] = {}


def test_the_hull_of_what_is_held_collides_not_its_box() -> None:
    """A wedge hangs from the hand; a thin block where its box has a corner and it has none."""
    hull = hull_of(
        np.array(
            [
                [x, y, z]
                for y in (-0.03, 0.03)
                for x, z in ((-0.05, 0.05), (0.05, 0.05), (0.05, -0.05))
            ]
        )
    )
    arm = get_arm("panda", "suction")
    half = np.array([[0.05, 0.03, 0.05], [0.004, 0.03, 0.004]])
    hit = {}
    for own in (None, hull):
        model = BlockChecker(arm, 2, True, 2, frozenset({hull}))
        model.move_arm(arm.home)
        site = model.data.site(arm.tool)
        tool, turn = site.xpos.copy(), site.xmat.reshape(3, 3).copy()
        held = np.array([0.0, 0.0, 0.06])
        # Inside the box of the wedge, at the corner that it lacks.
        corner = tool + turn @ (held + np.array([-0.04, 0.0, -0.04]))
        scene = Scene(
            np.array([[2.0, 0.0, 0.05], corner]),
            np.zeros(2),
            np.arange(2),
            1,
            half,
            None,
            np.tile([1.0, 0, 0, 0], (2, 1)),
            (own, None),
        )
        model.place(scene)
        model.hang(scene, np.zeros(1, np.int64), held[None], np.eye(3)[None])
        found = model.check(arm.home)
        hit[own is None] = found is not None and found.part == "carried 0"
        if own is None:
            assert str(found) == "what is held touches block 1"
    assert hit == {True: True, False: False}


def test_put_down_turns_all_parts_about_one_another() -> None:
    rng = np.random.default_rng(0)
    shape, now = STAIR, np.eye(3)
    way = next(w for w in ways_to_turn(UR5E, shape, now, [turn_of(rng) for _ in range(40)]))
    from learn2assemble.robot.grasps import facing

    position = np.array([part.centre for part in shape])
    scene = Scene(
        position,
        np.zeros(2),
        np.zeros(2, int),
        0,
        np.array([p.half for p in shape]),
        None,
        np.tile([1.0, 0, 0, 0], (2, 1)),
    )
    move = Move(0, np.array([0.3, 0.0, 0.2]), facing(way.grasp), facing(way.place))
    there, turned = carried(scene, move, np.arange(2))
    after = put_down(scene, move)
    assert after.quaternion is not None
    turn = quaternion_matrix(turned[0])
    np.testing.assert_allclose(there[1] - there[0], turn @ (position[1] - position[0]), atol=1e-9)
    np.testing.assert_allclose(after.position, there)
    np.testing.assert_allclose(abs((after.quaternion * turned).sum(1)), 1)


# ---------------------------------------------------------------- waiting


def test_the_voussoirs_of_an_arch_are_one_kind_and_wait_where_the_hand_leans_least() -> None:
    arch = runpy.run_path(str(STRUCTURES / "arch.py"))["arch"](9)
    pieces = with_rests(pieces_of(arch), UR5E)
    assert len({piece.shape for piece in pieces}) == 1
    assert len({piece.rest.tobytes() for piece in pieces}) == 2
    for piece in pieces:
        goals = [piece.turn @ turn for turn in piece.turns()]
        tilts = [
            ways[0].tilt
            for rest in ways_to_rest(piece)
            if (ways := ways_to_turn(UR5E, piece.shape, rest, goals))
        ]
        chosen = ways_to_turn(UR5E, piece.shape, piece.rest, goals)[0].tilt
        assert chosen <= min(tilts) + math.radians(1.0)
        assert chosen < math.radians(41.0)
        points = body_of(piece.shape).points @ piece.rest.T
        assert (points[:, 2] < points[:, 2].min() + 1e-6).sum() == 4


# ---------------------------------------------------------------- built


def turned_bricks(count: int) -> Assembly:
    """The first bricks of the turned wall, half as large."""
    made = runpy.run_path(str(STRUCTURES / "turned_wall.py"))["turned_wall"](count, 2)
    blocks = [dataclasses.replace(b, vertices=0.5 * b.vertices) for b in made.blocks]
    return Assembly(tuple(blocks), friction=made.friction, name="turned")


@pytest.mark.parametrize(("arm", "tool"), [("panda", "suction"), ("ur5e", "gripper")])
def test_turned_bricks_are_built(arm: str, tool: str) -> None:
    plan = l2a.build(turned_bricks(5), arm=arm, tool=tool)
    assert plan.complete, plan.reason
    assert plan.arm is not None
    assert plan.arm.attempts == 5
    assert plan.arm.error_worst is not None
    assert plan.arm.error_worst < 1e-3
    assert plan.record is not None
    assert find_fault(plan.record) is None


@pytest.fixture(scope="module")
def arch() -> Plan:
    return l2a.build(runpy.run_path(str(STRUCTURES / "arch.py"))["arch"](9), arm="ur5e")


@pytest.fixture(scope="module")
def small_arch() -> Plan:
    """Of five voussoirs: for what moves all of them again."""
    made = runpy.run_path(str(STRUCTURES / "arch.py"))["arch"](5, 0.2, 0.06, 0.08)
    return l2a.build(made, arm="ur5e", supports="posts")


def test_an_arch_is_built_on_posts_and_stands_when_they_are_gone(arch: Plan) -> None:
    assert arch.complete, arch.reason
    assert arch.arm is not None
    assert arch.record is not None
    # Of the fewest posts, which are wide, the arm sets both; what the structure covers stays to
    # a person.
    posts = [step for step in arch.steps if step.prop]
    assert [(step.action, step.by_hand) for step in posts] == 2 * [("place", False)] + 2 * [
        ("remove", True)
    ]
    assert arch.arm.attempts == 11
    assert arch.arm.error_worst is not None
    assert arch.arm.error_worst < 1e-3
    assert arch.blocks.used == 9
    hands = [step for step in arch.steps if step.by_hand]
    assert hands
    assert all(step.prop and step.grasp == "by hand" and step.outcome is None for step in hands)
    assert len(arch.record.hands) == len(hands)
    assert find_fault(arch.record) is None
    # What was placed by hand is there from the next step of the arm on, and gone at the end.
    cells = {cell for hand in arch.record.hands for cell in hand.cells}
    assert (arch.record.steps[-1].after[sorted(cells), 2] < 0).all()
    assert len(arch.record.steps) == 11


def test_a_block_waits_only_for_what_stands_when_the_plan_places_it() -> None:
    """A post that comes later may touch a block that stands: it carries what comes next, too."""
    arch = STRUCTURES / "arch.obj"
    plan = l2a.build(arch, blocks=True, unit="mm", friction=0.6, supports="posts")
    job = job_of(plan, "ur5e", 1e-4)
    structure = Structure(job)
    faces = structure.contacts
    standing, later = set[int](), 0
    for step in job.steps:
        if step.remove:
            standing.discard(step.block)
            continue
        assert structure.below[step.block] <= standing
        under = np.where(faces.b == step.block, faces.a, faces.b)
        up = np.where(faces.b == step.block, faces.normal[:, 2], -faces.normal[:, 2])
        under = under[((faces.a == step.block) | (faces.b == step.block)) & (up > 0.1)]
        later += len(set(under.tolist()) - standing - {-1})
        standing.add(step.block)
    assert later, "nothing comes later below what stands: the plan shows nothing"


def inside(record: BuildRecord, cell: int, pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """bool[N]: which points lie in a cell at a pose."""
    own = (points - pose[:3]) @ quaternion_matrix(pose[3:])
    hull = None if record.hull is None else record.hull[cell]
    if hull is not None:
        return np.all(own @ hull.normals.T - hull.offsets < 0, 1)
    assert record.half is not None
    return (np.abs(own) < record.half[cell]).all(1)


def assert_cups_are_on_free_faces(plan: Plan) -> None:
    """From the joints of the arm, when it grips and when it lets go."""
    record = plan.record
    assert record is not None
    x, y, z = record.arm.base_position.tolist()
    base = x, y, z, record.arm.base_yaw
    arm = get_arm(record.arm.name, record.arm.tool_name, base)
    assert arm.suction is not None
    radius = arm.suction.cups[0].radius
    angle = np.arange(24) * np.pi / 12
    for step in record.steps:
        assert step.grip is not None
        assert step.release is not None
        for time, poses in ((step.grip, step.before), (step.release, step.after)):
            at = int(np.searchsorted(step.samples.time, time, side="right")) - 1
            point, turn = forward(get_chain(arm), step.samples.joints[at])
            ring = [np.cos(angle), np.sin(angle), np.zeros(24)]
            ring = point + 0.95 * radius * np.stack(ring, 1) @ turn.T
            ring = np.vstack([ring, ring + (point - ring) / 2, point])
            own = [inside(record, k, poses[k], ring + 0.003 * turn[:, 2]) for k in step.cells]
            assert np.any(own, 0).all(), "all of the cup is on the block"
            lip = np.vstack([ring - back * turn[:, 2] for back in (0.001, 0.003)])
            for k in range(record.num_cells):
                assert not inside(record, k, poses[k], lip).any(), (step.number, k)


@pytest.mark.parametrize("arm", ["panda", "ur5e"])
def test_no_cup_is_on_a_face_that_is_covered(arm: str) -> None:
    """Turned bricks, one on the others."""
    plan = l2a.build(turned_bricks(6), arm=arm)
    assert plan.complete, plan.reason
    assert_cups_are_on_free_faces(plan)


def test_no_cup_is_on_a_face_of_a_voussoir_that_is_covered(arch: Plan) -> None:
    """Faces lean, and neighbours and posts cover the others."""
    assert_cups_are_on_free_faces(arch)


def test_a_kind_has_one_magazine_whatever_its_poses() -> None:
    """What is dropped is put aside, and the next one of the magazine comes."""
    plan = plan_assembly(turned_bricks(6))
    dropping = Disturbance(drop=frozenset({2}))
    done = carry_out(plan, Workcell("ur5e", disturbance=dropping, hands=True), joint=0.0)
    assert done.complete, done.reason
    assert done.assembly is not None
    assert done.arm is not None
    assert done.arm.attempts > 6
    waiting: dict[str, set[tuple[float, ...]]] = {}
    for block, at in zip(done.assembly.blocks, done.blocks.waiting, strict=True):
        waiting.setdefault(block.kind, set()).add(tuple(at))
    assert {kind: len(places) for kind, places in waiting.items()} == {"brick": 1, "half": 1}
    assert done.arm.places == 2


def test_what_is_done_by_hand_is_said_wherever_a_plan_is_shown(
    arch: Plan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert arch.assembly is not None
    numbers = [step.step for step in arch.steps if step.by_hand]
    assert [n for n, s in enumerate(arch.assembly.steps, 1) if s.by_hand] == numbers
    for kind in ("assembly", "compas"):
        again = l2a.read_assembly(l2a.export_assembly(arch.assembly, kind, tmp_path))
        assert again.steps == arch.assembly.steps
    told = instructions(arch.assembly)
    assert [p.number for p in told.placements if p.by_hand] == numbers
    assert any(f"{len(numbers)} steps by hand" in fact for fact in facts(told))
    html = l2a.export_assembly(arch.assembly, "cards", tmp_path).read_text()
    assert html.count("By hand, while the arm waits.") == len(numbers)
    assert pdf_text(arch.assembly).count("By hand, while the arm waits.") == len(numbers)
    arch.save(tmp_path / "plan")
    page = (tmp_path / "plan" / "view.html").read_text()
    assert page.count("By hand, while the arm waits.") >= len(numbers)
    placed = sum(step.by_hand and step.action == "place" for step in arch.steps)
    assert page.count("place by hand") == placed
    assert page.count("remove by hand") == len(numbers) - placed
    _print_plan(Output(False), arch, {})
    line = next(s for s in capsys.readouterr().out.splitlines() if s.startswith("by hand, while"))
    assert line.count("post-") == len(numbers)


def test_a_build_with_hulls_and_hands_is_written_read_and_played(
    small_arch: Plan, tmp_path: Path
) -> None:
    record = small_arch.record
    assert record is not None
    assert record.hands
    write_record(record, tmp_path / "trajectory.json")
    again = read_record(tmp_path / "trajectory.json")
    assert again.hands == record.hands
    assert again.hull is not None
    assert record.hull is not None
    for one, two in zip(again.hull, record.hull, strict=True):
        assert (one is None) == (two is None)
        if one is not None and two is not None:
            far = np.linalg.norm(one.points[:, None] - two.points, axis=2)
            assert far.min(0).max() < 2e-6
    export_program(again, "csv", tmp_path / "program.csv")
    assert replay_program(tmp_path / "program.csv", "ur5e").same


def test_a_urscript_waits_for_what_is_done_by_hand(arch: Plan, tmp_path: Path) -> None:
    plan = arch
    assert plan.record is not None
    export_program(plan.record, "urscript", tmp_path / "arch.script")
    lines = [line.strip() for line in (tmp_path / "arch.script").read_text().splitlines()]
    waits = [line for line in lines if line.startswith('popup("by hand')]
    assert len(waits) == len(plan.record.hands)
    # That is all it asks for: no arm has put down what only a hand takes away.
    assert any(not hand.place for hand in plan.record.hands)
    assert not [line for line in lines if line.startswith("l2a_wait_until_taken(")]
    for hand, line in zip(plan.record.hands, waits, strict=True):
        assert hand.words in line
        assert "blocking=True" in line
        step = next(
            (k for k, text in enumerate(lines) if text.startswith(f"# step {hand.after + 1},")),
            len(lines),
        )
        assert lines.index(line) > step or step == len(lines)


# ---------------------------------------------------------------- what is refused


def needle(name: str, x: float) -> Block:
    return hull_block(name, [[x, 0, 0], [x + 0.02, 0, 0], [x, 0.02, 0], [x, 0, 0.06]])


def test_blocks_that_no_face_lets_the_tool_hold_are_named_before_planning(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def planned(*args: object, **more: object) -> None:
        raise AssertionError("planned first")

    monkeypatch.setattr("learn2assemble.planning.given.plan_assembly", planned)
    wall = [box_block("sill", [0.1, 0.0, 0.0], [0.2, 0.1, 0.05])]
    needles = Assembly((needle("n1", 0.0), *wall, needle("n2", 0.3)))
    with pytest.raises(InputError, match=r"^tool suction: got 'n1, n2: .* too small for a cup of"):
        l2a.build(needles, arm="ur5e")
    with pytest.raises(InputError, match=r"n1, n2: .* no two parallel faces for fingers"):
        l2a.build(needles, arm="ur5e", tool="gripper")
    with pytest.raises(InputError, match=r"blocks it can hold; no other tool holds all of them$"):
        l2a.build(needles, arm="ur5e")
    with pytest.raises(InputError, match=r"blocks it can hold; `tool=suction` holds all of them$"):
        l2a.build(Assembly(wall), arm="ur5e", tool="gripper")
    # Fingers of a Panda are short enough for what is flat.
    slats = Assembly((box_block("slat", [0.1, 0.0, 0.0], [0.14, 0.02, 0.01]),))
    flat = r"slat: no two faces at most 77 mm apart and 21 mm deep for fingers', .*; "
    other = "`arm=panda` holds all of them with `tool=gripper`"
    with pytest.raises(InputError, match=flat + other):
        check_held(get_arm("ur5e", "gripper"), pieces_of(slats))
    with pytest.raises(InputError, match=r"slat: .*; `tool=socket` holds all of them$"):
        check_held(get_arm("ur5e", "gripper"), pieces_of(slats), studs=0.008)
    check_held(UR5E, pieces_of(Assembly(wall)))
    heavy = dataclasses.replace(wall[0], density=20_000.0)
    with pytest.raises(InputError, match=r"sill: 10 kg is too heavy"):
        l2a.build(Assembly((heavy,)), arm="panda")


def test_blocks_that_cannot_be_turned_are_named() -> None:
    """A thin plate that stands on its edge: lying or standing, the cup has no face for both."""
    plate = box_block("plate", [0, 0, 0], [0.2, 0.02, 0.1])
    pieces = pieces_of(Assembly((plate,)))
    with pytest.raises(InputError, match=r"plate: .* no face for the cup both as it waits and as"):
        check_held(UR5E, pieces)


def test_solids_overlap_where_they_share_room() -> None:
    piece = pieces_of(Assembly((needle("n", 0.0),)))[0]
    near, far = piece.pose.copy(), piece.pose.copy()
    near[0] += 0.005
    far[0] += 0.021
    mine = solids(piece.shape, piece.pose)
    assert overlaps(mine, solids(piece.shape, near), 1e-4)
    assert not overlaps(mine, solids(piece.shape, far), 1e-4)


def test_a_run_takes_posts_that_the_arm_cannot_set_as_set_by_hand(arch: Plan) -> None:
    """It ended before anything moved: "hand touches v1"."""
    assert any(step.by_hand for step in arch.steps)
    said: list[str] = []

    def pause(_: int, words: str) -> bool:
        said.append(words)
        return False

    ran = l2a.run(arch, confirm=pause)
    assert said
    assert not ran.plan.complete


def test_a_run_counts_what_the_robot_did(small_arch: Plan) -> None:
    """Steps of the person are none of its blocks, and none of its seconds a block."""
    plan = small_arch
    done = sum(not step.by_hand for step in plan.steps)
    assert done < len(plan.steps)
    ran = l2a.run(plan)
    assert ran.complete, ran.reason
    assert ran.blocks == done


# ---------------------------------------------------------------- on what stands already


def on_piers(voussoirs: int = 7, height: float = 0.1) -> Assembly:
    """An arch on two piers that stand already."""
    angles = np.linspace(0, np.pi, voussoirs + 1)
    joints = [
        [(r * np.cos(a), y, height + r * np.sin(a)) for r in (0.16, 0.24) for y in (-0.05, 0.05)]
        for a in angles
    ]
    blocks = [hull_block(f"v{k}", joints[k] + joints[k + 1]) for k in range(voussoirs)]
    piers = [
        box_block(f"pier{k}", (x - 0.06, -0.06, 0), (x + 0.06, 0.06, height), support=True)
        for k, x in enumerate((-0.2, 0.2))
    ]
    return Assembly((*piers, *blocks), friction=0.6)


@pytest.mark.parametrize("physics", ["kinematic", "dynamic"])
def test_an_arm_builds_an_arch_on_piers_that_stand(physics: str) -> None:
    plan = l2a.build(on_piers(), arm="ur5e", physics=physics, seed=1)
    assert plan.complete, plan.reason
    assert plan.blocks.used == 7
    assert {step.action for step in plan.steps} == {"place", "remove"}  # Posts come and go.
    assert plan.assembly is not None
    assert l2a.check(plan.assembly).verdict == "stands"
    if physics == "dynamic":
        assert plan.arm is not None
        assert plan.arm.error_worst is not None
        assert plan.arm.error_worst < 1e-3
        again = l2a.run(plan)
        assert again.complete, again.reason


def test_two_arms_build_on_what_stands_and_noise_moves_none_of_it() -> None:
    old = box_block("old", (0, 0, 0), (0.32, 0.1, 0.05), support=True)
    raised = [higher(block, 0.05) for block in small_wall(0.0, 0.0).blocks]
    wall = Assembly((old, *raised), friction=0.6)
    both = l2a.build(wall, arm=("ur5e", "panda"), physics="kinematic")
    assert both.complete, both.reason
    one = l2a.build(wall, arm="ur5e", noise=(1e-3, 0.01), seed=2)
    assert one.complete, one.reason
    assert one.steps[0].action == "place"
    assert "old" not in {one.assembly.blocks[s.block].id for s in one.steps if one.assembly}
    # What has to be reached are the blocks that come.
    found = l2a.reach(wall, arm="ur5e")
    assert found.here.count == 6
    slab = box_block("slab", (-1, -1, -0.02), (1, 1, 0), support=True)
    low = Assembly((slab, *small_wall(0.0, 0.0).blocks), friction=0.6)
    assert l2a.build(low, arm="ur5e", physics="kinematic").complete
    for arm in ("ur5e", ("ur5e", "panda")):
        with pytest.raises(InputError, match="supports alone"):
            l2a.build(Assembly((old,)), arm=arm, physics="kinematic")
    # Arms stand beside what stands there, wherever they are told to.
    hall = [
        box_block(f"hall{k}", (x, -1.2, 0), (x + 1.5, 1.3, 0.1), support=True)
        for k, x in enumerate((-1.55, 0.37))
    ]
    inside = Assembly((*hall, *wall.blocks), friction=0.6)
    told = l2a.Site(base=(-0.4, 0.05, 0.0, 0.0))
    for arm, layout in (("ur5e", told), (("ur5e", "panda"), None)):
        with pytest.raises(InputError, match=r"base of .* m from supports"):
            l2a.build(inside, arm=arm, physics="kinematic", layout=layout)
    floating = Assembly(tuple(higher(block, 0.3) for block in wall.blocks), friction=0.6)
    with pytest.raises(InputError, match=r"lowest point is at z = 0\.3 m"):
        l2a.build(floating, arm="ur5e", physics="kinematic")


def higher(block: Block, up: float) -> Block:
    """The same block higher up."""
    return dataclasses.replace(block, vertices=np.add(block.vertices, (0.0, 0.0, up)))


# ---------------------------------------------------------------- wherever it stands


def small_wall(x: float, y: float) -> Assembly:
    """Six bricks with a corner at a point of the work plane."""
    size = (0.1, 0.1, 0.06)
    corners = [(x + 0.11 * (k % 3), y, size[2] * (k // 3)) for k in range(6)]
    blocks = [
        box_block(f"b{k}", at, tuple(np.add(at, size)), kind="brick", density=700.0)
        for k, at in enumerate(corners)
    ]
    return Assembly(tuple(blocks), friction=0.6)


@pytest.mark.parametrize("at", [(0.4, 0.2), (2.0, 1.0), (-61.0, 47.5)])
def test_an_arm_stands_before_a_structure_wherever_that_is(at: tuple[float, float]) -> None:
    """Models of other programs have their origin anywhere."""
    near, far = (
        l2a.build(small_wall(*place), arm="ur5e", physics="kinematic") for place in ((0, 0), at)
    )
    assert far.complete, far.reason
    assert near.arm is not None
    assert far.arm is not None
    assert far.arm.attempts == near.arm.attempts
    assert np.subtract(far.arm.base, near.arm.base)[:2] == pytest.approx(at, abs=2e-3)
    waiting = np.array(far.blocks.waiting)[:, :2]
    assert np.linalg.norm(waiting - far.arm.base[:2], axis=1).max() < 0.85


def test_two_arms_stand_on_both_sides_of_a_structure_wherever_that_is() -> None:
    plan = l2a.build(small_wall(2.0, 1.0), arm=("ur5e", "panda"), physics="kinematic")
    assert plan.complete, plan.reason
    assert [arm.reaches for arm in plan.arms] == [6, 6]
    assert np.mean([arm.base[:2] for arm in plan.arms], axis=0) == pytest.approx(
        [2.16, 1.05], abs=2e-3
    )
    found = l2a.reach(small_wall(2.0, 1.0), arm=("ur5e", "panda"))
    assert found.out == []


def test_what_stands_too_far_away_for_an_arm_is_said() -> None:
    expected = "design: got 'blocks 142 m from the origin', expected blocks within 90 m"
    for arm in ("ur5e", ("ur5e", "panda")):
        with pytest.raises(InputError, match=expected):
            l2a.build(small_wall(100.0, 100.0), arm=arm, physics="kinematic")


def test_magazines_of_a_layout_stand_on_the_table_about_a_structure() -> None:
    at = Magazine("brick", Pose(2.16, 0.85, 0.0))
    site = l2a.Site(magazines=(at,))
    done = l2a.build(small_wall(2.0, 1.0), arm="ur5e", physics="kinematic", layout=site)
    assert done.complete, done.reason
    # Where the layout says where the table is, it is there, and nothing is built beside it.
    with pytest.raises(InputError, match=r"table: got 'b0, b1, b2 .*not on it', expected all that"):
        l2a.build(
            small_wall(2.0, 1.0),
            arm="ur5e",
            physics="kinematic",
            layout=dataclasses.replace(site, table=(1.5, 1.0)),
        )


def test_what_an_arm_builds_in_its_own_order_is_proven_for_the_friction_that_was_asked_for() -> (
    None
):
    blocks = tuple(
        box_block(name, (x, 0.0, 0.0), (x + 0.05, 0.05, 0.05), kind="cube")
        for name, x in (("a", 0.0), ("b", 0.051))
    )
    alone = plan_assembly(Assembly(blocks), friction=(0.1, 0.6))
    assert [step.block for step in alone.steps] == [0, 1]
    # It stands to the left, and places what is farthest first.
    cell = Workcell("panda", site=Site(base=(-0.5, 0.0, 0.0, 0.0)), physics="kinematic")
    found = prepare(alone, cell, 0.0)
    plan = carry_out(alone, cell, joint=0.0, found=found)
    assert plan.complete
    assert [step.block for step in plan.steps] == [1, 0]
    for one in (alone, plan):
        assert one.margin_friction == 0.1
        assert all(0 < (step.margin_g or 0) <= 0.1 for step in one.steps)
    # A simulation has the friction of the blocks.
    assert setup_of(found.job, cell).friction == Assembly(blocks).friction == 0.5
