"""Shapes as cells, bool[X, Y, Z]: walls with openings, and those that the laboratory measures."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np


def wall(x: int, y: int, z: int, *holes: tuple[int, int, int, int]) -> np.ndarray:
    """A wall along x with openings ``(x0, x1, z0, z1)`` right through it; one down to the table
    makes it a bridge."""
    cells = np.ones((x, y, z), bool)
    for x0, x1, z0, z1 in holes:
        cells[x0:x1, :, z0:z1] = False
    return cells


def read_shapes() -> dict[str, np.ndarray]:
    """Houses, towers, arches, domes by name, as ``l2a_lab.shapes`` makes them (its tests compare);
    of each the levels from the table up, as rows along y with ``#`` for a cell."""
    shapes = dict[str, np.ndarray]()
    with gzip.open(Path(__file__).parent / "data" / "shapes.jsonl.gz", "rt") as lines:
        for line in map(json.loads, lines):
            levels = [[[cell == "#" for cell in row] for row in level] for level in line["levels"]]
            cells = np.moveaxis(np.array(levels), 0, -1)
            shapes[line["name"]] = np.ascontiguousarray(cells)
    return shapes


SHAPES = read_shapes()
