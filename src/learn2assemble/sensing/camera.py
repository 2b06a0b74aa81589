"""Depth cameras of a cell as a layout has them, and their pictures.

Camera frame: x to the right of the picture, y down, z ahead; the depth of a pixel is along z. The
middle of the first pixel has the picture coordinates (0, 0).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix
from learn2assemble.values import Range, from_plain, mapping

MOST_PIXELS = 4_000_000
"""Of a picture."""

_Length = Annotated[float, Range(0.0, 0.1, "m")]
_Share = Annotated[float, Range(0.0, 1.0)]
_Coordinate = Annotated[float, Range(-100.0, 100.0, "m")]


@dataclass(frozen=True)
class DepthNoise:
    """How a depth picture differs from the truth."""

    floor: _Length = 0.0005
    """Standard deviation of a reading at no distance at all [m]."""
    growth: Annotated[float, Range(0.0, 0.1, "1/m")] = 0.001
    """What is added to it per square metre of depth [1/m]."""
    waves: _Length = 0.0003
    """Standard deviation of an error that varies slowly over the picture [m]."""
    edges: _Share = 0.6
    """Share of the pixels beside an edge that are lost; half as many mix what is before and
    behind."""
    dropout: _Share = 0.01
    """Share of all pixels that are lost."""

    def sigma(self, depth: np.ndarray) -> np.ndarray:
        """Standard deviations of readings at such depths [m]."""
        return self.floor + self.growth * depth**2


@dataclass(frozen=True)
class DepthCamera:
    """A depth camera as a layout has it: where it is taken to be."""

    name: str
    pose: tuple[float, ...]
    """x, y, z [m] and quaternion (w, x, y, z) of the camera frame in the world."""
    resolution: tuple[int, int] = (640, 480)
    """Columns and rows."""
    field_of_view: float = 1.0
    """Angle between the left and the right edge [rad]."""
    range: tuple[float, float] = (0.15, 4.0)
    """Least and largest depth that is read [m]."""
    rate: float = 10.0
    """Pictures a second."""
    frames: int = 3
    """Of which so many in a row, the median of every pixel, are one look."""
    noise: DepthNoise = field(default_factory=DepthNoise)
    covariance: tuple[tuple[float, ...], ...] | None = None
    """6 × 6, of the pose: position [m] and a small rotation about the axes of the world [rad], as a
    calibration leaves it; None: taken to be exact."""

    @property
    def position(self) -> np.ndarray:
        """float64[3] [m]"""
        return np.array(self.pose[:3])

    @cached_property
    def turn(self) -> np.ndarray:
        """float64[3, 3]: from the camera frame to the world."""
        return quaternion_matrix(np.array(self.pose[3:]))

    def sigma(self, depth: float) -> float:
        """Standard deviation of a reading of one look at a depth [m]."""
        return float(self.sigmas(np.array(depth)))

    def sigmas(self, depth: np.ndarray) -> np.ndarray:
        """The same at many depths [m]."""
        share = math.sqrt(math.pi / 2 / self.frames) if self.frames > 2 else 1.0
        return self.noise.sigma(depth) * share

    @property
    def focal(self) -> float:
        """Focal length [pixels]."""
        return self.resolution[0] / 2 / math.tan(self.field_of_view / 2)

    @property
    def middle(self) -> tuple[float, float]:
        """Picture coordinates of the axis [pixels]."""
        return (self.resolution[0] - 1) / 2, (self.resolution[1] - 1) / 2

    @cached_property
    def rays(self) -> np.ndarray:
        """float64[rows, columns, 3]: where pixels look, in the camera frame, one metre deep."""
        columns, rows = self.resolution
        u, v = np.meshgrid(np.arange(columns), np.arange(rows))
        x, y = ((k - m) / self.focal for k, m in zip((u, v), self.middle, strict=True))
        return np.stack([x, y, np.ones_like(x)], -1)

    def project(self, points: np.ndarray) -> np.ndarray:
        """float64[..., 3]: picture coordinates [pixels] and depth [m] of points of the world."""
        seen = (points - self.position) @ self.turn
        depth = np.where(np.abs(seen[..., 2:]) < 1e-9, 1e-9, seen[..., 2:])
        return np.concatenate([self.focal * seen[..., :2] / depth + self.middle, depth], -1)

    def points(self, depth: np.ndarray) -> np.ndarray:
        """float64[rows, columns, 3]: places in the world that a depth picture shows [m]."""
        return (self.rays * depth[..., None]) @ self.turn.T + self.position

    def moved(self, shift: np.ndarray, turn: np.ndarray) -> DepthCamera:
        """The camera elsewhere: moved by float64[3] [m], and turned about itself by the rotation
        float64[3, 3] along the axes of the world."""
        quaternion = matrix_quaternion(turn @ self.turn)
        return replace(self, pose=(*(self.position + shift).tolist(), *quaternion.tolist()))


class DepthPicture(NamedTuple):
    """What a camera has seen."""

    camera: str
    time: float
    """Of the plant's clock [s]."""
    depth: np.ndarray
    """float32[rows, columns]: depths [m]; 0 where nothing was read."""
    grey: np.ndarray | None = None
    """uint8[rows, columns]: brightness, where the camera has it too."""

    @property
    def blind(self) -> bool:
        """Whether it shows nothing at all."""
        return not bool((self.depth > 0).any())


