"""Scenes on the lattice of the robot cell, for tests of its fidelities."""

from __future__ import annotations

import mujoco
import numpy as np

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.bodies import Part, Shape
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.holding import attitudes
from learn2assemble.robot.kinematic import BlockChecker, Collision
from learn2assemble.robot.moves import Scene

PITCH, GROUND = 0.06, 0.025


def scene(placed: list[tuple], waiting: list[tuple], objects: list[int] | None = None) -> Scene:
    """Cells (x, y, z) [pitches; levels above the ground]."""
    cells = np.array([*placed, *waiting], float)
    position = cells * [PITCH, PITCH, 0.05] + [0.0, 0.0, GROUND]
    ids = np.arange(len(cells)) if objects is None else np.array(objects)
    return Scene(position, np.zeros(len(cells)), ids, len(placed))


def cell(x: float, y: float, z: float) -> np.ndarray:
    """Centre of a cell [m]."""
    return np.array([x * PITCH, y * PITCH, z * 0.05 + GROUND])


def box(half: np.ndarray) -> Shape:
    """A box with these half extents as the shape of a block."""
    x, y, z = half.tolist()
    return (Part((0.0, 0.0, 0.0), (x, y, z)),)


def hands(arm: Arm, half: np.ndarray, side: bool = False) -> list[Attitude]:
    """How the tool of an arm meets a box that stands upright: from above, or with a cup at its
    side."""
    found = attitudes(arm, box(half))
    return [hand for hand in found if hand.sideways == side and not hand.tilt]


def check_hit(model: BlockChecker, hit: Collision | None, near: float) -> None:
    """That a checker reports a collision where every pair of geoms by itself has one.

    Args:
        hit: what the checker reported for the joints that its data has.
        near: distances smaller than this decide nothing [m].
    """
    m, d = model.model, model.data
    mujoco.mj_kinematics(m, d)
    body = [m.body(b).name for b in m.geom_bodyid]
    things = [g for g in range(m.ngeom) if body[g].startswith(("table", "block"))]
    held = [g for g in range(m.ngeom) if body[g] == "carried 0"]
    links = [
        g
        for g in range(m.ngeom)
        if (m.geom_contype[g] and g not in things)
        and not body[g].startswith(("carried", "meshes", "link0"))
    ]
    nearest = min(
        mujoco.mj_geomDistance(m, d, a, b, 0.05, None) for a in (*links, *held) for b in things
    )
    if abs(nearest) < near:
        return
    if nearest < 0:
        assert hit is not None
    elif hit is not None:
        assert not hit.other.startswith(("table", "block"))
