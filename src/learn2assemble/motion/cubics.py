"""Motions between their samples, where they are cubics: at any time, with fewer samples, slower."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from learn2assemble.motion.plant import Commands, Guard, Guards, Motion, ToolCommand, between

CLOSE = 5e-5
"""A motion with fewer samples is nowhere farther from the one it was [rad]."""
LONGEST = 0.25
"""Between two of its samples [s]."""


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


def slower(
    motion: Motion, commands: Commands, guards: Guards, factor: float
) -> tuple[Motion, list[ToolCommand], list[Guard]]:
    """A motion on the same path in ``factor`` times its time, with what happens during it."""
    return (
        Motion(motion.stage, motion.time * factor, motion.joints, motion.velocity / factor),
        [one._replace(at=one.at * factor) for one in commands],
        [one._replace(begin=one.begin * factor) for one in guards],
    )
