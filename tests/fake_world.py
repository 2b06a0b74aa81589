"""What is on the table of a fake controller: blocks that hang on a cup as soon as it is on them,
and stay where they are let go. No forces, no time: a build of a hundred bricks in seconds."""

from __future__ import annotations

from typing import Any

import numpy as np

from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.kinematics import forward, get_chain

STIFF = 1e5
"""Of what is pressed on something [N/m]."""
DEEPEST, BESIDE = 0.01, 1e-3
"""What is deeper in something is beside it, not on it [m]; and so is what overlaps it by less
[m]."""
CLOSE = 0.004
"""A cup so near to a face takes hold of it [m]."""


class KinematicWorld:
    """Blocks as boxes, and the cup of an arm.

    Args:
        arm: with its tool, where it stands.
    """

    def __init__(self, arm: Arm) -> None:
        self.arm, self.chain = arm, get_chain(arm)
        self.half: dict[str, np.ndarray] = {}
        self.pose: dict[str, np.ndarray] = {}
        self.held: str | None = None
        self.odd: list[str] = []
        """What cannot be in a real cell."""
        self.stiff = STIFF
        self.force = 0.0
        """Upwards on what is held [N]."""
        self._in_hand = np.eye(3), np.zeros(3)
        self._boxes: dict[str, tuple[np.ndarray, np.ndarray]] = {}

    def present(self, name: str, half: Any, pose: Any) -> None:
        """A block is on the table; not where another one is, and not one that is elsewhere."""
        there = np.array(pose, float)
        for other, known in self.pose.items():
            near = float(np.linalg.norm(known[:3] - there[:3])) < CLOSE
            if (other == name) != near:
                self.odd.append(f"{name} is presented, and {other} is at {known[:3].tolist()}")
        self.half[name], self.pose[name] = np.array(half, float), np.array(pose, float)
        self._boxes.pop(name, None)

    def take(self, name: str) -> None:
        """A block is gone, also from the hand."""
        self.pose.pop(name, None)
        if self.held == name:  # Nothing presses on an empty cup.
            self.held, self.force = None, 0.0

    def drop(self) -> None:
        """What hangs on the cup falls off, though that is still on, and rolls out of sight."""
        if self.held is not None:
            self.pose.pop(self.held)
        self.held, self.force = None, 0.0

    def advance(self, joints: np.ndarray, vacuum: bool) -> None:
        """The arm is there now, and its vacuum on or off."""
        if self.held is None and not vacuum:
            return
        position, turn = forward(self.chain, joints)
        self.force = 0.0
        if self.held is not None:
            inner, offset = self._in_hand
            self.pose[self.held] = np.concatenate(
                [position + turn @ offset, matrix_quaternion(turn @ inner)]
            )
            self.force = self.stiff * self._depth(self.held)
            if not vacuum:
                self.held, self.force = None, 0.0
        elif vacuum:
            self.held = self._under(position)
            if self.held is not None:
                pose = self.pose[self.held]
                self._in_hand = (
                    turn.T @ quaternion_matrix(pose[3:]),
                    turn.T @ (pose[:3] - position),
                )

    def _depth(self, name: str) -> float:
        """By how much a block is in the table or in what it is lowered on [m]."""
        middle, half = self._bounds(name)
        low, found = middle[2] - half[2], max(half[2] - middle[2], 0.0)
        for other in self.pose:
            if other == name:
                continue
            there, size = self._bounds(other)
            shared = (half + size - np.abs(middle - there))[:2].min()
            deep = there[2] + size[2] - low
            if shared > BESIDE and 0 < deep < DEEPEST and self._over(name, other) > BESIDE:
                found = max(found, deep)
        return float(found)

    def _over(self, name: str, other: str) -> float:
        """By how much two upright blocks overlap, seen from above, on the axis where they do least
        [m]; those along the axes of the world overlap sooner, where a block is being turned."""
        apart = (self.pose[name] - self.pose[other])[:2]
        sides = [
            (quaternion_matrix(self.pose[one][3:])[:2, :2] * self.half[one][:2]).T
            for one in (name, other)
        ]
        least = np.inf
        for axis in np.vstack(sides):
            length = float(np.linalg.norm(axis))
            reach = sum(float(np.abs(side @ axis).sum()) for side in sides)
            least = min(least, (reach - abs(float(apart @ axis))) / length)
        return least

    def _bounds(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Middle and half extents of the box along the axes around a block [m]."""
        known = self._boxes.get(name)
        if known is not None and name != self.held:
            return known
        turn = np.abs(quaternion_matrix(self.pose[name][3:]))
        found = self.pose[name][:3], turn @ self.half[name]
        self._boxes[name] = found
        return found

    def _under(self, tip: np.ndarray) -> str | None:
        """The block on whose face the lip lies."""
        for name, pose in self.pose.items():
            inside = quaternion_matrix(pose[3:]).T @ (tip - pose[:3])
            out = np.abs(inside) - self.half[name]
            if out.max() < CLOSE and np.sort(out)[1] < 0 and out.max() > -CLOSE:
                return name
        return None
