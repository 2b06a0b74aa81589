"""Once the arm is done: does everything stand where it should? (protocol 6.2)"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.robot.mjcf import matrix
from learn2assemble.robot.order import Order
from learn2assemble.robot.outcome import Outcome
from learn2assemble.robot.prepare import Failure
from learn2assemble.robot.scene import carried

PLACE_LIMIT = 0.01
"""The object was dropped when a cell ends so far from where it was ordered [m]."""
HEIGHT_LIMIT = 1e-3
"""Cells of an object keep their heights, relative to each other [m] (protocol 6.2)."""
TILT_LIMIT = 0.05
"""An object that leans more [rad] has tipped."""
STILL = 0.02
"""An object that is faster at the end keeps moving [m/s]."""


class ShiftRule(NamedTuple):
    """How far other blocks may be moved (protocol 6.2), waiting ones included."""

    limit: float = 0.01
    """[m]"""
    axes: int = 2
    """2: in x and y; 3: in space."""


ONE_SIDED = ShiftRule(0.035, 3)
"""The rule of the one-sided cell."""


def check_rest(
    order: Order, poses: np.ndarray, speed: float, landed: bool, rule: ShiftRule
) -> None:
    """Look at how things are after a motion that went as planned.

    Args:
        order: what was asked.
        poses: float64[b, 7] of the objects now.
        speed: of the moved object [m/s].
        landed: whether it rested on something before the hand let go of it.
        rule: for the others.

    Raises:
        Failure: DISTURBED_STRUCTURE where another block was moved; DROPPED where the object ended
            elsewhere, UNSTABLE where it tipped or has not come to rest. An object that rested and
            then tipped over is UNSTABLE wherever it lies, one that was let go in the air DROPPED.
    """
    position, quaternion, _ = order.objects.cells(poses)
    shift = np.linalg.norm((position - order.scene.position)[:, : rule.axes], axis=1)
    shift[order.objects.owner == order.target] = 0.0
    if not shift.max() < rule.limit:
        k = int(np.argmax(shift))
        detail = f"block {k} was moved by {1e3 * shift[k]:.0f} mm"
        raise Failure(Outcome.DISTURBED_STRUCTURE, "rest", detail)
    members = order.scene.members(order.move.cell)
    ordered, _ = carried(order.scene, order.move, members)
    sunk = position[members, 2] - ordered[:, 2]
    lean = _lean(order.quaternion[order.move.cell], quaternion[order.move.cell])
    tipped = np.ptp(sunk) > HEIGHT_LIMIT or lean > TILT_LIMIT
    missed = np.linalg.norm(position[members] - ordered, axis=1).max()
    name = order.names[order.target]
    if not missed <= PLACE_LIMIT and not (tipped and landed):
        detail = f"{name} ended {1e3 * missed:.0f} mm from its place"
        raise Failure(Outcome.DROPPED, "rest", detail)
    if tipped:
        detail = f"{name} leans by {np.degrees(lean):.1f} degrees"
        raise Failure(Outcome.UNSTABLE, "rest", detail)
    if speed > STILL:
        raise Failure(Outcome.UNSTABLE, "rest", f"{name} still moves at {speed:.2f} m/s")


def _lean(before: np.ndarray, after: np.ndarray) -> float:
    """Angle [rad] by which a body with quaternions before and after has turned off the vertical."""
    return float(np.arccos(np.clip(matrix(before)[2] @ matrix(after)[2], -1.0, 1.0)))
