"""Joints under velocity motors of limited torque, as the published simulator drives them.

The arm counts as stronger than what it touches, so its motion depends on its own mass only.
"""

# The compiled module has no stubs that pyright finds.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import mujoco
import numpy as np
from numba import njit

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.model import arm_spec
from learn2assemble.world.blocks import GRAVITY

TIMESTEP = 0.004
"""[s] (protocol 1.1)."""
TORQUE = 500.0
"""Of every joint [N m] (protocol 8.2)."""
POSITION_GAIN = 0.1
"""Share of the distance to its command that a joint goes in a step (protocol 8.2)."""
LIMIT_GAIN = 0.2
"""Share of the distance beyond a limit that a joint is pushed back in a step (protocol 1.1)."""
SWEEPS = 50
"""Of the solver over all joints (protocol 1.1)."""


class Servo:
    """The joints of one arm.

    Args:
        arm: the robot.
        lower, upper: float64[n], limits the joints are pushed back into [rad].
        torque: the largest one [N m].
    """

    def __init__(
        self, arm: Arm, lower: np.ndarray, upper: np.ndarray, torque: float = TORQUE
    ) -> None:
        self.lower, self.upper, self.torque = lower, upper, torque
        spec = arm_spec(arm)
        spec.option.gravity = [0, 0, -GRAVITY]
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self._model = m = spec.compile()
        m.dof_armature[:] = 0
        m.body_gravcomp[:] = 0
        m.dof_damping[:] = 0
        self._data = mujoco.MjData(m)
        self._qpos = np.array([m.joint(name).qposadr[0] for name in arm.joints])
        self._dof = np.array([m.joint(name).dofadr[0] for name in arm.joints])
        self._mass = np.empty((m.nv, m.nv))
        self.joints = arm.home.copy()
        """float64[n] [rad]."""
        self.rates = np.zeros(len(arm.joints))
        """float64[n] [rad/s]."""
        self.command = self.joints.copy()
        """float64[n]: where the motors want the joints [rad]."""

    def jump(self, joints: np.ndarray) -> None:
        """Put the joints somewhere, at rest."""
        self.joints, self.rates = joints.copy(), np.zeros(len(joints))
        self.command = self.joints.copy()

    def step(self) -> None:
        """One time step towards the command."""
        m, d = self._model, self._data
        d.qpos[self._qpos], d.qvel[self._dof] = self.joints, self.rates
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        mujoco.mj_crb(m, d)
        mujoco.mj_comVel(m, d)
        mujoco.mj_rne(m, d, 0, d.qfrc_bias)
        mujoco.mj_fullM(m, d, self._mass)
        mass = self._mass[np.ix_(self._dof, self._dof)]
        bias = d.qfrc_bias[self._dof]
        self.rates = _motors(
            np.linalg.inv(mass), bias, self.joints, self.rates, self.command, self.lower,
            self.upper, self.torque * TIMESTEP,
        )  # fmt: skip
        self.joints = self.joints + TIMESTEP * self.rates


@njit(cache=True)
def _motors(inverse, bias, joints, rates, command, lower, upper, largest):
    """Rates after a step: projected Gauss-Seidel over motors and limits."""
    n = joints.shape[0]
    out = rates.copy()
    for i in range(n):
        for k in range(n):
            out[i] -= TIMESTEP * inverse[i, k] * bias[k]
    motor, stop = np.zeros(n), np.zeros(n)
    for _ in range(SWEEPS):
        for i in range(n):
            wanted = POSITION_GAIN * (command[i] - joints[i]) / TIMESTEP
            new = motor[i] + (wanted - out[i]) / inverse[i, i]
            new = min(max(new, -largest), largest)
            change = new - motor[i]
            motor[i] = new
            for k in range(n):
                out[k] += inverse[k, i] * change
            below, above = lower[i] - joints[i], joints[i] - upper[i]
            change = 0.0
            if below > 0:
                least = LIMIT_GAIN * below / TIMESTEP
                new = max(stop[i] + (least - out[i]) / inverse[i, i], 0.0)
                change = new - stop[i]
            elif above > 0:
                most = -LIMIT_GAIN * above / TIMESTEP
                new = min(stop[i] + (most - out[i]) / inverse[i, i], 0.0)
                change = new - stop[i]
            stop[i] += change
            for k in range(n):
                out[k] += inverse[k, i] * change
    return out
