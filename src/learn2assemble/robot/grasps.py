"""Grasps as data: how a hand meets a cell, and named sets of ways to pick up and put down."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from learn2assemble.errors import look_up
from learn2assemble.geometry.rotations import yaw_matrix

QUARTER = math.pi / 2


_NOWHERE = (0.0, 0.0, 0.0)


class Lip(NamedTuple):
    """Where the lip of a cup is on its tool."""

    at: tuple[float, float, float] = _NOWHERE
    """Its middle in the tool frame, whose origin is the middle of the first lip and whose z axis
    points out of it [m]."""
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Unit vector out of the cup, in the tool frame."""

    def frame(self) -> np.ndarray:
        """float64[3, 3]: axes of the cup as columns, in the tool frame; z points out of it."""
        z = np.array(self.axis)
        if z[2] == 1.0:
            return np.eye(3)
        y = np.array([0.0, 1.0, 0.0]) if abs(z[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
        x = np.cross(y, z) / np.linalg.norm(np.cross(y, z))
        return np.stack([x, np.cross(z, x), z], 1)


FIRST = Lip()
"""Of the first cup, and of fingers."""
WAY = 0.06
"""The hand keeps to its approach for so long at least before it rises [m]."""
STEEP = 0.7
"""An approach that is less steep (cosine of its angle to the vertical) comes from the side."""


class Attitude(NamedTuple):
    """How the hand meets a cell. The tool's z axis points out of the hand, the fingers close
    along its y axis; without a tilt z points straight down. A cup at the side of a tool has an
    approach of its own."""

    yaw: float = 0.0
    """Of the hand about the vertical [rad]; at 0 the fingers close along the world's y."""
    tilt: float = 0.0
    """Lean of the hand about the closing axis [rad]; positive: the wrist moves towards the tool's
    negative x."""
    depth: float = 0.0
    """How far above the cell's centre the lip, or the point between the fingers, stays, along the
    approach [m]."""
    lip: Lip = FIRST
    """Which cup of the tool it is."""
    way: float = WAY
    """How far the hand keeps to the approach from the contact on before it rises [m]."""
    spin: float = 0.0
    """Of the hand about the tool's z axis, after the tilt [rad]."""
    aside: tuple[float, float, float] = _NOWHERE
    """What else the lip, or the point between the fingers, is off the cell's centre, at right
    angles to the approach, in the tool frame [m]."""
    into: tuple[float, float, float] | None = None
    """Unit vector along which what is held comes to its place, world frame; None: the approach
    itself, and straight down where that comes from the side. Of a grasp: along which the hand comes
    to it, and back along which it takes it away."""

    def rotation(self) -> np.ndarray:
        """float64[3, 3]: the tool's axes as columns, world frame; to be read only."""
        return _rotation(self.yaw, self.tilt, self.spin)

    def approach(self) -> np.ndarray:
        """float64[3]: unit vector along which the hand comes to the cell, world frame."""
        return self.rotation() @ np.array(self.lip.axis)

    @property
    def sideways(self) -> bool:
        """Whether a cup at the side of the tool comes from the side rather than from above."""
        return self.lip != FIRST and -float(self.approach()[2]) < STEEP

    @property
    def apart(self) -> bool:
        """Whether what is held comes to its place another way than the hand leaves it."""
        return self.into is not None or self.sideways

    @property
    def straight(self) -> bool:
        """Of a grasp: whether it is taken away another way than along the approach."""
        return self.into is not None

    def insertion(self) -> np.ndarray:
        """float64[3]: unit vector along which what is held comes to its place, world frame."""
        if self.into is not None:
            return np.array(self.into)
        return np.array([0.0, 0.0, -1.0]) if self.sideways else self.approach()

    def spun(self, angle: float) -> Attitude:
        """The hand turned about its own axis [rad], counted as a yaw where it points down; it holds
        where it did."""
        (x, y, z), c, s = self.aside, math.cos(angle), math.sin(angle)
        held = self._replace(aside=(c * x - s * y, s * x + c * y, z)) if x or y else self
        if held.tilt:
            return held._replace(spin=held.spin - angle)
        return held._replace(yaw=held.yaw + angle)

    def tool_point(self, centre: np.ndarray) -> np.ndarray:
        """float64[3]: where the tool point is when the hand holds a cell with this centre [m]."""
        point = centre - self.depth * self.approach()
        if self.lip.at == self.aside == _NOWHERE:
            return point
        return point + self.rotation() @ (np.array(self.aside) - np.array(self.lip.at))


@lru_cache(maxsize=4096)
def _rotation(yaw: float, tilt: float, spin: float) -> np.ndarray:
    """See :meth:`Attitude.rotation`: a move asks for it twenty times."""
    c, s = math.cos(tilt), math.sin(tilt)
    # Half a turn about x points the tool down; the tilt is about the tool's own y axis.
    down = np.array([[c, 0.0, s], [0.0, -1.0, 0.0], [s, 0.0, -c]])
    turn = yaw_matrix(yaw) @ down
    turn = turn @ yaw_matrix(spin) if spin else turn
    turn.flags.writeable = False
    return turn


UPRIGHT = math.radians(1.0)
"""A tool that is tilted less points straight down [rad]."""
MOST_TILT, LEVEL = math.radians(70.0), math.radians(95.0)
"""The axis of a tool is not tilted more than this from the vertical, ..., or than that at one end
of a way where two arms build what leans: a block that lies on a face is put down by the other one,
the tool level [rad]."""


def facing(tool: np.ndarray) -> Attitude:
    """The attitude of a tool, float64[3, 3]: its axes as columns, world frame."""
    z = tool[:, 2]
    tilt = math.acos(float(np.clip(-z[2], -1.0, 1.0)))
    if tilt < UPRIGHT:
        return Attitude(math.atan2(tool[1, 0], tool[0, 0]))
    found = Attitude(math.atan2(z[1], z[0]), tilt)
    own = found.rotation().T @ tool
    return found._replace(spin=math.atan2(own[1, 0], own[0, 0]))


def along(grasp: Attitude, yaw: float) -> Attitude:
    """An attitude meant for an upright object, for one that is turned by ``yaw`` [rad]: turned
    with it by at most an eighth, as a quarter makes no difference to a cube."""
    turned = yaw - QUARTER * round(yaw / QUARTER)
    return grasp._replace(yaw=grasp.yaw + turned) if turned else grasp


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
    # Action k mod 4: net turns of 0, -90, 90 and 0 degrees.
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
