"""MuJoCo models of blocks on the ground: one free body per object, one box per cell and filler.

The settings (protocol 1.1 for the physical constants) let exact structures rest:

- boxes are 0.15 mm thinner per side in x and y, so that neighbours do not rub, but not in z; with
  0.25 mm an overhang of exactly one half tips faster than it did in the published logs;
- contacts begin 20 um before the surfaces meet: without it a block that stands exactly on
  another falls freely for one step, and the tremor grows with the height (V, as defined in
  :mod:`learn2assemble.physics.rigid`, of a column of 12 / 45 cubes: 1.5 / 5.8, not 0.04 / 0.08);
- solimp 0.998/0.9998: with 0.95/0.99 the same columns sink and reach V = 0.4 / 6.7;
- linear and angular damping of 10/s as published, without its quadratic part: an overhang of
  exactly one half then reaches V = 0.22 in 0.2 s, tilts by less than 1 mm and passes, as it did
  in most of the published logs;
- resting islands sleep where MuJoCo can: half the time, V within 0.002 and no other verdict.
"""

# The compiled module has no stubs that pyright finds.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.geometry.support import find_fillers
from learn2assemble.world.blocks import EDGE, FRICTION, GRAVITY, HALF, MASS

Layout = tuple[tuple[tuple[int, int, int], ...], ...]
"""Per object its cells in whole cells, relative to its first cell, in the object's frame."""

TIMESTEP = 0.004
SHRINK = 1.5e-4
"""How much thinner a box is on each side in x and y [m]."""
CONTACT_MARGIN = 1e-5
"""Margin of a geom [m]: a pair pushes at the sum of both (at the larger before MuJoCo 3.5).
MuJoCo 3.3 ignores it between boxes, so tall columns fail there."""
SOLREF = (0.01, 1.0)
SOLIMP = (0.998, 0.9998, 0.001, 0.5, 2.0)
IMPRATIO = 10.0
DAMPING = 10.0
"""Linear and angular velocity decay [1/s]."""
CELL_TOLERANCE = 1e-3
"""How far a cell may be from its place in the object's own lattice [m]."""
_CUBE = ((0, 0, 0),)


class Grouping(NamedTuple):
    """How ``n`` cells make up ``b`` bodies."""

    layout: Layout
    body: np.ndarray
    """int64[n]: body of each cell; bodies are numbered by their first cell."""
    offset: np.ndarray
    """float64[n, 3]: cell centre in its body's frame [m], whose origin is the centre of mass."""
    lead: np.ndarray
    """int64[b]: first cell of each body."""


class Parts(NamedTuple):
    """What an object is made of; lengths in metres from its centre of mass, in its own frame."""

    cells: np.ndarray
    """float64[n, 3]: centres of its cells."""
    fillers: np.ndarray
    """float64[f, 3]: centres of what fills the gaps between them."""
    sizes: np.ndarray
    """float64[f, 3]: half edges of the fillers."""


def object_parts(cells: tuple[tuple[int, int, int], ...] | np.ndarray, pitch: float) -> Parts:
    """The object with the given cells (in whole cells) at a horizontal distance of ``pitch``."""
    lattice, spacing = np.asarray(cells, float), np.array([pitch, pitch, EDGE])
    found = np.empty((2 * len(lattice), 3))
    count = find_fillers(spacing * lattice, 0, len(lattice), HALF, found)
    between = np.rint(2 * found[:count] / spacing) / 2
    # A filler lies off the lattice along the axis on which it fills a gap.
    sizes = np.full(between.shape, HALF)
    sizes[:, :2] = np.where(between[:, :2] % 1 == 0, HALF - SHRINK, (pitch - EDGE) / 2)
    centre = np.concatenate([lattice, between]).mean(0)
    return Parts(spacing * (lattice - centre), spacing * (between - centre), sizes)


