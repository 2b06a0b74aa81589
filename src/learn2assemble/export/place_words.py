"""What a person has to prepare before a robot runs a program, as data and in words.

Where blocks are taken from (:mod:`learn2assemble.motion.places`) in the world and in the base frame
of the robot's controller, and what else stands at the top of a program.
"""

from __future__ import annotations

import math
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix
from learn2assemble.kinematics.chain import forward_many, get_chain
from learn2assemble.motion.driver import driver_of
from learn2assemble.motion.places import Lying, PickPlace, half_turn, ranges
from learn2assemble.motion.program import Program
from learn2assemble.plants.settings import ProgramSettings
from learn2assemble.robot.arm import Arm, get_arm

PLACE_HEAD = ("Place", "Kind", "Blocks", "World, mm", "Turn", "Base, mm", "Refill")
"""Of the table of places, see :func:`place_rows`."""
_MOST_CORNERS = 24


class InBase(NamedTuple):
    """A place as the robot's controller sees it."""

    centre: np.ndarray
    """float64[3]: middle of a block, in the base frame of the controller [m]."""
    turn: float
    """Direction of its long side there: from x about z, above -pi/2, up to pi/2 [rad]."""
    tool: np.ndarray | None
    """float64[7]: the tool point there where it takes the block: x, y, z [m], quaternion
    (w, x, y, z); None: no attempt has held one."""


