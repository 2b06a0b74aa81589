"""Objects on a table, and a hand that goes where it is told: the world of the published cell.

MuJoCo finds the contacts; :mod:`learn2assemble.robot.impulses` moves the bodies. Nothing pushes
the hand. A held object hangs on a constraint.
"""

# The compiled module has no stubs that pyright finds.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.grasps import turn
from learn2assemble.robot.kinematics import forward, get_chain, jacobian
from learn2assemble.robot.servo import Servo
from learn2assemble.robot.impulses import advance, move, resolve, wake
from learn2assemble.robot.manifolds import BREAKING, empty, points, update
from learn2assemble.robot.model import PICTURE_GROUP, arm_model
from learn2assemble.robot.rotations import rotation_vector
from learn2assemble.robot.scene import GAP, Scene, fillers
from learn2assemble.world.blocks import EDGE, FRICTION, GRAVITY, HALF, MASS

SKIN = 1e-3
"""The hand counts as this much thicker on every side [m]: the margin of the engine's hulls."""
FEELER = 0.9e-3
"""Contacts count from this distance on [m]: 2 % of a block's half diagonal."""
INERTIA = 3.0
ORDER = True
SLOW = 1e-3
GRAIN = 1e-3
"""Cells of an object are multiples of this apart [m]."""
_FAR = np.array([0.0, 0.0, 5.0])

Cells = tuple[tuple[float, float, float], ...]
"""Centres of an object's cells relative to its first one [m]."""


@lru_cache(maxsize=16)
def hand_parts(arm: Arm, opening: float) -> tuple[np.ndarray, ...]:
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
        parts.append(np.concatenate(points))
    return tuple(parts)


