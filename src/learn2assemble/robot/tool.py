"""Tools as data: fingers that come with an arm, suction tools and sockets from a ``tool.toml``.

A suction tool holds by the force F with which the air presses its cup on a face. In the frame of
the cup, let N be the pull along its axis, M the moment that tilts the block, S the force along the
face and T the moment about the axis that the held block loads the cup with. The cup of radius r
keeps holding while the lip is pressed on everywhere,

    N + |M| / r <= F,

and while the friction that is left carries what is along the face (a limit surface in the shape of
an ellipse: Howe and Cutkosky 1996; the share that is left is how suppliers of cups compute,
F >= m (g + a / mu) for a block that hangs and is accelerated sideways),

    (S / S_max)^2 + (T / T_max)^2 <= (1 - N / F)^2.

A socket clamps one stud of a brick and stands on the brick round it with a square face of half the
side r, so it presses as well as it pulls: with N negative where it presses, it keeps holding while

    N + max(|M_x|, |M_y|) / r <= F.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, cast

import mujoco
import numpy as np

from learn2assemble.constants import GRAVITY
from learn2assemble.errors import InputError, look_up
from learn2assemble.robot.grasps import FIRST, Lip

PICTURE_GROUP, COLLISION_GROUP = 2, 3
"""Geom groups of every vendored arm."""
ATMOSPHERE = 101_325.0
"""No vacuum presses harder than this [Pa]."""
FARTHEST_PART = 0.6
"""No part of a tool is farther from the middle of the flange along an axis [m]."""
FACE = 0.95
"""Side of the face of a socket, in distances of studs: bricks beside are not touched."""
_GREY, _BLACK = (0.75, 0.76, 0.78, 1.0), (0.2, 0.2, 0.22, 1.0)


@dataclass(frozen=True, eq=False)
class Gripper:
    """Two fingers that close along the tool's y axis.

    The opening ``width`` is the distance between the pads [m], also where it is commanded.
    """

    hand: str
    """Body the fingers slide on; it begins at the flange of the arm."""
    fingers: tuple[str, ...]
    """Bodies."""
    pads: tuple[str, ...]
    """Geoms that may touch what is held."""
    joints: tuple[str, ...]
    """One slide per finger; each travels half the width."""
    actuator: str
    max_width: float
    """Largest opening [m]."""
    closed_command: float
    """Command of the actuator at width 0."""
    open_command: float
    """Command of the actuator at the largest width."""
    force: float
    """What each finger presses with [N]."""
    speed: float
    """Change of the opening [m/s] at which the command should be ramped."""
    stiffness: float
    """Force per missing width [N/m], from the actuator."""
    tip: float = 0.0
    """How far the fingers reach beyond the tool point [m]."""

    def command(self, width: float) -> float:
        """The actuator's command for an opening [m]; below 0 it presses."""
        slope = (self.open_command - self.closed_command) / self.max_width
        return self.closed_command + slope * width


@dataclass(frozen=True)
class Cup:
    """One cup of a suction tool."""

    diameter: float
    """Of the sealed disc [m]."""
    stroke: float
    """By which the bellows follow a face that is nearer or farther than meant [m]."""
    pull_off: float
    """Force along the axis at which the cup comes off [N]."""
    shear: float
    """Force along the face at which it slips [N]."""
    torsion: float
    """Moment about the axis at which it turns [N m]."""
    lip: Lip = FIRST
    studs: float = 0.0
    """Of a socket, the distance of the studs of which it clamps one [m]; 0: a cup, on plane
    faces."""
    capture: float = 0.0
    """Of a socket, how far it may be beside the axis of a stud [m]."""

    @property
    def radius(self) -> float:
        """Of the sealed disc [m]."""
        return self.diameter / 2

    def load(
        self, force: Sequence[float] | np.ndarray, moment: Sequence[float] | np.ndarray
    ) -> tuple[float, float]:
        """Shares of what the cup holds: of the pull-off force, and of the friction at the lip;
        above 1 it does not hold.

        Args:
            force: float64[3] the held block loads the cup with, in the frame of the cup [N]; its z
                axis points out of the cup, so that a pull is positive.
            moment: float64[3], the same about the middle of the lip [N m].
        """
        pull = max(float(force[2]), 0.0)
        if self.studs:
            tilt = max(abs(moment[0]), abs(moment[1])) / self.radius
            off = max(float(force[2]) + tilt, 0.0) / self.pull_off
        else:
            off = (pull + math.hypot(moment[0], moment[1]) / self.radius) / self.pull_off
        slip = math.hypot(math.hypot(force[0], force[1]) / self.shear, moment[2] / self.torsion)
        left = 1.0 - pull / self.pull_off
        return off, slip / left if left > 0 else math.inf

    def presses(self, off: tuple[float, float], force: float) -> bool:
        """Whether it can press with a force [N] so far beside its axis, along the sides of its face
        [m], without tilting what it holds."""
        x, y = off
        return self.load((0.0, 0.0, -force), (y * force, -x * force, 0.0))[0] <= 1.0


