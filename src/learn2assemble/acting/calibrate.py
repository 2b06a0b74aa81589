"""A layout is put right by what the arm touched and cameras saw (``l2a calibrate``)."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from learn2assemble.cell.site import MOST_LEAN, Site, read_site
from learn2assemble.errors import InputError, check_name
from learn2assemble.files import as_path, check_new, check_output, read_bytes, read_json, write_file
from learn2assemble.geometry.rotations import quaternion_matrix, yaw_quaternion
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.robot.arm import Arm, get_arm
from learn2assemble.sensing.calibration import (
    Calibrated,
    Sighting,
    Sightings,
    TagSighting,
    Touch,
    calibrated,
)
from learn2assemble.sensing.camera import DepthCamera
from learn2assemble.sensing.tags import FoundTag, detect
from learn2assemble.values import Range, read_document

READINGS = "learn2assemble-readings"
"""``format`` of a file of readings."""

MOST_BYTES = 50_000_000
"""Of a picture."""

_Metres = Annotated[float, Range(-100.0, 100.0, "m")]
_Point = tuple[_Metres, _Metres, _Metres]
_Sigma = Annotated[float, Range(1e-6, 0.1, "m")]


@dataclass(frozen=True)
class TouchEntry:
    """Something that the tip of the tool touched, in a file."""

    tip: _Point | None = None
    joints: tuple[float, ...] | None = None
    at: _Point | None = None
    sigma: _Sigma = Touch._field_defaults["sigma"]


@dataclass(frozen=True)
class PointEntry:
    """Something that a camera saw, in a file."""

    camera: str
    seen: _Point
    at: _Point | None = None
    tip: _Point | None = None
    joints: tuple[float, ...] | None = None
    sigma: _Sigma = Sighting._field_defaults["sigma"]


@dataclass(frozen=True)
class TagEntry:
    """A tag that lies in the cell, in a file."""

    number: int
    size: Annotated[float, Range(0.001, 2.0, "m")]
    at: tuple[_Metres, _Metres, _Metres]
    """x, y and yaw, on the table and facing up."""


@dataclass(frozen=True)
class PictureEntry:
    """A picture with tags, in a file."""

    camera: str
    file: str


@dataclass(frozen=True)
class ReadingsFile:
    """What a file of readings holds."""

    touches: tuple[TouchEntry, ...] = ()
    points: tuple[PointEntry, ...] = ()
    tags: tuple[TagEntry, ...] = ()
    pictures: tuple[PictureEntry, ...] = ()
    family: str = "tag36h11"


class Calibration(NamedTuple):
    """A layout that was put right."""

    found: Calibrated
    layout: Mapping[str, Any]
    """Of the file, as it was written."""
    moved: Mapping[str, tuple[float, float]]
    """By ``base`` and the names of cameras: by how much [m], [rad]."""

    def spread(self, number: int) -> tuple[float, float]:
        """How well something is known now, the base (0) or a camera (from 1): standard deviations
        along the worst axis [mm], [degrees]; infinite where nothing was read of a camera."""
        if number:
            given = self.found.cameras[number - 1].covariance
            if given is None:
                return math.inf, math.inf
            covariance = np.array(given)
        else:
            covariance = self.found.base_covariance
        place, turn = (
            math.sqrt(max(float(np.linalg.eigvalsh(covariance[k : k + 3, k : k + 3])[-1]), 0.0))
            for k in (0, 3)
        )
        return 1e3 * place, math.degrees(turn)


def calibrate(
    layout: str | Path,
    readings: str | Path,
    *,
    arm: str | None = None,
    tool: str | None = None,
    out: str | Path | None = None,
) -> Calibration:
    """Put base and cameras of a layout where readings say that they are.

    Args:
        layout: a file with a base (``docs/layouts.md``).
        readings: a file of what the arm touched and cameras saw (``docs/sensing.md``).
        arm: that touched, where readings are joints.
        tool: of it, whose tip touched.
        out: a new file that is written, all or nothing; by default the layout itself is replaced,
            which is what calibrating is for.

    Raises:
        InputError: naming file and path of what is wrong; nothing is written then.
    """
    layout, readings = as_path(layout, "layout"), as_path(readings, "readings")
    target = layout if out is None else as_path(out, "out")
    if out is None:
        check_output(target, "layout")
    else:
        check_new(target, "layout", layout, readings)
    site = read_site(layout)
    if site.base is None:
        raise InputError(f"{site.source}: base", "none", "where the base is taken to be")
    x, y, z, yaw = site.base
    base = np.array([x, y, z, *yaw_quaternion(yaw)])
    given = _read(readings, arm, tool, site)
    found = calibrated(base, site.cameras, given)
    lean = float(np.abs(quaternion_matrix(found.base[3:])[:2, 2]).max())
    if lean > MOST_LEAN:
        raise InputError(
            str(readings), f"a base that leans by {lean:.2f}", f"readings of one by {MOST_LEAN:g}"
        )
    root = dict(read_json(layout, "layout file")[0])
    changed = _changed(root, site, found)
    write_file(target, json.dumps(changed, indent=2) + "\n", "layout")
    before = [base, *(np.array(camera.pose) for camera in site.cameras)]
    after = [found.base, *(np.array(camera.pose) for camera in found.cameras)]
    names = ["base", *(camera.name for camera in site.cameras)]
    moved = {n: _apart(a, b) for n, a, b in zip(names, before, after, strict=True)}
    return Calibration(found, changed, moved)


def _apart(one: np.ndarray, two: np.ndarray) -> tuple[float, float]:
    """How far two poses are apart [m], [rad]."""
    turn = quaternion_matrix(one[3:]).T @ quaternion_matrix(two[3:])
    angle = math.acos(float(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
    return float(np.linalg.norm(one[:3] - two[:3])), angle


def _yaw(turn: np.ndarray) -> float:
    """Yaw of a base that leans a little [rad]."""
    return math.atan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])


def _changed(root: dict[str, Any], site: Site, found: Calibrated) -> dict[str, Any]:
    """The JSON object of a layout with what was found."""
    if any(found.told["base"]):
        turn = quaternion_matrix(found.base[3:])
        root["base"] = {
            "position": _rounded(found.base[:3]),
            "yaw": round(_yaw(turn), 9),
            "lean": _rounded(turn[:2, 2]),
            "covariance": [_digits(row) for row in found.base_covariance],
        }
    entries = list[dict[str, Any]]()
    for entry, old, new in zip(root.get("cameras", []), site.cameras, found.cameras, strict=True):
        if new is not old:
            entry = {k: v for k, v in entry.items() if k != "look_at"}
            entry |= {
                "position": _rounded(new.pose[:3]),
                "quaternion": _rounded(new.pose[3:]),
                "covariance": [_digits(row) for row in new.covariance or ()],
            }
        entries.append(entry)
    return root | ({"cameras": entries} if entries else {})


def _rounded(values: Any) -> list[float]:
    return [round(float(value), 9) + 0.0 for value in values]


def _digits(values: Any) -> list[float]:
    return [float(f"{float(value):.6g}") for value in values]


# ---------------------------------------------------------------- readings


def _read(path: Path, arm: str | None, tool: str | None, site: Site) -> list[Sightings]:
    value, source = read_json(path, "file of readings")
    told, _ = read_document(ReadingsFile, value, source, READINGS, 1)
    jointed = any(one.joints is not None for one in (*told.touches, *told.points))
    if jointed and arm is None:
        raise InputError("arm", arm, "the name of the arm, as readings are joints")
    hand = None if arm is None else get_arm(arm, tool, (0.0, 0.0, 0.0, 0.0))
    cameras = {camera.name: camera for camera in site.cameras}
    found: list[Sightings] = []
    for k, one in enumerate(told.touches):
        where = f"{source}: touches[{k}]"
        tip = _tip(one, hand, where)
        if tip is None:
            raise InputError(where, "neither", "one of tip and joints")
        found.append(Touch(tip, _array(one.at), one.sigma))
    for k, one in enumerate(told.points):
        where = f"{source}: points[{k}]"
        check_name(f"{where}.camera", one.camera, cameras)
        tip = _tip(one, hand, where)
        if tip is not None and one.at is not None:
            raise InputError(where, "both", "one of at, tip and joints, or none: on the table")
        found.append(Sighting(one.camera, np.array(one.seen), _array(one.at), tip, one.sigma))
    found += _tags(told, cameras, source, path.parent)
    if not found:
        raise InputError(source, "no readings", "touches, points, or pictures of tags")
    return found


def _array(point: tuple[float, ...] | None) -> np.ndarray | None:
    return None if point is None else np.array(point)


def _tip(one: TouchEntry | PointEntry, arm: Arm | None, where: str) -> np.ndarray | None:
    """float64[3]: where the tip of the tool was, in the frame of the base [m]; None: not told."""
    if one.tip is not None and one.joints is not None:
        raise InputError(where, "both", "one of tip and joints")
    if one.joints is None:
        return _array(one.tip)
    assert arm is not None
    if len(one.joints) != len(arm.joints):
        expected = f"{len(arm.joints)} angles of {arm.name} [rad]"
        raise InputError(f"{where}.joints", f"{len(one.joints)} numbers", expected)
    return forward(get_chain(arm), np.array(one.joints))[0]


def _tags(
    told: ReadingsFile, cameras: Mapping[str, DepthCamera], source: str, folder: Path
) -> list[TagSighting]:
    """Tags in pictures, as far as it is known where they lie."""
    lying = {tag.number: tag for tag in told.tags}
    if len(lying) < len(told.tags):
        raise InputError(f"{source}: tags", "two of one number", "every number once")
    found = list[TagSighting]()
    for k, one in enumerate(told.pictures):
        where = f"{source}: pictures[{k}]"
        check_name(f"{where}.camera", one.camera, cameras)
        grey = _grey(folder / one.file, where, cameras[one.camera])
        seen = [tag for tag in detect(grey, told.family) if tag.number in lying]
        if not seen:
            raise InputError(f"{where}.file", one.file, f"a picture with a tag of {sorted(lying)}")
        found += [_lying(one.camera, tag, lying[tag.number]) for tag in seen]
    return found


def _lying(camera: str, tag: FoundTag, told: TagEntry) -> TagSighting:
    x, y, yaw = told.at
    pose = np.array([x, y, 0.0, *yaw_quaternion(yaw)])
    return TagSighting(camera, tag, pose, told.size)


def _grey(path: Path, where: str, camera: DepthCamera) -> np.ndarray:
    """uint8[rows, columns] of a picture file of a camera."""
    import io

    from PIL import Image

    content, source = read_bytes(path, "picture", MOST_BYTES)
    try:
        with Image.open(io.BytesIO(content)) as image:
            size = image.size
            if size == camera.resolution:
                return np.asarray(image.convert("L"))
    except (OSError, ValueError, Image.DecompressionBombError):
        raise InputError(f"{where}.file", source, "a picture, as PNG or JPEG") from None
    expected = f"a picture of {camera.resolution[0]} x {camera.resolution[1]} pixels"
    raise InputError(f"{where}.file", f"{size[0]} x {size[1]} pixels", expected)
