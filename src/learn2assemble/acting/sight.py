"""What the arm knows of the cell, from what a plant lets it sense and from nothing else.

It looks until it knows what it has to, which may take several pictures; what is in the hand is
known in the frame of the tool. A touch is a measurement, too: pads and the lip of a cup lie flat
against what they hold.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.acting.belief import (
    GATE,
    Belief,
    Estimate,
    averaged,
    distance,
    fused,
    moved_on,
    read,
    step_between,
)
from learn2assemble.cell.world import LOOSE, LOST, MISSING, STANDING, WorkcellBlocks
from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.plants.plant import Plant, Readings, ToolReading
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.grasps import Attitude

PICTURE = 0.1
"""Two readings tell more than one if they are so far apart in time [s]."""
MOST_LOOKS = 10
"""How often it is looked at most for what has to be known."""
FINE = 1.2e-4
"""What is in the hand is looked at until its place is known so well: standard deviation [m]."""
TELLS = 0.97
"""A look that tells something of what is in the hand leaves no more of its spread than this."""
SHIFT, SHIFT_TURN = 1e-4, 2e-3
"""By which a block may move when it is taken or let go: standard deviations [m], [rad]."""
FLUSH, FLUSH_TURN = 1e-4, 2e-3
"""How well a face lies against pads or lip: standard deviations [m], [rad]."""
FELL, FELL_TURN = 0.005, math.radians(20.0)
"""A brick that has come off its knobs is farther from where it was [m], [rad]."""
ARM_OFF = 5e-5
"""How exactly the joints say where the tool is [m]."""


class Held(NamedTuple):
    """What is in the hand."""

    block: str
    estimate: Estimate
    """In the tool frame."""
    taken: np.ndarray
    """float64[7]: its pose in the tool frame when it was taken."""
    flush: np.ndarray
    """float64[3, 6]: what of a small motion in the tool frame would part it from pads or lip."""
    brings: dict[str, Estimate]
    """What it is pressed on or carries and brings along, in its own frame."""


class Sight:
    """What is known of all blocks.

    Args:
        plant: that is asked; no answer of it gets past that makes no sense.
        arm: of it.
        world: the blocks; where they are believed to be is written there.
        touch: whether the tool's touch counts as a measurement.
    """

    plant: Plant
    arm: Arm
    world: WorkcellBlocks
    touch: bool

    def __init__(self, plant: Plant, arm: Arm, world: WorkcellBlocks, touch: bool = True) -> None:
        self.plant, self.arm, self.world, self.touch = plant, arm, world, touch
        self.belief: Belief = Belief(lambda name: world.pieces[world.names.index(name)].turns())
        self.held: Held | None = None
        self.since: dict[str, float] = {}
        """When a block was moved last; older readings say nothing of it."""
        self.brought: dict[str, Estimate] = {}
        """What the block that was let go last has brought along, in its frame."""
        self.carried: set[int] = set()
        """Pieces that another arm moves or has moved since the attempt began: it says itself what
        comes of them."""
        self.last: float = -PICTURE
        self.pause: Callable[[float], Any] = lambda seconds: None
        """Waits [s], standing still."""

    # ------------------------------------------------------------ looking

    def look(self, needed: Collection[str] = (), fine: bool = False) -> None:
        """Look, until it is known where these blocks are; once more for whatever readings say that
        contradict what was known. Blocks that are not seen then are not known.

        Args:
            needed: names of blocks.
            fine: look at what is in the hand until its place is known to :data:`FINE`, as long as
                that tells anything.
        """
        self.belief.rest()
        for _ in range(MOST_LOOKS):
            before = self.held.estimate.spread if self.held else 0.0
            exact = self._picture()
            open_questions = bool(self.belief.rivals) or any(
                name not in self.belief.known and not self._carries(name) for name in needed
            )
            spread = self.held.estimate.spread if self.held else 0.0
            rough = fine and FINE < spread < TELLS * before
            if not open_questions and (exact or not rough):
                break
        self.write()

    def _picture(self) -> bool:
        """Take in what is sensed now; whether it is exact."""
        if self.last > -PICTURE:
            now = self.plant.sense()
            exact = now.blocks and not any(one.covariance.any() for one in now.blocks)
            if now.time - self.last < PICTURE and not exact:
                self.pause(PICTURE - (now.time - self.last))
        readings = self.plant.sense()
        self.last = readings.time
        tool = self._tool(readings)
        for one in readings.blocks:
            if self._holds(one.block):
                if one.time >= readings.time - 1e-6:
                    self._see_held(read(one), tool)
            elif self.held is not None and one.block in self.held.brings:
                continue  # It goes where the block goes that it is pressed on.
            elif one.time >= self.since.get(one.block, one.time):
                reading = read(one)
                if not self._on_knobs(one.block, reading):
                    self.belief.see(one.block, reading)
        return not any(one.covariance.any() for one in readings.blocks)

    def _on_knobs(self, name: str, reading: Estimate) -> bool:
        """Whether a reading is wrong as it contradicts that a brick was pressed home: knobs do not
        allow it to be a little beside its place, and one between others that are still in their
        places cannot have come off them."""
        world, known = self.world, self.belief.known.get(name)
        k = world.names.index(name)
        lower, upper = ([pair[n] for pair in world.home if pair[1 - n] == k] for n in (0, 1))
        if not (self.touch and (lower or upper) and known and reading.covariance.any()):
            return False
        reading = self.belief.as_known(name, reading, known)
        if distance(known, reading) <= GATE:
            return False
        off = step_between(known.pose, reading.pose)
        if np.linalg.norm(off[:3]) < FELL and np.linalg.norm(off[3:]) < FELL_TURN:
            return True
        return bool(lower) and any(self._in_place(n) for n in upper)

    def _in_place(self, k: int) -> bool:
        """Whether a block is where it shall be, as far as that is known."""
        known = self.belief.known.get(self.world.names[k])
        there = self.world.target(k)[:3]
        return known is not None and bool(np.linalg.norm(known.pose[:3] - there) < FELL)

    def _see_held(self, reading: Estimate, tool: tuple[np.ndarray, np.ndarray]) -> None:
        """A reading of what is in the hand."""
        assert self.held is not None
        held = self.held
        name, known = held.block, held.estimate
        seen = reading.seen_from(*tool)
        if not reading.covariance.any():
            self.held = held._replace(estimate=seen)
            return
        seen = self.belief.as_known(name, seen, known)
        off = np.diag([ARM_OFF**2] * 3 + [0.0] * 3)
        seen = seen._replace(covariance=seen.covariance + off)
        if distance(known, seen) <= GATE:
            self.held = held._replace(estimate=averaged(known, seen))
            self.belief.rivals.pop(name, None)
            return
        rival = self.belief.rivals.get(name)
        if rival is not None and distance(rival, seen) <= GATE:
            slipped = moved_on(known, averaged(rival, seen))
            self.held = self._flat(held._replace(estimate=slipped))
            self.belief.rivals.pop(name)
        else:
            self.belief.rivals[name] = seen

    def _tool(self, readings: Readings) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the tool float64[3] [m] and float64[3, 3]."""
        return forward(get_chain(self.arm), readings.joints)

    def _holds(self, name: str) -> bool:
        return self.held is not None and self.held.block == name

    def _carries(self, name: str) -> bool:
        return self._holds(name) or (self.held is not None and name in self.held.brings)

    def feel(self) -> ToolReading:
        """What the tool feels now."""
        return self.plant.sense().tool

    def write(self) -> None:
        """Blocks are where they are believed to be; what was missing may have been found."""
        world = self.world
        for k, name in enumerate(world.names):
            known = self.belief.known.get(name)
            if known is not None and world.state[k] == MISSING:
                world.state[k] = LOST
            there = world.state[k] in (STANDING, LOOSE, LOST) and k not in self.carried
            if known is not None and there:
                world.pose[k] = known.pose
                world.spread[k] = known.spread, known.turn_spread

    def unknown(self, k: int) -> bool:
        """Whether it is not known where a block is."""
        return self.world.names[k] not in self.belief.known

    # ------------------------------------------------------------ taking and letting go

    def taken(
        self, name: str, grasp: Attitude, contact: np.ndarray, along: Collection[str] = ()
    ) -> None:
        """The tool has taken hold of a block.

        Args:
            name: of it.
            grasp: how.
            contact: float64[3]: middle of the part that is held, in the frame of the block [m].
            along: names of blocks that it brings along.
        """
        tool = self._tool(self.plant.sense())
        stood = self.belief.known[name]
        frame = stood.pose[:3], quaternion_matrix(stood.pose[3:])
        beside = {one: self.belief.known.get(one) for one in along}
        brings = {one: est.seen_from(*frame) for one, est in beside.items() if est is not None}
        known = stood.seen_from(*tool)
        shift = np.diag([SHIFT**2] * 3 + [SHIFT_TURN**2] * 3)
        known = known._replace(covariance=known.covariance + shift)
        for one in (name, *along):
            self.belief.forget(one)
        held = Held(name, known, known.pose, self._parting(known, grasp, contact), brings)
        # The hand was turned so that the face should lie flat: what was meant is what is measured.
        self.held = self._flat(held)

    def _parting(self, known: Estimate, grasp: Attitude, contact: np.ndarray) -> np.ndarray:
        """See :attr:`Held.flush`: along the axis across pads, or out of the lip, and about the two
        others."""
        fingers = self.arm.suction is None
        frame = np.eye(3)[:, [2, 0, 1]] if fingers else grasp.lip.frame()
        axis = frame[:, 2]
        arm = quaternion_matrix(known.pose[3:]) @ contact
        rows = np.zeros((3, 6))
        rows[0, :3], rows[0, 3:] = axis, np.cross(arm, axis)
        rows[1, 3:], rows[2, 3:] = frame[:, 0], frame[:, 1]
        return rows

    def _flat(self, held: Held) -> Held:
        """A face of what is held lies flat against the tool, as when it was taken: it slips only
        along that."""
        if not self.touch:
            return held
        off = held.flush @ step_between(held.estimate.pose, held.taken)
        noise = np.diag([FLUSH, FLUSH_TURN, FLUSH_TURN]) ** 2
        return held._replace(estimate=fused(held.estimate, held.flush, off, noise))

    def let_go(self) -> None:
        """What was held rests where the hand is."""
        if self.held is None:
            return
        readings = self.plant.sense()
        name, known = self.held.block, self.held.estimate
        there = known.seen_in(*self._tool(readings))
        shift = np.diag([SHIFT**2] * 3 + [SHIFT_TURN**2] * 3)
        self.brought, self.held = self.held.brings, None
        self.belief.put(name, there._replace(covariance=there.covariance + shift))
        self._put_along(name)
        self.since.update(dict.fromkeys((name, *self.brought), readings.time))

    def _put_along(self, name: str) -> None:
        """What a block has brought along is where that says."""
        lead = self.belief.known[name]
        turn = quaternion_matrix(lead.pose[3:])
        for one, beside in self.brought.items():
            there = beside.seen_in(lead.pose[:3], turn)
            x, y, z = there.pose[:3] - lead.pose[:3]
            onto = np.eye(6)
            # Where it is turns with the block that brought it, about that.
            onto[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
            covariance = there.covariance + onto @ lead.covariance @ onto.T
            self.belief.put(one, there._replace(covariance=covariance))

    def rests(self, name: str, where: Estimate) -> None:
        """A touch tells where a block is that was let go, unless that contradicts what is known.

        Args:
            name: of it.
            where: what the touch tells.
        """
        known = self.belief.known[name]
        where = self.belief.as_known(name, where, known)
        if self.touch and known.covariance.any() and distance(known, where) <= GATE:
            self.belief.put(name, averaged(known, where))
            self._put_along(name)

    def dropped(self) -> None:
        """What was held is somewhere else."""
        if self.held is not None:
            gone = (self.held.block, *self.held.brings)
            for one in gone:
                self.belief.forget(one)
            self.since.update(dict.fromkeys(gone, self.plant.sense().time))
            self.held = None

    def in_hand(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose of what is held in the tool frame: float64[3] [m] and float64[3, 3]."""
        assert self.held is not None
        pose = self.held.estimate.pose
        return pose[:3], quaternion_matrix(pose[3:])

    def held_pose(self, joints: np.ndarray) -> np.ndarray:
        """float64[7]: of what is held, where the arm is at these joints."""
        position, rotation = forward(get_chain(self.arm), joints)
        where, turn = self.in_hand()
        return np.array([*(position + rotation @ where), *matrix_quaternion(rotation @ turn)])

    # ------------------------------------------------------------ a file of the build

    def state(self) -> dict[str, Any]:
        """What a file says of it."""
        return {"known": self.belief.state(), "since": self.since, "looked": self.last}

    def restore(self, state: dict[str, Any]) -> None:
        """As a file says it was."""
        self.belief.restore(state["known"])
        self.since, self.last = state["since"], state["looked"]
