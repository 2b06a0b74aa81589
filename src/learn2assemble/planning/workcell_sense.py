"""What is believed of where blocks are, and how the next placement is corrected by it.

Readings are noisy. The estimate of a block begins where the arm has put it, as exactly as the arm
places, and is averaged with the readings since then (a Kalman filter of a block at rest); a reading
that is off by far means that the block was moved.
"""

from __future__ import annotations

import math

import numpy as np

from learn2assemble.geometry.rotations import (
    matrix_quaternion,
    quaternion_matrix,
    yaw_quaternion,
)
from learn2assemble.planning.workcell import World

STEADY, STEADY_YAW = 3e-4, 3e-3
"""How exactly the arm places a block: standard deviations of x and y [m] and of its yaw [rad]."""
DRIFT, DRIFT_YAW = 5e-5, 1e-4
"""By which the estimate of a block at rest may be wrong anew after every attempt [m], [rad]."""
SPREAD = 5.0
"""A reading that is off by more standard deviations means that the block has moved."""


def read_back(
    belief: np.ndarray,
    variance: np.ndarray,
    true: np.ndarray,
    noise: tuple[float, float],
    rng: np.random.Generator,
) -> None:
    """Read the pose of a block back; height and lean are read exactly.

    Args:
        belief: float64[7], the estimate; changed.
        variance: float64[2], of its place and of its yaw; changed.
        true: float64[7].
        noise: standard deviations of a reading: x and y [m], yaw [rad].
        rng: draws the noise.
    """
    place, turn = noise
    seen, spin = true[:2] + rng.normal(0.0, place, 2), rng.normal(0.0, turn)
    variance += DRIFT**2, DRIFT_YAW**2
    if np.abs(seen - belief[:2]).max() > SPREAD * math.hypot(math.sqrt(variance[0]), place):
        belief[:2], variance[:] = seen, (place**2, turn**2)
    gain = variance / (variance + np.array([place**2, turn**2]) + 1e-18)
    belief[:2] += gain[0] * (seen - belief[:2])
    variance *= 1 - gain
    # The error of the yaw shrinks with the readings as that of the place does.
    spun = yaw_quaternion(spin * math.sqrt(float(gain[1])))
    belief[2] = true[2]
    belief[3:] = matrix_quaternion(quaternion_matrix(spun) @ quaternion_matrix(true[3:]))


def fitted(world: World, belief: np.ndarray, standing: set[int], k: int) -> np.ndarray:
    """Where a block goes, shifted by the little that its neighbours are off.

    Args:
        belief: float64[N, 7] of all blocks.
        standing: pieces in the structure, without the block itself.
        k: the block.

    Returns:
        float64[7]: in the middle of a slot that is too narrow for half a joint on both sides.
    """
    piece, goal, joint = world.pieces[k], world.target(k), world.job.joint
    low, high = np.full(2, -np.inf), np.full(2, np.inf)
    rise = []
    mine = piece.boxes(piece.target, piece.yaw)
    for n in sorted(standing):
        other = world.pieces[n]
        if np.abs(other.target - piece.target).max() > 1.0:
            continue
        shift = belief[n, :3] - other.target
        theirs = other.boxes(other.target, other.yaw)
        for (a, b), (c, d) in ((m, t) for m in mine for t in theirs):
            shared = np.minimum(b, d) - np.maximum(a, c)
            if (shared[:2] > 1e-3).all() and abs(d[2] - a[2]) < 1e-3:
                rise.append(shift[2])
            for axis in (0, 1):
                if shared[1 - axis] < 1e-3 or shared[2] < 1e-3 or shared[axis] > 1e-3:
                    continue
                if c[axis] >= b[axis] - 1e-3:
                    free = c[axis] + shift[axis] - b[axis] - joint / 2
                    high[axis] = min(high[axis], free)
                else:
                    free = d[axis] + shift[axis] - a[axis] + joint / 2
                    low[axis] = max(low[axis], free)
    for axis in (0, 1):
        a, b = low[axis], high[axis]
        if a > b:
            goal[axis] += (a + b) / 2
        else:
            goal[axis] += min(max(0.0, a), b)
    if rise:
        goal[2] += float(np.mean(rise))
    return goal
