"""Objects on a table, and the hand of an arm among them: the world of the published cell.

MuJoCo finds where shapes touch; :mod:`learn2assemble.robot.impulses` says what comes of it.
"""

# The compiled module has no stubs that pyright finds.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.freebodies import (
    FIRST,
    HAND,
    REST,
    accelerate,
    move,
    rotations,
    wake,
    yields,
)
from learn2assemble.robot.grasps import turn
from learn2assemble.robot.handshapes import (
    SKIN,
    Cells,
    compile_shapes,
    hand_parts,
    inverse_inertia,
)
from learn2assemble.robot.impulses import Drive, Hold, resolve
from learn2assemble.robot.manifolds import BREAKING, Manifolds, empty, points, touching, update
from learn2assemble.robot.published_arm import LOWER, TIMESTEP, UPPER, MotorArm
from learn2assemble.robot.rotations import rotation_vector
from learn2assemble.robot.scene import Scene

GRAIN = 1e-3
"""Cells of an object are multiples of this apart [m]."""
MAX_MODELS = 64


class _Shapes(NamedTuple):
    """A compiled set of objects."""

    model: mujoco.MjModel
    data: mujoco.MjData
    body: np.ndarray
    """int64[g] of each shape."""
    centre: np.ndarray
    """float64[b, 3]: centre of mass in the body's frame [m]."""
    inverse_mass: np.ndarray
    """float64[b] [1/kg]."""
    inverse_inertia: np.ndarray
    """float64[b, 3, 3]."""


