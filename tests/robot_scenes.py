"""Scenes on the lattice of the robot cell, for tests of its fidelities."""

from __future__ import annotations

import numpy as np

from learn2assemble.robot.moves import Scene

PITCH, GROUND = 0.06, 0.025


def scene(placed: list[tuple], waiting: list[tuple], objects: list[int] | None = None) -> Scene:
    """Cells (x, y, z) [pitches; levels above the ground]."""
    cells = np.array([*placed, *waiting], float)
    position = cells * [PITCH, PITCH, 0.05] + [0.0, 0.0, GROUND]
    ids = np.arange(len(cells)) if objects is None else np.array(objects)
    return Scene(position, np.zeros(len(cells)), ids, len(placed))


def cell(x: float, y: float, z: float) -> np.ndarray:
    """Centre of a cell [m]."""
    return np.array([x * PITCH, y * PITCH, z * 0.05 + GROUND])
