"""The MuJoCo model of an arm at its place in the world (table top z = 0)."""

# The compiled module has no stubs that pyright finds.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from functools import lru_cache

import mujoco

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.spec import COLLISION_GROUP, PICTURE_GROUP, read_spec

__all__ = ["COLLISION_GROUP", "PICTURE_GROUP", "arm_model", "arm_spec"]


def arm_spec(arm: Arm, pictures: bool = False) -> mujoco.MjSpec:
    """An editable model of the arm at its base pose, for adding a table and blocks."""
    return read_spec(arm.mjcf, arm.base_position, arm.base_yaw, pictures)


@lru_cache(maxsize=16)
def arm_model(arm: Arm, pictures: bool = False) -> mujoco.MjModel:
    """The compiled arm alone; shared between callers, so do not change it."""
    return arm_spec(arm, pictures).compile()
