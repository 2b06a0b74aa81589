"""Models as StableLego's JSON, and as lists of bricks with their size.

StableLego numbers its bricks and refers to a library: ``{"1": {"x": 0, "y": 21, "z": 0,
"brick_id": 2, "ori": 1}, ...}``, extents along x and y from the library, turned where ``ori`` is 1.
The other form names sizes: ``{"bricks": [{"size": [4, 2], "at": [0, 21, 0], "mass": 0.00216},
...]}``, in studs and bricks.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from learn2assemble.assembly.blocks import MAX_BLOCKS
from learn2assemble.assembly.bricks.model import Brick, BrickModel
from learn2assemble.errors import InputError, is_number, look_up
from learn2assemble.values import integer, mapping, sequence, text

_LIBRARY = {
    "1": (2, 2, 0.2),
    "2": (2, 4, None),
    "3": (2, 6, None),
    "4": (1, 8, None),
    "5": (1, 4, None),
    "6": (1, 6, None),
    "9": (1, 2, None),
    "10": (1, 1, None),
    "12": (2, 2, None),
}
"""Of StableLego: extents across and along, and the mass [kg] of the one that is a weight."""


def is_stablelego(document: Mapping[str, Any]) -> bool:
    """Whether a JSON document is one of these."""
    if "format" in document or "dtype" in document:
        return False
    if isinstance(document.get("bricks"), list):
        return True
    values = list(document.values())[:3]
    return bool(values) and all(isinstance(v, Mapping) and "brick_id" in v for v in values)


def parse_stablelego(document: Mapping[str, Any], source: str, layers: int) -> BrickModel:
    """The bricks of a document.

    Args:
        layers: of a brick.

    Raises:
        InputError: with the path of what is wrong.
    """
    name = ""
    if "bricks" in document:
        rows = sequence(document["bricks"], f"{source}: bricks", "a list of bricks")
        _check_count(len(rows), source)
        bricks = [_listed(row, f"{source}: bricks[{k}]", layers) for k, row in enumerate(rows)]
        name = text(document.get("name", ""), f"{source}: name")
    else:
        _check_count(len(document), source)
        bricks = [_of_library(row, f"{source}: {key}", layers) for key, row in document.items()]
    return BrickModel(tuple(bricks), name=name)


def _check_count(count: int, source: str) -> None:
    if not 0 < count <= MAX_BLOCKS:
        raise InputError(f"{source}: bricks", count, f"1 to {MAX_BLOCKS} bricks")


def _listed(row: Any, where: str, layers: int) -> Brick:
    brick = mapping(row, where)
    for key in ("size", "at"):
        if key not in brick:
            raise InputError(where, sorted(brick), f"the key {key!r}")
    size = _numbers(brick["size"], f"{where}.size", 2)
    at = _numbers(brick["at"], f"{where}.at", 3)
    if min(size) < 1:
        raise InputError(f"{where}.size", size, "two numbers of studs from 1")
    mass = brick.get("mass")
    if mass is not None and not is_number(mass, 1e-6, 1e3):
        raise InputError(f"{where}.mass", mass, "a mass from 1e-6 to 1000 kg")
    low = (at[0], at[1], layers * at[2])
    return Brick(low, (size[0], size[1], layers), where, mass=None if mass is None else float(mass))


def _of_library(row: Any, where: str, layers: int) -> Brick:
    brick = mapping(row, where)
    x, y, z, kind, turned = (
        integer(brick.get(key), f"{where}.{key}") for key in ("x", "y", "z", "brick_id", "ori")
    )
    if turned not in (0, 1):
        raise InputError(f"{where}.ori", turned, "0, or 1 for a brick that is turned")
    across, along, mass = look_up(f"{where}.brick_id", str(kind), _LIBRARY)
    size = (along, across, layers) if turned == 1 else (across, along, layers)
    return Brick((x, y, layers * z), size, where, mass=mass)


def _numbers(values: Any, where: str, count: int) -> list[int]:
    expected = f"{count} whole numbers"
    given = sequence(values, where, expected)
    if len(given) != count:
        raise InputError(where, list(given), expected)
    return [integer(value, where) for value in given]
