"""An arm carries out exact plans: order with reach, supply, repair, going on, what is refused."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from random import Random

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

import learn2assemble as l2a
from cell_shapes import wall
from learn2assemble.acting.carry_out import Workcell, carry_out, job_of, prepare
from learn2assemble.acting.state import Choice, area
from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.assembly.kit import Kit, load_kit
from learn2assemble.cell.pieces import QUARTER, Piece, Pose, pieces_of
from learn2assemble.cell.site import (
    Magazine,
    Obstacle,
    Pallet,
    Position,
    Site,
    read_site,
)
from learn2assemble.cell.structure import Structure
from learn2assemble.cell.world import STANDING, WorkcellBlocks, rows_of
from learn2assemble.design.cells import CellDesign
from learn2assemble.design.solids import mesh_boxes, read_mesh
from learn2assemble.errors import InputError
from learn2assemble.export.robot_programs import export_program
from learn2assemble.kinematics.chain import forward_many, get_chain
from learn2assemble.motion.record import RATE, find_fault
from learn2assemble.planning.plan import LARGEST, Plan
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.planning.tiling.ordering import polycube
from learn2assemble.plants.safety import Box, Safety
from learn2assemble.plants.setup import Disturbance
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.bodies import Part
from learn2assemble.statics.forces.equilibrium import margin, solve
from learn2assemble.statics.proofs import LOCAL, PROGRAM

ROOT = Path(__file__).resolve().parents[1]
KIT = dataclasses.replace(load_kit("bricks-lintels"), pitch=(0.04, 0.04, 0.04))


def planned(cells: np.ndarray, kit: Kit = KIT) -> Plan:
    plan = plan_cells(CellDesign("wall", cells, kit.pitch, None, 0.0, None, "", None), kit)
    assert plan.complete
    return plan


@pytest.fixture(scope="module")
def window() -> Plan:
    return planned(wall(8, 1, 5, (3, 6, 2, 4)))


def quick(**fields: object) -> Workcell:
    return Workcell("panda", "suction", physics="kinematic", **fields)


def stands_where_it_should(plan: Plan) -> None:
    """Every block of the finished structure is within 3 mm of its place in the assembly."""
    assert plan.complete, plan.reason
    assert plan.assembly is not None
    gone = {step.block for step in plan.steps if step.action == "remove"}
    for step in plan.steps:
        if step.action == "place" and step.block not in gone:
            block = plan.assembly.blocks[step.block]
            middle = (block.vertices.min(0) + block.vertices.max(0)) / 2
            assert np.linalg.norm(np.array(step.position) - middle) < 3e-3


# ---------------------------------------------------------------- blocks as boxes


def test_pieces_fill_their_blocks(window: Plan) -> None:
    assert window.assembly is not None
    for piece, block in zip(pieces_of(window.assembly), window.assembly.blocks, strict=True):
        low, high = piece.extent
        assert np.allclose([low, high], [block.vertices.min(0), block.vertices.max(0)], atol=1e-6)
        assert math.isclose(piece.mass / piece.density, block.volume, rel_tol=1e-4)
        assert piece.half[0] >= piece.half[1]


def in_every_turn(block: Block) -> tuple[Piece, ...]:
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = [dataclasses.replace(block, id="as it is")]
    for k in range(3):
        vertices = turned[-1].vertices @ quarter.T
        turned.append(dataclasses.replace(block, id=f"turned {k}", vertices=vertices))
    return pieces_of(Assembly(tuple(turned)))


@pytest.mark.parametrize(
    ("kind", "symmetric"), [("I", 4), ("O", 8), ("T", 2), ("S", 2), ("Z", 2), ("J", 1), ("L", 1)]
)
def test_tetrominoes_are_one_shape_in_every_turn(kind: str, symmetric: int) -> None:
    kit = load_kit("tetrominoes")
    cells = next(np.array(k.cells) for k in kit.kinds if k.name == kind)
    found = in_every_turn(Block(kind, *polycube(cells, kit, kit.joint_gap)))
    assert len({piece.shape for piece in found}) == 1
    assert len(found[0].turns()) == symmetric


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 20), st.integers(0, 5)), min_size=1, max_size=8))
def test_any_polycube_is_exactly_its_cells_inside_their_joints(growth: list[tuple]) -> None:
    cells = [(0, 0, 0)]
    for where, side in growth:
        step = np.eye(3, dtype=int)[side % 3] * (1 - 2 * (side // 3))
        cells.append(tuple((np.array(cells[where % len(cells)]) + step).tolist()))
    own = np.unique(np.array(cells) - np.min(cells, axis=0), axis=0)
    kit = load_kit("tetrominoes")
    block = Block("polycube", *polycube(own, kit, kit.joint_gap))
    half, edge = kit.joint_gap / 2, kit.pitch[0]
    level = [
        shapely.union_all(
            [
                shapely.box(x, y, x + edge, y + edge)
                for x, y, z in own * np.array(kit.pitch)
                if z == at
            ]
        )
        for at in np.unique(own[:, 2]) * kit.pitch[2]
    ]
    area = sum(shapely.buffer(face, -half, join_style="mitre").area for face in level)
    assert math.isclose(block.volume, area * kit.pitch[2], rel_tol=1e-9)
    found = in_every_turn(block)
    assert len({piece.shape for piece in found}) == 1
    assert all(part.hull is None for part in found[0].shape)
    boxes = sum(8 * np.prod(part.half) for part in found[0].shape)
    assert math.isclose(block.volume, boxes, rel_tol=1e-6)


# ---------------------------------------------------------------- the order


@pytest.mark.parametrize("arm", ["panda", "ur5e"])
def test_the_order_builds_from_below_and_every_state_is_proven(window: Plan, arm: str) -> None:
    job, structure, order, _ = prepare(window, Workcell(arm), KIT.joint_gap)
    assert not order.stuck
    assert sorted(order.steps) == sorted(job.steps)
    standing: set[int] = set()
    for step in order.steps:
        assert structure.below[step.block] <= standing
        standing.add(step.block)
        assert structure.stands(frozenset(standing))
    # One magazine for every kind, none of them on the site or on another.
    assert len(job.sources) == len({piece.shape for piece in job.pieces})
    faces = [source.area for source in job.sources]
    ground = [piece.face() for piece in job.pieces]
    for n, face in enumerate(faces):
        assert all(face.distance(other) > 0.005 for other in faces[:n])
        assert all(face.distance(other) > 0.05 for other in ground)


def test_what_falls_is_refused_by_the_structure(window: Plan) -> None:
    job = job_of(window, "panda", KIT.joint_gap)
    structure = Structure(job)
    above = next(k for k in range(len(job.pieces)) if structure.below[k])
    assert not structure.stands(frozenset({above}))


@settings(max_examples=12, deadline=None)
@given(st.randoms(use_true_random=False))
def test_margins_of_any_order_stay_below_those_of_programs(window: Plan, chance: Random) -> None:
    """Proofs that follow from one another against programs over all blocks that begin anew."""
    job = job_of(window, "panda", KIT.joint_gap)
    structure, standing = Structure(job), set[int]()
    left = set(range(len(job.pieces)))
    while left:
        free = sorted(k for k in left if structure.below[k] <= standing)
        if not free:
            break  # What is left stands on what fell.
        block = chance.choice(free)
        standing.add(block)
        left.discard(block)
        present = np.zeros(len(job.pieces), bool)
        present[list(standing)] = True
        shown = structure.proof(frozenset(standing))
        contacts = structure.lying
        stands = solve(job.assembly, contacts, job.friction, present=present).stands
        assert (shown is not None) >= stands
        if shown is None:
            standing.discard(block)  # It falls without one that comes later.
            continue
        worth = margin(job.assembly, contacts, job.friction, present=present)
        assert 0.5 * worth <= shown[1] <= 1.01 * worth + 1e-6


def test_scene_rows_are_the_boxes_where_they_are(window: Plan) -> None:
    job = prepare(window, quick(), KIT.joint_gap)[0]
    world = WorkcellBlocks(job)
    for k in range(4):
        world.pose[k], world.state[k] = world.target(k), STANDING
    rows = rows_of(world, world.pose, 3)
    assert rows.scene.num_placed == len(rows.scene.position) - len(job.pieces[3].shape)
    volume = 8 * rows.scene.halves.prod(1).sum()
    assert math.isclose(volume, sum(b.volume for b in job.assembly.blocks[:4]), rel_tol=1e-4)


# ---------------------------------------------------------------- carrying out


@pytest.fixture(scope="module")
def done(window: Plan) -> Plan:
    return carry_out(window, quick())


def test_a_wall_is_carried_out_with_one_attempt_a_block(done: Plan) -> None:
    plan = done
    stands_where_it_should(plan)
    assert plan.arm is not None
    assert plan.arm.attempts == len(plan.steps)
    assert plan.arm.attempts_per_step == 1.0
    assert Plan.from_dict(plan.to_dict()).arm == plan.arm


def test_in_another_order_every_step_is_proven_anew(window: Plan, done: Plan) -> None:
    plan = done
    assert [step.block for step in plan.steps] != [step.block for step in window.steps]
    assert plan.assembly is not None
    friction = plan.assembly.friction
    for step in plan.steps:
        assert step.proof in (LOCAL, PROGRAM)
        assert step.margin_g is not None
        assert 0 < step.margin_g <= friction + 1e-6
    # The finished wall is the same, and the planner's margin is a lower bound.
    planners, worth = window.steps[-1].margin_g, plan.steps[-1].margin_g
    assert planners is not None
    assert worth is not None
    assert planners <= worth <= 1.1 * planners
    # Loads pass down level joints without friction, as in the order of the planner.
    assert plan.friction_range == (0.0, LARGEST)
    assert plan.gap_range == (KIT.joint_gap, KIT.joint_gap)


def test_the_soma_cube_is_carried_out() -> None:
    kit = load_kit(ROOT / "examples" / "kits" / "soma.toml")
    plan = planned(np.load(ROOT / "examples" / "designs" / "soma_cube.npy"), kit)
    assert sorted(step.kind for step in plan.steps) == sorted(kind.name for kind in kit.kinds)
    stands_where_it_should(carry_out(plan, quick()))


def test_polycubes_are_carried_out() -> None:
    plan = carry_out(planned(np.ones((4, 4, 2), bool), load_kit("tetrominoes")), quick())
    stands_where_it_should(plan)


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 10**6))
def test_noise_of_readings_leaves_blocks_in_their_places(window: Plan, seed: int) -> None:
    noise = 5e-4, math.radians(0.2)
    plan = carry_out(window, quick(noise=noise, seed=seed))
    stands_where_it_should(plan)
    assert plan.arm is not None
    assert plan.arm.error_worst is not None
    assert plan.arm.error_worst < 2e-3


def test_what_was_pushed_goes_back_and_what_is_shifted_with_its_row_stays() -> None:
    plan = planned(wall(12, 1, 1))
    found = prepare(plan, quick(), KIT.joint_gap)
    known = Choice(found.job, found.order, found.structure)
    world, there = known.world, sorted({step.block for step in known.order})
    assert len(there) == 2
    left, right = sorted(there, key=lambda k: world.target(k)[0])
    for k in there:
        world.state[k], world.pose[k] = STANDING, world.target(k)

    def again() -> int | None:
        action = known.choose()
        assert not isinstance(action, str)
        assert action is None or action.what == "again"
        return None if action is None else action.block

    # Both by 2 mm: the one behind has nothing that keeps it there, the one ahead has that one.
    for off, wrong in ((2e-3, left), (1e-3, None)):
        for k in there:
            world.pose[k, 0] = world.target(k)[0] + off
        assert again() == wrong
    world.pose[right, 0] = world.target(right)[0] + 2e-3
    world.pose[left] = world.target(left)
    assert again() == right
    world.spread[right] = 5e-4, 0.0
    assert again() is None, "nor is it certain then"


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 10**6), st.sets(st.integers(2, 7), max_size=3))
def test_pushed_and_dropped_blocks_are_repaired(window: Plan, seed: int, when: set[int]) -> None:
    mixed = sorted(when)
    disturbance = Disturbance(drop=frozenset(mixed[::2]), push=frozenset(mixed[1::2]))
    plan = carry_out(window, quick(seed=seed, disturbance=disturbance))
    stands_where_it_should(plan)
    assert plan.arm is not None
    assert plan.arm.attempts >= len(plan.steps)
    assert sum(f.outcome == "dropped" for f in plan.arm.failures) <= len(disturbance.drop)


def test_an_interrupted_build_goes_on_to_the_same_end(window: Plan, tmp_path: Path) -> None:
    whole = carry_out(window, quick(noise=(5e-4, 0.002)))
    log = tmp_path / "build.jsonl"
    carry_out(window, quick(noise=(5e-4, 0.002), log=log))
    lines = log.read_text().split("\n")
    # As a kill in the middle of a write leaves it.
    log.write_text("\n".join(lines[:6]) + "\n" + lines[6][: len(lines[6]) // 2])
    resumed = carry_out(window, quick(noise=(5e-4, 0.002), log=log))
    assert [s.position for s in resumed.steps] == [s.position for s in whole.steps]
    assert resumed.arm is not None
    assert whole.arm is not None
    assert resumed.arm.attempts == whole.arm.attempts
    content = log.read_bytes()
    head, first, *rest = content.split(b"\n")
    state = json.loads(first)
    state["joints"][0] += 1e-3
    moved = json.dumps(state).encode()
    # Refused, and left as it is: bits that turned, another number, half a line within, no file of
    # ours at all.
    for wrong in (
        [head, first[:99] + bytes([first[99] ^ 0x80]) + first[100:], *rest],
        [head, moved, *rest],
        [head, first[:-9], *rest],
        [head, b"[]", *rest],
        [b"\x89PNG"],
    ):
        log.write_bytes(b"\n".join(wrong))
        with pytest.raises(InputError, match="--resume"):
            carry_out(window, quick(noise=(5e-4, 0.002), log=log))
        assert log.read_bytes() == b"\n".join(wrong)
    log.write_bytes(content)
    other = quick(noise=(5e-4, 0.002), log=log, seed=5)
    with pytest.raises(InputError, match="the same design"):
        carry_out(window, other)
    with pytest.raises(InputError, match="layout, seed, physics and noise as before"):
        carry_out(window, quick(noise=(0.0, 0.0), log=log))


# ---------------------------------------------------------------- the workcell of a user


def written(tmp_path: Path, **fields: object) -> Path:
    path = tmp_path / "layout.json"
    path.write_text(json.dumps({"format": "learn2assemble-layout", "version": 2, **fields}))
    return path


def test_blocks_come_from_where_the_layout_says(window: Plan, tmp_path: Path) -> None:
    kinds = sorted({step.kind for step in window.steps if step.kind})
    first = kinds[0]
    count = sum(step.kind == first for step in window.steps)
    path = written(
        tmp_path,
        base={"position": [0, -0.5, 0], "yaw": QUARTER},
        magazines=[
            {"kind": kind, "at": [0.34, -0.3 + 0.08 * n, 0.0]} for n, kind in enumerate(kinds[1:])
        ],
        pallets=[
            {
                "kind": first,
                "at": [-0.35, -0.3],
                "rows": 1 + count,
                "columns": 1,
                "pitch": [0.1, 0.06],
            }
        ],
        obstacles=[{"at": [-0.4, 0.3], "size": [0.1, 0.1, 0.1]}],
    )
    site = read_site(path)
    job, _, order, _ = prepare(window, quick(site=site), KIT.joint_gap)
    assert not order.stuck
    assert len(job.sources) == len(kinds) - 1 + count
    stands_where_it_should(carry_out(window, quick(site=site)))


@pytest.mark.parametrize("count", [0, 1])
def test_a_magazine_that_runs_empty_pauses_the_build(
    window: Plan, tmp_path: Path, count: int
) -> None:
    kinds, log = [step.kind or "" for step in window.steps], tmp_path / "build.jsonl"
    kind = max(kinds, key=kinds.count)
    assert kinds.count(kind) > 1
    site = Site(magazines=(Magazine(kind, Pose(0.0, -0.2), count),))
    paused = carry_out(window, quick(site=site, log=log))
    assert paused.status == "incomplete"
    # What is lacking is told of its own kind alone; what lies on it waits.
    waiting = len(window.steps) - len(paused.steps) - 1
    told = f"({kind}) cannot be placed: no {kind} is left in the supply"
    assert (paused.reason or "").partition(" ")[2] == f"{told}; {waiting} more wait for that"
    assert bool(count) <= len(paused.steps) < len(window.steps)
    filled = Site(magazines=(Magazine(kind, Pose(0.0, -0.2), 99),))
    whole = carry_out(window, quick(site=filled, log=log))
    stands_where_it_should(whole)
    assert whole.arm is not None
    assert whole.arm.attempts == len(window.steps)


def test_less_force_than_a_block_at_rest_presses_with_ends_a_build() -> None:
    plan = planned(np.ones((4, 1, 1), bool))
    site = Site(safety=Safety(force=0.2))
    done = carry_out(plan, Workcell("panda", site=site), joint=1e-4)
    assert done.status == "incomplete"
    assert done.reason is not None
    assert "touches" in done.reason


def test_a_build_keeps_the_rules_of_its_layout(tmp_path: Path) -> None:
    plan = planned(np.ones((2, 1, 1), bool), dataclasses.replace(KIT, kinds=(KIT.kind("1x2"),)))
    low = Site(safety=Safety(box=Box((-2.0, -2.0, 0.3), (2.0, 2.0, 2.0))))
    log = tmp_path / "build.jsonl"
    stopped = carry_out(plan, quick(site=low, log=log))
    assert stopped.status == "incomplete"
    # Nothing was asked of the plant, and nothing was in the hand.
    assert (stopped.reason or "").startswith("the tool ")
    assert "safety.box" in (stopped.reason or "")
    assert stopped.arm is not None
    [failure] = stopped.arm.failures
    assert failure.outcome == "stopped"
    assert failure.detail.startswith("place block-1: interrupted: the tool ")
    # When the rule is another one it goes on, slowly.
    slow = Site(safety=Safety(speed=0.1))
    stands_where_it_should(carry_out(plan, quick(site=slow, log=log)))
    done = carry_out(plan, Workcell("panda", "suction", site=slow))
    stands_where_it_should(done)
    assert done.record is not None
    joints = done.record.joined()[0].joints
    tool = forward_many(get_chain(get_arm("panda", "suction")), np.ascontiguousarray(joints))[0]
    speed = np.linalg.norm(np.diff(tool, axis=0), axis=1) * RATE
    assert 0.05 < speed.max() < 0.101


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ({"base": {"position": [2.0, 0, 0]}}, "out of it"),
        ({"base": {"position": [0, 0]}}, "base.position"),
        ({"magazines": [{"kind": "1x4", "at": [0, 0]}]}, "building site"),
        ({"magazines": [{"kind": "1x4", "at": [0.9, 0]}]}, "on the table"),
        ({"magazines": [{"kind": "1x4"}]}, "at"),
        ({"magazines": [{"kind": "1x4", "at": [0.2, -0.3], "count": -1}]}, "0 or more"),
        (
            {
                "pallets": [
                    {"kind": "1x4", "at": [0.2, -0.3], "rows": 0, "columns": 1, "pitch": [0.1, 0.1]}
                ]
            },
            "rows",
        ),
        ({"obstacles": [{"at": [0, 0], "size": [0.1, 0.1, 0.1]}]}, "building site"),
        (
            {
                "obstacles": [{"at": [0, -0.25], "size": [0.1, 0.1, 0.1]}],
                "magazines": [{"kind": "1x4", "at": [0, -0.25]}],
            },
            "obstacles",
        ),
        (
            {
                "magazines": [
                    {"kind": "1x4", "at": [0.2, -0.3]},
                    {"kind": "1x4", "at": [0.22, -0.3]},
                ]
            },
            "magazines[1]: got [0.22, -0.3, 0.0], expected a place that does not overlap "
            "magazines[0]",
        ),
        ({"obstacles": [{"at": [0, 0], "size": [0, 0.1, 0.1]}]}, "positive"),
        (
            {"magazines": [{"kind": "1x4", "at": [0.2, -0.3]}, {"kind": "1x44", "at": [0, -0.3]}]},
            "magazines[1].kind: got '1x44', expected one of 1x4; did you mean '1x4'?",
        ),
        (
            {
                "pallets": [
                    {"kind": "lx4", "at": [0.2, -0.3], "rows": 1, "columns": 1, "pitch": [0.1, 0.1]}
                ]
            },
            "pallets[0].kind",
        ),
        ({"positions": [{"kind": "1x8", "at": [0.2, -0.3]}]}, "positions[0].kind"),
        ({"heaps": []}, "heaps"),
        ({"version": 3}, "version: got 3, expected 2"),
        ({"version": 1, "positions": []}, "version: got 1, expected 2"),
        ({"positions": [[0.2, -0.3]]}, "positions[0]"),
        (
            {"positions": [{"kind": "1x4", "at": [0.2, -0.3]}]},
            "pallets and positions: got '1 of 2 1x4', expected places for all blocks of a kind",
        ),
        ({"table": [0.3, 0.5]}, "layout.json: table: got '"),
    ],
)
def test_layouts_that_cannot_be_used(tmp_path: Path, fields: dict[str, object], what: str) -> None:
    plan = planned(np.ones((8, 1, 1), bool), dataclasses.replace(KIT, kinds=(KIT.kind("1x4"),)))
    with pytest.raises(InputError) as error:
        carry_out(plan, quick(site=read_site(written(tmp_path, **fields))))
    assert what in str(error.value)
    assert "\n" not in str(error.value)


def test_a_position_without_a_kind_holds_the_next_block(tmp_path: Path) -> None:
    places = [[0.25, -0.3], [0.25, -0.2, 0.3], [0.25, -0.1]]
    site = read_site(written(tmp_path, positions=[{"at": place} for place in places]))
    assert site.positions[1] == Position(None, Pose(0.25, -0.2, 0.3))
    plan = planned(np.ones((1, 1, 3), bool), dataclasses.replace(KIT, kinds=(KIT.kind("1x1"),)))
    done = carry_out(plan, quick(site=site))
    stands_where_it_should(done)
    assert done.arm is not None
    assert done.arm.places == 3


def test_pallets_are_rows_and_columns() -> None:
    pallet = Pallet("1x1", Pose(0.1, 0.2, QUARTER), 2, 3, (0.1, 0.3))
    poses = pallet.poses()
    assert len(poses) == 6
    assert np.allclose(poses[2][:2], [0.1, 0.4])
    assert np.allclose(poses[3][:2], [-0.2, 0.2])


# ---------------------------------------------------------------- what is refused


def test_blocks_too_small_or_too_heavy_for_the_tool() -> None:
    small = dataclasses.replace(KIT, pitch=(0.02, 0.02, 0.02))
    with pytest.raises(InputError, match="too small"):
        carry_out(planned(np.ones((4, 1, 2), bool), small), quick())
    heavy = dataclasses.replace(KIT, density=20_000.0)
    with pytest.raises(InputError, match="too heavy"):
        carry_out(planned(np.ones((8, 2, 2), bool), heavy), quick())
    gripper = dataclasses.replace(quick(), tool="gripper")
    thick = planned(np.ones((2, 2, 1), bool), dataclasses.replace(KIT, pitch=(0.1, 0.1, 0.05)))
    with pytest.raises(InputError, match="no two faces"):
        carry_out(thick, gripper)


def test_a_design_out_of_reach_names_blocks_and_a_base(window: Plan) -> None:
    far = Site(base=(-1.2, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match=r"blocks out of it: block-.*a base at \["):
        carry_out(window, quick(site=far))


def test_fingers_take_what_stands_alone_and_say_what_does_not() -> None:
    cubes, gripper = load_kit("cubes"), dataclasses.replace(quick(), tool="gripper")
    stands_where_it_should(carry_out(planned(np.ones((4, 1, 3), bool), cubes), gripper))
    thick = carry_out(planned(np.ones((3, 3, 1), bool), cubes), gripper)
    assert thick.status == "refused"
    assert "cannot place block-" in (thick.reason or "")
    assert "; with `tool=suction` there is an order" in (thick.reason or "")


def test_reach_reports_the_best_base() -> None:
    design = CellDesign("wall", np.ones((6, 1, 3), bool), KIT.pitch, None, 0.0, None, "", None)
    near = l2a.reach(design, arm="ur5e", kit=KIT)
    assert near.complete
    far = l2a.reach(design, arm="ur5e", kit=KIT, layout=Site(base=(-1.5, 0.0, 0.0, 0.0)))
    assert len(far.here.out) == near.here.count
    assert not far.best.out
    assert Obstacle((0.0, 0.0), (1.0, 1.0, 1.0)).yaw == 0.0


def test_build_with_the_exact_planner_and_an_arm(window: Plan, tmp_path: Path) -> None:
    design = CellDesign("wall", np.ones((4, 1, 2), bool), KIT.pitch, None, 0.0, None, "", None)
    plan = l2a.build(design, planner="exact", kit=KIT, arm="panda", physics="kinematic")
    stands_where_it_should(plan)
    files = plan.save(tmp_path)
    assert Plan.load(files["plan"]).arm == plan.arm
    with pytest.raises(InputError, match="tool"):
        l2a.build(design, planner="exact", kit=KIT, arm="panda", tool="suctoin")
    with pytest.raises(InputError, match="physics"):
        l2a.build(design, planner="exact", kit=KIT, arm="panda", physics="static")
    with pytest.raises(InputError, match="an arm"):
        l2a.build(design, planner="exact", kit=KIT, tool="suction")


# ---------------------------------------------------------------- the dynamic cell


def test_a_dynamic_build_is_repaired_resumed_and_recorded(tmp_path: Path) -> None:
    """Kill it after two attempts, drop one block, and the record of the whole is sound."""
    plan = planned(np.ones((4, 1, 2), bool), dataclasses.replace(KIT, kinds=(KIT.kind("1x2"),)))
    dropping = Disturbance(drop=frozenset({3}))
    log = tmp_path / "build.jsonl"
    how = Workcell("panda", "suction", disturbance=dropping, log=log)
    first = carry_out(plan, how)
    lines = log.read_text().splitlines()
    log.write_text("\n".join(lines[:3]) + "\n")
    whole = carry_out(plan, how)
    for done in (first, whole):
        stands_where_it_should(done)
        assert done.arm is not None
        assert done.arm.attempts > len(plan.steps)
        assert done.arm.error_worst is not None
        assert done.arm.error_worst < 1e-3
        assert done.record is not None
        assert len(done.record.steps) == done.arm.attempts
        assert find_fault(done.record) is None
    assert [s.position for s in whole.steps] == [s.position for s in first.steps]
    # To the last bit, on every machine.
    assert first.record is not None
    assert whole.record is not None
    for one, other in zip(first.record.steps, whole.record.steps, strict=True):
        assert np.array_equal(one.samples.joints, other.samples.joints)
    files = whole.save(tmp_path / "out", video=False)
    assert Plan.load(files["plan"]).record is not None
    # A finished build keeps its files whatever its motion is like; only its export is refused.
    record = whole.record
    assert record is not None
    slow = dataclasses.replace(record.arm, velocity=record.arm.velocity / 100)
    broken = dataclasses.replace(whole, records=(dataclasses.replace(record, arm=slow),))
    found = Plan.load(broken.save(tmp_path / "broken", page=False)["plan"])
    assert found.complete
    assert found.record is not None
    assert found.arm is not None
    assert "rad/s" in (found.arm.motion_fault or "")
    with pytest.raises(InputError, match="rad/s"):
        export_program(found.record, "csv", tmp_path / "program.csv")


def bracket(path: Path, gap: float = 0.0) -> np.ndarray:
    """Write a gate of three bars, 200 x 40 x 160 mm, in millimetres; its triangles [m]. With a gap
    it is open there."""
    from manifold3d import Manifold

    def bar(low: tuple[int, int, int], size: tuple[int, int, int]) -> Manifold:
        return Manifold.cube(size).translate(low)

    gate = bar((0, 0, 0), (30, 40, 160)) + bar((170, 0, 0), (30, 40, 160))
    mesh = (gate + bar((0, 0, 130), (200, 40, 30))).to_mesh()
    faces = np.asarray(mesh.vert_properties)[:, :3][np.asarray(mesh.tri_verts)]
    if gap:
        faces = faces[1:]
    record = np.zeros(len(faces), [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    record["v"] = faces
    path.write_bytes(bytes(80) + np.uint32(len(faces)).tobytes() + record.tobytes())
    return faces / 1000


def test_boxes_cover_a_mesh_and_leave_its_opening_free(tmp_path: Path) -> None:
    faces = bracket(tmp_path / "gate.stl")
    layout = {
        "format": "learn2assemble-layout",
        "version": 2,
        "obstacles": [{"at": [0.4, 0.2], "mesh": "gate.stl", "unit": 0.001, "yaw": math.pi / 2}],
    }
    (tmp_path / "layout.json").write_text(json.dumps(layout))
    boxes = read_site(tmp_path / "layout.json").obstacles
    assert 3 <= len(boxes) <= 48
    assert {box.name for box in boxes} == {"obstacles[0]"}
    rng = np.random.default_rng(0)
    weight = rng.dirichlet(np.ones(3), (200, len(faces)))
    points = np.einsum("nfk,fkd->nfd", weight, faces).reshape(-1, 3) - [0.1, 0.02, 0.0]
    points = np.column_stack([0.4 - points[:, 1], 0.2 + points[:, 0], points[:, 2]])

    def inside(where: np.ndarray) -> np.ndarray:
        # Turned by a quarter, so x and y of their sizes change places.
        half = np.array([box.size for box in boxes])[:, [1, 0, 2]] / 2 + 1e-6
        middle = np.array([box.middle for box in boxes])
        within = np.all(np.abs(where[:, None] - middle) <= half, axis=2)
        return np.asarray(np.any(within, axis=1))

    assert inside(points).all()
    # Of the opening, 140 x 130 mm, nearly all is left free.
    free = rng.uniform([0.38, 0.2 - 0.06, 0.0], [0.42, 0.2 + 0.06, 0.12], (500, 3))
    assert inside(free).mean() < 0.2


@pytest.mark.parametrize("unit", [0.001, 0.0003, 0.01])
def test_boxes_of_a_mesh_with_faces_in_the_planes_of_cuts_have_volume(unit: float) -> None:
    dome = ROOT / "examples" / "designs" / "dome.stl"
    boxes = mesh_boxes(dome, unit, "mesh")
    sizes = np.array([high - low for low, high in boxes])
    assert (sizes.min(1) > 1e-3 * sizes.max()).all()
    whole = np.array(boxes).reshape(-1, 3)
    size = np.ptp(read_mesh(dome.read_bytes(), "stl", "dome").triangles.reshape(-1, 3), axis=0)
    assert np.allclose(np.ptp(whole, axis=0), unit * size)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"mesh": "none.stl"}, r"none.stl: got 'no such file', expected a mesh \(.*obstacles"),
        ({"mesh": "open.stl"}, "closed mesh"),
        ({"mesh": "text.stl"}, "text.stl"),
        ({"mesh": "gate.step"}, "a file in stl, obj, ply, glb, 3dm"),
        ({"mesh": 3}, r"obstacles\[0\].mesh"),
        ({"mesh": "gate.stl"}, "unit"),
        ({"mesh": "gate.stl", "unit": 0}, r"obstacles\[0\].unit"),
        ({"mesh": "gate.stl", "unit": "mm"}, r"obstacles\[0\].unit"),
        ({"mesh": "gate.stl", "size": [1, 1, 1]}, "size"),
    ],
)
def test_bad_meshes_are_refused_in_one_line(
    tmp_path: Path, entry: dict[str, object], words: str
) -> None:
    bracket(tmp_path / "gate.stl")
    bracket(tmp_path / "open.stl", 1.0)
    (tmp_path / "text.stl").write_text("hello")
    (tmp_path / "gate.step").write_text("hello")
    layout = {
        "format": "learn2assemble-layout",
        "version": 2,
        "obstacles": [{"at": [0.4, 0.2], **entry}],
    }
    (tmp_path / "layout.json").write_text(json.dumps(layout))
    with pytest.raises(InputError, match=words) as caught:
        read_site(tmp_path / "layout.json")
    assert "\n" not in str(caught.value)


def test_obstacles_stay_where_they_are() -> None:
    plan = planned(np.ones((4, 1, 1), bool), dataclasses.replace(KIT, kinds=(KIT.kind("1x2"),)))
    site = Site(obstacles=(Obstacle((0.25, 0.0), (0.1, 0.1, 0.2)),))
    done = carry_out(plan, Workcell("ur5e", "suction", site=site))
    stands_where_it_should(done)
    assert done.record is not None
    box = done.record.objects[len(plan.steps)][0]
    assert np.allclose(done.record.steps[-1].after[box, :3], [0.25, 0.0, 0.1], atol=1e-6)


def test_the_area_of_a_block_is_all_that_lies_below_it() -> None:
    """Of boxes, turned about any axis: as large as the shadow of their corners."""
    shape = (Part((0.0, 0.0, 0.0), (0.05, 0.02, 0.01)),)
    piece = Piece("b", "brick", False, 700.0, shape, np.zeros(3), np.eye(3), np.eye(3))
    flat = np.array([0.3, 0.1, 0.01, 1, 0, 0, 0])
    assert area(piece, flat).area == pytest.approx(0.1 * 0.04)
    assert area(piece, flat).bounds == pytest.approx((0.25, 0.08, 0.35, 0.12))
    side = np.array([0.3, 0.1, 0.02, math.sqrt(0.5), math.sqrt(0.5), 0, 0])
    assert area(piece, side).area == pytest.approx(0.1 * 0.02), "on its long side"
    diagonal = np.array([0.3, 0.1, 0.01, math.cos(0.4), 0, 0, math.sin(0.4)])
    assert area(piece, diagonal).area == pytest.approx(0.1 * 0.04)
