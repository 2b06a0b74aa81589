"""What space an arm may be in while it moves, and whether two arms that move keep their distance,
whatever each is doing of its way when: no clock has to agree."""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np

from learn2assemble.kernels import kernel
from learn2assemble.kinematics.capsules import Capsules, between_lines, placed
from learn2assemble.kinematics.chain import get_chain
from learn2assemble.robot.arm import Arm

LENGTH = 0.006
"""No point moves farther between two postures of a sweep that are next to each other [m]."""
BEFORE = 2
"""An arm that strays from its way by less than half a :data:`LENGTH` is not farther back on it than
so many postures before the one that looks most like it."""


class Sweep(NamedTuple):
    """Postures on a way, each with the lines of its capsules."""

    lines: np.ndarray
    """float64[m, c, 2, 3] [m, world]."""
    radius: np.ndarray
    """float64[c] [m]."""
    way: np.ndarray
    """float64[m, c]: no point of a capsule moves farther between two postures than these differ
    [m]."""

    @property
    def end(self) -> Sweep:
        """Standing at its end."""
        return Sweep(self.lines[-1:], self.radius, self.way[-1:])

    @property
    def begin(self) -> Sweep:
        """Standing at its beginning."""
        return Sweep(self.lines[:1], self.radius, self.way[:1])

    def from_near(self, joints: Sweep) -> Sweep:
        """What is left of it for an arm that is near one of its postures: all from
        :data:`BEFORE` postures before that on.

        Args:
            joints: the arm, standing there, with the same capsules.
        """
        off = np.linalg.norm(self.lines - joints.lines[-1], axis=3).max((1, 2))
        first = max(int(off.argmin()) - BEFORE, 0)
        return Sweep(self.lines[first:], self.radius, self.way[first:])


def sweep(arm: Arm, capsules: Capsules, joints: np.ndarray) -> Sweep:
    """The sweep of an arm along straight connections of joints float64[k, n] [rad].

    Args:
        capsules: of the arm and of what it holds.
    """
    chain = get_chain(arm)
    reach = capsules.reach(chain)
    steps = np.abs(np.diff(joints, axis=0)) @ reach
    far = np.r_[0.0, np.cumsum(steps)]
    if far[-1] == 0.0:
        lines = placed(chain, capsules, joints[:1].copy())
        return Sweep(lines, capsules.radius, np.zeros(lines.shape[:2]))
    # Corners of the way are postures, too.
    even = np.linspace(0.0, float(far[-1]), int(np.ceil(far[-1] / LENGTH)) + 1)
    at, kept = np.union1d(even, far), np.r_[True, steps > 0]
    turns = [cast("np.ndarray", np.interp(at, far[kept], q[kept])) for q in joints.T]
    between = np.column_stack(turns)
    lines = placed(chain, capsules, between)
    # An end of a line moves on an arc of no more acceleration than its reach times the square of
    # the sum of the angles, so it is longer than its chord by less than a quarter of that; all
    # other points of a capsule move by no more than the farther end.
    chord = np.linalg.norm(np.diff(lines, axis=0), axis=3).max(2)
    bend = reach.max() * np.abs(np.diff(between, axis=0)).sum(1) ** 2 / 4
    moves = np.minimum(chord + bend[:, None], np.diff(at)[:, None])
    way = np.vstack([np.zeros(len(capsules.radius)), np.cumsum(moves, axis=0)])
    return Sweep(lines, capsules.radius, way)


def still(block: Capsules) -> Sweep:
    """The sweep of something that stands."""
    return Sweep(block.ends[None].copy(), block.radius, np.zeros((1, len(block.radius))))


def clear(one: Sweep, other: Sweep, margin: float) -> bool:
    """Whether two keep at least so far from each other [m], wherever each is on its way."""
    return bool(_clear(*one, *other, margin))


@kernel
def _near(
    lines: np.ndarray,
    radius: np.ndarray,
    far: np.ndarray,
    others: np.ndarray,
    other_radius: np.ndarray,
    other_far: np.ndarray,
    margin: float,
) -> int:
    """Whether capsules come nearer than ``margin`` for certain (2), perhaps (1) or not at all (0),
    where they move by as much as ``far`` and ``other_far``, float64[c] and float64[d] [m]."""
    found = 0
    for c in range(lines.shape[0]):
        a = lines[c]
        mx, my, mz = a[0, 0] + a[1, 0], a[0, 1] + a[1, 1], a[0, 2] + a[1, 2]
        half = (
            (a[1, 0] - a[0, 0]) ** 2 + (a[1, 1] - a[0, 1]) ** 2 + (a[1, 2] - a[0, 2]) ** 2
        ) ** 0.5
        for d in range(others.shape[0]):
            b = others[d]
            size = (
                (b[1, 0] - b[0, 0]) ** 2 + (b[1, 1] - b[0, 1]) ** 2 + (b[1, 2] - b[0, 2]) ** 2
            ) ** 0.5
            sure = radius[c] + other_radius[d] + margin
            bound = sure + far[c] + other_far[d]
            # Twice the distance of the middles.
            x = mx - b[0, 0] - b[1, 0]
            y = my - b[0, 1] - b[1, 1]
            z = mz - b[0, 2] - b[1, 2]
            if x * x + y * y + z * z >= (2 * bound + half + size) ** 2:
                continue
            gap = between_lines(a, b)
            if gap < sure:
                return 2
            if gap < bound:
                found = 1
    return found


@kernel
def _clear(
    lines: np.ndarray,
    radius: np.ndarray,
    way: np.ndarray,
    others: np.ndarray,
    other_radius: np.ndarray,
    other_way: np.ndarray,
    margin: float,
) -> bool:
    """Halves both ways until the distances at two postures say that their surroundings are free, or
    neighbours are left whose distances do not."""
    stack = [(0, lines.shape[0] - 1, 0, others.shape[0] - 1)]
    while len(stack):
        a, b, c, d = stack.pop()
        if b - a <= 1 and d - c <= 1:
            # Whatever lies between neighbours is within half of their way of one of them.
            half, other_half = (way[b] - way[a]) / 2, (other_way[d] - other_way[c]) / 2
            for k in (a, b):
                for m in (c, d):
                    near = _near(
                        lines[k], radius, half, others[m], other_radius, other_half, margin
                    )
                    if near:
                        return False
            continue
        i, j = (a + b) // 2, (c + d) // 2
        far = np.maximum(way[i] - way[a], way[b] - way[i])
        other_far = np.maximum(other_way[j] - other_way[c], other_way[d] - other_way[j])
        near = _near(lines[i], radius, far, others[j], other_radius, other_far, margin)
        if near == 2:
            return False
        if near == 0:
            continue
        if d - c <= 1 or (b - a > 1 and far.max() >= other_far.max()):
            stack.append((a, i, c, d))
            stack.append((i, b, c, d))
        else:
            stack.append((a, b, c, j))
            stack.append((a, b, j, d))
    return True
