"""Two arms in one cell: whether they keep their distance at given joints."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from learn2assemble.robot.arm import Arm, arm_spec
from learn2assemble.robot.scene import reshape, rotation_matrix

MOST_CARRIED = 16
"""Parts of the largest block in a hand."""
_ONE, _OTHER = 1, 2
_FAR = (0.0, 0.0, -50.0)
_PREFIX = "other "
Carried = Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Boxes in a hand: centre float64[3] and axes float64[3, 3] in the frame of the tool, and half
extents float64[3] [m]."""


class ArmPair:
    """The collision shapes of two arms, of which the first may carry a block.

    Args:
        one, other: at their bases.
        apart: distance that they keep [m].
    """

    def __init__(self, one: Arm, other: Arm, apart: float) -> None:
        spec = arm_spec(one)
        spec.attach(arm_spec(other), prefix=_PREFIX, frame=spec.worldbody.add_frame())
        hand = spec.site(one.tool).parent
        for k in range(MOST_CARRIED):
            body = hand.add_body(name=f"carried {k}", pos=_FAR)
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.01] * 3, mass=0.01, contype=1)
        for geom in spec.geoms:
            mine = not geom.parent.name.startswith(_PREFIX)
            solid = bool(geom.contype or geom.conaffinity)
            kinds = (_ONE, _OTHER) if mine else (_OTHER, _ONE)
            geom.contype, geom.conaffinity = kinds if solid else (0, 0)
            # A distance that is kept is a margin of one of the two.
            geom.margin = 0.0 if mine else apart
        self.model = model = spec.compile()
        self.data = mujoco.MjData(model)
        names = one.joints, [_PREFIX + name for name in other.joints]
        self._joints = [np.array([model.joint(j).qposadr[0] for j in some]) for some in names]
        site = model.site(one.tool)
        self._tool, self._turn = site.pos.copy(), rotation_matrix(site.quat)
        self._bodies = np.array([model.body(f"carried {k}").id for k in range(MOST_CARRIED)])
        self._boxes = model.body_geomadr[self._bodies]

    def carry(self, carried: Carried = ()) -> None:
        """What the first arm has in its hand from now on; nothing by default."""
        model = self.model
        model.body_pos[self._bodies] = _FAR
        for k, (centre, axes, half) in enumerate(carried):
            body = self._bodies[k]
            model.body_pos[body] = self._tool + self._turn @ centre
            mujoco.mju_mat2Quat(model.body_quat[body], (self._turn @ axes).ravel())
            reshape(model, self._boxes[k : k + 1], half[None])

    def meet(self, ways: Iterable[np.ndarray], other: np.ndarray) -> bool:
        """Whether the first arm comes too near at some joints float64[n] [rad], the other one being
        at ``other``."""
        self.data.qpos[self._joints[1]] = other
        for joints in ways:
            self.data.qpos[self._joints[0]] = joints
            mujoco.mj_kinematics(self.model, self.data)
            mujoco.mj_collision(self.model, self.data)
            if self.data.ncon:
                return True
        return False
