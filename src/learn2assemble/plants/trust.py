"""Where nothing sees blocks: they are taken to be where they were put.

A user who says so gets readings that follow from what the arm was told and what its tool felt, with
the errors of a good magazine and of a careful hand. Arms that share a cell share what they take to
be so. Nobody notices then that a block was moved by somebody else, or lies aslant.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix
from learn2assemble.kinematics.chain import Chain, forward, get_chain
from learn2assemble.plants.plant import (
    BlockReading,
    Commands,
    Guards,
    Motion,
    Plant,
    Readings,
    Report,
    Request,
    Stop,
    WrappedPlant,
)
from learn2assemble.plants.setup import Setup
from learn2assemble.robot.bodies import body_of

PLACE, TURN = 3e-4, 3e-3
"""Standard deviations of where a block is taken to be [m], [rad]."""
WITHIN = 0.02
"""The tool has taken the block whose bounding box is nearest to its point, within this [m]."""


class Placements:
    """Where blocks are taken to be, as no one sees them: of one arm, or of all that share a cell.

    Args:
        setup: the cell as it is meant to be.
    """

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.poses: dict[str, np.ndarray] = {
            name: pose.copy() for name, pose in setup.waiting.items()
        }
        """float64[7] by name."""
        self.kinds: dict[str, str] = {name: name for name in setup.waiting}
        self.joined: dict[str, str] = {}
        """Blocks that clutch the one they follow."""
        self.in_hands: set[str] = set()
        """Blocks that some arm holds."""
        self.emptied: list[np.ndarray] = []
        """float64[3]: where tools were when a person took out of them what nobody knows [m]."""

    def nearest(self, position: np.ndarray) -> str:
        """The block that a tool holds, or takes, where its point is at float64[3] [m]; empty: none
        is so near. What an arm holds already no other one takes."""
        nearest, best = "", WITHIN
        for name, pose in self.poses.items():
            if name in self.in_hands:
                continue
            half = body_of(self.setup.kinds[self.kinds[name]].shape).half
            inside = quaternion_matrix(pose[3:]).T @ (position - pose[:3])
            far = float(np.linalg.norm(np.maximum(np.abs(inside) - half, 0.0)))
            # Of two that touch it is the one whose face the point is over.
            far += 1e-3 * float(np.linalg.norm(inside[:2]))
            if far < best:
                nearest, best = name, far
        return nearest

    def state(self) -> dict[str, Any]:
        """What the file of a build keeps, from which another one goes on; what is in a hand then
        is taken out of it."""
        poses = {n: p.tolist() for n, p in self.poses.items() if n not in self.in_hands}
        return {"poses": poses, "kinds": self.kinds}

    def restore(self, state: dict[str, Any]) -> None:
        """As :meth:`state` said."""
        self.poses = {name: np.array(pose) for name, pose in state["poses"].items()}
        self.kinds, self.joined, self.in_hands = dict(state["kinds"]), {}, set()
        for where in self.emptied:
            # It was taken hold of when nobody was told so any more: it is not where it lay.
            self.poses.pop(self.nearest(where), None)


class Trusted(WrappedPlant):
    """A plant that sees no blocks, with readings of where they were put.

    Args:
        plant: the one behind it.
        setup: the cell as it is meant to be, with its arm.
        known: where blocks are taken to be, if other arms move some of them, too.
    """

    def __init__(self, plant: Plant, setup: Setup, known: Placements | None = None) -> None:
        super().__init__(plant)
        self.chain: Chain = get_chain(setup.arm)
        self.known: Placements = known or Placements(setup)
        self.held: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        """Blocks in the hand, and their places float64[3] and rotations in the tool frame."""
        self.joins: set[str] = set()
        """Blocks that it brings along, as was said since it let go last."""
        covariance = np.diag([PLACE**2] * 3 + [TURN**2] * 3)
        self._covariance = covariance

    def sense(self) -> Readings:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        found = self.plant.sense()
        self._follow(found.joints)
        seen = tuple(
            BlockReading(name, pose.copy(), self._covariance, found.time)
            for name, pose in self.known.poses.items()
        )
        return found._replace(blocks=seen)

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        report = self.plant.execute(motion, commands, guards)
        joints = self.plant.sense().joints
        self._follow(joints)
        if report.stop in (Stop.VACUUM, Stop.WIDTH):
            # They are anywhere; so they are seen nowhere.
            for name in self.held:
                self.known.poses.pop(name)
            self._let_go()
        for command in commands:
            takes = command.vacuum
            if takes is None and command.width is not None:
                takes = command.force > 0
            if takes is False:
                for name in self.joins:
                    self.known.joined.pop(name, None)
                self.joins.clear()
                self._let_go()
            elif takes and not self.held and report.tool.vacuum is not False:
                self._take(joints)
        return report

    def _let_go(self) -> None:
        """Nothing is in the hand any more."""
        self.known.in_hands -= set(self.held)
        self.held = {}

    def _follow(self, joints: np.ndarray) -> None:
        """What is held is where the tool is."""
        if not self.held:
            return
        position, rotation = forward(self.chain, joints)
        for name, (place, turn) in self.held.items():
            quaternion = matrix_quaternion(rotation @ turn)
            self.known.poses[name] = np.concatenate([position + rotation @ place, quaternion])

    def _take(self, joints: np.ndarray) -> None:
        """The tool has taken what is nearest to its point."""
        known = self.known
        position, rotation = forward(self.chain, joints)
        nearest = known.nearest(position)
        together = {nearest, *(one for one, lead in known.joined.items() if lead == nearest)}
        for name in together & known.poses.keys():
            pose = known.poses[name]
            place = rotation.T @ (pose[:3] - position)
            self.held[name] = place, rotation.T @ quaternion_matrix(pose[3:])
            known.in_hands.add(name)

    def request(self, request: Request) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        report, known = self.plant.request(request), self.known
        if report.stop is Stop.END and request.what == "join":
            known.joined[request.block] = request.kind
            self.joins.add(request.block)
        elif report.stop is Stop.END:
            if request.what in ("present", "place"):
                known.poses[request.block] = request.pose.copy()
                known.kinds[request.block] = request.kind
            elif request.block in known.poses:
                known.poses.pop(request.block)
            else:
                known.emptied.append(forward(self.chain, self.plant.sense().joints)[0])
            self.held.pop(request.block, None)
            known.in_hands.discard(request.block)
        return report

    def state(self) -> dict[str, Any]:
        """See :meth:`Placements.state`."""
        return self.known.state()

    def restore(self, state: dict[str, Any]) -> None:
        """See :meth:`Placements.restore`."""
        self.held = {}
        self.known.restore(state)
