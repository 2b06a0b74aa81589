"""AprilTags: where they are in a picture, their poses, and pictures of them for tests.

Frame of a tag: x to the right and y up as one reads it, z out of it; its size is that of the black
square. Finding them needs the library ``pupil-apriltags`` (extra ``vision``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, cast

import numpy as np

from learn2assemble.errors import InputError, extra, look_up
from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix
from learn2assemble.plants.plant import BlockReading
from learn2assemble.sensing.camera import DepthCamera, DepthPicture, rotation

FAMILIES = {"tag36h11": 8, "tag25h9": 7, "tag16h5": 6}
"""Cells along the black square, border and all."""
CORNER = 0.15
"""Standard deviation of a corner in a picture [pixels]."""
SURE = 30.0
"""How clearly a tag has to be told from its surroundings (``decision_margin``)."""
ROUNDS = 10
SQUARE = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]) / 2
"""Corners of a tag of size 1 in its frame, as :class:`FoundTag` lists them."""


class FoundTag(NamedTuple):
    """A tag in a picture."""

    number: int
    corners: np.ndarray
    """float64[4, 2]: picture coordinates, counter-clockwise from the lower left [pixels]."""


class BlockTag(NamedTuple):
    """A tag on a block."""

    block: str
    pose: np.ndarray
    """float64[7]: of the tag in the frame of the block's shape."""
    size: float
    """[m]"""


@lru_cache(maxsize=8)
def _detector(family: str) -> Any:
    with extra("pupil_apriltags", "vision"):
        from pupil_apriltags import Detector  # pyright: ignore[reportMissingTypeStubs]

    class KeptDetector(Detector):
        """One that is not freed: the library (1.0.4) frees families before what uses them."""

        def __del__(self) -> None:
            pass

    return KeptDetector(families=family, quad_decimate=1.0)


def detect(grey: np.ndarray, family: str = "tag36h11") -> list[FoundTag]:
    """The tags in a picture.

    Args:
        grey: uint8[rows, columns].
        family: of the tags, a name of :data:`FAMILIES`.

    Raises:
        MissingExtraError: without the extra ``vision``.
        UnknownNameError: for another family.
    """
    look_up("family", family, FAMILIES)
    found = _detector(family).detect(np.ascontiguousarray(grey, np.uint8))
    return [
        # The library has the middle of the first pixel at (1/2, 1/2).
        FoundTag(int(one.tag_id), np.array(one.corners) - 0.5)
        for one in found
        if one.decision_margin >= SURE
    ]


