"""Table, blocks, and the hand of an arm among them: the world of the published cell.

MuJoCo finds where shapes touch; :mod:`.contacts` says what comes of it.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import mujoco
import numpy as np

from l2a_lab.bullet.contacts import BREAKING, REST, Manifolds, empty_manifolds
from l2a_lab.bullet.resolution import FIRST, HAND
from l2a_lab.bullet.step import (
    Bodies,
    Held,
    Links,
    Motors,
    advance,
    correction,
    fill_centres,
    fill_poses,
    follow,
)
from learn2assemble.constants import HALF, MASS
from learn2assemble.errors import InputError
from learn2assemble.geometry.rotations import quaternion_matrices, yaw_matrix, yaw_quaternion
from learn2assemble.kinematics.chain import get_chain, joint_frames
from learn2assemble.robot.arm import PICTURE_GROUP, Arm, arm_model, arm_spec
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.moves import GAP, Scene, object_boxes
from learn2assemble.robot.scene import add_ground, add_object, rotation_matrix

TIMESTEP = 0.004
"""[s]."""
TORQUE = 500.0
"""Largest torque of a joint [N m]."""
ARM = "panda"
"""The one arm the published cell knows; all numbers below are its own."""
HOME = np.array([0.0, -0.215, 0.0, -2.57, 0.0, 2.356, 2.356])
"""Where every solution of a grasp starts [rad]."""
LOWER = np.array([-2.9671, -1.8326, -2.9671, -3.1416, -2.9671, -0.0873, -2.9671])
UPPER = np.array([2.9671, 1.8326, 2.9671, 0.0, 2.9671, 3.8223, 2.9671])
"""Stops that push the joints back [rad]; inverse kinematics does not know them."""
GRASP_STARTS = (
    np.array([0.4904, -0.5005, 0.1023, -2.7084, 0.0610, 2.2092, 1.3292]),
    np.array([0.5402, 0.2053, -0.0501, -2.2307, 0.0150, 2.4366, 2.8357]),
)
"""For objects behind the first side, by the attitude of the grasp (A, B) [rad]."""
PLACE_STARTS = (
    np.array([0.1030, 0.3711, 0.0257, -2.5515, -0.0449, 2.9237, 0.9485]),
    np.array([-0.1668, 0.3903, 0.2273, -2.5430, -0.3584, 2.9223, 2.7669]),
    np.array([0.2349, 0.3726, -0.0794, -2.5509, 0.1234, 2.9235, 0.8360]),
    np.array([0.0652, 0.3777, 0.0531, -2.5578, -0.0884, 2.9480, 2.5584]),
)
"""For placing objects, by both attitudes (AA, AB, BA, BB) [rad]."""
LINKS = {
    "link1": (2.7, (0.0, -0.04, -0.05), (0.02297, 0.01777, 0.01148)),
    "link2": (2.73, (0.0, -0.04, 0.06), (0.02349, 0.01161, 0.01823)),
    "link3": (2.04, (0.01, 0.01, -0.05), (0.01092, 0.01258, 0.01197)),
    "link4": (2.08, (-0.03, 0.03, 0.02), (0.01134, 0.01225, 0.01306)),
    "link5": (3.0, (0.0, 0.04, -0.12), (0.03568, 0.02985, 0.01280)),
    "link6": (1.3, (0.04, 0.0, 0.0), (0.003428, 0.005117, 0.005988)),
    "link7": (0.2, (0.0, 0.0, 0.08), (0.000362, 0.000362, 0.000592)),
    "hand": (0.81, (0.0, 0.0, 0.04), (0.003719, 0.001016, 0.003388)),
    "left_finger": (0.1, (0.0, 0.01, 0.02), (4.168e-5, 3.874e-5, 1.694e-5)),
    "right_finger": (0.1, (0.0, 0.01, 0.02), (4.168e-5, 3.874e-5, 1.694e-5)),
}
"""Mass [kg], its centre [m] and moments of inertia [kg m^2] in the frame of each body, as that
simulator has them. They matter because motors of limited torque lag where the arm moves far."""
SKIN = 1e-3
"""The hand counts as this much thicker on every side [m]: the margin of that engine's hulls."""
INERTIA = 3.0
"""The moments of inertia of a block are this many times those of a cube."""
HAND_SHAPE, THING_SHAPE = 2, 1
"""Bits of contact: the hand's own parts do not touch each other."""
GRAIN = 1e-3
"""Cells of an object are multiples of this apart [m]."""
MAX_MODELS = 64

Cells = tuple[tuple[float, float, float], ...]
"""Centres of an object's cells relative to its first one [m]."""


