"""What there really is in a simulated cell: the blocks and where they are, a magazine, a person.

No one outside the simulation sees this but through readings; reports of a simulation may measure
it when a build is over.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.plants.plant import PlantError, Readings, Report, Request, Stop, ToolReading
from learn2assemble.plants.setup import BlockKind, Setup
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.bodies import Shape, body_of, overlaps, solids
from learn2assemble.simulation.disturbances import (
    DROPPED,
    PUSHED,
    Chances,
    Pictures,
    on_table,
    pushed,
)

TOUCHES, CARRIES = 1e-4, 2e-3
"""Blocks that overlap by more are in each other's way, and what begins within this of the top of
another one rests on it [m]."""
PRESENTING = 0.0
"""How long the arm waits for a magazine [s]."""


@dataclass
class Thing:
    """A block in the cell."""

    like: str
    """Name of the block of the plan whose shape it was made to."""
    number: int
    """How many were presented before it; what is off about it follows from that."""
    kind: BlockKind
    """As it is."""
    pose: np.ndarray
    """float64[7]"""
    handled: bool = False
    """Whether the arm has had it in its hand."""


class SimulatedCell:
    """The part of a simulated plant that is the same whatever moves blocks.

    Args:
        setup: as things are meant to be.
    """

    setup: Setup
    arm: Arm
    presented: int
    grasps: int

    def __init__(self, setup: Setup) -> None:
        self.setup, self.arm = setup, setup.arm
        self.chances: Chances = Chances(setup.simulated)
        self.pictures: Pictures = Pictures(self.chances)
        self.table: np.ndarray = self.chances.table()
        self.things: dict[str, Thing] = {}
        self.presented = self.grasps = 0
        """How often a magazine presented a block, and the arm took hold of something."""
        self.push_due: bool = False
        self.home: set[tuple[int, int]] = set()
        """Joints of studs that are pressed home: lower and upper kind."""
        self.joined: dict[str, str] = {}
        """Blocks that follow another one while that is in the hand."""
        for name, pose in setup.waiting.items():
            self.things[name] = self._made(name, pose)

    # ------------------------------------------------------------ what a plant answers

    def request(self, request: Request) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        name, known = request.block, request.block in self.things
        in_hand = self.in_hand(name)
        if request.what == "present" and not known and request.kind in self.setup.kinds:
            self.things[name] = self._made(request.kind, request.pose)
        elif request.what == "place":
            if not known:
                self.things[name] = self._made(request.kind, request.pose)
            self.things[name].pose = on_table(self.table, request.pose)
            self.things[name].handled = True
        elif request.what in ("return", "remove"):
            self.things.pop(name, None)
        elif request.what == "join" and known and request.kind in self.things:
            self.joined[name] = request.kind
        else:
            return self._report(Stop.REFUSED, f"nobody can {request.what} {name}")
        self.changed(name)
        # Nothing lies on what is taken out of the hand.
        if request.what == "place" or (request.what == "remove" and not in_hand):
            self.come_to_rest()
        return self._report(Stop.END, "")

    def stop(self) -> None:
        """See :class:`~learn2assemble.plants.plant.Plant`: it stands between two motions."""

    def close(self) -> None:
        """See :class:`~learn2assemble.plants.plant.Plant`."""

    def seen(
        self, time: float, joints: np.ndarray, velocity: np.ndarray, tool: ToolReading
    ) -> Readings:
        """What is sensed."""
        poses = {name: thing.pose for name, thing in self.things.items()}
        blocks = self.pictures.look(time, poses)
        return Readings(time, joints, velocity, blocks, tool, self.arm.name)

    def solids(self) -> list[tuple[Shape, np.ndarray]]:
        """Shapes and poses float64[7] of all that stands there, for cameras to take pictures of."""
        blocks = [(thing.kind.shape, thing.pose) for thing in self.things.values()]
        return [*((kind.shape, pose) for kind, pose in self.setup.fixed), *blocks]

    # ------------------------------------------------------------ what others fill in

    def where(self) -> np.ndarray:
        """float64[n]: joints the arm was told to be at [rad]."""
        raise NotImplementedError

    def in_hand(self, name: str) -> bool:
        """Whether a hand holds a block, where forces are simulated."""
        return False

    def changed(self, name: str) -> None:
        """A block came, went, or was moved by somebody else than the arm."""

    def come_to_rest(self) -> None:
        """Let everything come to rest by itself."""

    # ------------------------------------------------------------ what goes otherwise

    def _made(self, like: str, pose: np.ndarray) -> Thing:
        kind, there = self.chances.block(self.setup.kinds[like], pose, self.presented)
        thing = Thing(like, self.presented, kind, on_table(self.table, there))
        self.presented += 1
        return thing

    def drop_share(self) -> float | None:
        """Share of the next way across at which what is held is dropped; None: it is not."""
        if self.grasps not in self.chances.disturbance.drop:
            return None
        return float(self.chances.stream(DROPPED, self.grasps).uniform(0.2, 0.9))

    def taken(self) -> None:
        """The arm has taken hold of something."""
        self.grasps += 1
        self.push_due = self.grasps in self.chances.disturbance.push

    def push(self) -> None:
        """Somebody pushes a block that carries nothing, to where there is room."""
        self.push_due = False
        rng = self.chances.stream(PUSHED, self.grasps)
        bodies = {n: solids(one.kind.shape, one.pose) for n, one in sorted(self.things.items())}
        free = [n for n, one in sorted(self.things.items()) if one.handled and not self._carries(n)]
        for name in [free[int(k)] for k in rng.permutation(len(free))]:
            thing = self.things[name]
            for step in pushed(rng):
                there = thing.pose.copy()
                there[:3] += step
                mine = solids(thing.kind.shape, there)
                others = (body for n, body in bodies.items() if n != name)
                if not any(overlaps(mine, body, TOUCHES) for body in others):
                    thing.pose = there
                    self.changed(name)
                    self.come_to_rest()
                    return

    def _carries(self, name: str) -> bool:
        low, high = bounds(self.things[name])
        for other, thing in self.things.items():
            if other != name:
                bottom, top = bounds(thing)
                over = (bottom[:2] < high[:2]).all() and (top[:2] > low[:2]).all()
                if over and abs(bottom[2] - high[2]) < CARRIES:
                    return True
        return False

    # ------------------------------------------------------------ reports of the simulation

    def truth(self) -> dict[str, np.ndarray]:
        """float64[7]: where every block really is; for reports of a simulation only."""
        return {name: thing.pose.copy() for name, thing in self.things.items()}

    def shapes(self) -> dict[str, Shape]:
        """What every block really is; for reports of a simulation only."""
        return {name: thing.kind.shape for name, thing in self.things.items()}

    def state(self) -> dict[str, Any]:
        """All there is, so that a simulation can go on in another process."""
        return {
            "things": [
                [name, one.like, one.number, one.pose.tolist(), one.handled]
                for name, one in self.things.items()
            ],
            "presented": self.presented,
            "grasps": self.grasps,
            "home": sorted(self.home),
            "pictures": self.pictures.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """As it was."""
        self.things = {}
        for name, like, number, pose, handled in state["things"]:
            kind = self.chances.block(self.setup.kinds[like], np.array(pose), number)[0]
            self.things[name] = Thing(like, number, kind, np.array(pose), handled)
        self.presented, self.grasps = state["presented"], state["grasps"]
        self.home = {(lower, upper) for lower, upper in state["home"]}
        self.pictures.restore(state["pictures"])

    def _report(self, stop: Stop, detail: str) -> Report:
        return Report(stop, 1.0 if stop == Stop.END else 0.0, self.where(), PRESENTING, detail)


def bounds(thing: Thing) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest coordinates of a block, float64[3] each [m]."""
    return bounds_at(thing.kind.shape, thing.pose)


