"""Collision shapes of the published cell as MuJoCo models: table, hand, objects."""

# The compiled module has no stubs that pyright finds.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from functools import lru_cache

import mujoco
import numpy as np

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.freebodies import FIRST
from learn2assemble.robot.manifolds import BREAKING
from learn2assemble.robot.model import PICTURE_GROUP, arm_model
from learn2assemble.robot.scene import GAP, fillers
from learn2assemble.world.blocks import HALF, MASS

SKIN = 1e-3
"""The hand counts as this much thicker on every side [m]: the margin of that engine's hulls."""
INERTIA = 3.0
"""The moments of inertia of a block are this many times those of a cube (protocol 1.1)."""
HAND_SHAPE, THING_SHAPE = 2, 1
"""Bits of contact: the hand's own parts do not touch each other."""

Cells = tuple[tuple[float, float, float], ...]
"""Centres of an object's cells relative to its first one [m]."""


@lru_cache(maxsize=16)
def hand_parts(arm: Arm, opening: float) -> tuple[np.ndarray, ...]:
    """Corners of hand and fingers, float64[k, 3] each, in the tool frame [m].

    Their hulls collide; the pictures of the arm are nearer to the published meshes than the
    boxes of its MJCF.

    Args:
        arm: whose gripper.
        opening: between the pads [m], the fingers' range notwithstanding.
    """
    model = arm_model(arm, pictures=True)
    data = mujoco.MjData(model)
    for name in arm.gripper.joints:
        data.qpos[model.joint(name).qposadr[0]] = opening / len(arm.gripper.joints)
    mujoco.mj_kinematics(model, data)
    site = model.site(arm.tool).id
    origin, axes = data.site_xpos[site], data.site_xmat[site].reshape(3, 3)
    parts = []
    for name in (arm.gripper.hand, *arm.gripper.fingers):
        corners = []
        for geom in np.flatnonzero(model.geom_bodyid == model.body(name).id):
            if model.geom_group[geom] == PICTURE_GROUP:
                mesh = model.geom_dataid[geom]
                first = model.mesh_vertadr[mesh]
                own = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
                world = data.geom_xpos[geom] + own @ data.geom_xmat[geom].reshape(3, 3).T
                corners.append((world - origin) @ axes)
        parts.append(np.concatenate(corners))
    return tuple(parts)


def compile_shapes(parts: tuple[np.ndarray, ...], objects: tuple[Cells, ...]) -> mujoco.MjModel:
    """Bodies: the world with its table, the hand (frame: the tool), then every object.

    The ground is found from a short distance on, as is the hand; objects find each other where
    they overlap.
    """
    spec = mujoco.MjSpec()
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    world = spec.worldbody
    world.add_geom(
        name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], margin=BREAKING,
        contype=THING_SHAPE, conaffinity=THING_SHAPE,
    )  # fmt: skip
    hand = world.add_body(name="hand", mass=1, inertia=[1, 1, 1], explicitinertial=True)
    hand.add_freejoint()
    for number, corners in enumerate(parts):
        mesh = spec.add_mesh(name=f"part {number}", uservert=corners.ravel())
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        hand.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name, mass=0,
            contype=HAND_SHAPE, conaffinity=THING_SHAPE, margin=SKIN + BREAKING,
        )  # fmt: skip
    for number, cells in enumerate(objects):
        body = world.add_body(name=f"object {number}")
        body.add_freejoint()
        centres = np.array(cells)
        boxes = [(centre, np.full(3, HALF)) for centre in centres]
        for a, b in fillers(centres, np.zeros(len(centres), np.int64)):
            half = np.full(3, HALF)
            half[np.argmax(abs(centres[a] - centres[b]))] = GAP / 2
            boxes.append(((centres[a] + centres[b]) / 2, half))
        for centre, half in boxes:
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX, pos=centre, size=half, mass=MASS,
                contype=THING_SHAPE, conaffinity=THING_SHAPE,
            )  # fmt: skip
    return spec.compile()


def inverse_inertia(model: mujoco.MjModel) -> np.ndarray:
    """float64[b, 3, 3]: about the centre of mass of every body, in its frame; 0 for the first."""
    out = np.zeros((model.nbody, 3, 3))
    for b in range(FIRST, model.nbody):
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, model.body_iquat[b])
        axes = turn.reshape(3, 3)
        inertia = axes @ np.diag(model.body_inertia[b]) @ axes.T
        # What the boxes' own moments are short of.
        for geom in np.flatnonzero(model.geom_bodyid == b):
            square = model.geom_size[geom] ** 2
            inertia += (INERTIA - 1) * MASS / 3 * np.diag(square.sum() - square)
        out[b] = np.linalg.inv(inertia)
    return out
