"""Arms as data: an MJCF and an ``arm.toml`` beside it; their MuJoCo models (table top z = 0)."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from learn2assemble.errors import InputError, look_up
from learn2assemble.geometry.rotations import yaw_quaternion
from learn2assemble.physics import scene as _  # noqa: F401 (MuJoCo's warnings)
from learn2assemble.robot.registry import ARMS

PICTURE_GROUP, COLLISION_GROUP = 2, 3
"""Geom groups of every vendored arm."""


def read_spec(mjcf: Path, position: np.ndarray, yaw: float, pictures: bool) -> mujoco.MjSpec:
    """The arm's MJCF, its root bodies moved to the base pose.

    Args:
        mjcf: file of the arm.
        position: float64[3] of the base [m, world].
        yaw: turn of the base about z [rad].
        pictures: keep the geoms without contact, which only pictures need; loading is faster
            without them.
    """
    spec = mujoco.MjSpec.from_file(str(mjcf))
    turn = yaw_quaternion(yaw)
    for body in spec.worldbody.bodies:
        moved, turned, rotated = np.empty(3), np.empty(4), np.empty(3)
        own = np.asarray(body.quat) / np.linalg.norm(body.quat)
        mujoco.mju_rotVecQuat(rotated, np.asarray(body.pos), turn)
        mujoco.mju_mulQuat(turned, turn, own)
        np.add(position, rotated, out=moved)
        body.pos, body.quat = moved, turned
    if not pictures:
        for geom in list(spec.geoms):
            if geom.group == PICTURE_GROUP:
                spec.delete(geom)
        for mesh in list(spec.meshes):
            spec.delete(mesh)
    return spec


@dataclass(frozen=True, eq=False)
class Gripper:
    """Two fingers that close along the tool's y axis.

    The opening ``width`` is the distance between the pads [m], also where it is commanded.
    """

    hand: str
    """Body the fingers slide on."""
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

    def command(self, width: float) -> float:
        """The actuator's command for an opening [m]; below 0 it presses."""
        slope = (self.open_command - self.closed_command) / self.max_width
        return self.closed_command + slope * width


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm with its gripper, at its place in the world. Arrays are read-only, one per joint."""

    name: str
    mjcf: Path
    joints: tuple[str, ...]
    lower: np.ndarray
    """float64[n] [rad]."""
    upper: np.ndarray
    """float64[n] [rad]."""
    velocity: np.ndarray
    """float64[n], largest magnitude [rad/s]."""
    acceleration: np.ndarray
    """float64[n], largest magnitude [rad/s^2]."""
    jerk: np.ndarray
    """float64[n], largest magnitude [rad/s^3]."""
    home: np.ndarray
    """float64[n]: where the arm waits, and the posture it prefers [rad]."""
    base_position: np.ndarray
    """float64[3] [m, world]."""
    base_yaw: float
    """Turn about z [rad]."""
    tool: str
    """Site of the tool: z out of the hand (down when grasping), y the closing direction."""
    gripper: Gripper
    branches: dict[str, tuple[np.ndarray, np.ndarray]]
    """Parts of the joint range [rad] in which the arm keeps its shape (elbow up, wrist not turned
    over), the preferred one first; empty where the arm has no such choice."""

    def limits(self, branch: str | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper joint limits [rad] of a branch, by default the preferred one.

        Raises:
            UnknownNameError: naming the nearest one; ``"any"`` is the whole range.
        """
        whole = (self.lower, self.upper)
        if branch is None:
            return next(iter(self.branches.values()), whole)
        return look_up(f"branch of arm {self.name}", branch, {**self.branches, "any": whole})

    def inside_limits(self, joints: np.ndarray, tolerance: float = 1e-9) -> np.ndarray:
        """bool[...]: whether joints [rad], float64[..., n], respect the limits."""
        low, high = self.lower - tolerance, self.upper + tolerance
        return np.all((joints >= low) & (joints <= high), axis=-1)


@lru_cache(maxsize=16)
def get_arm(name: str) -> Arm:
    """The arm called ``name``.

    Raises:
        UnknownNameError: naming the nearest one.
    """
    return load_arm(look_up("arm", name, ARMS))


