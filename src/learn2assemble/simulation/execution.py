"""One pick and place in the simulation, stage by stage; the first thing that goes wrong ends it.

After a failure the arm leaves, and what it holds goes back; after success the scene is compared
with what was ordered.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from learn2assemble.motion.program import LOAD_TIME
from learn2assemble.robot.approach import ApproachPath, approach_path, tool_path
from learn2assemble.robot.arm import Limits
from learn2assemble.robot.grasps import facing
from learn2assemble.robot.joint_path import JointPath, joint_path
from learn2assemble.robot.kinematics import get_chain
from learn2assemble.robot.moves import Outcome, carried
from learn2assemble.robot.scene import rotation_matrix
from learn2assemble.simulation.cup import Vacuum, hanging, peak_load
from learn2assemble.simulation.model import TIMESTEP, Failure, Order
from learn2assemble.simulation.prepare import (
    Course,
    WorldChecker,
    free_way,
    leaving,
    rest_pose,
)
from learn2assemble.simulation.simulation import (
    BLOCK,
    PUSH,
    TOUCH,
    Rules,
    Simulation,
    Watch,
)
from learn2assemble.simulation.trajectory import (
    PathLimits,
    Segment,
    approach_speed_limits,
    limits_along,
    motion,
    reachable_speed,
)

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
GENTLE, MOST_SLOWER = 0.7, 6
"""What hangs from a cup is moved so that it loads it with no more than this share of what it holds;
how often it is slowed down for that, if need be."""
RAMP_TIME = 0.04
"""In which what hangs from a cup is brought to its full acceleration [s]; faster, the arm swings
with it and doubles its load."""
PERIOD = 0.01
"""Between the instants at which that load is computed [s]."""
PRESS_NEAR, PRESS_SPEED = 0.001, 0.005
"""From so near to the contact [m] it is pressed on studs so slowly [m/s]."""
BORNE, BORNE_RATE = 0.9, 0.2
"""Share of a press that the controller bears, and how quickly it follows the sensor, each step."""
EASES, EASED = 12, 0.4
"""After a press: how often the drives are told where they are, and on which share of the way."""
SLOT_SPEED = 0.1
"""So slowly it goes into a slot between others, and out of it [m/s]: faster, it strays by more than
the joints leave."""
LANDED = 1.0
"""What rests presses so hard on others [N]: as much as a block weighs."""
GRIPPED = 0.8
"""The grasp holds when both fingers press with this share of their force ..."""
GRIP_TIME = 0.2
"""... within this time after they were told to [s]."""
CALM_TIME = 0.1
"""The hand stands still so long before it is looked where a box of given size sits in it [s]."""
REST_TIME = 1.0
"""Longest time to wait for rest [s]."""
EMPTY = Watch(Rules(TOUCH, PUSH, None))
LOADED = Watch(Rules(TOUCH, None, TOUCH))
NEAR = Watch(Rules(TOUCH, None, None))
BESIDE = Watch(Rules(TOUCH, None, PUSH))
BLIND = Watch(Rules(None, None, None))
"""What is looked for with an empty hand, a loaded one, near the contact, where what is held slides
along others, and after a failure."""


class Execution:
    """Carries out a course in a simulation.

    Args:
        sim: at the beginning of the attempt.
        order: what is asked.
        course: how.
        limits: of the joints while the hand is empty.
        loaded: of the joints while it holds something.
        skip_free: let time pass instead of simulating what the arm does far from everything.
    """

    def __init__(
        self,
        sim: Simulation,
        order: Order,
        course: Course,
        limits: Limits,
        loaded: Limits,
        skip_free: bool = False,
    ) -> None:
        self.sim, self.order, self.course = sim, order, course
        self.limits, self.loaded, self.skip_free = limits, loaded, skip_free
        self.inside: ApproachPath | None = None
        """The approach path the hand is on; None where it travels."""
        self.segments_done = 0
        """How many straight parts of the way across are done."""
        self.holding = False
        """Whether the object is in the hand."""
        self.landed = False
        """Whether it rested on something before the hand let go of it."""
        self.pressed = 0.0
        """The largest force with which it was pressed on studs [N]."""

    def go(self) -> None:
        """The whole of it.

        Raises:
            Failure: at the first thing that goes wrong; the arm has stopped.
        """
        course, sim = self.course, self.sim
        self.settle("approach")
        self.travel(course.there, "approach")
        self.grasp(course.plan.pick)
        self.carry(self.checked(course.across, "cross"))
        if self.order.scene.half is not None:
            # What is seen shall be where it sits, not how it swings.
            sim.wait(_steps(CALM_TIME), "cross", LOADED)
        place, leave = self.corrected()
        self.lower(place, "place", LOADED, NEAR)
        self.ease(NEAR)
        self.release("release", NEAR)
        self.inside = leave
        self.rise("retreat", NEAR)
        self.travel(self.checked(course.home, "home"), "home")
        self.settle(sim.stage)

    def checked(self, way: np.ndarray, stage: str) -> np.ndarray:
        """A planned way from where the arm is; another one where things are not as planned and
        something is in the way now."""
        sim = self.sim
        checker = WorldChecker(sim.arm, sim.world, sim.poses.copy(), self.order.names)
        if self.holding:
            position, rotation = sim.tool()
            pose = sim.poses[sim.target]
            turned = rotation.T @ rotation_matrix(pose[3:])
            checker.carry(sim.target, rotation.T @ (pose[:3] - position), turned, self.order.held)
        else:
            checker.empty(self.order.opening)
        planned = np.vstack([sim.joints, way[1:]])
        if all(checker.blocked(start, end) is None for start, end in pairwise(planned)):
            return planned
        return free_way(checker, sim.joints, way[-1], stage)

    def settle(self, stage: str) -> None:
        """Wait until every object rests."""
        self.sim.wait(_steps(REST_TIME), stage, BLIND._replace(until=self.sim.asleep))

    def travel(self, way: np.ndarray, stage: str, watch: Watch = EMPTY) -> None:
        """Move the empty hand along straight lines of the joints."""
        self.inside = None
        for start, end in pairwise(way):
            path = joint_path(np.array([start, end]), self.limits)
            bounds = limits_along(path, self.limits)
            if self.skip_free:
                self.sim.skip(path, bounds, stage)
            else:
                self.sim.follow(path, bounds, stage, (watch,))

    def grasp(self, approach: ApproachPath) -> None:
        """Down, take hold, up."""
        sim, self.inside = self.sim, approach
        above = approach.rise > -1e-9  # The contact itself, whatever rounding made of it.
        joints, rise = approach.joints[above], approach.rise[above]
        path = joint_path(joints[::-1], self.limits)
        bounds = limits_along(path, self.limits)
        segments = approach_speed_limits(path, rise[::-1], ((CAREFUL, CAREFUL_SPEED),), bounds)
        sim.follow(path, bounds, "pick", (EMPTY,), segments)
        if sim.cup is not None:
            self.suck(sim.cup)
        else:
            self.close()
        sim.hold()
        self.holding = True
        grasp, mass = self.course.plan.move.grasp, sim.mass(self.order.target)
        if grasp.sideways:
            out = int(np.searchsorted(rise, grasp.way - 1e-9)) + 1
            self.draw(joints[:out], grasp.way)
            joints, rise = joints[out - 1 :], rise[out - 1 :] - grasp.way
        sim.load(mass, _steps(LOAD_TIME), "pick", NEAR)
        path, bounds = self.gently(joints)
        off = float(np.interp(LOOSE, rise, path.knots))
        watches, segments = (NEAR, LOADED._replace(start=off)), ()
        if self.order.scene.half is not None and not grasp.sideways:
            # Beside others it slides out of a slot.
            out = float(np.interp(self.slot(), rise, path.knots))
            watches = (NEAR, BESIDE._replace(start=off), LOADED._replace(start=out))
            slowly = min(SLOT_SPEED * out / self.slot(), bounds.speed)
            # It comes to rest at the end of the way, however near the end of the slot is to that.
            speed = min(
                slowly, *(reachable_speed(0.0, s, bounds) for s in (out, path.length - out))
            )
            segments = (Segment(out, speed, slowly), Segment(path.length, 0.0, bounds.speed))
        sim.follow(path, bounds, "lift", watches, segments)

    def draw(self, joints: np.ndarray, way: float) -> None:
        """Draw what is held out to the side from between others, along joints float64[k, n] [rad],
        over ``way`` [m]. What it lies on carries it, so the controller is not told of its mass yet:
        it would lift it against what is above."""
        path, bounds = self.gently(joints)
        slowly = (Segment(path.length, 0.0, min(SLOT_SPEED * path.length / way, bounds.speed)),)
        self.sim.follow(path, bounds, "lift", (NEAR,), slowly)

    def close(self) -> None:
        """Close the fingers until they press."""
        sim, gripper = self.sim, self.sim.arm.gripper
        pressing = self.order.held - gripper.force / gripper.stiffness
        enough = GRIPPED * gripper.force
        sim.squeeze(_ramp(sim.width, pressing, gripper.speed), "pick", NEAR)
        watch = NEAR._replace(until=lambda: self.grip() >= enough)
        if not sim.wait(_steps(GRIP_TIME), "pick", watch):
            detail = f"the fingers press with {self.grip():.1f} N at {1e3 * sim.opening:.0f} mm"
            raise Failure(Outcome.GRASP_LOST, "pick", detail)

    def suck(self, cup: Vacuum) -> None:
        """Turn the vacuum on, and wait until it holds."""
        sim, target = self.sim, self.order.target
        name = self.order.names[target]
        watch = NEAR._replace(until=lambda: cup.held is not None)
        count = _steps(cup.suction.grip_time + GRIP_TIME)
        if not sim.squeeze(np.ones(count), "pick", watch):
            raise Failure(Outcome.GRASP_LOST, "pick", f"the cup does not close on {name}")
        if cup.held != target:
            other = self.order.names[cup.held or 0]
            raise Failure(Outcome.GRASP_LOST, "pick", f"the cup closes on {other}, not on {name}")

    def slot(self) -> float:
        """Height of the object, which it may slide along others [m], where it was or shall be."""
        scene, move = self.order.scene, self.order.move
        members = scene.members(move.cell)
        there, turns = carried(scene, move, members)
        goal = scene.rows(members, 0)._replace(position=there, quaternion=turns)
        heights = []
        for low, high in (scene.rows(members, 0).bounds(), goal.bounds()):
            heights.append(float(high[:, 2].max() - low[:, 2].min()))
        return max(heights) + LOOSE

    def grip(self) -> float:
        """What the weaker finger presses with [N]."""
        return self.sim.contacts.grip(self.sim.arm.gripper.pads)

    def gently(self, joints: np.ndarray) -> tuple[JointPath, PathLimits]:
        """A path of the loaded hand through joint positions float64[k, n] [rad], and how fast: as
        fast as the limits allow, with a cup slower where what hangs from it would load it by more
        than :data:`GENTLE`."""
        sim, limits = self.sim, self.loaded
        if sim.cup is None or sim.cup.held is None:
            path = joint_path(joints, limits)
            return path, limits_along(path, limits)
        limits = limits._replace(jerk=np.minimum(limits.jerk, limits.acceleration / RAMP_TIME))
        path = joint_path(joints, limits)
        bounds = limits_along(path, limits)
        load = hanging(sim.world, sim.data, sim.cup.held)
        chain = get_chain(sim.arm)
        for _ in range(MOST_SLOWER):
            run = motion(path, bounds, PERIOD)
            peak = max(peak_load(sim.cup.used, chain, load, run.position, PERIOD))
            if peak <= GENTLE:
                break
            limits = limits.scaled(max(0.9 * math.sqrt(GENTLE / peak), 0.5))
            path = joint_path(joints, limits)
            bounds = limits_along(path, limits)
        return path, bounds

    def carry(self, way: np.ndarray, watch: Watch = LOADED) -> None:
        """Across, along straight lines of the joints."""
        self.inside = None
        for start, end in pairwise(way):
            path, bounds = self.gently(np.array([start, end]))
            self.sim.follow(path, bounds, "cross", (watch,))
            self.segments_done += 1

    def corrected(self) -> tuple[ApproachPath, ApproachPath]:
        """The approach path over the target for the hand that holds the object as it does, and
        the one by which the hand leaves."""
        sim, plan, order = self.sim, self.course.plan, self.order
        position, rotation = sim.tool()
        cell = order.objects.cells(sim.poses)[0][order.move.cell]
        place, target = plan.move.place, order.move.target
        if sim.cup is not None:
            # Turned by as much as the object is turned in the hand; pads straighten what they hold.
            now = rotation.T @ rotation_matrix(sim.poses[sim.target, 3:])
            if place.tilt:
                # The weight of what hangs aside leans it, too.
                goal = order.in_world(plan.move.grasp, place)[1]
                straight = facing(goal @ now.T)
                place = place._replace(yaw=straight.yaw, tilt=straight.tilt, spin=straight.spin)
            else:
                off = now @ order.in_hand(plan.move.grasp)[1].T
                place = place.spun(math.atan2(off[1, 0] - off[0, 1], off[0, 0] + off[1, 1]))
        tool = target - place.rotation() @ rotation.T @ (cell - position)
        centre = tool + target - place.tool_point(target)
        poses = tool_path(centre, place, plan.height, upwards=True)
        found = approach_path(sim.arm, poses, self.order.below, plan.place.joints[0])
        if isinstance(found, str):
            raise Failure(Outcome.UNREACHABLE, "place", found)
        leave = leaving(sim.arm, centre, place, plan.height, found)
        if isinstance(leave, str):
            raise Failure(Outcome.UNREACHABLE, "place", leave)
        return found, leave

    def lower(self, approach: ApproachPath, stage: str, before: Watch, near: Watch) -> None:
        """Down, the last part slowly, until the object rests or the path ends.

        Args:
            approach: over the place, from below it.
            stage: for the recording.
            before: what is looked for on the way ...
            near: ... and within :data:`LOOSE` of the place.
        """
        sim, self.inside = self.sim, approach
        now = _nearest(approach, sim.joints)
        path, bounds = self.gently(np.vstack([sim.joints, approach.joints[:now][::-1]]))
        rise = approach.rise[: now + 1][::-1]
        zones = [(CAREFUL, CAREFUL_SPEED), (SOFT, SOFT_SPEED)]
        if self.order.scene.half is not None:
            zones = sorted([*zones, (min(self.slot() + SOFT, rise[0]), SLOT_SPEED)], reverse=True)
        if sim.clutch is not None and sim.clutch.wanted:
            zones.append((PRESS_NEAR, PRESS_SPEED))
        segments = approach_speed_limits(path, rise, tuple(zones), bounds)
        loose = float(np.interp(-LOOSE, -rise, path.knots))
        until = near._replace(start=loose, until=self.rests)
        watches = (before, until)
        if self.order.scene.half is not None and before is LOADED:
            # Between others it slides into a slot.
            begin = float(np.interp(-self.slot(), -rise, path.knots))
            watches = (before, BESIDE._replace(start=begin), until)
        self.landed = False
        self.landed = sim.follow(path, bounds, stage, watches, segments)

    def rests(self) -> bool:
        """Whether what is held rests on something; where it has studs to meet, once it has been
        pressed with the force that brings it home."""
        clutch, force = self.sim.clutch, self.sim.contacts.support()
        if clutch is None or not clutch.wanted:
            return force >= LANDED
        self.pressed = max(self.pressed, force)
        self.bear(force)
        if force < clutch.press:
            return False
        clutch.join()
        return True

    def bear(self, force: float) -> None:
        """The controller bears most of what the hand pushes with [N], so that the arm hardly gives
        way: it would turn what it holds."""
        drives = self.sim.drives
        drives.push += BORNE_RATE * (BORNE * max(force, 0.0) - drives.push)

    def ease(self, watch: Watch) -> None:
        """After a press, stay where the arm is: step by step its drives are told the joints that
        they have, until the hand pushes and turns what it holds no more."""
        sim, clutch = self.sim, self.sim.clutch
        if clutch is None or clutch.loose or not clutch.wanted:
            return
        for _ in range(EASES):
            there = sim.data.qpos[sim.world.joint].copy()
            sim.drives.push *= 1 - EASED
            sim.stay(sim.joints + EASED * (there - sim.joints), BLOCK, "place", watch)
        sim.drives.push = 0.0

    def check_home(self) -> None:
        """Refuse a brick that is not home at the end.

        Raises:
            Failure: TOPPLED.
        """
        clutch = self.sim.clutch
        if clutch is not None and clutch.loose:
            name = self.order.names[self.order.target]
            words = f"pressed with {self.pressed:.1f} N of {clutch.press:g} N"
            raise Failure(Outcome.TOPPLED, "rest", f"{name} is loose on its studs, {words}")

    def release(self, stage: str, watch: Watch) -> None:
        """Open no further than needed; with a cup, turn the vacuum off and wait."""
        sim = self.sim
        sim.load(0.0, _steps(LOAD_TIME), stage, watch)
        sim.let_go()
        self.holding = False
        if sim.cup is not None:
            widths = np.zeros(_steps(sim.cup.suction.release_time) + 1)
        else:
            widths = _ramp(sim.width, self.order.opening, sim.arm.gripper.speed)
        if sim.clutch is not None:
            sim.clutch.take()
        sim.squeeze(widths, stage, watch)
        if sim.clutch is not None:
            sim.clutch.draw()

    def rise(self, stage: str, watch: Watch) -> None:
        """Up from wherever the hand is on an approach path; it may travel then."""
        approach = self.inside
        if approach is None:
            return
        sim, limits = self.sim, self.loaded if self.holding else self.limits
        above = approach.joints[_nearest(approach, sim.joints) + 1 :]
        path = joint_path(np.vstack([sim.joints, above]), limits)
        sim.follow(path, limits_along(path, limits), stage, (watch,))
        self.inside = None


def _nearest(approach: ApproachPath, joints: np.ndarray) -> int:
    return int(np.argmin(np.abs(approach.joints - joints).max(1)))


def _steps(time: float) -> int:
    return round(time / TIMESTEP)


def _ramp(start: float, end: float, speed: float) -> np.ndarray:
    """Openings [m], one per step, from one to another at a speed [m/s]."""
    count = max(1, int(np.ceil(abs(end - start) / (speed * TIMESTEP))))
    return start + (end - start) * np.arange(1, count + 1) / count


BACK_STRIDE = 25
"""Samples between the corners of a way back."""
HOLDS = 0.5
"""Both fingers press what is in the hand with this much at least [N]: half a block's weight."""


