"""Rotations: quaternions (w, x, y, z), matrices and rotation vectors.

Quaternions are of unit length; ``a * b`` turns by ``b`` first. Matrices map coordinates of the
turned frame to the fixed one. Angles in radians.
"""

from __future__ import annotations

import math

import numpy as np

from learn2assemble.kernels import kernel


def yaw_quaternion(yaw: np.ndarray | float) -> np.ndarray:
    """float64[..., 4]: quaternions of rotations about z by ``yaw`` float64[...] [rad]."""
    half = np.asarray(yaw, float) / 2
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], -1)


def yaw_matrix(yaw: float) -> np.ndarray:
    """float64[3, 3]: rotation about z by ``yaw`` [rad]; exact for quarter turns."""
    quarters = yaw / (math.pi / 2)
    if abs(quarters - round(quarters)) < 1e-9:
        c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[round(quarters) % 4]
    else:
        c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def quaternion_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """float64[4]: the rotation ``b`` followed by ``a``."""
    w, x, y, z = (float(k) for k in a)
    t, u, v, s = (float(k) for k in b)
    return np.array(
        [
            w * t - (x * u + y * v + z * s),
            w * u + t * x + (y * s - z * v),
            w * v + t * y + (z * u - x * s),
            w * s + t * z + (x * v - y * u),
        ]
    )


def quaternion_matrix(quaternion: np.ndarray) -> np.ndarray:
    """float64[..., 3, 3] of quaternions float64[..., 4]."""
    flat = np.ascontiguousarray(quaternion, float).reshape(-1, 4)
    return quaternion_matrices(flat).reshape(*np.shape(quaternion)[:-1], 3, 3)


@kernel
def quaternion_matrices(quaternion: np.ndarray) -> np.ndarray:
    """Compiled :func:`quaternion_matrix`: float64[n, 3, 3] of float64[n, 4]."""
    out = np.empty((len(quaternion), 3, 3))
    for b in range(len(quaternion)):
        w, x, y, z = quaternion[b]
        out[b, 0] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        out[b, 1] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        out[b, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return out


def matrix_quaternion(rotation: np.ndarray) -> np.ndarray:
    """float64[4] of a rotation matrix float64[3, 3]."""
    m = rotation
    # Of the four ways to write it, the one whose first divisor is largest.
    all_four = np.array(
        [
            [
                1 + m[0, 0] + m[1, 1] + m[2, 2],
                m[2, 1] - m[1, 2],
                m[0, 2] - m[2, 0],
                m[1, 0] - m[0, 1],
            ],
            [
                m[2, 1] - m[1, 2],
                1 + m[0, 0] - m[1, 1] - m[2, 2],
                m[0, 1] + m[1, 0],
                m[0, 2] + m[2, 0],
            ],
            [
                m[0, 2] - m[2, 0],
                m[0, 1] + m[1, 0],
                1 - m[0, 0] + m[1, 1] - m[2, 2],
                m[1, 2] + m[2, 1],
            ],
            [
                m[1, 0] - m[0, 1],
                m[0, 2] + m[2, 0],
                m[1, 2] + m[2, 1],
                1 - m[0, 0] - m[1, 1] + m[2, 2],
            ],
        ]
    )
    best = all_four[int(np.argmax(np.diag(all_four)))]
    return best / np.linalg.norm(best)


def interpolate_quaternions(a: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    """float64[4]: from ``a`` (share 0) to ``b`` (share 1) the shorter way, linearly."""
    mixed = (1 - share) * a + share * (b if a @ b >= 0 else -b)
    return mixed / np.linalg.norm(mixed)


def rotate_vectors(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Vectors float64[..., 3] rotated by quaternions float64[..., 4]."""
    w, axis = quaternion[..., :1], quaternion[..., 1:]
    across = 2 * np.cross(axis, vector)
    return vector + w * across + np.cross(axis, across)


def stepped_pose(pose: np.ndarray, step: np.ndarray) -> np.ndarray:
    """A pose float64[7] that is moved by float64[3] [m] and turned by a rotation vector about fixed
    axes float64[3] [rad], both in ``step``."""
    x, y, z, a, b, c = (float(k) for k in step)
    angle = math.sqrt(a * a + b * b + c * c)
    half = 0.5 if angle < 1e-9 else math.sin(angle / 2) / angle
    turn = np.array([math.cos(angle / 2), half * a, half * b, half * c])
    turned = quaternion_product(turn, pose[3:])
    turned /= math.sqrt(turned @ turned)
    return np.array([pose[0] + x, pose[1] + y, pose[2] + z, *turned])


def cube_yaw(rotation: np.ndarray) -> float:
    """Yaw [rad] of a cube with rotation float64[3, 3], on whichever face it lies: that of its
    first or second axis, whichever is closer to horizontal."""
    axis = int(np.argmin(np.abs(rotation[2, :2])))
    x, y = rotation[:2, axis]
    yaw = np.arctan2(y, x) - axis * np.pi / 2
    return float((yaw + np.pi) % (2 * np.pi) - np.pi)


@kernel
def rotation_vector(a: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    """Fill out[3] with the vector [rad, fixed axes] that rotates matrix ``a`` into ``b``."""
    # R = b a^T
    xx = yy = zz = xy = yx = xz = zx = yz = zy = 0.0
    for k in range(3):
        xx += b[0, k] * a[0, k]
        yy += b[1, k] * a[1, k]
        zz += b[2, k] * a[2, k]
        xy += b[0, k] * a[1, k]
        yx += b[1, k] * a[0, k]
        xz += b[0, k] * a[2, k]
        zx += b[2, k] * a[0, k]
        yz += b[1, k] * a[2, k]
        zy += b[2, k] * a[1, k]
    x, y, z = 0.5 * (zy - yz), 0.5 * (xz - zx), 0.5 * (yx - xy)
    sine = np.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (xx + yy + zz - 1.0)
    angle = np.arctan2(sine, cosine)
    if sine > 1e-6:
        factor = angle / sine
        out[0], out[1], out[2] = factor * x, factor * y, factor * z
    elif cosine > 0:
        out[0], out[1], out[2] = x, y, z
    else:
        # Half a turn: R + 1 = 2 u u^T, whose longest column gives the axis u.
        if xx >= yy and xx >= zz:
            x, y, z = xx + 1, 0.5 * (xy + yx), 0.5 * (xz + zx)
        elif yy >= zz:
            x, y, z = 0.5 * (xy + yx), yy + 1, 0.5 * (yz + zy)
        else:
            x, y, z = 0.5 * (xz + zx), 0.5 * (yz + zy), zz + 1
        factor = angle / np.sqrt(x * x + y * y + z * z)
        out[0], out[1], out[2] = factor * x, factor * y, factor * z


def rotation_of(vector: np.ndarray) -> np.ndarray:
    """float64[3, 3]: the turn about a vector by its length [rad]."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3) + _cross(vector)
    across = _cross(vector / angle)
    return np.eye(3) + math.sin(angle) * across + (1 - math.cos(angle)) * across @ across


def _cross(v: np.ndarray) -> np.ndarray:
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
