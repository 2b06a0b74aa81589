"""Where base, table and cameras really are, from what the arm touched and cameras saw.

World frame: the table is its plane z = 0. The unknowns are the pose of the base in it, all six
coordinates (its height and its lean are those of the table as the arm meets it), and the pose of
every camera. All readings are weighed together: least squares with weights that fall for readings
that are far off, and what the layout says as a wide prior. What no reading tells keeps the width of
that prior.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from learn2assemble.errors import InputError, check_name
from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix
from learn2assemble.sensing.camera import DepthCamera, DepthPicture, rotation
from learn2assemble.sensing.tags import CORNER, SQUARE, FoundTag

PRIOR, PRIOR_TURN = 0.03, 0.1
"""How far from what the layout says base and cameras may be: standard deviations [m], [rad]."""
TOLD = 0.7
"""What has become narrower than this share of the prior was told by readings."""
FAR_OFF = 3.0
"""Readings that are off by more standard deviations count less."""
ROUNDS, SMALL = 30, 1e-9
TABLE_PIXELS = 400
"""So many pixels of a picture say where the table is."""
NEAR_TABLE = 0.02
"""Pixels farther from where the table is taken to be show something else [m]."""


class Touch(NamedTuple):
    """A place that the tip of the tool touched."""

    tip: np.ndarray
    """float64[3]: where the tip was, in the frame of the base [m]."""
    at: np.ndarray | None = None
    """float64[3]: what it touched, in the world [m]; None: the table, somewhere."""
    sigma: float = 3e-4
    """Standard deviation along each axis [m]."""


class Sighting(NamedTuple):
    """A place that a camera saw and that is known otherwise."""

    camera: str
    seen: np.ndarray
    """float64[3]: in the frame of the camera [m]."""
    at: np.ndarray | None = None
    """float64[3]: where it is in the world, or ..."""
    tip: np.ndarray | None = None
    """... float64[3]: in the frame of the base, because the arm has put it there; None of both: it
    is on the table [m]."""
    sigma: float = 1e-3
    """Standard deviation along each axis [m]."""


class TagSighting(NamedTuple):
    """A tag that a camera saw and that lies where it is known to lie."""

    camera: str
    tag: FoundTag
    pose: np.ndarray
    """float64[7]: in the world."""
    size: float
    """[m]"""


Sightings = Touch | Sighting | TagSighting


class Calibrated(NamedTuple):
    """What came of it."""

    base: np.ndarray
    """float64[7]: pose of the base in the world."""
    base_covariance: np.ndarray
    """float64[6, 6]: position [m] and small rotation about the axes of the world [rad]."""
    cameras: tuple[DepthCamera, ...]
    """With their covariances; as they were where no reading tells anything of them."""
    told: Mapping[str, tuple[bool, ...]]
    """By ``base`` and the names of cameras: which of the six coordinates readings told."""
    residual: float
    """Root mean square of what readings are off, in their standard deviations."""
    worst: tuple[int, float]
    """Number of the reading that is farthest off, and how far, in its standard deviations."""


def calibrated(
    base: np.ndarray, cameras: Sequence[DepthCamera], readings: Sequence[Sightings]
) -> Calibrated:
    """Where base and cameras are.

    Args:
        base: float64[7]: pose of the base as it is taken to be.
        cameras: where they are taken to be.
        readings: what was touched and seen.

    Raises:
        InputError: without readings, and for one of a camera that does not exist.
    """
    if not readings:
        raise InputError("readings", "none", "what the arm touched or a camera saw")
    named = {camera.name: n for n, camera in enumerate(cameras)}
    for k, one in enumerate(readings):
        if not isinstance(one, Touch):
            check_name(f"readings[{k}].camera", one.camera, named)
    starts = [np.array(base, float), *(np.array(camera.pose) for camera in cameras)]
    poses = [pose.copy() for pose in starts]
    width = np.tile([PRIOR] * 3 + [PRIOR_TURN] * 3, len(poses))
    offset = np.zeros(len(width))
    count = len(width)
    information, errors, owner = np.eye(count), np.zeros(0), np.zeros(0, int)
    for _ in range(ROUNDS):
        errors, rows, owner = _linear(poses, cameras, named, readings)
        size = np.sqrt(np.bincount(owner, errors**2) / np.bincount(owner))[owner]
        weight = np.minimum(1.0, (FAR_OFF / np.maximum(size, 1e-12)) ** 2)
        information = (rows * weight[:, None]).T @ rows + np.diag(1 / width**2)
        step = np.linalg.solve(information, rows.T @ (weight * errors) - offset / width**2)
        offset += step
        poses = [_moved(pose, step[6 * n : 6 * n + 6]) for n, pose in enumerate(poses)]
        if np.abs(step).max() < SMALL:
            break
    covariance = np.linalg.inv(information)
    errors, _, owner = _linear(poses, cameras, named, readings)
    size = np.sqrt(np.bincount(owner, errors**2) / np.bincount(owner))
    residual = float(np.sqrt(np.mean(errors**2)))
    free = max(len(errors) - count, 1)
    covariance *= max(1.0, float(np.minimum(errors**2, FAR_OFF**2).sum()) / free)
    told, found = dict[str, tuple[bool, ...]](), list[DepthCamera]()
    for n, name in enumerate(["base", *named]):
        block = covariance[6 * n : 6 * n + 6, 6 * n : 6 * n + 6]
        spread = np.sqrt(np.diag(block))
        told[name] = tuple((spread < TOLD * width[:6]).tolist())
        if n and any(told[name]):
            camera = cameras[n - 1]
            spreads: list[list[float]] = ((block + block.T) / 2).tolist()
            found.append(_placed(camera, poses[n], tuple(map(tuple, spreads))))
        elif n:
            found.append(cameras[n - 1])
    own = covariance[:6, :6]
    return Calibrated(
        poses[0],
        (own + own.T) / 2,
        tuple(found),
        told,
        residual,
        (int(size.argmax()), float(size.max())),
    )


def _placed(
    camera: DepthCamera, pose: np.ndarray, covariance: tuple[tuple[float, ...], ...]
) -> DepthCamera:
    from dataclasses import replace

    return replace(camera, pose=tuple(pose.tolist()), covariance=covariance)


def _moved(pose: np.ndarray, step: np.ndarray) -> np.ndarray:
    turn = rotation(step[3:]) @ quaternion_matrix(pose[3:])
    return np.array([*(pose[:3] + step[:3]), *matrix_quaternion(turn)])


def _lever(arm: np.ndarray) -> np.ndarray:
    """float64[3, 6]: how a point moves with a small motion of its frame.

    Args:
        arm: float64[3]: from the origin of the frame, along the axes of the world [m].
    """
    x, y, z = arm.tolist()
    return np.array([[1.0, 0, 0, 0, z, -y], [0, 1.0, 0, -z, 0, x], [0, 0, 1.0, y, -x, 0]])


def _linear(
    poses: Sequence[np.ndarray],
    cameras: Sequence[DepthCamera],
    named: Mapping[str, int],
    readings: Sequence[Sightings],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What readings are off at poses of base and cameras, in standard deviations: errors
    float64[m], rows float64[m, 6 n] against small motions, and the reading of each int64[m]."""
    turns = [quaternion_matrix(pose[3:]) for pose in poses]
    errors, rows, owner = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
    for k, one in enumerate(readings):
        if isinstance(one, TagSighting):
            n = named[one.camera] + 1
            error, part = _of_tag(one, cameras[n - 1], poses[n], turns[n])
            row = np.zeros((len(error), 6 * len(poses)))
            row[:, 6 * n : 6 * n + 6] = part
        else:
            parts = dict[int, np.ndarray]()
            if isinstance(one, Touch):
                n, local, there = 0, one.tip, one.at
            else:
                n, local, there = named[one.camera] + 1, one.seen, one.at
                if one.tip is not None:
                    arm = turns[0] @ one.tip
                    there, parts[0] = poses[0][:3] + arm, -_lever(arm)
            arm = turns[n] @ local
            parts[n] = parts.get(n, np.zeros((3, 6))) + _lever(arm)
            point = poses[n][:3] + arm
            row = np.zeros((3, 6 * len(poses)))
            for m, part in parts.items():
                row[:, 6 * m : 6 * m + 6] = part
            error = (np.zeros(3) if there is None else there) - point
            if there is None:
                error, row = error[2:], row[2:]
            error, row = error / one.sigma, row / one.sigma
        errors.append(error)
        rows.append(row)
        owner.append(np.full(len(error), k))
    return np.concatenate(errors), np.vstack(rows), np.concatenate(owner)


