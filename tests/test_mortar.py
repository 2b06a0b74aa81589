"""Mortar while one builds: joints are dry until they have had their time, then they hold."""

from __future__ import annotations

from dataclasses import replace

import pytest

import learn2assemble as l2a
from learn2assemble.assembly.blocks import Assembly, AssemblyStep, Block, box_block
from learn2assemble.assembly.files import from_json, to_json
from learn2assemble.assembly.joints import Joint
from learn2assemble.constants import GRAVITY
from learn2assemble.errors import InputError
from learn2assemble.planning.given import plan_assembly
from learn2assemble.planning.plan import Plan
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


NEEDED = 2 * WEIGHT / (0.12 * WIDE)
"""Of the corbel: the middle of its upper two bricks is 0.08 m beside that of the joint they hang
on, which reaches 0.06 m, so its preload P has 2 W 0.08 = (2 W + P) 0.06; P is a third of the
tensile strength over its patch of 0.12 m x 0.1 m."""
BRACKET = 1.5 * WEIGHT / (0.08 * WIDE)
"""Of the bracket: W 0.06 = (W + P) 0.04, over 0.08 m x 0.1 m."""


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
    # Half of the weight on each joint of 0.1 m x 0.1 m; its share of the shear strength is an
    # inscribed square, of which a corner points down.
    for factor, verdict in ((1.5, STANDS), (0.98, FALLS)):
        shear = factor * weight / 2 / 0.01
        joint = Joint("mortar", tensile=1.0, shear=shear, age=AGE)
        given = Assembly((left, right, middle), friction=0.0, joint=joint)
        assert check(given).verdict == verdict


def test_a_plan_says_how_long_one_waits(tmp_path) -> None:
    plan = l2a.build(corbel(1.02 * NEEDED), supports="none")
    assert plan.steps[2].wait_h == AGE
    plan.save(tmp_path)
    assert l2a.read_assembly(tmp_path).steps[2].wait == AGE
