"""Approach paths: joint positions of the arm over a place where it grasps or releases.

A path begins at the contact (or below it) and leads upwards, first along the approach axis of the
hand, then along the vertical. Every solution of the inverse kinematics starts from its neighbour,
so a path stays on one branch of solutions. :func:`reached_area` is what an arm reaches at a height.
"""

from __future__ import annotations

import itertools
import math
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from learn2assemble.geometry.rotations import yaw_matrix
from learn2assemble.kinematics.chain import forward, forward_many, get_chain
from learn2assemble.kinematics.inverse import RESTARTS, ik_seeds, seed_distances, solve
from learn2assemble.kinematics.joint_path import joint_path
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.grasps import WAY, Attitude
from learn2assemble.robot.moves import LEVEL
from learn2assemble.values import rounded

LOW_HEIGHT = 0.05
"""Above the table at which it is shown how far an arm reaches: that of a block that lies [m]."""
RISE = (0.0, 0.008, 0.03, WAY)
"""Distances of poses from the contact along the approach axis [m], close where things are near."""
SPACING = 0.02
"""Largest distance between poses of an :class:`ApproachPath` [m]."""
JUMP = 0.5
"""Neighbouring poses whose joints differ by more [rad] are on different branches."""
GRAIN, KEPT = 1e-4, 20_000
"""Places that differ by less are one [m], and how many paths are remembered."""
STARTS = 16
"""How many other configurations a path is sought from."""


class ToolPath(NamedTuple):
    """Poses of the tool over a place, from the contact upwards."""

    position: np.ndarray
    """float64[k, 3]: tool point [m]."""
    rotation: np.ndarray
    """float64[3, 3]: of all of them."""
    approach: np.ndarray
    """float64[3]: unit vector along which the tool comes to the contact."""


def tool_path(
    centre: np.ndarray, attitude: Attitude, height: float, upwards: bool = False
) -> ToolPath:
    """Tool poses over a cell.

    Args:
        centre: float64[3] of the cell [m].
        attitude: of the hand.
        height: of the last tool point, or that just clear of the cell if that is higher [m].
        upwards: leave the contact the way what is held comes to its place.

    Returns:
        poses along that way, or along the approach axis, over what the attitude says or a bit, then
        straight up.
    """
    rotation, contact = attitude.rotation(), attitude.tool_point(centre)
    approach, rise = attitude.approach(), np.array(RISE)
    if upwards and attitude.apart:
        approach = attitude.insertion()
    if attitude.way > RISE[-1]:
        further = math.ceil((attitude.way - RISE[-1]) / (2 * LEVEL))
        rise = np.r_[rise, np.linspace(RISE[-1], attitude.way, further + 1)[1:]]
    near = contact - np.outer(rise, approach)
    top: float = max(height - near[-1, 2], 0.0)
    steps = np.linspace(0.0, top, 1 + math.ceil(top / (2 * LEVEL) - 1e-9))[1:]
    up = near[-1] + np.outer(steps, [0.0, 0.0, 1.0])
    return ToolPath(np.vstack([near, up]), rotation, approach)


def follow_poses(
    arm: Arm,
    points: np.ndarray,
    rotation: np.ndarray,
    start: np.ndarray,
    restarts: int = 0,
    jump: float = math.inf,
) -> np.ndarray | str:
    """Joint positions for one tool pose after the other.

    Args:
        arm: the robot.
        points: float64[k, 3], tool points [m].
        rotation: float64[3, 3] of all poses.
        start: float64[n] where the first solution is sought [rad].
        restarts: other starts for the first pose; further up, they would leave the branch.
        jump: largest change of a joint between neighbours [rad].

    Returns:
        float64[k, n] [rad], or in words which pose has no solution and why.
    """
    joints: list[np.ndarray] = []
    for point in points:
        found = solve(
            arm,
            point,
            rotation,
            joints[-1] if joints else start,
            restarts=0 if joints else restarts,
        )
        reason = "" if found.ok else found.failure.name.lower().replace("_", " ")
        if not reason and joints and np.abs(found.joints - joints[-1]).max() > jump:
            reason = "no steady way there"
        if reason:
            at = ", ".join(f"{rounded(value, 3):.3f}" for value in point)
            return f"tool at ({at}): {reason}"
        joints.append(found.joints)
    return np.array(joints)


