"""From JSON text to the fields of a design, with the JSON path of whatever is wrong.

Only structure and types are checked here; ranges and geometry belong to
:mod:`learn2assemble.world.design_model`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.world.design_model import DEFAULT_NAMES, Design, Elevation

FORMAT, VERSION = "learn2assemble-design", 1
MAX_BYTES = 1_000_000
"""Largest design file [bytes]."""
_KEYS = (
    "format", "version", "name", "description", "units", "elevations", "blocks", "first_block",
    "success_threshold", "supports",
)  # fmt: skip
_REQUIRED = ("format", "version", "name", "elevations")


class _Object(dict[str, Any]):
    """A JSON object that remembers a key it was given twice."""

    repeated: str | None = None


def _object(pairs: list[tuple[str, Any]]) -> _Object:
    made = _Object()
    for key, value in pairs:
        if key in made:
            made.repeated = key
        made[key] = value
    return made


def load_json(text: str, source: str) -> Any:
    """``json.loads`` that keeps track of repeated keys; every fault is an :class:`InputError`."""
    if not text.strip():
        raise InputError(source, "an empty file", f"a JSON object of format {FORMAT!r}")
    try:
        return json.loads(text, object_pairs_hook=_object)
    except json.JSONDecodeError as error:
        where = f"{source}: line {error.lineno} column {error.colno}"
        raise InputError(where, error.msg, "JSON") from None
    except ValueError:  # Python's limit on the digits of an integer
        got = "an integer of thousands of digits"
        raise InputError(source, got, "numbers of ordinary size") from None
    except RecursionError:
        raise _too_deep(source) from None


def design_from(value: Any, source: str) -> Design:
    """The design in parsed JSON ``value``; ``source`` begins every message.

    Raises:
        InputError: naming the JSON path, for example ``house.json: elevations[1].outline[3]``.
    """
    try:
        return _design(value, source)
    except RecursionError:
        raise _too_deep(source) from None


def _too_deep(source: str) -> InputError:
    return InputError(source, "brackets nested too deeply", "the five levels of a design")


def _design(value: Any, source: str) -> Design:
    root = _mapping(value, source)
    # The format comes first: a foreign file should say that it is foreign.
    if "format" in root and root["format"] != FORMAT:
        raise InputError(f"{source}: format", root["format"], repr(FORMAT))
    _check_keys(root, source, "", _KEYS, _REQUIRED)
    version = _integer(root["version"], f"{source}: version")
    if version != VERSION:
        raise InputError(f"{source}: version", version, f"{VERSION}")
    if root.get("units", "m") != "m":
        raise InputError(f"{source}: units", root["units"], "'m'; all lengths are metres")
    sides = _sequence(root["elevations"], f"{source}: elevations", "1 to 4 elevations")
    if not 1 <= len(sides) <= len(DEFAULT_NAMES):
        raise InputError(f"{source}: elevations", f"{len(sides)} of them", "1 to 4 elevations")
    elevations = tuple(_elevation(side, k, source) for k, side in enumerate(sides))
    blocks = root.get("blocks")
    fields: dict[str, Any] = {
        "name": _text(root["name"], f"{source}: name"),
        "elevations": elevations,
        "num_blocks": None if "blocks" not in root else _integer(blocks, f"{source}: blocks"),
        "description": _text(root.get("description", ""), f"{source}: description"),
    }
    if "first_block" in root:
        fields["first_elevation"] = _first_block(root["first_block"], source)
    if "success_threshold" in root:
        where = f"{source}: success_threshold"
        fields["success_threshold"] = _number(root["success_threshold"], where)
    if "supports" in root:
        if not isinstance(root["supports"], bool):
            raise InputError(f"{source}: supports", root["supports"], "true or false")
        fields["supports"] = root["supports"]
    try:
        return Design(**fields)
    except InputError as error:
        raise InputError(f"{source}: {error.what}", error.got, error.expected) from None


def _first_block(value: Any, source: str) -> int:
    first = _mapping(value, f"{source}: first_block")
    _check_keys(first, source, "first_block", ("elevation",), ("elevation",))
    return _integer(first["elevation"], f"{source}: first_block.elevation")


def _elevation(value: Any, index: int, source: str) -> Elevation:
    path = f"elevations[{index}]"
    side = _mapping(value, f"{source}: {path}")
    _check_keys(side, source, path, ("name", "outline"), ("outline",))
    name = _text(side.get("name", DEFAULT_NAMES[index]), f"{source}: {path}.name")
    where = f"{source}: {path}.outline"
    vertices = _sequence(side["outline"], where, "a list of [x, z] vertices")
    outline = [_vertex(vertex, f"{where}[{k}]") for k, vertex in enumerate(vertices)]
    try:
        return Elevation(name, np.array(outline, np.float64).reshape(-1, 2))
    except InputError as error:
        raise InputError(f"{source}: {path}.{error.what}", error.got, error.expected) from None


def _vertex(value: Any, where: str) -> list[float]:
    pair = _sequence(value, where, "[x, z], two numbers in metres")
    if len(pair) != 2:
        raise InputError(where, value, "[x, z], two numbers in metres")
    return [_number(number, where) for number in pair]


def _check_keys(
    given: Mapping[str, Any], source: str, path: str, valid: tuple[str, ...], need: tuple[str, ...]
) -> None:
    where = f"{source}: key of {path}" if path else f"{source}: key"
    repeated = getattr(given, "repeated", None)
    if repeated is not None:
        raise InputError(where, repeated, "every key once")
    for key in given:
        if key not in valid:
            raise UnknownNameError(where, key, valid)
    for key in need:
        if key not in given:
            wanted = f"the key {key!r}" + (f" in {path}" if path else "")
            raise InputError(f"{source}: {path}" if path else source, sorted(given), wanted)


def _mapping(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(where, value, "a JSON object {...}")
    return value


def _sequence(value: Any, where: str, expected: str) -> list[Any] | tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise InputError(where, value, expected)
    return value


def _text(value: Any, where: str) -> str:
    if not isinstance(value, str):
        raise InputError(where, value, "text")
    return value


def _integer(value: Any, where: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise InputError(where, value, "an integer")
    return value


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(where, value, "a number")
    try:
        number = float(value)
    except OverflowError:
        raise InputError(where, "a number beyond 1e308", "a finite number") from None
    if not np.isfinite(number):
        raise InputError(where, value, "a finite number")
    return number
