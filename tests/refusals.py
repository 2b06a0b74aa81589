"""Cells that were refused once though they stand, or of which little is known, with their kits."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np

from learn2assemble.assembly.kit import Kit, load_kit, parse_kit

_FILE = Path(__file__).parent / "data" / "refusals.toml"
_CASES = tomllib.loads(_FILE.read_text(encoding="utf-8"))


def wanted(name: str) -> np.ndarray:
    """bool[X, Y, Z]: the cells that are to be filled."""
    layers = [layer.split("/") for layer in _CASES[name]["layers"]]
    return np.array([[list(row) for row in layer] for layer in layers]).T == "#"


def kit(name: str) -> Kit:
    """The kit they were refused with."""
    text = _CASES[name].get("kit")
    return load_kit("bricks-lintels") if text is None else parse_kit(text)
