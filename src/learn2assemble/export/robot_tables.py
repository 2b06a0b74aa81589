"""Programs of robots as tables: one line a millisecond, for controllers that are streamed to.

A header in lines that begin with ``#`` says what is needed besides: joints, frames, limits, the
blocks before and after. Tables can be read back and played in the simulation
(``docs/robot_programs.md``).
"""

from __future__ import annotations

import gzip
import io
import json
import re
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.export.place_words import places_data, stands_data
from learn2assemble.files import read_bytes, write_file
from learn2assemble.geometry.hulls import Hull, hull_of
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.motion.driver import driver_of, stand
from learn2assemble.motion.files import studs_data, studs_from
from learn2assemble.motion.knots import Knots
from learn2assemble.motion.places import Blocks, Supply
from learn2assemble.motion.program import Program, ProgramStep, ToolState, Wait
from learn2assemble.motion.record import are_objects
from learn2assemble.robot.arm import Arm, Limits, get_arm
from learn2assemble.robot.moves import STAGES
from learn2assemble.values import load_json, rounded_array

FORMAT, VERSION = "learn2assemble-robot-program", 1
RATE = 1000
"""Lines of a table per second."""
CHUNK = 50_000
"""Lines that are made at once."""
MOST_BYTES = 1_000_000_000
"""Largest file that is read, unpacked."""
SLACK = 0.005
"""By this share the differences between the lines of a table may pass a limit: they are rounded."""


_NO_COLUMN = str.maketrans(dict.fromkeys(',"#\r\n', "_"))
"""What a word in a column of a table may not hold."""


# ---------------------------------------------------------------- what all files say


def header(program: Program, arm: Arm) -> dict[str, Any]:
    """What a reader of a program has to know besides its motion, for :func:`to_json`."""
    driver, limits, blocks = driver_of(arm), arm.bounds, program.blocks
    return {
        "format": FORMAT,
        "version": VERSION,
        "arm": program.arm,
        "tool": program.tool,
        "joints": driver.joints,
        "units": "s, m, rad, N, kg; quaternions w, x, y, z; world: z up, table top z = 0",
        "stand": np.append(arm.base_position, arm.base_yaw),
        "base": {"frame": driver.base_frame, "in": "world", "pose": driver.base},
        "tcp": {"frame": "tcp", "in": driver.flange_frame, "pose": driver.tcp},
        "limits": limits._asdict(),
        "seconds": round(program.seconds, 6),
        "stretch": round(program.stretch, 6),
        "gripper_speed": program.states[0].speed,
        "blocks": {
            "edge": blocks.edge,
            "half": blocks.half,
            "density": blocks.density,
            "hull": None
            if blocks.hull is None
            else [None if hull is None else hull.points for hull in blocks.hull],
            "objects": blocks.objects,
            "start": blocks.start,
            "end": blocks.end,
            "supply": [one._asdict() | {"time": round(one.time, 6)} for one in blocks.supply],
            **({} if blocks.studs is None else {"studs": studs_data(blocks.studs)}),
            **({"names": blocks.names, "kinds": blocks.kinds} if blocks.names else {}),
        },
        "places": places_data(program, arm),
        **({"stands": stands_data(program, arm)} if program.stands else {}),
        **(_waits(program) if program.of_two else {}),
        "hands": [hand._asdict() | {"time": round(time, 6)} for hand, time in program.asks],
        "steps": [
            {
                "step": step.number,
                "block": blocks.name(step.cells[0]),
                "cells": step.cells,
                "target": step.target,
                "end": round(step.end, 6),
                "reached": step.reached,
            }
            for step in program.steps
        ],
    }


def _waits(program: Program) -> dict[str, Any]:
    """What two arms wait for."""
    waits = [
        {
            "time": round(one.time, 6),
            "other": round(one.other, 6),
            "number": one.number,
            **({"hands": one.hands} if one.hands else {}),
        }
        for one in program.waits
    ]
    return {"waits": waits, "awaited": [round(time, 6) for time in program.awaited]}