def abandon(run: Execution, failure: Failure, recover: bool) -> Failure:
    """End an attempt that failed; every object comes to rest.

    Args:
        run: the attempt; its arm has stopped.
        failure: why.
        recover: put what is held back and bring the arm home; else it stays where it is.

    Returns:
        the failure, with a word on what became of what was held.
    """
    sim = run.sim
    sim.let_go()
    _settle(run)
    words = ""
    if recover and failure.stage != "rest":
        words = "the arm is home"
        try:
            if run.holding:
                sim.hold()
                _put_back(run)
                words = "put back"
            _leave(run)
        except Failure as second:
            words = f"then {second.stage}: {second.detail}"
            sim.let_go()
        _settle(run)
    words = "still in the hand" if run.holding else words
    detail = f"{failure.detail}; {words}" if words else failure.detail
    return Failure(failure.outcome, failure.stage, detail)


def _settle(run: Execution) -> None:
    """Wait until everything rests but what both fingers hold, whatever was meant."""
    sim = run.sim

    def in_hand() -> bool:
        if sim.cup is not None:
            return sim.cup.held == sim.target
        return sim.width < run.order.held and run.grip() >= HOLDS

    watch = BLIND._replace(until=lambda: sim.asleep(besides=in_hand()))
    sim.wait(round(REST_TIME / TIMESTEP), sim.stage, watch)
    run.holding = in_hand()
    if not run.holding:
        sim.load(0.0, round(LOAD_TIME / TIMESTEP), sim.stage, BLIND)


