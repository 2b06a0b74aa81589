"""Whether an arm touches anything, wherever it is put: MuJoCo's collision detection."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from learn2assemble.constants import HALF
from learn2assemble.geometry.hulls import Hull
from learn2assemble.geometry.rotations import yaw_quaternion
from learn2assemble.robot.arm import Arm, arm_spec
from learn2assemble.robot.moves import GAP, Scene, fillers
from learn2assemble.robot.scene import keep_meshes, reshape, rotation_matrix, table_pose

SHRINK = 0.001
"""What is carried counts as this much smaller on every side [m], so that resting on a block or
standing beside it is no collision."""
TABLE = (0.75, 0.5, 0.01)
"""Half extents of the table, its top at z = 0 [m]."""
MAX_CARRIED = 4
"""Cells of the largest object ..."""
MAX_SIZED = 16
"""... and boxes, at first, of the largest one where scenes say how large they are."""
HELD = "what is held"
"""What messages call what is carried."""
_CELL, _FILLER = (HALF, HALF, HALF), (GAP / 2, HALF, HALF)
_ARM, _CARRIED, _THING = 1, 2, 4
_FAR = (0.0, 0.0, -50.0)


class Collision(NamedTuple):
    """Two things that meet, by name: parts of the arm, ``table``, blocks, what is carried."""

    part: str
    other: str
    by_link: bool
    """A link of the arm is in the way, not its hand or what it holds."""

    def __str__(self) -> str:
        one, other = (HELD if n.startswith("carried ") else n for n in (self.part, self.other))
        return f"{one} touches {other}"


class CollisionChecker(ABC):
    """A model whose arm can be put anywhere.

    Args:
        arm: the robot.
        model: has the arm in it.
    """

    def __init__(self, arm: Arm, model: mujoco.MjModel) -> None:
        self.arm = arm
        self.model = model
        self.data: mujoco.MjData = mujoco.MjData(model)
        self._joints = np.array([model.joint(name).qposadr[0] for name in arm.joints])
        self._fingers = np.array(
            [model.joint(name).qposadr[0] for name in arm.gripper.joints], np.int64
        )

        self.opening: float = 0.0
        """Between the pads [m]."""

    @abstractmethod
    def check(self, joints: np.ndarray) -> Collision | None:
        """The first collision at joints float64[n] [rad], or None."""

    def move_arm(self, joints: np.ndarray) -> None:
        """Put the arm at joints float64[n] [rad]."""
        self.data.qpos[self._joints] = joints
        if len(self._fingers):
            self.data.qpos[self._fingers] = self.opening / len(self._fingers)
        mujoco.mj_kinematics(self.model, self.data)


class BlockChecker(CollisionChecker):
    """The arm, a table, and blocks that are put where a scene says.

    Args:
        arm: the robot.
        num_cells: cells a scene has at most.
        sized: scenes say what their cells are, and have no fillers.
        most: cells of the largest object of such a scene.
        hulls: that such scenes may have.

    One instance serves one thread.
    """

    def __init__(
        self,
        arm: Arm,
        num_cells: int,
        sized: bool = False,
        most: int = MAX_SIZED,
        hulls: frozenset[Hull] = frozenset(),
    ) -> None:
        most = most if sized else MAX_CARRIED
        self._smaller = {hull: hull.shrunk(SHRINK) for hull in hulls}
        meshes = sorted({*hulls, *self._smaller.values()})
        super().__init__(arm, _compile(arm, num_cells, sized, most, meshes))
        self.num_cells = num_cells
        self.sized = sized
        self.most = most
        m = self.model
        self.hulls = hulls
        self._hand = {arm.gripper.hand, *arm.gripper.fingers, "carried"}
        self._carried = np.array([m.body(f"carried {k}").id for k in range(most)])
        if sized:
            first = m.body("block 0").id
            self._boxes = np.arange(num_cells) + m.body_geomadr[first]
            self._carried_boxes = m.body_geomadr[self._carried]
        else:
            fillers_in_hand = [m.body(f"carried f{k}").id for k in range(most)]
            self._carried_fillers = np.array(fillers_in_hand)
        self._names = [m.body(k).name for k in range(m.nbody)]
        hand = arm.gripper.hand, *arm.gripper.fingers
        self._hand_bodies = np.array([name in hand for name in self._names])
        self._pairs = np.empty((0, 2), np.int64)
        site = m.site(arm.tool)
        self._tool_position, self._tool_rotation = site.pos.copy(), rotation_matrix(site.quat)
        self._scene: Scene | None = None
        """What was put there last ..."""
        self._moved: list[np.ndarray] = []
        """... and cells that are elsewhere since."""

    def keep(self, apart: float) -> None:
        """From now on the hand has to be so far from everything [m]."""
        m, hand = self.model, self._hand_bodies
        m.body_margin[hand] = m.geom_margin[hand[m.geom_bodyid]] = apart

    def place(self, scene: Scene) -> None:
        """Put the blocks where the cells of ``scene`` are, whose arrays nobody changes."""
        if scene is self._scene:  # Of many moves in one scene only what they carry is elsewhere.
            cells = np.concatenate([*self._moved, np.empty(0, np.int64)])
            self._put(cells, scene.position[cells], scene.orientation[cells])
            self._moved.clear()
            return
        self._scene = None
        n, d, m = len(scene.position), self.data, self.model
        table = m.body("table").id
        m.body_pos[table], m.body_quat[table] = table_pose(scene.table)
        if self.sized:
            reshape(m, self._boxes[:n], scene.halves, scene.hull)
        else:
            self._pairs = fillers(scene.position, scene.object_id)
            d.mocap_pos[self.num_cells + len(self._pairs) :] = _FAR
        d.mocap_pos[n : self.num_cells] = _FAR
        self._put(np.arange(n), scene.position, scene.orientation)
        self._scene = scene
        self._moved.clear()

    def put(self, cells: np.ndarray, position: np.ndarray, quaternion: np.ndarray) -> None:
        """Move whole objects of the scene.

        Args:
            cells: int64[c] of the scene.
            position: float64[c, 3], their centres [m].
            quaternion: float64[c, 4], their orientations.
        """
        self._moved.append(cells)
        self._put(cells, position, quaternion)

    def _put(self, cells: np.ndarray, position: np.ndarray, quaternion: np.ndarray) -> None:
        d = self.data
        d.mocap_pos[cells], d.mocap_quat[cells] = position, quaternion
        if len(self._pairs):
            numbers = np.flatnonzero(np.isin(self._pairs[:, 0], cells))
            where, angle = _between(d.mocap_pos, self._pairs[numbers])
            d.mocap_pos[self.num_cells + numbers] = where
            d.mocap_quat[self.num_cells + numbers] = yaw_quaternion(angle)

    def take(self, cells: np.ndarray) -> None:
        """Take whole objects out of the scene."""
        self.put(cells, np.tile(_FAR, (len(cells), 1)), yaw_quaternion(np.zeros(len(cells))))

    def carry(self, position: np.ndarray, object_id: np.ndarray) -> None:
        """Fix cubes to the hand; none: the hand is empty.

        Args:
            position: float64[c, 3] centres in the tool frame [m]; their sides are parallel to its
                axes.
            object_id: int64[c].
        """
        m = self.model
        m.body_pos[self._carried] = _FAR
        if self.sized:
            return
        pairs = fillers(position, object_id)
        m.body_pos[self._carried_fillers] = _FAR
        m.body_pos[self._carried[: len(position)]] = self._in_hand(position)
        where, angle = _between(position, pairs)
        bodies = self._carried_fillers[: len(pairs)]
        m.body_pos[bodies] = self._in_hand(where)
        m.body_quat[bodies] = yaw_quaternion(angle)  # the tool's z is the hand's

    def hang(self, scene: Scene, cells: np.ndarray, position: np.ndarray, turn: np.ndarray) -> None:
        """Fix cells that a scene tells the sizes of to the hand.

        Args:
            scene: that has them.
            cells: int64[c].
            position: float64[c, 3] centres in the tool frame [m].
            turn: float64[c, 3, 3]: their rotations in the tool frame.
        """
        m, count = self.model, len(cells)
        numbers: list[int] = cells.tolist()
        m.body_pos[self._carried] = _FAR
        m.body_pos[self._carried[:count]] = self._in_hand(position)
        for body, rotation in zip(self._carried, self._tool_rotation @ turn, strict=False):
            mujoco.mju_mat2Quat(m.body_quat[body], rotation.ravel())
        hulls = [
            None if hull is None else self._smaller[hull]
            for hull in ([None] * count if scene.hull is None else [scene.hull[k] for k in numbers])
        ]
        reshape(m, self._carried_boxes[:count], scene.halves[cells] - SHRINK, hulls)

    def check(self, joints: np.ndarray) -> Collision | None:
        """See :class:`CollisionChecker`; blocks are called ``block N``, ``filler N`` and
        ``carried N``."""
        self.move_arm(joints)
        mujoco.mj_collision(self.model, self.data)
        if not self.data.ncon:
            return None
        pair = self.data.contact.geom[0]
        part, other = (self._names[self.model.geom_bodyid[geom]] for geom in pair)
        if part.split()[0] in _THINGS:
            part, other = other, part
        return Collision(part, other, part.split()[0] not in self._hand)

    def _in_hand(self, points: np.ndarray) -> np.ndarray:
        """float64[k, 3]: points of the tool frame in the frame of its body [m]."""
        return self._tool_position + points @ self._tool_rotation.T


_THINGS = ("table", "block", "filler")


def _compile(
    arm: Arm, num_cells: int, sized: bool, most: int, hulls: Sequence[Hull]
) -> mujoco.MjModel:
    spec = arm_spec(arm)
    mounted = [body.name for body in spec.worldbody.bodies]
    for geom in spec.geoms:
        solid = geom.contype or geom.conaffinity
        geom.contype, geom.conaffinity = (_ARM, _ARM | _THING) if solid else (0, 0)
        if solid and geom.parent.name in mounted:
            geom.contype |= _THING  # what is carried must not meet the base either
    world, hand = spec.worldbody, spec.site(arm.tool).parent
    table = world.add_body(name="table")
    size = list(TABLE)
    _box(table, size, _THING, 0).pos = [0.0, 0.0, -TABLE[2]]
    for base in mounted:
        spec.add_exclude(bodyname1="table", bodyname2=base)
    keep_meshes(spec, hulls, _FAR)
    names = [(f"block {k}", _CELL) for k in range(num_cells)]
    names += [(f"filler {k}", _FILLER) for k in range(0 if sized else num_cells)]
    for name, half in names:
        _box(world.add_body(name=name, mocap=True, pos=_FAR), list(half), _THING, 0)
    carried = [(f"carried {k}", _CELL) for k in range(most)]
    carried += [(f"carried f{k}", _FILLER) for k in range(0 if sized else most)]
    for name, half in carried:
        body = hand.add_body(name=name, pos=_FAR)
        _box(body, [side - SHRINK for side in half], _CARRIED, _THING)
    return spec.compile()


def _box(body: mujoco.MjsBody, half: list[float], contype: int, conaffinity: int) -> mujoco.MjsGeom:
    return body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=half,
        contype=contype,
        conaffinity=conaffinity,
        mass=0.01,
    )


def _between(position: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres of fillers float64[f, 3] [m] and the direction float64[f] of their thin side."""
    gap = position[pairs[:, 1]] - position[pairs[:, 0]]
    return position[pairs].mean(1), np.arctan2(gap[:, 1], gap[:, 0])