def to_json(value: Any) -> str:
    """JSON, with arrays rounded to 1e-9."""

    def listed(array: np.ndarray) -> Any:
        return rounded_array(array, 9).tolist()

    return json.dumps(value, default=listed)


class Header(NamedTuple):
    """What a program is read with, besides its motion."""

    arm: Arm
    """With its tool, where it stood."""
    blocks: Blocks
    steps: tuple[ProgramStep, ...]
    seconds: float
    stretch: float
    speed: float
    """Of the gripper's opening [m/s]."""
    waits: tuple[Wait, ...]
    awaited: tuple[float, ...]


def read_header(data: Any, source: str, name: str) -> Header:
    """What a header says, which must be for the arm called ``name``.

    Raises:
        InputError: naming what is wrong.
    """
    default = get_arm(name)
    try:
        if data["format"] != FORMAT or data["version"] != VERSION:
            raise InputError(source, data["format"], f"{FORMAT}, version {VERSION}")
        if data["arm"] != name or tuple(data["joints"]) != driver_of(default).joints:
            expected = f"those of {name}: {', '.join(driver_of(default).joints)}"
            raise InputError(f"{source}: joints", f"{data['arm']}: {data['joints']}", expected)
        _check_limits(data["limits"], len(default.joints), source)
        arm = stand(name, str(data["tool"]), _array(data["stand"], 4))
        told = data["blocks"]
        objects = tuple(tuple(int(c) for c in cells) for cells in told["objects"])
        count = sum(map(len, objects))
        if sorted(c for cells in objects for c in cells) != list(range(count)):
            raise InputError(f"{source}: blocks", f"{count} cells", "each cell in one object")
        half = None if told["half"] is None else _array(told["half"], count, 3)
        density = None if told.get("density") is None else _array(told["density"], count)
        supply = tuple(
            Supply(float(one["time"]), cells, _array(one["poses"], len(cells), 7))
            for one in told["supply"]
            for cells in [tuple(one["cells"])]
        )
        blocks = Blocks(
            objects,
            float(told["edge"]),
            half,
            _array(told["start"], count, 7),
            _array(told["end"], count, 7),
            supply,
            density,
            None if told.get("hull") is None else tuple(map(_hull, told["hull"])),
            None if told.get("studs") is None else studs_from(told["studs"], count),
            *(_words(told.get(key, ()), count) for key in ("names", "kinds")),
        )
        steps = tuple(
            ProgramStep(
                int(one["step"]),
                tuple(one["cells"]),
                _array(one["target"], 7),
                float(one["end"]),
                one["reached"] is True,
                (),
                None,
            )
            for one in data["steps"]
        )
        moved = [*(step.cells for step in steps), *(one.cells for one in supply)]
        if not all(are_objects(cells, objects, blocks.studs) for cells in moved):
            raise InputError(f"{source}: steps", "cells that are no object", "cells of objects")
        numbers = _array([data[key] for key in ("seconds", "stretch", "gripper_speed")], 3)
        waits = tuple(
            Wait(
                float(one["time"]),
                float(one["other"]),
                int(one["number"]),
                tuple(map(str, one.get("hands", ()))),
            )
            for one in data.get("waits", ())
        )
        awaited = tuple(map(float, data.get("awaited", ())))
        seconds, stretch, speed = numbers.tolist()
        return Header(arm, blocks, steps, seconds, stretch, speed, waits, awaited)
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        got = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise InputError(f"{source}: header", got, "that of an exported program") from None


def _hull(corners: Any) -> Hull | None:
    return None if corners is None else hull_of(_array(corners, len(corners), 3))


def _words(value: Any, count: int) -> tuple[str, ...]:
    """A word for every cell, or none.

    Raises:
        ValueError: for another number of words.
    """
    found = tuple(map(str, value))
    if len(found) not in (0, count):
        raise ValueError(f"{len(found)} words for {count} cells")
    return found


