"""An arm holds a block in its place and feels what its neighbours do to it.

A hand that takes over a block of an arch has to press it on those that stand, as the proof counts
on: near the top joints are upright, and a block that nothing presses on from both sides slides down
between its neighbours. Pressed on with more, those below slide, or all of them tip. So the hand
moves along the joint until it feels the force that was asked for, and is where it shall be in all
other ways. Before a hand lets go it gives its load away, in the same manner: what it releases
stands already.

Hands can give many wrenches that balance a structure. Most of them leave some joints pressed at an
edge, where they open like hinges when anything gives way by a hundredth of a millimetre. So every
corner of every joint is to bear at least some share of the mean of its joint, the largest of
:data:`SHARES` that can be had; of all such forces those are taken for which the hand gives least.
"""

from __future__ import annotations

import numpy as np

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.contacts import Contacts
from learn2assemble.constants import GRAVITY
from learn2assemble.geometry.rotations import (
    interpolate_quaternions,
    matrix_quaternion,
    quaternion_matrix,
)
from learn2assemble.handling.execution import Execution
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.kinematics.inverse import solve
from learn2assemble.plants.plant import Guard, Motion
from learn2assemble.robot.arm import Arm
from learn2assemble.statics.forces.block_forces import System
from learn2assemble.statics.states import State

TURN = 0.04
"""Between two looks at what it feels, and whether it is the turn of an arm [s]."""
TURNS = 90
"""For so many of them a hand presses before the other one lets go, and after that; and for so many
it gives its load away."""
FIRM = 2e4
"""Of drives and what is pressed on together it is taken to be the stiffness [N/m]: where it is
smaller the force is met slower."""
MOST_BACK = 1e-3
"""A hand that holds a block brings it to where it shall be, which it has missed by what carries it
has given way, by so much at most at once [m]: else a gap that is closed from both sides is too
narrow."""
FARTHEST = 3e-3
"""In all a hand moves no farther from where it set its block down than this [m], whatever it feels:
a force that is never met is one that nothing measures, or nothing bears."""
MOST_TURN = 0.01
"""The same of how it is turned [rad]."""
NEAR_BY = 0.02
"""For that no joint turns by more [rad]: the arm stays bent as it is."""
PRESSES = 0.01
"""It is told to be no farther from there than this [rad], whatever is in its way: no drive of our
arms turns with more than 45 N m for that."""
GIVES, AT_ONCE = 0.3, 1e-3
"""Of how far the joints of an arm that holds are off, so much is taken back every time, and no more
than this [rad]."""
MORE, SOON = 0.02, 5e-4
"""A hand that keeps its place presses with so much more of the force in every turn, or less, where
its block is so far from there along the joint [m]; in proportion where it is nearer."""
NARROWER = 1e-4
"""It keeps a gap that is still to be closed narrower by this than drawn [m]: by about as much what
stands gives way when the last block bears it and the hand lets go. A voussoir of 8.6 degrees goes
in 0.7 mm deeper where its gap is wider by so much."""
BETWEEN = 0.3, 3.0
"""Least and largest share of the force."""
KEPT = Guard(hold="kept")
SHARES = (0.5, 0.4, 0.3, 0.2, 0.1, 0.0)
"""Of the mean force at the corners of a joint, what each of them bears at least, as tried."""
SURE = (0.85, 1.0)
"""Shares of the friction that forces may need, as tried."""


def contact_force(
    assembly: Assembly, contacts: Contacts, state: State, block: int
) -> np.ndarray | None:
    """What the contacts of a held block shall do to it.

    Args:
        assembly: blocks where they stand.
        contacts: of that assembly.
        state: with that block in a bounded hand.
        block: number of it.

    Returns:
        float64[3], the sum of their forces [N, world]; None where no forces balance the state.
    """
    system = System(assembly, contacts, state.present, state.held, dict(state.hands))
    for friction in SURE:
        for share in SHARES:
            forces = system.centred(friction * assembly.friction, share)
            if forces is not None:
                every = system.newtons(forces)
                on = contacts.b[contacts.patch] == block
                off = contacts.a[contacts.patch] == block
                return every[on].sum(0) - every[off].sum(0)
    return None