def world_in_base(
    arm: Arm, taught: tuple[float, ...] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Where the world lies in the base frame of the controller: position float64[3] [m], rotation
    float64[3, 3].

    Args:
        arm: as it stands in the plan.
        taught: x, y, z [m] and a rotation vector [rad] of another place, as it was taught.
    """
    if taught is not None:
        from scipy.spatial.transform import Rotation  # pyright: ignore[reportMissingTypeStubs]

        turned: Any = Rotation.from_rotvec(taught[3:])
        return np.array(taught[:3]), turned.as_matrix()
    base = driver_of(arm).base
    turn = quaternion_matrix(base[3:]).T
    return -turn @ base[:3], turn


def in_base(program: Program, arm: Arm, taught: tuple[float, ...] | None = None) -> list[InBase]:
    """The places of a program in the base frame of the controller.

    Args:
        program: with its places.
        arm: the one of the program.
        taught: where the world lies there, see :func:`world_in_base`.
    """
    middle, turn = world_in_base(arm, taught)
    found = list[InBase]()
    for place in program.places:
        tool = None
        for step in program.steps:
            if step.held is not None and step.pick is not None and step.pick.place == place.number:
                q = np.ascontiguousarray(program.knots.at(np.array([step.held[0]]))[0])
                (point,), (way,) = forward_many(get_chain(arm), q)
                tool = np.array([*(middle + turn @ point), *matrix_quaternion(turn @ way)])
                break
        found.append(InBase(*_seen_from_base(place, middle, turn), tool))
    return found


def places_data(program: Program, arm: Arm) -> list[dict[str, Any]]:
    """The places of a program as JSON says them: metres, radians."""
    return [
        {
            "place": place.number,
            "kind": place.kind,
            "size": place.size,
            "mass": round(place.mass, 6),
            "blocks": place.blocks,
            "steps": place.steps,
            "at_start": place.at_start,
            "refills": place.refills,
            "world": {"centre": place.centre, "turn": round(place.turn, 6)},
            "base": {"centre": base.centre, "turn": round(base.turn, 6), "tool": base.tool},
        }
        for place, base in zip(program.places, in_base(program, arm), strict=True)
    ]


def stands_data(program: Program, arm: Arm) -> list[dict[str, Any]]:
    """What else has to stand there as JSON says it: metres, radians."""
    return [
        {
            "name": one.name,
            "kind": one.kind,
            "size": one.size,
            "mass": round(one.mass, 6) if one.name else None,
            "by_hand": one.by_hand,
            "world": {"centre": one.centre, "turn": round(one.turn, 6)},
            "base": {"centre": centre, "turn": round(turn, 6)},
        }
        for one in program.stands
        for centre, turn in [_seen_from_base(one, *world_in_base(arm))]
    ]


def _seen_from_base(one: Lying, middle: np.ndarray, turn: np.ndarray) -> tuple[np.ndarray, float]:
    """Middle float64[3] [m] and direction of the long side [rad] of what lies somewhere in the base
    frame, in which the world is at ``middle`` float64[3], turned by ``turn`` float64[3, 3]."""
    yaw = math.atan2(turn[1, 0], turn[0, 0])
    return middle + turn @ one.centre, half_turn(one.turn + yaw)


def stands_words(program: Program) -> str:
    """How much else has to stand there, in a line; empty where nothing does."""
    counts = [sum(one.by_hand == by_hand for one in program.stands) for by_hand in (False, True)]
    words = (f"{counts[0]} from the start", f"{counts[1]} by hand during the build")
    told = " and ".join(one for one, count in zip(words, counts, strict=True) if count)
    return told and f"what else stands there: {told}"


def _refill_words(place: PickPlace) -> str:
    """Who lays blocks at a place, and when."""
    if not place.refills:
        return "lies there from the start, nothing to refill"
    first = "one lies there at the start" if place.at_start else "empty at the start"
    times = "once" if place.refills == 1 else f"{place.refills} times"
    return f"{first}; REFILL {times}, each before the step that takes it"


def place_rows(
    program: Program, arm: Arm, taught: tuple[float, ...] | None = None
) -> list[tuple[str, ...]]:
    """Rows below :data:`PLACE_HEAD`, arguments as of :func:`in_base`."""
    return [
        (
            str(place.number),
            _called(place),
            str(len(place.blocks)),
            _millimetres(place.centre),
            f"{_degrees(place.turn)}°",
            _millimetres(base.centre),
            place.refill_words,
        )
        for place, base in zip(program.places, in_base(program, arm, taught), strict=True)
    ]


def plain(text: str) -> str:
    """A name or a message as it may stand in a script: ASCII in one line, without quotes and what
    begins a comment."""
    one = " ".join(text.replace('"', "'").replace("#", "No ").split())
    return one.encode("ascii", "replace").decode()


def preparation(
    program: Program, arm: Arm, settings: ProgramSettings, refill: str, resume: int
) -> list[str]:
    """What a person prepares before a URScript program is run, a line each, plain ASCII.

    Args:
        program: what the robot is told.
        arm: the one of the program.
        settings: what stands at the top of the program.
        refill: who lays blocks where others were taken, ``hand`` or ``feeder``.
        resume: number of the first step that is carried out.
    """
    lines = [
        f"learn2assemble: {len(program.steps)} steps by the arm {program.arm} with the tool "
        f"{program.tool}.",
        "READ AND PREPARE THIS BEFORE THE FIRST RUN. Lengths in mm, angles in degrees.",
        "Steps and blocks are called as on the page, in plan.json and in what l2a build says.",
    ]
    if any(step.plan_step not in (None, step.number) for step in program.steps):
        lines.append("But: attempts failed in this build, so steps are counted as the page counts")
        lines.append("attempts. Build again without failures before you run this.")
    sections = (
        ("Frames", _frames(arm, settings)),
        ("Tool", _tool(program, arm, settings)),
        ("Blocks", _kinds(program)),
        ("Places blocks are taken from", _places(program, arm, settings, refill)),
        *(
            (title, _stands(program, arm, settings, by_hand))
            for title, by_hand in (("Stands there from the start", False), ("Set by hand", True))
            if any(one.by_hand == by_hand for one in program.stands)
        ),
        ("Order", _order(program)),
        ("Start", _start(program, settings, resume)),
        ("Speed", _speed(program, settings)),
        *((("The other arm", _other_arm(program, settings)),) * program.of_two),
    )
    for title, words in sections:
        lines += ["", f"{title}:", *(f"  {line}" for line in words)]
    return [_kept(line) for line in lines]


def _kept(line: str) -> str:
    """A line as it may stand in a script, indented as it is."""
    return " " * (len(line) - len(line.lstrip())) + " ".join(
        line.encode("ascii", "replace").decode().strip().splitlines()
    )


def _frames(arm: Arm, settings: ProgramSettings) -> list[str]:
    middle, turn = world_in_base(arm, settings.base_frame)
    yaw = math.atan2(turn[1, 0], turn[0, 0])
    as_planned = "as planned" if settings.base_frame is None else "as taught"
    facing = arm.base_yaw - get_arm(arm.name).base_yaw
    return [
        "world: x to the right of the design, y to its back, z up; the origin lies on the table,",
        "  in the middle of the design (not at the corner O of page and cards).",
        "base: the frame Base of the controller, in which the teach pendant shows positions.",
        f"base in the world: {_named(turn.T @ -middle)}, turned by {_degrees(-yaw)} about z",
        f"site in the base: the middle of the design is at {_named(middle)}, and the x of the",
        f"  world points {_degrees(yaw)} from the x of the base ({as_planned}: l2a_frame)",
        f"other files, as planned: plan.json, arm.base, has {_degrees(facing)}, the way the arm "
        "faces;",
        f"  trajectory.json, base_yaw, has {_degrees(arm.base_yaw)}, the turn of its simulated "
        "model.",
    ]


def _tool(program: Program, arm: Arm, settings: ProgramSettings) -> list[str]:
    driver, output, held = driver_of(arm), settings.output, settings.input
    level = "on" if output.on else "off"
    does = "the tool takes hold" if program.suction else "the gripper closes"
    kind = "digital" if held.threshold is None else f"analog (threshold {held.threshold:g} V)"
    return [
        f"{program.tool}: {1000 * driver.tool_mass:.0f} g, its tool point in the flange at "
        f"{_named(driver.tcp[:3])},",
        f"  turned against the flange by RPY {_turned(driver.tcp[3:])}",
        f"{does} while {output.bank} digital output {output.number} is {level}; that something is "
        "held says",
        f"  {held.bank} {kind} input {held.number}. Try both before the first run.",
    ]


def _kinds(program: Program) -> list[str]:
    kinds = dict[tuple[str, str, str], int]()
    for place in program.places:
        key = place.what, size_words(place), f"{1000 * place.mass:.0f} g"
        kinds[key] = kinds.get(key, 0) + len(dict.fromkeys(place.blocks))
    rows = [("kind", "number", "long x short x high, as it lies", "mass of one")]
    rows += [(kind, str(count), size, mass) for (kind, size, mass), count in kinds.items()]
    wide = [max(len(row[k]) for row in rows) for k in range(4)]
    return ["  ".join(f"{w:{n}}" for w, n in zip(row, wide, strict=True)).rstrip() for row in rows]


def size_words(place: Lying) -> str:
    """Long side, short side and height of a block as it lies [mm]."""
    return " x ".join(f"{1000 * v:.1f}" for v in place.size)


def _called(place: Lying) -> str:
    """What lies at a place; blocks without a name of their kind are told apart by their size."""
    return place.kind or f"{place.what} {size_words(place)}"


def _places(program: Program, arm: Arm, settings: ProgramSettings, refill: str) -> list[str]:
    lines = [
        "x, y, z: middle of the block as it lies; turn: of its long side, from x about z.",
        "A block stands wrong by as much as it lay wrong: lay blocks against a stop, closer to",
        "  their places than joints are wide, as l2a build says (joint_gap of the kit).",
    ]
    seen = in_base(program, arm, settings.base_frame)
    for place, base in zip(program.places, seen, strict=True):
        count = len(place.blocks)
        lines += [
            f"place {place.number}: {count} of {_called(place)}, "
            f"step{'s' * (len(place.steps) > 1)} {place.step_words}",
            f"  in the base:  {_named(base.centre)}, turn {_degrees(base.turn)}",
            f"  in the world: {_named(place.centre)}, turn {_degrees(place.turn)}",
        ]
        if base.tool is not None:
            lines.append(
                f"  tool point in the base as it takes the block: {_named(base.tool[:3])},"
            )
            lines.append(f"    RPY {_turned(base.tool[3:])}")
        lines += _corners(place)
        lines.append(f"  {_refill_words(place)}")
    if any(place.refills for place in program.places):
        lines += _refilled(refill)
    return lines


def _corners(one: Lying) -> list[str]:
    if one.corners is None or len(one.corners) > _MOST_CORNERS:
        return []
    shown = np.round(1000 * one.corners, 1) + 0.0
    points = [" ".join(f"{value:.1f}" for value in corner) for corner in shown]
    rows = [f"    {'; '.join(points[k : k + 4])}" for k in range(0, len(points), 4)]
    return ["  corners of the block in the world, x y z:", *rows]


def _stands(program: Program, arm: Arm, settings: ProgramSettings, by_hand: bool) -> list[str]:
    """What stands there from the start, or is set by hand: what, how large, where."""
    lines, frame = list[str](), world_in_base(arm, settings.base_frame)
    for one in program.stands:
        if one.by_hand == by_hand:
            centre, turn = _seen_from_base(one, *frame)
            lines += [
                f"{one.what}: {size_words(one)} mm" + f", {1000 * one.mass:.0f} g" * bool(one.name),
                f"  in the base:  {_named(centre)}, turn {_degrees(turn)}",
                f"  in the world: {_named(one.centre)}, turn {_degrees(one.turn)}",
                *_corners(one),
            ]
    return lines


def _refilled(refill: str) -> list[str]:
    first = "Who refills is said by l2a_refill_by_hand below:"
    by_hand = "by hand: the arm stops on its way back, away from the place, and asks for the block"
    feeder = "feeder: nothing is asked; the next block has to be there when the arm comes back,"
    mark = " (as exported)"
    return [
        first,
        f"  {by_hand}{mark * (refill == 'hand')}.",
        f"  {feeder}",
        "    and not before it has left with the last one: ways were checked with one block there.",
        f"    Its signal can be waited for in l2a_wait_for_block{mark * (refill == 'feeder')}.",
    ]


def _order(program: Program) -> list[str]:
    """Runs of steps that take from one place."""
    found = list[str]()
    for pick, group in groupby(program.steps, lambda step: step.pick and step.pick.place):
        steps = [step.number for step in group]
        many = f"step{'s' * (len(steps) > 1)} {ranges(steps)}"
        place = None if pick is None else program.places[pick - 1]
        where = "moves what the arm has put down before" if place is None else ""
        where = where or f"{_called(place) if place else ''} from place {pick}"
        found.append(f"{many}: {where}")
    found += [
        f"{hand.words}, before step {program.steps[hand.after].number}"
        if hand.after < len(program.steps)
        else f"{hand.words}, at the end"
        for hand in program.hands
    ]
    for wait in program.waits:
        step = next((one.number for one in program.steps if wait.time < one.end + 1e-9), None)
        goes = "at the end" if step is None else f"before step {step} goes on"
        found += [f"{words}, {goes}: the other program asks for it" for words in wait.hands]
    return found


def _start(program: Program, settings: ProgramSettings, resume: int) -> list[str]:
    index = next(k for k, step in enumerate(program.steps) if step.number == resume)
    begin = program.steps[index - 1].end if index else 0.0
    q = program.knots.at(np.array([begin]))[0][0]
    joints = ", ".join(f"{math.degrees(v) + 0.0:.1f}" for v in q)
    tolerance = math.degrees(settings.start_tolerance)
    return [
        f"bring the arm by hand to the joint positions [{joints}],",
        f"  base to wrist 3, each within {tolerance:.1f}: l2a_start checks that, stops with a "
        "message where",
        "  it is not so, else moves slowly to the exact position and opens the tool.",
        "after each lift and above each place l2a_check looks whether the block is held, and",
        "  halts where it is not.",
    ]


def _other_arm(program: Program, settings: ProgramSettings) -> list[str]:
    told = settings.other_arm or "not told yet, or of another make: l2a_other_arm below"
    return [
        "it builds at the same time and has a program of its own, which waits for this one, too.",
        f"its controller: {told}.",
        f"before a motion l2a_await stands until the other program has come so far, "
        f"{len(program.waits)} times;",
        "  l2a_done tells the other arm what is over. Start both anew when one was stopped.",
    ]


def _speed(program: Program, settings: ProgramSettings) -> list[str]:
    factor = settings.speed_factor
    fastest = math.degrees(float(np.abs(program.knots.velocity).max()))
    slow = ", for a first run" if factor <= 0.25 else ""
    return [
        f"l2a_factor = {factor:g} of the planned speed{slow}; about "
        f"{program.seconds / factor:.0f} s in all, without waiting.",
        f"The fastest joint turns by {factor * fastest:.0f} a second, as planned by {fastest:.0f}.",
        "When a whole run was watched, raise it, up to 1: below, as speed of the export, or as",
        "  speed_factor of a layout file (docs/layouts.md).",
    ]


def _named(position: np.ndarray) -> str:
    shown = np.round(1000 * position, 1) + 0.0
    return ", ".join(f"{name} {value:.1f}" for name, value in zip("xyz", shown, strict=True))


def _millimetres(position: np.ndarray) -> str:
    return ", ".join(f"{value:.1f}" for value in np.round(1000 * position, 1) + 0.0)


def _degrees(angle: float) -> str:
    return f"{round(math.degrees(angle), 1) + 0.0:.1f}"


def _turned(quaternion: np.ndarray) -> str:
    """Roll, pitch and yaw, as controllers of Universal Robots show them."""
    from scipy.spatial.transform import Rotation  # pyright: ignore[reportMissingTypeStubs]

    found: Any = Rotation.from_quat(quaternion, scalar_first=True)
    return ", ".join(f"{round(v, 1) + 0.0:.1f}" for v in found.as_euler("xyz", degrees=True))
