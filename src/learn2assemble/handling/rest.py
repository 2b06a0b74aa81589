"""How things are after a motion that went as planned: in place, upright, the others still."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.robot.moves import Failure, Outcome, carried
from learn2assemble.robot.scene import rotation_matrix
from learn2assemble.simulation.objects import Order

PLACE_LIMIT = 0.01
"""The object was dropped when a cell ends so far from where it was ordered [m]."""
HEIGHT_LIMIT = 1e-3
"""Cells of an object keep their heights, relative to each other [m]."""
TILT_LIMIT = 0.05
"""An object that leans more [rad] has tipped."""
STILL = 0.02
"""An object that is faster at the end keeps moving [m/s]."""


class ShiftRule(NamedTuple):
    """How far other blocks may be moved, waiting ones included."""

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
            elsewhere, TOPPLED where it tipped or has not come to rest. An object that rested and
            then tipped over is TOPPLED wherever it lies, one that was let go in the air DROPPED.
    """
    position, quaternion, _ = order.objects.cells(poses)
    shift = np.linalg.norm((position - order.scene.position)[:, : rule.axes], axis=1)
    shift[order.objects.owner == order.target] = 0.0
    if not shift.max() < rule.limit:
        k = int(np.argmax(shift))
        detail = f"block {k} was moved by {1e3 * shift[k]:.0f} mm"
        raise Failure(Outcome.DISTURBED_STRUCTURE, "rest", detail)
    members = order.scene.members(order.move.cell)
    ordered, turned = carried(order.scene, order.move, members)
    sunk = position[members, 2] - ordered[:, 2]
    cell = order.move.cell
    lean = _lean(
        turned[0] if order.scene.half is not None else order.quaternion[cell], quaternion[cell]
    )
    tipped = np.ptp(sunk) > HEIGHT_LIMIT or lean > TILT_LIMIT
    missed = np.linalg.norm(position[members] - ordered, axis=1).max()
    name = order.names[order.target]
    if not missed <= PLACE_LIMIT and not (tipped and landed):
        detail = f"{name} ended {1e3 * missed:.0f} mm from its place"
        raise Failure(Outcome.DROPPED, "rest", detail)
    if tipped:
        detail = f"{name} leans by {np.degrees(lean):.1f} degrees"
        raise Failure(Outcome.TOPPLED, "rest", detail)
    if speed > STILL:
        raise Failure(Outcome.TOPPLED, "rest", f"{name} still moves at {speed:.2f} m/s")


def _lean(before: np.ndarray, after: np.ndarray) -> float:
    """Angle [rad] by which a body with quaternions before and after has turned off the vertical."""
    return float(
        np.arccos(np.clip(rotation_matrix(before)[2] @ rotation_matrix(after)[2], -1.0, 1.0))
    )
