"""What all controllers have in common: addresses, clocks, and what is not theirs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.plants.plant import (
    Commands,
    Guard,
    Guards,
    Motion,
    PlantError,
    Readings,
    Stop,
    ToolReading,
    between,
)
from learn2assemble.plants.setup import UNWANTED

BACK = 1e-6
"""By so much the clock of a controller may go back [s]."""
JUMP, FASTEST = 10.0, 100.0
"""It has jumped where it went on by more than this [s], and so many times faster than ours; a
simulated controller may be faster than time."""
CLOSE = 5e-5
"""A motion with fewer samples is nowhere farther from the one it was [rad]."""
LONGEST = 0.25
"""Between two of its samples [s]."""


class Address(NamedTuple):
    """Where a controller is."""

    host: str
    port: int

    @classmethod
    def read(cls, scheme: str, text: str, port: int) -> Address:
        """The place in an address.

        Args:
            text: what follows ``SCHEME://``: a host, and perhaps its port.
            port: where none is told.

        Raises:
            InputError: naming the address.
        """
        host, mark, number = text.rstrip("/").rpartition(":") if ":" in text else (text, "", "")
        host = host.rstrip("/")
        fine = host and not set(host) & set("/?#@ :")
        if not fine or (mark and not (number.isdigit() and 0 < int(number) < 65536)):
            raise InputError(
                "robot", f"{scheme}://{text}", f"{scheme}://HOST or {scheme}://HOST:PORT"
            )
        return cls(host, int(number) if mark else port)


def marks_of(motion: Motion, commands: Commands, guards: Guards) -> list[float]:
    """The times of a motion at which something changes [s]."""
    told = [one.at for one in commands] + [one.begin for one in guards]
    return sorted({min(max(at, 0.0), motion.seconds) for at in told})


def thinned(motion: Motion, marks: Sequence[float] = ()) -> Motion:
    """The same motion with few samples.

    Args:
        marks: times at which there is a sample in any case [s].

    Returns:
        samples no farther apart than :data:`LONGEST`, nowhere farther than :data:`CLOSE` from the
        motion at its own samples.
    """
    if len(motion.time) < 2:
        return motion
    time, q, v = motion.time, motion.joints, motion.velocity
    extra = np.array([at for at in sorted({*marks}) if np.abs(time - at).min() > 1e-6])
    extra = extra[(extra > time[0]) & (extra < time[-1])] if len(extra) else extra
    if len(extra):
        there, speed, _ = between(motion, extra)
        order = np.argsort(np.concatenate([time, extra]), kind="stable")
        time = np.concatenate([time, extra])[order]
        q, v = np.concatenate([q, there])[order], np.concatenate([v, speed])[order]
    keep = {0, len(time) - 1, *(int(np.abs(time - at).argmin()) for at in marks)}
    fixed = sorted(keep)
    parts = [*pairwise(fixed)]
    while parts:
        a, b = parts.pop()
        if b - a < 2:
            continue
        part = Motion("", time[[a, b]], q[[a, b]], v[[a, b]])
        off = np.abs(between(part, time[a + 1 : b])[0] - q[a + 1 : b]).max()
        if off > CLOSE or time[b] - time[a] > LONGEST:
            middle = (a + b) // 2
            keep.add(middle)
            parts += [(a, middle), (middle, b)]
    rows = sorted(keep)
    return Motion(motion.stage, time[rows], q[rows], v[rows])


def felt(guards: Guards, feel: float) -> list[Guard]:
    """Guards in the order of their times, with forces that a robot can tell from noise; it does not
    tell those on the arm from those on what it holds.

    Args:
        feel: smallest force that counts [N].
    """
    found: list[Guard] = []
    for one in sorted(guards, key=lambda guard: guard.begin):
        given = [force for force in (one.force, one.held, one.taken) if force is not None]
        least = max(min(given), UNWANTED * feel) if given else None
        contact = None if one.contact is None else max(one.contact, feel)
        found.append(one._replace(force=least, held=None, taken=None, contact=contact))
    return found


def away(joints: np.ndarray, motion: Motion) -> float:
    """How far the arm is from where a motion begins [rad]; 0 where it does not move."""
    if not len(motion.time):
        return 0.0
    return float(np.abs(joints - motion.joints[0]).max())


def not_begun(
    now: Readings, motion: Motion, tolerance: float, why: str = "the robot is stopped"
) -> tuple[Stop, str] | None:
    """Why a motion may not begin as things are, in words; None: it may.

    Args:
        now: what was sensed last.
        tolerance: the arm may be so far from where the motion begins [rad].
        why: the robot is stopped, where it is.
    """
    if now.state == "stopped":
        return Stop.PROTECTIVE, why
    off = away(now.joints, motion)
    if off > tolerance:
        return Stop.REFUSED, f"the arm is {off:.3f} rad from where the motion begins"
    return None


def refused(why: str) -> PlantError:
    """The error of a controller that is not what it has to be."""
    return PlantError(Stop.REFUSED, why)


def lost(why: str) -> PlantError:
    """The error of a connection that is none any more."""
    return PlantError(Stop.LOST, why)


class ControllerClock:
    """Whether the clock of a controller goes on as that of this machine does.

    Args:
        silence: longest time without a new state [s of the clock it is waited for by].
    """

    def __init__(self, silence: float) -> None:
        self.silence = silence
        self.last: float = -math.inf
        self._wall = -math.inf
        self._states, self._began = 0, -math.inf

    def odd(self, now: float, wall: float) -> str:
        """What is wrong with the time that was told, in words; empty where nothing is.

        Args:
            now: of the controller [s].
            wall: of the clock it is waited for by [s].
        """
        before, waited = self.last, wall - self._wall
        self.last = now
        if now < before - BACK:
            return f"the controller's clock went back by {before - now:.3f} s"
        if now == before:
            return f"no state for {waited:.2f} s" if waited > self.silence else ""
        self._wall, self._states = wall, self._states + 1
        self._began = wall if self._began == -math.inf else self._began
        if before > -math.inf and now - before > JUMP + FASTEST * waited:
            return f"the controller's clock jumped by {now - before:.1f} s"
        return ""

    def rate(self) -> float | None:
        """States a second that were seen [1/s of the clock it is waited for by]."""
        span = self._wall - self._began
        return round(self._states / span, 1) if self._states > 1 and span > 0 else None


DEBOUNCE = 0.04
"""So long the tool may say that nothing is held before that is believed [s]."""


class WatchedHere:
    """The guards of a motion, where the controller does not look at them itself: the arm stops
    later by as long as the network takes.

    Args:
        guards: of the motion, as :func:`felt` gives them.
    """

    def __init__(self, guards: Guards) -> None:
        self._left, self._now = list(guards), Guard()
        self._gone = -1.0

    def broken(self, past: float, tool: ToolReading) -> tuple[Stop, str] | None:
        """What ends the motion, and why in words; None: nothing does.

        Args:
            past: since it began [s].
            tool: what the tool feels.
        """
        while self._left and self._left[0].begin <= past:
            self._now, self._gone = self._left.pop(0), -1.0
        guard, size = self._now, float(np.linalg.norm(tool.force))
        empty = tool.vacuum is False
        self._gone = (past if self._gone < 0 else self._gone) if empty else -1.0
        if guard.hold == "made" and (tool.vacuum or (tool.grip or 0.0) > 0):
            return Stop.HELD, ""
        if guard.hold == "kept" and empty and past - self._gone > DEBOUNCE:
            return Stop.VACUUM, "the tool says that nothing is held"
        if guard.force is not None and size > guard.force:
            return Stop.FORCE, f"{size:.1f} N, more than {guard.force:g} N"
        if guard.contact is not None and size > guard.contact:
            return Stop.CONTACT, ""
        if guard.width is not None and tool.width is not None:
            low, high = guard.width
            if not low <= tool.width <= high:
                return Stop.WIDTH, f"the fingers are {1e3 * tool.width:.1f} mm apart"
        return None
