"""Arms as data: an MJCF and an ``arm.toml`` beside it; their MuJoCo models (table top z = 0)."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import math
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from learn2assemble.errors import InputError, look_up
from learn2assemble.geometry.rotations import yaw_quaternion
from learn2assemble.robot import scene as _  # noqa: F401 (the warnings of MuJoCo)
from learn2assemble.robot.grasps import MOST_TILT
from learn2assemble.robot.registry import ARMS, TOOLS
from learn2assemble.robot.tool import (
    COLLISION_GROUP,
    PICTURE_GROUP,
    Gripper,
    Suction,
    frozen,
    load_suction,
    mount,
    numbers,
    read_toml,
    table,
    value,
)

SWING = 0.02
"""A curve through poses swings out between them by less [rad]; 0.007 was seen."""
FINGERS = "gripper"
"""The tool that an arm comes with."""
MESHES = "meshes.zip"
"""Beside an MJCF, the mesh files of its pictures; those that are not in it are read beside it."""
FARTHEST = 100.0
"""Bases stand no farther away than this [m]."""


def read_spec(mjcf: Path, position: np.ndarray, yaw: float, pictures: bool) -> mujoco.MjSpec:
    """The arm's MJCF, its root bodies moved to the base pose.

    Args:
        mjcf: file of the arm.
        position: float64[3] of the base [m, world].
        yaw: turn of the base about z [rad].
        pictures: keep the geoms without contact, which only pictures need; loading is faster
            without them.
    """
    if pictures:
        spec = mujoco.MjSpec.from_file(str(mjcf))
    else:
        known = mjcf.stat() if mjcf.is_file() else None
        spec = _bare_spec(mjcf, known and (known.st_mtime_ns, known.st_size)).copy()
    if pictures and (meshes := mjcf.parent / MESHES).is_file():
        with zipfile.ZipFile(meshes) as packed:
            # MuJoCo looks there before it looks beside the MJCF. Models of several arms share
            # these names, so they begin with the name of the arm.
            spec.assets = {name: packed.read(name) for name in packed.namelist()}
    turn = yaw_quaternion(yaw)
    for body in spec.worldbody.bodies:
        moved, turned, rotated = np.empty(3), np.empty(4), np.empty(3)
        own = np.asarray(body.quat) / np.linalg.norm(body.quat)
        mujoco.mju_rotVecQuat(rotated, np.asarray(body.pos), turn)
        mujoco.mju_mulQuat(turned, turn, own)
        np.add(position, rotated, out=moved)
        body.pos, body.quat = moved, turned
    return spec


# Every cell and every check of a program begins with one: a copy takes a hundredth of the time.
@lru_cache(maxsize=8)
def _bare_spec(mjcf: Path, version: tuple[int, int] | None) -> mujoco.MjSpec:
    """An arm's MJCF without what only pictures need, as long as its file is the same."""
    spec = mujoco.MjSpec.from_file(str(mjcf))
    for geom in list(spec.geoms):
        if geom.group == PICTURE_GROUP:
            spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    return spec


