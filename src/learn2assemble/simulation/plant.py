"""The simulated cell as a plant (``sim://``): arm and blocks together in MuJoCo.

It holds what is really the case and gives away readings. In the simulation those blocks are free
that the next motion may touch; all others are held still, so that a step costs what moves.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from learn2assemble.constants import GRAVITY
from learn2assemble.geometry.rotations import (
    matrix_quaternion,
    quaternion_matrix,
    quaternion_product,
)
from learn2assemble.motion.plant import Guard, Motion, Plant, Readings, Report, Stop, ToolCommand
from learn2assemble.motion.setup import Setup
from learn2assemble.registry import Registry
from learn2assemble.robot.kinematics import forward, get_chain
from learn2assemble.robot.moves import Scene
from learn2assemble.robot.studs import GROUND, Studs
from learn2assemble.simulation.bench import Bench
from learn2assemble.simulation.cell import DynamicCell, WorldForces
from learn2assemble.simulation.clutch import Clutch
from learn2assemble.simulation.kinematic_plant import KinematicPlant
from learn2assemble.simulation.model import SHRINK, TIMESTEP, concerned, group
from learn2assemble.simulation.simulation import BLIND, Simulation, Trace
from learn2assemble.simulation.things import SimulatedCell, check_motion, nearest

AIM = 0.03
"""The empty tool is about to take what is within this of where its cups, or pads, go [m]."""
LONGEST_REST = 2.0
"""Blocks that somebody has touched are left alone for so long at most [s]."""
MOVING = 1e-3
"""What moves faster stays free [m/s], [rad/s]."""
LATELY, FACING = 0.8, 0.7
"""How a tool comes is seen from this share of the motion on; cosine of the angle between that way
and the axis of a cup that faces it. Another cup may hang beside what is not meant."""
THINNER = 0.0
"""How much thinner boxes are on their upright sides [m]. Bricks that clutch are so by what is left
free between them, and what simulated fingers hold by :data:`~.model.SHRINK`: it drifts in the hand
by as much as a joint is wide."""
OBSTACLE = "an obstacle"
NOBODY = -9


def register_plant(table: Registry[Any]) -> None:
    """Add ``sim://`` to the plants."""
    table.register("sim", lambda rest, setup: simulated(setup))


def simulated(setup: Setup) -> Plant:
    """The simulated plant that a setup asks for."""
    kinds = {"dynamic": DynamicPlant, "kinematic": KinematicPlant}
    return kinds[setup.simulated.physics](setup)


