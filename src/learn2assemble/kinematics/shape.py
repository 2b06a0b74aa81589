"""How an arm looks: its parts as coloured meshes on the frames of its chain.

Frames are numbered: -1 is the world (what is bolted down), 0 to n - 1 the joint frames of
:class:`~.chain.Chain`, then one for every finger.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

from learn2assemble.kinematics.chain import Chain, forward, get_chain, joint_frames
from learn2assemble.robot.arm import COLLISION_GROUP, PICTURE_GROUP, Arm, arm_model

_CREASE = np.cos(np.radians(60.0))
"""Faces that meet at a larger angle do not share a normal."""
_SAME = 1e-6
"""Corners nearer than this are one [m]."""
_AROUND = 24
"""Sides of what is round."""


class Mesh(NamedTuple):
    """Triangles with a normal at every vertex; counter-clockwise as seen from outside."""

    vertices: np.ndarray
    """float64[v, 3] [m]."""
    normals: np.ndarray
    """float64[v, 3], unit."""
    faces: np.ndarray
    """int32[f, 3], indices of vertices."""


def shaded(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """A mesh with normals: means over the faces round a vertex that meet smoothly.

    Args:
        vertices: float64[v, 3] [m]; equal ones are merged first.
        faces: int[f, 3].
    """
    _, first, same = np.unique(
        np.round(vertices / _SAME).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    points, faces = vertices[first], same.reshape(-1)[faces]
    a, b, c = (points[faces[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)
    size = np.linalg.norm(area, axis=1)
    kept = size > 1e-14
    faces, area, size = faces[kept], area[kept], size[kept]
    unit = area / size[:, None]
    corner = faces.ravel()
    face = np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(corner, kind="stable")
    corner, face = corner[order], face[order]
    total = np.zeros((len(corner), 3))
    # Corners at one vertex lie side by side: compare each with those 0, 1, 2, ... places on.
    for shift in range(int(np.bincount(corner).max(initial=0))):
        i = np.arange(len(corner) - shift)
        i = i[corner[i] == corner[i + shift]]
        j = i + shift
        near = (unit[face[i]] * unit[face[j]]).sum(1) > _CREASE
        i, j = i[near], j[near]
        total[i] += area[face[j]]
        if shift:
            total[j] += area[face[i]]
    total /= np.linalg.norm(total, axis=1)[:, None]
    key = np.column_stack([corner, (total * 1000).round().astype(np.int64)])
    _, first, which = np.unique(key, axis=0, return_index=True, return_inverse=True)
    found = np.empty(len(corner), np.int32)
    found[order] = which.reshape(-1)
    return Mesh(points[corner[first]], total[first], found.reshape(-1, 3))


def box(half: np.ndarray) -> Mesh:
    """A box with these half extents, float64[3] [m], about the origin."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    faces = [
        (0, 1, 3),
        (0, 3, 2),
        (4, 6, 7),
        (4, 7, 5),
        (0, 4, 5),
        (0, 5, 1),
        (2, 3, 7),
        (2, 7, 6),
        (0, 2, 6),
        (0, 6, 4),
        (1, 5, 7),
        (1, 7, 3),
    ]
    return shaded(signs * half, np.array(faces))


def capsule(radius: float, half: float, rounded: bool = True) -> Mesh:
    """A capsule along z, or a cylinder where it is not ``rounded``; half length [m] without the
    round ends. A sphere is a capsule of half length 0."""
    from trimesh import creation

    if rounded:
        made = creation.capsule(  # pyright: ignore[reportUnknownMemberType]
            2 * half, radius, count=[_AROUND, _AROUND]
        )
    else:
        made = creation.cylinder(  # pyright: ignore[reportUnknownMemberType]
            radius, 2 * half, sections=_AROUND
        )
    return shaded(made.vertices, made.faces)


WORLD = -1


class LinkPart(NamedTuple):
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


class ArmShape(NamedTuple):
    """Everything that is needed to draw an arm."""

    name: str
    chain: Chain
    fingers: tuple[Finger, ...]
    parts: tuple[LinkPart, ...]

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
def arm_shape(arm: Arm) -> ArmShape:
    """The parts of an arm: its picture meshes, or its collision solids where it has none."""
    model = arm_model(arm, pictures=True)
    data = mujoco.MjData(model)
    data.qpos[:] = 0
    mujoco.mj_kinematics(model, data)
    shape = ArmShape(arm.name, get_chain(arm), (), ())
    position, rotation = shape.frames(np.zeros(len(arm.joints)), 0.0)
    frame_of = {model.joint(name).bodyid[0]: k for k, name in enumerate(arm.joints)}
    fingers = list[Finger]()
    for name in arm.gripper.fingers:
        body = model.body(name).id
        frame_of[body] = len(arm.joints) + len(fingers)
        fingers.append(_finger(arm, model, data, body, position[-1], rotation[-1]))
    shape = shape._replace(fingers=tuple(fingers))
    position, rotation = shape.frames(np.zeros(len(arm.joints)), 0.0)
    parts = list[LinkPart]()
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
        parts.append(LinkPart(model.geom(geom).name, frame, _colour(model, geom), placed))
    return shape._replace(parts=tuple(parts))


def _finger(
    arm: Arm,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    body: int,
    position: np.ndarray,
    rotation: np.ndarray,
) -> Finger:
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
    red, green, blue = rgba[:3].round(3).tolist()
    return red, green, blue
