"""From JSON text to the fields of a design, with the JSON path of whatever is wrong.

Only structure and types are checked here; ranges and geometry belong to
:mod:`learn2assemble.world.design_model`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.world.design_model import DEFAULT_NAMES, Design, Elevation
from learn2assemble.world.json_input import (
    check_keys,
    integer,
    mapping,
    number,
    read_head,
    sequence,
    text,
    too_deep,
)

FORMAT, VERSION = "learn2assemble-design", 1
_KEYS = (
    "format", "version", "name", "description", "units", "elevations", "blocks", "first_block",
    "success_threshold", "supports",
)  # fmt: skip
_REQUIRED = ("format", "version", "name", "elevations")


def design_from(value: Any, source: str) -> Design:
    """The design in parsed JSON ``value``; ``source`` begins every message.

    Raises:
        InputError: naming the JSON path, for example ``house.json: elevations[1].outline[3]``.
    """
    try:
        return _design(value, source)
    except RecursionError:
        raise too_deep(source) from None


def _design(value: Any, source: str) -> Design:
    root = read_head(value, source, FORMAT, VERSION, _KEYS, _REQUIRED)
    sides = sequence(root["elevations"], f"{source}: elevations", "1 to 4 elevations")
    if not 1 <= len(sides) <= len(DEFAULT_NAMES):
        raise InputError(f"{source}: elevations", f"{len(sides)} of them", "1 to 4 elevations")
    elevations = tuple(_elevation(side, k, source) for k, side in enumerate(sides))
    blocks = root.get("blocks")
    fields: dict[str, Any] = {
        "name": text(root["name"], f"{source}: name"),
        "elevations": elevations,
        "num_blocks": None if "blocks" not in root else integer(blocks, f"{source}: blocks"),
        "description": text(root.get("description", ""), f"{source}: description"),
    }
    if "first_block" in root:
        fields["first_elevation"] = _first_block(root["first_block"], source)
    if "success_threshold" in root:
        where = f"{source}: success_threshold"
        fields["success_threshold"] = number(root["success_threshold"], where)
    if "supports" in root:
        if not isinstance(root["supports"], bool):
            raise InputError(f"{source}: supports", root["supports"], "true or false")
        fields["supports"] = root["supports"]
    try:
        return Design(**fields)
    except InputError as error:
        raise InputError(f"{source}: {error.what}", error.got, error.expected) from None


def _first_block(value: Any, source: str) -> int:
    first = mapping(value, f"{source}: first_block")
    check_keys(first, source, "first_block", ("elevation",), ("elevation",))
    return integer(first["elevation"], f"{source}: first_block.elevation")


def _elevation(value: Any, index: int, source: str) -> Elevation:
    path = f"elevations[{index}]"
    side = mapping(value, f"{source}: {path}")
    check_keys(side, source, path, ("name", "outline"), ("outline",))
    name = text(side.get("name", DEFAULT_NAMES[index]), f"{source}: {path}.name")
    where = f"{source}: {path}.outline"
    vertices = sequence(side["outline"], where, "a list of [x, z] vertices")
    outline = [_vertex(vertex, f"{where}[{k}]") for k, vertex in enumerate(vertices)]
    try:
        return Elevation(name, np.array(outline, np.float64).reshape(-1, 2))
    except InputError as error:
        raise InputError(f"{source}: {path}.{error.what}", error.got, error.expected) from None


def _vertex(value: Any, where: str) -> list[float]:
    pair = sequence(value, where, "[x, z], two numbers in metres")
    if len(pair) != 2:
        raise InputError(where, value, "[x, z], two numbers in metres")
    return [number(value, where) for value in pair]
