"""One pick and place in the simulation, stage by stage; the first thing that goes wrong ends it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from learn2assemble.robot.approach import JointColumn, Plan
from learn2assemble.robot.mjcf import TIMESTEP
from learn2assemble.robot.motion import OPENING
from learn2assemble.robot.outcome import Outcome
from learn2assemble.robot.contacts import PUSH, TOUCH, Rules
from learn2assemble.robot.simulate import Event, Simulation, Watch
from learn2assemble.robot.trajectory import Leg, Limits, joint_path, pace_of
from learn2assemble.world.blocks import EDGE

LOOSE = 0.003
"""What is held may touch others while it is so near to where it stood or shall stand [m]."""
SOFT = 0.008
"""The last part of the way down is slow [m] ..."""
SOFT_SPEED = 0.04
"""... at this speed of the tool [m/s]."""
LANDED = 1.0
"""What rests presses so hard on others [N]: as much as a block weighs."""
GRIPPED = 0.8
"""The grasp holds when both fingers press with this share of their force."""
REST_TIME = 1.0
"""Longest time to wait for rest [s]."""
_EMPTY = Rules(TOUCH, PUSH, None)
_LOADED = Rules(TOUCH, None, TOUCH)
_FREE = Rules(TOUCH, None, None)
_BLIND = Rules(None)


@dataclass(frozen=True)
class Failure(Exception):
    """What broke a pick and place off."""

    outcome: Outcome
    stage: str
    detail: str


class Execution:
    """Carries out a plan in a simulation.

    Args:
        sim: at the beginning of the attempt.
        limits: of the joints while the hand is empty.
        loaded: of the joints while it holds something.
        skip_free: let time pass instead of simulating what the arm does far from everything.
    """

    def __init__(
        self, sim: Simulation, limits: Limits, loaded: Limits, skip_free: bool = False
    ) -> None:
        self.sim, self.limits, self.loaded, self.skip_free = sim, limits, loaded, skip_free
        self.released = False
        """Whether the object has been let go on purpose."""
        self.landed = False
        """Whether it rested on something before that."""

    def run(self, plan: Plan, ways: tuple[np.ndarray, np.ndarray, np.ndarray | None]) -> None:
        """The whole of it. ``ways``: joint positions float64[k, n] to the pick, across, and home.

        Raises:
            Failure: at the first thing that goes wrong; the arm has stopped.
        """
        there, across, home = ways
        self.settle("approach")
        self.travel(there, "approach")
        self.grasp(plan.pick)
        self.carry(across)
        self.lower(plan.place)
        self.release()
        self.retreat(plan.place)
        if home is not None:
            self.travel(home, "home")
        self.settle(self.sim.stage)

    def settle(self, stage: str) -> None:
        """Wait until every object rests."""
        self.sim.wait(round(REST_TIME / TIMESTEP), stage, Watch(_BLIND, until=self.sim.asleep))

    def travel(self, way: np.ndarray, stage: str) -> None:
        """Move the empty hand along straight lines of the joints."""
        outcome = Outcome.GRASP_COLLISION if stage == "approach" else Outcome.PLACE_COLLISION
        for start, end in zip(way[:-1], way[1:], strict=True):
            path = joint_path(np.array([start, end]), self.limits)
            pace = pace_of(path, self.limits)
            if self.skip_free:
                self.sim.skip(path, pace, stage)
                continue
            event = self.sim.follow(path, pace, stage, (Watch(_EMPTY),))
            _check(event, outcome, stage)

    def grasp(self, column: JointColumn) -> None:
        """Down, close, up."""
        sim, gripper = self.sim, self.sim.arm.gripper
        path = joint_path(column.joints[::-1], self.limits)
        event = sim.follow(path, pace_of(path, self.limits), "pick", (Watch(_EMPTY),))
        _check(event, Outcome.GRASP_COLLISION, "pick")
        pressing = EDGE - gripper.force / gripper.stiffness
        enough = GRIPPED * gripper.force
        event = sim.squeeze(_ramp(sim.width, pressing, gripper.speed), "pick", Watch(_FREE))
        _check(event, Outcome.GRASP_COLLISION, "pick")
        event = sim.wait(100, "pick", Watch(_FREE, until=lambda: self.grip() >= enough))
        if event is None:
            detail = f"the fingers press with {self.grip():.1f} N at {sim.opening:.3f} m"
            raise Failure(Outcome.GRASP_LOST, "pick", detail)
        _check(event, Outcome.GRASP_COLLISION, "pick")
        sim.hold()
        path = joint_path(column.joints, self.loaded)
        near = float(np.interp(LOOSE, column.rise, path.knots))
        watches = (Watch(_FREE), Watch(_LOADED, near))
        event = sim.follow(path, pace_of(path, self.loaded), "lift", watches)
        _check(event, Outcome.GRASP_COLLISION, "lift")

    def grip(self) -> float:
        """What the weaker finger presses with [N]."""
        return self.sim.contacts.grip(self.sim.arm.gripper.pads)

    def carry(self, way: np.ndarray) -> None:
        """Across, along straight lines of the joints."""
        for start, end in zip(way[:-1], way[1:], strict=True):
            path = joint_path(np.array([start, end]), self.loaded)
            pace = pace_of(path, self.loaded)
            event = self.sim.follow(path, pace, "cross", (Watch(_LOADED),))
            _check(event, Outcome.PLACE_COLLISION, "cross")

    def lower(self, column: JointColumn) -> None:
        """Down, the last part slowly, until the object rests or the column ends."""
        sim = self.sim
        path = joint_path(column.joints[::-1], self.loaded)
        pace = pace_of(path, self.loaded)
        rise = column.rise[::-1]
        soft, near = np.interp([-SOFT, -LOOSE], -rise, path.knots)
        slope = (path.length - soft) / (SOFT - rise[-1])
        legs = (
            Leg(soft, min(pace.speed, SOFT_SPEED * slope)),
            Leg(path.length, 0.0, SOFT_SPEED * slope),
        )
        watches = (
            Watch(_LOADED),
            Watch(_FREE, near, lambda: sim.contacts.support() >= LANDED),
        )
        event = sim.follow(path, pace, "place", watches, legs)
        self.landed = event is not None and event.what == "until"
        _check(event, Outcome.PLACE_COLLISION, "place")

    def release(self) -> None:
        """Open no further than needed."""
        sim, gripper = self.sim, self.sim.arm.gripper
        sim.let_go()
        self.released = True
        event = sim.squeeze(_ramp(sim.width, OPENING, gripper.speed), "release", Watch(_FREE))
        _check(event, Outcome.PLACE_COLLISION, "release")
        event = sim.wait(10, "release", Watch(_FREE))
        _check(event, Outcome.PLACE_COLLISION, "release")

    def retreat(self, column: JointColumn) -> None:
        """Up again from wherever the hand is in the column."""
        sim = self.sim
        now = int(np.argmin(np.abs(column.joints - sim.joints).max(1)))
        above = np.vstack([sim.joints, column.joints[now + 1 :]])
        path = joint_path(above, self.limits)
        event = sim.follow(path, pace_of(path, self.limits), "retreat", (Watch(_FREE),))
        _check(event, Outcome.PLACE_COLLISION, "retreat")


def _check(event: Event | None, outcome: Outcome, stage: str) -> None:
    if event is not None and event.what != "until":
        lost = event.what == "lost"
        raise Failure(Outcome.GRASP_LOST if lost else outcome, stage, event.detail)


def _ramp(start: float, end: float, speed: float) -> np.ndarray:
    """Openings [m], one per step, from one to another at a speed [m/s]."""
    count = max(1, int(np.ceil(abs(end - start) / (speed * TIMESTEP))))
    return start + (end - start) * np.arange(1, count + 1) / count
