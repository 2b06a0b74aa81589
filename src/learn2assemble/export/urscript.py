"""Programs for the controllers of Universal Robots (URScript).

What a user may want to change stands at the top of every program as variables with names.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.linalg import norm

from learn2assemble.errors import InputError
from learn2assemble.export import asset
from learn2assemble.export.place_words import plain, preparation, size_words, world_in_base
from learn2assemble.export.robot_tables import changes
from learn2assemble.files import write_file
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.kinematics.chain import forward_many, get_chain
from learn2assemble.motion.driver import driver_of, pose_vector
from learn2assemble.motion.program import Program, ProgramStep, Wait, motions
from learn2assemble.motion.waits import BY_HAND
from learn2assemble.plants.settings import ProgramSettings
from learn2assemble.robot.arm import Arm

ROUND = 5e-4
"""A line between two joint positions is nowhere farther from the planned path [rad]."""
BLEND = 0.002
"""Corners on a curve are rounded by so much at most, measured at the tool point [m]."""
NEAR_END = (0.06, 0.01)
"""So far from where a motion ends the arm gets slower [m]: the last parts have speeds of their
own."""
SLOWEST = 0.02
"""No part of a path is moved along slower [rad/s], as some parts are hardly moved along at all."""
MOST_SHIFT, MOST_TURN = 0.1, 0.2
"""A taught work plane is no farther from the planned one [m], [rad]: the path was checked there."""


_OTHER_ARM = """\
  # address of the controller of the other arm, if that is a UR; else "", and whoever drives the
  # other arm reads register 128 of this controller by Modbus (port 502) and writes register 129
  global l2a_other_arm = "{host}"
  global l2a_over = 0
"""
_MEET = """\
  # What the other arm waits for and is over is counted in register 128 here and 129 there, from 1,
  # which says that the program has begun.
  def l2a_done(number):
    l2a_over = number
    write_port_register(128, number + 1)
    if (l2a_other_arm != ""):
      modbus_set_output_register("l2a_other_arm", number + 1, False)
    end
  end
  # The arm stands until so much of the other program is over.
  def l2a_await(number):
    while (read_port_register(129) <= number):
      l2a_done(l2a_over)
      sleep(0.02)
    end
  end
  # Both programs are started anew, in any order; neither moves before both have begun.
  def l2a_meet():
    write_port_register(129, 0)
    if (l2a_other_arm != ""):
      modbus_add_signal(l2a_other_arm, 255, 129, 3, "l2a_other_arm")
    end
    l2a_await(0)
  end