def load_arm(path: Path) -> Arm:
    """The arm a file describes; its name is that of the folder.

    Raises:
        InputError: where the file lacks a value, or names something its MJCF does not have.
    """
    name = path.parent.name
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"arm {name}", str(path), "a file arm.toml") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"arm {name}", str(error), "valid TOML") from None
    where = f"arm {name}"
    base, gripper = _table(data, "base", where), _table(data, "gripper", where)
    position, yaw = _numbers(base, "position", 3, where), float(_value(base, "yaw", where))
    joints = tuple(_value(data, "joints", where))
    count = len(joints)
    mjcf = path.parent / _value(data, "mjcf", where)
    if not mjcf.is_file():
        raise InputError(f"{where}, mjcf", str(mjcf), "an MJCF file beside arm.toml")
    model = read_spec(mjcf, position, yaw, pictures=False).compile()
    limits = np.array([_joint_range(model, joint, where) for joint in joints])
    arm = Arm(
        name=name, mjcf=mjcf, joints=joints,
        lower=_frozen(limits[:, 0]), upper=_frozen(limits[:, 1]),
        velocity=_numbers(data, "velocity", count, where),
        acceleration=_numbers(data, "acceleration", count, where),
        jerk=_numbers(data, "jerk", count, where),
        home=_numbers(data, "home", count, where),
        base_position=position, base_yaw=yaw,
        tool=_named(model, "site", _value(data, "tool", where), where),
        gripper=_gripper(gripper, model, where),
        branches={
            label: _branch(ranges, joints, limits, f"{where}, branches.{label}")
            for label, ranges in data.get("branches", {}).items()
        },
    )  # fmt: skip
    if not arm.inside_limits(arm.home):
        raise InputError(f"{where}, home", arm.home.tolist(), "joints within their limits")
    return arm


def _gripper(data: dict[str, Any], model: mujoco.MjModel, where: str) -> Gripper:
    def names(key: str, kind: str) -> tuple[str, ...]:
        return tuple(_named(model, kind, name, where) for name in _value(data, key, where))

    closed, opened = _numbers(data, "command", 2, where)
    width = float(_value(data, "width", where))
    actuator = _named(model, "actuator", _value(data, "actuator", where), where)
    per_command = abs(float(model.actuator(actuator).gainprm[0]))
    return Gripper(
        hand=_named(model, "body", _value(data, "hand", where), where),
        fingers=names("fingers", "body"), pads=names("pads", "geom"),
        joints=names("joints", "joint"), actuator=actuator,
        max_width=width, closed_command=float(closed), open_command=float(opened),
        force=float(_value(data, "force", where)), speed=float(_value(data, "speed", where)),
        stiffness=per_command * abs(float(opened - closed)) / width,
    )  # fmt: skip


def _branch(
    ranges: dict[str, Any], joints: tuple[str, ...], limits: np.ndarray, where: str
) -> tuple[np.ndarray, np.ndarray]:
    """The limits, narrowed where the branch says so."""
    narrowed = limits.copy()
    for name in ranges:
        k = look_up(f"{where}, joint", name, {joint: k for k, joint in enumerate(joints)})
        low, high = _numbers(ranges, name, 2, where)
        narrowed[k] = max(low, limits[k, 0]), min(high, limits[k, 1])
        if narrowed[k, 0] >= narrowed[k, 1]:
            raise InputError(f"{where}, {name}", ranges[name], "a range within the joint's limits")
    return _frozen(narrowed[:, 0]), _frozen(narrowed[:, 1])


def _value(data: dict[str, Any], key: str, where: str) -> Any:
    if key not in data:
        raise InputError(f"{where}, {key}", None, "a value")
    return data[key]


def _table(data: dict[str, Any], key: str, where: str) -> dict[str, Any]:
    table = _value(data, key, where)
    if not isinstance(table, dict):
        raise InputError(f"{where}, {key}", table, f"a table [{key}]")
    return table


def _numbers(data: dict[str, Any], key: str, count: int, where: str) -> np.ndarray:
    given = _value(data, key, where)
    try:
        array = np.array(given, float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise InputError(f"{where}, {key}", given, f"{count} numbers")
    return _frozen(array)


def _frozen(array: np.ndarray) -> np.ndarray:
    array = np.ascontiguousarray(array, float)
    array.flags.writeable = False
    return array


def _named(model: mujoco.MjModel, kind: str, name: str, where: str) -> str:
    """``name``, if the MJCF has such a body, geom, joint, site or actuator."""
    count = {"body": "nbody", "geom": "ngeom", "joint": "njnt", "site": "nsite", "actuator": "nu"}
    access = getattr(model, kind)
    table = {access(k).name: name for k in range(getattr(model, count[kind]))}
    return look_up(f"{where}, {kind}", name, table)


def _joint_range(model: mujoco.MjModel, name: str, where: str) -> np.ndarray:
    joint = model.joint(_named(model, "joint", name, where))
    if joint.type[0] != mujoco.mjtJoint.mjJNT_HINGE or not model.jnt_limited[joint.id]:
        raise InputError(f"{where}, joints", name, "hinge joints with a range")
    return joint.range


__all__ = ["COLLISION_GROUP", "PICTURE_GROUP", "arm_model", "arm_spec"]


def arm_spec(arm: Arm, pictures: bool = False) -> mujoco.MjSpec:
    """An editable model of the arm at its base pose, for adding a table and blocks."""
    return read_spec(arm.mjcf, arm.base_position, arm.base_yaw, pictures)


@lru_cache(maxsize=16)
def arm_model(arm: Arm, pictures: bool = False) -> mujoco.MjModel:
    """The compiled arm alone; shared between callers, so do not change it."""
    return arm_spec(arm, pictures).compile()