class HandWorld:
    def __init__(self, arm: Arm, opening: float, timestep: float, servo: Servo) -> None:
        self.chain, self.servo = get_chain(arm), servo
        self.parts = hand_parts(arm, opening)
        self.timestep = timestep
        self._models: dict[tuple[Cells, ...], mujoco.MjModel] = {}

    def place(self, scene: Scene) -> None:
        self._group(scene)
        if self._shape not in self._models:
            self._models[self._shape] = _compile(self.parts, self._shape)
        self.model = m = self._models[self._shape]
        self.data = mujoco.MjData(m)
        count = m.nbody
        self.mass = np.zeros(count)
        self.local = np.zeros((count, 3, 3))
        self.mass[2:] = 1 / m.body_mass[2:]
        for b in range(2, count):
            full = np.empty(9)
            mujoco.mju_quat2Mat(full, m.body_iquat[b])
            axes = full.reshape(3, 3)
            inertia = axes @ np.diag(m.body_inertia[b]) @ axes.T
            inertia += np.eye(3) * (INERTIA - 1) * sum(4 * m.geom_size[g][:2].dot(m.geom_size[g][:2]) / 12 * MASS for g in np.flatnonzero(m.geom_bodyid == b))
            self.local[b] = np.linalg.inv(inertia)
        self.com = m.body_ipos.copy()
        self.com[:2] = 0
        self.position = np.zeros((count, 3))
        self.quat = np.zeros((count, 4))
        self.quat[:, 0] = 1
        self.position[1] = _FAR
        for number in range(len(self._shape)):
            yaw = self._yaw[number]
            self.quat[number + 2] = np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)
            self.position[number + 2] = self._origin[number] + turn(yaw) @ self.com[number + 2]
        self.twist = np.zeros((count, 6))
        self.clock = 0
        self.manifolds = empty(m.ngeom, 12 * m.ngeom)
        self.held = -1
        self.hand_turn = np.eye(3)

    def _put_hand(self, position, rotation) -> None:
        self.position[1] = position
        mujoco.mju_mat2Quat(self.quat[1], np.ascontiguousarray(rotation).ravel())
        self.hand_turn = rotation.copy()

    def _rotation(self, b) -> np.ndarray:
        full = np.empty(9)
        mujoco.mju_quat2Mat(full, self.quat[b])
        return full.reshape(3, 3)

    def contacts(self):
        m, d = self.model, self.data
        pose = d.qpos.reshape(-1, 7)
        d.xmat[0] = d.xmat[0]
        pose[:, 3:] = self.quat[1:]
        turned = np.empty(3)
        for b in range(1, len(self.position)):
            if self.com[b].any():
                mujoco.mju_rotVecQuat(turned, self.com[b], self.quat[b])
                pose[b - 1, :3] = self.position[b] - turned
            else:
                pose[b - 1, :3] = self.position[b]
        mujoco.mj_kinematics(m, d)
        mujoco.mj_collision(m, d)
        found = d.contact
        shapes = found.geom
        body = m.geom_bodyid.astype(np.int64)
        distance = found.dist.copy()
        distance[(body[shapes] == 1).any(1)] -= SKIN
        keep = np.flatnonzero(distance < BREAKING)
        self.clock += 1
        rotation = np.array([self._rotation(b) for b in range(m.nbody)])
        update(
            self.manifolds, self.clock, shapes[keep, 0].astype(np.int64), shapes[keep, 1].astype(np.int64), body,
            found.pos[keep], found.frame[keep, :3], distance[keep], self.position, rotation,
        )
        return points(self.manifolds, body, self.position, rotation)

    def step(self) -> None:
        dt, servo = self.timestep, self.servo
        self._put_hand(*forward(self.chain, servo.joints))
        first, second, end_1, end_2, frame, distance = self.contacts()
        jac = jacobian(self.chain, servo.joints)
        inverse = servo.dynamics()
        self.twist[1] = jac @ servo.rates
        awake = np.zeros(len(self.mass), bool)
        if self.held >= 0:
            awake[self.held] = True
        awake[1] = True
        wake(awake, first, second, self.twist, SLOW)
        awake[1] = False
        advance(self.twist, awake, GRAVITY, dt)
        keep = awake[first] | awake[second]
        yielding = np.zeros((len(self.mass), 6, 6))
        yielding[1] = jac @ inverse @ jac.T
        for b in np.flatnonzero(awake):
            r = self._rotation(b)
            yielding[b, :3, :3] = self.mass[b] * np.eye(3)
            yielding[b, 3:, 3:] = r @ self.local[b] @ r.T
        error, hold = np.zeros(6), np.zeros(3)
        if self.held >= 0:
            r = self._rotation(self.held)
            hold = self.position[self.held] + r @ (self.hold_offset - self.com[self.held])
            error[:3] = self.position[1] - hold
            rotation_vector(r, np.ascontiguousarray(self.hand_turn @ self.hold_relative), error[3:])
        resolve(
            self.position, self.twist, yielding, first[keep], second[keep],
            end_1[keep], end_2[keep], frame[keep], distance[keep], np.full(keep.sum(), FRICTION),
            self.held, hold, error, jac, inverse, servo.joints, servo.rates, servo.command,
            servo.lower, servo.upper, servo.torque * dt if servo.powered else 0.0, dt,
        )
        move(self.position, self.quat, self.twist, awake, dt)
        servo.joints = servo.joints + dt * servo.rates
        self._put_hand(*forward(self.chain, servo.joints))

    def grip(self, cell: int) -> None:
        self.held = int(self._body[cell]) + 2
        self.hold_offset = self._offset[cell]
        self.hold_relative = self.hand_turn.T @ self._rotation(self.held)

    def release(self, cell: int) -> None:
        self.held = -1

    def touched(self) -> set[int]:
        first, second, *_ = self.contacts()
        return {int(max(a, b)) - 2 for a, b in zip(first, second) if min(a, b) == 1}

    def on_table(self, cell: int) -> bool:
        first, second, *_ = self.contacts()
        return any(min(a, b) == 0 and max(a, b) == self._body[cell] + 2 for a, b in zip(first, second))

    def objects(self, cells: np.ndarray) -> set[int]:
        return set(self._body[cells].tolist())

    def centres(self) -> np.ndarray:
        bodies = self._body + 2
        where = self.position[bodies]
        turned = np.empty(3)
        for cell in self._several:
            mujoco.mju_rotVecQuat(turned, self._offset[cell] - self.com[bodies[cell]], self.quat[bodies[cell]])
            where[cell] += turned
        return where

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
        self._body = np.empty(count, np.int64)
        self._offset = np.zeros((count, 3))
        self._origin, self._yaw = np.empty((len(groups), 3)), np.empty(len(groups))
        several = []
        for number, (_, cells, relative, own) in enumerate(groups):
            self._body[cells] = number
            self._offset[cells] = relative
            self._origin[number] = (scene.position[cells] - relative @ own.T).mean(0)
            self._yaw[number] = scene.yaw[cells[0]]
            if len(cells) > 1:
                several += cells.tolist()
        self._several = several


def _compile(parts: tuple[np.ndarray, ...], shapes: tuple[Cells, ...]) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    world = spec.worldbody
    table = world.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    table.margin = BREAKING
    hand = world.add_body(name="hand", pos=_FAR, mass=1, inertia=[1] * 3, explicitinertial=True)
    hand.add_freejoint()
    for number, vertices in enumerate(parts):
        mesh = spec.add_mesh(name=f"part {number}", uservert=vertices.ravel())
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        geom = hand.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name, mass=0, contype=2, conaffinity=1
        )
        geom.margin = SKIN + BREAKING
    for number, cells in enumerate(shapes):
        body = world.add_body(name=f"object {number}")
        body.add_freejoint()
        for cell in cells:
            _box(body, cell, (HALF, HALF, HALF))
        centres = np.array(cells)
        for a, b in fillers(centres, np.zeros(len(centres), np.int64)):
            along_x = abs(centres[a] - centres[b])[0] > HALF
            half = (GAP / 2, HALF, HALF) if along_x else (HALF, GAP / 2, HALF)
            _box(body, tuple((centres[a] + centres[b]) / 2), half)
    return spec.compile()


def _box(body: mujoco.MjsBody, centre: tuple[float, ...], half: tuple[float, ...]) -> None:
    geom = body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, pos=list(centre), size=list(half), mass=MASS
    )
