"""Programs of robots as files: URScript here, tables (:mod:`.robot_tables`), bags (:mod:`.ros2`).

All of them are made from the record that a build with an arm leaves, by way of a
:class:`~learn2assemble.robot.motion.program.Program` (``docs/robot_programs.md``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from learn2assemble.errors import InputError, look_up
from learn2assemble.export import asset
from learn2assemble.export.formats import file_at
from learn2assemble.export.robot_tables import (
    changes,
    motions,
    read_table,
    write_franka,
    write_table,
)
from learn2assemble.export.ros2 import is_bag, read_bag, write_bag
from learn2assemble.files import check_output, write_file
from learn2assemble.registry import Registry
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.kinematics import forward_many, get_chain
from learn2assemble.robot.motion.files import read_record
from learn2assemble.robot.motion.program import (
    Program,
    arm_of,
    driver_of,
    make_program,
    usage,
)
from learn2assemble.robot.motion.record import BuildRecord
from learn2assemble.robot.registry import ARMS

if TYPE_CHECKING:
    from learn2assemble.robot.dynamic.cell import DryRun

# ---------------------------------------------------------------- URScript

ROUND = 5e-4
"""A line between two joint positions is nowhere farther from the planned path [rad]."""
BLEND = 0.002
"""Corners on a curve are rounded by so much at most, measured at the tool point [m]."""
NEAR_END = (0.06, 0.01)
"""So far from where a motion ends the arm gets slower [m]: the last parts have speeds of their
own."""
SLOWEST = 0.02
"""No part of a path is moved along slower [rad/s], as some parts are hardly moved along at all."""


def write_urscript(program: Program, arm: Arm, path: Path) -> None:
    """A URScript program: moves along the joint positions of the planned path.

    It begins with ``def`` and ends with ``end`` in the first column and all else is indented, as
    controllers ask for on their port 30002, where it runs when it has been received.

    The path is cut into straight lines of the joints that stay within :data:`ROUND` of it, each a
    ``movej`` at most as fast as the planned motion is there. Where two lines meet on a curve the
    corner is blended by at most :data:`BLEND`; where the planned motion rests the arm stops.

    Raises:
        InputError: for an arm without six joints.
    """
    if len(arm.joints) != 6 or arm.name != "ur5e":
        raise InputError("format", f"urscript for {arm.name}", "the arm ur5e")
    from scipy.spatial.transform import Rotation

    tcp = driver_of(arm).tcp
    turn = Rotation.from_quat(tcp[3:], scalar_first=True).as_rotvec()
    about = f"{len(program.steps)} moves, {program.seconds:.0f} s, tool {program.tool}"
    text = asset("urscript.script")
    text = text.format(about=about, tcp=_list([*tcp[:3], *turn]))
    told = sorted(_told(program, float(tcp[2])), key=lambda one: one.time)
    checks = [time for step in program.steps for time in step.checks]
    lines = [f"movej([{_list(program.knots.position[0])}], a=0.5, v=0.5)"]
    for begin, end in motions(program):
        for part in _lines(program, arm, begin, end, checks):
            while told and told[0].time <= part.time + 1e-6:
                lines.append(told.pop(0).text)
            lines.append(part.text)
    lines += [one.text for one in told]
    text += "".join(f"  {line}\n" for line in lines) + "end\n"
    write_file(path, text, "program")


class _Line(NamedTuple):
    time: float
    """When it begins in the program [s]."""
    text: str


def _lines(
    program: Program, arm: Arm, begin: int, end: int, checks: list[float]
) -> Iterator[_Line]:
    """The moves of one motion, whose knots are begin..end."""
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
    stops |= set(np.searchsorted(knots.time, np.array(checks) - 1e-6) - begin)
    found = sorted(cuts)
    corners = found[:1]
    for a, b in pairwise(found):
        corners += _simplified(q, a, b)
    for k, (a, b) in enumerate(pairwise(corners)):
        lead = int(np.abs(q[b] - q[a]).argmax())
        v = float(np.clip(speed[a : b + 1, lead].max(), SLOWEST, limits.velocity[lead]))
        acceleration = float(np.clip(change[a : b + 1, lead].max(), 0.5, limits.acceleration[lead]))
        text = f"movej([{_list(q[b])}], a={acceleration:.3f}, v={v:.4f}"
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


def _told(program: Program, length: float) -> Iterator[_Line]:
    """What is done besides moving: the steps by their numbers, the tool, and checks; the load hangs
    ``length`` [m] from the flange."""
    begin = 0.0
    for step in program.steps:
        yield _Line(begin, f"# step {step.number}, block {step.cells[0]}")
        for time in step.checks:
            yield _Line(time, f"l2a_check({step.number}, {step.cells[0]})")
        begin = step.end
    (first, _), *later = changes(program)
    yield _Line(0.0, f"l2a_open({first.width:.4f}, {first.speed:.3f})")
    yield _Line(0.0, "set_payload(0.0, [0, 0, 0])")
    was_closed = bool(first.force) or first.vacuum
    for state, new in later:
        if "load" in new:
            yield _Line(state.time, f"set_payload({state.load:.3f}, [0, 0, {length:.4f}])")
        closed = bool(state.force) or state.vacuum
        if closed != was_closed:
            numbers = f"{state.width:.4f}, {state.speed:.3f}"
            call = f"close({numbers}, {state.force:.1f})" if closed else f"open({numbers})"
            yield _Line(state.time, f"l2a_{call}")
        was_closed = closed


def _list(values: Any) -> str:
    return ", ".join(f"{value + 0.0:.6f}" for value in np.round(np.asarray(values), 6))


# ---------------------------------------------------------------- all formats

PROGRAMS: Registry[tuple[str, Callable[[Program, Arm, Path], None]]] = Registry(
    "format",
    {
        "csv": ("program.csv", write_table),
        "franka": ("program_franka.csv", write_franka),
        "urscript": ("program.script", write_urscript),
        "ros2": ("program.mcap", write_bag),
    },
)
"""Usual file name and writer of every format."""


class Exported(NamedTuple):
    """A program that was written."""

    file: Path
    seconds: float
    """How long the robot takes [s]."""
    stretch: float
    """Largest factor by which the time of a motion was stretched to stay within the limits."""
    used: dict[str, float]
    """Largest share of the limits of velocity, acceleration and jerk, anywhere in the motion."""


def export_program(source: BuildRecord | str | Path, format: str, path: str | Path) -> Exported:
    """Write the program of a robot that repeats a build.

    Args:
        source: what ``l2a build --arm`` has written: its folder or its ``trajectory.json``; or
            the record of a plan, ``plan.record``.
        format: ``csv``, ``franka``, ``ros2`` or ``urscript``.
        path: the file, or a folder that gets a file of the usual name; a table whose name ends in
            ``.gz`` is packed.

    Raises:
        UnknownNameError: naming the nearest format.
        InputError: for a record that cannot be used, an arm the format is not for, and a file that
            cannot be written; an old one is left as it was then.
        MissingExtraError: for ``ros2`` without the extra ``ros2``.
    """
    name, write = PROGRAMS[format]
    file = file_at(path, name)
    check_output(file, "program")  # Before anything is read.
    if isinstance(source, str | Path):
        source = _read_record(Path(source))
    if not isinstance(source, BuildRecord):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise InputError("source", source, "a BuildRecord (of a plan its .record), or a folder")
    arm = arm_of(source.arm)
    program = make_program(source, arm)
    write(program, arm, file)
    used = usage(program.knots, arm.bounds)
    return Exported(file, program.seconds, program.stretch, used)


def _read_record(path: Path) -> BuildRecord:
    file = path / "trajectory.json" if path.is_dir() else path
    if file.name == "plan.json":
        file = file.with_name("trajectory.json")
    if not file.is_file():
        expected = "the folder of a build with an arm (l2a build --arm), or its trajectory.json"
        raise InputError("PLAN", str(path), expected)
    return read_record(file)


def read_program(path: str | Path, arm: str) -> tuple[Program, Arm]:
    """Read a program that :func:`export_program` has written as a table or a bag.

    Args:
        path: the file.
        arm: name of the arm that is to play it.

    Returns:
        the program, and the arm with its tool where it stood.

    Raises:
        InputError: for a file that is damaged, incomplete, or for another arm, and for motions
            beyond the limits of the arm.
        MissingExtraError: for a bag without the extra ``ros2``.
    """
    path = Path(path)
    look_up("arm", arm, ARMS)
    return (read_bag if is_bag(path) else read_table)(path, arm)


def replay_program(path: str | Path, arm: str) -> DryRun:
    """Play an exported table or bag in the dynamic cell, from beginning to end without looking.

    Args:
        path: what :func:`export_program` has written as ``csv``, ``franka`` or ``ros2``.
        arm: name of the arm that is to play it.

    Raises:
        InputError: see :func:`read_program`.
        MissingExtraError: without the extra ``robot``.
    """
    from learn2assemble.robot.dynamic.cell import play

    return play(*read_program(path, arm))
