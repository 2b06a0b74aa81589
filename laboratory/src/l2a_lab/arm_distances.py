"""How far two arms of a simulated cell, with what they hold, were from each other.

Measured when the build is over, at moments drawn from all of it, by a collision library that
neither the simulation nor whoever plans ways uses (the Flexible Collision Library, extra
``distances``).
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from learn2assemble.errors import extra
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.robot.arm import Arm, arms_spec, prefix_of
from learn2assemble.robot.bodies import Part, Shape
from learn2assemble.simulation.plant import DynamicPlant

MOMENTS = 10_000
"""So many are drawn of a build."""
THERE = 0.005
"""What is held is in its place where it is so near to that [m]."""


class Moment(NamedTuple):
    """Where two arms were."""

    joints: np.ndarray
    """Of both and of their fingers, as a model of the arms alone has them [rad], [m]."""
    held: tuple[tuple[str, np.ndarray] | None, ...]
    """What each held, with its pose float64[7]."""


class Least(NamedTuple):
    """What was measured."""

    distance: float
    """The least [m]; below 0 where solids overlap."""
    moments: int
    """How many were looked at."""


class _Solids(NamedTuple):
    """Some solids that belong together, where they are."""

    objects: list[Any]
    place: np.ndarray
    """float64[k, 3] [m]"""
    turn: np.ndarray
    """float64[k, 3, 3]"""
    radius: np.ndarray
    """float64[k]: of balls around them about their places [m]."""


class ArmDistances:
    """Distances of two arms.

    Args:
        arms: both, where they stand.
        shapes: of what they may hold, by name.

    Raises:
        MissingExtraError: without the extra ``distances``.
    """

    def __init__(self, arms: Sequence[Arm], shapes: dict[str, Shape]) -> None:
        self._fcl = _library()
        self._held = {name: self._parts(shape) for name, shape in shapes.items()}
        self.model = m = arms_spec(arms).compile()
        self.data = mujoco.MjData(m)
        solid = (m.geom_contype | m.geom_conaffinity) > 0
        second = np.array(
            [m.body(int(b)).name.startswith(prefix_of(1)) for b in m.geom_bodyid], bool
        )
        self._geoms = [np.flatnonzero(solid & (second == which)) for which in (False, True)]
        self._objects = [[self._geom(g) for g in geoms.tolist()] for geoms in self._geoms]

    def between(self, moment: Moment, below: float = math.inf) -> float:
        """How far the arms are from each other, with what they hold [m].

        Args:
            below: nothing that is farther apart is looked at.
        """
        fcl = self._fcl
        self.data.qpos[:] = moment.joints
        mujoco.mj_kinematics(self.model, self.data)
        one, two = (self._arm(who, moment.held[who]) for who in range(2))
        far = np.linalg.norm(one.place[:, None] - two.place, axis=2)
        far = far - one.radius[:, None] - two.radius
        least = below
        if far.min() >= least:
            return least
        for number in np.argsort(far, axis=None).tolist():
            a, b = divmod(number, len(two.radius))
            if far[a, b] >= least:
                break
            pair: list[Any] = []
            for solids, k in ((one, a), (two, b)):
                solids.objects[k].setTransform(fcl.Transform(solids.turn[k], solids.place[k]))
                pair.append(solids.objects[k])
            least = min(least, self._apart(*pair))
        return least

    def least(self, moments: Sequence[Moment]) -> Least:
        """The least of some moments."""
        found = math.inf
        for moment in moments:
            found = self.between(moment, found)
        return Least(found, len(moments))

    # ------------------------------------------------------------ solids

    def _arm(self, who: int, held: tuple[str, np.ndarray] | None) -> _Solids:
        geoms, m, d = self._geoms[who], self.model, self.data
        place, turn = d.geom_xpos[geoms], d.geom_xmat[geoms].reshape(-1, 3, 3)
        own = _Solids(self._objects[who], place, turn, m.geom_rbound[geoms])
        if held is None:
            return own
        name, pose = held
        objects, centres, radius = self._held[name]
        axes = quaternion_matrix(pose[3:])
        return _Solids(
            own.objects + objects,
            np.vstack([place, pose[:3] + centres @ axes.T]),
            np.concatenate([turn, np.repeat(axes[None], len(objects), 0)]),
            np.concatenate([own.radius, radius]),
        )

    def _geom(self, geom: int) -> Any:
        """A solid of an arm.

        Raises:
            ValueError: for a kind of solid that no arm has so far.
        """
        kind = mujoco.mjtGeom(int(self.model.geom_type[geom]))
        x, y, z = self.model.geom_size[geom].tolist()
        if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            shape = self._fcl.Capsule(x, 2 * y)
        elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
            shape = self._fcl.Cylinder(x, 2 * y)
        elif kind == mujoco.mjtGeom.mjGEOM_BOX:
            shape = self._fcl.Box(2 * x, 2 * y, 2 * z)
        else:
            raise ValueError(kind.name)
        return self._fcl.CollisionObject(shape)

    def _parts(self, shape: Shape) -> tuple[list[Any], np.ndarray, np.ndarray]:
        """The parts of a block, their centres float64[k, 3] in its frame [m], and radii about
        these float64[k] [m]."""
        objects = [self._fcl.CollisionObject(self._part(part)) for part in shape]
        radius = [float(np.linalg.norm(part.solid.points, axis=1).max()) for part in shape]
        return objects, np.array([part.centre for part in shape]), np.array(radius)

    def _part(self, part: Part) -> Any:
        if part.hull is None:
            x, y, z = part.half
            return self._fcl.Box(2 * x, 2 * y, 2 * z)
        faces = [[len(face), *face] for face in part.hull.faces]
        flat = np.array([number for face in faces for number in face], np.int32)
        return self._fcl.Convex(np.array(part.hull.points, float), len(faces), flat)

    def _apart(self, one: Any, two: Any) -> float:
        """Of two solids [m]; below 0 by some depth where they overlap."""
        fcl = self._fcl
        return float(fcl.distance(one, two, fcl.DistanceRequest(), fcl.DistanceResult()))


def _library() -> Any:
    """The collision library, which has no types.

    Raises:
        MissingExtraError: where it is not installed.
    """
    with extra("fcl", "distances"):
        import fcl  # pyright: ignore[reportMissingTypeStubs]
    return fcl


class WatchedCell(DynamicPlant):
    """A cell that keeps where its two arms were after every step of time.

    Raises:
        MissingExtraError: without the extra ``distances``, before anything is simulated.
    """

    def __init__(self, setup: Any) -> None:
        _library()
        super().__init__(setup)
        self.moments: list[Moment] = []
        self.places: dict[str, np.ndarray] = {}
        """float64[7]: where blocks are to stand that an arm may hold there: in its place what is
        held belongs to the structure, on which the other arm sets the next block down."""
        self.carried: dict[str, Shape] = {}
        """All that ever was in a hand; some of it may be gone."""

    def _advance(self, moving: frozenset[int]) -> None:
        super()._advance(moving)
        state, held = self.simulated, [self._off_its_place(one.held()) for one in self.plants]
        self.carried |= {name: self.things[name].kind.shape for name in held if name}
        self.moments.append(
            Moment(
                state.data.qpos[: state.world.pose].copy(),
                tuple(None if n is None else (n, self.pose_now(n)) for n in held),
            )
        )

    def _off_its_place(self, name: str | None) -> str | None:
        """What is held, but where it stands."""
        place = self.places.get(name or "")
        if name is None or place is None:
            return name
        return None if np.linalg.norm(self.pose_now(name)[:3] - place[:3]) < THERE else name

    def least(self, count: int = MOMENTS, seed: int = 0) -> Least:
        """The least distance of the arms at so many moments, all different, or at all of them."""
        number = min(count, len(self.moments))
        drawn = np.random.default_rng(seed).choice(len(self.moments), number, replace=False)
        return ArmDistances(self.arms, self.carried).least([self.moments[int(k)] for k in drawn])
