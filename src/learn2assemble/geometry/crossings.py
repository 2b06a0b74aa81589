"""Edges that run through triangles, found in a tree of boxes."""

from __future__ import annotations

import numpy as np

from learn2assemble.kernels import kernel

_NONE, _PADDING = -1, -2
"""In place of a vertex: none, and any, below nodes without triangles."""
_GRID = 1024
"""Steps along every axis in which triangles are sorted for the tree."""


def find_crossing(
    points: np.ndarray, edges: np.ndarray, triangles: np.ndarray, depth: float, inside: float
) -> np.ndarray | None:
    """int64[2]: the first edge that runs through the inside of a triangle, or None.

    Args:
        points: float64[V, 3].
        edges, triangles: int64[E, 2] and int64[T, 3], vertices; those that share one are no pair.
        depth: how far both ends have to be from the plane of the triangle, on either side.
        inside: how far within its edges the triangle has to be met, as a share of its size.
    """
    corners = points[triangles]
    low, high = corners.min(1), corners.max(1)
    order = np.argsort(_curve((low + high) / 2), kind="stable")
    leaves = 1 << max(len(triangles) - 1, 1).bit_length()
    # Boxes of a complete tree: those of node n are around those of 2 n and 2 n + 1.
    below, above = np.full((2 * leaves, 3), np.inf), np.full((2 * leaves, 3), -np.inf)
    below[leaves : leaves + len(order)] = low[order]
    above[leaves : leaves + len(order)] = high[order]
    # Vertices that all triangles of a node have: their edges pass all of it. A fan of thousands of
    # narrow triangles, whose boxes all overlap, is done with at once.
    shared = np.full((2 * leaves, 3), _PADDING, np.int64)
    shared[leaves : leaves + len(order)] = triangles[order]
    first = leaves // 2
    while first:
        pairs = slice(2 * first, 4 * first)
        below[first : 2 * first] = below[pairs].reshape(first, 2, 3).min(1)
        above[first : 2 * first] = above[pairs].reshape(first, 2, 3).max(1)
        shared[first : 2 * first] = _common(*shared[pairs].reshape(first, 2, 3).swapaxes(0, 1))
        first //= 2
    found = _search(
        np.ascontiguousarray(points, np.float64),
        edges.astype(np.int64),
        shared,
        below,
        above,
        depth,
        inside,
    )
    return None if found < 0 else edges[found]


def _common(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """int64[N, 3]: the vertices of each row of one array that the same row of another has, too."""
    both = np.where((one[:, :, None] == other[:, None]).any(2), one, _NONE)
    both = np.where(other == _PADDING, one, both)
    return np.where(one == _PADDING, other, both)


def _curve(centres: np.ndarray) -> np.ndarray:
    """int64[T]: places along a curve that keeps what is near together (Morton)."""
    size = np.maximum(np.ptp(centres, axis=0), 1e-300)
    steps = np.clip((centres - centres.min(0)) / size * _GRID, 0, _GRID - 1).astype(np.int64)
    code = np.zeros(len(centres), np.int64)
    for bit in range(_GRID.bit_length() - 1):
        for axis in range(3):
            code |= (steps[:, axis] >> bit & 1) << (3 * bit + axis)
    return code


@kernel
def _search(
    points: np.ndarray,
    edges: np.ndarray,
    shared: np.ndarray,
    below: np.ndarray,
    above: np.ndarray,
    depth: float,
    inside: float,
) -> int:
    """The index of the first edge that crosses a triangle, or -1; ``shared`` of a leaf are the
    vertices of its triangle."""
    leaves = len(below) // 2
    stack = np.empty(128, np.int64)
    for e in range(len(edges)):
        i, j = edges[e]
        x0, x1 = min(points[i, 0], points[j, 0]), max(points[i, 0], points[j, 0])
        y0, y1 = min(points[i, 1], points[j, 1]), max(points[i, 1], points[j, 1])
        z0, z1 = min(points[i, 2], points[j, 2]), max(points[i, 2], points[j, 2])
        stack[0] = 1
        top = 1
        while top:
            top -= 1
            n = stack[top]
            if (
                below[n, 0] > x1
                or above[n, 0] < x0
                or below[n, 1] > y1
                or above[n, 1] < y0
                or below[n, 2] > z1
                or above[n, 2] < z0
            ):
                continue
            u, v, w = shared[n]
            if i in (u, v, w) or j in (u, v, w):
                continue
            if n < leaves:
                stack[top], stack[top + 1] = 2 * n + 1, 2 * n
                top += 2
            elif _crosses(points, i, j, shared[n], depth, inside):
                return e
    return -1


@kernel
def _crosses(
    points: np.ndarray, i: int, j: int, triangle: np.ndarray, depth: float, inside: float
) -> bool:
    """Whether the edge from i to j runs through a triangle that has neither."""
    u, v, w = triangle
    p, q = points[i], points[j]
    ax, ay, az = points[u, 0] - p[0], points[u, 1] - p[1], points[u, 2] - p[2]
    bx, by, bz = points[v, 0] - p[0], points[v, 1] - p[1], points[v, 2] - p[2]
    cx, cy, cz = points[w, 0] - p[0], points[w, 1] - p[1], points[w, 2] - p[2]
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    # Normal of the triangle.
    nx = (by - ay) * (cz - az) - (bz - az) * (cy - ay)
    ny = (bz - az) * (cx - ax) - (bx - ax) * (cz - az)
    nz = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    length = max(np.sqrt(nx * nx + ny * ny + nz * nz), 1e-300)
    start = -(ax * nx + ay * ny + az * nz) / length
    end = start + (dx * nx + dy * ny + dz * nz) / length
    if min(start, end) >= -depth or max(start, end) <= depth:
        return False
    room = inside * length * np.sqrt(dx * dx + dy * dy + dz * dz)
    # On which side of every edge the line passes (triple products).
    ab = (ay * bz - az * by) * dx + (az * bx - ax * bz) * dy + (ax * by - ay * bx) * dz
    bc = (by * cz - bz * cy) * dx + (bz * cx - bx * cz) * dy + (bx * cy - by * cx) * dz
    ca = (cy * az - cz * ay) * dx + (cz * ax - cx * az) * dy + (cx * ay - cy * ax) * dz
    low, high = min(ab, bc, ca), max(ab, bc, ca)
    return low > room or high < -room
