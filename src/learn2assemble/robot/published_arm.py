"""The arm of the released fast mode: joints under motors, and the mass behind the hand."""

# The compiled module has no stubs that pyright finds.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import math

import mujoco
import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.kinematics import forward, get_chain, jacobian
from learn2assemble.robot.model import arm_spec
from learn2assemble.world.blocks import GRAVITY

TIMESTEP = 0.004
"""[s] (protocol 1.1)."""
TORQUE = 500.0
"""Largest torque of a joint [N m] (protocol 8.2)."""
ARM = "panda"
"""The one arm the published cell knows; all numbers below are its own."""
HOME = np.array([0.0, -0.215, 0.0, -2.57, 0.0, 2.356, 2.356])
"""Where every solution of a grasp starts [rad] (protocol 8.1)."""
LOWER = np.array([-2.9671, -1.8326, -2.9671, -3.1416, -2.9671, -0.0873, -2.9671])
UPPER = np.array([2.9671, 1.8326, 2.9671, 0.0, 2.9671, 3.8223, 2.9671])
"""Stops that push the joints back [rad]; inverse kinematics does not know them (protocol 8.1)."""
GRASP_STARTS = (
    np.array([0.4904, -0.5005, 0.1023, -2.7084, 0.0610, 2.2092, 1.3292]),
    np.array([0.5402, 0.2053, -0.0501, -2.2307, 0.0150, 2.4366, 2.8357]),
)
"""For objects behind the first side, by the attitude of the grasp (A, B) [rad] (protocol 8.5)."""
PLACE_STARTS = (
    np.array([0.1030, 0.3711, 0.0257, -2.5515, -0.0449, 2.9237, 0.9485]),
    np.array([-0.1668, 0.3903, 0.2273, -2.5430, -0.3584, 2.9223, 2.7669]),
    np.array([0.2349, 0.3726, -0.0794, -2.5509, 0.1234, 2.9235, 0.8360]),
    np.array([0.0652, 0.3777, 0.0531, -2.5578, -0.0884, 2.9480, 2.5584]),
)
"""For placing objects, by both attitudes (AA, AB, BA, BB) [rad] (protocol 8.5)."""
LINKS = {
    "link1": (2.7, (0.0, -0.04, -0.05), (0.02297, 0.01777, 0.01148)),
    "link2": (2.73, (0.0, -0.04, 0.06), (0.02349, 0.01161, 0.01823)),
    "link3": (2.04, (0.01, 0.01, -0.05), (0.01092, 0.01258, 0.01197)),
    "link4": (2.08, (-0.03, 0.03, 0.02), (0.01134, 0.01225, 0.01306)),
    "link5": (3.0, (0.0, 0.04, -0.12), (0.03568, 0.02985, 0.01280)),
    "link6": (1.3, (0.04, 0.0, 0.0), (0.003428, 0.005117, 0.005988)),
    "link7": (0.2, (0.0, 0.0, 0.08), (0.000362, 0.000362, 0.000592)),
    "hand": (0.81, (0.0, 0.0, 0.04), (0.003719, 0.001016, 0.003388)),
    "left_finger": (0.1, (0.0, 0.01, 0.02), (4.168e-5, 3.874e-5, 1.694e-5)),
    "right_finger": (0.1, (0.0, 0.01, 0.02), (4.168e-5, 3.874e-5, 1.694e-5)),
}
"""Mass [kg], its centre [m] and moments of inertia [kg m^2] in the frame of each body, as that
simulator has them. They matter because motors of limited torque lag where the arm moves far."""


def turned(attitude: Attitude) -> bool:
    """Whether an attitude closes the fingers along x (B) rather than y (A), protocol 5."""
    return abs(math.sin(attitude.yaw)) > 0.5


class MotorArm:
    """The joints of the arm.

    Raises:
        InputError: for another arm than the published one.
    """

    def __init__(self, arm: Arm) -> None:
        if arm.name != ARM:
            raise InputError("arm of the published cell", arm.name, ARM)
        self.arm, self.chain = arm, get_chain(arm)
        spec = arm_spec(arm)
        spec.option.gravity = [0, 0, -GRAVITY]
        self._model = m = spec.compile()
        for name, (mass, centre, inertia) in LINKS.items():
            body = m.body(name).id
            m.body_mass[body], m.body_ipos[body], m.body_inertia[body] = mass, centre, inertia
            m.body_iquat[body] = 1, 0, 0, 0
        m.dof_armature[:], m.dof_damping[:], m.body_gravcomp[:] = 0, 0, 0
        self._data = mujoco.MjData(m)
        mujoco.mj_setConst(m, self._data)
        self._qpos = np.array([m.joint(name).qposadr[0] for name in arm.joints])
        self._dof = np.array([m.joint(name).dofadr[0] for name in arm.joints])
        self._mass = np.empty((m.nv, m.nv))
        self.joints, self.rates, self.command = HOME.copy(), np.zeros(7), HOME.copy()
        """float64[7]: angles [rad], rates [rad/s], and where the motors want the joints [rad]."""
        self.powered = False
        """Whether the motors have had a command; before, they give way."""

    def reset(self) -> None:
        """To the home pose, at rest, motors off."""
        self.jump(HOME)
        self.command, self.powered = HOME.copy(), False

    def jump(self, joints: np.ndarray) -> None:
        """Put the joints somewhere, at rest; the motors keep the command they had."""
        self.joints, self.rates = joints.copy(), np.zeros(7)

    def drive(self, command: np.ndarray) -> None:
        """Where the motors want the joints from now on [rad]."""
        self.command, self.powered = command, True

    @property
    def impulse(self) -> float:
        """Largest impulse of a motor in a step [N m s]."""
        return TORQUE * TIMESTEP if self.powered else 0.0

    def tool(self) -> tuple[np.ndarray, np.ndarray]:
        """Position float64[3] [m] and rotation float64[3, 3] of the tool, world frame."""
        return forward(self.chain, self.joints)

    def jacobian(self) -> np.ndarray:
        """float64[6, 7] of the tool, world axes."""
        return jacobian(self.chain, self.joints)

    def spatial(self) -> np.ndarray:
        """float64[3, 7]: velocity of that point of the hand which is at the arm's base.

        The integral term of the published servo (protocol 8.4) uses these rows for those of the
        tool, so errors are corrected in directions a little beside their own.
        """
        jac = self.jacobian()
        away = self.tool()[0] - self.arm.base_position
        return jac[:3] + np.cross(away, jac[3:].T).T

    def dynamics(self) -> np.ndarray:
        """Inverse of the mass matrix, float64[7, 7]; lets gravity act on the rates."""
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
