"""Small compiled helpers on rotations and 6x6 systems."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def rotation_vector(a, b, out):
    """Fills out[3] with the vector [rad, world axes] that turns rotation ``a`` into ``b``."""
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


@njit(cache=True)
def factorise(matrix, size):
    """Replaces the lower half of a symmetric positive definite matrix by its Cholesky factor.

    Returns False, with the factor unfinished, where the matrix is not positive definite.
    """
    for i in range(size):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if total <= 1e-300:
                    return False
                matrix[i, i] = np.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    return True


@njit(cache=True)
def solve_factorised(factor, size, vector):
    """Solves with a Cholesky factor, in place."""
    for i in range(size):
        for k in range(i):
            vector[i] -= factor[i, k] * vector[k]
        vector[i] /= factor[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            vector[i] -= factor[k, i] * vector[k]
        vector[i] /= factor[i, i]


@njit(cache=True)
def smallest_singular_value(jacobian, rows):
    """Of the first ``rows`` rows, by inverse iteration on J J^T; 0 where that is singular."""
    gram = np.empty((6, 6))
    for i in range(rows):
        for j in range(i + 1):
            total = 0.0
            for k in range(jacobian.shape[1]):
                total += jacobian[i, k] * jacobian[j, k]
            gram[i, j] = total
    if not factorise(gram, rows):
        return 0.0
    vector, size = np.empty(6), 1.0
    for i in range(6):
        vector[i] = 1.0 + i
    for _ in range(12):
        solve_factorised(gram, rows, vector)
        size = 0.0
        for i in range(rows):
            size += vector[i] * vector[i]
        size = np.sqrt(size)
        for i in range(rows):
            vector[i] /= size
    return 1.0 / np.sqrt(size)


@njit(cache=True)
def logarithm(position, rotation, out):
    """log6 of a rigid transform: out[:3] translation part [m], out[3:] rotation vector [rad]."""
    rotation_vector(np.eye(3), rotation, out[3:])
    x, y, z = out[3], out[4], out[5]
    square = x * x + y * y + z * z
    if square < 1e-12:
        factor = 1.0 / 12.0
    else:
        angle = np.sqrt(square)
        factor = (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / square
    px, py, pz = position[0], position[1], position[2]
    # v = p - w x p / 2 + factor * w x (w x p)
    cx, cy, cz = y * pz - z * py, z * px - x * pz, x * py - y * px
    out[0] = px - 0.5 * cx + factor * (y * cz - z * cy)
    out[1] = py - 0.5 * cy + factor * (z * cx - x * cz)
    out[2] = pz - 0.5 * cz + factor * (x * cy - y * cx)