def rotation(vector: np.ndarray) -> np.ndarray:
    """float64[3, 3]: the rotation by a vector float64[3] [rad]."""
    angle = float(np.linalg.norm(vector))
    half = 0.5 if angle < 1e-9 else math.sin(angle / 2) / angle
    return quaternion_matrix(np.array([math.cos(angle / 2), *(half * vector)]))


# ---------------------------------------------------------------- from a layout


@dataclass(frozen=True)
class _Entry:
    """A camera in a layout file."""

    name: str
    position: tuple[_Coordinate, _Coordinate, _Coordinate]
    look_at: tuple[_Coordinate, _Coordinate, _Coordinate] | None = None
    quaternion: tuple[float, float, float, float] | None = None
    resolution: tuple[int, int] = DepthCamera.resolution
    field_of_view: Annotated[float, Range(0.05, 2.6, "rad")] = DepthCamera.field_of_view
    range: tuple[float, float] = DepthCamera.range
    rate: Annotated[float, Range(0.01, 1000.0, "1/s")] = DepthCamera.rate
    frames: Annotated[int, Range(1, 50)] = DepthCamera.frames
    noise: DepthNoise = field(default_factory=DepthNoise)
    covariance: tuple[tuple[float, ...], ...] | None = None


def parse_camera(value: Any, where: str) -> DepthCamera:
    """A camera of a layout (``docs/layouts.md``).

    Args:
        value: from JSON.
        where: what messages call it.

    Raises:
        InputError: naming the key that is wrong.
    """
    source, _, path = where.rpartition(": ")
    given = from_plain(_Entry, mapping(value, where), source, path)
    if not given.name.strip():
        raise InputError(f"{where}.name", given.name, "a name")
    if given.position[2] <= 0:
        expected = "a place above the table, z = 0, through which no camera sees"
        raise InputError(f"{where}.position", list(given.position), expected)
    columns, rows = given.resolution
    if min(columns, rows) < 8 or columns * rows > MOST_PIXELS:
        expected = f"columns and rows, 8 or more each and {MOST_PIXELS} pixels at most"
        raise InputError(f"{where}.resolution", list(given.resolution), expected)
    low, high = given.range
    if not 0 < low < high <= 100:
        raise InputError(f"{where}.range", [low, high], "least and largest depth [m], 0 < a < b")
    covariance = given.covariance
    if covariance is not None:
        covariance = tuple(map(tuple, checked_covariance(covariance, f"{where}.covariance", 6)))
    return DepthCamera(
        given.name,
        (*given.position, *_attitude(given, where)),
        given.resolution,
        given.field_of_view,
        given.range,
        given.rate,
        given.frames,
        given.noise,
        covariance,
    )


def checked_covariance(value: Any, where: str, size: int) -> list[list[float]]:
    """A covariance from a file.

    Raises:
        InputError: where it is none.
    """
    rows = [list(row) for row in value]
    expected = f"{size} x {size} numbers, symmetric, none of its variances below 0"
    if len(rows) != size or any(len(row) != size for row in rows):
        raise InputError(where, value, expected)
    found = np.array(rows)
    scale = np.abs(found).max()
    if np.abs(found - found.T).max() > 1e-6 * scale:
        raise InputError(where, value, expected)
    if np.linalg.eigvalsh(found).min() < -1e-6 * scale:
        raise InputError(where, value, expected)
    return rows


def _attitude(given: _Entry, where: str) -> tuple[float, ...]:
    """Quaternion of a camera that looks at a place, upright, or that says how it is turned."""
    if (given.look_at is None) == (given.quaternion is None):
        both = [given.look_at, given.quaternion]
        raise InputError(where, both, "one of look_at and quaternion")
    if given.quaternion is not None:
        length = math.hypot(*given.quaternion)
        if abs(length - 1) > 1e-3:
            raise InputError(f"{where}.quaternion", list(given.quaternion), "one of length 1")
        return tuple(k / length for k in given.quaternion)
    assert given.look_at is not None
    ahead = np.subtract(given.look_at, given.position)
    far = float(np.linalg.norm(ahead))
    if far < 1e-3:
        got = list(given.look_at)
        raise InputError(f"{where}.look_at", got, "a place away from the camera")
    return looking(ahead)


def looking(ahead: np.ndarray) -> tuple[float, ...]:
    """Quaternion of a camera that looks along float64[3], with the vertical upright in its picture;
    one that looks straight down has x of the world to the right."""
    z = ahead / np.linalg.norm(ahead)
    down = np.array([0.0, 0.0, -1.0]) if np.hypot(*z[:2]) > 1e-6 else np.array([0.0, -1.0, 0.0])
    y = down - z * (down @ z)
    y /= np.linalg.norm(y)
    return tuple(matrix_quaternion(np.stack([np.cross(y, z), y, z], 1)).tolist())


def check_names(cameras: Sequence[DepthCamera], where: str) -> None:
    """Refuse two cameras of one name.

    Raises:
        InputError: naming the second one.
    """
    names = [camera.name for camera in cameras]
    for k, name in enumerate(names):
        if name in names[:k]:
            raise InputError(f"{where}[{k}].name", name, "a name that no other camera has")
