"""What every run does with a robot, whether it is alone or one of two: it is checked before
anything moves, and it is told how it was driven.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from learn2assemble.acting.building import Building
from learn2assemble.cell.world import MISSING
from learn2assemble.plants.plant import (
    Commands,
    Guards,
    Motion,
    Plant,
    PlantError,
    Readings,
    Report,
    Request,
    Stop,
    ToolCommand,
    WrappedPlant,
    standing,
)
from learn2assemble.plants.setup import Setup
from learn2assemble.values import rounded

IN_HAND = "hand"
"""Name of a block nobody knows, which is in the hand when a run begins; of two arms with ``of``
and the name of its arm behind it."""
AT_HOME = 0.05
"""No joint may be farther from where a build begins [rad]."""


class Link(NamedTuple):
    """How a controller was driven."""

    motions: int = 0
    """That were sent."""
    moving: float = 0.0
    """What they were to take together [s of the plant's clock]."""
    overhead: float = 0.0
    """What a motion took longer than that, on average [s of the plant's clock]."""
    latency: float = 0.0
    """Until the plant said what it senses, on average [s of this machine]."""
    rate: float | None = None
    """New states in a second, where the plant tells."""


class Timed(WrappedPlant):
    """A plant, and how long it takes.

    Args:
        plant: the one behind it.
    """

    def __init__(self, plant: Plant) -> None:
        super().__init__(plant)
        self.motions: int = 0
        """That were carried out to their ends; where an arm only stands, there is none."""
        self.moving: float = 0.0
        """What these were to take, at the speed that was asked for [s], ..."""
        self.took: float = 0.0
        """... and what they took [s of the plant's clock]."""
        self.looks: int = 0
        """How often it was asked what it senses."""
        self.waited: float = 0.0
        """For the answers [s of this machine]."""
        self.last: float = -1.0
        """When it sensed last [s of the plant's clock]."""

    def sense(self) -> Readings:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        begun = time.perf_counter()
        found = self.plant.sense()
        self.waited, self.looks = self.waited + time.perf_counter() - begun, self.looks + 1
        self.last = found.time
        return found

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        report = self.plant.execute(motion, commands, guards)
        stands = not commands and not np.ptp(motion.joints, 0).any()
        if report.stop is Stop.END and motion.seconds and not stands:
            self.motions += 1
            self.moving += motion.seconds
            self.took += report.seconds
        return report

    def link(self, plant: Plant) -> Link:
        """The figures; the plant may know more."""
        count, rate = max(self.motions, 1), getattr(plant, "rate", None)
        return Link(
            self.motions,
            round(self.moving, 2),
            round((self.took - self.moving) / count, 4),
            round(self.waited / max(self.looks, 1), 5),
            None if rate is None else rate(),
        )


def check_robot(plant: Plant, setup: Setup, resumed: bool, name: str = "") -> None:
    """Whether this is the robot of the plan, and may begin.

    Args:
        resumed: it may stand anywhere, as an interruption has left it.
        name: of the arm, where it is not the only one.

    Raises:
        PlantError: where it is not.
    """
    arm, now = setup.arm, plant.sense()
    if now.arm != arm.name or now.joints.shape != arm.home.shape:
        got = f"{now.arm!r} with {len(now.joints)} joints"
        raise PlantError(Stop.REFUSED, f"the robot is {got}, the plan is for {arm.name}")
    if now.state == "stopped":
        raise PlantError(Stop.PROTECTIVE, "the robot is stopped; clear that first")
    if now.state == "moving":
        raise PlantError(Stop.REFUSED, "the robot is moving already")
    if not arm.inside_limits(now.joints):
        raise PlantError(Stop.REFUSED, f"joints {_list(now.joints)} are beyond their limits")
    off = np.abs(now.joints - arm.home)
    if not resumed and off.max() > AT_HOME:
        worst = int(off.argmax())
        why = f"the arm is not at home: {arm.joints[worst]} is {off[worst]:.2f} rad away"
        raise PlantError(Stop.REFUSED, f"{why}; home is {_list(arm.home)}")
    if now.tool.vacuum or (now.tool.grip or 0.0) > 0:
        _empty_hand(plant, setup, now, f"{IN_HAND} of {name}" if name else IN_HAND)


def _empty_hand(plant: Plant, setup: Setup, now: Readings, hand: str) -> None:
    """What an interruption has left in the hand is taken out of it by a person, where it stands."""
    why = "the hand holds something: take it out, and run again"
    if setup.around.serve is None:
        raise PlantError(Stop.REFUSED, why)
    plant.request(Request("remove", hand, hand, np.array([0.0, 0, 0, 1, 0, 0, 0])))
    told = ToolCommand(vacuum=False)
    if setup.arm.suction is None:
        told = ToolCommand(width=setup.arm.gripper.max_width, speed=setup.arm.gripper.speed)
    plant.execute(standing("release", now.joints, 0.5), (told,))
    tool = plant.sense().tool
    if tool.vacuum or (tool.grip or 0.0) > 0:
        raise PlantError(Stop.REFUSED, why)


def take_away(plant: Plant, setup: Setup, building: Building) -> None:
    """Where nothing sees blocks, a person takes away those that an interruption has left anywhere,
    perhaps in their places.

    Raises:
        PlantError: where there is nobody who could.
    """
    world = building.world
    missing = [k for k, state in enumerate(world.state) if state == MISSING]
    if missing and setup.around.serve is None:
        names = ", ".join(world.names[k] for k in missing)
        raise PlantError(Stop.REFUSED, f"nobody can say where {names} is; take it away")
    for k in missing:
        plant.request(Request("remove", world.names[k], world.pieces[k].id, world.target(k)))


def _list(joints: np.ndarray) -> str:
    return f"[{', '.join(f'{rounded(value, 3):.3f}' for value in joints)}]"
