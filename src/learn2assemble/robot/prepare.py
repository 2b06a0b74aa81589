"""Everything that is decided before the arm moves: which way round, how high, along which ways."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.robot.approach import MAX_RAISES, Plan, plans, raised
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.mjcf import World
from learn2assemble.robot.motion import OPENING
from learn2assemble.robot.order import Order
from learn2assemble.robot.outcome import Outcome
from learn2assemble.robot.transit import Surroundings, straight_or_tree
from learn2assemble.world.blocks import EDGE


class Failure(Exception):
    """What broke a pick and place off, or spoiled it.

    Args:
        outcome: its kind.
        stage: one of :data:`~.recording.STAGES`, or ``rest`` once the arm is done.
        detail: one line.
    """

    def __init__(self, outcome: Outcome, stage: str, detail: str) -> None:
        super().__init__(f"{outcome.label} ({stage}): {detail}")
        self.outcome, self.stage, self.detail = outcome, stage, detail


class Course(NamedTuple):
    """A plan and the ways between its columns, each float64[k, n]: joint positions [rad] whose
    straight connections are free."""

    plan: Plan
    there: np.ndarray
    """From where the arm is to above the object."""
    across: np.ndarray
    """From there to above the target."""
    home: np.ndarray | None
    """From there home; None if the arm is to stay."""


def prepare(
    arm: Arm, world: World, order: Order, joints: np.ndarray, go_home: bool, precheck: bool
) -> Course:
    """The course of an attempt.

    Args:
        arm: the robot.
        world: model of the cell.
        order: what is asked.
        joints: float64[n] where the arm is [rad].
        go_home: whether it returns to its home pose.
        precheck: whether an occupied target is a failure already.

    Raises:
        Failure: where there is none.
    """
    around = Surroundings(arm, world, order.poses, order.names)
    found, stage, reason = plans(arm, order.scene, order.move)
    if not found:
        raise Failure(Outcome.UNREACHABLE, stage, reason)
    if precheck:
        move = found[0].move
        around.put(order.target, *order.in_world(move.grasp, move.place), OPENING)
        hit = around.overlap(order.target)
        if hit is not None:
            name = order.names[order.target]
            raise Failure(Outcome.PLACE_COLLISION, "place", f"{name} would overlap {hit}")
    plan = next((plan for plan in found if _looks_free(around, order, plan)), found[0])
    plan, across = _across(arm, around, order, plan)
    around.empty(OPENING)
    there = _way(around, joints, plan.pick.joints[-1], "approach")
    home = None
    if go_home:
        pose = order.in_world(plan.move.grasp, plan.move.place)
        around.put(order.target, *pose, OPENING)
        home = _way(around, plan.place.joints[-1], arm.home, "home")
    return Course(plan, there, across, home)


def _looks_free(around: Surroundings, order: Order, plan: Plan) -> bool:
    """Whether the columns meet nothing: which of two ways round to try, not a verdict."""
    around.empty(OPENING)
    if any(around.touch(q, 0.0, order.target) for q in plan.pick.joints[1::2]):
        return False
    around.carry(order.target, *order.in_hand(plan.move.grasp), EDGE)
    return not any(around.touch(q, 0.0) for q in plan.place.joints[1::2])


def _across(arm: Arm, around: Surroundings, order: Order, plan: Plan) -> tuple[Plan, np.ndarray]:
    """The plan, higher where that gives a straight free way, and the way."""
    around.carry(order.target, *order.in_hand(plan.move.grasp), EDGE)
    hit = around.blocked(plan.pick.joints[-1], plan.place.joints[-1])
    for levels in range(1, MAX_RAISES + 1) if hit else ():
        higher = raised(arm, order.scene, plan, levels)
        if higher is None:
            break
        ends = higher.pick.joints[-1], higher.place.joints[-1]
        if around.blocked(*ends) is None:
            return higher, np.array(ends)
    return plan, _way(around, plan.pick.joints[-1], plan.place.joints[-1], "cross")


def _way(around: Surroundings, start: np.ndarray, end: np.ndarray, stage: str) -> np.ndarray:
    way = straight_or_tree(around, start, end)
    if isinstance(way, str):
        raise Failure(Outcome.UNREACHABLE, stage, f"no free way: {way}")
    return way