class DynamicPlant(SimulatedCell):
    """An arm and blocks, simulated together.

    Args:
        setup: as things are meant to be.
    """

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        change = self.chances.disturbance.friction
        forces = WorldForces(setup.friction * (1 + change), GRAVITY)
        self.cell = DynamicCell(setup.arm, forces=forces)
        self.number: dict[str, int] = {}
        """Of the blocks that are free, the object that each is part of in the simulation."""
        self.offset: dict[str, np.ndarray] = {}
        """float64[3]: where they are in its frame [m], ..."""
        self.turn: dict[str, np.ndarray] = {}
        """... and float64[4], how they are turned there: what is brought as one may be turned by
        quarters."""
        self.kinds = {name: number for number, name in enumerate(setup.kinds)}
        self.pairs: dict[tuple[int, int], tuple[int, int]] = {}
        """By rows of the scene, the kinds that each joint of studs joins."""
        self.hardest = 0.0
        """What a block that was set down pressed hardest with [N]."""
        start = setup.arm.home if setup.joints is None else setup.joints
        self.bench = Bench(self._simulation(set(), start.copy(), 0.0))

    # ------------------------------------------------------------ as a plant

    def sense(self) -> Readings:
        """See :class:`~learn2assemble.motion.plant.Plant`."""
        self._take_poses()
        sim, joint = self.bench.sim, self.bench.sim.world.joint
        q, v = sim.data.qpos[joint].copy(), sim.data.qvel[joint].copy()
        return self.seen(sim.time, q, v, self.bench.feel())

    def execute(
        self,
        motion: Motion,
        commands: Sequence[ToolCommand] = (),
        guards: Sequence[Guard] = (),
    ) -> Report:
        """See :class:`~learn2assemble.motion.plant.Plant`."""
        check_motion(self.setup, motion.joints, self.bench.sim.joints)
        self._make_room(motion)
        share = self.drop_share() if motion.stage == "cross" and self.bench.holding else None
        if share is not None and np.ptp(motion.joints, axis=0).any():
            at, wide = share * motion.seconds, self.arm.gripper.max_width
            loose = (
                ToolCommand(at, vacuum=False) if self.arm.suction else ToolCommand(at, width=wide)
            )
            commands = (*commands, loose)
        report = self.bench.execute(motion, commands, guards)
        self._take_poses()
        self._note_home()
        # The hand that let go may brush all that it brought on its way up.
        if self.joined and not self.bench.holding and motion.stage in ("retreat", "home"):
            self.joined.clear()
            self._enter(set(self.number))
        if report.stop == Stop.HELD:
            self.taken()
            held = self._held()
            if held is not None:
                self.things[held].handled = True
                if self.bench.sim.clutch is not None:
                    self.bench.sim.clutch.aim(self.number[held])
        if report.stop == Stop.CONTACT:
            self.hardest = max(self.hardest, self.bench.hardest, abs(report.tool.force[2]))
        if self.push_due and motion.stage == "home" and np.ptp(motion.joints, axis=0).any():
            self.push()
        self.bench.sim.forget()
        return report

    # ------------------------------------------------------------ the simulation

    def where(self) -> np.ndarray:
        """See :class:`SimulatedCell`."""
        return self.bench.sim.joints.copy()

    def changed(self, name: str) -> None:
        """See :class:`SimulatedCell`."""
        self._enter({name})

    def come_to_rest(self) -> None:
        """See :class:`SimulatedCell`: everything is free for a while, as after a step by hand."""
        self._enter(set(self.things))
        sim = self.bench.sim
        sim.wait(round(LONGEST_REST / TIMESTEP), "home", BLIND._replace(until=sim.asleep))
        self._take_poses()
        sim.forget()

    def _take_poses(self) -> None:
        """Where the simulation has the blocks that are free."""
        poses = self.bench.sim.poses
        for name, number in self.number.items():
            if name in self.things:
                place, turn = poses[number, :3], poses[number, 3:]
                turn = turn / np.linalg.norm(turn)
                where = place + quaternion_matrix(turn) @ self.offset[name]
                turned = quaternion_product(turn, self.turn[name])
                self.things[name].pose = np.array([*where, *turned])

    def _make_room(self, motion: Motion) -> None:
        """Free what a motion may touch."""
        if not len(motion.joints) or not np.ptp(motion.joints, axis=0).any():
            return
        sim, chain = self.bench.sim, get_chain(self.arm)
        point, turn = forward(chain, motion.joints[-1])
        held = self._held()
        aim = held or nearest(self.things, self._comes(motion, point, turn), AIM)
        if aim is None:
            return
        scene, rows = self._scene()
        members = rows[aim]
        low, high = scene.bounds()
        boxes = list(zip(low[members], high[members], strict=True))
        ends = scene.position[members]
        if held:
            # Where it will be when the hand is there.
            now, rotation = sim.tool()
            change = turn @ rotation.T
            shift = point + (scene.position[members] - now) @ change.T
            turns = quaternion_matrix(scene.orientation[members])
            turned = np.array([matrix_quaternion(change @ one) for one in turns])
            there = scene.rows(members, 0)._replace(position=shift, quaternion=turned)
            boxes = list(zip(*there.bounds(), strict=True))
            ends = shift
        found = concerned(scene, members, boxes, ends)
        needed = {name for name, cells in rows.items() if found[cells].any()}
        if not needed <= set(self.number):
            self._enter(needed | {aim})
        if not held:
            self.bench.sim.aim(self.number[aim])

    def _comes(self, motion: Motion, point: np.ndarray, turn: np.ndarray) -> list[np.ndarray]:
        """float64[3] each: with what an empty tool comes to something in the end: the point between
        the pads, or the lips of the cups that face the way it comes.

        Args:
            point: of the tool at the end, with its rotation ``turn``.
        """
        if self.arm.suction is None:
            return [point]
        before = motion.at(np.array([LATELY * motion.seconds]))[0][0]
        way = point - forward(get_chain(self.arm), before)[0]
        length = float(np.linalg.norm(way))
        cups = self.arm.suction.cups
        ahead = [c for c in cups if turn @ np.array(c.lip.axis) @ way > FACING * length]
        return [point + turn @ np.array(cup.lip.at) for cup in ahead or cups]

    def _held(self) -> str | None:
        """The block in the hand."""
        sim = self.bench.sim
        if not self.bench.holding:
            return None
        number = sim.cup.held if sim.cup is not None else sim.target
        # Of several that are joined the first one is held, and brings along the others.
        return next((n for n, k in self.number.items() if k == number and n in self.things), None)

    def _moving(self) -> set[str]:
        sim = self.bench.sim
        speed = np.abs(_velocities(sim)).max(1)
        return {name for name, number in self.number.items() if speed[number] > MOVING}

    def _enter(self, free: set[str]) -> None:
        """Go on in a simulation in which these blocks are free, and what moves or is held."""
        old = self.bench.sim
        held = self._held()
        free = free | self._moving() | ({held} if held else set())
        leads = {self.joined.get(name, name) for name in free}
        free = {n for n in self.things if n in free or self.joined.get(n, n) in leads}
        numbers, speed = self.number, _velocities(old).copy()
        sim = self._simulation(free, old.joints, old.width, old.steps)
        for address in (old.world.joint, old.world.finger):
            sim.data.qpos[address] = old.data.qpos[address]
            sim.data.qvel[address] = old.data.qvel[address]
        for name, number in self.number.items():
            if name in numbers:
                _velocities(sim)[number] = speed[numbers[name]]
        sim.stage, sim.velocity, sim.drives.payload = old.stage, old.velocity, old.drives.payload
        if sim.cup is not None and old.cup is not None:
            sim.cup.take_over(old.cup, self.number[held] if held else None)
        mujoco.mj_forward(sim.model, sim.data)
        if held:
            sim.aim(self.number[held])
        self._clutch(sim, self.number[held] if held else NOBODY)
        self.bench.sim = sim

    def _simulation(
        self, free: set[str], joints: np.ndarray, width: float, begun: int = 0
    ) -> Simulation:
        scene, rows = self._scene()
        mask = np.zeros(len(scene.position), bool)
        for name in free:
            mask[rows[name]] = True
        slides = scene.studs is not None or self.arm.suction is None
        thinner = SHRINK if slides else THINNER
        objects = group(scene, scene.orientation, mask, thinner=thinner)
        of_row = {int(row): name for name, cells in rows.items() for row in cells}
        self.number = {name: int(objects.owner[rows[name][0]]) for name in sorted(free)}
        self.offset, self.turn = {}, {}
        for name, number in self.number.items():
            centre = np.array(self.things[name].kind.shape[0].centre)
            row, lead = rows[name][0], objects.lead[number]
            turn = np.array([1.0, 0.0, 0.0, 0.0])
            if row != lead:
                back = scene.orientation[lead] * (1.0, -1.0, -1.0, -1.0)
                turn = quaternion_product(back, scene.orientation[row])
            self.offset[name] = objects.offset[row] - quaternion_matrix(turn) @ centre
            self.turn[name] = turn
        leads = [of_row[row] for row in objects.lead.tolist()]
        still = [of_row.get(row, OBSTACLE) for row in np.flatnonzero(~mask).tolist()]
        poses = np.hstack([scene.position[objects.lead], scene.orientation[objects.lead]])
        self.objects, self.studs = objects, scene.studs
        world = self.cell.world(objects, scene.studs)
        table = world.model.geom("table").id
        world.model.geom_sameframe[table] = 0  # It is not where its body is.
        world.model.geom_pos[table], world.model.geom_quat[table] = self.table[:3], self.table[3:]
        sim = Simulation(
            self.arm, world, poses, [*leads, *still], NOBODY, joints, width, Trace(begun=begun)
        )
        sim.feels_slip = False
        return sim

    def _scene(self) -> tuple[Scene, dict[str, np.ndarray]]:
        """All blocks and obstacles as solids, and the rows of each block."""
        place, turn, number, half, hull, density = [], [], [], [], [], []
        rows: dict[str, np.ndarray] = {}
        fixed = [(kind, pose) for kind, pose in self.setup.fixed]
        names = list(self.things)
        lead: dict[int, int] = {}
        blocks = [(one.kind, one.pose) for one in self.things.values()]
        for k, (kind, pose) in enumerate([*fixed, *blocks]):
            axes, first = quaternion_matrix(pose[3:]), len(place)
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
        found = []
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

    def _clutch(self, sim: Simulation, held: int) -> None:
        """The joints of a simulation that is about to begin."""
        if self.studs is not None:
            sim.clutch = Clutch(sim.world, sim.data, self.objects, self.studs, held)

    def _note_home(self) -> None:
        """Which joints are home now."""
        clutch = self.bench.sim.clutch
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

    # ------------------------------------------------------------ going on elsewhere

    def state(self) -> dict[str, Any]:
        """See :class:`SimulatedCell`."""
        sim = self.bench.sim
        more = {"joints": sim.joints.tolist(), "width": float(sim.width), "steps": sim.steps}
        return super().state() | more

    def restore(self, state: dict[str, Any]) -> None:
        """See :class:`SimulatedCell`."""
        super().restore(state)
        joints = np.array(state["joints"])
        self.bench = Bench(self._simulation(set(), joints, state["width"], state["steps"]))


def _velocities(sim: Simulation) -> np.ndarray:
    """float64[b, 6] of the objects; a view."""
    return sim.data.qvel[sim.model.nv - 6 * len(sim.poses) :].reshape(-1, 6)
