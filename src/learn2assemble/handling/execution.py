"""One pick and place, stage by stage, as the side that decides carries it out: it knows how things
are meant to be and what it senses, and talks to a plant. The first thing that goes wrong ends it.

What is done after a failure is :mod:`.recovery`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

from learn2assemble.handling.load import hanging, peak_load
from learn2assemble.handling.prepare import Course, leaving
from learn2assemble.handling.ways import WorldChecker, free_way
from learn2assemble.kinematics.approach import ApproachPath, approach_path, on_path, tool_path
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.kinematics.joint_path import JointPath, joint_path
from learn2assemble.kinematics.time_law import (
    PathLimits,
    PathSamples,
    Segment,
    approach_speed_limits,
    limits_along,
    motion,
    reachable_speed,
)
from learn2assemble.motion.program import LOAD_TIME
from learn2assemble.motion.record import RATE
from learn2assemble.plants.plant import (
    Guard,
    Motion,
    Plant,
    Played,
    Report,
    Stop,
    ToolCommand,
    standing,
)
from learn2assemble.robot.arm import Arm, Limits
from learn2assemble.robot.grasps import facing
from learn2assemble.robot.moves import Failure, Outcome, carried
from learn2assemble.simulation.model import TIMESTEP, SimulatedWorld
from learn2assemble.simulation.objects import Order

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
GUARDED_SPEED, PADS_SPEED = 0.01, 0.005
"""... and, where that is guarded, as near to its place as that is uncertain at this one [m/s], so
that it meets what is there with less than :data:`PRESSED`; between pads slower, as what lands
harder on an edge comes off one of them and is thrown aside by the other (by half a millimetre)."""
GENTLE, MOST_SLOWER = 0.7, 6
"""What hangs from a cup is moved so that it loads it with no more than this share of what it holds;
how often it is slowed down for that, if need be."""
RAMP_TIME = 0.04
"""In which what hangs from a cup is brought to its full acceleration [s]; faster, the arm swings
with it and doubles its load."""
PERIOD = 0.01
"""Between the instants at which that load is computed [s]."""
KNOBS = 0.003
"""From so far above its place it is lowered softly on studs, whose knobs it meets 1.8 mm above that
[m] ..."""
PRESS_NEAR, PRESS_SPEED = 0.001, 0.0075
"""... and from so near to the contact [m] it is pressed on them so slowly [m/s], between pads as
slowly as it is set down."""
SLOT_SPEED = 0.1
"""So slowly it goes into a slot between others, and out of it [m/s]: faster, it strays by more than
the joints leave."""
NEAR_BY, LEDGE = 0.005, 0.001
"""What stands nearer than this beside the way of an object [m] is slid along, where it is higher
than the bottom of that by more than this [m]."""
SAME = 1e-6
"""Joints that differ by less are where they should be [rad]."""
ALIKE = 1e-9
"""Motions whose joints differ by less have not parted yet [rad]."""
LANDED = 1.0
"""What rests presses so hard on others [N]: as much as a block weighs."""
PRESSED = 20.0
"""What is set down never presses harder on anything [N]."""
GRIP_TIME = 0.2
"""The tool has taken hold within this time after it was told to [s]."""
CALM_TIME = 0.1
"""The hand stands still so long before it is looked where a box of given size sits in it [s]."""
ELSEWHERE = 0.03
"""What is seen so far from where it should be in the hand is not what the hand holds [m]."""
TOUCH = 0.5
"""Smallest force between things that must not meet that counts as a collision [N]: half the weight
of a block. A brush without force is none; a block that it moves nevertheless is noticed later."""
PUSH = 5.0
"""The same between the open hand and the block it is about to grasp [N]: a finger that slides a
free block (friction holds it with 1 N) is none, one that lands on it is."""
EMPTY = Guard(force=TOUCH, taken=PUSH)
LOADED = Guard(force=TOUCH, held=TOUCH, hold="kept")
NEAR = Guard(force=TOUCH, hold="kept")
BESIDE = Guard(force=TOUCH, held=PUSH, hold="kept")
LOOSELY = Guard(force=TOUCH)
BLIND = Guard()
CLOSING = Guard(force=TOUCH, hold="made")
"""What is looked for with an empty hand, a loaded one, near the contact, where what is held slides
along others, while it is let go, after a failure, and while the tool takes hold."""


class Senses(Protocol):
    """What an attempt asks of what is known."""

    def settle(self, stage: str) -> None:
        """Wait until everything rests."""
        ...

    def taken(self) -> None:
        """The tool has taken hold."""
        ...

    def in_hand(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the object in the tool frame, as far as it is known: float64[3] [m], [3, 3]."""
        ...

    def look(self) -> np.ndarray:
        """float64[b, 7]: where the objects are, the one in the hand included."""
        ...

    def let_go(self) -> None:
        """The tool has let go where the object rests."""
        ...

    def lost(self) -> None:
        """What was held is not in the hand any more."""
        ...


