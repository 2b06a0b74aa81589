"""What a robot program has to know of the real cell: speed, inputs and outputs, the taught frame.

The section ``program`` of a layout file (``docs/layouts.md``); what it leaves out has a default.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from learn2assemble.errors import InputError, look_up, printable
from learn2assemble.files import read_text
from learn2assemble.values import (
    boolean,
    check_keys,
    integer,
    load_json,
    mapping,
    number,
    read_head,
    sequence,
    text,
    too_deep,
)

LAYOUT = "learn2assemble-layout"
"""``format`` of a layout file."""
SECTION = "program"
"""Key of these settings in a layout file."""
BANKS = {"tool": 2, "standard": 8}
"""Connectors of a controller and how many digital inputs, and outputs, they have."""
ANALOG = 2
"""Analog inputs of each connector."""
MOST_VOLTS, LONGEST_DWELL, WIDEST_START = 10.0, 10.0, 0.5
FIRST_RUN = 0.25
"""Share of the planned speed where nobody says another one."""
SLOWEST_SHARE = 0.001
FARTHEST_FRAME = 10.0
"""A base frame is no farther away along an axis [m]."""
_KEYS = ("speed_factor", "output", "input", "dwell", "start_tolerance", "base_frame", "other_arm")


class ToolOutput(NamedTuple):
    """The digital output that closes the gripper or turns the vacuum on."""

    bank: str = "tool"
    """A name of :data:`BANKS`."""
    number: int = 0
    on: bool = True
    """Its level while the tool holds."""


class HeldInput(NamedTuple):
    """The input that says that something is held."""

    bank: str = "tool"
    """A name of :data:`BANKS`."""
    number: int = 0
    held: bool = True
    """Its level while something is held; of an analog input, whether it is then at or above the
    threshold (True) or below it (False)."""
    threshold: float | None = None
    """Of an analog input [V]; None: the input is digital."""


@dataclass(frozen=True)
class ProgramSettings:
    """What stands at the top of a program for a controller."""

    speed_factor: float = FIRST_RUN
    """Above 0, up to 1: all speeds and accelerations are multiplied with it; slow where nothing is
    said, as for a first run."""
    output: ToolOutput = field(default_factory=ToolOutput)
    input: HeldInput = field(default_factory=HeldInput)
    dwell: float = 0.5
    """How long the arm waits after the tool has been told to close or to open [s]."""
    start_tolerance: float = 0.05
    """No joint may be farther from where the program starts [rad]."""
    base_frame: tuple[float, ...] | None = None
    """Pose of the plan's world frame in the base frame of the controller, as taught: x, y, z [m]
    and a rotation vector [rad]; None: where the plan has it."""
    other_arm: str = ""
    """Of a build by two: address of the controller of the other arm, a UR; empty: of another make,
    or not told yet."""


def read_settings(path: str | Path) -> ProgramSettings:
    """The section ``program`` of a layout file; nothing else of the file is looked at.

    Raises:
        InputError: one line that names the file and the JSON path of the fault.
    """
    content, source = read_text(Path(path), "layout file")
    try:
        root = load_json(content, source, LAYOUT)
        root = mapping(root, source)
        root = read_head(root, source, LAYOUT, 2, tuple(root), ("format", "version"))
        return parse_settings(root.get(SECTION, {}), f"{source}: {SECTION}")
    except RecursionError:
        raise too_deep(source) from None


def parse_settings(value: Any, where: str) -> ProgramSettings:
    """The settings a section holds.

    Args:
        value: of the key ``program``, from JSON.
        where: what messages call it.

    Raises:
        InputError: naming the key that is wrong.
    """
    given = _table(value, where, _KEYS)
    default = ProgramSettings()
    frame = given.get("base_frame")
    return ProgramSettings(
        _between(given, "speed_factor", default.speed_factor, SLOWEST_SHARE, 1.0, where),
        _output(given.get("output", {}), f"{where}.output"),
        _input(given.get("input", {}), f"{where}.input"),
        _between(given, "dwell", default.dwell, 0.0, LONGEST_DWELL, where),
        _between(given, "start_tolerance", default.start_tolerance, 1e-4, WIDEST_START, where),
        None if frame is None else _frame(frame, f"{where}.base_frame"),
        _host(given.get("other_arm", ""), f"{where}.other_arm"),
    )


def _host(value: Any, where: str) -> str:
    found = text(value, where)
    if not re.fullmatch(r"[A-Za-z0-9.-]{0,253}", found):
        raise InputError(where, printable(found), "an IP address or the name of a host")
    return found


def _output(value: Any, where: str) -> ToolOutput:
    given = _table(value, where, ToolOutput._fields)
    bank = _bank(given, where)
    on = boolean(given.get("on", True), f"{where}.on")
    return ToolOutput(bank, _count(given, where, BANKS[bank]), on)


def _input(value: Any, where: str) -> HeldInput:
    given = _table(value, where, HeldInput._fields)
    bank, threshold = _bank(given, where), None
    if given.get("threshold") is not None:
        threshold = _between(given, "threshold", 0.0, 0.0, MOST_VOLTS, where)
    most = BANKS[bank] if threshold is None else ANALOG
    held = boolean(given.get("held", True), f"{where}.held")
    return HeldInput(bank, _count(given, where, most), held, threshold)


def _bank(given: Mapping[str, Any], where: str) -> str:
    bank = text(given.get("bank", "tool"), f"{where}.bank")
    look_up(f"{where}.bank", bank, BANKS)
    return bank


def _count(given: Mapping[str, Any], where: str, count: int) -> int:
    found = integer(given.get("number", 0), f"{where}.number")
    if not 0 <= found < count:
        raise InputError(f"{where}.number", found, f"0 to {count - 1}")
    return found


def _between(
    given: Mapping[str, Any], key: str, default: float, low: float, high: float, where: str
) -> float:
    found = number(given.get(key, default), f"{where}.{key}")
    if not low <= found <= high:
        raise InputError(f"{where}.{key}", found, f"{low:g} to {high:g}")
    return found


def _frame(value: Any, where: str) -> tuple[float, ...]:
    expected = "[x, y, z, rx, ry, rz]: metres, and a rotation vector in radians"
    found = [number(item, where) for item in sequence(value, where, expected)]
    turn = math.hypot(*found[3:])
    if len(found) != 6 or max(map(abs, found[:3])) > FARTHEST_FRAME or turn > 2 * math.pi:
        raise InputError(where, value, f"{expected}, at most {FARTHEST_FRAME:g} m and 2 pi")
    return tuple(found)


def _table(value: Any, where: str, valid: tuple[str, ...]) -> Mapping[str, Any]:
    given = mapping(value, where)
    check_keys(given, where, "", valid, ())
    return given
