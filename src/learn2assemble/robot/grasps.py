"""Attitudes of the hand at a cell, and the sets of them a task offers (protocol 5, 8.3)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from learn2assemble.errors import look_up

QUARTER = math.pi / 2


class Attitude(NamedTuple):
    """How the hand meets a cell. The tool's z axis points out of the hand, the fingers close
    along its y axis; without a tilt z points straight down."""

    yaw: float = 0.0
    """Of the hand about the vertical [rad]; at 0 the fingers close along the world's y."""
    tilt: float = 0.0
    """Lean of the hand about the closing axis [rad]; positive: the wrist moves towards the tool's
    negative x."""
    depth: float = 0.0
    """How far above the cell's centre the tool point stays, along the approach [m]."""

    def rotation(self) -> np.ndarray:
        """float64[3, 3]: the tool's axes as columns, world frame."""
        c, s = math.cos(self.tilt), math.sin(self.tilt)
        # Half a turn about x points the tool down; the tilt is about the tool's own y axis.
        down = np.array([[c, 0.0, s], [0.0, -1.0, 0.0], [s, 0.0, -c]])
        return turn(self.yaw) @ down

    def tool_point(self, centre: np.ndarray) -> np.ndarray:
        """float64[3]: where the tool point is when the hand holds a cell with this centre [m]."""
        return centre - self.depth * self.rotation()[:, 2]

    def flipped(self) -> Attitude:
        """The same grasp with the fingers exchanged."""
        return self._replace(yaw=self.yaw + math.pi)


def along(grasp: Attitude, yaw: float) -> Attitude:
    """An attitude meant for an upright object, for one that is turned by ``yaw`` [rad]: turned
    with it by at most an eighth, as a quarter makes no difference to a cube."""
    turned = yaw - QUARTER * round(yaw / QUARTER)
    return grasp._replace(yaw=grasp.yaw + turned) if turned else grasp


def turn(yaw: float) -> np.ndarray:
    """float64[3, 3]: rotation about z; exact for quarter turns."""
    quarters = yaw / (math.pi / 2)
    if abs(quarters - round(quarters)) < 1e-9:
        c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[round(quarters) % 4]
    else:
        c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


class GraspPair(NamedTuple):
    """Attitudes for picking up and for putting down; an object turns by the difference in yaw."""

    grasp: Attitude
    place: Attitude


_A, _B = Attitude(), Attitude(yaw=-math.pi / 2)
_YAWS = tuple(Attitude(yaw=-k * math.pi / 2) for k in range(4))
_LEANS = tuple(
    Attitude(yaw, tilt, depth)
    for yaw in (0.0, -math.pi / 2, math.pi / 2, math.pi)
    for tilt in (-math.pi / 6, 0.0, math.pi / 6)
    for depth in (0.0, 0.012)
)

GRASP_SETS: dict[str, tuple[GraspPair, ...]] = {
    # One-sided cell: the fingers always close along y.
    "along-y": (GraspPair(_A, _A),),
    # Protocol 5, action k mod 4: net turns of 0, -90, 90 and 0 degrees.
    "paper": (GraspPair(_A, _A), GraspPair(_A, _B), GraspPair(_B, _A), GraspPair(_B, _B)),
    "four-yaws": tuple(GraspPair(a, b) for a in _YAWS for b in _YAWS),
    # 6-D grasps: the lean and the depth a block is picked with are those it is placed with.
    "rich": tuple(
        GraspPair(a, b) for a in _LEANS for b in _LEANS if (a.tilt, a.depth) == (b.tilt, b.depth)
    ),
}
"""Named sets of (grasp, place) attitudes. The paper names 6-D grasps as future work."""


def get_grasps(name: str) -> tuple[GraspPair, ...]:
    """The grasp set called ``name``.

    Raises:
        UnknownNameError: naming the nearest one.
    """
    return look_up("grasp set", name, GRASP_SETS)
