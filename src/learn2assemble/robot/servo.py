"""The arm of the published cell: joints with motors, and the mass behind the hand."""

# The compiled module has no stubs that pyright finds.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import mujoco
import numpy as np

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.model import arm_spec
from learn2assemble.world.blocks import GRAVITY

TIMESTEP = 0.004
"""[s] (protocol 1.1)."""
TORQUE = 500.0
"""Of every joint [N m] (protocol 8.2)."""


class Servo:
    """The joints of one arm.

    Args:
        arm: the robot.
        lower, upper: float64[n], limits the joints are pushed back into [rad].
        torque: the largest one [N m].
    """

    def __init__(
        self, arm: Arm, lower: np.ndarray, upper: np.ndarray, torque: float = TORQUE,
        masses=None,
    ) -> None:
        self.lower, self.upper, self.torque = lower, upper, torque
        spec = arm_spec(arm)
        spec.option.gravity = [0, 0, -GRAVITY]
        self._model = m = spec.compile()
        m.dof_armature[:] = 0
        for name, (mass, where, inertia) in (masses or {}).items():
            body = m.body(name).id
            m.body_mass[body] = mass
            m.body_ipos[body] = where
            m.body_iquat[body] = 1, 0, 0, 0
            m.body_inertia[body] = inertia
        m.body_gravcomp[:] = 0
        m.dof_damping[:] = 0
        mujoco.mj_setConst(m, mujoco.MjData(m))
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

    def dynamics(self) -> np.ndarray:
        """Inverse of the mass matrix, float64[n, n]; gravity and inertia act on the rates."""
        m, d = self._model, self._data
        d.qpos[self._qpos], d.qvel[self._dof] = self.joints, self.rates
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        mujoco.mj_crb(m, d)
        mujoco.mj_comVel(m, d)
        mujoco.mj_rne(m, d, 0, d.qfrc_bias)
        mujoco.mj_fullM(m, d, self._mass)
        inverse = np.linalg.inv(self._mass[np.ix_(self._dof, self._dof)])
        self.rates = self.rates - TIMESTEP * inverse @ d.qfrc_bias[self._dof]
        return inverse