def _of_tag(
    one: TagSighting, camera: DepthCamera, pose: np.ndarray, turn: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Errors float64[8] of the corners of a tag and rows float64[8, 6]."""
    corners = one.pose[:3] + (SQUARE * one.size) @ quaternion_matrix(one.pose[3:]).T
    errors, rows = list[np.ndarray](), list[np.ndarray]()
    for corner, seen in zip(corners, one.tag.corners, strict=True):
        x, y, z = (corner - pose[:3]) @ turn
        z = max(float(z), 1e-3)
        onto = camera.focal * np.array([[1 / z, 0, -x / z**2], [0, 1 / z, -y / z**2]])
        errors.append(seen - camera.middle - camera.focal * np.array([x, y]) / z)
        # Where the camera moves ahead, what it sees moves back.
        rows.append(-onto @ turn.T @ _lever(corner - pose[:3]))
    return np.concatenate(errors) / CORNER, np.vstack(rows) / CORNER


def table_sightings(picture: DepthPicture, camera: DepthCamera) -> list[Sighting]:
    """Pixels of a picture that show the table.

    Args:
        picture: of a cell in which the table is not covered everywhere.
        camera: that took it, where it is taken to be.

    Returns:
        at most :data:`TABLE_PIXELS`; pixels that lie in the plane in which most of those near the
        table do.
    """
    depth = picture.depth.astype(float)
    points = camera.rays * depth[..., None]
    slack = NEAR_TABLE + 0.03 * depth
    there = (depth > 0) & (np.abs(camera.points(depth)[..., 2]) < slack)
    local = points[there]
    if len(local) < 3:
        return []
    rng = np.random.default_rng(0)
    sigma = camera.sigmas(local[:, 2])
    best = np.zeros(len(local), bool)
    for _ in range(60):
        a, b, c = local[rng.choice(len(local), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        size = np.linalg.norm(normal)
        if size > 1e-6:
            inside = np.abs((local - a) @ normal / size) < 3 * sigma
            best = inside if inside.sum() > best.sum() else best
    kept = np.flatnonzero(best)
    kept = rng.choice(kept, min(TABLE_PIXELS, len(kept)), replace=False)
    # Pixels share the slow error of the camera.
    share = len(kept) * camera.noise.waves**2 / 40
    return [
        Sighting(camera.name, local[k], None, None, float(np.sqrt(sigma[k] ** 2 + share)))
        for k in sorted(kept.tolist())
    ]