class ToolPart(NamedTuple):
    """A cylinder of a tool's collision shape, in the frame of the flange: z as the tool's."""

    radius: float
    """[m], like all others."""
    begin: tuple[float, float, float]
    end: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Suction:
    """A tool with one cup or several on one vacuum, where valves close those that meet nothing; or
    one with a socket for a stud, which closes and opens as a vacuum is made and let go."""

    cups: tuple[Cup, ...]
    """The tool point is the middle of the lip of the first."""
    payload: float
    """Largest mass it may be given [kg]."""
    length: float
    """From the flange to the tool point [m]."""
    mass: float
    """[kg]"""
    grip_time: float
    """Until the vacuum holds [s]."""
    release_time: float
    """Until the cup lets go [s]."""
    parts: tuple[ToolPart, ...]

    @property
    def studs(self) -> float:
        """Distance of the studs that its socket fits [m]; 0: it has cups."""
        return self.cups[0].studs

    @property
    def round(self) -> bool:
        """Whether the tool is the same however it is turned about its axis."""
        return not any(p.begin[:2] != (0.0, 0.0) or p.end[:2] != (0.0, 0.0) for p in self.parts)


def load_suction(path: Path) -> Suction | None:
    """The tool a ``tool.toml`` describes; None for the arm's own fingers.

    Raises:
        InputError: where the file lacks a value, or its limits are impossible.
    """
    where = f"tool {path.parent.name}"
    data = read_toml(path, where)
    kind = value(data, "kind", where)
    number = look_up(f"{where}, kind", kind, {"own": 0, "suction": 1, "socket": 2})
    if number == 0:
        return None
    parts = _tables(value(data, "parts", where), "parts", where)

    grip_time, release_time = numbers(data, "speed", 2, where).tolist()
    if not (0 <= grip_time <= 5 and 0 <= release_time <= 5):
        raise InputError(f"{where}, speed", [grip_time, release_time], "times from 0 to 5 s")
    length = _positive(data, "length", 0.6, where)
    if number == 2:
        first, sides = _socket(table(data, "socket", where), where), list[dict[str, Any]]()
    else:
        first = _cup(table(data, "cup", where), FIRST, where)
        sides = _tables(data.get("sides", []), "sides", where)
    others = [_side(side, length, f"{where}, sides[{k}]") for k, side in enumerate(sides)]
    return Suction(
        cups=(first, *others),
        payload=_positive(data, "payload", first.pull_off / GRAVITY, where),
        length=length,
        mass=_positive(data, "mass", 20.0, where),
        grip_time=grip_time,
        release_time=release_time,
        parts=tuple(_part(part, length, f"{where}, parts[{k}]") for k, part in enumerate(parts)),
    )


def _positive(source: dict[str, Any], key: str, most: float, where: str) -> float:
    found = float(numbers(source, key, 0, where))
    if not 0 < found <= most:
        raise InputError(f"{where}, {key}", found, f"a number above 0 and at most {most:g}")
    return found


def _cup(data: dict[str, Any], lip: Lip, where: str) -> Cup:
    """A cup, refused where its limits are impossible."""
    diameter = _positive(data, "diameter", 0.3, where)
    strongest = ATMOSPHERE * math.pi * diameter**2 / 4
    pull_off = _positive(data, "pull_off", math.inf, where)
    if pull_off > strongest:
        expected = f"at most {strongest:.1f} N, as the air presses on {1e3 * diameter:g} mm"
        raise InputError(f"{where}, pull_off", pull_off, expected)
    shear = _positive(data, "shear", 2 * pull_off, where)
    # No friction of the lip has a longer arm than its radius.
    torsion = _positive(data, "torsion", shear * diameter / 2, where)
    return Cup(diameter, _positive(data, "stroke", 0.02, where), pull_off, shear, torsion, lip)


def _socket(data: dict[str, Any], where: str) -> Cup:
    """A socket, refused where its limits are impossible."""
    pitch = _positive(data, "pitch", 0.1, where)
    capture = _positive(data, "capture", pitch / 4, where)
    pull_off = _positive(data, "pull_off", 1e3, where)
    shear = _positive(data, "shear", 1e3, where)
    torsion = _positive(data, "torsion", shear * pitch / 2, where)
    stroke = _positive(data, "stroke", pitch / 4, where)
    return Cup(FACE * pitch, stroke, pull_off, shear, torsion, FIRST, pitch, capture)


def _side(data: dict[str, Any], length: float, where: str) -> Cup:
    """A further cup; its place is given from the flange."""
    at: list[float] = numbers(data, "at", 3, where).tolist()
    x, y, z = at
    axis = numbers(data, "axis", 3, where)
    size = float(np.linalg.norm(axis))
    if not (size > 1e-6 and max(map(abs, at)) <= FARTHEST_PART):
        expected = f"a direction, and a place within {FARTHEST_PART:g} m"
        raise InputError(where, [*at, *axis.tolist()], expected)
    a, b, c = (axis / size).tolist()
    return _cup(data, Lip((x, y, round(z - length, 9)), (a, b, c)), where)


