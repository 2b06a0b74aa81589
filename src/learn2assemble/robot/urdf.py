"""An arm of one's own from its URDF: the folder with an MJCF and an ``arm.toml`` that describes it.

A URDF says nothing of drives, of the tool, or of where the arm waits: position servos that bear the
efforts of the joints, a tool point on the flange for suction tools, and a posture in which the tool
points down before the base are added, and may be changed in the files.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, cast

import mujoco
import numpy as np

from learn2assemble.errors import InputError, check_name
from learn2assemble.files import as_path, claim_folder, read_text, write_file
from learn2assemble.registry import PLAIN_NAME, is_plain_name
from learn2assemble.robot.registry import ARMS
from learn2assemble.robot.tool import COLLISION_GROUP

ACCELERATION, JERK = 8.0, 500.0
"""Of joints, as a URDF has none [rad/s^2], [rad/s^3]: those of the UR5e in this package."""
EFFORT = 100.0
"""Of joints whose URDF has none [N m]."""
STIFF, DAMPED = 14.0, 0.05
"""Stiffness of a drive from the effort of its joint [1/rad], and damping from that [s]."""
ARMATURE = 0.1
"""Inertia of drives about their joints [kg m^2]."""
TRIES, SEED = 64, 0
"""Random postures from which one is looked for that the arm waits in."""
AHEAD, ABOVE = 0.45, 0.35
"""Where the tool is then: before the base, as a share of the reach, and above it [m]."""
FARTHEST = 0.002, 0.01
"""The tool may be so far from there [m], and from straight down [rad]."""
MOST_JOINTS = 12
HAND, TOOL = "hand", "tool"


def arm_from_urdf(
    urdf: str | Path, folder: str | Path, *, flange: str | None = None, payload: float | None = None
) -> Path:
    """Write the folder of an arm, whose name is that of the folder.

    Args:
        urdf: its file; joints between base and flange turn, with limits. Meshes of collision
            shapes become the boxes around them.
        folder: a new or empty one.
        flange: link that tools are fixed to, z out of it; by default the one farthest down.
        payload: largest mass that it may carry, its tool included [kg]; by default not bounded.

    Returns:
        ``arm.toml`` in the folder.

    Raises:
        InputError: for a name that is taken, what is no URDF of such an arm, a mesh that is
            missing, and a posture with the tool down that is not found.
    """
    path, folder = as_path(urdf, "urdf"), as_path(folder, "folder")
    if not is_plain_name(folder.name):
        raise InputError("name of the arm", folder.name, PLAIN_NAME)
    if folder.name in ARMS:
        raise InputError("name of the arm", folder.name, "a folder whose name no other arm has")
    with claim_folder(folder):
        return _written(path, folder, flange, payload)


def _written(path: Path, folder: Path, flange: str | None, payload: float | None) -> Path:
    told, source = _limits_told(path)
    spec = _read(path, source)
    links = {body.name: body for body in spec.bodies if body.name != "world"}
    if flange is not None:
        check_name("flange", flange, links)
    chain = _chain(spec, links[flange] if flange else _farthest(spec), source)
    joints = [joint for body in chain for joint in body.joints]
    _check_joints(spec, joints, source)
    _complete(spec, chain, {joint.name: told.get(joint.name, (0.0, 0.0))[1] for joint in joints})
    names = [joint.name for joint in joints]
    model = _compiled(spec, source)
    home = _home(model, names, source)
    _exclude(spec, model, names, home)
    _compiled(spec, source)
    speeds = [told.get(name, (0.0, 0.0))[0] for name in names]
    if min(speeds) <= 0:
        got = f"joint {names[speeds.index(min(speeds))]} without a velocity"
        raise InputError(f"{source}: limit", got, "velocity above 0 for every joint [rad/s]")
    text = _toml(folder.name, names, home, speeds, (chain[0].name, chain[-1].name), payload)
    write_file(folder / f"{folder.name}.xml", spec.to_xml(), "arm")
    file = folder / "arm.toml"
    write_file(file, text, "arm")
    from learn2assemble.robot.arm import load_arm

    try:
        load_arm(file)  # What is written is an arm, or is not there.
    except InputError:
        for made in (file, folder / f"{folder.name}.xml"):
            made.unlink()
        raise
    return file


def _limits_told(path: Path) -> tuple[dict[str, tuple[float, float]], str]:
    """Velocity [rad/s] and effort [N m] of every joint, which MuJoCo does not keep."""
    text, source = read_text(path, "URDF")
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise InputError(source, str(error), "a URDF") from None
    if root.tag != "robot":
        raise InputError(source, f"<{root.tag}>", "a URDF, which begins with <robot>")
    found: dict[str, tuple[float, float]] = {}
    for joint in root.iter("joint"):
        limit = joint.find("limit")
        if limit is not None:
            try:
                values = (float(limit.get(key, "0")) for key in ("velocity", "effort"))
                velocity, effort = values
            except ValueError as error:
                raise InputError(f"{source}: {joint.get('name')}", str(error), "numbers") from None
            found[joint.get("name", "")] = velocity, effort
    return found, source


def _read(path: Path, source: str) -> mujoco.MjSpec:
    """The model, every collision shape of which is a primitive one."""
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compiler.fusestatic = False
        spec.compiler.discardvisual = True
        model = spec.compile()
    except ValueError as error:
        words = " ".join(str(error).split())
        raise InputError(source, words, "a URDF whose meshes are there") from None
    for geom in list(spec.geoms):
        if geom.type != mujoco.mjtGeom.mjGEOM_MESH:
            continue
        box = model.geom_aabb[geom.id]
        turn, middle = np.empty(9), model.geom_pos[geom.id].copy()
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom.id])
        middle += turn.reshape(3, 3) @ box[:3]
        geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_BOX, ""
        geom.pos, geom.quat, geom.size = middle, model.geom_quat[geom.id], box[3:]
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    return spec


def _farthest(spec: mujoco.MjSpec) -> Any:
    """The body with most joints above it, of those the one farthest down."""

    def depth(body: Any) -> tuple[int, int]:
        joints, links = 0, 0
        while body.name != "world":
            joints, links, body = joints + len(body.joints), links + 1, body.parent
        return joints, links

    return max((body for body in spec.bodies if body.name != "world"), key=depth)


def _chain(spec: mujoco.MjSpec, last: Any, source: str) -> list[Any]:
    """Bodies from the base to the flange."""
    found, body = list[Any](), last
    while body.name != "world":
        found.append(body)
        body = body.parent
    roots = [body.name for body in spec.worldbody.bodies]
    if len(roots) != 1:
        raise InputError(f"{source}: links", f"{len(roots)} without a parent", "one base")
    return found[::-1]


def _check_joints(spec: mujoco.MjSpec, joints: list[Any], source: str) -> None:
    if not 4 <= len(joints) <= MOST_JOINTS:
        got = f"{len(joints)} between base and flange"
        raise InputError(f"{source}: joints", got, f"4 to {MOST_JOINTS} that turn")
    for joint in joints:
        limited = joint.range[1] > joint.range[0]
        if joint.type != mujoco.mjtJoint.mjJNT_HINGE or not limited:
            raise InputError(f"{source}: joints", joint.name, "revolute joints with a range")
    if others := [joint.name for joint in spec.joints if joint not in joints]:
        got = f"{', '.join(others)} beside the arm"
        raise InputError(f"{source}: joints", got, "no fingers: the tool is a suction tool")


def _complete(spec: mujoco.MjSpec, chain: list[Any], efforts: dict[str, float]) -> None:
    """Add drives, the hand and the tool point; gravity is compensated, as by a controller."""
    for geom in spec.geoms:
        geom.group, geom.mass, geom.contype, geom.conaffinity = COLLISION_GROUP, 0, 1, 1
    for body in spec.bodies:
        if body.name != "world":
            body.gravcomp = 1
    hand = chain[-1].add_body(name=HAND, mass=0.01, inertia=[1e-5] * 3, gravcomp=1)
    hand.explicitinertial = True
    hand.add_site(name=TOOL)
    for joint in spec.joints:
        effort = efforts.get(joint.name) or EFFORT
        joint.armature = ARMATURE
        stiff = STIFF * effort
        made = spec.add_actuator(
            name=joint.name,
            target=joint.name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            ctrlrange=joint.range,
            forcerange=[-effort, effort],
        )
        made.set_to_position(kp=stiff, kv=DAMPED * stiff)


def _compiled(spec: mujoco.MjSpec, source: str) -> mujoco.MjModel:
    try:
        return spec.compile()
    except ValueError as error:
        raise InputError(source, " ".join(str(error).split()), "a whole arm") from None


def _home(model: mujoco.MjModel, names: list[str], source: str) -> np.ndarray:
    """float64[n]: where the tool points down before the base, as far as that goes from the limits
    of the joints [rad]."""
    from scipy.optimize import (  # pyright: ignore[reportMissingTypeStubs]
        least_squares,  # pyright: ignore[reportUnknownVariableType]
    )

    data, rng = mujoco.MjData(model), np.random.default_rng(SEED)
    address = [int(model.joint(name).qposadr[0]) for name in names]
    low, high = np.array([model.joint(name).range for name in names]).T
    anchors = [model.body(int(model.joint(name).bodyid[0])).id for name in names]
    mujoco.mj_kinematics(model, data)
    corners = np.vstack([data.xpos[anchors], data.site(TOOL).xpos])
    reach = float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum())
    slide, turn = np.empty((2, 3, model.nv))
    columns = [int(model.joint(name).dofadr[0]) for name in names]
    goal = np.array([AHEAD * reach, 0.0, ABOVE])

    def off(q: np.ndarray) -> np.ndarray:
        data.qpos[address] = q
        mujoco.mj_kinematics(model, data)
        tool = data.site(TOOL)
        return np.concatenate([tool.xpos - goal, 0.3 * (tool.xmat.reshape(3, 3)[:, 2] + [0, 0, 1])])

    best: tuple[float, np.ndarray] | None = None
    for _ in range(TRIES):
        found: Any = cast("Any", least_squares)(off, rng.uniform(low, high), bounds=(low, high))
        rest = off(found.x)
        if np.linalg.norm(rest[:3]) > FARTHEST[0] or np.linalg.norm(rest[3:]) > 0.3 * FARTHEST[1]:
            continue
        room = float((np.minimum(found.x - low, high - found.x) / (high - low)).min())
        # Free to turn all ways, with the elbow up.
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSite(model, data, slide, turn, model.site(TOOL).id)
        worst = np.linalg.svd(np.vstack([slide, turn])[:, columns], compute_uv=False).min()
        worth = min(room, 0.2) + min(float(worst), 0.2) + float(data.xpos[anchors][:, 2].max())
        if best is None or worth > best[0]:
            best = worth, found.x
    if best is None:
        got = f"no posture with the tool down at {goal.round(3).tolist()} m from the base"
        raise InputError(source, got, "an arm that reaches it, z out of its flange (`flange=`)")
    return best[1].round(4)


def _exclude(
    spec: mujoco.MjSpec, model: mujoco.MjModel, names: list[str], home: np.ndarray
) -> None:
    """Links that touch where the arm waits are neighbours, whose shapes overlap."""
    data = mujoco.MjData(model)
    for name, value in zip(names, home, strict=True):
        data.qpos[int(model.joint(name).qposadr[0])] = value
    mujoco.mj_forward(model, data)
    pairs = {
        tuple(sorted((int(model.geom_bodyid[a]), int(model.geom_bodyid[b]))))
        for a, b in (data.contact.geom if data.ncon else ())
    }
    for a, b in sorted(pairs):
        if a:
            spec.add_exclude(bodyname1=model.body(a).name, bodyname2=model.body(b).name)


def _toml(
    name: str,
    joints: list[str],
    home: np.ndarray,
    speeds: list[float],
    ends: tuple[str, str],
    payload: float | None,
) -> str:
    """``arm.toml``.

    Args:
        ends: links of base and flange.
    """
    count, carries = len(joints), "" if payload is None else f"payload = {payload:g}  # kg\n"
    return f"""# {name}, from its URDF. Check what a URDF does not say: acceleration, jerk, home.
mjcf = "{name}.xml"
tool = "{TOOL}"  # site: z out of the flange
joints = {json.dumps(joints)}
home = {home.tolist()}
velocity = {speeds}  # rad/s
acceleration = {[ACCELERATION] * count}  # rad/s^2: none is in a URDF
jerk = {[JERK] * count}  # rad/s^3: none is in a URDF
{carries}
[base]
position = [-0.5, 0.0, 0.0]  # m, world
yaw = 0.0  # rad

# No fingers: tools are suction tools.
[gripper]
hand = "{HAND}"

[driver]
base_frame = "{ends[0]}"
flange_frame = "{ends[1]}"
"""
