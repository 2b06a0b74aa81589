"""A cell with arms and blocks, simulated together: which blocks are free to move, and what goes on
when that changes.

In the simulation those blocks are free that the next motions may touch; all others are held still,
so that a step costs what moves.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import mujoco
import numpy as np

from learn2assemble.constants import GRAVITY
from learn2assemble.geometry.hulls import Hull
from learn2assemble.geometry.rotations import quaternion_matrix, quaternion_product
from learn2assemble.plants.setup import Setup
from learn2assemble.robot.moves import Scene
from learn2assemble.robot.studs import GROUND, StudJoint, Studs
from learn2assemble.simulation.bench import Bench
from learn2assemble.simulation.clock import SharedClock
from learn2assemble.simulation.clutch import NOTHING_MADE, Clutch, Made
from learn2assemble.simulation.contacts import BLIND
from learn2assemble.simulation.model import TIMESTEP
from learn2assemble.simulation.objects import SHRINK, Objects, group
from learn2assemble.simulation.simulation import NOBODY, SimulatedState
from learn2assemble.simulation.things import SimulatedCell
from learn2assemble.simulation.worlds import WorldForces, Worlds

if TYPE_CHECKING:
    from collections.abc import Sequence

    from learn2assemble.robot.arm import Arm

LONGEST_REST = 2.0
"""Blocks that somebody has touched are left alone for so long at most [s]."""
MOVING = 1e-3
"""What moves faster stays free [m/s], [rad/s]."""
THINNER = 0.0
"""How much thinner boxes are on their upright sides [m]. Bricks that clutch are so by what is left
free between them, and what simulated fingers hold by :data:`~.objects.SHRINK`: it drifts in the
hand by as much as a joint is wide."""
OBSTACLE = "an obstacle"


class ArmInCell(Protocol):
    """What a cell asks of an arm in it."""

    bench: Bench
    needs: set[str]
    """Blocks that its motion may touch."""

    def held(self) -> str | None:
        """The block in its hand."""
        ...


class DynamicWorld(SimulatedCell):
    """Arms and blocks, simulated together.

    Args:
        setup: as things are meant to be.
    """

    objects: Objects
    studs: Studs | None

    simulated: SimulatedState
    plants: tuple[ArmInCell, ...]
    acting: ArmInCell
    """The arm whose motion something happens during."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        change = self.chances.disturbance.friction
        forces = WorldForces(setup.friction * (1 + change), GRAVITY)
        self.arms: tuple[Arm, ...] = (setup.arm, *setup.others)
        self.worlds: Worlds = Worlds(self.arms, forces)
        self.number: dict[str, int] = {}
        """Of the blocks that are free, the object that each is part of in the simulation."""
        self.offset: dict[str, np.ndarray] = {}
        """float64[3]: where they are in its frame [m], ..."""
        self.turn: dict[str, np.ndarray] = {}
        """... and float64[4], how they are turned there: what is brought as one may be turned by
        quarters."""
        self.alone: set[str] = set()
        """Those whose frame is that of the object."""
        self.kinds: dict[str, int] = {name: number for number, name in enumerate(setup.kinds)}
        self.pairs: dict[tuple[int, int], tuple[int, int]] = {}
        """By rows of the scene, the kinds that each joint of studs joins."""
        self.hardest: float = 0.0
        """What a block that was set down pressed hardest with [N]."""
        self.clock: SharedClock = SharedClock(self._advance)

    def _advance(self, moving: frozenset[int]) -> None:
        """A step of time, in which these arms do what they were told, and others stand."""
        idle = [one.bench.sim for n, one in enumerate(self.plants) if n not in moving]
        for sim in idle:
            sim.stand()
        self.simulated.step()
        for sim in idle:
            sim.stood()

    def in_hand(self, name: str) -> bool:
        """See :class:`SimulatedCell`."""
        return any(one.held() == name for one in self.plants)

    def changed(self, name: str) -> None:
        """See :class:`SimulatedCell`."""
        self.enter({name})

    def come_to_rest(self) -> None:
        """See :class:`SimulatedCell`: everything is free for a while, as after a step by hand."""
        self.enter(set(self.things))
        sim = self.acting.bench.sim
        sim.wait(round(LONGEST_REST / TIMESTEP), "home", BLIND._replace(until=sim.asleep))
        self.take_poses()
        sim.forget()

    def take_poses(self) -> None:
        """Where the simulation has the blocks that are free."""
        for name in self.number:
            if name in self.things:
                self.things[name].pose = self.pose_now(name)

    def pose_now(self, name: str) -> np.ndarray:
        """float64[7]: where the simulation has a block that is free."""
        pose = self.simulated.poses[self.number[name]]
        turn = pose[3:] / np.linalg.norm(pose[3:])
        if name in self.alone:
            return np.concatenate([pose[:3], turn])
        where = pose[:3] + quaternion_matrix(turn) @ self.offset[name]
        return np.array([*where, *quaternion_product(turn, self.turn[name])])

    def called(self, number: int | None) -> str | None:
        """The block that an object of the simulation is."""
        # Of several that are joined the first one is held, and brings along the others.
        return next((n for n, k in self.number.items() if k == number and n in self.things), None)

    def _moving(self) -> set[str]:
        speed = np.abs(self._velocities()).max(1)
        return {name for name, number in self.number.items() if speed[number] > MOVING}

    def _velocities(self) -> np.ndarray:
        """float64[b, 6] of the objects; a view."""
        state = self.simulated
        return state.data.qvel[state.model.nv - 6 * len(state.poses) :].reshape(-1, 6)

    def enter(self, free: set[str]) -> None:
        """Go on in a state in which these blocks are free, and those that another arm may touch,
        that move, or that are held."""
        old, others = self.simulated, [one for one in self.plants if one is not self.acting]
        held = [one.held() for one in self.plants]
        # Another arm may be on its way to something.
        aims = [
            one.held() if one is self.acting else self.called(one.bench.sim.target)
            for one in self.plants
        ]
        free = free | self._moving() | {name for name in (*held, *aims) if name}
        free = free.union(*(one.needs for one in others))
        leads = {self.joined.get(name, name) for name in free}
        free = {n for n in self.things if n in free or self.joined.get(n, n) in leads}
        numbers, speed = self.number, self._velocities().copy()
        # Another arm may be pressing.
        self.note_home()
        made = self._hands()
        self.simulated = state = self._state(free, old.steps)
        before = [one.bench.sim.leave(state) for one in self.plants]
        for one in self.plants:
            parts = one.bench.sim.parts
            for address in (parts.joint, parts.finger):
                state.data.qpos[address] = old.data.qpos[address]
                state.data.qvel[address] = old.data.qvel[address]
        for name, number in self.number.items():
            if name in numbers:
                self._velocities()[number] = speed[numbers[name]]
        for one, left, name in zip(self.plants, before, held, strict=True):
            one.bench.sim.go_on(left, self.number[name] if name else None)
        # Before the forces of this moment are found: another arm may look at them next.
        state.data.ctrl[:] = old.data.ctrl
        mujoco.mj_forward(state.model, state.data)
        for one, name in zip(self.plants, aims, strict=True):
            if name:
                one.bench.sim.aim(self.number[name])
        self._clutch([self.number[name] if name else NOBODY for name in held], made)

    def _state(self, free: set[str], begun: int) -> SimulatedState:
        scene, rows = self.scene()
        mask = np.zeros(len(scene.position), bool)
        for name in free:
            mask[rows[name]] = True
        slides = scene.studs is not None or any(arm.suction is None for arm in self.arms)
        thinner = SHRINK if slides else THINNER
        objects = group(scene, scene.orientation, mask, thinner=thinner)
        of_row = {int(row): name for name, cells in rows.items() for row in cells}
        self.number = {name: int(objects.owner[rows[name][0]]) for name in sorted(free)}
        self.offset, self.turn, self.alone = {}, {}, set()
        for name, number in self.number.items():
            centre = np.array(self.things[name].kind.shape[0].centre)
            row, lead = rows[name][0], objects.lead[number]
            turn = np.array([1.0, 0.0, 0.0, 0.0])
            if row != lead:
                back = scene.orientation[lead] * (1.0, -1.0, -1.0, -1.0)
                turn = quaternion_product(back, scene.orientation[row])
            self.offset[name] = objects.offset[row] - quaternion_matrix(turn) @ centre
            self.turn[name] = turn
            if row == lead and not self.offset[name].any():
                self.alone.add(name)
        leads = [of_row[row] for row in objects.lead.tolist()]
        still = [of_row.get(row, OBSTACLE) for row in np.flatnonzero(~mask).tolist()]
        poses = np.hstack([scene.position[objects.lead], scene.orientation[objects.lead]])
        self.objects, self.studs = objects, scene.studs
        world = self.worlds.of(objects, scene.studs)
        table = world.model.geom("table").id
        world.model.geom_sameframe[table] = 0  # It is not where its body is.
        world.model.geom_pos[table], world.model.geom_quat[table] = self.table[:3], self.table[3:]
        return SimulatedState(world, poses, [*leads, *still], begun)

    def scene(self) -> tuple[Scene, dict[str, np.ndarray]]:
        """All blocks and obstacles as solids, and the rows of each block."""
        place, turn, half = list[np.ndarray](), list[np.ndarray](), list[tuple[float, ...]]()
        number, hull, density = list[int](), list[Hull | None](), list[float]()
        rows: dict[str, np.ndarray] = {}
        fixed = [(kind, pose) for kind, pose in self.setup.fixed]
        names = list(self.things)
        lead: dict[int, int] = {}
        solids = [*fixed, *((one.kind, one.pose) for one in self.things.values())]
        turned = quaternion_matrix(np.array([pose[3:] for _, pose in solids]).reshape(-1, 4))
        for k, ((kind, pose), axes) in enumerate(zip(solids, turned, strict=True)):
            first = len(place)
            for part in kind.shape:
                place.append(pose[:3] + axes @ np.array(part.centre))
                turn.append(pose[3:])
                number.append(k if k < len(fixed) else self._one_with(names, k - len(fixed)))
                half.append(part.half)
                hull.append(part.hull)
                density.append(kind.density)
            if k >= len(fixed):
                lead[self._kind(names[k - len(fixed)])] = first
                rows[names[k - len(fixed)]] = np.arange(first, len(place))
        turns = np.array(turn, float).reshape(-1, 4)
        axes = quaternion_matrix(turns)
        return Scene(
            np.array(place, float).reshape(-1, 3),
            np.arctan2(axes[:, 1, 0], axes[:, 0, 0]),
            np.array(number, np.int64),
            0,
            np.array(half, float).reshape(-1, 3),
            np.array(density, float),
            turns,
            tuple(hull) if any(hull) else None,
            self._studs(lead),
        ), rows

    def _kind(self, name: str) -> int:
        """Number of the kind of a block."""
        return self.kinds[self.things[name].like]

    def _studs(self, lead: dict[int, int]) -> Studs | None:
        """The joints of studs of blocks that are there, in rows of the scene.

        Args:
            lead: the first row of a block of each kind.
        """
        told = self.setup.studs
        if told is None:
            return None
        found: list[StudJoint] = []
        for joint in told.joints:
            if joint.upper in lead and (joint.lower == GROUND or joint.lower in lead):
                lower = GROUND if joint.lower == GROUND else lead[joint.lower]
                home = (joint.lower, joint.upper) in self.home
                found.append(joint._replace(lower=lower, upper=lead[joint.upper], home=home))
        self.pairs = {
            (one.lower, one.upper): (old.lower, old.upper)
            for one, old in zip(
                found,
                (
                    j
                    for j in told.joints
                    if j.upper in lead and (j.lower == GROUND or j.lower in lead)
                ),
                strict=True,
            )
        }
        return Studs(tuple(found), told.press)

    def _clutch(self, held: Sequence[int], made: Made = NOTHING_MADE) -> None:
        """The joints of the state that is about to begin.

        Args:
            held: number of what each arm holds.
            made: what hands have made so far, by kinds.
        """
        if self.studs is not None:
            state, row = self.simulated, {pair: cells for cells, pair in self.pairs.items()}
            made = made.named(row)
            state.clutch = Clutch(state.world, state.data, self.objects, self.studs, held, made)

    def _hands(self) -> Made:
        """What hands have made so far and still hold, by kinds."""
        clutch = self.simulated.clutch
        return NOTHING_MADE if clutch is None else clutch.made.named(self.pairs)

    def note_home(self) -> None:
        """Which joints are home now."""
        clutch = self.simulated.clutch
        if clutch is not None:
            for joint in clutch.joints:
                pair = self.pairs[joint.lower, joint.upper]
                self.home.discard(pair)
                if joint.home:
                    self.home.add(pair)

    def _one_with(self, names: list[str], k: int) -> int:
        """Number of the object that a block is part of: that of the block it is joined to."""
        lead = self.joined.get(names[k])
        return len(self.setup.fixed) + (k if lead is None else names.index(lead))
