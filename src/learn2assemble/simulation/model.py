"""MuJoCo models of the cell: its arms, a table, and one free body per object of a scene.

Settings that hold a block by friction alone and let structures rest:

- boxes are thinner than they are called, so that neighbours do not rub (:mod:`.objects`);
- impratio 10: more does not reduce the creep of a block in the hand, whose cause is that MuJoCo
  neglects the change of the contact Jacobian (what is held drifts outwards on every turn, by
  0.2-0.6 mm with the stiff pads of our arms and by 1-3 mm with soft ones), and with 100 the solver
  fails where the hand jams several blocks; where blocks are no boxes it is 100 all the same, with
  passes against slip, as friction that bears for minutes creeps otherwise (``_NO_SLIP``);
- resting islands of blocks sleep, so a step costs what moves, not what is there.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from learn2assemble.constants import GRAVITY, HALF
from learn2assemble.geometry.hulls import Hull
from learn2assemble.robot.arm import Arm, arms_spec, prefix_of
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.scene import (
    ContactSurface,
    add_ground,
    add_object,
    keep_meshes,
    reshape,
    set_contact,
    set_options,
    table_pose,
)
from learn2assemble.simulation.objects import Box, Objects, part_of

TIMESTEP = 0.002
"""[s]; with 4 ms the grasp fails."""
PLAN_MARGIN = 0.005
"""The arm keeps this distance from everything on planned ways [m]."""
LOOK = 0.02
"""Distances up to this are measured when ways are planned [m]."""
TABLE, ARM, PAD = -1, -2, -3
"""Kinds of geoms in :attr:`SimulatedWorld.kind` that belong to no object; those of the next arm are
two lower each."""

_ARM_BIT, _THING_BIT, _HELD_BIT = 1, 2, 4
_FAR = (0.0, 0.0, 50.0)
_FIRM_REF = (0.01, 2.0)
"""Between boxes of given size: with a damping of 1, blocks on several others chatter and creep
sideways, 0.1 mm a second (measured); cubes keep theirs, for the tables."""
_ASLEEP = 3e-4
"""Boxes of given size fall asleep below this speed [m/s]: at MuJoCo's 1e-3 those that were pressed
into others (by 0.09 mm, measured) fall asleep before they have come out again."""
_NO_SLIP = 100.0, 5
"""Where blocks are no boxes, joints may lean and friction bear for minutes. MuJoCo's creeps there:
a block on a slope of 25 degrees with friction 0.6 slides 0.7 mm a second. With this ratio of the
impedances of friction and of normal forces, and so many passes against slip, it slides 0.004 mm in
8 s; with the passes alone 1.1 mm (all measured)."""
_CUP_REF, _CUP_IMP = (0.01, 1.0), (0.95, 0.99, 0.001, 0.5, 2.0)
"""The bellows give way a little: 0.05 mm under the weight of what hangs from them."""

_STUD_REF, _STUD_IMP = (0.004, 1.0), (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Of joints of studs, and of a socket on one: 20 N shift them by less than a hundredth of a
millimetre."""


class ArmParts(NamedTuple):
    """Where one arm is in a compiled cell."""

    joint: np.ndarray
    """int64[n]: addresses of its joints in qpos and qvel (arms come first)."""
    finger: np.ndarray
    """int64[f]: the same of the fingers."""
    drive: np.ndarray
    """int64[n]: actuators of the joints."""
    gripper: int
    """Actuator of the gripper; -1 for a suction tool."""
    stiffness: np.ndarray
    """float64[n]: of the drives [N m/rad]."""
    damping: np.ndarray
    """float64[n]: of the drives [N m s/rad]."""
    tool: int
    """Site of the tool."""
    pads: tuple[int, ...]
    """Geoms of the pads; none for a suction tool."""
    cup: int
    """Equality that holds what is in the cup; -1 for fingers."""
    kinds: tuple[int, int]
    """Of its geoms and of its pads, in :attr:`SimulatedWorld.kind`."""

    @property
    def actuators(self) -> np.ndarray:
        """int64[u]: all of its actuators."""
        return self.drive if self.gripper < 0 else np.append(self.drive, self.gripper)