def _check_limits(given: Any, joints: int, source: str) -> None:
    """Refuse a header whose limits no arm has.

    Raises:
        InputError: naming the one that is wrong.
    """
    table: Any = given
    limits = cast("dict[str, Any]", table) if isinstance(table, dict) else dict[str, Any]()
    for key in Limits._fields:
        if key not in limits:
            got = sorted(limits) if isinstance(table, dict) else given
            raise InputError(f"{source}: limits", got, f"{', '.join(Limits._fields)} per joint")
        found = _array(limits[key], joints)
        if key not in ("lower", "upper") and found.min() <= 0:
            raise InputError(f"{source}: limits.{key}", limits[key], "numbers above 0")
    if (_array(limits["lower"], joints) >= _array(limits["upper"], joints)).any():
        raise InputError(f"{source}: limits.lower", limits["lower"], "less than limits.upper")


def _array(value: Any, *shape: int) -> np.ndarray:
    """float64 of a shape, finite.

    Raises:
        ValueError: for anything else.
    """
    array = np.array(value, float).reshape(shape)
    if not np.isfinite(array).all():
        raise ValueError("a number that is not finite")
    return array


def changes(program: Program) -> Iterator[tuple[ToolState, set[str]]]:
    """Every state of the tool, and the names of what is new in it: in the first one, all."""
    before = None
    for state in program.states:
        pairs = zip(state, before or state, strict=True)
        new = [before is None or now != old for now, old in pairs]
        yield state, {name for name, told in zip(state._fields, new, strict=True) if told}
        before = state


# ---------------------------------------------------------------- tables


def write_table(program: Program, arm: Arm, path: Path, more: dict[str, Any] | None = None) -> None:
    """Write a table: a header in lines that begin with ``#``, then a line per millisecond."""
    head = {**header(program, arm), "rate": RATE, **(more or {})}
    fields = _tool_fields(program.suction, program.blocks)
    columns = _columns(fields, arm)
    count = int(np.ceil(program.seconds * RATE - 1e-6)) + 1
    lines = [f"# {key}: {to_json(value)}" for key, value in {**head, "rows": count}.items()]
    lines.append(",".join(name for name, _ in columns))
    out = io.BytesIO()
    packed = path.suffix == ".gz"
    with gzip.GzipFile("", "wb", 6, out, mtime=0) if packed else nullcontext(out) as file:
        file.write(("\n".join(lines) + "\n").encode())
        pattern = ",".join(form for _, form in columns).replace("%s", "%%s") + "\n"
        digits = [re.fullmatch(r"%\.(\d+)f", form) for _, form in columns if form != "%s"]
        least = np.array([0.5 * 10.0 ** -int(one[1]) if one else 1e-300 for one in digits])
        blocks = _block_of(program)
        tool = np.array([[float(getattr(s, f)) for f in fields] for s in program.states])
        for first in range(0, count, CHUNK):
            time = np.arange(first, min(first + CHUNK, count)) / RATE
            piece = program.knots.pieces(time)
            numbers = np.column_stack(
                [
                    time,
                    program.motion[piece],
                    program.step[piece],
                    *program.knots.at(time),
                    tool[program.states_at(time)],
                ]
            )
            stages: list[int] = program.stage[piece].tolist()
            names = [STAGES[k] if k >= 0 else "" for k in stages]
            steps: list[int] = program.step[piece].tolist()
            words = zip([blocks.get(k, "") for k in steps], names, strict=True)
            numbers[np.abs(numbers) < least] = 0.0  # no minus zero
            rows = zip(numbers.tolist(), words, strict=True)
            file.write("".join(pattern % tuple(row) % told for row, told in rows).encode())
    write_file(path, out.getvalue(), "program")


def _tool_fields(suction: bool, blocks: Blocks) -> list[str]:
    """What a table says of the tool, a column each."""
    fields = ["vacuum", "load"] if suction else ["width", "speed", "force", "load"]
    return fields if blocks.studs is None else [*fields, "press"]