def _part(data: dict[str, Any], length: float, where: str) -> ToolPart:
    """A cylinder between two points, or between two heights on the axis."""
    radius = float(numbers(data, "radius", 0, where))
    ends: list[np.ndarray] = []
    for key in ("from", "to"):
        point = isinstance(value(data, key, where), list)
        found = numbers(data, key, 3 if point else 0, where)
        ends.append(found if point else np.array([0.0, 0.0, float(found)]))
    begin, end = ends
    on_axis = not (begin[:2].any() or end[:2].any())
    right = begin[2] < end[2] if on_axis else bool((begin != end).any())
    far = max(float(np.abs(ends).max()), radius) > FARTHEST_PART
    if not (radius > 0 and right and not far and max(begin[2], end[2]) <= length):
        expected = f"a radius above 0, and an end after its beginning and up to {length:g} m"
        raise InputError(where, [radius, data["from"], data["to"]], expected)
    (a, b, c), (d, e, f) = begin.tolist(), end.tolist()
    return ToolPart(radius, (a, b, c), (d, e, f))


def mount(spec: mujoco.MjSpec, hand: str, site: str, suction: Suction, pictures: bool) -> None:
    """Put a suction tool in the place of a hand with fingers.

    Args:
        spec: the arm with its fingers; changed.
        hand: body that begins at the flange; what hangs on it is taken away.
        site: of the tool; moved to the lip of the cup.
        suction: the tool.
        pictures: add geoms without contact as well, which only pictures need.
    """
    body, tool = spec.body(hand), spec.site(site)
    for part in (*body.bodies, *body.geoms):
        spec.delete(part)  # and with it joints, actuators and whatever else refers to it
    used = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in used:
            spec.delete(mesh)
    turn, axis = np.array(tool.quat, float), np.empty(3)
    turn /= np.linalg.norm(turn)
    mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, 1.0]), turn)
    tool.pos = suction.length * axis
    widest = max((part.radius for part in suction.parts), default=suction.cups[0].radius)
    across = suction.mass * (3 * widest**2 + suction.length**2) / 12
    body.mass, body.ipos, body.iquat = suction.mass, 0.4 * suction.length * axis, turn
    body.inertia = [across, across, suction.mass * widest**2 / 2]
    for k, part in enumerate(suction.parts):
        begin, end = np.array(part.begin), np.array(part.end)
        middle, along, quat = np.empty(3), np.empty(4), np.empty(4)
        mujoco.mju_rotVecQuat(middle, (begin + end) / 2, turn)
        mujoco.mju_quatZ2Vec(along, (end - begin) / np.linalg.norm(end - begin))
        mujoco.mju_mulQuat(quat, turn, along)
        for group, solid in ((PICTURE_GROUP, 0), (COLLISION_GROUP, 1)):
            if not (pictures or solid):
                continue
            body.add_geom(
                name=f"{hand}_{'c' if solid else 'v'}_tool{k}",
                type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                size=[part.radius, float(np.linalg.norm(end - begin)) / 2, 0],
                pos=middle,
                quat=quat,
                group=group,
                mass=0,
                contype=solid,
                conaffinity=solid,
                rgba=_BLACK if k % 2 else _GREY,
            )


# ---------------------------------------------------------------- reading TOML


def read_toml(path: Path, where: str) -> dict[str, Any]:
    """The content of a file.

    Raises:
        InputError: where there is none, or it is no TOML; ``where`` says what it is about.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(where, str(path), f"a file {path.name}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(where, str(error), "valid TOML") from None


def value(data: dict[str, Any], key: str, where: str) -> Any:
    """The entry ``key``, which must be there."""
    if key not in data:
        raise InputError(f"{where}, {key}", None, "a value")
    return data[key]


def table(data: dict[str, Any], key: str, where: str) -> dict[str, Any]:
    """The table ``[key]``, which must be there."""
    found: Any = value(data, key, where)
    if not isinstance(found, dict):
        raise InputError(f"{where}, {key}", found, f"a table [{key}]")
    return cast("dict[str, Any]", found)


def _tables(found: Any, key: str, where: str) -> list[dict[str, Any]]:
    """The tables ``[[key]]``."""
    tables: Any = found
    if isinstance(tables, list):
        tables = cast("list[Any]", tables)
        if all(isinstance(one, dict) for one in tables):
            return tables
    raise InputError(f"{where}, {key}", found, f"tables [[{key}]]")


def numbers(data: dict[str, Any], key: str, count: int, where: str) -> np.ndarray:
    """float64[count], finite and read-only; a single number, float64[], for count 0."""
    given = value(data, key, where)
    try:
        array = np.array(given, float)
    except (TypeError, ValueError):
        array = np.empty(7)
    shape, words = ((count,), f"{count} numbers") if count else ((), "a number")
    if array.shape != shape or not np.isfinite(array).all() or isinstance(given, bool):
        raise InputError(f"{where}, {key}", given, words)
    return frozen(array)


def frozen(array: np.ndarray) -> np.ndarray:
    """A read-only copy, float64."""
    array = np.array(array, float, order="C")
    array.flags.writeable = False
    return array
