"""What the MuJoCo scenes of blocks have in common: options, boxes, contact, and MuJoCo's warnings.

Sizes, masses and time steps are the caller's: every scene makes its blocks a little smaller, by an
amount that suits what it is for.

MuJoCo's warnings go to the logger ``learn2assemble.mujoco``, not to a file in the working folder.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from learn2assemble.constants import FRICTION, GRAVITY, MASS
from learn2assemble.geometry.hulls import Hull
from learn2assemble.geometry.rotations import matrix_quaternion, rotation_of

mujoco.set_mju_user_warning(logging.getLogger("learn2assemble.mujoco").warning)


class ContactSurface(NamedTuple):
    """Contact parameters of a geom, as MuJoCo means them.

    solimp 0.998/0.9998 lets tall structures rest: with 0.95/0.99 columns of 12 / 45 cubes sink.
    """

    friction: float = FRICTION
    margin: float = 0.0
    """Distance at which contacts begin [m]."""
    solref: tuple[float, float] = (0.01, 1.0)
    solimp: tuple[float, float, float, float, float] = (0.998, 0.9998, 0.001, 0.5, 2.0)


def set_options(
    spec: mujoco.MjSpec,
    timestep: float,
    integrator: mujoco.mjtIntegrator,
    gravity: float = GRAVITY,
) -> None:
    """Options of a simulated scene with such a step [s]: gravity, elliptic cones, sleeping."""
    option = spec.option
    option.timestep = timestep
    option.gravity = [0, 0, -gravity]
    option.integrator = integrator
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10.0
    # A diverged simulation must be reported, not silently put back to its start.
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    if hasattr(mujoco.mjtEnableBit, "mjENBL_SLEEP"):
        option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)


def add_ground(spec: mujoco.MjSpec, name: str, surface: ContactSurface | None, **geom: Any) -> None:
    """A plane at z = 0; ``geom`` are further fields of the geom."""
    plane = spec.worldbody.add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], **geom
    )
    set_contact(plane, surface)


def add_object(
    spec: mujoco.MjSpec,
    name: str,
    boxes: Iterable[tuple[Any, ...]],
    surface: ContactSurface | None,
    **geom: Any,
) -> None:
    """A free body made of boxes or hulls, each as heavy as a block unless it has a mass of its own.

    Args:
        spec: the scene.
        name: of the body.
        boxes: centre and half extents of each, float[3] in the body's frame [m], and perhaps its
            mass [kg] and the hull that it is instead of a box.
        surface: contact parameters, or None for MuJoCo's own.
        geom: further fields of the geoms.
    """
    body = spec.worldbody.add_body(name=name)
    body.add_freejoint()
    for centre, half, *own in boxes:
        mass = own[0] if own else MASS
        if len(own) > 1:
            solid = body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=mesh_of(spec, own[1]),
                pos=centre,
                mass=mass,
                **geom,
            )
        else:
            solid = body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX, pos=centre, size=half, mass=mass, **geom
            )
        set_contact(solid, surface)


def mesh_of(spec: mujoco.MjSpec, hull: Hull) -> str:
    """The name of the mesh of a hull in a scene; added where it is not there yet."""
    name = f"hull {hash(hull) & 0xFFFFFFFFFFFF:x}"
    if all(mesh.name != name for mesh in spec.meshes):
        spec.add_mesh(name=name, uservert=hull.points.ravel())
    return name


def keep_meshes(spec: mujoco.MjSpec, hulls: Iterable[Hull], place: Sequence[float]) -> None:
    """Meshes that no body of a scene has yet, for :func:`reshape`; they hang at a far place."""
    hulls = list(hulls)
    if not hulls:
        return
    body = spec.worldbody.add_body(name="meshes", pos=list(place))
    for hull in hulls:
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            name=f"shape of {mesh_of(spec, hull)}",
            meshname=mesh_of(spec, hull),
            mass=0.01,
            contype=1 << 30,
            conaffinity=0,
        )


def reshape(
    model: mujoco.MjModel,
    geoms: np.ndarray,
    half: np.ndarray,
    hulls: Sequence[Hull | None] | None = None,
    rounded: np.ndarray | None = None,
) -> None:
    """Change solids of a compiled model that are the only geoms of bodies without joints.

    Args:
        model: the scene.
        geoms: int[k], at the origin of their bodies.
        half: float64[k, 3], new half extents of those that are boxes [m].
        hulls: what the others are, which :func:`keep_meshes` has been told of.
        rounded: bool[k], those that are capsules along z, as long and wide as these boxes.
    """
    bodies = model.geom_bodyid[geoms]
    # No frame is taken to be another one any more.
    model.geom_sameframe[geoms], model.body_sameframe[bodies] = 0, 0
    model.geom_type[geoms], model.geom_dataid[geoms] = mujoco.mjtGeom.mjGEOM_BOX, -1
    model.geom_pos[geoms], model.geom_quat[geoms] = 0.0, (1.0, 0.0, 0.0, 0.0)
    model.geom_size[geoms] = half
    model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:] = 0.0, half
    model.geom_rbound[geoms] = np.linalg.norm(half, axis=1)
    if rounded is not None and rounded.any():
        wide, length = half[rounded, 0], half[rounded, 2]
        model.geom_type[geoms[rounded]] = mujoco.mjtGeom.mjGEOM_CAPSULE
        sizes = np.stack([wide, length - wide, np.zeros_like(wide)], 1)
        model.geom_size[geoms[rounded]], model.geom_rbound[geoms[rounded]] = sizes, length
    for geom, hull in zip(geoms.tolist(), hulls or (), strict=False):
        if hull is not None:
            like = model.geom(f"shape of hull {hash(hull) & 0xFFFFFFFFFFFF:x}").id
            for values in _OF_A_SHAPE:
                getattr(model, values)[geom] = getattr(model, values)[like]
    # The trees of bounding boxes, which are in the frames of the centres of mass, are not made
    # anew; with old ones collisions are missed.
    model.body_ipos[bodies], model.body_iquat[bodies] = (
        model.geom_pos[geoms],
        model.geom_quat[geoms],
    )
    model.bvh_aabb[model.body_bvhadr[bodies]] = model.geom_aabb[geoms]


_OF_A_SHAPE = (
    "geom_type",
    "geom_dataid",
    "geom_pos",
    "geom_quat",
    "geom_size",
    "geom_aabb",
    "geom_rbound",
)


def table_pose(table: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Position float64[3] [m] and quaternion float64[4] of a table.

    Args:
        table: see :attr:`~learn2assemble.robot.moves.Scene.table`.
    """
    height, about_x, about_y = table
    turn = matrix_quaternion(rotation_of(np.array([about_x, about_y, 0.0])))
    return np.array([0.0, 0.0, height]), np.array(turn)


def set_contact(geom: mujoco.MjsGeom, surface: ContactSurface | None) -> None:
    """Give a geom these contact parameters; None leaves MuJoCo's own."""
    if surface is not None:
        geom.friction[0] = surface.friction
        geom.solref, geom.solimp, geom.margin = surface.solref, surface.solimp, surface.margin


def rotation_matrix(quaternion: np.ndarray) -> np.ndarray:
    """float64[3, 3] of a quaternion (w, x, y, z), to the last bit as MuJoCo computes it."""
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, np.ascontiguousarray(quaternion, float))
    return flat.reshape(3, 3)