def _put_back(run: Execution) -> None:
    """The way here backwards, and down where the object came from."""
    pick, across = run.course.plan.pick, run.course.across
    if run.inside is not pick:
        run.rise("place", BLIND)
        run.carry(np.vstack([run.sim.joints, across[: run.segments_done + 1][-2::-1]]), BLIND)
    run.lower(pick, "place", BLIND, BLIND)
    run.release("release", BLIND)


def _leave(run: Execution) -> None:
    """Up, and home if there is a free way."""
    sim = run.sim
    run.rise("retreat", BLIND)
    checker = WorldChecker(sim.arm, sim.world, sim.poses.copy(), run.order.names)
    checker.empty(run.order.opening)
    if checker.check(sim.joints) is not None:
        _back_off(run, checker)
    run.travel(free_way(checker, sim.joints, rest_pose(sim.arm, checker), "home"), "home", BLIND)


def _back_off(run: Execution, checker: WorldChecker) -> None:
    """Back the way the arm has come, to where it last touched nothing, if it ever did."""
    past = run.sim.past()[::-1]
    free = next((k for k, joints in enumerate(past) if checker.check(joints) is None), None)
    if free is None:
        return
    way = past[: free + 1]
    corners = np.unique(np.r_[0:free:BACK_STRIDE, free])
    run.travel(np.vstack([run.sim.joints, way[corners][1:]]), "retreat", BLIND)