def bounds_at(shape: Shape, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same of a shape at a pose float64[7]."""
    points = body_of(shape).points @ quaternion_matrix(pose[3:]).T
    return pose[:3] + points.min(0), pose[:3] + points.max(0)


def nearest(things: dict[str, Thing], points: list[np.ndarray], within: float) -> str | None:
    """The block whose surface, or inside, is nearest to one of these points float64[3], if it is
    ``within`` [m] of it."""
    best, found, there = within, None, np.array(points)
    for name, thing in sorted(things.items()):
        local = (there - thing.pose[:3]) @ quaternion_matrix(thing.pose[3:])
        for part in thing.kind.shape:
            solid = part.solid
            beyond = (local - np.array(part.centre)) @ solid.normals.T - solid.offsets
            away = float(beyond.max(1).min())
            if away < best:
                best, found = away, name
    return found


def check_motion(arm: Arm, joints: np.ndarray, now: np.ndarray) -> None:
    """Refuse a motion that does not begin where the arm is, or leaves the joints' ranges.

    Raises:
        PlantError: for these.
    """
    if not len(joints):
        return
    if joints.shape[1] != len(arm.joints) or not np.isfinite(joints).all():
        raise PlantError(Stop.REFUSED, f"a motion that is not of {len(arm.joints)} joints")
    off = float(np.abs(joints[0] - now).max())
    if off > 1e-3:
        raise PlantError(Stop.REFUSED, f"a motion that begins {off:.3f} rad from where the arm is")
