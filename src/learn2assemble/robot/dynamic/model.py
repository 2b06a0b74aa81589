"""MuJoCo models of the cell: the arm, a table, and one free body per object of a scene.

Settings that hold a block by friction alone and let structures rest:

- boxes are 0.25 mm thinner per side in x and y, so that neighbours do not rub, but not in z;
- impratio 10: more does not reduce the creep of a block in the hand, whose cause is that MuJoCo
  neglects the change of the contact Jacobian (what is held drifts outwards on every turn, by
  0.2-0.6 mm with the stiff pads of our arms and by 1-3 mm with soft ones), and with 100 the solver
  fails where the hand jams several blocks;
- resting islands of blocks sleep, so a step costs what moves, not what is there.

A move in a scene as the simulation sees it: rigid objects with poses, one to be moved.

The state of a simulated cell, in the words of the task.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.geometry.rotations import cube_yaw, rotate_vectors, yaw_quaternion
from learn2assemble.physics.scene import (
    Surface,
    add_ground,
    add_object,
    rotation_matrix,
    set_options,
)
from learn2assemble.robot.arm import Arm, arm_spec
from learn2assemble.robot.moves import Attitude, Move, Scene, object_boxes, put_down
from learn2assemble.world.blocks import HALF

TIMESTEP = 0.002
"""[s]; with 4 ms the grasp fails."""
SHRINK = 2.5e-4
"""How much thinner a box is on each side in x and y [m]."""
GRAIN = 1e-3
"""Places of cells in their object are multiples of this [m]."""
PLAN_MARGIN = 0.005
"""The arm keeps this distance from everything on planned ways [m]."""
LOOK = 0.02
"""Distances up to this are measured when ways are planned [m]."""
TABLE, ARM, PAD = -1, -2, -3
"""Kinds of geoms in :attr:`World.kind` that belong to no object."""

_ARM_BIT, _THING_BIT, _HELD_BIT = 1, 2, 4

Box = tuple[tuple[float, ...], tuple[float, ...]]
"""Centre and half extents in the object's frame [m]."""


