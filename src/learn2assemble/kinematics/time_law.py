"""Joint paths and their time laws: never faster than the arm's limits allow.

A path is a cubic spline through joint positions over a parameter s, so that velocity and
acceleration are continuous. Along it, s(t) is a time-optimal, jerk-limited profile (ruckig) under
constant limits on its derivatives that keep every joint within its own:

    |q'| s' <= v,   |q'| s'' + |q''| s'^2 <= a,   |q'| s''' + 3 |q''| s' s'' + |q'''| s'^3 <= j
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.errors import InputError, MissingExtraError
from learn2assemble.kinematics.joint_path import JointPath
from learn2assemble.robot.arm import Limits

_BENT = 0.6
"""Share of acceleration and jerk that the bends of a path may use."""
_HALVINGS = 30
BENT_SHARES = (0.2, 0.4, 0.6, 0.75, 0.88)
"""The same, to choose from: a high speed on a long way, a fast start on a short one."""


def load_ruckig() -> Any:
    """The library of time-optimal profiles; only simulated motions need it.

    Raises:
        MissingExtraError: where it is not installed.
    """
    try:
        import ruckig
    except ImportError as error:  # pragma: no cover - depends on the installation
        raise MissingExtraError("ruckig", "robot") from error
    return ruckig


class PathLimits(NamedTuple):
    """Limits on the derivatives of s: speed, acceleration [1/s], jerk [1/s^2]."""

    speed: float
    acceleration: float
    jerk: float


def limits_along(path: JointPath, limits: Limits, quickest: bool = False) -> PathLimits:
    """Constant limits on s(t) that keep every joint of the path within ``limits``.

    Args:
        path: on which the arm moves.
        limits: of its joints.
        quickest: bends may use the share of acceleration and jerk with which this path takes least
            time, not always the same one.
    """
    if path.length == 0:
        return PathLimits(1.0, 1.0, 1.0)
    first, second, third = (np.maximum(bound, 1e-12) for bound in path.bounds())
    v, a, j = limits[:3]
    found: list[tuple[float, PathLimits]] = []
    for bent in BENT_SHARES if quickest else (_BENT,):
        speed = min(
            np.min(v / first),
            np.sqrt(np.min(bent * a / second)),
            np.cbrt(np.min(bent / 2 * j / third)),
        )
        acceleration = min(
            np.min((a - second * speed**2) / first), np.min(bent / 2 * j / (3 * second * speed))
        )
        jerk = np.min((j - 3 * second * speed * acceleration - third * speed**3) / first)
        # From rest to rest, where the full speed is reached.
        seconds = path.length / speed + speed / acceleration + acceleration / jerk
        found.append((seconds, PathLimits(float(speed), float(acceleration), float(jerk))))
    return min(found, key=lambda one: one[0])[1]


def reachable_speed(speed: float, way: float, bounds: PathLimits) -> float:
    """A speed that can be reached from another one, without acceleration at both ends, on a way;
    no lower than that."""
    # The acceleration rises and falls at full jerk; on average it is at least half its peak.
    peak = min(bounds.acceleration, np.cbrt(bounds.jerk**2 * way / 2))
    found = float(np.sqrt(speed**2 + peak * way))
    if not speed:
        return found

    def needed(end: float) -> float:
        """The way on which the speed changes to this one."""
        change = end - speed
        ramps = 2 * math.sqrt(change / bounds.jerk)
        if change > bounds.acceleration**2 / bounds.jerk:
            ramps = change / bounds.acceleration + bounds.acceleration / bounds.jerk
        return (speed + end) / 2 * ramps

    low, high = speed, found
    # A start that moves covers the way in less time, so it gains less.
    for _ in range(_HALVINGS if needed(found) > way else 0):
        middle = (low + high) / 2
        low, high = (middle, high) if needed(middle) <= way else (low, middle)
    return low if needed(found) > way else found


class PathSamples(NamedTuple):
    """Where the joints shall be at equal steps of time; the first sample is one step after now."""

    progress: np.ndarray
    """float64[m, 3]: s and its two derivatives."""
    position: np.ndarray
    """float64[m, n] [rad]."""
    velocity: np.ndarray
    """float64[m, n] [rad/s]."""
    acceleration: np.ndarray
    """float64[m, n] [rad/s^2]."""


class Segment(NamedTuple):
    """A part of a motion along a path."""

    end: float
    """s where it ends."""
    end_speed: float = 0.0
    """Derivative of s there."""
    top_speed: float = math.inf
    """Largest derivative of s on the way."""


def motion(
    path: JointPath,
    bounds: PathLimits,
    step: float,
    segments: tuple[Segment, ...] = (),
) -> PathSamples:
    """Move along a path, from rest at its beginning, by default to rest at its end.

    Args:
        path: where to.
        bounds: how fast; from :func:`limits_along`, or slower.
        step: time between samples [s].
        segments: one after the other, each from where the one before ended.
    """
    found, start = list[Any](), (0.0, 0.0, 0.0)
    for segment in segments or (Segment(path.length),):
        capped = bounds._replace(speed=min(bounds.speed, segment.top_speed))
        found.append(_profile(capped, start, (segment.end, segment.end_speed)))
        start = (segment.end, segment.end_speed, 0.0)
    return _sample(path, found, step)


def _profile(
    bounds: PathLimits, start: tuple[float, float, float], end: tuple[float, float]
) -> Any:
    """The fastest s(t) within ``bounds`` to s and its derivative at the end."""
    ruckig = load_ruckig()
    wanted = ruckig.InputParameter(1)
    wanted.target_position, wanted.target_velocity = [end[0]], [end[1]]
    now = ([start[0]], [start[1]], [start[2]])
    wanted.current_position, wanted.current_velocity, wanted.current_acceleration = now
    wanted.max_velocity, wanted.max_jerk = [bounds.speed], [bounds.jerk]
    found = ruckig.Trajectory(1)
    # Where two shapes of the profile meet to the last bit Ruckig finds neither; a little less of
    # the acceleration is clearly one of them.
    for less in (0.0, 1e-9, 1e-6):
        wanted.max_acceleration = [bounds.acceleration * (1 - less)]
        try:
            if ruckig.Ruckig(1).calculate(wanted, found) == ruckig.Result.Working:
                return found
        except ruckig.RuckigError:
            continue
    raise InputError("motion", str(wanted), "a motion within the limits of the path")


def _sample(path: JointPath, parts: list[Any], step: float) -> PathSamples:
    progress, begun = list[tuple[float, float, float]](), 0.0
    for part in parts:
        first = len(progress) + 1
        last = math.floor((begun + part.duration) / step + 1e-9)
        progress += [_now(part, k * step - begun) for k in range(first, last + 1)]
        begun += part.duration
    if len(progress) * step < begun - 1e-9:
        progress.append(_now(parts[-1], math.inf))
    sampled = np.array(progress).reshape(-1, 3)
    s, rate, change = sampled[:, 0], sampled[:, 1:2], sampled[:, 2:]
    q, slope, bend = path.at(np.clip(s, 0.0, path.length))
    return PathSamples(sampled, q, slope * rate, slope * change + bend * rate**2)


def _now(part: Any, time: float) -> tuple[float, float, float]:
    position, velocity, acceleration = part.at_time(min(time, part.duration))[:3]
    return position[0], velocity[0], acceleration[0]


def approach_speed_limits(
    path: JointPath, rise: np.ndarray, zones: tuple[tuple[float, float], ...], bounds: PathLimits
) -> tuple[Segment, ...]:
    """Segments of a way down that enter zones near the contact at lower speeds.

    Args:
        path: down an approach path.
        rise: float64[k] of the tool at its knots [m], falling.
        zones: height above the contact [m] and largest speed there [m/s], downwards.
        bounds: of the path.
    """
    ends, limits = [0.0], [bounds.speed]
    for height, slowly in zones:
        s = float(np.interp(-height, -rise, path.knots))
        # Within a zone, s and the way of the tool are all but proportional.
        limit = min(limits[-1], slowly * (path.length - s) / (height - rise[-1]))
        if s > ends[-1]:
            ends.append(s)
            limits.append(limit)
        else:
            limits[-1] = limit
    # What a zone is entered with can be reached from the one above, and from it the next.
    entered = [0.0, *limits[1:], 0.0]
    ends.append(path.length)
    for k in range(1, len(ends) - 1):
        entered[k] = min(entered[k], reachable_speed(entered[k - 1], ends[k] - ends[k - 1], bounds))
    for k in range(len(ends) - 2, 0, -1):
        entered[k] = min(entered[k], reachable_speed(entered[k + 1], ends[k + 1] - ends[k], bounds))
    return tuple(
        Segment(end, speed, top)
        for end, speed, top in zip(ends[1:], entered[1:], limits, strict=True)
    )