def _columns(fields: list[str], arm: Arm) -> list[tuple[str, str]]:
    """Names of the columns of a table, and how their numbers are written.

    Digits are such that differences over a millisecond show the jerk within 0.1 rad/s^3.
    """
    columns = [("time", "%.3f"), ("motion", "%d"), ("step", "%d"), ("block", "%s")]
    for what, form in (("q", "%.10f"), ("dq", "%.8f"), ("ddq", "%.5f")):
        columns += [(f"{what}_{joint}", form) for joint in driver_of(arm).joints]
    columns += [(f, "%d" if f == "vacuum" else "%.6g") for f in fields]
    return [*columns, ("stage", "%s")]


def _block_of(program: Program) -> dict[int, str]:
    """What the block of every step is called, by its number, as a column may hold it."""
    name = program.blocks.name
    return {step.number: name(step.cells[0]).translate(_NO_COLUMN) for step in program.steps}


def read_table(path: Path, name: str) -> tuple[Program, Arm]:
    """Read what :func:`write_table` has written.

    Raises:
        InputError: see :func:`read_program`.
    """
    content, source = read_bytes(path, "program", MOST_BYTES)
    head, names, skipped = _split(content, source)
    rate = head.get("rate")
    ours = head.get("format") == FORMAT
    if ours and (isinstance(rate, bool) or not isinstance(rate, int | float) or rate != RATE):
        raise InputError(f"{source}: rate", rate, f"{RATE} lines a second")
    told = read_header(head, source, name)
    arm, suction = told.arm, told.arm.suction is not None
    fields = _tool_fields(suction, told.blocks)
    expected = [one for one, _ in _columns(fields, arm)]
    if names != expected:
        wrong = next((a for a, b in zip(names, expected, strict=False) if a != b), len(names))
        raise InputError(f"{source}: columns", wrong, ", ".join(expected))
    words = {"stage": "U12", "block": "U1"}  # Names stand in the header, too.
    kinds = [(one, words.get(one, "f8")) for one in expected]
    try:
        rows = np.loadtxt(
            io.BytesIO(content),
            delimiter=",",
            dtype=kinds,
            comments=None,
            ndmin=1,
            skiprows=skipped,
            encoding="utf-8",
        )
    except (ValueError, IndexError) as error:
        reason = str(error).partition(";")[0]
        raise InputError(source, reason, f"lines of {len(expected)} numbers") from None
    if head.get("rows") != len(rows) or len(rows) < 2:
        raise InputError(f"{source}: lines", len(rows), f"{head.get('rows')}: it is not complete")
    n = len(arm.joints)
    numbers = [one for one in expected if one not in words]
    table = np.column_stack([rows[one] for one in numbers])
    if not np.isfinite(table).all():
        i, j = np.argwhere(~np.isfinite(table))[0].tolist()
        raise InputError(f"{source}: {numbers[j]} of line {i + 1}", table[i, j], "a finite number")
    q, v, a = (table[:, 3 + k * n : 3 + (k + 1) * n] for k in range(3))
    knots = Knots(table[:, 0].copy(), q, v, a)
    _check_motion(knots, arm, source)
    stage = np.array([STAGES.index(one) if one in STAGES else -1 for one in rows["stage"]])
    program = Program(
        name,
        arm.tool_name,
        suction,
        knots,
        stage[1:].astype(np.int8),
        table[1:, 2].astype(np.int64),
        table[1:, 1].astype(np.int64),
        _states(rows, fields),
        told.steps,
        told.blocks,
        told.stretch,
        waits=told.waits,
        awaited=told.awaited,
    )
    return program, arm


def _split(content: bytes, source: str) -> tuple[dict[str, Any], list[str], int]:
    """Header, names of the columns, and how many lines these take."""
    head, count = dict[str, Any](), 0
    for count, raw in enumerate(io.BytesIO(content), 1):
        try:
            line = raw.decode().strip()
        except UnicodeDecodeError:
            raise InputError(source, "bytes that are not UTF-8", "an exported program") from None
        if not line.startswith("#"):
            if "format" in head:
                return head, line.split(","), count
            break
        key, colon, value = line[1:].strip().partition(": ")
        if colon:
            head[key] = load_json(value, f"{source}: {key}", FORMAT)
    raise InputError(source, "no header" if count else "an empty file", "an exported program")