def group_cells(
    position: np.ndarray, quaternion: np.ndarray, object_id: np.ndarray, pitch: float = EDGE
) -> Grouping:
    """Bodies of the given cells.

    Args:
        position: float64[n, 3] cell centres [m, world].
        quaternion: float64[n, 4] orientations (w, x, y, z), the same for all cells of an object.
        object_id: int64[n]; cells with the same number are one body.
        pitch: horizontal distance of neighbouring cells of an object [m].

    Raises:
        InputError: where the cells of an object are not on one lattice.
    """
    ids = object_id.tolist()
    count = len(ids)
    if len(set(ids)) == count:
        cells = np.arange(count)
        return Grouping((_CUBE,) * count, cells, np.zeros((count, 3)), cells)
    first: dict[int, int] = {}
    body = np.array([first.setdefault(k, len(first)) for k in ids])
    lead = np.array([ids.index(k) for k in first])
    offset = np.zeros((count, 3))
    layout, spacing = [], np.array([pitch, pitch, EDGE])
    for number, head in enumerate(lead):
        cells = np.flatnonzero(body == number)
        relative = (position[cells] - position[head]) @ rotation(quaternion[head])
        lattice = np.rint(relative / spacing)
        if np.abs(relative - spacing * lattice).max() > CELL_TOLERANCE:
            raise InputError(
                f"object {ids[head]}", position[cells].tolist(),
                f"cells on one {100 * pitch:g} cm lattice",
            )  # fmt: skip
        layout.append(tuple(tuple(int(v) for v in cell) for cell in lattice))
        offset[cells] = object_parts(lattice, pitch).cells
    return Grouping(tuple(layout), body, offset, lead)


def rotation(quaternion: np.ndarray) -> np.ndarray:
    """R_world_body, float64[3, 3], of a quaternion (w, x, y, z)."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def build_spec(layout: Layout, timestep: float = TIMESTEP, pitch: float = EDGE) -> mujoco.MjSpec:
    """An editable scene: the ground and one free body ``object<k>`` per object.

    Args:
        layout: see :data:`Layout`.
        timestep: simulation step [s].
        pitch: horizontal distance of neighbouring cells of an object [m].
    """
    spec = mujoco.MjSpec()
    option = spec.option
    option.timestep = timestep
    option.gravity = [0, 0, -GRAVITY]
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = IMPRATIO
    # A diverged world must be reported, not silently put back to its start.
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    if hasattr(mujoco.mjtEnableBit, "mjENBL_SLEEP"):
        option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    ground = spec.worldbody.add_geom(
        name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1]
    )
    _set_contact(ground)
    for number, cells in enumerate(layout):
        parts = object_parts(cells, pitch)
        cube = np.array([[HALF - SHRINK, HALF - SHRINK, HALF]])
        places = np.concatenate([parts.cells, parts.fillers])
        sizes = np.concatenate([cube.repeat(len(parts.cells), 0), parts.sizes])
        body = spec.worldbody.add_body(name=f"object{number}")
        body.add_freejoint()
        for place, size in zip(places, sizes, strict=True):
            box = body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=place, size=size, mass=MASS)
            _set_contact(box)
    return spec


def _set_contact(geom: mujoco.MjsGeom) -> None:
    geom.friction[0] = FRICTION
    geom.solref = SOLREF
    geom.solimp = SOLIMP
    geom.margin = CONTACT_MARGIN


@lru_cache(maxsize=256)
def compile_model(
    layout: Layout, timestep: float = TIMESTEP, pitch: float = EDGE
) -> mujoco.MjModel:
    """The compiled scene with damping; shared between callers, so do not change it."""
    model = build_spec(layout, timestep, pitch).compile()
    damping = model.dof_damping.reshape(-1, 6)
    damping[:, :3] = DAMPING * model.body_mass[1:, None]
    damping[:, 3:] = DAMPING * model.body_inertia[1:].mean(1, keepdims=True)
    return model
