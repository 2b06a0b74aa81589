"""What depth pictures say of a small motion of a block: two kinds of residuals, both linear in it.

*Faces*: along the ray of a pixel, the depth that was read against that of the face which the ray
meets (point to plane). *Outlines*: where, across an edge beyond which nothing of the block is seen,
the picture changes from the face to what is farther behind it; what is known of that place is the
gap between the last pixel on the face and the first one behind it. A face says nothing of motions
within its plane, and an outline that runs on into a neighbour of the same height nothing at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.kernels import kernel
from learn2assemble.sensing.camera import DepthCamera, DepthPicture
from learn2assemble.sensing.faceted import Faceted

BORDER = 0.002
"""Pixels nearer to the border of a face than this may show its neighbour [m]."""
BEHIND = 0.006
"""What lies farther behind a face than this is not a part of it [m]."""
BEYOND = 0.002
"""A reading that is off by more than this beyond three standard deviations is of something else
[m]."""
GAP = 6
"""Most pixels between the last one on a face and the first one behind it."""
BLUR = 0.3
"""Standard deviation of the place of an outline that is not due to the pixels [pixels]."""
LEAST_OUTLINE = 0.25
"""Share of the places along an edge at which its outline has to be seen."""
MOST_CUT = 6.0
"""So many places along an outline at most count as independent."""
BACKGROUND = 4
"""Pixels beyond an outline that say what lies behind it."""
GRAZING = 0.12
"""A face whose normal has a smaller cosine with the ray says too little."""
MANY, FEW = 8000, 500
"""Pixels of a block that are used at the end and on the way there; of more than four times as many
every second one of every second row, and so on."""


# ---------------------------------------------------------------- residuals of one picture

COUNTS = 5
"""Kinds of pixels: on the faces, near the border, before them, behind them, not read."""


_Pair = tuple[np.ndarray, np.ndarray]
_Camera = tuple[np.ndarray, np.ndarray, float, tuple[float, float]]
_Arrays = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
_Sums = tuple[np.ndarray, np.ndarray, np.ndarray]


@kernel
def ray_meets(
    eye: np.ndarray, way: np.ndarray, normals: np.ndarray, offsets: np.ndarray, starts: np.ndarray
) -> tuple[float, int, float]:
    """Depth along a ray, the face it meets, and how far from the border of that; face -1: none."""
    best, face, border = np.inf, -1, 0.0
    for part in range(len(starts) - 1):
        enter, leave, first = -np.inf, np.inf, -1
        for f in range(starts[part], starts[part + 1]):
            towards = normals[f, 0] * way[0] + normals[f, 1] * way[1] + normals[f, 2] * way[2]
            room = offsets[f] - (
                normals[f, 0] * eye[0] + normals[f, 1] * eye[1] + normals[f, 2] * eye[2]
            )
            if towards < -1e-9:
                if room / towards > enter:
                    enter, first = room / towards, f
            elif towards > 1e-9:
                leave = min(leave, room / towards)
            elif room < 0:
                leave = -np.inf
        if first >= 0 and 0 < enter < leave and enter < best:
            best, face = enter, first
            border = np.inf
            for f in range(starts[part], starts[part + 1]):
                if f != first:
                    room = offsets[f]
                    for k in range(3):
                        room -= normals[f, k] * (eye[k] + enter * way[k])
                    border = min(border, room)
    return best, face, border


@kernel
def _turned(matrix: np.ndarray, vector: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` with matrix @ vector, both of three."""
    for i in range(3):
        out[i] = matrix[i, 0] * vector[0] + matrix[i, 1] * vector[1] + matrix[i, 2] * vector[2]


@kernel
def _lever(arm: np.ndarray, force: np.ndarray, out: np.ndarray, start: int) -> None:
    """Fill three of ``out`` with arm x force."""
    out[start] = arm[1] * force[2] - arm[2] * force[1]
    out[start + 1] = arm[2] * force[0] - arm[0] * force[2]
    out[start + 2] = arm[0] * force[1] - arm[1] * force[0]


@kernel
def _add(
    information: np.ndarray, gradient: np.ndarray, row: np.ndarray, residual: float, weight: float
) -> None:
    for i in range(6):
        scaled = weight * row[i]
        gradient[i] += scaled * residual
        for j in range(6):
            information[i, j] += scaled * row[j]


@kernel
def _robust(residual: float, sigma: float) -> float:
    """Weight of a residual: Tukey's, none from five standard deviations."""
    share = residual / (5.0 * sigma)
    return (1.0 - share * share) ** 2 if abs(share) < 1.0 else 0.0


