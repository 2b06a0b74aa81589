"""Where the tool goes in a pick and place, the same for every fidelity of the arm.

    home - above the block - down, close, up - across - down, open, up - home

Down and up follow the approach axis of the attitude near the block, then the vertical.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.scene import Move, Scene
from learn2assemble.world.blocks import EDGE, HALF

OPENING = EDGE + 0.008
"""Opening between the pads while approaching, after releasing and while retreating [m]: wide
enough for a millimetre or two of error, narrow enough to leave neighbours alone."""
AXIAL = 0.06
"""The tool moves along its approach axis within this distance of a grasp [m]."""
CLEARANCE = 0.06
"""Between what is carried and everything below it while crossing [m]."""
LEVEL = 0.05
"""Heights of crossing are multiples of this, so that paths repeat [m]."""
RISE = (0.0, 0.008, 0.03, AXIAL)
"""Distances from the contact at which poses of a column lie, close where things are near [m]."""


class Column(NamedTuple):
    """Poses of the tool over a place where it grasps or releases, from the contact upwards."""

    position: np.ndarray
    """float64[k, 3]: tool point [m]."""
    rotation: np.ndarray
    """float64[3, 3]: of all of them."""


def column(centre: np.ndarray, attitude: Attitude, height: float) -> Column:
    """Poses over a cell with this centre, up to tool height ``height`` or just clear of it."""
    rotation, contact = attitude.rotation(), attitude.tool_point(centre)
    near = contact - np.outer(RISE, rotation[:, 2])
    top = max(height - near[-1, 2], 0.0)
    steps = np.linspace(0.0, top, 1 + math.ceil(top / (2 * LEVEL) - 1e-9))[1:]
    return Column(np.vstack([near, near[-1] + np.outer(steps, [0.0, 0.0, 1.0])]), rotation)


def crossing_height(scene: Scene, move: Move) -> float:
    """Height of the tool between picking and placing [m].

    What hangs below the grasped cell, and the fingertips, pass above everything else.
    """
    members = scene.members(move.cell)
    others = np.setdiff1d(np.arange(len(scene.position)), members)
    highest = max(scene.position[others, 2], default=-HALF) + HALF
    hanging = scene.position[move.cell, 2] - scene.position[members, 2].min() + HALF
    height = max(highest, move.target[2] - hanging) + CLEARANCE + hanging
    return LEVEL * math.ceil(height / LEVEL - 1e-9)
