"""The state of a simulated cell, in the words of the task."""

# The compiled module has no stubs that pyright finds.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import mujoco
import numpy as np

from learn2assemble.robot.mjcf import World


class CellState:
    """Arm and objects at rest, one of which is to be moved.

    Args:
        world: model of the cell.
        poses: float64[b, 7] of the objects: position [m] and quaternion (w, x, y, z).
        target: number of the object to be moved.
        joints: float64[n] of the arm [rad].
        width: opening of the gripper [m].
    """

    def __init__(
        self, world: World, poses: np.ndarray, target: int, joints: np.ndarray, width: float
    ) -> None:
        self.world, self.target = world, target
        self.model, self.data = world.model, mujoco.MjData(world.model)
        self.poses = self.data.qpos[world.pose :].reshape(-1, 7)
        """float64[b, 7]: poses of the objects now; a view."""
        self.poses[:] = poses
        self.data.qpos[world.finger] = width / len(world.finger)
        self.put_arm(joints)

    def put_arm(self, joints: np.ndarray) -> None:
        """The arm is at joints float64[n] [rad], at rest."""
        d, joint = self.data, self.world.joint
        d.qpos[joint], d.qvel[joint] = joints, 0.0
        mujoco.mj_forward(self.model, d)

    @property
    def opening(self) -> float:
        """Between the pads [m]."""
        return float(self.data.qpos[self.world.finger].sum())

    def tool(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the tool float64[3] [m] and float64[3, 3], of the same instant as the objects
        (a step leaves its own one behind)."""
        mujoco.mj_kinematics(self.model, self.data)
        d, tool = self.data, self.world.tool
        return d.site_xpos[tool].copy(), d.site_xmat[tool].reshape(3, 3).copy()

    def in_hand(self) -> np.ndarray:
        """float64[3]: the target object in the tool frame [m]."""
        position, rotation = self.tool()
        return rotation.T @ (self.poses[self.target, :3] - position)

    def asleep(self, besides: bool = False) -> bool:
        """Whether every object rests, or every one but the target."""
        rest = self.data.tree_asleep[self.world.tree :] >= 0
        return bool(rest.all() or (besides and np.delete(rest, self.target).all()))

    def speed(self, number: int) -> float:
        """Of an object [m/s]."""
        first = self.model.nv - 6 * (len(self.poses) - number)
        return float(np.linalg.norm(self.data.qvel[first : first + 3]))

    def mass(self, number: int) -> float:
        """Of an object [kg]."""
        return float(self.model.body_mass[self.model.nbody - len(self.poses) + number])