class HandWorld:
    """Bodies are the world, the hand and the objects; all start asleep.

    One instance serves one thread.

    Args:
        arm: whose hand.
        motors: its joints.
        opening: between the pads [m].
    """

    def __init__(self, arm: Arm, motors: MotorArm, opening: float) -> None:
        self.motors = motors
        self._parts = hand_parts(arm, opening)
        self._known: dict[tuple[Cells, ...], _Shapes] = {}

    def place(self, scene: Scene) -> None:
        """Start over with the objects of ``scene`` at rest."""
        objects, origin, yaw = self._group(scene)
        if objects not in self._known:
            if len(self._known) >= MAX_MODELS:
                self._known.clear()
            self._known[objects] = _shapes(compile_shapes(self._parts, objects))
        self._shapes = s = self._known[objects]
        count = len(s.centre)
        self._position, self._quaternion = np.zeros((count, 3)), np.zeros((count, 4))
        self._quaternion[:, 0] = 1
        self._quaternion[FIRST:, 0], self._quaternion[FIRST:, 3] = np.cos(yaw / 2), np.sin(yaw / 2)
        self._rotation = rotations(self._quaternion)
        self._position[FIRST:] = origin
        self._position += np.einsum("bij,bj->bi", self._rotation, s.centre)
        self._twist = np.zeros((count, 6))
        self._still = np.full(count, REST)
        self._manifolds: Manifolds = empty(len(s.body), 4 * len(s.body))
        self._touching = np.empty((0, 2), np.int64)
        self._clock, self._held = 0, -1
        self._hold_offset, self._hold_turn = np.zeros(3), np.eye(3)

    def step(self) -> None:
        """One time step of arm and objects."""
        motors, s = self.motors, self._shapes
        self._follow()
        self._find_contacts()
        self._touching = touching(self._manifolds, s.body)
        awake = wake(self._still, self._touching, self._held)
        contacts = points(self._manifolds, s.body, self._position, self._rotation, awake)
        jacobian, inverse = motors.jacobian(), motors.dynamics()
        accelerate(self._twist, awake, TIMESTEP)
        self._twist[HAND] = jacobian @ motors.rates
        drive = Drive(
            jacobian, inverse, motors.joints, motors.command, LOWER, UPPER, motors.impulse
        )
        resolve(
            self._position, self._twist, motors.rates,
            yields(s.inverse_mass, s.inverse_inertia, self._rotation, awake),
            contacts, drive, self._hold(), TIMESTEP,
        )  # fmt: skip
        move(self._position, self._quaternion, self._twist, awake, self._still, TIMESTEP)
        motors.joints = motors.joints + TIMESTEP * motors.rates
        self._follow()
        self._rotation = rotations(self._quaternion)

    def grip(self, cell: int) -> None:
        """Fix the object of a cell to the hand: the cell's centre to the tool point, axes kept."""
        body = int(self._body[cell])
        self._held = body
        self._hold_offset = self._offset[cell] - self._shapes.centre[body]
        self._hold_turn = self._rotation[HAND].T @ self._rotation[body]

    def release(self) -> None:
        """Let go."""
        self._held = -1

    def hand_touches(self, cells: np.ndarray) -> bool:
        """Whether the hand touched the object of any of these cells in the last step."""
        bodies = self._body[cells]
        pairs = self._touching[(self._touching == HAND).any(1)]
        return bool(np.isin(pairs, bodies).any())

    def table_touches(self, cell: int) -> bool:
        """Whether the object of a cell touched the table in the last step."""
        pairs = self._touching[(self._touching == 0).any(1)]
        return bool((pairs == self._body[cell]).any())

    def centres(self) -> np.ndarray:
        """float64[n, 3]: of all cells [m]."""
        away = self._offset - self._shapes.centre[self._body]
        return self._position[self._body] + np.einsum(
            "nij,nj->ni", self._rotation[self._body], away
        )

    def yaws(self) -> np.ndarray:
        """float64[n]: rotation of all cells about z [rad]."""
        x, y = self._rotation[self._body, 0, 0], self._rotation[self._body, 1, 0]
        return np.arctan2(y, x)

    def _follow(self) -> None:
        """The hand is where the joints take it."""
        position, rotation = self.motors.tool()
        self._position[HAND], self._rotation[HAND] = position, rotation
        mujoco.mju_mat2Quat(self._quaternion[HAND], np.ascontiguousarray(rotation).ravel())

    def _find_contacts(self) -> None:
        model, data, body = self._shapes.model, self._shapes.data, self._shapes.body
        pose = data.qpos.reshape(-1, 7)
        away = np.einsum("bij,bj->bi", self._rotation, self._shapes.centre)
        pose[:, :3] = (self._position - away)[HAND:]
        pose[:, 3:] = self._quaternion[HAND:]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        found = data.contact
        shapes = found.geom.astype(np.int64)
        distance = found.dist - SKIN * (body[shapes] == HAND).any(1)
        near = np.flatnonzero(distance < BREAKING)
        self._clock += 1
        update(
            self._manifolds, self._clock, shapes[near], body, found.pos[near],
            found.frame[near, :3], distance[near], self._position, self._rotation,
        )  # fmt: skip

    def _hold(self) -> Hold:
        error, point = np.zeros(6), np.zeros(3)
        if self._held >= 0:
            rotation = self._rotation[self._held]
            point = self._position[self._held] + rotation @ self._hold_offset
            error[:3] = self._position[HAND] - point
            rotation_vector(rotation, self._rotation[HAND] @ self._hold_turn, error[3:])
        return Hold(self._held, point, error)

    def _group(self, scene: Scene) -> tuple[tuple[Cells, ...], np.ndarray, np.ndarray]:
        """Objects sorted by shape, so that few sets are compiled; origins and yaws."""
        groups = []
        for number in np.unique(scene.object_id):
            cells = np.flatnonzero(scene.object_id == number)
            axes = turn(float(scene.yaw[cells[0]]))
            offset = (scene.position[cells] - scene.position[cells[0]]) @ axes
            offset = GRAIN * np.rint(offset / GRAIN)
            origin = (scene.position[cells] - offset @ axes.T).mean(0)
            # Rounded again so that equal shapes are equal tuples.
            shape = tuple((float(x), float(y), float(z)) for x, y, z in offset.round(6) + 0.0)
            groups.append((shape, cells, offset, origin, scene.yaw[cells[0]]))
        groups.sort(key=lambda group: (len(group[0]), group[0]))
        count = len(scene.position)
        self._body, self._offset = np.empty(count, np.int64), np.empty((count, 3))
        for number, (_, cells, offset, _, _) in enumerate(groups):
            self._body[cells], self._offset[cells] = FIRST + number, offset
        return (
            tuple(group[0] for group in groups), np.array([group[3] for group in groups]),
            np.array([group[4] for group in groups]),
        )  # fmt: skip


def _shapes(model: mujoco.MjModel) -> _Shapes:
    inverse_mass = np.zeros(model.nbody)
    inverse_mass[FIRST:] = 1 / model.body_mass[FIRST:]
    centre = model.body_ipos.copy()
    centre[:FIRST] = 0
    return _Shapes(
        model, mujoco.MjData(model), model.geom_bodyid.astype(np.int64), centre, inverse_mass,
        inverse_inertia(model),
    )  # fmt: skip
