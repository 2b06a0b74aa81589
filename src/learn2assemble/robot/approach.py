"""Joint positions over a place, from the contact upwards, on one branch."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.attempts import METRES_PER_RADIAN, seeds
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.inverse import solve
from learn2assemble.robot.motion import column

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
