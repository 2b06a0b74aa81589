"""Everything that is decided before the arm moves: which way round, how high, along which ways."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from learn2assemble.robot.approach import ApproachPath, approach_path, approach_paths, travel_time
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.dynamic.model import Order, World
from learn2assemble.robot.dynamic.transit import WorldChecker, straight_or_tree
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.inverse import solve
from learn2assemble.robot.kinematic.collision import Collision
from learn2assemble.robot.kinematics import forward, get_chain
from learn2assemble.robot.moves import LEVEL, Move, Outcome, Scene, overload, turned, turns

PRESS = 0.004
"""Approach paths begin so far below the place [m]: what is held is lowered until it rests."""
MAX_RAISES = 4
"""How often the crossing is tried again, a level higher."""
_MAX_LIFTS, _UP = 8, np.array([0.0, 0.0, LEVEL])


class Failure(Exception):
    """What broke a pick and place off, or spoiled it.

    Args:
        outcome: its kind.
        stage: one of :data:`learn2assemble.robot.moves.STAGES`, or ``rest`` once the arm is done.
        detail: one line.
    """

    def __init__(self, outcome: Outcome, stage: str, detail: str) -> None:
        super().__init__(f"{outcome.label} ({stage}): {detail}")
        self.outcome, self.stage, self.detail = outcome, stage, detail


class Approaches(NamedTuple):
    """Approach paths over both places."""

    pick: ApproachPath
    """Over the grasped cell, from :data:`PRESS` below the contact."""
    place: ApproachPath
    """Over the target, likewise."""
    leave: ApproachPath
    """By which the hand leaves the target; the same but where it comes from the side: there it
    sets down from above."""
    move: Move
    """The order, with the fingers exchanged where that is easier."""
    height: float
    """Of the tool while crossing [m]."""


class Course(NamedTuple):
    """A plan and the ways between its approach paths, each float64[k, n]: joint positions [rad]
    whose straight connections are free."""

    plan: Approaches
    there: np.ndarray
    """From where the arm is to above the object."""
    across: np.ndarray
    """From there to above the target."""
    home: np.ndarray | None
    """From there home; None if the arm is to stay."""


def require_held(arm: Arm, scene: Scene, move: Move) -> None:
    """Refuse what the tool cannot hold at all.

    Raises:
        Failure: GRASP_LOST.
    """
    why = overload(arm, scene, move)
    if why is not None:
        raise Failure(Outcome.GRASP_LOST, "lift", why)


def prepare(
    arm: Arm, world: World, order: Order, joints: np.ndarray | None, go_home: bool, precheck: bool
) -> Course:
    """The course of an attempt.

    Args:
        arm: the robot.
        world: model of the cell.
        order: what is asked.
        joints: float64[n] where the arm is [rad]; by default its :func:`rest_pose`.
        go_home: whether it returns to its home pose.
        precheck: whether an occupied target is a failure already.

    Raises:
        Failure: where there is none.
    """
    checker = WorldChecker(arm, world, order.poses, order.names)
    plan = _plan(arm, checker, order)
    if precheck:
        checker.put(order.target, *order.in_world(plan.move.grasp, plan.move.place), order.opening)
        hit = checker.overlap(order.target)
        if hit is not None:
            name = order.names[order.target]
            raise Failure(Outcome.PLACE_COLLISION, "place", f"{name} would overlap {hit}")
    plan, across = _across(arm, checker, order, plan)
    checker.empty(order.opening)
    start = rest_pose(arm, checker) if joints is None else joints
    there = free_way(checker, start, plan.pick.joints[-1], "approach")
    home = None
    if go_home:
        pose = order.in_world(plan.move.grasp, plan.move.place)
        checker.put(order.target, *pose, order.opening)
        home = free_way(checker, plan.leave.joints[-1], rest_pose(arm, checker), "home")
    return Course(plan, there, across, home)


def rest_pose(arm: Arm, checker: WorldChecker) -> np.ndarray:
    """Where the arm waits, float64[n] [rad]: at home, or above it where something stands there."""
    position, rotation = forward(get_chain(arm), arm.home)
    for level in range(_MAX_LIFTS):
        found = solve(arm, position + level * _UP, rotation, arm.home)
        joints = arm.home if level == 0 else found.joints
        if found.ok and checker.check(joints) is None:
            return joints
    return arm.home


def _plan(arm: Arm, checker: WorldChecker, order: Order) -> Approaches:
    """As ordered or with the hand turned: whatever meets less, then what turns less."""
    height, given = order.height, order.move
    found: list[tuple[int, float, Approaches]] = []
    reasons: list[Failure] = []
    for move in (given, *(turned(given, turn) for turn in turns(arm, given))):
        centre = order.scene.position[move.cell]
        checker.empty(order.opening)
        pick = _choose(
            checker, approach_paths(arm, centre, move.grasp, height, PRESS), order.target
        )  # fmt: skip
        if isinstance(pick, str):
            reasons.append(Failure(Outcome.UNREACHABLE, "pick", pick))
            continue
        checker.carry(order.target, *order.in_hand(move.grasp), order.held)
        down = approach_paths(arm, move.target, move.place, height, PRESS, upwards=True)
        place = _choose(checker, down, None)
        if isinstance(place, str):
            reasons.append(Failure(Outcome.UNREACHABLE, "place", place))
            continue
        leave = leaving(arm, move.target, move.place, height, place[0])
        if isinstance(leave, str):
            reasons.append(Failure(Outcome.UNREACHABLE, "retreat", leave))
            continue
        plan = Approaches(pick[0], place[0], leave, move, height)
        ways = [arm.home, *plan.pick.joints[::-1], *plan.place.joints, arm.home]
        found.append((pick[1] + place[1], travel_time(arm, ways), plan))
    if not found:
        raise reasons[0]
    return min(found, key=lambda one: one[:2])[2]


def leaving(
    arm: Arm, target: np.ndarray, attitude: Attitude, height: float, place: ApproachPath
) -> ApproachPath | str:
    """The path by which the hand leaves, on the branch of the one it came by."""
    if not attitude.sideways:
        return place
    return approach_path(arm, target, attitude, height, 0.0, place.joints[0])


def _choose(
    checker: WorldChecker, approaches: Iterator[ApproachPath | str], besides: int | None
) -> tuple[ApproachPath, int] | str:
    """The first path that meets nothing but perhaps the object ``besides``, and 0; else the
    first one, and 1: the motion will tell. If there is none, why."""
    first, reason = None, ""
    for found in approaches:
        if isinstance(found, str):
            reason = reason or found
            continue
        hits = (checker.near(q, 0.0, besides)[0] for q in found.joints[1:])
        hit = next((hit for hit in hits if hit), None)
        if hit is None:
            return found, 0
        first = first or found
        if not hit.by_link:
            # Another branch moves the links, not what is at their end.
            break
    return reason if first is None else (first, 1)


def _across(
    arm: Arm, checker: WorldChecker, order: Order, plan: Approaches
) -> tuple[Approaches, np.ndarray]:
    """The plan, higher where that gives a straight free way, and the way."""
    checker.carry(order.target, *order.in_hand(plan.move.grasp), order.held)
    hit = checker.blocked(plan.pick.joints[-1], plan.place.joints[-1])
    for levels in range(1, MAX_RAISES + 1) if hit else ():
        higher = _raised(arm, order, plan, levels)
        if higher is None:
            break
        ends = higher.pick.joints[-1], higher.place.joints[-1]
        if checker.blocked(*ends) is None:
            return higher, np.array(ends)
    return plan, free_way(checker, plan.pick.joints[-1], plan.place.joints[-1], "cross")


def _raised(arm: Arm, order: Order, plan: Approaches, levels: int) -> Approaches | None:
    """The plan on the same branches, crossing some levels higher."""
    height, move = plan.height + levels * LEVEL, plan.move
    centre = order.scene.position[move.cell]
    pick = approach_path(arm, centre, move.grasp, height, PRESS, plan.pick.joints[0])
    place = approach_path(
        arm, move.target, move.place, height, PRESS, plan.place.joints[0], upwards=True
    )
    if isinstance(pick, str) or isinstance(place, str):
        return None
    leave = leaving(arm, move.target, move.place, height, place)
    return None if isinstance(leave, str) else Approaches(pick, place, leave, move, height)


def free_way(checker: WorldChecker, start: np.ndarray, end: np.ndarray, stage: str) -> np.ndarray:
    """As :func:`straight_or_tree`.

    Raises:
        Failure: where there is none.
    """
    way = straight_or_tree(checker, start, end)
    if isinstance(way, Collision):
        raise Failure(Outcome.UNREACHABLE, stage, f"no free way: {way}")
    return way
