"""Orientations as quaternions (w, x, y, z)."""

from __future__ import annotations

import numpy as np


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Of two quaternions: first turn by ``b``, then by ``a``."""
    w, v = a[0], a[1:]
    return np.array([w * b[0] - v @ b[1:], *(w * b[1:] + b[0] * v + np.cross(v, b[1:]))])


def quaternion_of(rotation: np.ndarray) -> np.ndarray:
    """float64[4] (w, x, y, z) of a rotation float64[3, 3]."""
    m = rotation
    # Of the four ways to write it, the one whose first divisor is largest.
    all_four = np.array([
        [1 + m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
        [m[2, 1] - m[1, 2], 1 + m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
        [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], 1 - m[0, 0] + m[1, 1] - m[2, 2], m[1, 2] + m[2, 1]],
        [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], 1 - m[0, 0] - m[1, 1] + m[2, 2]],
    ])  # fmt: skip
    best = all_four[int(np.argmax(np.diag(all_four)))]
    return best / np.linalg.norm(best)


def blend(a: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    """Between two orientations: the shorter way, normalised."""
    mixed = (1 - share) * a + share * (b if a @ b >= 0 else -b)
    return mixed / np.linalg.norm(mixed)


def rotation_of(quaternion: np.ndarray) -> np.ndarray:
    """float64[..., 3, 3] of unit quaternions float64[..., 4]."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))