PLACE_LIMIT = 0.01
"""The object was dropped when a cell ends so far from where it was ordered [m]."""
HEIGHT_LIMIT = 1e-3
"""Cells of an object keep their heights, relative to each other [m]."""
TILT_LIMIT = 0.05
"""An object that leans more [rad] has tipped."""
STILL = 0.02
"""An object that is faster at the end keeps moving [m/s]."""


class ShiftRule(NamedTuple):
    """How far other blocks may be moved, waiting ones included."""

    limit: float = 0.01
    """[m]"""
    axes: int = 2
    """2: in x and y; 3: in space."""


ONE_SIDED = ShiftRule(0.035, 3)
"""The rule of the one-sided cell."""


def check_rest(
    order: Order, poses: np.ndarray, speed: float, landed: bool, rule: ShiftRule
) -> None:
    """Look at how things are after a motion that went as planned.

    Args:
        order: what was asked.
        poses: float64[b, 7] of the objects now.
        speed: of the moved object [m/s].
        landed: whether it rested on something before the hand let go of it.
        rule: for the others.

    Raises:
        Failure: DISTURBED_STRUCTURE where another block was moved; DROPPED where the object ended
            elsewhere, TOPPLED where it tipped or has not come to rest. An object that rested and
            then tipped over is TOPPLED wherever it lies, one that was let go in the air DROPPED.
    """
    position, quaternion, _ = order.objects.cells(poses)
    shift = np.linalg.norm((position - order.scene.position)[:, : rule.axes], axis=1)
    shift[order.objects.owner == order.target] = 0.0
    if not shift.max() < rule.limit:
        k = int(np.argmax(shift))
        detail = f"block {k} was moved by {1e3 * shift[k]:.0f} mm"
        raise Failure(Outcome.DISTURBED_STRUCTURE, "rest", detail)
    members = order.scene.members(order.move.cell)
    ordered, turned = carried(order.scene, order.move, members)
    sunk = position[members, 2] - ordered[:, 2]
    cell = order.move.cell
    lean = _lean(
        turned[0] if order.scene.half is not None else order.quaternion[cell], quaternion[cell]
    )
    tipped = np.ptp(sunk) > HEIGHT_LIMIT or lean > TILT_LIMIT
    missed = np.linalg.norm(position[members] - ordered, axis=1).max()
    name = order.names[order.target]
    if not missed <= PLACE_LIMIT and not (tipped and landed):
        detail = f"{name} ended {1e3 * missed:.0f} mm from its place"
        raise Failure(Outcome.DROPPED, "rest", detail)
    if tipped:
        detail = f"{name} leans by {np.degrees(lean):.1f} degrees"
        raise Failure(Outcome.TOPPLED, "rest", detail)
    if speed > STILL:
        raise Failure(Outcome.TOPPLED, "rest", f"{name} still moves at {speed:.2f} m/s")


def _lean(before: np.ndarray, after: np.ndarray) -> float:
    """Angle [rad] by which a body with quaternions before and after has turned off the vertical."""
    return float(
        np.arccos(np.clip(rotation_matrix(before)[2] @ rotation_matrix(after)[2], -1.0, 1.0))
    )
