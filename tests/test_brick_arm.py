"""Bricks that clutch, pressed home by an arm: order and grasps, and what is built beside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.bricks.model import Brick, BrickModel, assembly_of
from learn2assemble.assembly.joints import Joint
from learn2assemble.assembly.kit import load_kit
from learn2assemble.cell.bricks import BrickStates
from learn2assemble.errors import InputError
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.holding import LEAST_GRIP, PAD, STUD_ROOM, holds_of

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
    plan = l2a.build(STAIR, arm="panda", physics="kinematic")
    assert plan.complete
    assert plan.arm is not None
    assert plan.arm.tool == "gripper"
    assert [step.way for step in plan.steps] == ["above", "above", "beside", "beside"]
    # The two that are built beside come in one more move.
    assert plan.arm.attempts == len(plan.steps) + 1
    assert plan.arm.error_worst == pytest.approx(0, abs=1e-6)
    states = BrickStates(STAIR)
    three = frozenset({0, 1, 2})
    assert states.stands(three | {3})
    assert not states.stands_pressed([3], three)
    assert states.stands_pressed([2, 3], frozenset({0, 1}))


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


def test_what_an_arm_cannot_press_is_refused() -> None:
    with pytest.raises(InputError, match="does not hold on studs"):
        l2a.build(WALL, arm="panda", tool="suction")
    mortar = replace(WALL, joint=Joint("mortar", tensile=1e5, shear=1e5))
    with pytest.raises(InputError, match="lays no mortar"):
        l2a.build(mortar, arm="panda")
