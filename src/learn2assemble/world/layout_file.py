"""Where blocks wait for an arm, as a user gives it: a JSON file (``docs/layouts.md``)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.world.json_input import (
    load_json,
    number,
    read_head,
    read_text,
    sequence,
    too_deep,
)

FORMAT, VERSION = "learn2assemble-layout", 1
_KEYS = ("format", "version", "units", "positions")
_REQUIRED = ("format", "version", "positions")
_PLACE = "[x, y] in metres, or [x, y, yaw] with the yaw in radians"
MAX_PLACES = 400


class Layout(NamedTuple):
    """Where blocks wait."""

    places: np.ndarray
    """float64[n, 3]: x, y [m, world] and yaw [rad] of every waiting block, on the table."""
    source: str
    """What messages call it."""


def read_layout(path: Path) -> Layout:
    """The layout in the file ``path``.

    Raises:
        InputError: one line that names the file and the JSON path of the fault.
    """
    text, source = read_text(Path(path), "layout file")
    try:
        return Layout(_places(load_json(text, source, FORMAT), source), source)
    except RecursionError:
        raise too_deep(source) from None


def _places(value: Any, source: str) -> np.ndarray:
    root = read_head(value, source, FORMAT, VERSION, _KEYS, _REQUIRED)
    where = f"{source}: positions"
    expected = f"a list of 1 to {MAX_PLACES} places"
    places = sequence(root["positions"], where, expected)
    if not 1 <= len(places) <= MAX_PLACES:
        raise InputError(where, f"{len(places)} places", expected)
    return np.array([_place(place, f"{where}[{k}]") for k, place in enumerate(places)])


def _place(value: Any, where: str) -> list[float]:
    place = sequence(value, where, _PLACE)
    if len(place) not in (2, 3):
        raise InputError(where, value, _PLACE)
    return [*(number(item, where) for item in place), 0.0][:3]
