"""Where nothing sees blocks: they are taken to be where they were put.

A user who says so gets readings that follow from what the arm was told and what its tool felt, with
the errors of a good magazine and of a careful hand. Nobody notices then that a block was moved by
somebody else, or lies aslant.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix
from learn2assemble.motion.plant import (
    BlockReading,
    Guard,
    Motion,
    Plant,
    Readings,
    Report,
    Request,
    Stop,
    ToolCommand,
    WrappedPlant,
)
from learn2assemble.motion.setup import Setup
from learn2assemble.robot.bodies import body_of
from learn2assemble.robot.kinematics import Chain, forward, get_chain

PLACE, TURN = 3e-4, 3e-3
"""Standard deviations of where a block is taken to be [m], [rad]."""
WITHIN = 0.02
"""The tool has taken the block whose bounding box is nearest to its point, within this [m]."""


class Trusted(WrappedPlant):
    """A plant that sees no blocks, with readings of where they were put.

    Args:
        plant: the one behind it.
        setup: the cell as it is meant to be.
    """

    def __init__(self, plant: Plant, setup: Setup) -> None:
        super().__init__(plant)
        self.setup = setup
        self.chain: Chain = get_chain(setup.arm)
        self.poses: dict[str, np.ndarray] = {
            name: pose.copy() for name, pose in setup.waiting.items()
        }
        self.kinds: dict[str, str] = {name: name for name in setup.waiting}
        self.joined: dict[str, str] = {}
        """Blocks that clutch the one they follow."""
        self.held: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        """Blocks in the hand, and their places float64[3] and rotations in the tool frame."""
        covariance = np.diag([PLACE**2] * 3 + [TURN**2] * 3)
        self._covariance = covariance
        self._emptied: np.ndarray | None = None
        """float64[3]: where the tool was when a person took out of it what nobody knows [m]."""

    def sense(self) -> Readings:
        """See :class:`~learn2assemble.motion.plant.Plant`."""
        found = self.plant.sense()
        self._follow(found.joints)
        seen = tuple(
            BlockReading(name, pose.copy(), self._covariance, found.time)
            for name, pose in self.poses.items()
        )
        return found._replace(blocks=seen)

    def execute(
        self,
        motion: Motion,
        commands: Sequence[ToolCommand] = (),
        guards: Sequence[Guard] = (),
    ) -> Report:
        """See :class:`~learn2assemble.motion.plant.Plant`."""
        report = self.plant.execute(motion, commands, guards)
        joints = self.plant.sense().joints
        self._follow(joints)
        if report.stop in (Stop.VACUUM, Stop.WIDTH):
            # They are anywhere; so they are seen nowhere.
            for name in self.held:
                self.poses.pop(name)
            self.held = {}
        for command in commands:
            takes = command.vacuum
            if takes is None and command.width is not None:
                takes = command.force > 0
            if takes is False:
                self.held, self.joined = {}, {}
            elif takes and not self.held and report.tool.vacuum is not False:
                self._take(joints)
        return report

    def _follow(self, joints: np.ndarray) -> None:
        """What is held is where the tool is."""
        if not self.held:
            return
        position, rotation = forward(self.chain, joints)
        for name, (place, turn) in self.held.items():
            quaternion = matrix_quaternion(rotation @ turn)
            self.poses[name] = np.concatenate([position + rotation @ place, quaternion])

    def _take(self, joints: np.ndarray) -> None:
        """The tool has taken what is nearest to its point."""
        position, rotation = forward(self.chain, joints)
        nearest = self._nearest(position)
        together = {nearest, *(one for one, lead in self.joined.items() if lead == nearest)}
        for name in together & self.poses.keys():
            pose = self.poses[name]
            place = rotation.T @ (pose[:3] - position)
            self.held[name] = place, rotation.T @ quaternion_matrix(pose[3:])

    def _nearest(self, position: np.ndarray) -> str:
        """The block that the tool holds, or takes, where its point is at float64[3] [m]; empty:
        none is so near."""
        nearest, best = "", WITHIN
        for name, pose in self.poses.items():
            half = body_of(self.setup.kinds[self.kinds[name]].shape).half
            inside = quaternion_matrix(pose[3:]).T @ (position - pose[:3])
            far = float(np.linalg.norm(np.maximum(np.abs(inside) - half, 0.0)))
            # Of two that touch it is the one whose face the point is over.
            far += 1e-3 * float(np.linalg.norm(inside[:2]))
            if far < best:
                nearest, best = name, far
        return nearest

    def request(self, request: Request) -> Report:
        """See :class:`~learn2assemble.motion.plant.Plant`."""
        report = self.plant.request(request)
        if report.stop is Stop.END and request.what == "join":
            self.joined[request.block] = request.kind
        elif report.stop is Stop.END:
            if request.what in ("present", "place"):
                self.poses[request.block] = request.pose.copy()
                self.kinds[request.block] = request.kind
            elif request.block in self.poses:
                self.poses.pop(request.block)
            else:
                self._emptied = forward(self.chain, self.plant.sense().joints)[0]
            self.held.pop(request.block, None)
        return report

    def state(self) -> dict[str, Any]:
        """What the file of a build keeps, from which another one goes on; what is in the hand then
        is taken out of it."""
        return {
            "poses": {n: p.tolist() for n, p in self.poses.items() if n not in self.held},
            "kinds": self.kinds,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """As :meth:`state` said."""
        self.poses = {name: np.array(pose) for name, pose in state["poses"].items()}
        self.kinds, self.held, self.joined = dict(state["kinds"]), {}, {}
        if self._emptied is not None:
            # It was taken hold of when nobody was told so any more: it is not where it lay.
            self.poses.pop(self._nearest(self._emptied), None)