"""
"""Added to the programs of two arms; registers 128 to 255 are free in the controllers of UR."""


def write_urscript(
    program: Program,
    arm: Arm,
    path: Path,
    settings: ProgramSettings | None = None,
    resume_from: int | None = None,
    refill: str = "hand",
) -> None:
    """A URScript program: moves along the joint positions of the planned path.

    Comments at its top say what a person has to prepare (:func:`~.place_words.preparation`).

    It begins with ``def`` and ends with ``end`` in the first column and all else is indented, as
    controllers ask for on their port 30002, where it runs when it has been received.

    The path is cut into straight lines of the joints that stay within :data:`ROUND` of it, each a
    ``movej`` at most as fast as the planned motion is there. Where two lines meet on a curve the
    corner is blended by at most :data:`BLEND`; where the planned motion rests the arm stops. Each
    step is left out where the program resumes from a later one.

    Args:
        program: what the robot is told.
        arm: the one of the program.
        path: the file.
        settings: what stands at the top; by default the defaults.
        resume_from: number of the first step that is carried out; by default the first one.
        refill: who lays blocks where others were taken: ``hand``, and the program asks for each, or
            ``feeder``.

    Raises:
        InputError: for an arm without six joints, a step that the program does not have, and a
            taught work plane far from the planned one.
    """
    if len(arm.joints) != 6 or arm.name != "ur5e":
        raise InputError("format", f"urscript for {arm.name}", "the arm ur5e")
    text = _head(program, arm, settings or ProgramSettings(), resume_from, refill)
    asks = list(_asks(program, arm))
    told = sorted(_told(program, arm, asks), key=lambda one: (one.time, one.rank))
    halts = [time for step in program.steps for time in step.checks]
    halts += [ask.time for ask in asks if ask.time is not None]
    lines: list[str] = []
    for begin, end in motions(program):
        for part in _lines(program, arm, begin, end, halts):
            while told and told[0].time <= part.time + 1e-6:
                lines.append(told.pop(0).text)
            lines.append(part.text)
    lines += [*(one.text for one in told), "end"]
    deep = 1
    for line in (line for block in lines for line in block.splitlines()):
        deep -= line == "end"
        text += f"{'  ' * deep}{line}\n"
        deep += line.startswith("if ")
    text += "end\n"
    write_file(path, text, "program")


def _head(
    program: Program, arm: Arm, settings: ProgramSettings, resume_from: int | None, refill: str
) -> str:
    """The variables and functions at the top, and what is done before the first step."""
    numbers = [step.number for step in program.steps]
    resume = numbers[0] if resume_from is None else resume_from
    if isinstance(resume, bool) or resume not in numbers:
        near = [n for n in numbers if abs(n - resume) <= 2]
        words = f"a step of this arm, from {numbers[0]} to {numbers[-1]}"
        words += f", as {' or '.join(map(str, near))}" if near else ""
        raise InputError("resume_from", resume, words)
    about = preparation(program, arm, settings, refill, resume)
    driver = driver_of(arm)
    planned = planned_frame(arm)
    taught = planned if settings.base_frame is None else np.array(settings.base_frame)
    _check_taught(taught, planned)
    output, held = settings.output, settings.input
    return asset("urscript.script").format(
        about="\n".join(f"  # {line}".rstrip() for line in about),
        by_hand=refill == "hand",
        factor=f"{settings.speed_factor:g}",
        resume=resume,
        first=numbers[0],
        last=numbers[-1],
        output_bank=output.bank,
        output=output.number,
        on=output.on,
        input_bank=held.bank,
        input=held.number,
        held=held.held,
        threshold=-1.0 if held.threshold is None else f"{held.threshold:g}",
        dwell=f"{settings.dwell:g}",
        tolerance=f"{settings.start_tolerance:g}",
        frame=_list(taught),
        planned=_list(planned),
        mass=f"{driver.tool_mass:.4f}",
        centre=_list(driver.tool_centre),
        tcp=_list(pose_vector(driver.tcp)),
        other_arm=_OTHER_ARM.format(host=settings.other_arm) if program.of_two else "",
        meet=_MEET if program.of_two else "",
        begin="  l2a_meet()\n" if program.of_two else "",
    )


def planned_frame(arm: Arm) -> np.ndarray:
    """float64[6]: the world frame in the base frame of the controller as the arm stands in the
    plan: x, y, z [m] and a rotation vector [rad]."""
    from scipy.spatial.transform import Rotation  # pyright: ignore[reportMissingTypeStubs]

    middle, turn = world_in_base(arm)
    return np.concatenate([middle, Rotation.from_matrix(turn).as_rotvec()])


def _check_taught(taught: np.ndarray, planned: np.ndarray) -> None:
    from scipy.spatial.transform import Rotation  # pyright: ignore[reportMissingTypeStubs]

    turn = Rotation.from_rotvec(taught[3:]) * Rotation.from_rotvec(planned[3:]).inv()
    if norm(taught[:3] - planned[:3]) > MOST_SHIFT or turn.magnitude() > MOST_TURN:
        near = f"{MOST_SHIFT:g} m and {MOST_TURN:g} rad"
        expected = f"within {near} of the planned one, [{_list(planned)}]; else plan for that stand"
        raise InputError("base_frame", f"[{_list(taught)}]", expected)


class _Line(NamedTuple):
    time: float
    """When it begins in the program [s]."""
    text: str
    rank: int = 1
    """Of those of one time: what is over is told first, and the tool is told something last."""


def _lines(program: Program, arm: Arm, begin: int, end: int, halts: list[float]) -> Iterator[_Line]:
    """The moves of one motion, whose knots are begin..end; at ``halts`` [s] the robot stands."""
    knots, limits = program.knots, arm.bounds
    q = knots.position[begin : end + 1]
    speed = np.abs(knots.velocity[begin : end + 1])
    change = np.abs(knots.acceleration[begin : end + 1])
    tool, _ = forward_many(get_chain(arm), np.ascontiguousarray(q))
    stage = program.stage[begin:end]
    cuts = {0, len(q) - 1, *(np.flatnonzero(np.diff(stage)) + 1).tolist()}
    for distance in NEAR_END:
        left = np.linalg.norm(tool - tool[-1], axis=1)
        cuts.add(int(np.flatnonzero(left > distance)[-1]) + 1 if (left > distance).any() else 0)
    stops = {k for k in range(len(q)) if speed[k].max() < 5 * SLOWEST}
    halted: list[int] = (np.searchsorted(knots.time, np.array(halts) - 1e-6) - begin).tolist()
    stops |= set(halted)
    cuts |= {k for k in halted if 0 < k < len(q) - 1}
    found = sorted(cuts)
    corners = found[:1]
    for a, b in pairwise(found):
        corners += _simplified(q, a, b)
    for k, (a, b) in enumerate(pairwise(corners)):
        lead = int(np.abs(q[b] - q[a]).argmax())
        v = float(np.clip(speed[a : b + 1, lead].max(), SLOWEST, limits.velocity[lead]))
        acceleration = float(np.clip(change[a : b + 1, lead].max(), 0.5, limits.acceleration[lead]))
        text = f"movej(l2a_at([{_list(q[b])}]), "
        text += f"a={acceleration:.3f} * l2a_factor, v={v:.4f} * l2a_factor"
        if b < len(q) - 1 and b not in stops:
            ways = np.linalg.norm(np.diff(tool[[a, b, corners[k + 2]]], axis=0), axis=1)
            # Blends of two corners must not meet.
            text += f", r={min(BLEND, 0.4 * float(ways.min())):.5f}"
        yield _Line(float(knots.time[begin + a]), f"{text})")


def _simplified(q: np.ndarray, first: int, last: int) -> list[int]:
    """Rows after ``first``, up to ``last``, such that straight lines between them are nowhere
    farther than :data:`ROUND` from the path float64[k, n] (Ramer 1972)."""
    chord = q[last] - q[first]
    length = float(chord @ chord)
    inside = q[first + 1 : last] - q[first]
    share = np.clip(inside @ chord / length, 0, 1) if length else np.zeros(len(inside))
    off = np.abs(inside - share[:, None] * chord).max(1, initial=0.0)
    if not len(off) or off.max() <= ROUND:
        return [last]
    middle = first + 1 + int(off.argmax())
    return _simplified(q, first, middle) + _simplified(q, middle, last)


def _told(program: Program, arm: Arm, asks: list[_Ask]) -> Iterator[_Line]:
    """What is done besides moving: the steps by their numbers, the tool, and checks."""
    begin = 0.0
    yield from (_Line(ask.time, ask.call) for ask in asks if ask.time is not None)
    for k, step in enumerate(program.steps):
        first = program.knots.at(np.array([begin]))[0][0]
        state = program.states[int(program.states_at(np.array([begin]))[0])]
        told = [_asked_on_resuming(ask, step.number) for ask in asks if ask.after == k]
        halts = (time for hand, time in program.asks if hand.after == k)
        yield _Line(
            max(begin, next(halts, begin)),
            "end\n" * bool(k)
            + (
                f"# step {_step_words(program, step)}\n"
                f"{_told_before(program, begin)}"
                f"if (l2a_resume_from <= {step.number}):\n"
                f"{_pauses(program, k)}{''.join(told)}"
                f"l2a_start({step.number}, [{_list(first)}], {state.width:.4f}, {state.speed:.3f})"
            ),
        )
        for time in step.checks:
            name = plain(program.blocks.name(step.cells[0]))
            yield _Line(time, f'l2a_check({step.number}, "{name}")')
        begin = step.end
    last = _pauses(program, len(program.steps))
    left = [ask.call for ask in asks if ask.after == len(program.steps) and ask.time is None]
    if last or left:
        yield _Line(begin, last + "\n".join(left))
    begins = np.array(program.halts)
    for k, time in enumerate(program.awaited, 1):
        if not _near(time, begins + BY_HAND):
            yield _Line(time, f"l2a_done({k})", 0)
    for one in program.waits:
        if not _near(one.time, begins):
            yield _Line(one.time, _await(one), 2)
    (first, _), *later = changes(program)
    was_closed = bool(first.force) or first.vacuum
    for state, new in later:
        if "load" in new:
            yield _Line(state.time, _payload(program, arm, state.time, state.load), 3)
        if "press" in new and state.press:
            yield _Line(state.time, f"l2a_press({state.press:.1f})", 3)
        closed = bool(state.force) or state.vacuum
        if closed != was_closed:
            numbers = f"{state.width:.4f}, {state.speed:.3f}"
            call = f"close({numbers}, {state.force:.1f})" if closed else f"open({numbers})"
            yield _Line(state.time, f"l2a_{call}", 3)
        was_closed = closed


def _pauses(program: Program, done: int) -> str:
    """Calls that wait for what is done by hand after so many steps, one a line; of a build by two,
    for what of the other arm comes before it, and they tell the other arm when it is done."""
    lines = list[str]()
    for hand, time in program.asks:
        if hand.after != done:
            continue
        begin, halts = np.array([time]), bool(program.halts)
        lines += [_await(one) for one in program.waits if halts and _near(one.time, begin)]
        lines.append(f'popup("{plain(hand.words)}, then go on", title="l2a", blocking=True)')
        over = (n for n, t in enumerate(program.awaited, 1) if halts and _near(t, begin + BY_HAND))
        lines += [f"l2a_done({number})" for number in over]
    return "".join(f"{line}\n" for line in lines)


def _near(time: float, times: np.ndarray) -> bool:
    return bool((np.abs(times - time) < 1e-6).any())


def _await(wait: Wait) -> str:
    """The call that waits for the other arm, and for what is done by hand there."""
    told = [f"# {plain(words)}: the other program asks for it\n" for words in wait.hands]
    return "".join(told) + f"l2a_await({wait.number})"


def _step_words(program: Program, step: ProgramStep) -> str:
    """The comment of a step: number, block, where that comes from and where it goes."""
    blocks, cell = program.blocks, step.cells[0]
    kind = blocks.kinds[cell] if blocks.kinds else ""
    said = f"{step.number}: {blocks.name(cell)}{f' ({kind})' * bool(kind)}"
    if step.plan_step not in (None, step.number):
        said = said.replace(":", f", an attempt at step {step.plan_step} of the plan:", 1)
    where = "where it was put before" if step.pick is None else f"place {step.pick.place}"
    x, y, z = (np.round(1000 * step.target[:3], 1) + 0.0).tolist()
    said += f" from {where} to x {x:.1f}, y {y:.1f}, z {z:.1f} mm"
    said += "" if step.turn is None else f", turn {np.round(np.degrees(step.turn), 1) + 0.0:.1f}"
    said += " (world)"
    return plain(said + " (failed in the build)" * (not step.reached))


def _told_before(program: Program, begin: float) -> str:
    """A line that tells the other arm what is over before a step, also where it is left out."""
    over = sum(time <= begin + 1e-9 for time in program.awaited)
    return f"l2a_done({over})\n" * bool(over)


class _Ask(NamedTuple):
    """What someone has to do by hand at a place where the arm takes blocks or puts them back."""

    after: int
    """So many steps are done before."""
    time: float | None
    """When the arm stands and waits for it [s]; None: before the next step begins."""
    call: str
    """A function of the script, and what it is told."""


def _asks(program: Program, arm: Arm) -> Iterator[_Ask]:
    """What is asked for, in order: blocks to be laid, and blocks to be taken away."""
    begin = 0.0
    for k, step in enumerate(program.steps):
        if step.pick is not None and step.pick.refill:
            hand = program.places[step.pick.place - 1].centre
            time = _aside(program, arm, k, hand)
            yield _Ask(k, time, f"l2a_wait_for_block({_wanted(program, step)})")
        taken = {c for hand in program.hands if hand.after == k + 1 for c in hand.cells}
        for one in program.blocks.supply:
            if taken.issuperset(one.cells):
                continue  # It is asked for as a step by hand.
            if program.of_two and not set(one.cells) & set(step.cells):
                continue  # The other arm has put it back.
            if begin + 1e-9 < one.time <= step.end + 1e-9 and one.poses[0, 2] < 0:
                name = plain(program.blocks.name(one.cells[0]))
                words = f"take {name} away, where the arm has put it down, then go on"
                (hand,) = _tool(program, arm, [step.end if step.held is None else step.held[1]])
                time = _aside(program, arm, k + 1, hand)
                yield _Ask(k + 1, time, f'l2a_wait_until_taken("{name}", "{words}")')
        begin = step.end


def _asked_on_resuming(ask: _Ask, number: int) -> str:
    """Lines that ask in a step: who goes on from it was not asked in the step before."""
    if ask.time is None:
        return f"{ask.call}\n"
    return f"if (l2a_resume_from == {number}):\n{ask.call}\nend\n"


def _wanted(program: Program, step: ProgramStep) -> str:
    """The block that someone has to lay at its place, as arguments of ``l2a_wait_for_block``."""
    assert step.pick is not None
    place = program.places[step.pick.place - 1]
    kind = plain(place.what)
    words = f"step {step.number}: lay one {kind} ({size_words(place)} mm) at place {place.number}"
    return f'{place.number}, "{kind}", "{words}, then go on"'


def _aside(program: Program, arm: Arm, after: int, hand: np.ndarray) -> float | None:
    """When the arm waits while somebody's hand is at a place.

    In the last of the steps that are done, empty, where the tool is farthest from the hand: at the
    end of a step it is right over the next block, or over what it has just put down.

    Args:
        after: so many steps are done.
        hand: float64[3] [m, world].

    Returns:
        float | None: [s]; None before the first step.
    """
    if not after:
        return None
    last = program.steps[after - 1]
    begin = program.steps[after - 2].end if after > 1 else 0.0
    empty = begin if last.held is None else last.held[1]
    time = program.knots.time
    times = time[(time > empty + 1e-6) & (time < last.end - 1e-6)]
    if not len(times):
        return None
    return float(times[norm(_tool(program, arm, times) - hand, axis=1).argmax()])


def _tool(program: Program, arm: Arm, times: Any) -> np.ndarray:
    """float64[k, 3]: where the tool is at times [s] [m, world]."""
    q = program.knots.at(np.asarray(times))[0]
    return forward_many(get_chain(arm), np.ascontiguousarray(q))[0]


def _payload(program: Program, arm: Arm, time: float, load: float) -> str:
    """What the flange carries from a time on: the tool, and with a load the block as it is held."""
    if not load:
        return "set_payload(l2a_tool_mass, l2a_tool_centre)"
    number = next(
        (k for k, step in enumerate(program.steps) if time < step.end), len(program.steps) - 1
    )
    driver = driver_of(arm)
    centre = held_centre(program, arm, program.steps[number], number)
    mass = driver.tool_mass + load
    both = (driver.tool_mass * driver.tool_centre + load * centre) / mass
    return f"set_payload({mass:.4f}, [{_list(both)}])"


def held_centre(program: Program, arm: Arm, step: ProgramStep, index: int) -> np.ndarray:
    """float64[3]: centre of mass of what a step holds, in the frame of the flange [m].

    Args:
        index: of the step in the program; the step before says where the cells are.
    """
    assert step.held is not None, "a load without a grip"
    blocks, cells = program.blocks, list(step.cells)
    before = program.steps[index - 1].after if index else None
    poses = blocks.start if before is None else before
    masses = np.array([blocks.mass([cell]) for cell in cells])
    centre = masses @ blocks.middles(cells, poses) / masses.sum()
    q = np.ascontiguousarray(program.knots.at(np.array([step.held[0]]))[0])
    (tool,), (turn,) = forward_many(get_chain(arm), q)
    tcp = driver_of(arm).tcp
    # From the world to the tool point, and from there to the flange.
    return tcp[:3] + quaternion_matrix(tcp[3:]) @ (turn.T @ (centre - tool))


def _list(values: Any) -> str:
    return ", ".join(f"{value + 0.0:.6f}" for value in np.round(np.asarray(values), 6))