class PressingHand:
    """An arm with a block in its hand that is in its place.

    Args:
        run: the attempt by which it came.
        arm: at its base.
        in_hand: float64[3] and float64[3, 3], of the block in the frame of the tool.
        pose: float64[7], the pose the block shall have.
        way: float64[3], unit vector towards what it is pressed on; zeros where it is on nothing.
        force: float64[3], of what all contacts shall do to it while it is held [N]; None: it is
            not pressed on anything, and only kept in its place.
        mass: of the block [kg].
    """

    def __init__(
        self,
        run: Execution,
        arm: Arm,
        in_hand: tuple[np.ndarray, np.ndarray],
        pose: np.ndarray,
        way: np.ndarray,
        force: np.ndarray | None,
        mass: float,
    ) -> None:
        self.run: Execution = run
        self.arm: Arm = arm
        self.in_hand: tuple[np.ndarray, np.ndarray] = in_hand
        self.pose: np.ndarray = pose
        self.way: np.ndarray = np.zeros(3) if force is None else way
        self.force: np.ndarray = np.zeros(3) if force is None else force
        self.weight: np.ndarray = np.array([0.0, 0.0, GRAVITY * mass])
        self.share: float = 1.0
        """Of the force, what it presses with."""
        self.there: np.ndarray = self._joints()
        """float64[n]: where it stays [rad]."""
        self.start: np.ndarray = self._hand()[0]
        """float64[3]: where the tool set the block down [m]."""

    def stay(self) -> None:
        """Hold it where it is, for a turn."""
        self._keep(self.there)

    def press(self, keeps: bool = False) -> None:
        """Press it along the joint with the force, for a turn, and bring it to its place in all
        other ways.

        Args:
            keeps: whether the force is found with which it stays in its place along the joint, too.
                That of the proof is one of many that friction allows, under which all that stands
                creeps as far as it can.
        """
        (where, turn), way = self._hand(), self.way
        place, turn = self._brought(turn)
        if keeps:
            short = float(way @ (place - where)) - NARROWER
            self.share += MORE * float(np.clip(short / SOON, -1.0, 1.0))
            self.share = float(np.clip(self.share, *BETWEEN))
        more = float(way @ (self._felt() - self.share * self.force)) / FIRM
        off = _at_most(place - where, MOST_BACK)
        push = float(np.clip(more, -MOST_BACK, MOST_BACK)) - float(way @ off)
        self._keep(self._bent(where + off + way * push, turn))
        self.there = self._joints()

    def ease(self) -> None:
        """Give its load to what it stands on, for a turn.

        Sideways, along the joint and level, it stays in its place, and friction bears what it has
        borne there: joints that are pressed at few corners turn like hinges, and a hand that gave
        way sideways would let the whole arch follow (by half a millimetre for 0.4 N, measured).
        """
        (where, turn), more = self._hand(), (self._felt() - self.weight) / FIRM
        side = np.cross(self.way, (0.0, 0.0, 1.0))
        size = float(np.linalg.norm(side))
        if size > 1e-6:
            side /= size
            place, turn = self._brought(turn)
            more += side * (side @ (_at_most(place - where, MOST_BACK) - more))
        self._keep(self._bent(where + _at_most(more, MOST_BACK), turn))

    # ------------------------------------------------------------ the arm

    def _joints(self) -> np.ndarray:
        return self.run.rig.plant.sense().joints

    def _hand(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the tool is, float64[3] [m], and its axes, float64[3, 3]."""
        return forward(get_chain(self.arm), self._joints())

    def _felt(self) -> np.ndarray:
        """float64[3]: what all contacts do to the block [N]."""
        return np.array(self.run.rig.plant.sense().tool.force)

    def _brought(self, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The tool with the block in its place, turned by no more than :data:`MOST_TURN` from its
        axes float64[3, 3]."""
        where, held = self.in_hand
        now, meant = matrix_quaternion(turn @ held), self.pose[3:]
        angle = 2 * float(np.arccos(min(1.0, abs(float(now @ meant)))))
        share = min(1.0, MOST_TURN / max(angle, 1e-9))
        axes = quaternion_matrix(interpolate_quaternions(now, meant, share)) @ held.T
        return self.pose[:3] - axes @ where, axes

    def _bent(self, point: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """float64[n] [rad]: the arm with its tool at a point float64[3] [m], or as near to it as it
        may move, its axes float64[3, 3]; as it is, where it cannot without another bend."""
        joints = self._joints()
        point = self.start + _at_most(point - self.start, FARTHEST)
        found = solve(self.arm, point, turn, joints, restarts=0)
        near = found.ok and np.abs(found.joints - joints).max() < NEAR_BY
        return found.joints if near else joints

    def _keep(self, there: np.ndarray) -> None:
        """Hold for a turn.

        Drives give way under a load like springs, and what a block leans on has given way before
        it came. The arm is told to be as far on the other side of where it shall be, so that the
        hand comes there.

        Args:
            there: float64[n], the joints with the block where it shall be [rad].
        """
        run = self.run
        off = there - self._joints()
        told = run.joints + np.clip(GIVES * off, -AT_ONCE, AT_ONCE)
        told = np.clip(told, there - PRESSES, there + PRESSES)
        joints = np.array([run.joints, told])
        run.do(Motion("place", np.array([0.0, TURN]), joints, np.zeros_like(joints)), (KEPT,))


def _at_most(way: np.ndarray, size: float) -> np.ndarray:
    """float64[3], no longer than this."""
    return way * min(1.0, size / max(float(np.linalg.norm(way)), 1e-9))
