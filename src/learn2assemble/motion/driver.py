"""What the driver of a robot calls things, and where its frames are."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import tomllib
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from learn2assemble.geometry.rotations import (
    matrix_quaternion,
    quaternion_matrix,
    yaw_quaternion,
)
from learn2assemble.motion.record import ArmFacts
from learn2assemble.robot.arm import Arm, arm_model, get_arm


class Driver(NamedTuple):
    """What the robot's own driver calls things, and where its frames are."""

    joints: tuple[str, ...]
    base_frame: str
    base: np.ndarray
    """float64[7]: pose of that frame: x, y, z [m, world], quaternion (w, x, y, z)."""
    flange_frame: str
    tcp: np.ndarray
    """float64[7]: pose of the tool point in the frame of the flange."""
    tool_mass: float
    """Of all that hangs on the flange [kg]."""
    tool_centre: np.ndarray
    """float64[3]: its centre of mass in the frame of the flange [m]."""


@lru_cache(maxsize=16)
def driver_of(arm: Arm) -> Driver:
    """Names and frames of an arm's driver: table ``driver`` of its ``arm.toml``; by default those
    of its MJCF, with the hand as flange."""
    import mujoco

    file = arm.mjcf.parent / "arm.toml"
    told = tomllib.loads(file.read_text(encoding="utf-8")).get("driver", {})
    model = arm_model(arm)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    flange = data.body(told.get("flange_body", arm.gripper.hand))
    turn = flange.xmat.reshape(3, 3)
    position = flange.xpos + turn @ told.get("flange_position", np.zeros(3))
    turn = turn @ quaternion_matrix(np.array(told.get("flange_quaternion", [1.0, 0, 0, 0])))
    tool = data.site(arm.tool)
    tcp = turn.T @ (tool.xpos - position), matrix_quaternion(turn.T @ tool.xmat.reshape(3, 3))
    yaw = yaw_quaternion(arm.base_yaw + told.get("base_yaw", 0.0))
    return Driver(
        tuple(told.get("joints", arm.joints)),
        told.get("base_frame", "base"),
        np.concatenate([arm.base_position, yaw]),
        told.get("flange_frame", "flange"),
        np.concatenate(tcp),
        float(model.body(arm.gripper.hand).subtreemass[0]),
        turn.T @ (data.body(arm.gripper.hand).subtree_com - position),
    )


def pose_vector(pose: np.ndarray) -> np.ndarray:
    """x, y, z and a rotation vector float64[6], of a position and a quaternion float64[7]."""
    from scipy.spatial.transform import Rotation  # pyright: ignore[reportMissingTypeStubs]

    turn = Rotation.from_quat(pose[3:], scalar_first=True).as_rotvec()
    return np.concatenate([pose[:3], turn])


def stand(name: str, tool: str, base: np.ndarray) -> Arm:
    """An arm with its tool where it stands: x, y, z [m, world] and turn about z [rad]."""
    arm = get_arm(name, tool)
    if np.allclose(base, (*arm.base_position, arm.base_yaw), rtol=0, atol=1e-6):
        return arm
    x, y, z, yaw = base.tolist()
    return get_arm(name, tool, (x, y, z, yaw))


def arm_of(facts: ArmFacts) -> Arm:
    """The arm of a record.

    Raises:
        UnknownNameError: for an arm or a tool that does not exist.
    """
    return stand(facts.name, facts.tool_name, np.append(facts.base_position, facts.base_yaw))
