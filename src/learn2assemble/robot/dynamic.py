"""The arm for real: every pick and place is simulated, blocks are held by friction alone."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path
from typing import NamedTuple

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.robot.approach import MAX_RAISES, Plan, plans, raised
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.execution import Execution, Failure
from learn2assemble.robot.mjcf import (
    Objects,
    World,
    about_z,
    compile_world,
    group,
    heading,
    matrix,
)
from learn2assemble.robot.motion import OPENING
from learn2assemble.robot.outcome import Outcome
from learn2assemble.robot.recording import Trajectory, rotated
from learn2assemble.robot.scene import Move, Scene, carried, put_down
from learn2assemble.robot.simulate import Simulation
from learn2assemble.robot.trajectory import Limits
from learn2assemble.robot.transit import Surroundings, straight_or_tree
from learn2assemble.world.blocks import EDGE, FRICTION

SHIFT_LIMIT = 0.01
"""Earlier blocks may not move so far [m] (protocol 6.2)."""
PLACE_LIMIT = 0.01
"""The object was dropped when it ends so far from where it was ordered [m]."""
HEIGHT_LIMIT = 1e-3
"""Cells of an object keep their heights, relative to each other [m] (protocol 6.2)."""
TILT_LIMIT = 0.05
"""An object that leans more [rad] has tipped."""
STILL = 0.02
"""An object that is faster at the end keeps moving [m/s]."""
_MAX_WORLDS = 32


class Attempt(NamedTuple):
    """What became of a move."""

    outcome: Outcome
    stage: str
    """Where it failed, one of :data:`~.recording.STAGES`, or ``rest``; empty for a success."""
    detail: str
    """Why, in one line; empty for a success."""
    scene: Scene
    """As things are afterwards. Where the object stands as ordered it is the last of the placed
    ones, the grasped cell first (:func:`~.scene.put_down`); else the order is that before."""
    quaternion: np.ndarray
    """float64[n, 4]: orientations (w, x, y, z) of its cells."""
    error: float
    """Distance of the grasped cell from its target [m]."""
    held: bool
    """Whether the object is still in the hand, which has stopped."""
    joints: np.ndarray
    """float64[n]: where the arm is [rad]."""
    trajectory: Trajectory | None
    """None where nothing was moved."""

    @property
    def reached(self) -> bool:
        return self.outcome == Outcome.REACHED


class DynamicCell:
    """Picks and places with one arm, in MuJoCo.

    Args:
        arm: the robot.
        speed: share of the arm's speed that is used (acceleration and jerk follow).
        loaded_speed: the same while the hand holds something.
        finish: ``home``, or ``above``: stay over the target.
        precheck: report an occupied target without moving; else the simulation has to find it.
        skip_free_motion: let only the time pass while the empty hand travels far from everything.
        shift_limit: earlier blocks may not move so far [m].
        shift_axes: 2 to compare x and y, 3 for z as well (protocol 6.2: 0.035 m and 3 in the
            one-sided cell).
        friction: between blocks, and of blocks on the table.
        sample_steps: simulation steps of 2 ms between samples of the trajectory.
        dump: folder for model and state should the simulation diverge.

    Attempts depend on their arguments only. One instance serves one thread.

    Raises:
        InputError: for a value out of range.
    """

    name = "dynamic"

    def __init__(
        self,
        arm: Arm,
        *,
        speed: float = 0.5,
        loaded_speed: float = 0.4,
        finish: str = "home",
        precheck: bool = True,
        skip_free_motion: bool = False,
        shift_limit: float = SHIFT_LIMIT,
        shift_axes: int = 2,
        friction: float = FRICTION,
        sample_steps: int = 10,
        dump: Path | None = None,
    ) -> None:
        for what, value in (("speed", speed), ("loaded_speed", loaded_speed)):
            if not 0 < value <= 1:
                raise InputError(what, value, "a share between 0 and 1")
        if finish not in ("home", "above"):
            raise InputError("finish", finish, "home or above")
        if shift_axes not in (2, 3):
            raise InputError("shift_axes", shift_axes, "2 or 3")
        self.arm = arm
        full = Limits(arm.velocity, arm.acceleration, arm.jerk)
        self.limits, self.loaded = full.scaled(speed), full.scaled(loaded_speed)
        self.finish, self.precheck, self.skip_free_motion = finish, precheck, skip_free_motion
        self.shift_limit, self.shift_axes = shift_limit, shift_axes
        self.friction, self.sample_steps, self.dump = friction, sample_steps, dump
        self._worlds: OrderedDict[object, World] = OrderedDict()

    def attempt(
        self,
        scene: Scene,
        move: Move,
        *,
        joints: np.ndarray | None = None,
        quaternion: np.ndarray | None = None,
    ) -> Attempt:
        """Carry out a move.

        Args:
            scene: as things are; it is left alone.
            move: the order.
            joints: float64[n] where the arm begins [rad]; its home pose by default.
            quaternion: float64[n, 4] orientations of the cells where not all stand upright.

        Raises:
            InputError: for a cell that is not waiting, or numbers that are not finite.
            SimulationDivergedError: where the simulation left the numbers.
        """
        return _Try(self, scene, move, joints, quaternion).attempt()

    def world(self, objects: Objects) -> World:
        """The compiled cell for these objects; remembered."""
        world = self._worlds.get(objects.shape)
        if world is None:
            world = self._worlds[objects.shape] = compile_world(
                self.arm, objects.shape, self.friction
            )
            if len(self._worlds) > _MAX_WORLDS:
                self._worlds.popitem(last=False)
        return world


class _Try:
    """An attempt in the making."""

    def __init__(
        self,
        cell: DynamicCell,
        scene: Scene,
        move: Move,
        joints: np.ndarray | None,
        quaternion: np.ndarray | None,
    ) -> None:
        if not scene.num_placed <= move.cell < len(scene.position):
            raise InputError("cell", move.cell, "the index of a waiting cell")
        self.cell, self.arm, self.scene, self.move = cell, cell.arm, scene, move
        self.joints = np.array(cell.arm.home if joints is None else joints, float)
        self.quaternion = about_z(scene.yaw) if quaternion is None else quaternion
        numbers = np.concatenate(
            [scene.position.ravel(), self.quaternion.ravel(), move.target, self.joints]
        )
        if not np.isfinite(numbers).all():
            raise InputError("scene", scene.position.tolist(), "finite numbers")
        self.objects = objects = group(scene, self.quaternion)
        self.world = cell.world(objects)
        self.poses = np.hstack([scene.position[objects.lead], self.quaternion[objects.lead]])
        self.names = [f"block {k}" for k in objects.lead]
        self.target = int(objects.owner[move.cell])

    def attempt(self) -> Attempt:
        around = Surroundings(self.arm, self.world, self.poses, self.names)
        try:
            plan, ways = self.prepare(around)
        except Failure as failure:
            return self.untouched(failure)
        sim = Simulation(
            self.arm, self.world, self.poses, self.names, self.target, self.joints, OPENING,
            self.cell.sample_steps, self.cell.dump,
        )  # fmt: skip
        execution = Execution(sim, self.cell.limits, self.cell.loaded, self.cell.skip_free_motion)
        try:
            execution.run(plan, ways)
        except Failure as failure:
            held = not execution.released and failure.outcome in (
                Outcome.PLACE_COLLISION, Outcome.GRASP_COLLISION
            ) and sim.stage in ("lift", "cross", "place")
            execution.settle(sim.stage)
            return self.report(sim, failure, held)
        return self.report(sim, self.verdict(sim, execution), False)

    # ------------------------------------------------------------ before moving

    def prepare(
        self, around: Surroundings
    ) -> tuple[Plan, tuple[np.ndarray, np.ndarray, np.ndarray | None]]:
        """A plan with its free ways.

        Raises:
            Failure: where there is none.
        """
        found, stage, reason = plans(self.arm, self.scene, self.move)
        if not found:
            raise Failure(Outcome.UNREACHABLE, stage, reason)
        if self.cell.precheck:
            self.check_target(around, found[0])
        plan = next((plan for plan in found if self.looks_free(around, plan)), found[0])
        plan, across = self.across(around, plan)
        around.empty(OPENING)
        there = straight_or_tree(around, self.joints, plan.pick.joints[-1])
        if isinstance(there, str):
            raise Failure(Outcome.UNREACHABLE, "approach", there)
        home = None
        if self.cell.finish == "home":
            around.put(self.target, *self.in_world(plan), OPENING)
            home = straight_or_tree(around, plan.place.joints[-1], self.arm.home)
            if isinstance(home, str):
                raise Failure(Outcome.UNREACHABLE, "home", home)
        return plan, (there, across, home)

    def in_hand(self, plan: Plan) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the object in the tool frame when it is grasped: float64[3] [m], [3, 3]."""
        tool = plan.move.grasp.rotation()
        start = plan.move.grasp.tool_point(self.scene.position[plan.move.cell])
        pose = self.poses[self.target]
        return tool.T @ (pose[:3] - start), tool.T @ matrix(pose[3:])

    def in_world(self, plan: Plan) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the object when it is placed: float64[3] [m] and float64[3, 3]."""
        position, rotation = self.in_hand(plan)
        tool, contact = plan.move.place.rotation(), plan.move.place.tool_point(self.move.target)
        return contact + tool @ position, tool @ rotation

    def check_target(self, around: Surroundings, plan: Plan) -> None:
        around.put(self.target, *self.in_world(plan), OPENING)
        hit = around.overlap(self.target)
        if hit is not None:
            raise Failure(Outcome.PLACE_COLLISION, "place", f"the target is occupied: {hit}")

    def looks_free(self, around: Surroundings, plan: Plan) -> bool:
        around.empty(OPENING)
        if any(around.touch(q) for q in plan.pick.joints[1::2]):
            return False
        around.carry(self.target, *self.in_hand(plan), EDGE)
        return not any(around.touch(q) for q in plan.place.joints[1::2])

    def across(self, around: Surroundings, plan: Plan) -> tuple[Plan, np.ndarray]:
        """The plan, raised where that gives a straight free way, and the way."""
        around.carry(self.target, *self.in_hand(plan), EDGE)
        hit = around.blocked(plan.pick.joints[-1], plan.place.joints[-1])
        for levels in range(1, MAX_RAISES + 1) if hit else ():
            higher = raised(self.arm, self.scene, plan, levels)
            if higher is None:
                break
            ends = higher.pick.joints[-1], higher.place.joints[-1]
            if around.blocked(*ends) is None:
                return higher, np.array(ends)
        way = straight_or_tree(around, plan.pick.joints[-1], plan.place.joints[-1])
        if isinstance(way, str):
            raise Failure(Outcome.UNREACHABLE, "cross", way)
        return plan, way

    # ------------------------------------------------------------ afterwards

    def verdict(self, sim: Simulation, execution: Execution) -> Failure | None:
        """What is wrong after a motion that went as planned."""
        cells = self.cells(sim)
        mine = self.objects.owner == self.target
        shift = cells[0] - self.scene.position
        away = np.where(mine, 0.0, np.linalg.norm(shift[:, : self.cell.shift_axes], axis=1))
        if away.max() >= self.cell.shift_limit:
            k = int(np.argmax(away))
            detail = f"block {k} moved by {1e3 * away[k]:.0f} mm"
            return Failure(Outcome.DISTURBED_STRUCTURE, "rest", detail)
        members = self.scene.members(self.move.cell)
        ordered, _ = carried(self.scene, self.move, members)
        sunk = cells[0][members, 2] - ordered[:, 2]
        lean = tilt(self.quaternion[self.move.cell], cells[1][self.move.cell])
        tipped = np.ptp(sunk) > HEIGHT_LIMIT or lean > TILT_LIMIT
        missed = np.linalg.norm(cells[0][members] - ordered, axis=1).max()
        name = self.names[self.target]
        if missed > PLACE_LIMIT and not (tipped and execution.landed):
            detail = f"{name} ended {1e3 * missed:.0f} mm from its place"
            return Failure(Outcome.DROPPED, "rest", detail)
        if tipped:
            detail = f"{name} leans by {np.degrees(lean):.0f} degrees"
            return Failure(Outcome.UNSTABLE, "rest", detail)
        speed = sim.speed(self.target)
        if speed > STILL:
            return Failure(Outcome.UNSTABLE, "rest", f"{name} still moves at {speed:.2f} m/s")
        return None

    def cells(self, sim: Simulation) -> tuple[np.ndarray, np.ndarray]:
        """Centres float64[n, 3] [m] and orientations float64[n, 4] of the cells now."""
        pose = sim.poses[self.objects.owner]
        return pose[:, :3] + rotated(pose[:, 3:], self.objects.offset), pose[:, 3:].copy()

    def report(self, sim: Simulation, failure: Failure | None, held: bool) -> Attempt:
        position, quaternion = self.cells(sim)
        yaw = np.array([heading(matrix(q)) for q in quaternion])
        scene = self.scene._replace(position=position, yaw=yaw)
        error = float(np.linalg.norm(position[self.move.cell] - self.move.target))
        if not held and error <= PLACE_LIMIT:
            members = scene.members(self.move.cell)
            order = put_down(scene._replace(yaw=np.arange(len(yaw), dtype=float)), self.move)
            del order, members
        return Attempt(
            Outcome.REACHED if failure is None else failure.outcome,
            failure.stage if failure else "", failure.detail if failure else "",
            scene, quaternion, error, held, sim.joints.copy(),
            sim.recorder.trajectory(self.objects.owner, self.objects.offset),
        )  # fmt: skip

    def untouched(self, failure: Failure) -> Attempt:
        error = float(np.linalg.norm(self.scene.position[self.move.cell] - self.move.target))
        return Attempt(
            failure.outcome, failure.stage, failure.detail, self.scene, self.quaternion.copy(),
            error, False, self.joints, None,
        )  # fmt: skip


def tilt(before: np.ndarray, after: np.ndarray) -> float:
    """Angle [rad] by which a body with quaternions before and after has turned off the vertical."""
    up = matrix(before)[2]
    return float(np.arccos(np.clip(matrix(after)[2] @ up, -1.0, 1.0)))
