"""Joint positions over a place, from the contact upwards, on one branch.

Everything that is decided before the arm moves: which way round, how high, along which ways.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.dynamic.model import Order, World
from learn2assemble.robot.dynamic.transit import Surroundings, Touch, straight_or_tree
from learn2assemble.robot.inverse import METRES_PER_RADIAN, seeds, solve
from learn2assemble.robot.kinematics import forward, get_chain
from learn2assemble.robot.moves import (
    LEVEL,
    OPENING,
    Attitude,
    Move,
    Outcome,
    column,
    crossing_height,
)
from learn2assemble.world.blocks import EDGE

SPACING = 0.02
"""Largest distance between poses of a column that are solved for [m]."""
JUMP = 0.5
"""Neighbouring poses of a column whose joints differ by more [rad] are on different branches."""
STARTS = 16
"""How many other configurations a column is sought from."""


class JointColumn(NamedTuple):
    """Joint positions over a place, from the contact (or below it) upwards, close together."""

    joints: np.ndarray
    """float64[k, n] [rad]."""
    rise: np.ndarray
    """float64[k]: way of the tool from the contact [m]."""


def joint_column(
    arm: Arm,
    centre: np.ndarray,
    attitude: Attitude,
    height: float,
    below: float = 0.0,
    start: np.ndarray | None = None,
) -> JointColumn | str:
    """The first of :func:`joint_columns`, or in words which pose is out of reach and why."""
    reason = ""
    for found in joint_columns(arm, centre, attitude, height, below, start):
        if not isinstance(found, str):
            return found
        reason = reason or found
    return reason


def joint_columns(
    arm: Arm,
    centre: np.ndarray,
    attitude: Attitude,
    height: float,
    below: float = 0.0,
    start: np.ndarray | None = None,
) -> Iterator[JointColumn | str]:
    """Joint positions over a cell, from ``below`` under the contact upwards, close together.

    Each solution starts from its neighbour, so the arm stays on one branch. The first one is
    sought from ``start`` (by default the home pose), at the lower end, then at the upper end, then
    from other configurations with the tool near the contact.

    Yields:
        columns on different branches, and between them, in words, which pose was out of reach.
    """
    poses = column(centre, attitude, height)
    points = [poses.position[:1] + below * poses.rotation[:, 2]] if below else []
    for begin, end in zip(poses.position[:-1], poses.position[1:], strict=True):
        count = math.ceil(np.linalg.norm(end - begin) / SPACING - 1e-9)
        points.append(begin + np.outer(np.arange(count) / count, end - begin))
    points.append(poses.position[-1:])
    tool = np.vstack(points)
    way = np.linalg.norm(np.diff(tool, axis=0), axis=1)
    rise = np.concatenate([[0.0], np.cumsum(way)]) - below
    first = arm.home if start is None else start
    found = _track(arm, tool, poses.rotation, first)
    yield found if isinstance(found, str) else JointColumn(found, rise)
    found = _track(arm, tool[::-1], poses.rotation, first)
    yield found if isinstance(found, str) else JointColumn(found[::-1].copy(), rise)
    others = [_track(arm, tool, poses.rotation, q) for q in _near(arm, tool[0], poses.rotation)]
    tracks = [track for track in others if not isinstance(track, str)]
    for track in sorted(tracks, key=lambda way: turning(arm, [*way, arm.home])):
        yield JointColumn(track, rise)


def _track(
    arm: Arm, points: np.ndarray, rotation: np.ndarray, start: np.ndarray
) -> np.ndarray | str:
    """Solutions float64[k, n] for one pose after the other, or which pose has none near."""
    joints: list[np.ndarray] = []
    for point in points:
        found = solve(arm, point, rotation, joints[-1] if joints else start, restarts=0)
        reason = "" if found.ok else found.failure.name.lower().replace("_", " ")
        if not reason and joints and np.abs(found.joints - joints[-1]).max() > JUMP:
            reason = "no steady way there"
        if reason:
            return "tool at ({:.3f}, {:.3f}, {:.3f}): {}".format(*point, reason)
        joints.append(found.joints)
    return np.array(joints)


def _near(arm: Arm, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """float64[k, n]: fixed configurations whose tool is nearest to a pose."""
    table = seeds(arm)
    trace = np.einsum("kij,ij->k", table.rotation, rotation)
    angle = np.arccos(np.clip((trace - 1) / 2, -1.0, 1.0))
    away = np.sum((table.position - position) ** 2, axis=1) + (METRES_PER_RADIAN * angle) ** 2
    return table.joints[np.argsort(away, kind="stable")[:STARTS]]


def turning(arm: Arm, way: Sequence[np.ndarray]) -> float:
    """Time the joints need from one position to the next, each at full speed [s]."""
    return float(np.sum(np.max(np.abs(np.diff(way, axis=0)) / arm.velocity, axis=1)))


PRESS = 0.004
"""Columns begin so far below the ordered place [m]: what is held is lowered until it rests."""
MAX_RAISES = 4
"""How often the crossing is tried again, a level higher."""
_MAX_LIFTS, _UP = 8, np.array([0.0, 0.0, LEVEL])


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


class Plan(NamedTuple):
    """Joint positions over both places."""

    pick: JointColumn
    """Over the grasped cell, from :data:`PRESS` below the contact."""
    place: JointColumn
    """Over the target, likewise."""
    move: Move
    """The order, with the fingers exchanged where that is easier."""
    height: float
    """Of the tool while crossing [m]."""


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
    around = Surroundings(arm, world, order.poses, order.names)
    plan = _plan(arm, around, order)
    if precheck:
        around.put(order.target, *order.in_world(plan.move.grasp, plan.move.place), OPENING)
        hit = around.overlap(order.target)
        if hit is not None:
            name = order.names[order.target]
            raise Failure(Outcome.PLACE_COLLISION, "place", f"{name} would overlap {hit}")
    plan, across = _across(arm, around, order, plan)
    around.empty(OPENING)
    start = rest_pose(arm, around) if joints is None else joints
    there = free_way(around, start, plan.pick.joints[-1], "approach")
    home = None
    if go_home:
        pose = order.in_world(plan.move.grasp, plan.move.place)
        around.put(order.target, *pose, OPENING)
        home = free_way(around, plan.place.joints[-1], rest_pose(arm, around), "home")
    return Course(plan, there, across, home)


def rest_pose(arm: Arm, around: Surroundings) -> np.ndarray:
    """Where the arm waits, float64[n] [rad]: at home, or above it where something stands there."""
    position, rotation = forward(get_chain(arm), arm.home)
    for level in range(_MAX_LIFTS):
        found = solve(arm, position + level * _UP, rotation, arm.home)
        joints = arm.home if level == 0 else found.joints
        if found.ok and around.touch(joints) is None:
            return joints
    return arm.home


def _plan(arm: Arm, around: Surroundings, order: Order) -> Plan:
    """As ordered or with the fingers exchanged: whatever meets less, then what turns less."""
    height = crossing_height(order.scene, order.move)
    given = order.move
    flipped = given._replace(grasp=given.grasp.flipped(), place=given.place.flipped())
    found: list[tuple[int, float, Plan]] = []
    reasons: list[Failure] = []
    for move in (given, flipped):
        centre = order.scene.position[move.cell]
        around.empty(OPENING)
        pick = _choose(
            around, joint_columns(arm, centre, move.grasp, height, PRESS), order.target
        )  # fmt: skip
        if isinstance(pick, str):
            reasons.append(Failure(Outcome.UNREACHABLE, "pick", pick))
            continue
        around.carry(order.target, *order.in_hand(move.grasp), EDGE)
        place = _choose(around, joint_columns(arm, move.target, move.place, height, PRESS), None)
        if isinstance(place, str):
            reasons.append(Failure(Outcome.UNREACHABLE, "place", place))
            continue
        plan = Plan(pick[0], place[0], move, height)
        ways = [arm.home, *plan.pick.joints[::-1], *plan.place.joints, arm.home]
        found.append((pick[1] + place[1], turning(arm, ways), plan))
    if not found:
        raise reasons[0]
    return min(found, key=lambda one: one[:2])[2]


def _choose(
    around: Surroundings, columns: Iterator[JointColumn | str], besides: int | None
) -> tuple[JointColumn, int] | str:
    """The first column that meets nothing but perhaps the object ``besides``, and 0; else the
    first one, and 1: the motion will tell. If there is none, why."""
    first, reason = None, ""
    for found in columns:
        if isinstance(found, str):
            reason = reason or found
            continue
        hits = (around.touch(q, 0.0, besides) for q in found.joints[1:])
        hit = next((hit for hit in hits if hit), None)
        if hit is None:
            return found, 0
        first = first or found
        if not hit.by_link:
            # Another branch moves the links, not what is at their end.
            break
    return reason if first is None else (first, 1)


def _across(arm: Arm, around: Surroundings, order: Order, plan: Plan) -> tuple[Plan, np.ndarray]:
    """The plan, higher where that gives a straight free way, and the way."""
    around.carry(order.target, *order.in_hand(plan.move.grasp), EDGE)
    hit = around.blocked(plan.pick.joints[-1], plan.place.joints[-1])
    for levels in range(1, MAX_RAISES + 1) if hit else ():
        higher = _raised(arm, order, plan, levels)
        if higher is None:
            break
        ends = higher.pick.joints[-1], higher.place.joints[-1]
        if around.blocked(*ends) is None:
            return higher, np.array(ends)
    return plan, free_way(around, plan.pick.joints[-1], plan.place.joints[-1], "cross")


def _raised(arm: Arm, order: Order, plan: Plan, levels: int) -> Plan | None:
    """The plan on the same branches, crossing some levels higher."""
    height, move = plan.height + levels * LEVEL, plan.move
    centre = order.scene.position[move.cell]
    pick = joint_column(arm, centre, move.grasp, height, PRESS, plan.pick.joints[0])
    place = joint_column(arm, move.target, move.place, height, PRESS, plan.place.joints[0])
    if isinstance(pick, str) or isinstance(place, str):
        return None
    return Plan(pick, place, move, height)


def free_way(around: Surroundings, start: np.ndarray, end: np.ndarray, stage: str) -> np.ndarray:
    """As :func:`straight_or_tree`.

    Raises:
        Failure: where there is none.
    """
    way = straight_or_tree(around, start, end)
    if isinstance(way, Touch):
        raise Failure(Outcome.UNREACHABLE, stage, f"no free way: {way.words}")
    return way
