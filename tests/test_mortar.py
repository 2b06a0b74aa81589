"""Mortar while one builds: joints are dry until they have had their time, then they hold."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import learn2assemble as l2a
from cell_shapes import wall
from learn2assemble.assembly.blocks import Assembly, AssemblyStep, Block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.files import from_json, read_assembly, to_json
from learn2assemble.assembly.joints import DRY, Joint
from learn2assemble.assembly.kit import Kit, load_kit
from learn2assemble.cli import main
from learn2assemble.constants import GRAVITY
from learn2assemble.errors import InputError
from learn2assemble.geometry.hulls import kern
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.given import plan_assembly
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.cover.retiling import Retiling
from learn2assemble.planning.tiling.cover.tile import tile
from learn2assemble.planning.tiling.finished import stand_by_mortar
from learn2assemble.statics.holding.program import balance_of
from learn2assemble.statics.holding.solver import STATUS, new_solver, run_within
from learn2assemble.statics.proofs import MORTAR
from learn2assemble.statics.rigid_blocks import FALLS, STANDS, check

LONG, WIDE, HIGH, DENSITY = 0.2, 0.1, 0.05, 2000.0
WEIGHT = DENSITY * LONG * WIDE * HIGH * GRAVITY
AGE = 24.0


def brick(number: int, x: float, z: int) -> Block:
    low = x, 0.0, z * HIGH
    return box_block(f"b{number}", low, (x + LONG, WIDE, low[2] + HIGH), density=DENSITY)


def corbel(tensile: float, age: float = AGE) -> Assembly:
    """Three bricks, each 0.08 m farther out than the one below."""
    joint = Joint("mortar", tensile=tensile, shear=1e9, age=age)
    return Assembly(tuple(brick(k + 1, 0.08 * k, k) for k in range(3)), joint=joint)


def bracket(tensile: float, age: float = AGE) -> Assembly:
    """A brick that lies on another one with less than half of it."""
    joint = Joint("mortar", tensile=tensile, shear=1e9, age=age)
    return Assembly((brick(1, 0.0, 0), brick(2, 0.12, 1)), joint=joint)


NEEDED = 6 * WEIGHT / (0.12 * WIDE)
"""Of the corbel: the middle of its upper two bricks is e = 0.08 m beside that of the joint they
hang on, which is L = 0.12 m long. Stress that varies linearly pulls 2 W / A (6 e / L - 1) at its
end."""
BRACKET = 3.5 * WEIGHT / (0.08 * WIDE)
"""Of the bracket: W / A (6 e / L - 1) with e = 0.06 m and L = 0.08 m."""


def told(plan: Plan) -> list[str]:
    """What is done, in words."""
    assert plan.assembly is not None
    return [
        "wait " * (step.wait is not None) + f"{step.action} {step.block}"
        for step in plan.assembly.steps
    ]


def test_a_corbel_waits_before_the_brick_that_dry_joints_do_not_carry() -> None:
    plan = plan_assembly(corbel(1.02 * NEEDED), supports="none")
    assert plan.status == "complete"
    assert told(plan) == ["place b1", "place b2", "wait place b3"]
    assert [step.proof == MORTAR for step in plan.steps] == [False, False, True]
    assert [step.wait_h for step in plan.steps] == [None, None, AGE]
    assert plan.steps[2].margin_g is not None


def test_mortar_that_is_too_weak_is_refused() -> None:
    assert check(corbel(1.02 * NEEDED)).verdict == STANDS
    assert check(corbel(0.98 * NEEDED)).verdict == FALLS
    assert plan_assembly(corbel(0.98 * NEEDED)).status == "refused"


def test_a_post_stays_until_the_joint_holds() -> None:
    plan = plan_assembly(bracket(1.02 * BRACKET))
    assert plan.status == "complete"
    post = next(block.id for block in plan.assembly.blocks if block.prop)
    assert told(plan) == ["place b1", f"place {post}", "place b2", f"wait remove {post}"]
    assert plan_assembly(bracket(1.02 * BRACKET), supports="none").status == "incomplete"
    assert plan_assembly(bracket(0.98 * BRACKET)).status == "refused"


def test_a_hand_holds_until_the_joint_does() -> None:
    plan = plan_assembly(bracket(1.02 * BRACKET), supports="none", holds=1)
    assert plan.status == "complete"
    assert told(plan) == ["place b1", "place b2", "hold b2", "wait release b2"]


def test_mortar_that_holds_at_once_needs_no_help() -> None:
    plan = plan_assembly(bracket(1.02 * BRACKET, age=0.0), supports="none")
    assert (plan.status, told(plan)) == ("complete", ["place b1", "place b2"])


def test_without_strength_it_is_dry() -> None:
    for given in (corbel(0.0), bracket(0.0)):
        weak = replace(given, joint=replace(given.joint, shear=0.0))
        dry = replace(given, joint=Joint())
        assert check(weak).verdict == check(dry).verdict == FALLS
        one, other = plan_assembly(weak), plan_assembly(dry)
        assert (one.status, one.reason, one.steps) == (other.status, other.reason, other.steps)


def test_what_stands_dry_is_built_as_if_it_were_dry() -> None:
    tower = Assembly(tuple(brick(k + 1, 0.02 * k, k) for k in range(3)))
    mortared = replace(tower, joint=corbel(1e5).joint)
    one, other = plan_assembly(mortared), plan_assembly(tower)
    assert one.status == "complete"
    assert one.steps == other.steps


def test_an_order_of_a_file_is_proven_with_its_waits() -> None:
    def with_wait(hours: float | None) -> Assembly:
        steps = [AssemblyStep(place="b1"), AssemblyStep(place="b2")]
        return replace(corbel(1.02 * NEEDED), steps=(*steps, AssemblyStep(place="b3", wait=hours)))

    good = with_wait(AGE)
    again = from_json(to_json(good))
    assert again.steps == good.steps
    assert plan_assembly(again).status == "complete"
    for short in (None, AGE / 2):
        plan = plan_assembly(with_wait(short))
        assert (plan.status, len(plan.steps)) == ("incomplete", 2)
        assert "b3" in (plan.reason or "")
    with pytest.raises(InputError, match="wait"):
        AssemblyStep(place="b1", wait=float("nan"))


def test_mortar_fills_joints_side_by_side() -> None:
    """A brick between two supports hangs on its sides; dry it would fall for certain."""
    left = box_block("left", (-0.1, 0, 0), (0, 0.1, 0.2), support=True)
    right = box_block("right", (0.2, 0, 0), (0.3, 0.1, 0.2), support=True)
    middle = box_block("middle", (0, 0, 0.1), (0.2, 0.1, 0.2), density=DENSITY)
    weight = DENSITY * 0.2 * 0.1 * 0.1 * GRAVITY
    # Half of the weight on each joint of 0.1 m x 0.1 m.
    for factor, verdict in ((1.01, STANDS), (0.99, FALLS)):
        shear = factor * weight / 2 / 0.01
        joint = Joint("mortar", tensile=1.0, shear=shear, age=AGE)
        given = Assembly((left, right, middle), friction=0.0, joint=joint)
        assert check(given).verdict == verdict


def glued(shear: float, friction: float, tensile: float = 1e9) -> Assembly:
    """A block of 0.2 x 0.1 x 0.1 m that hangs by a side of 0.1 x 0.1 m on a wall."""
    support = box_block("wall", (-0.2, 0, 0), (0, 0.1, 0.4), support=True)
    block = box_block("block", (0, 0, 0.1), (0.2, 0.1, 0.2), density=DENSITY)
    joint = Joint("mortar", tensile=tensile, shear=shear, age=AGE)
    return Assembly((support, block), friction=friction, joint=joint)


def test_mortar_does_not_rub_on_its_own_strength() -> None:
    """Nothing presses the joint of a block that hangs by its side: its shear strength bears all."""
    area = 0.1 * 0.1
    weight = DENSITY * 0.2 * area * GRAVITY
    bent = weight * 0.1 / (0.1**3 / 6)
    for friction in (0.0, 0.5):
        # The tension at its upper edge is on the line of Mohr and Coulomb, too.
        least = max(weight / area, friction * bent)
        assert check(glued(1.01 * least, friction)).verdict == STANDS
        for share in (0.0, 0.05, 0.99):
            assert check(glued(share * least, friction)).verdict == FALLS, share
    assert check(glued(0.51 * bent, 0.5, 1.01 * bent)).verdict == STANDS
    assert check(glued(0.51 * bent, 0.5, 0.99 * bent)).verdict == FALLS


def test_what_presses_mortar_adds_friction_once() -> None:
    """A flat brick under a push along its bed: c A + mu W, and an octagon inside the circle."""
    ground = box_block("ground", (-1, -1, -1), (1, 1, 0), support=True)
    flat = box_block("flat", (0, 0, 0), (0.2, 0.2, 0.01), density=DENSITY)
    given = Assembly((ground, flat), friction=0.5, joint=Joint("mortar", tensile=1e3, shear=1e3))
    weight = DENSITY * 0.2 * 0.2 * 0.01 * GRAVITY
    most = (1e3 * 0.2 * 0.2 + 0.5 * weight) / weight
    assert 0.91 * most < check(given).margin_g < 1.001 * most


@pytest.mark.parametrize("beside", [(0.0, 0.0), (0.02, 0.0), (0.02, 0.03)])
def test_mortar_pulls_nowhere_more_than_it_can(beside: tuple[float, float]) -> None:
    """A block hangs under a joint of 0.1 x 0.1 m with its middle beside that of the joint along
    both axes: W / A (1 + 6 e_x / L + 6 e_y / L)."""
    long, wide = (0.1 + 2 * e for e in beside)
    support = box_block("beam", (-1, -1, 0.2), (0.1, 0.1, 0.3), support=True)
    block = box_block("block", (0, 0, 0.1), (long, wide, 0.2), density=DENSITY)
    weight = DENSITY * long * wide * 0.1 * GRAVITY
    needed = weight / 0.1**2 * (1 + 6 * sum(beside) / 0.1)
    for factor, verdict in ((1.01, STANDS), (0.99, FALLS)):
        joint = Joint("mortar", tensile=factor * needed, shear=1e9)
        assert check(Assembly((support, block), joint=joint)).verdict == verdict


def test_the_kern_of_a_rectangle_and_of_a_triangle_by_hand() -> None:
    """A third as long and as wide, corner to corner of the middles of sides; a quarter as large."""
    rectangle, triangle = [[1, 1], [4, 1], [4, 2], [1, 2]], [[0, 0], [3, 0], [0, 3]]
    for corners, middle, spots in (
        (rectangle, [2.5, 1.5], [[2, 1.5], [2.5, 4 / 3], [2.5, 5 / 3], [3, 1.5]]),
        (triangle, [1, 1], [[0.75, 0.75], [0.75, 1.5], [1.5, 0.75]]),
    ):
        for way in (1, -1):
            found = kern(np.array(corners, float)[::way])
            assert found is not None
            assert found[0] == pytest.approx(middle)
            assert np.array(sorted(found[1].round(9).tolist())) == pytest.approx(np.array(spots))
    assert kern(np.array([[0, 0], [1, 0], [2, 0.0]])) is None


def test_mortar_that_cracks_may_stand_dry() -> None:
    """Its middle is outside the kern of the joint, but over the joint."""
    joint = Joint("mortar", tensile=1.0, shear=1.0)
    over = Assembly((brick(1, 0.0, 0), brick(2, 0.09, 1)), joint=joint)
    assert check(over).verdict == check(replace(over, joint=DRY)).verdict == STANDS


def test_forces_at_corners_do_what_those_of_the_kern_do() -> None:
    """Those that are shown turn the upper two bricks of a corbel as their weight does."""
    found = check(corbel(1.5 * NEEDED))
    lower = (found.contacts.a == 0) & (found.contacts.b == 1)
    corner = lower[found.contacts.patch]
    force, at = found.forces[corner], found.contacts.points[corner]
    assert (force[:, 2] * (at[:, 0] - 0.14)).sum() == pytest.approx(2 * WEIGHT * 0.08)


def test_what_is_said_of_mortar_is_true() -> None:
    weight = DENSITY * 0.2 * 0.1 * 0.1 * GRAVITY
    found = check(glued(0.9 * weight / 0.01, 0.0))
    assert (found.verdict, "certain" in found.proof) == (FALLS, False)
    assert "with the shear strength of their joints, whatever these can pull" in found.proof
    assert "of the tensile strength" in check(glued(1.1 * weight / 0.01, 0.0)).proof


def test_a_plan_says_how_long_one_waits(tmp_path) -> None:
    plan = l2a.build(corbel(1.02 * NEEDED), supports="none")
    assert plan.steps[2].wait_h == AGE
    plan.save(tmp_path)
    assert l2a.read_assembly(tmp_path).steps[2].wait == AGE


# Drawn designs in mortar: filled, ordered and proven by the law of the kit.

BRICKS = load_kit("bricks-mortar")
SET = 72.0


def mortared(tensile: float, age: float = 24.0) -> Kit:
    """Bricks four cells long and no others."""
    joint = Joint("mortar", tensile=tensile, shear=1e9, age=age)
    kit = load_kit("bricks")
    return replace(kit, joint=joint, joint_gap=0.0, kinds=(kit.kind("1x4"),))


def stair(count: int) -> np.ndarray:
    """Bricks four cells long, each a cell farther out than the one below."""
    wanted = np.zeros((count + 3, 1, count), bool)
    for z in range(count):
        wanted[z : z + 4, 0, z] = True
    return wanted


def steps_told(plan: Plan) -> list[str]:
    """What is done, in words."""
    assert plan.assembly is not None
    return ["wait " * (s.wait is not None) + s.action for s in plan.assembly.steps]


def built(plan: Plan) -> Assembly:
    """The blocks of a plan whose every state is proven once more, as of given blocks."""
    assert plan.complete, plan.reason
    assert plan.assembly is not None
    again = plan_assembly(plan.assembly)
    assert again.complete, again.reason
    assert len(again.steps) == len(plan.steps)
    return plan.assembly


def test_a_wall_with_a_window_has_no_lintel() -> None:
    plan = l2a.build(wall(8, 1, 5, (2, 6, 1, 3)), kit=BRICKS)
    made = built(plan)
    assert plan.cells is not None
    assert (plan.cells.missing, plan.cells.outside) == (0, 0)
    assert made.joint == BRICKS.joint
    removed = [k for k, word in enumerate(steps_told(plan)) if "remove" in word]
    assert len(removed) == sum(block.prop for block in made.blocks) >= 4
    waits = [(k, s.wait_h) for k, s in enumerate(plan.steps) if s.wait_h is not None]
    assert waits == [(removed[0], SET)], "all props stay until the mortar holds"
    assert any(plan.steps[k].proof == MORTAR for k in removed)
    assert check(made).verdict == STANDS


def test_dry_a_window_without_lintel_falls() -> None:
    wanted = np.ones((7, 1, 3), bool)
    wanted[2:5, 0, :2] = False
    assert l2a.build(wanted, kit=BRICKS).complete
    # Dry, with a mortar that holds nothing, and where joints may open and are not filled.
    weak = Joint("mortar", tensile=0.0, shear=0.0, age=SET)
    for joint in (DRY, weak):
        fallen = l2a.build(wanted, kit=replace(BRICKS, joint=joint, joint_gap=1e-4))
        assert fallen.status == "refused"
        assert fallen.blamed
    assert not l2a.build(wanted, kit=BRICKS, gap=0.001).complete


def test_strength_decides_what_a_stair_of_bricks_bears() -> None:
    """The upper four bricks hang on the joint of the lowest: their middle is two cells beside that
    of the joint, which is three long: stress that varies linearly pulls 4 W / A (6 * 2 / 3 - 1) at
    its end."""
    kit = mortared(1.0)
    x, y, z = kit.pitch
    needed = 12 * (4 * x * y * z * kit.density * GRAVITY) / (3 * x * y)
    plan = l2a.build(stair(5), kit=mortared(1.02 * needed))
    assert not any(block.prop for block in built(plan).blocks)
    assert steps_told(plan) == ["place", "place", "place", "wait place", "place"]
    assert [step.wait_h for step in plan.steps] == [None, None, None, 24.0, None]
    assert [step.proof == MORTAR for step in plan.steps] == [False, False, False, True, True]
    assert all(step.margin_g is not None for step in plan.steps)
    weak = l2a.build(stair(5), kit=mortared(0.98 * needed))
    assert weak.status == "not found"
    assert "1.02 times its strength" in (weak.reason or "")
    at_once = l2a.build(stair(5), kit=mortared(1.02 * needed, age=0.0))
    assert steps_told(at_once) == ["place"] * 5
    built(at_once)


def test_what_stands_dry_waits_for_nothing() -> None:
    wall = np.ones((6, 1, 4), bool)
    plan = l2a.build(wall, kit=BRICKS)
    dry = l2a.build(wall, kit=replace(BRICKS, joint=DRY))
    built(plan)
    assert plan.steps == dry.steps
    assert dry.complete


def test_the_command_line_takes_a_kit_of_ones_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kit = tmp_path / "mine.toml"
    kit.write_text(
        'format = "learn2assemble-kit"\nversion = 1\nname = "mine"\njoint_gap = 0.0\n'
        '[joint]\nlaw = "mortar"\ntensile = 1e5\nshear = 1e5\nage = 48\n'
        '[[kinds]]\nname = "long"\nbox = [4, 1, 1]\n'
    )
    np.save(tmp_path / "stair.npy", stair(5))
    asked = ["build", str(tmp_path / "stair.npy"), "--kit", str(kit), "--out"]
    assert main([*asked, str(tmp_path / "out")]) == 0
    assert "wait until the mortar holds before steps 4 (48 h)" in capsys.readouterr().out
    plan = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert [step.get("wait_h") for step in plan["steps"]] == [None, None, None, 48.0, None]
    for name in ("cards.html", "view.html"):
        assert "Wait 48 h first, until the mortar holds." in (tmp_path / "out" / name).read_text()
    assert read_assembly(tmp_path / "out").steps[3].wait == 48.0
    assert main([*asked, str(tmp_path / "arm"), "--arm", "panda"]) == 2
    assert "lays no mortar" in capsys.readouterr().err


# A limit of time.


def seconds_that_pass(most: int) -> Clock:
    """A clock that is over once it has been looked at so often, whatever the machine."""
    looks = iter(range(most + 1))
    return Clock(1.0, lambda: 0.0 if next(looks, None) is not None else 2.0)


def test_no_program_of_a_state_runs_on_where_time_is_over() -> None:
    given = corbel(1.02 * NEEDED, age=0.0)
    there = np.ones(3, bool)
    balance = balance_of(given)
    balance.clock = Clock(100.0)
    assert balance.stands(there, ~there)
    assert balance.need().stands
    margin = balance.margin_g()
    assert margin > 0
    balance.clock = Clock(0.0)
    assert not balance.stands(there, ~there)
    assert not balance.need().stands
    assert balance.holding() == (np.inf, [])
    assert balance.margin_g() == pytest.approx(margin), "of a state that stands"
    balance.clock = None
    assert balance.stands(there, ~there)


def test_a_program_is_given_what_is_left_of_the_clock() -> None:
    solver = new_solver(1)
    run_within(solver, Clock(1000.0, lambda: 5.0))
    assert solver.getOptionValue("time_limit")[1] == pytest.approx(1000.0, abs=1.0)
    run_within(solver, None)
    assert solver.getOptionValue("time_limit")[1] == np.inf
    assert run_within(solver, Clock(0.0)) == STATUS.kTimeLimit


def test_a_plan_says_that_time_was_over_while_mortar_was_asked() -> None:
    kit = mortared(1.0)
    tiling = tile(stair(5), kit)
    again = Retiling(tiling, kit, tight=True)
    fallen = stand_by_mortar(tiling, kit, 0.6, Clock(1e3), again)
    assert (fallen.status, "times its strength" in fallen.reason) == ("not found", True)
    for looks in (1, 3, 4):
        late = stand_by_mortar(tiling, kit, 0.6, seconds_that_pass(looks), again)
        assert (late.status, late.reason.split(" after")[0]) == ("time", "time ran out"), looks


def test_blocks_that_mortar_may_hold_do_not_fall_where_time_is_over() -> None:
    plan = plan_assembly(corbel(1.02 * NEEDED), seconds=0.0, supports="none")
    assert plan.status == "not found"
    assert "time ran out" in (plan.reason or "")
