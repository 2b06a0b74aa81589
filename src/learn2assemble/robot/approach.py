"""From an order to joint paths: columns over both places, and free ways between them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.inverse import METRES_PER_RADIAN, seeds, solve
from learn2assemble.robot.motion import LEVEL, column, crossing_height
from learn2assemble.robot.scene import Move, Scene

SPACING = 0.02
"""Largest distance between poses of a column that are solved for [m]."""
JUMP = 0.5
"""Neighbouring poses of a column whose joints differ by more [rad] are on different branches."""
STARTS = 8
"""How many other configurations a column is sought from."""
PRESS = 0.004
"""The column over the target ends so far below the ordered place [m]: what is held is lowered
until it rests."""
MAX_RAISES = 4
"""How often the crossing is tried again, a level higher."""


class JointColumn(NamedTuple):
    """Joint positions over a place, from the contact (or below it) upwards, close together."""

    joints: np.ndarray
    """float64[k, n] [rad]."""
    rise: np.ndarray
    """float64[k]: way of the tool from the contact [m]."""


class Plan(NamedTuple):
    """Joint positions of a pick and place."""

    pick: JointColumn
    """Over the grasped cell, from :data:`PRESS` below the contact."""
    place: JointColumn
    """Over the target, from :data:`PRESS` below the contact."""
    move: Move
    """The order, with the fingers exchanged where that is easier."""
    height: float
    """Of the tool while crossing [m]."""


def joint_column(
    arm: Arm,
    centre: np.ndarray,
    attitude: Attitude,
    height: float,
    below: float = 0.0,
    start: np.ndarray | None = None,
) -> JointColumn | str:
    """Joint positions over a cell, from ``below`` under the contact upwards, close together.

    Each solution starts from its neighbour, so the arm stays on one branch. The first one is
    sought from ``start`` (by default the home pose), at the lower end and, where that leads
    nowhere, at the upper end and from other configurations with the tool near the contact.

    Returns:
        the column, or in words which pose is out of reach and why.
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
    reason = found = _track(arm, tool, poses.rotation, first)
    if isinstance(found, str):
        found = _track(arm, tool[::-1], poses.rotation, first)
        if not isinstance(found, str):
            return JointColumn(found[::-1].copy(), rise)
        for other in _near(arm, tool[0], poses.rotation):
            found = _track(arm, tool, poses.rotation, other)
            if not isinstance(found, str):
                break
    return str(reason) if isinstance(found, str) else JointColumn(found, rise)


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


def plans(arm: Arm, scene: Scene, move: Move) -> tuple[list[Plan], str, str]:
    """Plans as ordered and with the fingers exchanged, the one with less to turn first.

    Returns:
        the plans; if there are none, the stage and pose out of reach.
    """
    height = crossing_height(scene, move)
    found, reason = [], ("", "")
    flipped = move._replace(grasp=move.grasp.flipped(), place=move.place.flipped())
    for order in (move, flipped):
        plan = plan_at(arm, scene, order, height)
        if isinstance(plan, Plan):
            found.append(plan)
        elif not reason[0]:
            reason = plan
    found.sort(key=lambda plan: _effort(arm, plan))
    return found, *reason


def plan_at(arm: Arm, scene: Scene, move: Move, height: float) -> Plan | tuple[str, str]:
    """A plan that crosses at a height [m], or stage and pose that is out of reach."""
    pick = joint_column(arm, scene.position[move.cell], move.grasp, height, PRESS)
    if isinstance(pick, str):
        return "pick", pick
    place = joint_column(arm, move.target, move.place, height, PRESS)
    if isinstance(place, str):
        return "place", place
    return Plan(pick, place, move, height)


def raised(arm: Arm, scene: Scene, plan: Plan, levels: int) -> Plan | None:
    """The plan, crossing some levels higher."""
    higher = plan_at(arm, scene, plan.move, plan.height + levels * LEVEL)
    return higher if isinstance(higher, Plan) else None


def _effort(arm: Arm, plan: Plan) -> float:
    """Time a full-speed arm needs for the turns between home, picking and placing [s]."""
    stops = (arm.home, plan.pick.joints[-1], plan.place.joints[-1], arm.home)
    ways = zip(stops[:-1], stops[1:], strict=True)
    return sum(float(np.max(np.abs(b - a) / arm.velocity)) for a, b in ways)
