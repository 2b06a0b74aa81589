"""What is on the table of a fake controller: blocks that hang on a cup as soon as it is on them,
and stay where they are let go. No forces, no time: a build of a hundred bricks in seconds."""

from __future__ import annotations

from typing import Any

import numpy as np

from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.kinematics import forward, get_chain

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
        self.on = False
        self._in_hand = np.eye(3), np.zeros(3)

    def present(self, name: str, half: Any, pose: Any) -> None:
        """A block is on the table."""
        self.half[name], self.pose[name] = np.array(half, float), np.array(pose, float)

    def take(self, name: str) -> None:
        """A block is gone."""
        self.pose.pop(name, None)

    def drop(self) -> None:
        """What hangs on the cup falls off, though that is still on."""
        self.held, self.on = None, True

    def advance(self, joints: np.ndarray, vacuum: bool) -> None:
        """The arm is there now, and its vacuum on or off."""
        if self.held is None and (not vacuum or self.on):
            self.on = vacuum
            return
        position, turn = forward(self.chain, joints)
        if self.held is not None:
            inner, offset = self._in_hand
            self.pose[self.held] = np.concatenate(
                [position + turn @ offset, matrix_quaternion(turn @ inner)]
            )
            if not vacuum:
                self.held = None
        elif vacuum and not self.on:
            self.held = self._under(position)
            if self.held is not None:
                pose = self.pose[self.held]
                self._in_hand = (
                    turn.T @ quaternion_matrix(pose[3:]),
                    turn.T @ (pose[:3] - position),
                )
        self.on = vacuum

    def _under(self, tip: np.ndarray) -> str | None:
        """The block on whose face the lip lies."""
        for name, pose in self.pose.items():
            inside = quaternion_matrix(pose[3:]).T @ (tip - pose[:3])
            out = np.abs(inside) - self.half[name]
            if out.max() < CLOSE and np.sort(out)[1] < 0 and out.max() > -CLOSE:
                return name
        return None
