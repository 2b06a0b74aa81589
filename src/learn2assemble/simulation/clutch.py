r"""Bricks that clutch, in the simulation: pressed home by a force, held up to their capacity.

The law is that of the proofs (:mod:`learn2assemble.statics.holding.forces`): a contact point of a
knob pushes, or pulls up to its capacity :math:`T`; sideways forces and a couple about the vertical
are free. So a joint that bears the force :math:`F` and the couple :math:`M` (on its upper brick,
about the middle of its lower side) holds as long as pushes at its contact points add up to them
beside the pulls :math:`T`: where their sum :math:`N = F_z + \sum T` is positive, and its point of
attack

.. math:: (-M_y + \sum T x,\; M_x + \sum T y) / N

is in the hull of the contact points. A load that presses where the faces meet is borne by them,
too: which of several joints bears it is not a matter of choice here, as it is in a proof.

What clutches by friction slips at its capacity and goes on bearing that, so where forces balance a
structure it does not fall, however stiff its joints are (the static theorem of limit analysis, on
which the proofs rest). So a joint that bears more than it can gives, a few micrometres, until it
bears the share of its load that it can, and others take over the rest. Where they cannot, it gives
again and again, and opens, for good.

A joint that is home is a weld without give, which bears the load with the contact of the faces.
Capacities are those of the kit: 0.70 N a contact point (measured by others on small bricks; 0.98 N
in published verdicts). A brick comes home where it is pressed with the force of the kit while it is
within :data:`CAPTURE` of its place on the knobs, which are tapered and draw it there once the hand
has let go; less of a push leaves it loose on them. Until then the hand and the faces bear it.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np

from learn2assemble.robot.scene import rotation_matrix
from learn2assemble.robot.studs import GROUND, StudJoint, Studs

if TYPE_CHECKING:
    from learn2assemble.simulation.model import SimulatedWorld
    from learn2assemble.simulation.objects import Objects

CAPTURE, CAPTURE_TURN = 0.0015, math.radians(3.0)
"""So far from its place a knob finds its hole [m], [rad]."""
EVERY, MEAN = 5, 8
"""Steps between two looks at what joints bear, and looks whose mean counts: 80 ms, so that the
instant in which a joint comes home does not open it."""
AWAKE = 3 * EVERY * MEAN
"""Steps in which all are kept awake once they are drawn: at rest they fall asleep unjudged."""
DRAWN = 0.3
"""Share of the way to its place on which a joint draws its brick between two looks."""
NEAR_ENOUGH, NUDGE = 1e-6, 1e-9
"""Drawn so near it is there [m], [rad]; a force that only wakes a body [N]."""
GIVES = 6
"""A joint gives so many times in a row before it opens: half a second."""
HALVED = 20
"""Steps of the search for the share of a load that a joint bears."""
EDGE = 1e-5
"""The point of attack may be so far outside the hull [m]."""


class Made(NamedTuple):
    """What hands have made so far, by arm: lower and upper cell of joints."""

    pressed: tuple[frozenset[tuple[int, int]], ...] = ()
    """Those that the hand and the faces bear so far."""
    held: tuple[frozenset[tuple[int, int]], ...] = ()
    """Those that hold while the hand opens."""

    def named(self, names: Mapping[tuple[int, int], tuple[int, int]]) -> Made:
        """The same in other numbers, those that have one."""

        def told(
            several: tuple[frozenset[tuple[int, int]], ...],
        ) -> tuple[frozenset[tuple[int, int]], ...]:
            return tuple(frozenset(names[p] for p in some if p in names) for some in several)

        return Made(told(self.pressed), told(self.held))


NOTHING_MADE = Made()


def holds(joint: StudJoint, force: np.ndarray, couple: np.ndarray) -> bool:
    """Whether a joint bears a load.

    Args:
        force: float64[3] on its upper brick [N], in the directions of the lattice.
        couple: float64[3] about the middle of the lower side of that [N m].
    """
    load, push = float(force[2]), float(force[2]) + joint.pull
    if load > 0:
        # What presses within the faces is borne by them.
        at = np.array([-couple[1], couple[0]]) / load
        low, high = np.array(joint.face)
        if (at >= low - EDGE).all() and (at <= high + EDGE).all():
            return True
    if push <= 0:
        return False
    at = np.array([-couple[1], couple[0]]) + joint.pull * np.array(joint.middle)
    return _outside(np.array(joint.hull), at / push) <= EDGE


def borne(joint: StudJoint, force: np.ndarray, couple: np.ndarray) -> float:
    """The largest share of a load that a joint bears, 0 to 1."""
    if holds(joint, force, couple):
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(HALVED):
        share = (low + high) / 2
        low, high = (share, high) if holds(joint, share * force, share * couple) else (low, share)
    return low


def _outside(hull: np.ndarray, point: np.ndarray) -> float:
    """How far a point is outside a convex polygon, by its sides [m]; negative inside."""
    side = np.roll(hull, -1, 0) - hull
    normal = np.stack([side[:, 1], -side[:, 0]], 1)
    length = np.linalg.norm(normal, axis=1)
    return float((((point - hull) * normal).sum(1) / length).max())


class Clutch:
    """The joints of studs of one simulation.

    Args:
        world: model of the cell, with room for them.
        data: its state, with the objects where they begin.
        objects: which cells make up which object.
        studs: the joints, in cells of the scene.
        targets: number of the object that each arm moves; none where that is below 0.
        before: what hands have made so far, where this simulation goes on from another one.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    press: float
    joints: list[StudJoint]
    opened: list[StudJoint]

    def __init__(
        self,
        world: SimulatedWorld,
        data: mujoco.MjData,
        objects: Objects,
        studs: Studs,
        targets: Sequence[int],
        before: Made = NOTHING_MADE,
    ) -> None:
        self.model, self.data, self.press, m = world.model, data, studs.press, world.model
        self.joints, self.opened = list(studs.joints), list[StudJoint]()
        owner = objects.owner
        body = owner + world.first
        self._body = {GROUND: 0, **{k: int(b) for k, b in enumerate(body.tolist())}}
        self._offset = {GROUND: np.zeros(3), **dict(enumerate(objects.offset))}
        self._owner = owner
        self._first = m.equality("clutch0").id if world.num_welds else -1
        self._slot: dict[int, int] = {}
        for n, joint in enumerate(self.joints):
            ends = self._body[joint.lower], self._body[joint.upper]
            moves = any(m.body_dofnum[b] for b in ends)
            if ends[0] != ends[1] and moves and len(self._slot) < world.num_welds:
                self._slot[n] = self._first + len(self._slot)
        data.eq_active[self._first : self._first + world.num_welds] = 0
        self._wanted: list[list[int]] = [[] for _ in targets]
        """By arm, joints that its move makes."""
        for who, target in enumerate(targets):
            self.aim(target, who)
        self._steps, self._sum = 0, {n: np.zeros(6) for n in self._slot}
        self._off: dict[int, np.ndarray] = {}
        """By joint, float64[6]: how far its rest is from its place [m], [rad]."""
        self._slip: dict[int, np.ndarray] = {}
        """By joint, float64[6]: how far it has given [m], [rad], ..."""
        self._given = dict.fromkeys(self._slot, 0)
        """... and how many times in a row."""
        self._calm = 0
        """Step at which the last joint had drawn its brick to its place."""
        self._pressed: list[set[int]] = [self._numbers(pairs) for pairs in before.pressed]
        """By arm, joints that were made and that its hand and the faces bear so far, ..."""
        self._held: list[set[int]] = [self._numbers(pairs) for pairs in before.held]
        """... and those that hold while its hand opens."""
        for several in (self._pressed, self._held):
            several += [set() for _ in targets[len(several) :]]
        self._geom = self._geoms(objects)
        mujoco.mj_kinematics(m, data)
        for n in self._slot:
            if self.joints[n].home and self._near(n):
                if not any(n in some for some in self._pressed):
                    self._take(n)
            else:
                self.joints[n] = self.joints[n]._replace(home=False)
        self._wake(NUDGE)

    def _wake(self, force: float) -> None:
        for n in self._slot:
            for cell in (self.joints[n].lower, self.joints[n].upper):
                self.data.xfrc_applied[self._body[cell], 2] = force

    def aim(self, target: int, who: int = 0) -> None:
        """From now on an arm moves this object; none where the number is below 0."""
        own = set(np.flatnonzero(self._owner == target).tolist())
        self._wanted[who] = [
            n for n in self._slot if self.joints[n].leaves(own) and not self.joints[n].home
        ]

    @property
    def made(self) -> Made:
        """What hands have made so far and still hold."""

        def pairs(several: list[set[int]]) -> tuple[frozenset[tuple[int, int]], ...]:
            ends = [[(self.joints[n].lower, self.joints[n].upper) for n in s] for s in several]
            return tuple(map(frozenset, ends))

        return Made(pairs(self._pressed), pairs(self._held))

    def _numbers(self, pairs: frozenset[tuple[int, int]]) -> set[int]:
        """The joints of these cells."""
        return {n for n in self._slot if (self.joints[n].lower, self.joints[n].upper) in pairs}

    @property
    def home(self) -> tuple[tuple[int, int], ...]:
        """The joints that are home now: lower and upper cell."""
        return tuple((joint.lower, joint.upper) for joint in self.joints if joint.home)

    @property
    def loose(self) -> bool:
        """Whether a joint that a move was to make is not home."""
        return any(not self.joints[n].home for wanted in self._wanted for n in wanted)

    @property
    def unmade(self) -> bool:
        """Whether a joint is not home that a move was to make and whose brick has come to its
        place."""
        wanted = (n for some in self._wanted for n in some)
        return any(not self.joints[n].home and self._near(n) for n in wanted)

    def join(self, who: int = 0) -> None:
        """What an arm moves is pressed home: on every knob that it is near enough to."""
        for n in self._wanted[who]:
            if not self.joints[n].home and self._near(n):
                self.joints[n] = self.joints[n]._replace(home=True)
                self._pressed[who].add(n)

    def take(self, who: int = 0) -> None:
        """A hand is about to let go: the joints that were made hold what they joined as it is."""
        for n in {*self._wanted[who], *self._pressed[who]}:
            if self.joints[n].home:
                self._take(n)
                self._held[who].add(n)
        self._pressed[who].clear()

    def draw(self, who: int = 0) -> None:
        """A hand has let go: joints bring their bricks to their places."""
        self._held[who].clear()
        self._wake(NUDGE)

    def step(self) -> None:
        """A step of the simulation is done: open what bears more than it can."""
        self._steps += 1
        if self._steps % EVERY:
            return
        active = [n for n in self._slot if self.joints[n].home]
        rows = self.data.efc_type[: self.data.nefc] == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        number = np.where(rows, self.data.efc_id[: self.data.nefc], -1)
        faces = self._faces()
        last = self._steps % (EVERY * MEAN) == 0
        for n in active:
            own = number == self._slot[n]
            for first, count in faces.get(self._pair(n), ()):
                own[first : first + count] = True
            if n in self._off and not any(n in some for some in self._held):
                self._draw(n)
            if own.any():
                self._sum[n] += self._load(n, own) / MEAN
            if not last:
                continue
            if n not in self._off and self.data.eq_active[self._slot[n]]:
                self._judge(n)
            self._sum[n][:] = 0.0
        if self._steps == self._calm + AWAKE:
            self._wake(0.0)

    # ------------------------------------------------------------ one joint

    def _judge(self, n: int) -> None:
        """A joint that bears more than it can gives until it bears what it can; others take over
        what they can. One that gives again and again opens."""
        share = borne(self.joints[n], self._sum[n][:3], self._sum[n][3:])
        self._given[n] = self._given[n] + 1 if share < 1 else 0
        if self._given[n] > GIVES:
            self._open(n)
        elif share < 1:
            slip = self._slip.get(n, np.zeros(6))
            self._slip[n] = slip + (1 - share) * (self._misplaced(n) - slip)
            self._weld(n)
            self._calm = self._steps
            self._wake(NUDGE)

    def _take(self, n: int) -> None:
        """A joint holds its bricks as they are, and is to draw them to their places."""
        self._off[n] = self._misplaced(n)
        self._weld(n)

    def _draw(self, n: int) -> None:
        """Draw a brick nearer to its place."""
        self._off[n] *= 1 - DRAWN
        if np.abs(self._off[n]).max() < NEAR_ENOUGH:
            del self._off[n]
            self._calm = self._steps
        self._weld(n)

    def _pose(self, cell: int) -> tuple[np.ndarray, np.ndarray]:
        """Centre float64[3] [m] and rotation float64[3, 3] of a cell now."""
        body = self._body[cell]
        turn = self.data.xmat[body].reshape(3, 3)
        return self.data.xpos[body] + turn @ self._offset[cell], turn

    def _rest(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        """Where the upper cell of a joint shall be, from the lower one: float64[3] [m] in its
        frame, and float64[3, 3]."""
        joint = self.joints[n]
        lower, upper = (_along_axes(self._pose(k)[1]) for k in (joint.lower, joint.upper))
        return lower.T @ np.array(joint.at), lower.T @ upper

    def _misplaced(self, n: int) -> np.ndarray:
        """float64[6]: how far the upper cell is from its place on the lower one [m], and its
        rotation from that there, as a vector [rad]."""
        joint = self.joints[n]
        (low, turn), (high, other) = self._pose(joint.lower), self._pose(joint.upper)
        at, rest = self._rest(n)
        quaternion, angle = np.empty(4), np.empty(3)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray((turn @ rest).T @ other).ravel())
        mujoco.mju_quat2Vel(angle, quaternion, 1.0)
        return np.concatenate([turn.T @ (high - low) - at, angle])

    def _near(self, n: int) -> bool:
        off = self._misplaced(n)
        near = bool(np.abs(off[:3]).max() <= CAPTURE)
        return near and float(np.linalg.norm(off[3:])) <= CAPTURE_TURN

    def _weld(self, n: int) -> None:
        m, joint, slot = self.model, self.joints[n], self._slot[n]
        lower, upper = self._body[joint.lower], self._body[joint.upper]
        at, turn = self._rest(n)
        m.eq_obj1id[slot], m.eq_obj2id[slot] = lower, upper
        values = m.eq_data[slot]
        off = self._off.get(n, np.zeros(6)) + self._slip.get(n, np.zeros(6))
        values[:3] = self._offset[joint.upper]
        values[3:6] = self._offset[joint.lower] + at + off[:3]
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(turn).ravel())
        mujoco.mju_quatIntegrate(quaternion, off[3:].copy(), 1.0)
        values[6:10], values[10] = quaternion, 1.0
        self.data.eq_active[slot] = 1

    def _open(self, n: int) -> None:
        self.data.eq_active[self._slot[n]] = 0
        self.joints[n] = self.joints[n]._replace(home=False)
        self.opened.append(self.joints[n])

    def _geoms(self, objects: Objects) -> dict[int, int]:
        """The geom of every cell, and of the ground."""
        m, found = self.model, {GROUND: self.model.geom("table").id}
        seen: dict[int, int] = {}
        for cell in range(len(objects.owner)):
            body = self._body[cell]
            found[cell] = int(m.body_geomadr[body]) + seen.get(body, 0)
            seen[body] = seen.get(body, 0) + 1
        return found

    def _pair(self, n: int) -> tuple[int, int]:
        a, b = sorted((self._geom[self.joints[n].lower], self._geom[self.joints[n].upper]))
        return a, b

    def _faces(self) -> dict[tuple[int, int], list[tuple[int, int]]]:
        """By pair of geoms, the rows of constraints of their contacts: first and number."""
        d, found = self.data, dict[tuple[int, int], list[tuple[int, int]]]()
        elliptic = self.model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
        for pair, first, dim in zip(
            d.contact.geom.tolist() if d.ncon else (),
            d.contact.efc_address.tolist() if d.ncon else (),
            d.contact.dim.tolist() if d.ncon else (),
            strict=True,
        ):
            if first >= 0:
                a, b = sorted(map(int, pair))
                count = dim if elliptic or dim == 1 else 2 * (dim - 1)
                found.setdefault((a, b), []).append((first, count))
        return found

    def _load(self, n: int, rows: np.ndarray) -> np.ndarray:
        """float64[6]: force and couple on the upper cell, as :func:`holds` takes them."""
        m, d, joint = self.model, self.data, self.joints[n]
        each, general = np.zeros(d.nefc), np.empty(m.nv)
        each[rows] = d.efc_force[: d.nefc][rows]
        mujoco.mj_mulJacTVec(m, d, general, each)
        body, sign = self._body[joint.upper], 1.0
        if not m.body_dofnum[body]:
            body, sign = self._body[joint.lower], -1.0
        first = m.body_dofadr[body]
        force, own = general[first : first + 3], general[first + 3 : first + 6]
        couple = d.xmat[body].reshape(3, 3) @ own
        centre, turn = self._pose(joint.upper)
        tilt = turn @ _along_axes(turn).T
        middle = centre - tilt[:, 2] * self._half(joint.upper)
        couple = couple - np.cross(middle - d.xpos[body], force)
        return sign * np.concatenate([tilt.T @ force, tilt.T @ couple])

    def _half(self, cell: int) -> float:
        """Half the height of a cell [m]."""
        return float(self.model.geom_size[self.model.body_geomadr[self._body[cell]], 2])


def _along_axes(turn: np.ndarray) -> np.ndarray:
    """float64[3, 3]: the quarter turn about the vertical that is nearest to a rotation."""
    angle = math.pi / 2 * round(math.atan2(turn[1, 0], turn[0, 0]) / (math.pi / 2))
    quaternion = np.array([math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)])
    return rotation_matrix(quaternion)