@kernel
def _faces(
    picture: _Pair,
    window: np.ndarray,
    camera: _Camera,
    block: _Pair,
    shape: _Arrays,
    noise: tuple[float, float],
    gate: float,
    waves: float,
    sums: _Sums,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Add what the faces say; see :func:`normal_equations`. Returns, by face, whether it is seen,
    the pixels on it, and the sum of squared residuals in standard deviations."""
    depth, rays = picture
    information, gradient, counts = sums
    place, turn, _, _ = camera
    centre, attitude = block
    normals, offsets, starts, _, _ = shape
    # The rays in the frame of the shape.
    between = attitude.T @ turn
    origin = attitude.T @ (place - centre)
    stride = window[4]
    most = ((window[1] - window[0]) // stride + 1) * ((window[3] - window[2]) // stride + 1)
    hits, face_of = np.empty((most, 6)), np.empty(most, np.int64)
    on, before = np.zeros(len(normals)), np.zeros(len(normals))
    found = 0
    way = np.zeros(3)
    for v in range(window[0], window[1], stride):
        for u in range(window[2], window[3], stride):
            ray = rays[v, u]
            _turned(between, ray, way)
            there, face, border = ray_meets(origin, way, normals, offsets, starts)
            if face < 0:
                continue
            read = depth[v, u]
            if read <= 0.0:
                counts[4] += 1
                continue
            sigma = noise[0] + noise[1] * there * there
            residual = read - there
            wide = 3.0 * sigma + BEYOND
            if residual < -wide:
                counts[2] += 1
                before[face] += 1
            elif residual > wide:
                counts[3] += 1
            else:
                counts[0 if border >= BORDER else 1] += 1
                on[face] += 1
            if border >= BORDER and abs(residual) < gate + 3.0 * sigma:
                hits[found, :3] = way
                hits[found, 3], hits[found, 4], hits[found, 5] = there, residual, sigma
                face_of[found] = face
                found += 1
    seen = on > 2.0 * before
    of_face = np.zeros(len(normals))
    for n in range(found):
        of_face[face_of[n]] += 1
    squares = 0.0
    outward = normals @ attitude.T
    row, arm, normal, out = np.zeros(6), np.zeros(3), np.zeros(3), np.zeros(3)
    for n in range(found):
        face, there, residual, sigma = face_of[n], hits[n, 3], hits[n, 4], hits[n, 5]
        if not seen[face]:
            continue
        towards, length = 0.0, 0.0
        for k in range(3):
            towards += normals[face, k] * hits[n, k]
            length += hits[n, k] ** 2
        if -towards < GRAZING * np.sqrt(length):
            continue
        for k in range(3):
            arm[k] = origin[k] + there * hits[n, k]
            normal[k] = outward[face, k] / towards
        _turned(attitude, arm, out)
        row[:3] = normal
        _lever(out, normal, row, 3)
        squares += min(residual * residual / (sigma * sigma), 25.0)
        weight = _robust(residual, np.sqrt(sigma * sigma + gate * gate)) / (sigma * sigma)
        # The pixels of a face share an error.
        weight /= 1.0 + of_face[face] * (waves / sigma) ** 2
        _add(information, gradient, row, residual, weight)
    return seen, of_face, squares


@kernel
def _outlines(
    picture: _Pair,
    camera: _Camera,
    block: _Pair,
    shape: _Arrays,
    noise: tuple[float, float],
    seen_faces: np.ndarray,
    reach: int,
    sums: _Sums,
) -> int:
    """Add what the outlines say; see :func:`normal_equations`. Returns how many places."""
    depth, rays = picture
    information, gradient, _ = sums
    place, turn, focal, middle = camera
    centre, attitude = block
    normals, offsets, starts, edges, beside = shape
    floor, growth = noise[0], noise[1]
    rows, columns = depth.shape
    between = attitude.T @ turn
    inside = np.ascontiguousarray(between.T)
    origin = attitude.T @ (place - centre)
    found = 0
    ends, row = np.zeros((2, 2)), np.zeros(6)
    behind, behind_far = np.zeros(2 * reach + 6), np.zeros(2 * reach + 6)
    way, seen, world, along, in_camera = (
        np.zeros(3),
        np.zeros(3),
        np.zeros(3),
        np.zeros(3),
        np.zeros(3),
    )
    for e in range(len(edges)):
        one = normals[beside[e, 0]] @ origin - offsets[beside[e, 0]]
        two = normals[beside[e, 1]] @ origin - offsets[beside[e, 1]]
        if (one > 0) == (two > 0):
            continue
        face = beside[e, 0] if one > 0 else beside[e, 1]
        if not seen_faces[face]:
            continue
        normal = np.ascontiguousarray(normals[face])
        room = offsets[face] - normal @ origin
        ahead = True
        for k in range(2):
            _turned(inside, edges[e, k] - origin, seen)
            if seen[2] < 1e-3:
                ahead = False
                break
            ends[k, 0] = focal * seen[0] / seen[2] + middle[0]
            ends[k, 1] = focal * seen[1] / seen[2] + middle[1]
        if not ahead:
            continue
        long_u, long_v = ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1]
        length = np.sqrt(long_u * long_u + long_v * long_v)
        if length < 6.0:
            continue
        # Outwards: away from what of the shape is on the other side.
        out_u, out_v = long_v / length, -long_u / length
        inner = inside @ (-origin)
        side = (focal * inner[0] / inner[2] + middle[0] - ends[0, 0]) * out_u + (
            focal * inner[1] / inner[2] + middle[1] - ends[0, 1]
        ) * out_v
        if side > 0:
            out_u, out_v = -out_u, -out_v
        # Steps go on within the plane of the face, so that they stay on a neighbour beside it.
        edge = edges[e, 1] - edges[e, 0]
        across = np.cross(normal, edge) * (0.01 / np.sqrt(edge @ edge))
        half = inside @ ((edges[e, 0] + edges[e, 1]) / 2 - origin)
        beyond = half + inside @ across
        step_u = focal * (beyond[0] / beyond[2] - half[0] / half[2])
        step_v = focal * (beyond[1] / beyond[2] - half[1] / half[2])
        ahead_out = step_u * out_u + step_v * out_v
        if abs(ahead_out) < 0.3 * np.sqrt(step_u * step_u + step_v * step_v):
            continue
        step_u, step_v = step_u / ahead_out, step_v / ahead_out
        samples = int(length) - 3
        spread = min(1.0 + min(abs(long_u), abs(long_v)), MOST_CUT)
        start = found
        places = np.zeros((samples, 9))
        for s in range(samples):
            share = (s + 2.0) / (samples + 3.0)
            point = edges[e, 0] + share * (edges[e, 1] - edges[e, 0])
            _turned(inside, point - origin, seen)
            at_u = focal * seen[0] / seen[2] + middle[0]
            at_v = focal * seen[1] / seen[2] + middle[1]
            count, first = 0, -1
            for step in range(-reach, reach + BACKGROUND + 1):
                u, v = int(round(at_u + step * step_u)), int(round(at_v + step * step_v))
                if u < 0 or v < 0 or u >= columns or v >= rows:
                    break
                read = depth[v, u]
                if read <= 0.0:
                    continue
                _turned(between, rays[v, u], way)
                towards = normal[0] * way[0] + normal[1] * way[1] + normal[2] * way[2]
                if towards > -1e-6:
                    continue
                there = room / towards
                slack = 4.0 * (floor + growth * there * there)
                far = (u - at_u) * out_u + (v - at_v) * out_v
                if read < there - BEHIND - slack:
                    count = 0  # Something is before it.
                    break
                if first < 0:
                    if count == 0 and read > there + slack:
                        continue  # Not on the face yet.
                    if read > there + BEHIND + slack:
                        first = count
                if first >= 0 and far > 1.0:
                    # An outline only where the shape itself is not what lies behind.
                    _, other, _ = ray_meets(origin, way, normals, offsets, starts)
                    if other >= 0:
                        count = 0
                        break
                behind[count], behind_far[count] = read - there, far
                count += 1
                if first >= 0 and count > first + BACKGROUND:
                    break
            if first < 0 or count <= first + BACKGROUND:
                continue
            half_way = np.median(behind[first + 1 : count]) / 2
            # Pixels that mix face and background count as what they are nearer to.
            on, off = -1e9, 1e9
            for k in range(count):
                if behind[k] < half_way:
                    on = max(on, behind_far[k])
                else:
                    off = min(off, behind_far[k])
            gap = off - on
            if on < -1e8 or off > 1e8 or abs(gap) > GAP:
                continue
            places[found - start, 0] = (on + off) / 2
            places[found - start, 1] = gap * gap / 12 + BLUR * BLUR
            places[found - start, 2] = seen[2]
            # Picture coordinates across the edge against a motion of the point in the world.
            in_camera[0], in_camera[1] = focal * out_u / seen[2], focal * out_v / seen[2]
            in_camera[2] = -(seen[0] * in_camera[0] + seen[1] * in_camera[1]) / seen[2]
            _turned(turn, in_camera, along)
            _turned(attitude, point, world)
            places[found - start, 3:6] = along
            _lever(world, along, places[found - start], 6)
            found += 1
        if found - start < LEAST_OUTLINE * samples:
            found = start  # Stray pixels: an outline is seen along much of an edge.
            continue
        # Pixels cut an edge at the same place all along, where it runs with them.
        alike = max(1.0, (found - start) / spread)
        middle_off = np.median(places[: found - start, 0]) if found > start else 0.0
        for s in range(found - start):
            sigma = np.sqrt(places[s, 1] * alike)
            weight = _robust(places[s, 0] - middle_off, 2.0 * np.sqrt(places[s, 1]) + 0.5)
            row[:] = places[s, 3:9]
            _add(information, gradient, row, places[s, 0], weight / (sigma * sigma))
    return found


# ---------------------------------------------------------------- all pictures


class PreparedPicture(NamedTuple):
    """A picture with its camera as compiled code takes them."""

    depth: np.ndarray
    rays: np.ndarray
    camera: _Camera
    noise: tuple[float, float]
    waves: float
    device: DepthCamera


def views_of(
    pictures: Sequence[DepthPicture], cameras: Sequence[DepthCamera]
) -> tuple[PreparedPicture, ...]:
    """Pictures with the cameras of their names, for :func:`register`; those of other cameras and of
    another size are left out."""
    named = {camera.name: camera for camera in cameras}
    found = list[PreparedPicture]()
    for picture in pictures:
        camera = named.get(picture.camera)
        if camera is None or picture.depth.shape != camera.rays.shape[:2]:
            continue
        depth = np.ascontiguousarray(picture.depth, np.float64)
        place = camera.position, np.ascontiguousarray(camera.turn), camera.focal, camera.middle
        scale = camera.sigma(0.0) / camera.noise.floor if camera.noise.floor else 1.0
        noise = max(scale * camera.noise.floor, 1e-5), scale * camera.noise.growth
        found.append(PreparedPicture(depth, camera.rays, place, noise, camera.noise.waves, camera))
    return tuple(found)


def window_of(view: PreparedPicture, corners: np.ndarray, most: int = 1 << 30) -> np.ndarray | None:
    """int64[5]: rows, columns and stride of the pixels that may show a block with these corners;
    None: none do.

    Args:
        most: pixels that are enough, see :data:`MANY`.
    """
    place, turn, focal, middle = view.camera
    window = np.zeros(5, np.int64)
    found = _window(corners, place, turn, focal, middle, view.depth.shape, most, window)
    return window if found else None


@kernel
def _window(
    corners: np.ndarray,
    place: np.ndarray,
    turn: np.ndarray,
    focal: float,
    middle: tuple[float, float],
    size: tuple[int, ...],
    most: int,
    window: np.ndarray,
) -> bool:
    """Fill what :func:`window_of` returns; whether there is anything to see."""
    low_u, low_v, high_u, high_v = np.inf, np.inf, -np.inf, -np.inf
    for n in range(len(corners)):
        x, y, z = 0.0, 0.0, 0.0
        for k in range(3):
            away = corners[n, k] - place[k]
            x, y, z = x + away * turn[k, 0], y + away * turn[k, 1], z + away * turn[k, 2]
        if z < 0.01:
            return False
        u, v = focal * x / z + middle[0], focal * y / z + middle[1]
        low_u, high_u = min(low_u, u), max(high_u, u)
        low_v, high_v = min(low_v, v), max(high_v, v)
    if high_v < -2 or high_u < -2 or low_v > size[0] or low_u > size[1]:
        return False
    top, bottom = max(0, int(low_v)), min(size[0], int(high_v) + 2)
    left, right = max(0, int(low_u)), min(size[1], int(high_u) + 2)
    if top >= bottom or left >= right:
        return False
    window[:4] = top, bottom, left, right
    window[4] = max(1, int(np.sqrt((bottom - top) * (right - left) / most)))
    return True


class Sums(NamedTuple):
    """What the pictures say of a small motion of a block."""

    information: np.ndarray
    gradient: np.ndarray
    counts: np.ndarray
    squares: float
    of_face: tuple[np.ndarray, ...]


def normal_equations(
    views: Sequence[PreparedPicture],
    shape: Faceted,
    pose: np.ndarray,
    gate: float,
    reach: int,
    most: int = MANY,
) -> Sums:
    """Sums over all pictures at a pose.

    Args:
        gate: how far residuals of faces may be off beyond their noise [m].
        reach: of outlines [pixels]; 0: without them.
    """
    information, gradient = np.zeros((6, 6)), np.zeros(6)
    counts, squares, of_faces = np.zeros(COUNTS, np.int64), 0.0, list[np.ndarray]()
    sums = information, gradient, counts
    block = pose[:3].copy(), np.ascontiguousarray(quaternion_matrix(pose[3:]))
    arrays = shape.normals, shape.offsets, shape.starts, shape.edges, shape.beside
    corners = pose[:3] + shape.corners @ block[1].T
    for view in views:
        window = window_of(view, corners, most)
        if window is None:
            of_faces.append(np.zeros(len(shape.normals)))
            continue
        picture = view.depth, view.rays
        seen, of_face, more = _faces(
            picture, window, view.camera, block, arrays, view.noise, gate, view.waves, sums
        )
        of_faces.append(of_face)
        squares += more
        if reach:
            _outlines(picture, view.camera, block, arrays, view.noise, seen, reach, sums)
    return Sums(information, gradient, counts, squares, tuple(of_faces))