class Objects(NamedTuple):
    """How the ``n`` cells of a scene make up ``b`` rigid objects; an object's frame is that of
    its first cell in the scene."""

    shape: tuple[tuple[Box, ...], ...]
    """Per object its boxes: cells, then fillers."""
    owner: np.ndarray
    """int64[n]: object of each cell; objects are numbered by their first cell."""
    offset: np.ndarray
    """float64[n, 3]: cell centre in the object's frame [m]."""
    lead: np.ndarray
    """int64[b]: first cell of each object."""

    def cells(self, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Centres float64[n, 3] [m], quaternions float64[n, 4] and yaws float64[n] [rad] of the
        cells of objects at ``poses`` float64[b, 7]."""
        pose = poses[self.owner]
        yaw = np.array([cube_yaw(rotation_matrix(turn)) for turn in pose[:, 3:]])
        return pose[:, :3] + rotate_vectors(pose[:, 3:], self.offset), pose[:, 3:].copy(), yaw


def group(scene: Scene, quaternion: np.ndarray) -> Objects:
    """Objects of a scene whose cells have orientations ``quaternion`` float64[n, 4]."""
    _, lead, owner = np.unique(scene.object_id, return_index=True, return_inverse=True)
    order = np.argsort(lead)
    lead, owner = lead[order], np.argsort(order)[owner]
    offset = np.zeros_like(scene.position)
    shape = []
    for number, first in enumerate(lead):
        cells = np.flatnonzero(owner == number)
        relative = (scene.position[cells] - scene.position[first]) @ rotation_matrix(
            quaternion[first]
        )
        offset[cells] = GRAIN * np.rint(relative / GRAIN)
        half = np.array([HALF - SHRINK, HALF - SHRINK, HALF])
        boxes = object_boxes(offset[cells], half)
        shape.append(
            tuple((tuple(centre.tolist()), tuple(size.tolist())) for centre, size in boxes)
        )
    return Objects(tuple(shape), owner, offset, lead)


class World(NamedTuple):
    """A compiled cell and where things are in it."""

    spec: mujoco.MjSpec
    model: mujoco.MjModel
    plan: mujoco.MjModel
    """The same to plan ways with: a margin around the arm, and objects do not meet each other."""
    joint: np.ndarray
    """int64[n]: addresses of the arm's joints in qpos and qvel (the arm comes first)."""
    finger: np.ndarray
    """int64[f]: the same of the fingers."""
    drive: np.ndarray
    """int64[n]: actuators of the joints."""
    gripper: int
    """Actuator of the gripper."""
    stiffness: np.ndarray
    """float64[n]: of the drives [N m/rad]."""
    damping: np.ndarray
    """float64[n]: of the drives [N m s/rad]."""
    pose: int
    """Address of the first object's pose in qpos; each takes 7 numbers."""
    tree: int
    """Kinematic tree of the first object; one each."""
    kind: np.ndarray
    """int64[g]: object a geom belongs to, or TABLE, ARM, PAD."""
    tool: int
    """Site of the tool."""


def compile_world(arm: Arm, shape: tuple[tuple[Box, ...], ...], friction: float) -> World:
    """The cell with these objects, somewhere.

    Args:
        arm: the robot.
        shape: see :attr:`Objects.shape`.
        friction: between blocks, and of blocks on the table.
    """
    spec = arm_spec(arm)
    set_options(spec, TIMESTEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    # The feed-forward of a drive may ask for more than the joint's range.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
    surface = Surface(friction)
    arm_parts = [geom for geom in spec.geoms if geom.contype or geom.conaffinity]
    for part in arm_parts:
        part.margin = LOOK
    add_ground(spec, "table", surface)
    for number, boxes in enumerate(shape):
        add_object(spec, f"object{number}", boxes, surface)
    plan = spec.compile()
    plan.opt.enableflags = 0
    for part in arm_parts:
        part.margin = 0.0
    world = _world(arm, spec, spec.compile(), plan, len(shape))
    arm_bits, thing_bits = (_ARM_BIT, _ARM_BIT | _THING_BIT), (_THING_BIT, _ARM_BIT | _HELD_BIT)
    for geom, kind in enumerate(world.kind):
        bits = thing_bits if kind >= TABLE else arm_bits
        if plan.geom_contype[geom] or plan.geom_conaffinity[geom]:
            plan.geom_contype[geom], plan.geom_conaffinity[geom] = bits
    return world


def set_held(world: World, held: int | None) -> None:
    """In the model for planning, one object is in the hand: it and the arm do not meet, but it
    and all other things do."""
    model, kind = world.plan, world.kind
    model.geom_contype[kind >= 0], model.geom_conaffinity[kind >= 0] = (
        _THING_BIT, _ARM_BIT | _HELD_BIT
    )  # fmt: skip
    model.geom_margin[kind >= 0] = 0.0
    if held is not None:
        model.geom_margin[kind == held] = LOOK
        model.geom_contype[kind == held], model.geom_conaffinity[kind == held] = _HELD_BIT, 0


def _world(
    arm: Arm, spec: mujoco.MjSpec, model: mujoco.MjModel, plan: mujoco.MjModel, count: int
) -> World:
    body = model.geom_bodyid
    first = model.body("object0").id if count else model.nbody
    kind = np.where(body >= first, body - first, ARM)
    kind[model.geom("table").id] = TABLE
    kind[[model.geom(name).id for name in arm.gripper.pads]] = PAD
    drive = np.array([_drive_of(model, name) for name in arm.joints])
    return World(
        spec, model, plan,
        joint=np.array([model.joint(name).qposadr[0] for name in arm.joints]),
        finger=np.array([model.joint(name).qposadr[0] for name in arm.gripper.joints]),
        drive=drive, gripper=model.actuator(arm.gripper.actuator).id,
        stiffness=-model.actuator_biasprm[drive, 1], damping=-model.actuator_biasprm[drive, 2],
        pose=model.nq - 7 * count, tree=model.ntree - count, kind=kind,
        tool=model.site(arm.tool).id,
    )  # fmt: skip


def _drive_of(model: mujoco.MjModel, joint: str) -> int:
    turned = model.actuator_trnid[:, 0] == model.joint(joint).id
    on_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    return int(np.flatnonzero(turned & on_joint)[0])


class Order(NamedTuple):
    """What is asked of the arm, and where."""

    scene: Scene
    quaternion: np.ndarray
    """float64[n, 4]: orientations (w, x, y, z) of the cells."""
    move: Move
    objects: Objects
    poses: np.ndarray
    """float64[b, 7] of the objects: position [m] and quaternion."""
    names: list[str]
    """Of the objects, in messages."""
    target: int
    """Number of the object to be moved."""

    def in_hand(self, grasp: Attitude) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the object in the tool frame once it is grasped so: float64[3] [m] and [3, 3]."""
        tool, pose = grasp.rotation(), self.poses[self.target]
        contact = grasp.tool_point(self.scene.position[self.move.cell])
        return tool.T @ (pose[:3] - contact), tool.T @ rotation_matrix(pose[3:])

    def in_world(self, grasp: Attitude, place: Attitude) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the object once it is placed: float64[3] [m] and float64[3, 3]."""
        position, rotation = self.in_hand(grasp)
        tool = place.rotation()
        return place.tool_point(self.move.target) + tool @ position, tool @ rotation

    def after(self, poses: np.ndarray) -> tuple[Scene, np.ndarray]:
        """The scene with objects at ``poses`` float64[b, 7], the moved one listed as
        :func:`~.moves.put_down` does, and quaternions of its cells float64[n, 4]."""
        position, quaternion, yaw = self.objects.cells(poses)
        # Which cell goes where in the list, by sending their numbers instead of their yaws.
        numbered = self.scene._replace(yaw=np.arange(len(yaw), dtype=float))
        meant = put_down(numbered, self.move)
        new = np.rint(meant.yaw).astype(np.int64)
        members = self.scene.members(self.move.cell)
        new[self.scene.num_placed : self.scene.num_placed + len(members)] = members
        return meant._replace(position=position[new], yaw=yaw[new]), quaternion[new]


def take_order(scene: Scene, move: Move, quaternion: np.ndarray | None = None) -> Order:
    """The order to carry out ``move``.

    Args:
        scene: as things are.
        move: what shall be done.
        quaternion: float64[n, 4] orientations (w, x, y, z) of the cells; by default all stand
            upright at their yaw.

    Raises:
        InputError: for a cell that is not waiting, or numbers that are not finite.
    """
    if not scene.num_placed <= move.cell < len(scene.position):
        waiting = f"the index of a waiting cell, {scene.num_placed} to {len(scene.position) - 1}"
        raise InputError("cell", move.cell, waiting)
    if not np.isfinite(move.target).all():
        raise InputError("target", np.asarray(move.target).tolist(), "finite numbers")
    objects, poses, names = rigid_objects(scene, quaternion)
    turns = poses[objects.owner, 3:]
    return Order(scene, turns, move, objects, poses, names, int(objects.owner[move.cell]))


def rigid_objects(
    scene: Scene, quaternion: np.ndarray | None = None
) -> tuple[Objects, np.ndarray, list[str]]:
    """The objects of a scene, their poses float64[b, 7] and their names in messages.

    Raises:
        InputError: for numbers that are not finite.
    """
    turns = yaw_quaternion(scene.yaw) if quaternion is None else np.asarray(quaternion, float)
    for array in (scene.position, turns):
        if not np.isfinite(array).all():
            raise InputError("scene", array.tolist(), "finite numbers")
    objects = group(scene, turns)
    poses = np.hstack([scene.position[objects.lead], turns[objects.lead]])
    return objects, poses, [f"block {k}" for k in objects.lead]


class CellState:
    """Arm and objects at rest, one of which is to be moved.

    Args:
        world: model of the cell.
        poses: float64[b, 7] of the objects: position [m] and quaternion (w, x, y, z).
        target: number of the object to be moved.
        joints: float64[n] of the arm [rad].
        width: opening of the gripper [m].
    """

    def __init__(
        self, world: World, poses: np.ndarray, target: int, joints: np.ndarray, width: float
    ) -> None:
        self.world, self.target = world, target
        self.model, self.data = world.model, mujoco.MjData(world.model)
        self.poses = self.data.qpos[world.pose :].reshape(-1, 7)
        """float64[b, 7]: poses of the objects now; a view."""
        self.poses[:] = poses
        self.data.qpos[world.finger] = width / len(world.finger)
        self.put_arm(joints)

    def put_arm(self, joints: np.ndarray) -> None:
        """The arm is at joints float64[n] [rad], at rest."""
        d, joint = self.data, self.world.joint
        d.qpos[joint], d.qvel[joint] = joints, 0.0
        mujoco.mj_forward(self.model, d)

    @property
    def opening(self) -> float:
        """Between the pads [m]."""
        return float(self.data.qpos[self.world.finger].sum())

    def tool(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the tool float64[3] [m] and float64[3, 3], of the same instant as the objects
        (a step leaves its own one behind)."""
        mujoco.mj_kinematics(self.model, self.data)
        d, tool = self.data, self.world.tool
        return d.site_xpos[tool].copy(), d.site_xmat[tool].reshape(3, 3).copy()

    def in_hand(self) -> np.ndarray:
        """float64[3]: the target object in the tool frame [m]."""
        position, rotation = self.tool()
        return rotation.T @ (self.poses[self.target, :3] - position)

    def asleep(self, besides: bool = False) -> bool:
        """Whether every object rests, or every one but the target."""
        rest = self.data.tree_asleep[self.world.tree :] >= 0
        return bool(rest.all() or (besides and np.delete(rest, self.target).all()))

    def speed(self, number: int) -> float:
        """Of an object [m/s]."""
        first = self.model.nv - 6 * (len(self.poses) - number)
        return float(np.linalg.norm(self.data.qvel[first : first + 3]))

    def mass(self, number: int) -> float:
        """Of an object [kg]."""
        return float(self.model.body_mass[self.model.nbody - len(self.poses) + number])
