"""The kinematic cell as a plant: blocks follow the hand and stay where they are let go, nothing
weighs anything, and nothing gives way."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from learn2assemble.geometry.hulls import separation
from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix
from learn2assemble.kinematics.chain import Chain, forward, get_chain
from learn2assemble.plants.plant import (
    Commands,
    Guards,
    Motion,
    Played,
    Readings,
    Report,
    Stop,
    ToolCommand,
    ToolReading,
)
from learn2assemble.plants.setup import Setup
from learn2assemble.robot.bodies import Shape, solids
from learn2assemble.simulation.disturbances import Straying
from learn2assemble.simulation.things import SimulatedCell, bounds, bounds_at, check_motion, nearest

REACH = 0.015
"""The tool takes what is within this of it [m]."""
INTO, CARRIES = 1e-8, 0.1
"""What is lowered rests where it is so deep in something [m], below it: cosine of the angle between
its way and the axis that parts the two, at least."""
HALVINGS, LAST = 40, 0.02
"""How often the time of a contact is halved, and the share of a motion that tells its way."""
STEP = 0.001
"""What is lowered is looked at after so far, to find what it meets [m]."""


class KinematicPlant(SimulatedCell):
    """An arm and blocks without forces.

    Args:
        setup: as things are meant to be.
    """

    chain: Chain
    straying: Straying
    time: float
    width: float
    force: float

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.chain, self.straying = get_chain(setup.arm), Straying(self.chances, setup.arm)
        self.joints: np.ndarray = (setup.arm.home if setup.joints is None else setup.joints).copy()
        self.time, self.width, self.force = 0.0, setup.arm.gripper.max_width, 0.0
        self.hand: tuple[str, np.ndarray, np.ndarray] | None = None
        """The block in it, its position float64[3] and rotation in the tool frame."""

    def sense(self) -> Readings:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        return self.seen(self.time, self.joints.copy(), np.zeros_like(self.joints), self._feel())

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        check_motion(self.arm, motion.joints, self.joints)
        moves = bool(len(motion.joints) and np.ptp(motion.joints, axis=0).any())
        stop, seconds = Stop.END, motion.seconds
        share = self.drop_share() if moves and motion.stage == "cross" and self.hand else None
        if share is not None:
            self._go(motion, share * seconds)
            self._fall()
            stop, seconds = Stop.VACUUM if self.arm.suction else Stop.WIDTH, share * seconds
        elif moves:
            contact = next((guard for guard in guards if guard.contact is not None), None)
            found = None if contact is None else self._first_contact(motion, contact.begin)
            if found is not None:
                stop, seconds = Stop.CONTACT, found
            self._go(motion, seconds)
        for command in commands:
            self._tell(command)
        if self.hand is not None and any(guard.hold == "made" for guard in guards):
            stop = Stop.HELD
            self.taken()
            self.things[self.hand[0]].handled = True
        before, self.time = self.time, self.time + seconds
        if self.push_due and motion.stage == "home" and moves:
            self.push()
        done = seconds / motion.seconds if motion.seconds else 1.0
        return Report(
            stop, done, self.joints.copy(), seconds, "", self._feel(), self._played(before)
        )

    def where(self) -> np.ndarray:
        """See :class:`SimulatedCell`."""
        return self.joints.copy()

    def state(self) -> dict[str, Any]:
        """See :class:`SimulatedCell`."""
        more = {"joints": self.joints.tolist(), "width": self.width, "time": self.time}
        return super().state() | more

    def restore(self, state: dict[str, Any]) -> None:
        """See :class:`SimulatedCell`."""
        super().restore(state)
        self.joints, self.width, self.time = (
            np.array(state["joints"]),
            state["width"],
            state["time"],
        )

    # ------------------------------------------------------------ what happens

    def _feel(self) -> ToolReading:
        held = self.hand is not None
        if self.arm.suction is not None:
            return ToolReading(vacuum=held)
        return ToolReading(width=self.width, grip=self.force if held else 0.0)

    def _played(self, before: float) -> Played:
        n = np.stack([self.joints] * 2)
        told = np.full(2, float(self.hand is not None) if self.arm.suction else self.width)
        return Played(np.array([before, self.time]), n, np.zeros_like(n), 0 * told, told)

    def _go(self, motion: Motion, time: float) -> None:
        """The arm, and what it holds, are where they are at a time of a motion [s]."""
        self.joints = motion.at(np.array([time]))[0][0]
        for name, pose in self._carried(self.joints).items():
            self.things[name].pose = pose

    def _tool(self, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the tool truly is, float64[3] [m] and [3, 3], where joints were told this."""
        return forward(self.chain, joints + self.straying.zero)

    def _carried(self, joints: np.ndarray) -> dict[str, np.ndarray]:
        """float64[7]: poses of what is in the hand, and of what is joined to it, where the arm is
        at these joints."""
        if self.hand is None:
            return {}
        name, position, rotation = self.hand
        point, turn = self._tool(joints)
        before, axes = self.things[name].pose, turn @ rotation
        found = {name: np.array([*(point + turn @ position), *matrix_quaternion(axes)])}
        change = axes @ quaternion_matrix(before[3:]).T
        for other, lead in self.joined.items():
            if lead == name:
                pose = self.things[other].pose
                place = found[name][:3] + change @ (pose[:3] - before[:3])
                turned = matrix_quaternion(change @ quaternion_matrix(pose[3:]))
                found[other] = np.array([*place, *turned])
        return found

    def _first_contact(self, motion: Motion, begin: float) -> float | None:
        """When what is lowered meets something below it [s]; None: it does not."""
        if self.hand is None:
            return None
        told = np.array([begin, motion.seconds * (1 - LAST), motion.seconds])
        first, near, last = (forward(self.chain, joints)[0] for joints in motion.at(told)[0])
        way = (last - near) / max(float(np.linalg.norm(last - near)), 1e-9)
        # In steps: where two are deep in one another, what parts them is beside, not below.
        steps = math.ceil(float(np.linalg.norm(last - first)) / STEP) + 1
        times = np.linspace(begin, motion.seconds, steps + 1)
        every = enumerate(motion.at(times)[0])
        met = next((k for k, joints in every if self._rests(joints, way)), None)
        if met is None:
            return None
        low, high = float(times[max(met - 1, 0)]), float(times[met])
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            joints = motion.at(np.array([middle]))[0][0]
            low, high = (low, middle) if self._rests(joints, way) else (middle, high)
        return high

    def _rests(self, joints: np.ndarray, way: np.ndarray) -> bool:
        """Whether something in the hand is in something below it."""
        mine = self._carried(joints)
        up = quaternion_matrix(self.table[3:])[:, 2]
        for name, pose in mine.items():
            parts = solids(self.things[name].kind.shape, pose)
            if min(float(((one[0] - self.table[:3]) @ up).min()) for one in parts) < -INTO:
                return True
            low = np.min([one[0].min(0) for one in parts], axis=0)
            high = np.max([one[0].max(0) for one in parts], axis=0)
            for other, shape, there in self._around():
                bottom, top = bounds_at(shape, there)
                if other in mine or (bottom > high).any() or (top < low).any():
                    continue
                for a in parts:
                    for b in solids(shape, there):
                        gap, axis = separation(a, b)
                        if gap < -INTO and abs(float(axis @ way)) > CARRIES:
                            return True
        return False

    def _around(self) -> Iterator[tuple[str, Shape, np.ndarray]]:
        """Names, shapes and poses float64[7] of all blocks and of what stays where it is."""
        yield from ((name, one.kind.shape, one.pose) for name, one in self.things.items())
        yield from (("", kind.shape, pose) for kind, pose in self.setup.fixed)

    def _fall(self) -> None:
        """What is held falls straight down, flat on what is below it."""
        assert self.hand is not None
        thing = self.things[self.hand[0]]
        self.hand = None
        low, high = bounds(thing)
        below = 0.0
        for other in self.things.values():
            bottom, top = bounds(other)
            if other is not thing and (bottom[:2] < high[:2]).all() and (top[:2] > low[:2]).all():
                below = max(below, float(top[2]))
        thing.pose = thing.pose.copy()
        thing.pose[2] += below - low[2]

    def _tell(self, command: ToolCommand) -> None:
        if command.vacuum:
            self._take()
        elif command.vacuum is not None:
            self._let_go()
        if command.width is not None:
            self.width, self.force = command.width, command.force
            if command.force:
                self._take()
            else:
                self._let_go()

    def _let_go(self) -> None:
        if self.hand is not None:
            self.joined.clear()
        self.hand = None

    def _take(self) -> None:
        """Take hold of what is there; it comes to lie against the pads, or the lip."""
        point, turn = self._tool(self.joints)
        lips = [(np.array([0.0, 1.0, 0.0]), np.zeros(3))]
        if self.arm.suction is not None:
            lips = [(np.array(c.lip.axis), np.array(c.lip.at)) for c in self.arm.suction.cups]
        for axis, at in lips:
            name = nearest(self.things, [point + turn @ at], REACH)
            if name is not None:
                pose = self.things[name].pose
                rotation = turn.T @ quaternion_matrix(pose[3:])
                where = turn.T @ (pose[:3] - point)
                self.hand = name, *self._straight(name, axis, at, where, rotation)
                self.things[name].pose = self._carried(self.joints)[name]
                return

    def _straight(
        self, name: str, axis: np.ndarray, at: np.ndarray, where: np.ndarray, turn: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The pose in the tool frame after a face has come to lie against the tool."""
        shape = self.things[name].kind.shape
        part = min(
            shape, key=lambda p: float(np.linalg.norm(where + turn @ np.array(p.centre) - at))
        )
        normals = part.solid.normals @ turn.T
        face = int(np.argmin(normals @ axis))
        normal, cross = normals[face], np.cross(normals[face], -axis)
        size = float(np.linalg.norm(cross))
        if size > 1e-12:
            angle = np.arctan2(size, float(-normal @ axis)) / 2
            q = np.array([np.cos(angle), *(np.sin(angle) * cross / size)])
            change = quaternion_matrix(q)
            where, turn = at + change @ (where - at), change @ turn
        points = (where + part.points @ turn.T) @ axis - at @ axis
        if self.arm.suction is not None:
            return where - points.min() * axis, turn
        return where - (points.min() + points.max()) / 2 * axis, turn
