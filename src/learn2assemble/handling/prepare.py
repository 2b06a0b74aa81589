"""Everything that is decided before the arm moves: which way round, how high, along which ways."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from learn2assemble.handling.ways import KEEP, WorldChecker, free_way
from learn2assemble.kinematics.approach import (
    ApproachPath,
    approach_path,
    approach_paths,
    on_path,
    tool_path,
    travel_time,
)
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.kinematics.inverse import solve
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.moves import LEVEL, Failure, Move, Outcome, Scene, overload, turned, turns
from learn2assemble.simulation.model import SimulatedWorld
from learn2assemble.simulation.objects import PRESS, Order

STRAIGHT, OFF_KNOBS = 0.015, 0.008
"""At least so far from a contact the tool comes and goes straight [m]; and a socket where studs say
where things are, whose knobs are 1.8 mm high."""
LIFTED, GRADE = 0.008, 0.001
"""So far above a contact it counts how near the arm comes to others [m], in steps of this [m]."""
HANGS = 2e-4
"""So much lower than it is planned a brick may sit in the hand [m]."""
MAX_RAISES = 4
"""How often the crossing is tried again, a level higher."""
_MAX_LIFTS, _UP = 8, np.array([0.0, 0.0, LEVEL])


class Approaches(NamedTuple):
    """Approach paths over both places."""

    pick: ApproachPath
    """Over the grasped cell, from :data:`PRESS` below the contact."""
    place: ApproachPath
    """Over the target, likewise."""
    leave: ApproachPath
    """By which the hand leaves the target; the same but where it comes from the side: there it
    sets down from above."""
    move: Move
    """The order, with the fingers exchanged where that is easier."""
    height: float
    """Of the tool while crossing [m]."""


class Following(NamedTuple):
    """What an arm takes next."""

    step: np.ndarray
    """float64[3] from the top of the object it moves now, where it waits, to where the top of the
    next one will be [m]."""
    placed: bool = False
    """Whether it is from the top of the object in its place, as the next one is near that."""


class Course(NamedTuple):
    """A plan and the ways between its approach paths, each float64[k, n]: joint positions [rad]
    whose straight connections are free."""

    plan: Approaches
    there: np.ndarray
    """From where the arm is to above the object; only where it is, if the hand goes down from
    there."""
    across: np.ndarray
    """From there to above the target."""
    home: np.ndarray
    """From there to where it waits: home, or above where it took the object."""


def require_held(arm: Arm, scene: Scene, move: Move) -> None:
    """Refuse what the tool cannot hold at all.

    Raises:
        Failure: GRASP_LOST.
    """
    why = overload(arm, scene, move)
    if why is not None:
        raise Failure(Outcome.GRASP_LOST, "lift", why)


def prepare(
    arm: Arm,
    world: SimulatedWorld,
    order: Order,
    joints: np.ndarray | None,
    precheck: bool,
    following: Following | None = None,
    near: np.ndarray | None = None,
    low: bool = False,
) -> Course:
    """The course of an attempt.

    Args:
        arm: the robot.
        world: model of the cell.
        order: what is asked.
        joints: float64[n] where the arm is [rad]; by default its :func:`rest_pose`.
        precheck: whether an occupied target is a failure already.
        following: what comes next: the arm takes the shortest ways there are, and waits above
            that.
        near: float64[n], joints near which the arm shall be when the object is in its place, with
            the hand as ordered [rad]; by default what meets least.
        low: whether it takes the shortest ways though it waits at home.

    Raises:
        Failure: where there is none.
    """
    checker = WorldChecker(arm, world, order.poses, order.names)
    checker.empty(order.opening)
    start = rest_pose(arm, checker) if joints is None else joints
    plan = _plan(checker, order, start, following is not None, near)
    placed = order.in_world(plan.move.grasp, plan.move.place)
    if precheck:
        checker.put(order.target, *placed, order.opening)
        hit = checker.overlap(order.target)
        if hit is not None:
            name = order.names[order.target]
            raise Failure(Outcome.PLACE_COLLISION, "place", f"{name} would overlap {hit}")
    plan, across = _across(arm, checker, order, plan)
    checker.empty(order.opening)
    waits = None
    if (low or following is not None) and len(across) == 2:
        plan = _lowered(checker, order, plan, start)
        across = np.array([plan.pick.joints[-1], plan.place.joints[-1]])
    if following is not None:
        if following.placed:
            checker.put(order.target, *placed, order.opening)
        waits = _above(checker, plan.place if following.placed else plan.pick, following.step)
        checker.empty(order.opening)
    there = _there(checker, start, plan.pick, least_rise(arm, order))
    checker.put(order.target, *placed, order.opening)
    low, waits = low or waits is not None, rest_pose(arm, checker) if waits is None else waits
    if low and len(across) == 2:
        least = least_rise(arm, order)
        plan = plan._replace(leave=_lowest(plan.leave, least, lambda q: _free(checker, q, waits)))
    home = free_way(checker, plan.leave.joints[-1], waits, "home")
    return Course(plan, there, across, home)


def least_rise(arm: Arm, order: Order) -> float:
    """At least so far from a contact the tool comes and goes straight [m]; fingers reach down
    beside what they hold."""
    pads = arm.suction is None
    return STRAIGHT if pads or order.scene.studs is None else OFF_KNOBS


def _there(
    checker: WorldChecker, start: np.ndarray, pick: ApproachPath, least: float
) -> np.ndarray:
    """See :attr:`Course.there`; a cup has nothing to open before it goes down.

    Args:
        least: of :func:`least_rise`.

    Raises:
        Failure: where there is no way.
    """
    on = None if checker.arm.suction is None else on_path(checker.arm, pick, start)
    if on is not None and on[1] >= least and _free(checker, start, pick.joints[on[0] - 1]):
        return start[None]
    return free_way(checker, start, pick.joints[-1], "approach")


def _free(checker: WorldChecker, start: np.ndarray, end: np.ndarray) -> bool:
    return checker.blocked(start, end) is None


def _lowest(path: ApproachPath, least: float, free: Callable[[np.ndarray], bool]) -> ApproachPath:
    """An approach path only as high as it has to be.

    Args:
        path: whose end is high enough.
        least: of :func:`least_rise`.
        free: of its joints float64[n]: whether the way from there is.
    """
    low = int(np.searchsorted(path.rise, least - 1e-9))
    high = len(path.joints) - 1
    # What is free is so higher up, too, as a rule; what is found is looked at itself.
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if free(path.joints[middle]) else (middle + 1, high)
    return ApproachPath(path.joints[: high + 1], path.rise[: high + 1])


def _lowered(
    checker: WorldChecker, order: Order, plan: Approaches, start: np.ndarray
) -> Approaches:
    """The plan with approach paths only as high as the ways between them need, those straight.

    Bricks are built so high that a way which ends just above one has to begin far above the other
    one. There the sum counts, what is above the place twice: the way down is slow there, and others
    wait for it.
    """
    move, pick, place = plan.move, plan.pick, plan.place
    if move.grasp.sideways or move.place.sideways or move.place.apart:
        return plan
    studs, least = order.scene.studs is not None, least_rise(checker.arm, order)
    where, turn = order.in_hand(move.grasp)
    checker.carry(order.target, where + HANGS * studs * np.array([0.0, 0.0, 1.0]), turn, order.held)
    top = pick.joints[-1]
    found: list[tuple[float, ApproachPath, ApproachPath]] = []
    low = _lowest(place, least, lambda q: _free(checker, top, q))
    for count in range(len(low.joints), len(place.joints) + 1):
        path = ApproachPath(place.joints[:count], place.rise[:count])
        over = path.joints[-1]
        if found and not _free(checker, top, over):
            continue
        up = _lowest(pick, least, lambda q, over=over: _free(checker, q, over))
        found.append((2 * path.rise[-1] + up.rise[-1], up, path))
        if not studs or up.rise[-1] < STRAIGHT:
            break
    pick, place = min(found, key=lambda one: one[0])[1:]
    checker.empty(order.opening)
    if not _free(checker, start, pick.joints[-1]):
        pick = plan.pick
    return plan._replace(pick=pick, place=place)


def _above(checker: WorldChecker, over: ApproachPath, step: np.ndarray) -> np.ndarray | None:
    """Joints float64[n] [rad] with the empty tool above the next object, ``step`` float64[3] [m]
    from the end of an approach path over this one; None where it cannot be there."""
    arm = checker.arm
    position, rotation = forward(get_chain(arm), over.joints[-1])
    found = solve(arm, position + step, rotation, over.joints[-1], restarts=0)
    return found.joints if found.ok and checker.check(found.joints) is None else None


def rest_pose(arm: Arm, checker: WorldChecker) -> np.ndarray:
    """Where the arm waits, float64[n] [rad]: at home, or above it where something stands there."""
    position, rotation = forward(get_chain(arm), arm.home)
    for level in range(_MAX_LIFTS):
        found = solve(arm, position + level * _UP, rotation, arm.home)
        joints = arm.home if level == 0 else found.joints
        if found.ok and checker.check(joints) is None:
            return joints
    return arm.home


def _plan(
    checker: WorldChecker,
    order: Order,
    start: np.ndarray,
    returns: bool,
    near: np.ndarray | None = None,
) -> Approaches:
    """As ordered or with the hand turned: whatever meets less, then what turns less on the way.

    Args:
        checker: of the arm.
        order: what is asked.
        start: float64[n] where the arm is [rad].
        returns: whether it waits where it takes the object, not at home, when that is in its place.
        near: as of :func:`prepare`.
    """
    arm, height, given = checker.arm, order.height, order.move
    found: list[tuple[float, float, Approaches]] = []
    sized = order.scene.half is not None
    reasons: list[Failure] = []
    some = turns(arm, given) if near is None else ()
    others = (turned(order.scene, given, turn) for turn in some)
    for move in (given, *others):
        centre = order.scene.position[move.cell]
        checker.empty(order.opening)
        over = tool_path(centre, move.grasp, height, move.grasp.straight)
        pick = _choose(checker, approach_paths(arm, over, PRESS), order.target, sized)
        if isinstance(pick, str):
            reasons.append(Failure(Outcome.UNREACHABLE, "pick", pick))
            continue
        checker.carry(order.target, *order.in_hand(move.grasp), order.held)
        over = tool_path(move.target, move.place, height, upwards=True)
        place = _choose(checker, approach_paths(arm, over, order.below, near), None, sized)
        if isinstance(place, str):
            reasons.append(Failure(Outcome.UNREACHABLE, "place", place))
            continue
        leave = leaving(arm, move.target, move.place, height, place[0])
        if isinstance(leave, str):
            reasons.append(Failure(Outcome.UNREACHABLE, "retreat", leave))
            continue
        plan = Approaches(pick[0], place[0], leave, move, height)
        end = plan.pick.joints[-1] if returns else arm.home
        ways = [start, *plan.pick.joints[::-1], *plan.place.joints, end]
        found.append((pick[1] + place[1], travel_time(arm, ways), plan))
    if not found:
        raise reasons[0]
    return min(found, key=lambda one: one[:2])[2]


def leaving(
    arm: Arm, target: np.ndarray, attitude: Attitude, height: float, place: ApproachPath
) -> ApproachPath | str:
    """The path by which the hand leaves, on the branch of the one it came by."""
    if not attitude.apart:
        return place
    return approach_path(arm, tool_path(target, attitude, height), 0.0, place.joints[0])


def _choose(
    checker: WorldChecker,
    approaches: Iterator[ApproachPath | str],
    besides: int | None,
    sized: bool,
) -> tuple[ApproachPath, float] | str:
    """The first path that meets nothing but perhaps the object ``besides``, and 0, or, among things
    of any size, what it lacks of :data:`KEEP` [m]; else the first one, and 1: the motion will tell.
    If there is none, why."""
    first, reason = None, ""
    for found in approaches:
        if isinstance(found, str):
            reason = reason or found
            continue
        hit, room = None, KEEP
        for q, rise in zip(found.joints[1:], found.rise[1:], strict=True):
            hit = checker.near(q, 0.0, besides)[0]
            if hit is not None:
                break
            if rise >= LIFTED - 1e-9:
                room = min(room, checker.room(besides))
        if hit is None:
            return found, (KEEP - room // GRADE * GRADE if sized else 0.0)
        first = first or found
        if not hit.by_link:
            # Another branch moves the links, not what is at their end.
            break
    return reason if first is None else (first, 1)


def _across(
    arm: Arm, checker: WorldChecker, order: Order, plan: Approaches
) -> tuple[Approaches, np.ndarray]:
    """The plan, higher where that gives a straight free way, and the way."""
    checker.carry(order.target, *order.in_hand(plan.move.grasp), order.held)
    hit = checker.blocked(plan.pick.joints[-1], plan.place.joints[-1])
    for levels in range(1, MAX_RAISES + 1) if hit else ():
        higher = _raised(arm, order, plan, levels)
        if higher is None:
            break
        ends = higher.pick.joints[-1], higher.place.joints[-1]
        if checker.blocked(*ends) is None:
            return higher, np.array(ends)
    return plan, free_way(checker, plan.pick.joints[-1], plan.place.joints[-1], "cross")


def _raised(arm: Arm, order: Order, plan: Approaches, levels: int) -> Approaches | None:
    """The plan on the same branches, crossing some levels higher."""
    height, move = plan.height + levels * LEVEL, plan.move
    centre = order.scene.position[move.cell]
    over = tool_path(centre, move.grasp, height, move.grasp.straight)
    pick = approach_path(arm, over, PRESS, plan.pick.joints[0])
    over = tool_path(move.target, move.place, height, upwards=True)
    place = approach_path(arm, over, order.below, plan.place.joints[0])
    if isinstance(pick, str) or isinstance(place, str):
        return None
    leave = leaving(arm, move.target, move.place, height, place)
    return None if isinstance(leave, str) else Approaches(pick, place, leave, move, height)