PAUSE = 0.04
"""Between two looks whether the way is free [s]."""


class Coordinator:
    """What an arm tells and asks of its ways where another one moves in its cell; here it has that
    for itself."""

    def rerouted(self, stage: str, way: np.ndarray) -> None:
        """The arm goes by other corners, float64[k, n] [rad], than were planned."""

    def halt(self, start: np.ndarray, end: np.ndarray) -> np.ndarray | None:
        """Of a straight part of the way across, from joints float64[n] to others [rad]: where it is
        to go first; where it is, to wait there for a moment; None: to the end."""
        return None

    piecewise: bool = False
    """Whether an arm that is to go somewhere first may find on its way that it may go on, and does
    so without a stop: its plant is told motions piece by piece."""

    def farther(self, now: np.ndarray, there: np.ndarray, end: np.ndarray) -> np.ndarray | None:
        """How far it may go on, from joints float64[n] where it is, on its way to others, before it
        has to brake for these [rad]; None: no farther."""
        return None


ALONE = Coordinator()


@dataclass(frozen=True)
class Rig:
    """What carries an attempt out."""

    plant: Plant
    senses: Senses
    arm: Arm
    world: SimulatedWorld | None
    """Model of the cell as it is believed, to plan ways in; None: planned ways are not looked at
    again, and nothing is slowed down for what hangs from a cup."""
    limits: Limits
    """Of the joints while the hand is empty, ..."""
    loaded: Limits
    """... and while it holds something."""
    guarded: float = 0.0
    """So near to where an object shall stand it may meet what carries it [m], and if it meets
    nothing there, it goes back instead of being let go; 0: it is let go there, whatever it met."""
    coordinator: Coordinator = ALONE