def turned(attitude: Attitude) -> bool:
    """Whether an attitude closes the fingers along x (B) rather than y (A)."""
    return abs(math.sin(attitude.yaw)) > 0.5


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
    parts: list[np.ndarray] = []
    for name in (arm.gripper.hand, *arm.gripper.fingers):
        corners: list[np.ndarray] = []
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
    things: dict[str, Any] = {"contype": THING_SHAPE, "conaffinity": THING_SHAPE}
    add_ground(spec, "table", None, margin=BREAKING, **things)
    hand = spec.worldbody.add_body(name="hand", mass=1, inertia=[1, 1, 1], explicitinertial=True)
    hand.add_freejoint()
    for number, corners in enumerate(parts):
        mesh = spec.add_mesh(name=f"part {number}", uservert=corners.ravel())
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        hand.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=mesh.name,
            mass=0,
            contype=HAND_SHAPE,
            conaffinity=THING_SHAPE,
            margin=SKIN + BREAKING,
        )
    for number, cells in enumerate(objects):
        boxes = object_boxes(np.array(cells), np.full(3, HALF), GAP / 2)
        add_object(spec, f"object {number}", boxes, None, **things)
    return spec.compile()


def inverse_inertia(model: mujoco.MjModel) -> np.ndarray:
    """float64[b, 3, 3]: about the centre of mass of every body, in its frame; 0 for the first."""
    out = np.zeros((model.nbody, 3, 3))
    for b in range(FIRST, model.nbody):
        axes = rotation_matrix(model.body_iquat[b])
        inertia = axes @ np.diag(model.body_inertia[b]) @ axes.T
        # What the boxes' own moments are short of.
        for geom in np.flatnonzero(model.geom_bodyid == b):
            square = model.geom_size[geom] ** 2
            inertia += (INERTIA - 1) * MASS / 3 * np.diag(square.sum() - square)
        out[b] = np.linalg.inv(inertia)
    return out


class _BodyShapes(NamedTuple):
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
    poses: np.ndarray
    """float64[b - 1, 7]: those of ``data``, to be written to."""


NOTHING = Held(-1, np.zeros(3), np.eye(3))


class BulletWorld:
    """The joints of the arm, and bodies: the world, the hand and the objects; all start asleep.

    One instance serves one thread.

    Args:
        arm: the published one.
        opening: between the pads [m].

    Raises:
        InputError: for another arm.
    """

    def __init__(self, arm: Arm, opening: float) -> None:
        if arm.name != ARM:
            raise InputError("arm of the published cell", arm.name, ARM)
        self.arm, self.chain = arm, get_chain(arm)
        self._links = _links(arm)
        self._motors = Motors(HOME.copy(), np.zeros(7), HOME.copy(), LOWER, UPPER)
        self._parts = hand_parts(arm, opening)
        self._known: dict[tuple[Cells, ...], _BodyShapes] = {}

    @property
    def joints(self) -> np.ndarray:
        """float64[7] [rad]."""
        return self._motors.joints.copy()

    def place(self, scene: Scene) -> None:
        """Start over: the objects of ``scene`` and the arm at home, at rest; motors off."""
        objects, origin, yaw = self._group(scene)
        if objects not in self._known:
            if len(self._known) >= MAX_MODELS:
                self._known.clear()
            self._known[objects] = _shapes(compile_shapes(self._parts, objects))
        self._shapes = s = self._known[objects]
        count = len(s.centre)
        position, quaternion = np.zeros((count, 3)), np.zeros((count, 4))
        quaternion[:, 0] = 1
        quaternion[FIRST:] = yaw_quaternion(yaw)
        rotation = quaternion_matrices(quaternion)
        position[FIRST:] = origin
        position += np.einsum("bij,bj->bi", rotation, s.centre)
        twist, still = np.zeros((count, 6)), np.full(count, REST)
        self._bodies = Bodies(position, quaternion, rotation, twist, still)
        self._away = self._offset - s.centre[self._body]
        self._manifolds: Manifolds = empty_manifolds(len(s.body), 4 * len(s.body))
        self._touching = np.empty((0, 2), np.int64)
        self._clock, self._held = 0, NOTHING
        self.jump(HOME)
        self._motors.command[:], self._impulse = HOME, 0.0

    def jump(self, joints: np.ndarray) -> None:
        """Put the joints somewhere [rad], at rest; the motors keep the command they had."""
        self._motors.joints[:], self._motors.rates[:] = joints, 0.0
        follow(self.chain, self._motors.joints, self._bodies)

    def drive(self, command: np.ndarray) -> None:
        """Where the motors want the joints from now on [rad]; before, they give way."""
        self._motors.command[:], self._impulse = command, TORQUE * TIMESTEP

    def correct(self, left: np.ndarray, total: np.ndarray) -> None:
        """Add what moves the hand by ``left``, float64[3] [m], to ``total``, float64[7] [rad]; see
        :func:`~l2a_lab.bullet.step.correction`."""
        base = np.asarray(self.arm.base_position, float)
        correction(self.chain, self._motors.joints, base, left, total)

    def step(self) -> None:
        """One time step of arm and objects."""
        s = self._shapes
        data = s.data
        fill_poses(self._bodies, s.centre, s.poses)
        mujoco.mj_kinematics(s.model, data)
        mujoco.mj_collision(s.model, data)
        found = data.contact
        self._clock += 1
        self._touching = advance(
            self.chain,
            self._links,
            self._motors,
            self._impulse,
            self._bodies,
            self._held,
            s.inverse_mass,
            s.inverse_inertia,
            self._manifolds,
            s.body,
            self._clock,
            (found.geom, found.dist, found.pos, found.frame),
            SKIN,
            TIMESTEP,
        )

    def grip(self, cell: int) -> None:
        """Fix the object of a cell to the hand: the cell's centre to the tool point, axes kept."""
        body, rotation = int(self._body[cell]), self._bodies.rotation
        self._held = Held(body, self._away[cell], rotation[HAND].T @ rotation[body])

    def release(self) -> None:
        """Let go."""
        self._held = NOTHING

    def touches(self, body: int, cells: np.ndarray) -> bool:
        """Whether hand or table touched the object of any of these cells in the last step."""
        pairs = self._touching[(self._touching == body).any(1)]
        return bool(np.isin(pairs, self._body[cells]).any())

    def centres(self) -> np.ndarray:
        """float64[n, 3]: of all cells [m]."""
        out = np.empty((len(self._body), 3))
        fill_centres(self._bodies, self._body, self._away, out)
        return out

    def yaws(self) -> np.ndarray:
        """float64[n]: rotation of all cells about z [rad]."""
        rotation = self._bodies.rotation[self._body]
        x, y = rotation[:, 0, 0], rotation[:, 1, 0]
        return np.arctan2(y, x)

    def _group(self, scene: Scene) -> tuple[tuple[Cells, ...], np.ndarray, np.ndarray]:
        """Objects sorted by shape, so that few sets are compiled; origins and yaws."""
        groups: list[tuple[Cells, np.ndarray, np.ndarray, np.ndarray, float]] = []
        for number in np.unique(scene.object_id):
            cells = np.flatnonzero(scene.object_id == number)
            axes = yaw_matrix(float(scene.yaw[cells[0]]))
            offset = (scene.position[cells] - scene.position[cells[0]]) @ axes
            offset = GRAIN * np.rint(offset / GRAIN)
            origin = (scene.position[cells] - offset @ axes.T).mean(0)
            # Rounded again so that equal shapes are equal tuples.
            shape = tuple((float(x), float(y), float(z)) for x, y, z in offset.round(6) + 0.0)
            groups.append((shape, cells, offset, origin, float(scene.yaw[cells[0]])))
        groups.sort(key=lambda group: (len(group[0]), group[0]))
        count = len(scene.position)
        self._body, self._offset = np.empty(count, np.int64), np.empty((count, 3))
        for number, (_, cells, offset, _, _) in enumerate(groups):
            self._body[cells], self._offset[cells] = FIRST + number, offset
        return (
            tuple(group[0] for group in groups),
            np.array([group[3] for group in groups]),
            np.array([group[4] for group in groups]),
        )