class SimulatedWorld(NamedTuple):
    """A compiled cell and where things are in it."""

    spec: mujoco.MjSpec
    model: mujoco.MjModel
    plan: mujoco.MjModel
    """The same to plan ways with: a margin around the arm, and objects do not meet each other."""
    arms: tuple[ArmParts, ...]
    pose: int
    """Address of the first object's pose in qpos; each takes 7 numbers."""
    tree: int
    """Kinematic tree of the first object; one each."""
    kind: np.ndarray
    """int64[g]: object a geom belongs to, or TABLE, ARM, PAD."""
    first: int
    """Body of the first object; one each, those that are held still follow."""
    num_still: int
    """How many cells can be held still."""
    solids: dict[int, Part]
    """By geom of an object, the part it is, in the frame of the object."""
    num_welds: int = 0
    """How many joints of studs there can be."""


def compile_world(
    arms: Sequence[Arm],
    shape: tuple[tuple[Box, ...], ...],
    friction: float,
    num_still: int = 0,
    hulls: frozenset[Hull] = frozenset(),
    gravity: float = GRAVITY,
    num_welds: int = 0,
) -> SimulatedWorld:
    """The cell with these objects, somewhere.

    Args:
        arms: the robots; ways are planned for the first one.
        shape: see :attr:`Objects.shape`.
        friction: between blocks, and of blocks on the table.
        num_still: room for so many cells that are held still, see :func:`hold_still`.
        hulls: what these may be where they are no boxes.
        gravity: [m/s^2].
        num_welds: room for so many joints of studs, see :class:`~.clutch.Clutch`.
    """
    spec = arms_spec(arms)
    set_options(spec, TIMESTEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST, gravity)
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    # The feed-forward of a drive may ask for more than the joint's range.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
    given = num_still > 0 or any(len(box) > 2 for boxes in shape for box in boxes)
    surface = ContactSurface(friction, solref=_FIRM_REF) if given else ContactSurface(friction)
    if given:
        spec.option.sleep_tolerance = _ASLEEP
    if hulls or any(len(box) > 3 for boxes in shape for box in boxes):
        spec.option.impratio, spec.option.noslip_iterations = _NO_SLIP
    arm_parts = [geom for geom in spec.geoms if geom.contype or geom.conaffinity]
    for part in arm_parts:
        part.margin = LOOK
    add_ground(spec, "table", surface)
    keep_meshes(spec, sorted(hulls), _FAR)
    for number, boxes in enumerate(shape):
        add_object(spec, f"object{number}", boxes, surface)
    for number in range(num_still):
        box = spec.worldbody.add_body(name=f"still{number}", pos=_FAR)
        geom = box.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[HALF] * 3)
        set_contact(geom, surface)
    for number, arm in enumerate(arms):
        if arm.suction is None:
            continue
        # The block in the cup: which one, where, and whether, is said when it is attached.
        firm = arm.suction.studs > 0
        name, body = prefix_of(number), "object0" if shape else ""
        _add_weld(spec, f"{name}cup", f"{name}{arm.gripper.hand}", body, firm)
    num_welds = num_welds if shape else 0
    for number in range(num_welds):
        _add_weld(spec, f"clutch{number}", "world", "object0", firm=True)
    plan = spec.compile()
    plan.opt.enableflags = 0
    for part in arm_parts:
        part.margin = 0.0
    world = _world(arms, spec, spec.compile(), plan, shape, num_still)._replace(num_welds=num_welds)
    arm_bits, thing_bits = (_ARM_BIT, _ARM_BIT | _THING_BIT), (_THING_BIT, _ARM_BIT | _HELD_BIT)
    for geom, kind in enumerate(world.kind):
        # What belongs to another arm is a thing.
        bits = arm_bits if kind in (ARM, PAD) else thing_bits
        if plan.geom_contype[geom] or plan.geom_conaffinity[geom]:
            plan.geom_contype[geom], plan.geom_conaffinity[geom] = bits
    return world


def _add_weld(spec: mujoco.MjSpec, name: str, one: str, other: str, firm: bool) -> None:
    """Room for a joint in a model; which bodies it joins is said later."""
    weld = spec.add_equality(
        name=name,
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1=one,
        name2=other,
        active=False,
        solref=_STUD_REF if firm else _CUP_REF,
        solimp=_STUD_IMP if firm else _CUP_IMP,
    )
    weld.data[:] = 0.0


