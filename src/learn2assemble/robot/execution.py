"""One pick and place in the simulation, stage by stage; the first thing that goes wrong ends it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from learn2assemble.robot.approach import JointColumn, joint_column
from learn2assemble.robot.contacts import PUSH, TOUCH, Event, Rules, Watch
from learn2assemble.robot.mjcf import TIMESTEP
from learn2assemble.robot.motion import OPENING
from learn2assemble.robot.order import Order
from learn2assemble.robot.outcome import Outcome
from learn2assemble.robot.prepare import PRESS, Course, Failure
from learn2assemble.robot.simulate import Simulation
from learn2assemble.robot.slowing import slowing
from learn2assemble.robot.trajectory import Limits, joint_path, pace_of
from learn2assemble.world.blocks import EDGE

LOOSE = 0.005
"""What is held may touch others while it is so near to where it stood or shall stand [m]."""
CAREFUL = 0.06
"""So near to the contact the hand comes down slower [m] ..."""
CAREFUL_SPEED = 0.2
"""... at most at this speed of the tool [m/s] ..."""
SOFT = 0.01
"""... and what it holds is lowered the last bit [m] ..."""
SOFT_SPEED = 0.02
"""... at this speed of the tool [m/s]."""
LANDED = 1.0
"""What rests presses so hard on others [N]: as much as a block weighs."""
GRIPPED = 0.8
"""The grasp holds when both fingers press with this share of their force ..."""
GRIP_TIME = 0.2
"""... within this time after they were told to [s]."""
LOAD_TIME = 0.1
"""In which the controller learns of what the hand holds, and forgets it again [s]: at once, the
arm would jump."""
REST_TIME = 1.0
"""Longest time to wait for rest [s]."""
EMPTY = Watch(Rules(TOUCH, PUSH, None))
LOADED = Watch(Rules(TOUCH, None, TOUCH))
NEAR = Watch(Rules(TOUCH, None, None))
BLIND = Watch(Rules(None, None, None))
"""What is looked for with an empty hand, a loaded one, near the contact, and after a failure."""


class Execution:
    """Carries out a course in a simulation.

    Args:
        sim: at the beginning of the attempt.
        order: what is asked.
        course: how.
        limits: of the joints while the hand is empty.
        loaded: of the joints while it holds something.
    """

    correct = True
    """Look where the object sits in the hand before lowering it."""
    skip_free = False
    """Let time pass instead of simulating what the arm does far from everything."""

    def __init__(
        self, sim: Simulation, order: Order, course: Course, limits: Limits, loaded: Limits
    ) -> None:
        self.sim, self.order, self.course = sim, order, course
        self.limits, self.loaded = limits, loaded
        self.place = course.plan.place
        """The column over the target that is used."""
        self.inside: JointColumn | None = None
        """The column the hand is in; None where it travels."""
        self.legs = 0
        """How many straight parts of the way across are done."""
        self.holding = False
        """Whether the object is in the hand."""
        self.landed = False
        """Whether it rested on something before the hand let go of it."""

    def go(self) -> None:
        """The whole of it.

        Raises:
            Failure: at the first thing that goes wrong; the arm has stopped.
        """
        course, sim = self.course, self.sim
        self.settle("approach")
        self.travel(course.there, "approach")
        self.grasp(course.plan.pick)
        self.carry(course.across)
        if self.correct:
            self.place = self.corrected()
        self.lower(self.place, "place", LOADED, NEAR)
        self.release("release", NEAR)
        self.rise("retreat", NEAR)
        if course.home is not None:
            self.travel(np.vstack([sim.joints, course.home[1:]]), "home")
        self.settle(sim.stage)

    def settle(self, stage: str) -> None:
        """Wait until every object rests."""
        self.sim.wait(_steps(REST_TIME), stage, BLIND._replace(until=self.sim.asleep))

    def travel(self, way: np.ndarray, stage: str, watch: Watch = EMPTY) -> None:
        """Move the empty hand along straight lines of the joints."""
        self.inside = None
        outcome = Outcome.GRASP_COLLISION if stage == "approach" else Outcome.PLACE_COLLISION
        for start, end in pairwise(way):
            path = joint_path(np.array([start, end]), self.limits)
            pace = pace_of(path, self.limits)
            if self.skip_free:
                self.sim.skip(path, pace, stage)
            else:
                _check(self.sim.follow(path, pace, stage, (watch,)), outcome, stage)

    def grasp(self, column: JointColumn) -> None:
        """Down, close, up."""
        sim, gripper = self.sim, self.sim.arm.gripper
        touch, self.inside = Outcome.GRASP_COLLISION, column
        above = column.rise >= 0
        joints, rise = column.joints[above], column.rise[above]
        path = joint_path(joints[::-1], self.limits)
        pace = pace_of(path, self.limits)
        legs = slowing(path, rise[::-1], ((CAREFUL, CAREFUL_SPEED),), pace)
        _check(sim.follow(path, pace, "pick", (EMPTY,), legs), touch, "pick")
        pressing = EDGE - gripper.force / gripper.stiffness
        enough = GRIPPED * gripper.force
        _check(sim.squeeze(_ramp(sim.width, pressing, gripper.speed), "pick", NEAR), touch, "pick")
        watch = NEAR._replace(until=lambda: self.grip() >= enough)
        event = sim.wait(_steps(GRIP_TIME), "pick", watch)
        if event is None:
            detail = f"the fingers press with {self.grip():.1f} N at {1e3 * sim.opening:.0f} mm"
            raise Failure(Outcome.GRASP_LOST, "pick", detail)
        _check(event, touch, "pick")
        sim.hold()
        self.holding = True
        mass = sim.mass(self.order.target)
        _check(sim.load(mass, _steps(LOAD_TIME), "pick", NEAR), touch, "pick")
        path = joint_path(joints, self.loaded)
        off = float(np.interp(LOOSE, rise, path.knots))
        watches = (NEAR, LOADED._replace(start=off))
        _check(sim.follow(path, pace_of(path, self.loaded), "lift", watches), touch, "lift")

    def grip(self) -> float:
        """What the weaker finger presses with [N]."""
        return self.sim.contacts.grip(self.sim.arm.gripper.pads)

    def carry(self, way: np.ndarray, watch: Watch = LOADED) -> None:
        """Across, along straight lines of the joints."""
        self.inside = None
        for start, end in pairwise(way):
            path = joint_path(np.array([start, end]), self.loaded)
            event = self.sim.follow(path, pace_of(path, self.loaded), "cross", (watch,))
            _check(event, Outcome.PLACE_COLLISION, "cross")
            self.legs += 1

    def corrected(self) -> JointColumn:
        """The column over the target for the hand that holds the object as it does."""
        sim, plan, order = self.sim, self.course.plan, self.order
        position, rotation = sim.tool()
        cell = order.objects.cells(sim.poses)[0][order.move.cell]
        place, target = plan.move.place, order.move.target
        tool = target - place.rotation() @ rotation.T @ (cell - position)
        centre = tool + target - place.tool_point(target)
        found = joint_column(sim.arm, centre, place, plan.height, PRESS, plan.place.joints[0])
        if isinstance(found, str):
            raise Failure(Outcome.UNREACHABLE, "place", found)
        return found

    def lower(self, column: JointColumn, stage: str, before: Watch, near: Watch) -> None:
        """Down, the last part slowly, until the object rests or the column ends.

        Args:
            column: over the place, from below it.
            stage: for the recording.
            before: what is looked for on the way ...
            near: ... and within :data:`LOOSE` of the place.
        """
        sim, self.inside = self.sim, column
        now = _nearest(column, sim.joints)
        path = joint_path(np.vstack([sim.joints, column.joints[:now][::-1]]), self.loaded)
        pace = pace_of(path, self.loaded)
        rise = column.rise[: now + 1][::-1]
        legs = slowing(path, rise, ((CAREFUL, CAREFUL_SPEED), (SOFT, SOFT_SPEED)), pace)
        loose = float(np.interp(-LOOSE, -rise, path.knots))
        until = near._replace(start=loose, until=lambda: sim.contacts.support() >= LANDED)
        event = sim.follow(path, pace, stage, (before, until), legs)
        self.landed = event is not None and event.what == "until"
        _check(event, Outcome.PLACE_COLLISION, stage)

    def release(self, stage: str, watch: Watch) -> None:
        """Open no further than needed."""
        sim = self.sim
        _check(sim.load(0.0, _steps(LOAD_TIME), stage, watch), Outcome.PLACE_COLLISION, stage)
        sim.let_go()
        self.holding = False
        widths = _ramp(sim.width, OPENING, sim.arm.gripper.speed)
        _check(sim.squeeze(widths, stage, watch), Outcome.PLACE_COLLISION, stage)

    def rise(self, stage: str, watch: Watch) -> None:
        """Up from wherever the hand is in a column; it may travel then."""
        column = self.inside
        if column is None:
            return
        sim, limits = self.sim, self.loaded if self.holding else self.limits
        above = column.joints[_nearest(column, sim.joints) + 1 :]
        path = joint_path(np.vstack([sim.joints, above]), limits)
        event = sim.follow(path, pace_of(path, limits), stage, (watch,))
        _check(event, Outcome.PLACE_COLLISION, stage)
        self.inside = None


def _check(event: Event | None, outcome: Outcome, stage: str) -> None:
    if event is not None and event.what != "until":
        lost = event.what == "lost"
        raise Failure(Outcome.GRASP_LOST if lost else outcome, stage, event.detail)


def _nearest(column: JointColumn, joints: np.ndarray) -> int:
    return int(np.argmin(np.abs(column.joints - joints).max(1)))


def _steps(time: float) -> int:
    return round(time / TIMESTEP)


def _ramp(start: float, end: float, speed: float) -> np.ndarray:
    """Openings [m], one per step, from one to another at a speed [m/s]."""
    count = max(1, int(np.ceil(abs(end - start) / (speed * TIMESTEP))))
    return start + (end - start) * np.arange(1, count + 1) / count
