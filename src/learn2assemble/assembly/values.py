"""Parts of blocks in JSON files, ours and those of COMPAS."""

from __future__ import annotations

import json
from contextlib import suppress
from typing import Annotated, Any

import numpy as np

from learn2assemble.errors import InputError, is_whole
from learn2assemble.values import Range, number, rounded_array, sequence

DIGITS = 9
"""Of coordinates written."""
Byte = Annotated[int, Range(0, 255)]
Colour = tuple[Byte, Byte, Byte]
"""Red, green, blue."""


def compact(document: dict[str, Any]) -> str:
    """JSON text without spaces."""
    return json.dumps(document, separators=(",", ":"))


def written(points: np.ndarray) -> Any:
    """Coordinates as files have them: lists of numbers, without a minus before zero."""
    return rounded_array(points, DIGITS).tolist()


def coordinates(rows: Any, where: str) -> np.ndarray:
    """float64[n, 3]: a list of points; messages call it ``where``."""
    expected = "a list of points [x, y, z]"
    points = sequence(rows, where, expected)
    for k, row in enumerate(points):
        if len(sequence(row, f"{where}[{k}]", expected)) != 3:
            raise InputError(f"{where}[{k}]", row, "three numbers")
        for value in row:
            number(value, f"{where}[{k}]")
    return np.array(points, np.float64).reshape(-1, 3)


def as_colour(value: Any, where: str) -> Colour:
    """A colour that a caller gives; messages call it ``where``."""
    given: object = value
    parts: list[Any] = list(value) if isinstance(given, list | tuple | np.ndarray) else []
    if len(parts) != 3 or not all(is_whole(one, 0, 255) for one in parts):
        raise InputError(where, value, "red, green and blue, whole numbers from 0 to 255")
    red, green, blue = map(int, parts)
    return red, green, blue


def any_colour(value: Any) -> Colour | None:
    """A colour where it is one; files of others may hold anything there."""
    given: object = value
    if isinstance(given, list) and all(type(k) is int for k in value):
        with suppress(InputError):
            return as_colour(value, "colour")
    return None
