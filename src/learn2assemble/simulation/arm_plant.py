"""One arm of a simulated cell, as a plant."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.plants.plant import (
    Commands,
    Guards,
    Motion,
    Readings,
    Report,
    Request,
    Stop,
    ToolCommand,
)
from learn2assemble.simulation.bench import Bench
from learn2assemble.simulation.disturbances import Straying
from learn2assemble.simulation.dynamic_world import DynamicWorld
from learn2assemble.simulation.objects import concerned
from learn2assemble.simulation.simulation import NOBODY, Simulation
from learn2assemble.simulation.things import check_motion, nearest

if TYPE_CHECKING:
    from learn2assemble.robot.arm import Arm

AIM = 0.03
"""The empty tool is about to take what is within this of where its cups, or pads, go [m]."""
LATELY, FACING = 0.8, 0.7
"""How a tool comes is seen from this share of the motion on; cosine of the angle between that way
and the axis of a cup that faces it. Another cup may hang beside what is not meant."""


class ArmPlant:
    """An arm among the blocks of a cell.

    Args:
        cell: in which it stands.
        sim: the arm in its simulation.
    """

    cell: DynamicWorld
    arm: Arm
    bench: Bench

    def __init__(self, cell: DynamicWorld, sim: Simulation) -> None:
        self.cell, self.arm, self.bench = cell, sim.arm, Bench(sim)
        self.needs: set[str] = set()
        """Blocks that its motion may touch."""
        self._brings: set[str] = set()
        """Blocks that follow the one that it moves."""
        sim.feels_slip = False
        sim.straying = Straying(cell.chances, sim.arm, sim.number)
        sim.put_arm(sim.joints)
        if len(cell.arms) > 1:
            sim.step = lambda: cell.clock.tick(sim.number)

    # ------------------------------------------------------------ as a plant

    def sense(self) -> Readings:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        cell, sim = self.cell, self.bench.sim
        cell.take_poses()
        return cell.seen(sim.time, *self.measured(), self.bench.feel())._replace(arm=self.arm.name)

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        cell, sim = self.cell, self.bench.sim
        check_motion(self.arm, motion.joints, sim.joints)
        self._begin()
        self._make_room(motion, bool(commands))
        share = cell.drop_share() if motion.stage == "cross" and self.bench.holding else None
        if share is not None and np.ptp(motion.joints, axis=0).any():
            at, wide = share * motion.seconds, self.arm.gripper.max_width
            loose = (
                ToolCommand(at, vacuum=False) if self.arm.suction else ToolCommand(at, width=wide)
            )
            commands = (*commands, loose)
        report = self.bench.execute(motion, commands, guards)
        self._begin()
        cell.take_poses()
        cell.note_home()
        # The hand that let go may brush all that it brought on its way up.
        if self._brings and not self.bench.holding and motion.stage in ("retreat", "home"):
            for name in self._brings:
                cell.joined.pop(name, None)
            self._brings.clear()
            cell.enter(set(cell.number))
        if report.stop == Stop.HELD:
            cell.taken()
            held = self.held()
            if held is not None:
                cell.things[held].handled = True
                if sim.clutch is not None:
                    sim.clutch.aim(cell.number[held], sim.number)
        if report.stop == Stop.CONTACT:
            cell.hardest = max(cell.hardest, self.bench.hardest, abs(report.tool.force[2]))
        if cell.push_due and motion.stage == "home" and np.ptp(motion.joints, axis=0).any():
            cell.push()
        sim.forget()
        return report

    def request(self, request: Request) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        self._begin()
        if request.what == "join":
            self._brings.add(request.block)
        return self.cell.request(request)._replace(joints=self.where())

    def stop(self) -> None:
        """See :class:`~learn2assemble.plants.plant.Plant`: an arm that was left moving brakes."""
        self.bench.brake()
        self.cell.take_poses()
        self.bench.sim.forget()

    def close(self) -> None:
        """See :class:`~learn2assemble.plants.plant.Plant`."""

    # ------------------------------------------------------------ the simulation

    def measured(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions [rad] and velocities [rad/s] of the joints, float64[n] each, as their encoders
        have them."""
        sim = self.bench.sim
        return sim.measured(), sim.data.qvel[sim.parts.joint].copy()

    def where(self) -> np.ndarray:
        """float64[n]: joints it was told to be at [rad]."""
        return self.bench.sim.joints.copy()

    def held(self) -> str | None:
        """The block in the hand."""
        sim = self.bench.sim
        if not self.bench.holding:
            return None
        return self.cell.called(sim.cup.held if sim.cup is not None else sim.target)

    def _begin(self) -> None:
        """It is the turn of this arm; others may have moved blocks before."""
        cell = self.cell
        if cell.acting is not self:
            cell.acting = self
            cell.take_poses()

    def _make_room(self, motion: Motion, switched: bool) -> None:
        """Free what a motion may touch.

        Args:
            switched: the tool is told something; one that stood there from the beginning may take
                what it is on.
        """
        cell, sim, chain = self.cell, self.bench.sim, get_chain(self.arm)
        if not len(motion.joints) or not (
            np.ptp(motion.joints, axis=0).any() or (switched and sim.target == NOBODY)
        ):
            return
        point, turn = forward(chain, motion.joints[-1])
        held = self.held()
        aim = held or nearest(cell.things, self._comes(motion, point, turn), AIM)
        if aim is None:
            return
        scene, rows = cell.scene()
        members = rows[aim]
        ends = scene.position[members]
        if not held:
            low, high = scene.bounds()
            boxes = list(zip(low[members], high[members], strict=True))
        else:
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
        self.needs = {name for name, cells in rows.items() if found[cells].any()}
        if not self.needs <= set(cell.number):
            cell.enter(self.needs | {aim})
        if not held:
            sim.aim(cell.number[aim])

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
