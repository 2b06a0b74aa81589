"""What the drives are told so that the joints follow a path without lag."""

# The compiled module has no stubs that pyright finds.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import mujoco
import numpy as np

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.mjcf import World
from learn2assemble.world.blocks import GRAVITY


class Drives:
    """Commands of the actuators.

    The drives are position servos, torque = k (command - q) - d q'. The command is the wanted
    position plus what it takes for the joint to be there: damping, inertia, Coriolis forces and
    the payload over k, as the controller of any real arm adds. The arm's own weight is
    compensated by the model.

    Args:
        arm: the robot.
        world: model of the cell.
        data: its state.
    """

    payload = 0.0
    """Mass at the tool point the controller was told of [kg]."""

    def __init__(self, arm: Arm, world: World, data: mujoco.MjData) -> None:
        self.arm, self.world, self.data = arm, world, data
        m, joint = world.model, world.joint
        self._damping = world.damping + m.dof_damping[joint]
        self._entry = self._inertia_entries(joint)
        self._jacobian = np.empty((3, m.nv))

    def commands(
        self,
        position: np.ndarray,
        velocity: np.ndarray,
        acceleration: np.ndarray,
        width: np.ndarray,
    ) -> np.ndarray:
        """Commands float64[k, u] of the next k steps, the inertia taken as it is now.

        Args:
            position: float64[k, n] wanted after each step [rad]; ``velocity`` [rad/s] and
                ``acceleration`` [rad/s^2] likewise.
            width: float64[k] openings of the gripper [m], or one for all.
        """
        w, d = self.world, self.data
        inertia = d.M[self._entry]
        load = d.qfrc_bias[w.joint] - d.qfrc_gravcomp[w.joint]
        if self.payload:
            mujoco.mj_jacSite(w.model, d, self._jacobian, None, w.tool)
            jacobian = self._jacobian[:, w.joint]
            inertia = inertia + self.payload * jacobian.T @ jacobian
            load += self.payload * GRAVITY * jacobian[2]
        load = load + acceleration @ inertia + velocity * self._damping
        out = np.zeros((len(position), w.model.nu))
        out[:, w.drive] = position + load / w.stiffness
        gripper = self.arm.gripper
        closed = gripper.command(0.0)
        out[:, w.gripper] = closed + (gripper.command(1.0) - closed) * width
        return out

    def _inertia_entries(self, joint: np.ndarray) -> np.ndarray:
        """int64[n, n]: where the joints' inertia is in the sparse matrix of MuJoCo."""
        m = self.world.model
        entry = np.empty((len(joint), len(joint)), np.int64)
        for a, row in enumerate(joint):
            begin = m.M_rowadr[row]
            columns = m.M_colind[begin : begin + m.M_rownnz[row]].tolist()
            for b in range(a + 1):
                entry[a, b] = entry[b, a] = begin + columns.index(joint[b])
        return entry