def hold_still(world: SimulatedWorld, objects: Objects) -> None:
    """Put the cells that are held still where they are; for every simulation that begins now."""
    count = len(objects.still)
    bodies = world.first + len(objects.shape) + np.arange(world.num_still)
    for model in (world.model, world.plan):
        model.body_pos[bodies[count:]] = _FAR
        model.body_pos[bodies[:count]] = objects.still[:, :3]
        model.body_quat[bodies[:count]] = objects.still[:, 3:]
        geoms = model.body_geomadr[bodies[:count]]
        reshape(model, geoms, objects.still_half, objects.still_hull, objects.still_round)


def lean_table(model: mujoco.MjModel, table: tuple[float, float, float]) -> None:
    """The table of a model is as :attr:`~learn2assemble.robot.moves.Scene.table` says."""
    geom = model.geom("table").id
    model.geom_sameframe[geom] = 0  # It is not where its body is.
    model.geom_pos[geom], model.geom_quat[geom] = table_pose(table)


def set_held(world: SimulatedWorld, held: int | None) -> None:
    """In the model for planning, one object is in the hand: it and the arm do not meet, but it
    and all other things do."""
    model, kind = world.plan, world.kind
    model.geom_contype[kind >= 0], model.geom_conaffinity[kind >= 0] = (
        _THING_BIT,
        _ARM_BIT | _HELD_BIT,
    )
    model.geom_margin[kind >= 0] = 0.0
    if held is not None:
        model.geom_margin[kind == held] = LOOK
        model.geom_contype[kind == held], model.geom_conaffinity[kind == held] = _HELD_BIT, 0


def _world(
    arms: Sequence[Arm],
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    plan: mujoco.MjModel,
    shape: tuple[tuple[Box, ...], ...],
    num_still: int,
) -> SimulatedWorld:
    body, count = model.geom_bodyid, len(shape)
    lowest = "object0" if count else "still0" if num_still else None
    first = model.nbody if lowest is None else model.body(lowest).id
    kind = np.where(body >= first, body - first, ARM)
    kind[model.geom("table").id] = TABLE
    parts = tuple(_parts(model, arm, number) for number, arm in enumerate(arms))
    for number, one in enumerate(parts[1:], 1):
        name = prefix_of(number)
        mine = np.array([model.body(k).name.startswith(name) for k in range(model.nbody)])
        kind[mine[body]] = one.kinds[0]
    for one in parts:
        kind[list(one.pads)] = one.kinds[1]
    return SimulatedWorld(
        spec,
        model,
        plan,
        parts,
        pose=model.nq - 7 * count,
        tree=model.ntree - count,
        kind=kind,
        first=first,
        num_still=num_still,
        solids=_solids(model, shape, first),
    )


def _parts(model: mujoco.MjModel, arm: Arm, number: int) -> ArmParts:
    """Where an arm of a cell is."""
    name = prefix_of(number)
    gripper = arm.gripper
    drive = np.array([_drive_of(model, name + joint) for joint in arm.joints])
    return ArmParts(
        joint=np.array([model.joint(name + joint).qposadr[0] for joint in arm.joints]),
        finger=np.array([model.joint(name + one).qposadr[0] for one in gripper.joints], np.int64),
        drive=drive,
        gripper=-1 if arm.suction else model.actuator(name + gripper.actuator).id,
        stiffness=-model.actuator_biasprm[drive, 1],
        damping=-model.actuator_biasprm[drive, 2],
        tool=model.site(name + arm.tool).id,
        pads=tuple(model.geom(name + pad).id for pad in gripper.pads),
        cup=model.equality(f"{name}cup").id if arm.suction else -1,
        kinds=(ARM - 2 * number, PAD - 2 * number),
    )


def _solids(
    model: mujoco.MjModel, shape: tuple[tuple[Box, ...], ...], first: int
) -> dict[int, Part]:
    found: dict[int, Part] = {}
    for number, boxes in enumerate(shape):
        begin = int(model.body_geomadr[first + number])
        found |= {begin + k: part_of(box) for k, box in enumerate(boxes)}
    return found


def _drive_of(model: mujoco.MjModel, joint: str) -> int:
    turned = model.actuator_trnid[:, 0] == model.joint(joint).id
    on_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    return int(np.flatnonzero(turned & on_joint)[0])