class Execution:
    """Carries out a course.

    Args:
        rig: with what.
        order: what is asked, in the world as it is believed.
        course: how.
        joints: float64[n] where the arm stands [rad].
    """

    rig: Rig
    order: Order
    course: Course

    def __init__(self, rig: Rig, order: Order, course: Course, joints: np.ndarray) -> None:
        self.rig, self.order, self.course = rig, order, course
        self.joints: np.ndarray = joints
        self.log: list[tuple[str, Played]] = []
        """What the drives were told, by stage."""
        self.inside: ApproachPath | None = None
        """The approach path the hand is on; None where it travels."""
        self.segments_done: int = 0
        """How many straight parts of the way across are done."""
        self.holding: bool = False
        """Whether the object is in the hand."""
        self.closed: bool = False
        """Whether the tool was told to hold."""
        self.landed: bool = False
        """Whether it rested on something before the hand let go of it."""
        self.unmoved: bool = False
        """Whether the tool has taken hold of the object, and has not moved it yet."""
        self.gone: int | None = None
        """After so many entries of the log it was lost."""
        self.leaving: ApproachPath | None = None
        """By which the hand leaves the place; None: it has not come there yet."""

    def bring(self) -> None:
        """Fetch the object and set it down; then it rests in its place, still in the hand.

        Raises:
            Failure: at the first thing that goes wrong; the arm has stopped.
        """
        course, gripper = self.course, self.rig.arm.gripper
        opened: tuple[ToolCommand, ...] = ()
        if self.rig.arm.suction is None:
            opened = (ToolCommand(width=self.order.opening, speed=gripper.speed),)
        self.travel(course.there, "approach", EMPTY, opened)
        self.grasp(course.plan.pick)
        self.carry(self.checked(course.across, "cross"))
        suction = self.rig.arm.suction
        if self.order.scene.half is not None and not (suction is not None and suction.studs):
            # What is seen shall be where it sits, not how it swings; on studs nothing swings.
            self.wait(CALM_TIME, "cross", LOADED)
        place, self.leaving = self.corrected()
        self.lower(place, "place", LOADED, NEAR)
        if self.rig.guarded and not self.landed:
            detail = f"nothing is met {1e3 * self.order.below:.0f} mm below the place"
            raise Failure(Outcome.NO_CONTACT, "place", detail)

    def leave(self) -> None:
        """Let go of what rests in its place, and home.

        Raises:
            Failure: as :meth:`bring`.
        """
        self.release("release", LOOSELY)
        self.inside = self.leaving
        self.rise("retreat", LOOSELY)
        self.travel(self.checked(self.course.home, "home"), "home")

    # ------------------------------------------------------------ what a plant is told

    def do(
        self, run: Motion, guards: tuple[Guard, ...], commands: tuple[ToolCommand, ...] = ()
    ) -> Report:
        """Let the plant carry a motion out.

        Raises:
            Failure: where something was touched that should not be, or what was held is lost.
        """
        before = self.joints
        report = self.rig.plant.execute(run, commands, guards)
        self.joints = report.joints
        self.unmoved = self.unmoved and not np.abs(self.joints - before).max() > SAME
        self.log.append((run.stage, report.played or told(run, report)))
        if report.stop == Stop.FORCE:
            grasping = run.stage in ("approach", "pick", "lift")
            touch = Outcome.GRASP_COLLISION if grasping else Outcome.PLACE_COLLISION
            raise Failure(touch, run.stage, report.detail or "something is touched")
        if report.stop in (Stop.VACUUM, Stop.WIDTH):
            self.gone = len(self.log)
            raise Failure(Outcome.GRASP_LOST, run.stage, report.detail or "the hand holds nothing")
        return report

    def follow(
        self,
        path: JointPath,
        bounds: PathLimits,
        stage: str,
        guards: tuple[Guard, ...],
        segments: tuple[Segment, ...] = (),
        commands: tuple[ToolCommand, ...] = (),
    ) -> Report:
        """Move along a path; guards begin where the path has their ``begin`` as its parameter."""
        run = motion(path, bounds, TIMESTEP, segments)
        begins = np.searchsorted(run.progress[:, 0], [guard.begin for guard in guards]).tolist()
        at = (g._replace(begin=k * TIMESTEP) for g, k in zip(guards, begins, strict=True))
        return self.do(_from_rest(stage, self.joints, run), tuple(at), commands)

    def wait(
        self, seconds: float, stage: str, guard: Guard, commands: tuple[ToolCommand, ...] = ()
    ) -> Report:
        """Stand still, while the tool does what it is told."""
        return self.do(standing(stage, self.joints, seconds), (guard,), commands)

    def bounds(self, path: JointPath, limits: Limits) -> PathLimits:
        """How fast along a path; builds are carried out as fast as that can be."""
        return limits_along(path, limits, quickest=self.rig.guarded > 0)

    def tool(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the tool float64[3] [m] and float64[3, 3], as it was told to be."""
        return forward(get_chain(self.rig.arm), self.joints)

    # ------------------------------------------------------------ the stages

    def checked(self, way: np.ndarray, stage: str) -> np.ndarray:
        """A planned way from where the arm is; another one where things are not as planned and
        something is in the way now."""
        rig, planned = self.rig, np.vstack([self.joints, way[1:]])
        poses = rig.senses.look()
        if rig.world is None:
            return planned
        checker = WorldChecker(rig.arm, rig.world, poses, self.order.names)
        if self.holding:
            checker.carry(self.order.target, *rig.senses.in_hand(), self.order.held)
        else:
            checker.empty(self.order.opening)
        if all(checker.blocked(start, end) is None for start, end in pairwise(planned)):
            return planned
        found = free_way(checker, self.joints, way[-1], stage)
        rig.coordinator.rerouted(stage, found)
        return found

    def travel(
        self,
        way: np.ndarray,
        stage: str,
        guard: Guard = EMPTY,
        commands: tuple[ToolCommand, ...] = (),
    ) -> None:
        """Move the empty hand along straight lines of the joints; the tool is told something as it
        begins."""
        self.inside = None
        for start, end in pairwise(way):
            path = joint_path(np.array([start, end]), self.rig.limits)
            self.follow(path, self.bounds(path, self.rig.limits), stage, (guard,), (), commands)
            commands = ()

    def grasp(self, approach: ApproachPath) -> None:
        """Down from where the hand is on the path, take hold, up to its end."""
        self.inside, limits = approach, self.rig.limits
        above = approach.rise > -1e-9  # The contact itself, whatever rounding made of it.
        joints, rise = approach.joints[above], approach.rise[above]
        down, below = joints[::-1], rise[::-1]
        if np.abs(self.joints - joints[-1]).max() > SAME:
            on = on_path(self.rig.arm, ApproachPath(joints, rise), self.joints)
            if on is not None:
                down = np.vstack([self.joints, joints[: on[0]][::-1]])
                below = np.array([on[1], *rise[: on[0]][::-1]])
        path = joint_path(down, limits)
        bounds = self.bounds(path, limits)
        segments = approach_speed_limits(path, below, ((CAREFUL, CAREFUL_SPEED),), bounds)
        self.follow(path, bounds, "pick", (EMPTY,), segments)
        self.close()
        self.holding = self.unmoved = True
        grasp, load = self.course.plan.move.grasp, ToolCommand(load=self.mass())
        if grasp.sideways:
            out = int(np.searchsorted(rise, grasp.way - 1e-9)) + 1
            self.draw(joints[:out], grasp.way)
            joints, rise = joints[out - 1 :], rise[out - 1 :] - grasp.way
        self.wait(LOAD_TIME, "pick", NEAR, (load,))
        path, bounds = self.gently(joints)
        off = float(np.interp(LOOSE, rise, path.knots))
        guards, segments = (NEAR, LOADED._replace(begin=off)), ()
        slot = 0.0 if self.order.scene.half is None or grasp.sideways else self.slot(False)
        if slot:
            # Beside others it slides out of a slot.
            out = float(np.interp(slot, rise, path.knots))
            guards = (NEAR, BESIDE._replace(begin=off), LOADED._replace(begin=out))
            slowly = min(SLOT_SPEED * out / slot, bounds.speed)
            # It comes to rest at the end of the way, however near the end of the slot is to that.
            speed = min(
                slowly, *(reachable_speed(0.0, s, bounds) for s in (out, path.length - out))
            )
            segments = (Segment(out, speed, slowly), Segment(path.length, 0.0, bounds.speed))
        self.follow(path, bounds, "lift", guards, segments)

    def draw(self, joints: np.ndarray, way: float) -> None:
        """Draw what is held out to the side from between others, along joints float64[k, n] [rad],
        over ``way`` [m]. What it lies on carries it, so the controller is not told of its mass yet:
        it would lift it against what is above."""
        path, bounds = self.gently(joints)
        slowly = (Segment(path.length, 0.0, min(SLOT_SPEED * path.length / way, bounds.speed)),)
        self.follow(path, bounds, "lift", (NEAR,), slowly)

    def close(self) -> None:
        """Close the fingers until they press, or make the vacuum."""
        arm, name = self.rig.arm, self.order.names[self.order.target]
        if arm.suction is not None:
            told, seconds = ToolCommand(vacuum=True), arm.suction.grip_time
        else:
            gripper = arm.gripper
            told = ToolCommand(width=self.order.held, force=gripper.force, speed=gripper.speed)
            way = self.order.opening - self.order.held + gripper.force / gripper.stiffness
            seconds = way / gripper.speed
        self.closed = True
        report = self.wait(seconds + GRIP_TIME, "pick", CLOSING, (told,))
        if report.stop != Stop.HELD:
            what = "socket" if arm.suction is not None and arm.suction.studs else "cup"
            detail, felt = f"the {what} does not close on {name}", report.tool
            if felt.width is not None:
                grip, width = felt.grip or 0.0, 1e3 * felt.width
                detail = f"the fingers press with {grip:.1f} N at {width:.0f} mm"
            raise Failure(Outcome.GRASP_LOST, "pick", detail)
        self.rig.senses.taken()

    def mass(self) -> float:
        """Of the object, as it is meant to be [kg]."""
        scene, move = self.order.scene, self.order.move
        return float(scene.mass(scene.members(move.cell)).sum())

    def slot(self, goal: bool) -> float:
        """So far above where it was, or shall be, the object may slide along others [m]; 0:
        nothing stands so near beside that it could."""
        scene, move = self.order.scene, self.order.move
        members = scene.members(move.cell)
        own = scene.rows(members, 0)
        if goal:
            there, turns = carried(scene, move, members)
            own = own._replace(position=there, quaternion=turns)
        (low, high), (under, over) = own.bounds(), scene.bounds()
        bottom = low[:, 2].min()
        near = (under[:, None] < high + NEAR_BY) & (over[:, None] > low - NEAR_BY)
        beside = np.any(near[..., 0] & near[..., 1], 1) & (over[:, 2] > bottom + LEDGE)
        beside[members] = False
        if not beside.any():
            return 0.0
        return float(min(over[beside, 2].max(), high[:, 2].max()) - bottom) + LOOSE

    def gently(self, joints: np.ndarray) -> tuple[JointPath, PathLimits]:
        """A path of the loaded hand through joint positions float64[k, n] [rad], and how fast: as
        fast as the limits allow, with a cup slower where what hangs from it would load it by more
        than :data:`GENTLE`."""
        rig, limits = self.rig, self.rig.loaded
        suction, world = rig.arm.suction, rig.world
        if suction is None or world is None or not self.holding:
            path = joint_path(joints, limits)
            return path, self.bounds(path, limits)
        limits = limits._replace(jerk=np.minimum(limits.jerk, limits.acceleration / RAMP_TIME))
        path = joint_path(joints, limits)
        bounds = self.bounds(path, limits)
        load = hanging(world, self.order.target, *rig.senses.in_hand())
        lip, chain = self.course.plan.move.grasp.lip, get_chain(rig.arm)
        cup = next(one for one in suction.cups if one.lip == lip)
        for _ in range(MOST_SLOWER):
            run = motion(path, bounds, PERIOD)
            peak = max(peak_load(cup, chain, load, run.position, PERIOD))
            if peak <= GENTLE:
                break
            limits = limits.scaled(max(0.9 * math.sqrt(GENTLE / peak), 0.5))
            path = joint_path(joints, limits)
            bounds = self.bounds(path, limits)
        return path, bounds

    def carry(self, way: np.ndarray, guard: Guard = LOADED) -> None:
        """Across, along straight lines of the joints."""
        self.inside = None
        for start, end in pairwise(way):
            while (there := self.rig.coordinator.halt(start, end)) is not None:
                if there is start:
                    self.wait(PAUSE, "cross", guard)
                else:
                    start = self._towards(start, there, end, guard)
                    if start is end:
                        break
            else:
                self._straight(start, end, guard)
            self.segments_done += 1

    def _towards(
        self, start: np.ndarray, there: np.ndarray, end: np.ndarray, guard: Guard
    ) -> np.ndarray:
        """Across along a straight line of the joints float64[n] as far as the arm may go, and on
        where it may go on before it has to brake; where it stands then."""
        coordinator = self.rig.coordinator
        if not coordinator.piecewise:
            return self._straight(start, there, guard)
        path, bounds = self.gently(np.stack([start, end]))
        whole, done = motion(path, bounds, TIMESTEP), 0

        def play(run: PathSamples, until: int) -> None:
            nonlocal done
            if until > done:
                piece = _from_rest("cross", start, run)
                joints, velocity = (one[done : until + 1] for one in (piece.joints, piece.velocity))
                self.do(Motion("cross", piece.time[: until + 1 - done], joints, velocity), (guard,))
                done = until

        while there is not end:
            share = float(np.abs(there - start).max() / np.abs(end - start).max())
            part = JointPath(path.knots * share, np.stack([start, there]), path.bend)
            short = motion(part, bounds, TIMESTEP)
            play(whole, _alike(whole, short))
            farther = coordinator.farther(self.joints, there, end)
            if farther is None:
                play(short, len(short.position))
                return there
            there = farther
        play(whole, len(whole.position))
        return end

    def _straight(self, start: np.ndarray, end: np.ndarray, guard: Guard) -> np.ndarray:
        """Across along one straight line of the joints; its end."""
        path, bounds = self.gently(np.stack([start, end]))
        self.follow(path, bounds, "cross", (guard,))
        return end

    def corrected(self) -> tuple[ApproachPath, ApproachPath]:
        """The approach path over the target for the hand that holds the object as it does, and
        the one by which the hand leaves."""
        rig, plan, order = self.rig, self.course.plan, self.order
        rig.senses.look()
        where, now = rig.senses.in_hand()
        if float(np.linalg.norm(where - order.in_hand(plan.move.grasp)[0])) > ELSEWHERE:
            rig.senses.lost()
            detail = f"{order.names[order.target]} is not in the hand"
            raise Failure(Outcome.GRASP_LOST, "cross", detail)
        cell = where + now @ order.objects.offset[order.move.cell]
        place, target = plan.move.place, order.move.target
        if rig.arm.suction is not None:
            # Turned by as much as the object is turned in the hand; pads straighten what they hold.
            if place.tilt:
                # The weight of what hangs aside leans it, too.
                goal = order.in_world(plan.move.grasp, place)[1]
                straight = facing(goal @ now.T)
                place = place._replace(yaw=straight.yaw, tilt=straight.tilt, spin=straight.spin)
            else:
                off = now @ order.in_hand(plan.move.grasp)[1].T
                place = place.spun(math.atan2(off[1, 0] - off[0, 1], off[0, 0] + off[1, 1]))
        tool = target - place.rotation() @ cell
        centre = tool + target - place.tool_point(target)
        poses = tool_path(centre, place, plan.height, upwards=True)
        found = approach_path(rig.arm, poses, order.below, plan.place.joints[0])
        if isinstance(found, str):
            raise Failure(Outcome.UNREACHABLE, "place", found)
        leave = leaving(rig.arm, centre, place, plan.height, found)
        if isinstance(leave, str):
            raise Failure(Outcome.UNREACHABLE, "place", leave)
        return found.upto(plan.place.rise[-1]), leave.upto(plan.leave.rise[-1])

    def lower(self, approach: ApproachPath, stage: str, before: Guard, near: Guard) -> None:
        """Down, the last part slowly, until the object rests or the path ends.

        Args:
            approach: over the place, from below it.
            stage: for the recording.
            before: what is looked for on the way ...
            near: ... and within :data:`LOOSE` of the place.
        """
        self.inside, pick = approach, self.course.plan.pick
        now = _nearest(approach, self.joints)
        path, bounds = self.gently(np.vstack([self.joints, approach.joints[:now][::-1]]))
        rise = approach.rise[: now + 1][::-1]
        press = self.press() if before is LOADED else 0.0
        soft = KNOBS if press else SOFT if self.order.scene.half is None else LOOSE
        zones = [(CAREFUL, CAREFUL_SPEED), (soft, SOFT_SPEED)]
        slot = 0.0 if self.order.scene.half is None else self.slot(approach is not pick)
        if slot:
            zones = sorted([*zones, (min(slot + SOFT, rise[0]), SLOT_SPEED)], reverse=True)
        pads = self.rig.arm.suction is None
        if self.rig.guarded:
            zones.append((self.rig.guarded, PADS_SPEED if pads else GUARDED_SPEED))
        if press:
            zones.append((PRESS_NEAR, PADS_SPEED if pads else PRESS_SPEED))
        segments = approach_speed_limits(path, rise, tuple(zones), bounds)
        loose = float(np.interp(-LOOSE, -rise, path.knots))
        until = near._replace(begin=loose, contact=press or LANDED, bears=press > 0)
        if self.rig.guarded:
            until = until._replace(held=PRESSED + press)
        guards = (before, until)
        if slot and before is LOADED:
            # Between others it slides into a slot.
            begin = float(np.interp(-slot, -rise, path.knots))
            guards = (before, BESIDE._replace(begin=begin), until)
        self.landed = False
        self.landed = self.follow(path, bounds, stage, guards, segments).stop == Stop.CONTACT

    def press(self) -> float:
        """With which what is held has to be pressed home on studs [N]; 0: there are none."""
        studs, move = self.order.scene.studs, self.order.move
        if studs is None:
            return 0.0
        own = set(self.order.scene.members(move.cell).tolist())
        wanted = any(joint.leaves(own) and not joint.home for joint in studs.joints)
        return studs.press if wanted else 0.0

    def release(self, stage: str, guard: Guard) -> None:
        """Open no further than needed; with a cup, turn the vacuum off and wait."""
        arm, load = self.rig.arm, ToolCommand(load=0.0)
        self.holding = self.closed = False
        if arm.suction is not None:
            # The controller forgets the load while the vacuum breaks down.
            seconds = max(LOAD_TIME, arm.suction.release_time + TIMESTEP)
            self.wait(seconds, stage, guard, (load, ToolCommand(vacuum=False)))
        else:
            self.wait(LOAD_TIME, stage, guard, (load,))
            gripper, order = arm.gripper, self.order
            told = ToolCommand(width=order.opening, speed=gripper.speed)
            way = order.opening - order.held + gripper.force / gripper.stiffness
            self.wait(way / gripper.speed, stage, guard, (told,))
        self.rig.senses.let_go()

    def rise(self, stage: str, guard: Guard) -> None:
        """Up from wherever the hand is on an approach path; it may travel then."""
        approach = self.inside
        if approach is None:
            return
        limits = self.rig.loaded if self.holding else self.rig.limits
        above = approach.joints[_nearest(approach, self.joints) + 1 :]
        path = joint_path(np.vstack([self.joints, above]), limits)
        self.follow(path, self.bounds(path, limits), stage, (guard,))
        self.inside = None


def straight_motion(way: np.ndarray, limits: Limits, stage: str) -> Motion:
    """The motion along the straight line between two positions of the joints, float64[2, n] [rad],
    as fast as the limits allow."""
    path = joint_path(way, limits)
    run = motion(path, limits_along(path, limits, quickest=True), TIMESTEP)
    return _from_rest(stage, way[0], run)


def _alike(one: PathSamples, other: PathSamples) -> int:
    """In how many samples two motions from the same rest are one."""
    count = min(len(one.position), len(other.position))
    same = np.abs(one.position[:count] - other.position[:count]).max(1, initial=0.0) < ALIKE
    return int(np.argmin(np.r_[same, False]))


def _from_rest(stage: str, start: np.ndarray, run: PathSamples) -> Motion:
    """What a plant is told of samples that are one step apart, from joints float64[n] [rad]."""
    return Motion(
        stage,
        TIMESTEP * np.arange(len(run.position) + 1),
        np.vstack([start[None], run.position]),
        np.vstack([np.zeros_like(start[None]), run.velocity]),
    )


def told(run: Motion, report: Report) -> Played:
    """What a plant that does not say how a motion went was told, as far as it came."""
    count = max(1, round(report.seconds * RATE))
    at = report.done * run.seconds * np.arange(1, count + 1) / count
    joints, velocity = run.at(at)
    nothing = np.zeros(count)
    return Played(at, joints, velocity, nothing, nothing)


def _nearest(approach: ApproachPath, joints: np.ndarray) -> int:
    return int(np.argmin(np.abs(approach.joints - joints).max(1)))
