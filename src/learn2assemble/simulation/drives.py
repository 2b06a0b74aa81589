"""What the drives of an arm are told."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import mujoco
import numpy as np

from learn2assemble.robot.arm import Arm
from learn2assemble.simulation.model import ArmParts, SimulatedWorld


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
        number: of the arm in the model.
    """

    payload: float
    push: float
    arm: Arm
    world: SimulatedWorld
    data: mujoco.MjData

    payload = 0.0
    """Mass at the tool point the controller was told of [kg]."""
    push = 0.0
    """With which it pushes down there, as its sensor of forces says [N]."""

    def __init__(
        self, arm: Arm, world: SimulatedWorld, data: mujoco.MjData, number: int = 0
    ) -> None:
        self.arm, self.world, self.data = arm, world, data
        self.parts: ArmParts = world.arms[number]
        m, joint = world.model, self.parts.joint
        self._damping = self.parts.damping + m.dof_damping[joint]
        self._entry = self._inertia_entries(joint)
        self._jacobian = np.empty((3, m.nv))

    def commands(
        self,
        position: np.ndarray,
        velocity: np.ndarray,
        acceleration: np.ndarray,
        width: np.ndarray,
    ) -> np.ndarray:
        """Commands float64[k, u] of the actuators of the arm (:attr:`~.model.ArmParts.actuators`)
        in the next k steps, the inertia taken as it is now.

        Args:
            position: float64[k, n] wanted after each step [rad]; ``velocity`` [rad/s] and
                ``acceleration`` [rad/s^2] likewise.
            width: float64[k] openings of the gripper [m], or one for all.
        """
        d, parts, m = self.data, self.parts, self.world.model
        inertia = d.M[self._entry]
        load = d.qfrc_bias[parts.joint] - d.qfrc_gravcomp[parts.joint]
        if self.payload or self.push:
            mujoco.mj_jacSite(m, d, self._jacobian, None, parts.tool)
            jacobian = self._jacobian[:, parts.joint]
            inertia = inertia + self.payload * jacobian.T @ jacobian
            load += (self.payload * -m.opt.gravity[2] - self.push) * jacobian[2]
        load = load + acceleration @ inertia + velocity * self._damping
        told = position + load / parts.stiffness
        if parts.gripper < 0:
            return told
        gripper = self.arm.gripper
        closed = gripper.command(0.0)
        opened = closed + (gripper.command(1.0) - closed) * width
        return np.column_stack([told, np.broadcast_to(opened, len(told))])

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