class ApproachCache:
    """Joint positions of an arm for the poses of :func:`tool_path`, remembered: the paths used
    last, over places that differ by :data:`GRAIN` or more."""

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self._known: OrderedDict[tuple[object, ...], np.ndarray | str] = OrderedDict()

    def solve(
        self, centre: np.ndarray, attitude: Attitude, height: float, upwards: bool = False
    ) -> np.ndarray | str:
        """float64[k, n] [rad], or in words why there are none; arguments of :func:`tool_path`."""
        upwards = upwards and attitude.apart
        key = (*(round(float(c) / GRAIN) for c in centre), attitude, round(height / GRAIN), upwards)
        found = self._known.get(key)
        if found is None:
            poses = tool_path(centre, attitude, height, upwards)
            found = follow_poses(self.arm, poses.position, poses.rotation, self.arm.home, RESTARTS)
            self._known[key] = found
            if len(self._known) > KEPT:
                self._known.popitem(last=False)
        else:
            self._known.move_to_end(key)
        return found


class ApproachPath(NamedTuple):
    """Joint positions over a place, from the contact (or below it) upwards, close together."""

    joints: np.ndarray
    """float64[k, n] [rad]."""
    rise: np.ndarray
    """float64[k]: way of the tool from the contact [m]."""

    def upto(self, rise: float) -> ApproachPath:
        """The part of it up to about this height [m], with the knot that is nearest to it."""
        count = int(np.searchsorted(self.rise, rise + SPACING / 2))
        return ApproachPath(self.joints[:count], self.rise[:count])


BESIDE, TURNED, APART = 0.0025, math.radians(2.0), 0.05
"""The hand is on an approach path if it is no farther beside its line [m] and turned by no more
[rad], and no joint is farther from where the path would have it there [rad]. The cubic that begins
leaves the straight lines between its knots by less than a quarter of that."""


def on_path(arm: Arm, path: ApproachPath, joints: np.ndarray) -> tuple[int, float] | None:
    """Where the hand is on a straight approach path.

    Args:
        arm: the robot.
        path: whose line goes on above its last pose.
        joints: float64[n] of the arm [rad].

    Returns:
        how many poses are clearly below the hand, and its way from the contact [m]; None where it
        is not on the path, or bent otherwise, or the path is.
    """
    chain = get_chain(arm)
    where, turns = forward_many(chain, np.ascontiguousarray(path.joints))
    line = where[-1] - where[0]
    along = line / max(float(np.linalg.norm(line)), 1e-9)
    place, turn = forward(chain, joints)
    ways = np.vstack([where, place]) - where[0]
    beside = np.linalg.norm(ways - np.outer(ways @ along, along), axis=1)
    apart = math.acos(min(max((float(np.trace(turns[0].T @ turn)) - 1) / 2, -1.0), 1.0))
    rise = float(path.rise[0] + ways[-1] @ along)
    count = int(np.searchsorted(path.rise, rise - SPACING / 2))
    if count < 2 or beside[:-1].max() > GRAIN or beside[-1] > BESIDE or apart > TURNED:
        return None
    one, two = path.joints[count - 2 : count]
    share = (rise - path.rise[count - 1]) / (path.rise[count - 1] - path.rise[count - 2])
    there = two + share * (two - one)
    return (count, rise) if np.abs(joints - there).max() <= APART else None


SLACK = (1e-3, 0.01, 0.03)
"""Approach paths keep one of these distances from the joint limits [rad], the first with which the
cubic through their knots, which goes farther where a joint stops at its limit, stays inside."""


@lru_cache(maxsize=64)
def _with_slack(arm: Arm, slack: float) -> Arm:
    """The arm with joint limits that much narrower."""
    branches = {name: (low + slack, high - slack) for name, (low, high) in arm.branches.items()}
    return replace(arm, lower=arm.lower + slack, upper=arm.upper - slack, branches=branches)


def _stays_inside(arm: Arm, joints: np.ndarray) -> bool:
    """Whether the cubic through joint positions float64[k, n] [rad] respects the limits."""
    room = np.minimum(joints - arm.lower, arm.upper - joints).min()
    if room > np.abs(np.diff(joints, axis=0)).max(initial=0.0):
        return True  # It does not leave its knots by as much as they are apart.
    path = joint_path(joints, arm.bounds)
    return bool(arm.inside_limits(path.at(np.linspace(0, path.length, 8 * len(joints)))[0]).all())


def approach_path(
    arm: Arm, poses: ToolPath, below: float = 0.0, start: np.ndarray | None = None
) -> ApproachPath | str:
    """The first of :func:`approach_paths`, or in words which pose is out of reach and why."""
    reason = ""
    for found in approach_paths(arm, poses, below, start):
        if not isinstance(found, str):
            return found
        reason = reason or found
    return reason


