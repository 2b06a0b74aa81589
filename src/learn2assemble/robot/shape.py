"""How an arm looks: its parts as coloured meshes on the frames of its chain.

Frames are numbered: -1 is the world (what is bolted down), 0 to n - 1 the joint frames of
:class:`~.kinematics.Chain`, then one for every finger.
"""

# The compiled module has no stubs that pyright finds.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.kinematics import Chain, forward, get_chain, joint_frames
from learn2assemble.robot.meshes import Mesh, box, capsule, shaded
from learn2assemble.robot.model import COLLISION_GROUP, PICTURE_GROUP, arm_model

WORLD = -1


class Part(NamedTuple):
    """A mesh in one colour that moves with one frame."""

    name: str
    frame: int
    colour: tuple[float, float, float]
    """Red, green, blue from 0 to 1."""
    mesh: Mesh
    """In its frame."""


class Finger(NamedTuple):
    """A finger in the last joint frame."""

    offset: np.ndarray
    """float64[3]: at opening 0 [m]."""
    turn: np.ndarray
    """float64[3, 3]."""
    travel: np.ndarray
    """float64[3]: displacement per metre of opening."""


class Shape(NamedTuple):
    """Everything that is needed to draw an arm."""

    name: str
    chain: Chain
    fingers: tuple[Finger, ...]
    parts: tuple[Part, ...]

    def frames(self, joints: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
        """Poses in the world of the joint frames, then of the fingers.

        Args:
            joints: float64[n] [rad].
            width: opening between the pads [m].

        Returns:
            float64[n + fingers, 3] [m] and float64[n + fingers, 3, 3].
        """
        n = len(joints)
        position, rotation = np.empty((n, 3)), np.empty((n, 3, 3))
        joint_frames(self.chain, joints, position, rotation)
        hand, turned = position[-1], rotation[-1]
        moved = [hand + turned @ (f.offset + width * f.travel) for f in self.fingers]
        turns = [turned @ f.turn for f in self.fingers]
        return np.array([*position, *moved]), np.array([*rotation, *turns])

    def tool(self, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The tool in the world: float64[3] [m] and float64[3, 3]."""
        return forward(self.chain, joints)


@lru_cache(maxsize=8)
def arm_shape(arm: Arm) -> Shape:
    """The parts of an arm: its picture meshes, or its collision solids where it has none."""
    model = arm_model(arm, pictures=True)
    data = mujoco.MjData(model)
    data.qpos[:] = 0
    mujoco.mj_kinematics(model, data)
    shape = Shape(arm.name, get_chain(arm), (), ())
    position, rotation = shape.frames(np.zeros(len(arm.joints)), 0.0)
    frame_of = {model.joint(name).bodyid[0]: k for k, name in enumerate(arm.joints)}
    fingers = []
    for name in arm.gripper.fingers:
        body = model.body(name).id
        frame_of[body] = len(arm.joints) + len(fingers)
        fingers.append(_finger(arm, model, data, body, position[-1], rotation[-1]))
    shape = shape._replace(fingers=tuple(fingers))
    position, rotation = shape.frames(np.zeros(len(arm.joints)), 0.0)
    parts = []
    for geom in _drawn(model):
        body = int(model.geom_bodyid[geom])
        while body and body not in frame_of:
            body = int(model.body_parentid[body])
        frame = frame_of.get(body, WORLD)
        mesh = _mesh(model, geom)
        turn, offset = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
        if frame != WORLD:
            turn, offset = rotation[frame].T @ turn, rotation[frame].T @ (offset - position[frame])
        placed = Mesh(mesh.vertices @ turn.T + offset, mesh.normals @ turn.T, mesh.faces)
        parts.append(Part(model.geom(geom).name, frame, _colour(model, geom), placed))
    return shape._replace(parts=tuple(parts))


def _finger(
    arm: Arm, model: mujoco.MjModel, data: mujoco.MjData, body: int, position: np.ndarray,
    rotation: np.ndarray,
) -> Finger:  # fmt: skip
    joint = int(model.body_jntadr[body])
    share = 1 / len(arm.gripper.fingers)
    return Finger(
        rotation.T @ (data.xpos[body] - position),
        rotation.T @ data.xmat[body].reshape(3, 3),
        share * (rotation.T @ data.xaxis[joint]),
    )


def _drawn(model: mujoco.MjModel) -> list[int]:
    for group in (PICTURE_GROUP, COLLISION_GROUP):
        found = np.flatnonzero(model.geom_group == group).tolist()
        if found:
            return found
    return list(range(model.ngeom))


def _mesh(model: mujoco.MjModel, geom: int) -> Mesh:
    """A geom in its own frame."""
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        first, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
        vertices = model.mesh_vert[start : start + count].astype(float)
        return shaded(vertices, model.mesh_face[first : first + faces])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return capsule(size[0], size[1])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return capsule(size[0], size[1], rounded=False)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return capsule(size[0], 0.0)
    return box(size)


def _colour(model: mujoco.MjModel, geom: int) -> tuple[float, float, float]:
    material = int(model.geom_matid[geom])
    rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    red, green, blue = np.round(rgba[:3], 3).tolist()
    return red, green, blue
