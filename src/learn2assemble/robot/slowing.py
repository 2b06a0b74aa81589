"""Slower near the contact."""

from __future__ import annotations

import numpy as np

from learn2assemble.robot.trajectory import JointPath, Leg, Pace, reachable_speed


def slowing(
    path: JointPath, rise: np.ndarray, zones: tuple[tuple[float, float], ...], pace: Pace
) -> tuple[Leg, ...]:
    """Legs of a way down that enter zones near the contact at lower speeds.

    Args:
        path: down a column.
        rise: float64[k] of the tool at its knots [m], falling.
        zones: height above the contact [m] and largest speed there [m/s], downwards.
        pace: of the path.
    """
    legs, top, begun, speed = [], pace.speed, 0.0, 0.0
    for height, slowly in zones:
        s = float(np.interp(-height, -rise, path.knots))
        # Within a zone, s and the way of the tool are all but proportional.
        limit = min(top, slowly * (path.length - s) / (height - rise[-1]))
        if s > begun:
            speed = min(limit, reachable_speed(speed, s - begun, pace))
            legs.append(Leg(s, speed, top))
            begun = s
        top = limit
    return (*legs, Leg(path.length, 0.0, top))