class Limits(NamedTuple):
    """Largest magnitudes per joint, each float64[n]: [rad/s], [rad/s^2], [rad/s^3]; and the range
    of positions [rad]."""

    velocity: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    def scaled(self, speed: float) -> Limits:
        """Limits of the same motion played at ``speed`` times its bounds."""
        v, a, j, *positions = self
        return Limits(v * speed, a * speed**2, j * speed**3, *positions)


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
    tool_name: str = "gripper"
    """A name of :data:`~.registry.TOOLS`."""
    suction: Suction | None = None
    """The tool in place of the fingers; ``gripper`` then has none, and no opening."""
    payload: float = np.inf
    """Largest mass that it may carry, a tool in place of the fingers included [kg]."""
    most_tilt: float = MOST_TILT
    """Of the axis of its tool from the vertical at one end of a way [rad]; at the other one
    :data:`MOST_TILT`."""

    @property
    def works_level(self) -> bool:
        """Whether its tool may be level at one end of a way."""
        return self.most_tilt > MOST_TILT

    @property
    def bounds(self) -> Limits:
        """Of its joints."""
        return Limits(self.velocity, self.acceleration, self.jerk, self.lower, self.upper)

    @property
    def turns(self) -> tuple[float, ...]:
        """Other turns of the hand about the vertical in which it holds the same [rad]."""
        return (np.pi,) if self.suction is None else (np.pi, np.pi / 2, -np.pi / 2)

    def fits(self, studs: float) -> bool:
        """Whether its tool is one for blocks with studs so far apart [m], or without (0): fingers
        are for all, a cup does not hold on studs, and a socket on those of its own size alone."""
        return self.suction is None or math.isclose(self.suction.studs, studs, rel_tol=1e-3)

    def limits(self, branch: str | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper joint limits [rad] of a branch, by default the preferred one, within
        which poses are sought. With a suction tool they keep a distance from the limits of the
        joints, as the curve through several poses may swing out a little between them.

        Raises:
            UnknownNameError: naming the nearest one; ``"any"`` is the whole range.
        """
        found = whole = (self.lower, self.upper)
        if branch is not None:
            table = {**self.branches, "any": whole}
            found = look_up(f"branch of arm {self.name}", branch, table)
        elif self.branches:
            found = next(iter(self.branches.values()))
        if self.suction is None:
            return found
        return np.maximum(found[0], self.lower + SWING), np.minimum(found[1], self.upper - SWING)

    def inside_limits(self, joints: np.ndarray) -> np.ndarray:
        """bool[...]: whether joints [rad], float64[..., n], respect the limits."""
        return np.all((joints >= self.lower - 1e-9) & (joints <= self.upper + 1e-9), axis=-1)


def get_arm(
    name: str, tool: str | None = None, base: tuple[float, float, float, float] | None = None
) -> Arm:
    """The arm called ``name``; the same object for the same arguments.

    Args:
        name: one of :data:`~.registry.ARMS`.
        tool: one of :data:`~.registry.TOOLS`, by default the fingers it comes with.
        base: x, y, z [m, world] and turn about z [rad] of its base, as in ``arm.toml``; by
            default where that puts it.

    Raises:
        UnknownNameError: naming the nearest one.
        InputError: for a base that is not four finite numbers, and for fingers of an arm that has
            none.
    """
    if base is not None:
        given = {"base": list(base)}
        base = tuple(numbers(given, "base", 4, f"arm {name}").tolist())
        if max(map(abs, base)) > FARTHEST:
            raise InputError(f"arm {name}, base", list(base), f"numbers up to {FARTHEST:g}")
    found = _get_arm(
        look_up("arm", name, ARMS),
        look_up("tool", FINGERS if tool is None else tool, TOOLS),
        base,
    )
    if tool == FINGERS and not found.gripper.fingers:
        raise InputError("tool", tool, f"a suction tool: the arm {name} has no fingers")
    return found


@lru_cache(maxsize=32)
def _get_arm(file: Path, tool: Path, base: tuple[float, ...] | None) -> Arm:
    arm = load_arm(file)
    if base is not None:
        arm = replace(arm, base_position=frozen(np.array(base[:3])), base_yaw=base[3])
    suction = load_suction(tool)
    if suction is None:
        return arm
    bare = replace(arm.gripper, fingers=(), pads=(), joints=(), actuator="", max_width=0.0, tip=0.0)
    return replace(arm, gripper=bare, suction=suction, tool_name=tool.parent.name)


def load_arm(path: Path) -> Arm:
    """The arm a file describes, with its fingers; its name is that of the folder.

    Raises:
        InputError: where the file lacks a value, or names something its MJCF does not have.
    """
    name = path.parent.name
    where = f"arm {name}"
    data = read_toml(path, where)
    base, gripper = table(data, "base", where), table(data, "gripper", where)
    position, yaw = numbers(base, "position", 3, where), float(value(base, "yaw", where))
    joints = tuple(value(data, "joints", where))
    count = len(joints)
    mjcf = path.parent / value(data, "mjcf", where)
    if not mjcf.is_file():
        raise InputError(f"{where}, mjcf", str(mjcf), "an MJCF file beside arm.toml")
    model = read_spec(mjcf, position, yaw, pictures=False).compile()
    limits = np.array([_joint_range(model, joint, where) for joint in joints])
    tool = _named(model, "site", value(data, "tool", where), where)
    arm = Arm(
        name=name,
        mjcf=mjcf,
        joints=joints,
        lower=frozen(limits[:, 0]),
        upper=frozen(limits[:, 1]),
        velocity=numbers(data, "velocity", count, where),
        acceleration=numbers(data, "acceleration", count, where),
        jerk=numbers(data, "jerk", count, where),
        home=numbers(data, "home", count, where),
        base_position=position,
        base_yaw=yaw,
        tool=tool,
        gripper=_gripper(gripper, model, tool, where),
        branches={
            label: _branch(ranges, joints, limits, f"{where}, branches.{label}")
            for label, ranges in data.get("branches", {}).items()
        },
        payload=float(numbers(data, "payload", 0, where)) if "payload" in data else np.inf,
    )
    if arm.payload <= 0:
        raise InputError(f"{where}, payload", arm.payload, "a number above 0 [kg]")
    if not arm.inside_limits(arm.home):
        raise InputError(f"{where}, home", arm.home.tolist(), "joints within their limits")
    return arm


def _gripper(data: dict[str, Any], model: mujoco.MjModel, site: str, where: str) -> Gripper:
    def names(key: str, kind: str) -> tuple[str, ...]:
        return tuple(_named(model, kind, name, where) for name in value(data, key, where))

    if "fingers" not in data:
        hand = _named(model, "body", value(data, "hand", where), where)
        return Gripper(hand, (), (), (), "", 0.0, 0.0, 0.0, 0.0, 1.0, 1.0)
    closed, opened = numbers(data, "command", 2, where)
    width = float(value(data, "width", where))
    actuator = _named(model, "actuator", value(data, "actuator", where), where)
    per_command = abs(float(model.actuator(actuator).gainprm[0]))
    fingers = names("fingers", "body")
    return Gripper(
        hand=_named(model, "body", value(data, "hand", where), where),
        fingers=fingers,
        pads=names("pads", "geom"),
        tip=_beyond(model, fingers, site),
        joints=names("joints", "joint"),
        actuator=actuator,
        max_width=width,
        closed_command=float(closed),
        open_command=float(opened),
        force=float(value(data, "force", where)),
        speed=float(value(data, "speed", where)),
        stiffness=per_command * abs(float(opened - closed)) / width,
    )


def _beyond(model: mujoco.MjModel, fingers: tuple[str, ...], site: str) -> float:
    """How far the solids of the fingers reach beyond the tool point [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    tool, most = data.site(site), 0.0
    bodies = [model.body(name).id for name in fingers]
    for geom in np.flatnonzero(np.isin(model.geom_bodyid, bodies)):
        axis = data.geom_xmat[geom].reshape(3, 3).T @ tool.xmat.reshape(3, 3)[:, 2]
        # Of the box around the geom, whatever its type.
        middle, half = model.geom_aabb[geom].reshape(2, 3)
        along = (data.geom_xpos[geom] - tool.xpos) @ tool.xmat.reshape(3, 3)[:, 2]
        most = max(most, float(along + axis @ middle + np.abs(axis) @ half))
    return most


def _branch(
    ranges: dict[str, Any], joints: tuple[str, ...], limits: np.ndarray, where: str
) -> tuple[np.ndarray, np.ndarray]:
    """The limits, narrowed where the branch says so."""
    narrowed = limits.copy()
    for name in ranges:
        k = look_up(f"{where}, joint", name, {joint: k for k, joint in enumerate(joints)})
        low, high = numbers(ranges, name, 2, where)
        narrowed[k] = max(low, limits[k, 0]), min(high, limits[k, 1])
        if narrowed[k, 0] >= narrowed[k, 1]:
            raise InputError(f"{where}, {name}", ranges[name], "a range within the joint's limits")
    return frozen(narrowed[:, 0]), frozen(narrowed[:, 1])


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


__all__ = ["COLLISION_GROUP", "PICTURE_GROUP", "arm_model", "arm_spec", "arms_spec"]


def arm_spec(arm: Arm, pictures: bool = False) -> mujoco.MjSpec:
    """An editable model of the arm with its tool at its base pose, for adding a table and
    blocks."""
    spec = read_spec(arm.mjcf, arm.base_position, arm.base_yaw, pictures)
    if arm.suction is not None:
        mount(spec, arm.gripper.hand, arm.tool, arm.suction, pictures)
    return spec


def prefix_of(number: int) -> str:
    """What the names of an arm's parts begin with in a model of several arms."""
    return f"{number}/" if number else ""


def arms_spec(arms: Sequence[Arm], pictures: bool = False) -> mujoco.MjSpec:
    """An editable model of arms with their tools, each at its base pose; names of all but the first
    one begin as :func:`prefix_of` says."""
    spec = arm_spec(arms[0], pictures)
    for number, arm in enumerate(arms[1:], 1):
        frame = spec.worldbody.add_frame()
        spec.attach(arm_spec(arm, pictures), prefix=prefix_of(number), frame=frame)
    return spec


@lru_cache(maxsize=16)
def arm_model(arm: Arm, pictures: bool = False) -> mujoco.MjModel:
    """The compiled arm alone; shared between callers, so do not change it."""
    return arm_spec(arm, pictures).compile()
