"""The arm for real: every pick and place is simulated, blocks are held by friction alone.

Open loop: the same commands to the same cell, without looking.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from pathlib import Path

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.dynamic.execution import (
    BLIND,
    Execution,
    ShiftRule,
    abandon,
    check_rest,
)
from learn2assemble.robot.dynamic.model import (
    TIMESTEP,
    Objects,
    Order,
    World,
    compile_world,
    hold_still,
    rigid_objects,
    take_order,
)
from learn2assemble.robot.dynamic.prepare import (
    Failure,
    WorldChecker,
    prepare,
    require_held,
    rest_pose,
)
from learn2assemble.robot.dynamic.simulation import Simulation
from learn2assemble.robot.dynamic.trajectory import Limits, load_ruckig
from learn2assemble.robot.moves import Attempt, Move, Outcome, Scene
from learn2assemble.world.blocks import FRICTION

LOADED_SPEED = 0.6
"""Share of the arm's speed that is used while the hand holds something."""
_MAX_WORLDS = 32


class DynamicCell:
    """Picks and places with one arm, in MuJoCo.

    Args:
        arm: the robot.
        speed: share of the arm's speed that is used with an empty hand (acceleration and jerk
            follow).
        recover: after a failure on the way, bring what is held back to where it was, and the arm
            home; else it stops, holding it.
        precheck: report an occupied target without moving; else the motion has to find it.
        skip_free_motion: let only the time pass while the empty hand travels far from everything.
        shift_rule: how far other blocks may be moved.
        friction: between blocks, and of blocks on the table.
        sample_steps: simulation steps of 2 ms between samples of the trajectory.
        dump: folder for model and state should the simulation diverge; a new one by default.

    Attempts depend on their arguments only. One instance serves one thread.

    Raises:
        InputError: for a value out of range.
        MissingExtraError: without the extra ``robot``.
    """

    name = "dynamic"

    def __init__(
        self,
        arm: Arm,
        *,
        speed: float = 0.8,
        recover: bool = False,
        precheck: bool = True,
        skip_free_motion: bool = False,
        shift_rule: ShiftRule | None = None,
        friction: float = FRICTION,
        sample_steps: int = 10,
        dump: Path | None = None,
    ) -> None:
        if not 0 < speed <= 1:
            raise InputError("speed", speed, "a share, above 0 and at most 1")
        if sample_steps < 1:
            raise InputError("sample_steps", sample_steps, "1 or more")
        load_ruckig()
        self.arm = arm
        full = Limits(arm.velocity, arm.acceleration, arm.jerk)
        self.limits, self.loaded = full.scaled(speed), full.scaled(LOADED_SPEED)
        self.recover, self.precheck, self.skip_free_motion = recover, precheck, skip_free_motion
        self.shift_rule = shift_rule or ShiftRule()
        self.friction, self.sample_steps, self.dump = friction, sample_steps, dump
        self._worlds: OrderedDict[tuple[object, int], World] = OrderedDict()

    def attempt(
        self,
        scene: Scene,
        move: Move,
        *,
        joints: np.ndarray | None = None,
        quaternion: np.ndarray | None = None,
    ) -> Attempt:
        """Carry out a move; the scene is left alone.

        Args:
            scene: as things are.
            move: the order; the fingers may be exchanged.
            joints: float64[n] where the arm begins [rad]; by default at home, or above it where
                something stands there.
            quaternion: float64[n, 4] orientations of the cells where not all stand upright.

        Raises:
            InputError: for a cell that is not waiting, or numbers that are not finite.
            SimulationDivergedError: where the simulation left the numbers.
        """
        order = take_order(scene, move, quaternion)
        if joints is not None:
            joints = np.array(joints, float)
            if joints.shape != self.arm.home.shape or not self.arm.inside_limits(joints):
                within = f"{len(self.arm.joints)} angles within the limits"
                raise InputError("joints", joints.tolist(), within)
        world = self.world(order.objects)
        try:
            if self.precheck:
                require_held(self.arm, scene, move)
            course = prepare(self.arm, world, order, joints, self.precheck)
        except Failure as failure:
            return _report(order, order.poses, self.arm.home if joints is None else joints, failure)
        width = order.opening if self.arm.suction is None else 0.0
        sim = Simulation(
            self.arm, world, order.poses, order.names, order.target, course.there[0], width,
            self.sample_steps, self.dump,
        )  # fmt: skip
        sim.contacts.upright = scene.half is not None
        run = Execution(sim, order, course, self.limits, self.loaded, self.skip_free_motion)
        failure = None
        try:
            run.go()
            speed = sim.speed(order.target)
            check_rest(order, sim.poses, speed, run.landed, self.shift_rule)
        except Failure as found:
            failure = abandon(run, found, self.recover)
        found = _report(order, sim.poses, sim.joints.copy(), failure)
        return found._replace(held=run.holding, trajectory=sim.trajectory(order.objects))

    def settle(
        self,
        scene: Scene,
        *,
        joints: np.ndarray | None = None,
        quaternion: np.ndarray | None = None,
        seconds: float = 2.0,
    ) -> tuple[Scene, np.ndarray, bool]:
        """Let all blocks go at once and wait: whether a whole structure stands by itself, also
        those parts that single moves hold still.

        Args:
            scene: as things are.
            joints: float64[n] where the arm is meanwhile [rad]; by default its rest pose.
            quaternion: float64[n, 4] orientations of the cells where not all stand upright.
            seconds: longest time to wait [s].

        Returns:
            the scene as it is then, float64[n, 4] orientations of its cells, and whether
            everything has come to rest.

        Raises:
            InputError: for numbers that are not finite.
            SimulationDivergedError: where the simulation left the numbers.
        """
        objects, poses, names = rigid_objects(scene, quaternion)
        world = self.world(objects)
        if joints is None:
            joints = rest_pose(self.arm, WorldChecker(self.arm, world, poses, names))
        sim = Simulation(self.arm, world, poses, names, 0, joints, 0.0, 10**9, self.dump)
        sim.wait(round(seconds / TIMESTEP), "home", BLIND._replace(until=sim.asleep))
        position, turns, yaw = objects.cells(sim.poses)
        return scene._replace(position=position, yaw=yaw), turns, sim.asleep()

    def world(self, objects: Objects) -> World:
        """The compiled cell for these objects; remembered."""
        count = len(objects.still)
        room = 64 * math.ceil(count / 64)
        known = [key for key in self._worlds if key[0] == objects.shape and key[1] >= count]
        key = known[0] if known else (objects.shape, room)
        world = self._worlds.get(key)
        if world is None:
            world = compile_world(self.arm, objects.shape, self.friction, room)
            self._worlds[key] = world
            if len(self._worlds) > _MAX_WORLDS:
                self._worlds.popitem(last=False)
        if world.num_still:
            hold_still(world, objects)
        return world


def _report(
    order: Order, poses: np.ndarray, joints: np.ndarray, failure: Failure | None
) -> Attempt:
    after, quaternion = order.after(poses)
    error = np.linalg.norm(after.position[order.scene.num_placed] - order.move.target)
    return Attempt(
        Outcome.REACHED if failure is None else failure.outcome,
        "" if failure is None else failure.stage, "" if failure is None else failure.detail,
        after=after, quaternion=quaternion, error=float(error), joints=joints,
    )  # fmt: skip
