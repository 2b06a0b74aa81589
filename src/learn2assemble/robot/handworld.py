"""Objects on a table, and a hand that goes where it is told: the world of the published cell.

The hand (and its fingers, stiff) is a body of great mass whose pose and velocity are set before
every step, so it pushes what it meets and nothing pushes it. A held object hangs on a weld.
"""

# The compiled module has no stubs that pyright finds.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

from learn2assemble.physics.mjcf import DAMPING, IMPRATIO, SHRINK, SOLIMP, SOLREF
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.model import PICTURE_GROUP, arm_model
from learn2assemble.robot.grasps import turn
from learn2assemble.robot.scene import GAP, Scene, fillers
from learn2assemble.world.blocks import FRICTION, GRAVITY, HALF, MASS

SKIN = 1e-3
"""The hand counts as this much thicker on every side [m]: the margin of the engine's hulls."""
FEELER = 1e-3
"""Contacts count from this distance on [m]."""
HAND_MASS, HAND_INERTIA = 1e3, 1e2
WELD = (0.02, 1.0)
"""Time constant [s] and damping of the hold: a fifth of an error goes in a step."""
GRAIN = 1e-3
"""Cells of an object are multiples of this apart [m]."""
_FAR = np.array([0.0, 0.0, 5.0])

Cells = tuple[tuple[float, float, float], ...]
"""Centres of an object's cells relative to its first one [m]."""


class Part(NamedTuple):
    """A convex piece of the hand, in the tool frame."""

    vertices: np.ndarray
    """float64[k, 3] [m]."""


@lru_cache(maxsize=16)
def hand_parts(arm: Arm, opening: float) -> tuple[Part, ...]:
    """Hulls of the hand and of every finger.

    Args:
        arm: whose gripper.
        opening: between the pads [m].
    """
    model = arm_model(arm, pictures=True)
    data = mujoco.MjData(model)
    for name in arm.gripper.joints:
        data.qpos[model.joint(name).qposadr[0]] = opening / len(arm.gripper.joints)
    mujoco.mj_kinematics(model, data)
    site = model.site(arm.tool).id
    origin, axes = data.site_xpos[site], data.site_xmat[site].reshape(3, 3)
    parts = []
    for body in (arm.gripper.hand, *arm.gripper.fingers):
        points = []
        for geom in np.flatnonzero(model.geom_bodyid == model.body(body).id):
            if model.geom_group[geom] == PICTURE_GROUP:
                mesh = model.geom_dataid[geom]
                first = model.mesh_vertadr[mesh]
                own = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
                world = data.geom_xpos[geom] + own @ data.geom_xmat[geom].reshape(3, 3).T
                points.append((world - origin) @ axes)
        parts.append(Part(np.concatenate(points)))
    return tuple(parts)


