"""What the MuJoCo scenes of blocks have in common: options, boxes, contact, and MuJoCo's warnings.

Sizes, masses and time steps are the caller's: every scene makes its blocks a little smaller, by an
amount that suits what it is for.

MuJoCo's warnings go to the logger ``learn2assemble.mujoco``, not to a file in the working folder.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import Any, NamedTuple

import mujoco
import numpy as np

from learn2assemble.constants import FRICTION, GRAVITY, MASS

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
    """A free body made of boxes, each as heavy as a block unless it has a mass of its own.

    Args:
        spec: the scene.
        name: of the body.
        boxes: centre and half extents of each, float[3] in the body's frame [m], and perhaps its
            mass [kg].
        surface: contact parameters, or None for MuJoCo's own.
        geom: further fields of the geoms.
    """
    body = spec.worldbody.add_body(name=name)
    body.add_freejoint()
    for centre, half, *own in boxes:
        mass = own[0] if own else MASS
        box = body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, pos=centre, size=half, mass=mass, **geom
        )
        set_contact(box, surface)


def resize_boxes(model: mujoco.MjModel, geoms: np.ndarray, half: np.ndarray) -> None:
    """Change boxes of a compiled model that are the only geoms of bodies without joints.

    Args:
        model: the scene.
        geoms: int[k], boxes at the origin of their bodies.
        half: float64[k, 3], their new half extents [m].
    """
    # The trees of bounding boxes are not made anew; with old ones collisions are missed.
    model.bvh_aabb[model.body_bvhadr[model.geom_bodyid[geoms]], 3:] = half
    model.geom_size[geoms] = half
    model.geom_aabb[geoms, 3:] = half
    model.geom_rbound[geoms] = np.linalg.norm(half, axis=1)


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