def _links(arm: Arm) -> Links:
    """What the published simulator has between the joints; hand and fingers, as they are at the
    zero of their joints, go with the last one."""
    model = arm_spec(arm).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    joints = np.array([float(data.qpos[model.joint(name).qposadr[0]]) for name in arm.joints])
    n = len(joints)
    positions, rotations = np.empty((n, 3)), np.empty((n, 3, 3))
    joint_frames(get_chain(arm), joints, positions, rotations)
    mass, centre, inertia = np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3, 3))
    parts: list[list[tuple[float, np.ndarray, np.ndarray]]] = [[] for _ in range(n)]
    for number, (name, (own, middle, moments)) in enumerate(LINKS.items()):
        body, joint = model.body(name).id, min(number, n - 1)
        axes = data.xmat[body].reshape(3, 3)
        at = data.xpos[body] + axes @ np.array(middle)
        turn = rotations[joint].T @ axes
        away = rotations[joint].T @ (at - positions[joint])
        parts[joint].append((own, away, turn @ np.diag(moments) @ turn.T))
    for joint, bodies in enumerate(parts):
        mass[joint] = sum(own for own, _, _ in bodies)
        centre[joint] = sum(own * away for own, away, _ in bodies) / mass[joint]
        for own, away, moments in bodies:
            arm_ = away - centre[joint]
            inertia[joint] += moments + own * (arm_ @ arm_ * np.eye(3) - np.outer(arm_, arm_))
    return Links(mass, centre, inertia)


def _shapes(model: mujoco.MjModel) -> _BodyShapes:
    inverse_mass = np.zeros(model.nbody)
    inverse_mass[FIRST:] = 1 / model.body_mass[FIRST:]
    centre = model.body_ipos.copy()
    centre[:FIRST] = 0
    data = mujoco.MjData(model)
    return _BodyShapes(
        model,
        data,
        model.geom_bodyid.astype(np.int64),
        centre,
        inverse_mass,
        inverse_inertia(model),
        data.qpos.reshape(-1, 7),
    )