def tag_pose(
    tag: FoundTag, size: float, camera: DepthCamera, near: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Where a tag is.

    Args:
        tag: in a picture of the camera.
        size: of it [m].
        camera: where it is taken to be.
        near: float64[7]: its pose as it is believed; of the two in which a small tag looks nearly
            the same, the one that fits better, or where both do, the one nearer to this.

    Returns:
        pose float64[7] in the world, and covariance float64[6, 6]: position [m] and small rotation
        about the axes of the world [rad].
    """
    first = _from_homography(tag, size, camera)
    starts = [first, _mirrored(first)]
    if near is not None:
        place = (near[:3] - camera.position) @ camera.turn
        starts.append((place, camera.turn.T @ quaternion_matrix(near[3:])))
    best: tuple[float, np.ndarray, np.ndarray, np.ndarray] | None = None
    for place, turn in starts:
        found = _refined(tag, size, camera, place, turn)
        worth = found[0]
        if near is not None:
            apart = camera.turn @ found[2] @ quaternion_matrix(near[3:]).T
            worth += 1 - (float(np.trace(apart)) - 1) / 2
        if best is None or worth < best[0]:
            best = worth, *found[1:]
    assert best is not None
    _, place, turn, information = best
    both = np.kron(np.eye(2), camera.turn)
    covariance = both @ np.linalg.inv(information) @ both.T
    pose = np.array(
        [*(camera.turn @ place + camera.position), *matrix_quaternion(camera.turn @ turn)]
    )
    if camera.covariance is not None:
        x, y, z = pose[:3] - camera.position
        onto = np.eye(6)
        onto[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
        covariance = covariance + onto @ np.array(camera.covariance) @ onto.T
    return pose, (covariance + covariance.T) / 2


def _from_homography(
    tag: FoundTag, size: float, camera: DepthCamera
) -> tuple[np.ndarray, np.ndarray]:
    """A first pose in the camera frame."""
    rows = list[list[float]]()
    seen = (tag.corners - camera.middle) / camera.focal
    for (x, y, _), (u, v) in zip(SQUARE * size, seen, strict=True):
        rows.append([x, y, 1, 0, 0, 0, -u * x, -u * y, -u])
        rows.append([0, 0, 0, x, y, 1, -v * x, -v * y, -v])
    onto = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
    onto /= np.linalg.norm(onto[:, :2], axis=0).mean() * (1 if onto[2, 2] > 0 else -1)
    a, b = onto[:, 0], onto[:, 1]
    u, _, v = np.linalg.svd(np.stack([a, b, np.cross(a, b)], 1))
    return onto[:, 2], u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v


def _mirrored(pose: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The pose in which a small tag looks nearly the same: its normal on the other side of the line
    of sight."""
    place, turn = pose
    sight = place / np.linalg.norm(place)
    half = rotation(np.pi * sight)
    return place, half @ turn @ np.diag([-1.0, -1.0, 1.0])


def _refined(
    tag: FoundTag, size: float, camera: DepthCamera, place: np.ndarray, turn: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """The pose in the camera frame that fits the corners best nearby: the mean square of its errors
    in standard deviations, place, rotation, and information float64[6, 6]."""
    information = np.eye(6)
    errors = np.zeros(8)
    for _ in range(ROUNDS):
        arms = (SQUARE * size) @ turn.T
        points = arms + place
        depth = np.maximum(points[:, 2:], 1e-6)
        errors = (tag.corners - camera.middle - camera.focal * points[:, :2] / depth).ravel()
        rows = np.zeros((4, 2, 6))
        for k, (x, y, z) in enumerate(points):
            z = max(z, 1e-6)
            onto = camera.focal * np.array([[1 / z, 0, -x / z**2], [0, 1 / z, -y / z**2]])
            a, b, c = arms[k]
            rows[k, :, :3] = onto
            rows[k, :, 3:] = onto @ np.array([[0, c, -b], [-c, 0, a], [b, -a, 0]])
        jacobian = rows.reshape(8, 6)
        information = jacobian.T @ jacobian / CORNER**2 + 1e-9 * np.eye(6)
        step = np.linalg.solve(information, jacobian.T @ errors / CORNER**2)
        place, turn = place + step[:3], rotation(step[3:]) @ turn
    return float(errors @ errors) / 8 / CORNER**2, place, turn, information


def tagged_readings(
    picture: DepthPicture,
    camera: DepthCamera,
    tags: Mapping[int, BlockTag],
    near: Mapping[str, np.ndarray],
    family: str = "tag36h11",
) -> tuple[BlockReading, ...]:
    """Blocks whose tags a picture shows.

    Args:
        picture: with brightness.
        camera: that took it.
        tags: on blocks, by their numbers; others are passed over.
        near: float64[7]: poses of blocks as they are believed, as far as they are.
        family: of the tags.

    Raises:
        MissingExtraError: without the extra ``vision``.
    """
    if picture.grey is None:
        return ()
    found: dict[str, BlockReading] = {}
    for one in detect(picture.grey, family):
        tag = tags.get(one.number)
        if tag is None:
            continue
        own, guess = quaternion_matrix(tag.pose[3:]), None
        if tag.block in near:
            block = quaternion_matrix(near[tag.block][3:])
            guess = np.array(
                [*(near[tag.block][:3] + block @ tag.pose[:3]), *matrix_quaternion(block @ own)]
            )
        pose, covariance = tag_pose(one, tag.size, camera, guess)
        turn = quaternion_matrix(pose[3:]) @ own.T
        x, y, z = arm = -turn @ tag.pose[:3]
        onto = np.eye(6)
        onto[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
        there = np.array([*(pose[:3] + arm), *matrix_quaternion(turn)])
        spread = onto @ covariance @ onto.T
        reading = BlockReading(tag.block, there, (spread + spread.T) / 2, picture.time)
        before = found.get(tag.block)
        if before is None or np.trace(spread[:3, :3]) < np.trace(before.covariance[:3, :3]):
            found[tag.block] = reading
    return tuple(found.values())


# ---------------------------------------------------------------- pictures of tags


@lru_cache(maxsize=64)
def bitmap(number: int, family: str = "tag36h11") -> np.ndarray:
    """uint8[n, n]: a tag as it is printed, its white border and all; row 0 is the top.

    Raises:
        MissingExtraError: without the extra ``vision``.
        UnknownNameError: for another family.
    """
    look_up("family", family, FAMILIES)
    told = _detector(family).tag_families[family].contents
    if not 0 <= number < told.ncodes:
        raise InputError("tag", number, f"0 to {told.ncodes - 1} of {family}")
    inner, outer = told.width_at_border, told.total_width
    border = (outer - inner) // 2
    image = np.full((outer, outer), 255, np.uint8)
    image[border : outer - border, border : outer - border] = 0
    for k in range(told.nbits):
        if told.codes[number] >> (told.nbits - 1 - k) & 1:
            image[told.bit_y[k] + border, told.bit_x[k] + border] = 255
    return image


def drawn(
    picture: DepthPicture,
    camera: DepthCamera,
    tags: Sequence[tuple[int, np.ndarray, float]],
    family: str = "tag36h11",
    blur: float = 0.7,
) -> DepthPicture:
    """A picture with brightness: grey, and the tags in it, seen where nothing is before them.

    Args:
        picture: of what is there.
        camera: where it truly is.
        tags: number, pose float64[7] in the world, and size [m] of each.
        family: of them.
        blur: standard deviation of the lens [pixels].
    """
    from scipy.ndimage import (  # pyright: ignore[reportMissingTypeStubs]
        gaussian_filter,  # pyright: ignore[reportUnknownVariableType]
    )

    grey = np.full((3, 3, *picture.depth.shape), 140.0)
    offsets = np.arange(-1, 2) / 3 / camera.focal
    for number, pose, size in tags:
        print_ = bitmap(number, family)
        cells = len(print_)
        turn = camera.turn.T @ quaternion_matrix(pose[3:])
        place = (pose[:3] - camera.position) @ camera.turn
        wide = size * cells / FAMILIES[family]
        ends = camera.project(pose[:3] + (SQUARE * wide) @ quaternion_matrix(pose[3:]).T)
        if ends[:, 2].min() <= 0:
            continue
        (u, v), (far_u, far_v) = (
            np.clip(end, 0, camera.resolution).astype(int)
            for end in (ends[:, :2].min(0) - 1, ends[:, :2].max(0) + 2)
        )
        window = np.s_[v:far_v, u:far_u]
        read = picture.depth[window]
        for i, dy in enumerate(offsets):
            for j, dx in enumerate(offsets):
                rays = camera.rays[window] + np.array([dx, dy, 0.0])
                towards = rays @ turn[:, 2]
                with np.errstate(divide="ignore", invalid="ignore"):
                    depth = (place @ turn[:, 2]) / towards
                local = (rays * depth[..., None] - place) @ turn
                at = local[..., :2] / size * FAMILIES[family] + cells / 2
                inside = (towards < 0) & (at >= 0).all(-1) & (at < cells).all(-1)
                show = inside & ((read <= 0) | (read > depth - 0.01))
                column, row = at[show].astype(int).T
                grey[i, j][window][show] = 30 + 195 * (print_[cells - 1 - row, column] / 255.0)
    shown = cast("np.ndarray", gaussian_filter(grey.mean((0, 1)), blur))
    return picture._replace(grey=shown.round().clip(0, 255).astype(np.uint8))
