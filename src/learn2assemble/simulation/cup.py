"""A suction cup, or a socket, in the simulation: when it takes hold, what it is loaded with, how it
lets go.

The cup obeys its command and nothing else: with the vacuum on, it takes hold of whatever face its
lip is closed on, once the vacuum has built up; with the vacuum off it lets go. What it holds hangs
on a soft weld, whose forces are the load on the cup. Every step they are compared with what the cup
can hold (:mod:`learn2assemble.robot.tool`): beyond the friction of the lip the block slips along
its face, the faster the more it is, beyond the pull-off force, or where the lip has
slipped over an edge, it comes off.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import math

import mujoco
import numpy as np

from learn2assemble.robot.holding import FACING
from learn2assemble.robot.scene import rotation_matrix
from learn2assemble.robot.studs import stud_axes
from learn2assemble.robot.tool import Cup, Suction
from learn2assemble.simulation.model import TIMESTEP, ArmParts, SimulatedWorld
from learn2assemble.simulation.objects import SHRINK

RIM = 16
"""Points at which the lip is looked at."""
TIGHT = 1e-3 + SHRINK
"""The lip may stand over an edge by this [m]."""
SLIDING = 4.0
"""Share of its give that the lip slips each step, by excess of the load: a block slips at 80 mm/s
under 1.2 times what friction carries. The weld that stands for the bellows damps as well as it
springs, so that a share of 1 would let it creep."""
TIPPED = math.radians(5.0)
"""A brick that tilts farther under a socket comes out of it [rad]."""
UPRIGHT = (0.0, 0.0, 1.0)
"""The axis of a cup whose frame is that of the tool."""
AWAKE = -(1 + mujoco.mjMINAWAKE)
"""State of what is kept awake for the next steps, as the engine counts them."""
LOOK = 10
"""Steps between two looks whether the lip is closed."""


class Vacuum:
    """The cups of a simulated arm, on one vacuum: whichever lip is closed on a face holds it.

    Args:
        suction: the tool.
        world: model of the cell.
        data: its state.
        number: of the arm in the model.
    """

    suction: Suction
    world: SimulatedWorld
    model: mujoco.MjModel
    data: mujoco.MjData

    def __init__(
        self, suction: Suction, world: SimulatedWorld, data: mujoco.MjData, number: int = 0
    ) -> None:
        self.suction, self.world, self.model, self.data = suction, world, world.model, data
        self.parts: ArmParts = world.arms[number]
        self.held: int | None = None
        """Number of the object in the cup."""
        self.used: Cup = suction.cups[0]
        """The cup that holds it, or that was the last to."""
        self.lost: str = ""
        """Why it came off, until the vacuum is turned off; empty if it did not."""
        self.most: tuple[float, float] = (0.0, 0.0)
        """Largest shares of pull-off force and friction so far, see
        :meth:`~learn2assemble.robot.tool.Suction.load`."""
        self._on = self._off = 0
        self._weld = self.parts.cup
        self._hand = int(self.model.site_bodyid[self.parts.tool])
        angle = np.linspace(0.0, 2 * np.pi, RIM, endpoint=False)
        self._rim = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
        data.eq_active[self._weld] = 0

    def step(self, command: float) -> None:
        """A simulation step is done, in which the vacuum was on (1) or off (0)."""
        if command < 0.5:
            self._on, self._off = 0, self._off + 1
            if self._off * TIMESTEP >= self.suction.release_time:
                self.lost = ""
                if self.held is not None:
                    self._let_go()
        else:
            self._on, self._off = self._on + 1, 0
            ready = self._on * TIMESTEP >= self.suction.grip_time
            if self.held is None and ready and not self.lost and self._on % LOOK == 0:
                self._take()
        if self.held is not None:
            self._watch()

    def take_over(self, before: Vacuum, number: int | None) -> None:
        """Go on as another cup of the same tool did in another simulation of the same moment.

        Args:
            before: that cup.
            number: of the object in it, here; None: it holds nothing.
        """
        self.used, self.lost, self.most = before.used, before.lost, before.most
        self._on, self._off, self.held = before._on, before._off, number
        if number is None:
            return
        self.model.eq_obj2id[self._weld] = self.world.first + number
        self.model.eq_data[self._weld] = before.model.eq_data[before._weld]
        self.data.eq_active[self._weld] = 1

    def load(self, first: int) -> tuple[np.ndarray, np.ndarray]:
        """What the held block loads the cup with: force [N] and moment about the tool point [N m],
        each float64[3] in the tool frame.

        Args:
            first: :attr:`row` of the weld.
        """
        d, w = self.data, self.world
        # The force at the cup, then the moment in the frame of the block, in units of twice the
        # turn.
        rows = d.efc_force[first : first + 6]
        tool = d.site_xmat[self.parts.tool].reshape(3, 3)
        if self.used.lip.axis != UPRIGHT:
            tool = tool @ self.used.lip.frame()
        block = d.xmat[w.first + (self.held or 0)].reshape(3, 3)
        return tool.T @ rows[:3], 0.5 * (tool.T @ (block @ rows[3:]))

    @property
    def row(self) -> int | None:
        """The first row of the weld among the equalities, which come first of the constraints;
        None where it has none yet."""
        mine = self.data.efc_id[: self.data.ne] == self._weld
        first = int(mine.argmax()) if len(mine) else 0
        return first if len(mine) and mine[first] else None

    def _lip(self, cup: Cup) -> tuple[np.ndarray, np.ndarray]:
        """Where the middle of a lip is, float64[3] [m], and axes of the cup float64[3, 3]."""
        d, site = self.data, self.parts.tool
        tool = d.site_xmat[site].reshape(3, 3)
        return d.site_xpos[site] + tool @ np.array(cup.lip.at), tool @ cup.lip.frame()

    def closed_on(self, number: int, cup: Cup | None = None) -> bool:
        """Whether the lip of a cup, by default the one that is used, is closed on a face of an
        object; a socket, on a stud of it."""
        d, w, cup = self.data, self.world, cup or self.used
        turn = rotation_matrix(d.xquat[w.first + number])
        point, tool = self._lip(cup)
        away = point - d.xpos[w.first + number]
        axis = turn.T @ tool[:, 2]
        lip = (away + cup.radius * self._rim @ tool.T) @ turn
        closed = np.zeros(len(lip), bool)
        for geom in np.flatnonzero(w.kind == number).tolist():
            part = w.solids[geom]
            solid, apart = part.solid, lip - np.array(part.centre)
            own = turn.T @ away - np.array(part.centre)
            for face in np.flatnonzero(solid.normals @ axis < -math.cos(FACING)):
                normal = solid.normals[face]
                if cup.studs and not _on_stud(solid.points, normal, own, cup):
                    continue
                gap = apart @ normal - solid.offsets[face]
                flat = apart - np.outer(gap, normal)
                # How far over an edge it is counts in the face, not across the one beyond.
                slope = np.linalg.norm(np.cross(solid.normals, normal), axis=1)
                beyond = flat @ solid.normals.T - solid.offsets
                inside = (beyond <= TIGHT * slope + 1e-9).all(1)
                closed |= inside & (np.abs(gap) <= cup.stroke)
        return bool(closed.all())

    def _take(self) -> None:
        """Hold the object whose face the lip is closed on, if there is one."""
        found = (
            (k, cup)
            for cup in self.suction.cups
            for k in range(self._count())
            if self.closed_on(k, cup)
        )
        number, self.used = next(found, (None, self.used))
        if number is None:
            return
        m, d, body = self.model, self.data, self.world.first + number
        point = self._lip(self.used)[0]
        m.eq_obj2id[self._weld] = body
        values = m.eq_data[self._weld]
        values[:3] = d.xmat[body].reshape(3, 3).T @ (point - d.xpos[body])
        tool = rotation_matrix(m.site_quat[self.parts.tool])
        values[3:6] = m.site_pos[self.parts.tool] + tool @ np.array(self.used.lip.at)
        turn = np.empty(4)
        mujoco.mju_negQuat(turn, d.xquat[self._hand])
        mujoco.mju_mulQuat(values[6:10], turn, d.xquat[body])
        values[10] = 1.0
        d.eq_active[self._weld] = 1
        self.held = number

    def _count(self) -> int:
        return self.model.nbody - self.world.num_still - self.world.first

    def _let_go(self) -> None:
        if self.held is not None:
            # What hung still was about to fall asleep with the hand, and would stay in the air.
            self.data.tree_asleep[self.world.tree + self.held] = AWAKE
        self.held = None
        self.data.eq_active[self._weld] = 0

    def _watch(self) -> None:
        """Compare the load with what the cup can hold."""
        row = self.row
        if row is None:
            return  # taken after this step
        force, moment = self.load(row)
        off, slip = self.used.load(force, moment)
        self.most = max(self.most[0], off), max(self.most[1], slip)
        if off > 1 and force[2] < 0 and self.used.studs:
            # What a socket presses on tilts under its face, and does not leave it.
            self._slip(min(1.0, SLIDING * (1 - 1 / off)), tilts=True)
            if self._tilt() < TIPPED:
                return
            words = f"tipped over under {-force[2]:.1f} N and {np.hypot(*moment[:2]):.2f} N m"
        elif off > 1:
            words = f"pulled off by {force[2]:.1f} N and {np.hypot(*moment[:2]):.2f} N m"
        elif slip > 1:
            self._slip(min(1.0, SLIDING * (1 - 1 / slip)))
            if self.closed_on(self.held or 0):
                return
            words = f"slipped out under {np.hypot(*force[:2]):.1f} N and {abs(moment[2]):.2f} N m"
        else:
            return
        self._let_go()
        self.lost = words

    def _tilt(self) -> float:
        """Angle between the axis of the cup and the vertical of what it holds [rad]."""
        up = self.data.xmat[self.world.first + (self.held or 0)].reshape(3, 3)[:, 2]
        cosine = -float(self._lip(self.used)[1][:, 2] @ up)
        return math.acos(min(max(cosine, -1.0), 1.0))

    def _slip(self, share: float, tilts: bool = False) -> None:
        """Let the block slip along its face, and turn on it, by a share of what it is off; or tilt
        alone."""
        m, d = self.model, self.data
        number = self.held or 0
        body, values = self.world.first + number, m.eq_data[self._weld]
        turn, (point, tool) = d.xmat[body].reshape(3, 3), self._lip(self.used)
        off = point - (d.xpos[body] + turn @ values[:3])
        off -= tool[:, 2] * (tool[:, 2] @ off)
        if not tilts:
            values[:3] += share * (turn.T @ off)
        now, error, angle = np.empty(4), np.empty(4), np.empty(3)
        mujoco.mju_negQuat(error, d.xquat[self._hand])
        mujoco.mju_mulQuat(now, error, d.xquat[body])
        mujoco.mju_negQuat(error, values[6:10])
        mujoco.mju_mulQuat(error, now, error.copy())
        mujoco.mju_quat2Vel(angle, error, 1.0)
        axis = rotation_matrix(m.site_quat[self.parts.tool]) @ np.array(self.used.lip.axis)
        about = axis * float(axis @ angle)
        about = share * (angle - about if tilts else about)
        size = float(np.linalg.norm(about))
        mujoco.mju_axisAngle2Quat(error, about / size if size > 0 else axis, size)
        mujoco.mju_mulQuat(now, error, values[6:10].copy())
        values[6:10] = now


def _on_stud(corners: np.ndarray, normal: np.ndarray, point: np.ndarray, socket: Cup) -> bool:
    """Whether a socket at a point of a face of a brick is over one of its studs; all float64 in the
    frame of the brick."""
    if normal[2] < 1 - 1e-6:
        return False
    low, high = corners.min(0)[:2], corners.max(0)[:2]
    apart = np.linalg.norm(stud_axes(low, high, socket.studs) - point[:2], axis=1)
    return bool(apart.min() <= socket.capture)