def _check_motion(knots: Knots, arm: Arm, source: str) -> None:
    """Refuse what no robot should be sent: the differences from line to line are means of the
    velocity, acceleration and jerk between them."""
    limits, names = arm.bounds, driver_of(arm).joints
    step = np.diff(knots.time)
    if np.abs(step - 1 / RATE).max() > 1e-6:
        i = int(np.abs(step - 1 / RATE).argmax())
        raise InputError(
            f"{source}: time", f"{step[i]:g} s after {knots.time[i]:g} s", f"{1 / RATE:g} s"
        )

    def fault(wrong: np.ndarray, what: str, values: np.ndarray, most: np.ndarray) -> None:
        if wrong.any():
            i, j = np.argwhere(wrong)[0].tolist()
            where = f"{source}: {names[j]} at {knots.time[i]:.3f} s"
            raise InputError(where, f"{what} {values[i, j]:.4f}", f"at most {most[j]:.4f}")

    q, v, a = knots[1:]
    fault(q > limits.upper + 1e-6, "position", q, limits.upper)
    fault(q < limits.lower - 1e-6, "position below", -q, -limits.lower)
    for values, below, what, most in (
        (v, q, "velocity", limits.velocity),
        (a, v, "acceleration", limits.acceleration),
        (None, a, "jerk", limits.jerk),
    ):
        mean = np.diff(below, axis=0) * RATE
        for found in (mean,) if values is None else (values, mean):
            fault(np.abs(found) > most * (1 + SLACK), what, found, most)


def _states(rows: np.ndarray, fields: list[str]) -> tuple[ToolState, ...]:
    told = np.column_stack([rows[name] for name in fields])
    new = np.flatnonzero(np.any(np.diff(told, axis=0, prepend=np.nan), axis=1))
    nothing = ToolState(0.0, 0.0, 0.0, 0.0, False, 0.0)
    found = list[ToolState]()
    for k in new.tolist():
        state = nothing._replace(
            time=float(rows["time"][k]), **dict(zip(fields, told[k].tolist(), strict=True))
        )
        found.append(state._replace(vacuum=bool(state.vacuum)))
    return tuple(found)


def write_franka(program: Program, arm: Arm, path: Path) -> None:
    """A table for libfranka: lines of a motion are sent by its motion generator, one every
    millisecond, and between two motions the calls of the header are made, in their order.

    Raises:
        InputError: for an arm that is not by Franka.
    """
    if arm.name != "panda":
        raise InputError("format", f"franka for {arm.name}", "the arm panda, or the format csv")
    driver, calls = driver_of(arm), list[dict[str, Any]]()
    first, *later = changes(program)
    if not program.suction:
        width, speed = first[0].width, first[0].speed
        calls.append({"time": 0.0, "call": "move", "width": width, "speed": speed})
    for state, new in later:
        time = round(state.time, 6)
        if "load" in new:
            # The load hangs half a block below the tool point at most; its inertia is left out.
            centre = driver.tcp[:3]
            calls.append({"time": time, "call": "setLoad", "load": state.load, "centre": centre})
        if "press" in new:
            calls.append({"time": time, "call": "press", "force": state.press})
        if "vacuum" in new:
            calls.append({"time": time, "call": "vacuum" if state.vacuum else "dropOff"})
        if new & {"width", "force"}:
            call = {"time": time, "call": "move", "width": state.width, "speed": state.speed}
            if state.force:
                epsilon = {"epsilon_inner": 0.005, "epsilon_outer": 0.005}
                call |= {"call": "grasp", "force": state.force, **epsilon}
            calls.append(call)
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = quaternion_matrix(driver.tcp[3:]), driver.tcp[:3]
    write_table(program, arm, path, {"F_T_EE": frame.T.ravel(), "calls": calls})