class HandWorld:
    """One instance serves one thread.

    Args:
        arm: whose hand.
        opening: between the pads [m].
        timestep: [s].
    """

    def __init__(self, arm: Arm, opening: float, timestep: float) -> None:
        self.parts = hand_parts(arm, opening)
        self.timestep = timestep
        self._models: dict[tuple[Cells, ...], mujoco.MjModel] = {}

    def place(self, scene: Scene) -> None:
        """Start over with the objects of ``scene`` at rest, and the hand far away."""
        self._group(scene)
        if self._shape not in self._models:
            self._models[self._shape] = _compile(self.parts, self._shape, self.timestep)
        self.model = m = self._models[self._shape]
        self.data = d = mujoco.MjData(m)
        d.qpos[:3] = _FAR
        for number, cells in enumerate(self._cells):
            pose = d.qpos[7 * number + 7 : 7 * number + 14]
            pose[:3] = self._origin[number]
            yaw = self._yaw[number]
            pose[3:] = np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)
        self._hand_pose = None

    def jump(self, position: np.ndarray, rotation: np.ndarray) -> None:
        """The hand is there at once; then one step."""
        self._hand_pose = (position, rotation)
        self.move(position, rotation)

    def move(self, position: np.ndarray, rotation: np.ndarray) -> None:
        """One step, at the end of which the hand is there."""
        d, (before, turned) = self.data, self._hand_pose
        d.qpos[:3] = before
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, turned.ravel())
        d.qpos[3:7] = quat
        d.qvel[:3] = (position - before) / self.timestep
        relative = np.empty(4)
        mujoco.mju_mat2Quat(relative, (turned.T @ rotation).ravel())
        local = np.empty(3)
        mujoco.mju_quat2Vel(local, relative, self.timestep)
        d.qvel[3:6] = local
        mujoco.mj_step(self.model, d)
        self._hand_pose = (position, rotation)

    def grip(self, cell: int) -> None:
        """Weld the object of a cell to the hand: the cell's centre at the tool point, axes kept."""
        body, offset = self._body[cell], self._offset[cell]
        m, d = self.model, self.data
        position, rotation = self._hand_pose
        own = d.xmat[body + 2].reshape(3, 3)
        relative = rotation.T @ own
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, relative.ravel())
        data = m.eq_data[body]
        data[:3] = 0
        data[3:6] = -relative @ offset
        data[6:10] = quat
        data[10] = 1.0
        d.eq_active[body] = 1

    def release(self, cell: int) -> None:
        self.data.eq_active[self._body[cell]] = 0

    def touched(self) -> set[int]:
        """Numbers of the objects that the hand touches."""
        d, body = self.data, self.model.geom_bodyid
        mujoco.mj_kinematics(self.model, d)
        mujoco.mj_collision(self.model, d)
        return {
            int(max(pair)) - 2 for pair in body[d.contact.geom] if 1 in pair and min(pair) == 1
        }

    def on_table(self, cell: int) -> bool:
        d, body = self.data, self.model.geom_bodyid
        return any(
            min(pair) == 0 and max(pair) == self._body[cell] + 2 for pair in body[d.contact.geom]
        )

    def objects(self, cells: np.ndarray) -> set[int]:
        return set(self._body[cells].tolist())

    def centres(self) -> np.ndarray:
        """float64[n, 3]: of all cells [m]."""
        pose = self.data.qpos[7:].reshape(-1, 7)
        where = pose[self._body, :3].copy()
        turned = np.empty(3)
        for cell in np.flatnonzero(self._offset.any(1)):
            mujoco.mju_rotVecQuat(turned, self._offset[cell], pose[self._body[cell], 3:])
            where[cell] += turned
        return where

    def yaw(self) -> np.ndarray:
        q = self.data.qpos[7:].reshape(-1, 7)[self._body, 3:]
        return 2 * np.arctan2(q[:, 3], q[:, 0])

    def _group(self, scene: Scene) -> None:
        """Objects, sorted by shape so that few models are compiled."""
        ids, first = np.unique(scene.object_id, return_index=True)
        groups = []
        for head in sorted(first):
            cells = np.flatnonzero(scene.object_id == scene.object_id[head])
            own = turn(scene.yaw[head])
            relative = (scene.position[cells] - scene.position[head]) @ own
            relative = GRAIN * np.rint(relative / GRAIN)
            shape = tuple(tuple(float(round(v, 6)) for v in row) for row in relative)
            groups.append((shape, cells, relative, own))
        groups.sort(key=lambda group: (len(group[0]), group[0]))
        count = len(scene.position)
        self._shape = tuple(group[0] for group in groups)
        self._cells = [group[1] for group in groups]
        self._body = np.empty(count, np.int64)
        self._offset = np.zeros((count, 3))
        self._origin, self._yaw = np.empty((len(groups), 3)), np.empty(len(groups))
        for number, (_, cells, relative, own) in enumerate(groups):
            self._body[cells] = number
            self._offset[cells] = relative
            self._origin[number] = (scene.position[cells] - relative @ own.T).mean(0)
            self._yaw[number] = scene.yaw[cells[0]]


def _compile(
    parts: tuple[Part, ...], shapes: tuple[Cells, ...], timestep: float
) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    option = spec.option
    option.timestep = timestep
    option.gravity = [0, 0, -GRAVITY]
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = IMPRATIO
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    world = spec.worldbody
    table = world.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    _set_contact(table)
    hand = world.add_body(
        name="hand", pos=_FAR, mass=HAND_MASS, inertia=[HAND_INERTIA] * 3, gravcomp=1,
        explicitinertial=True,
    )  # fmt: skip
    hand.add_freejoint()
    for number, part in enumerate(parts):
        mesh = spec.add_mesh(name=f"part {number}", uservert=part.vertices.ravel())
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        geom = hand.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name, mass=0, contype=2, conaffinity=1
        )
        _set_contact(geom)
        geom.margin, geom.gap = SKIN, FEELER
    for number, cells in enumerate(shapes):
        body = world.add_body(name=f"object {number}")
        body.add_freejoint()
        for cell in cells:
            _box(body, cell, (HALF - SHRINK, HALF - SHRINK, HALF))
        centres = np.array(cells)
        for a, b in fillers(centres, np.zeros(len(centres), np.int64)):
            along_x = abs(centres[a] - centres[b])[0] > HALF
            half = (GAP / 2, HALF - SHRINK, HALF) if along_x else (HALF - SHRINK, GAP / 2, HALF)
            _box(body, tuple((centres[a] + centres[b]) / 2), half)
        weld = spec.add_equality(
            name=f"hold {number}", type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1="hand", name2=body.name, active=False,
        )
        weld.solref = WELD
        weld.solimp = (0.99, 0.9999, 0.001, 0.5, 2.0)
    model = spec.compile()
    damping = model.dof_damping[6:].reshape(-1, 6)
    damping[:, :3] = DAMPING * model.body_mass[2:, None]
    damping[:, 3:] = DAMPING * model.body_inertia[2:].mean(1, keepdims=True)
    return model


def _box(body: mujoco.MjsBody, centre: tuple[float, ...], half: tuple[float, ...]) -> None:
    geom = body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, pos=list(centre), size=list(half), mass=MASS
    )
    _set_contact(geom)


def _set_contact(geom: mujoco.MjsGeom) -> None:
    geom.friction[0] = FRICTION
    geom.solref = SOLREF
    geom.solimp = SOLIMP
    geom.margin = 1e-5