def approach_paths(
    arm: Arm, poses: ToolPath, below: float = 0.0, start: np.ndarray | None = None
) -> Iterator[ApproachPath | str]:
    """Approach paths on different branches of the inverse kinematics.

    The first is sought from ``start`` at the lower end, then at the upper end, then from fixed
    configurations with the tool near the contact.

    Args:
        arm: the robot.
        poses: of the tool, see :func:`tool_path`.
        below: how far under the contact the path begins [m].
        start: float64[n] [rad], by default the home pose.

    Yields:
        paths, and between them, in words, which pose was out of reach.
    """
    points = [poses.position[:1] + below * poses.approach] if below else []
    for begin, end in zip(poses.position[:-1], poses.position[1:], strict=True):
        count = math.ceil(np.linalg.norm(end - begin) / SPACING - 1e-9)
        points.append(begin + np.outer(np.arange(count) / count, end - begin))
    points.append(poses.position[-1:])
    tool = np.vstack(points)
    way = np.linalg.norm(np.diff(tool, axis=0), axis=1)
    rise = np.concatenate([[0.0], np.cumsum(way)]) - below

    def follow(points: np.ndarray, start: np.ndarray) -> np.ndarray | str:
        for slack in SLACK:
            inner = _with_slack(arm, slack)
            found = follow_poses(inner, points, poses.rotation, start, jump=JUMP)
            if isinstance(found, str) or _stays_inside(arm, found):
                return found
        return "a joint leaves its range between two poses"

    first = arm.home if start is None else start
    found = follow(tool, first)
    yield found if isinstance(found, str) else ApproachPath(found, rise)
    found = follow(tool[::-1], first)
    yield found if isinstance(found, str) else ApproachPath(found[::-1].copy(), rise)
    table = ik_seeds(arm)
    distance = seed_distances(table, tool[0], poses.rotation, 6)
    nearest = table.joints[np.argsort(distance, kind="stable")[:STARTS]]
    others = [follow(tool, q) for q in nearest]
    paths = [path for path in others if not isinstance(path, str)]
    for path in sorted(paths, key=lambda way: travel_time(arm, [*way, arm.home])):
        yield ApproachPath(path, rise)


def travel_time(arm: Arm, way: Sequence[np.ndarray]) -> float:
    """Time from one joint position to the next, the slowest joint at full speed [s]."""
    return float(np.sum(np.max(np.abs(np.diff(way, axis=0)) / arm.velocity, axis=1)))


def reached_area(arm: Arm, height: float = LOW_HEIGHT) -> tuple[np.ndarray, ...]:
    """Where the tool of an arm, upright as at home, reaches at a height above the table [m].

    How far is looked for along one line from its base, which its first joint turns round.

    Returns:
        outlines of the area, float64[n, 2] each [m, world]: where the arm can turn all the way
        round, the outer and the inner one, else one; none where it reaches nothing.
    """
    base = arm.base_position[:2]
    chain = get_chain(arm)
    point, rotation = forward(chain, arm.home)
    facing = math.atan2(point[1] - base[1], point[0] - base[0])

    def place(radius: float, turn: float) -> np.ndarray:
        angle = facing + turn
        return base + radius * np.array([math.cos(angle), math.sin(angle)])

    def reached(radius: float, turn: float = 0.0) -> bool:
        start = arm.home.copy()
        start[0] += turn
        at = np.array([*place(radius, turn), height])
        return solve(arm, at, yaw_matrix(turn) @ rotation, start).ok

    longest = float(np.linalg.norm([*chain.offset[1:], chain.tool_offset], axis=1).sum())
    radii = [r for r in np.linspace(0.1, longest, 80).tolist() if reached(r)]
    if not radii:
        return ()
    low, high, middle = radii[0], radii[-1], radii[len(radii) // 2]

    def furthest(way: int) -> float:
        turns = (math.radians(5 * k) for k in range(37))
        return max(
            itertools.takewhile(lambda turn: reached(middle, way * turn), turns), default=0.0
        )

    first, last = furthest(-1), furthest(1)
    count = 1 + round(math.degrees(first + last) / 5)
    outer, inner = (
        np.array([place(r, turn) for turn in np.linspace(-first, last, count)]) for r in (high, low)
    )
    if first + last >= 2 * math.pi - 1e-6:
        return outer[:-1], inner[:-1]
    return (np.concatenate([outer, inner[::-1]]),)
