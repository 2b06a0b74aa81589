"""The arm for real: every pick and place is simulated, blocks are held by friction alone."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.attempt import Attempt
from learn2assemble.robot.execution import Execution
from learn2assemble.robot.mjcf import Objects, World, compile_world
from learn2assemble.robot.motion import OPENING
from learn2assemble.robot.order import Order, take_order
from learn2assemble.robot.outcome import Outcome
from learn2assemble.robot.prepare import Failure, prepare
from learn2assemble.robot.recovery import abandon
from learn2assemble.robot.resting import ShiftRule, check_rest
from learn2assemble.robot.scene import Move, Scene
from learn2assemble.robot.simulate import Simulation
from learn2assemble.robot.trajectory import Limits
from learn2assemble.world.blocks import FRICTION

_MAX_WORLDS = 32


class DynamicCell:
    """Picks and places with one arm, in MuJoCo.

    Args:
        arm: the robot.
        speed: share of the arm's speed that is used with an empty hand (acceleration and jerk
            follow).
        loaded_speed: the same while the hand holds something.
        correct: look where the object sits in the hand before lowering it, and correct the target
            by that, as the published integral term does (protocol 8.4).
        finish: ``home`` (or above it where something stands there), or ``above``: stay over the
            target.
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
    """

    name = "dynamic"

    def __init__(
        self,
        arm: Arm,
        *,
        speed: float = 0.8,
        loaded_speed: float = 0.6,
        correct: bool = True,
        finish: str = "home",
        recover: bool = False,
        precheck: bool = True,
        skip_free_motion: bool = False,
        shift_rule: ShiftRule | None = None,
        friction: float = FRICTION,
        sample_steps: int = 10,
        dump: Path | None = None,
    ) -> None:
        for what, value in (("speed", speed), ("loaded_speed", loaded_speed)):
            if not 0 < value <= 1:
                raise InputError(what, value, "a share, above 0 and at most 1")
        if finish not in ("home", "above"):
            raise InputError("finish", finish, "home or above")
        if sample_steps < 1:
            raise InputError("sample_steps", sample_steps, "1 or more")
        self.arm = arm
        full = Limits(arm.velocity, arm.acceleration, arm.jerk)
        self.limits, self.loaded = full.scaled(speed), full.scaled(loaded_speed)
        self.correct, self.finish, self.recover = correct, finish, recover
        self.precheck, self.skip_free_motion = precheck, skip_free_motion
        self.shift_rule = shift_rule or ShiftRule()
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
            course = prepare(
                self.arm, world, order, joints, self.finish == "home", self.precheck
            )  # fmt: skip
        except Failure as failure:
            return _report(order, order.poses, self.arm.home if joints is None else joints, failure)
        sim = Simulation(
            self.arm, world, order.poses, order.names, order.target, course.there[0], OPENING,
            self.sample_steps, self.dump,
        )  # fmt: skip
        run = Execution(sim, order, course, self.limits, self.loaded)
        run.correct, run.skip_free = self.correct, self.skip_free_motion
        failure = None
        try:
            run.go()
            speed = sim.speed(order.target)
            check_rest(order, sim.poses, speed, run.landed, self.shift_rule)
        except Failure as found:
            failure = abandon(run, found, self.recover)
        trajectory = sim.recorder.trajectory(order.objects.owner, order.objects.offset)
        found = _report(order, sim.poses, sim.joints.copy(), failure)
        return found._replace(held=run.holding, trajectory=trajectory)

    def world(self, objects: Objects) -> World:
        """The compiled cell for these objects; remembered."""
        world = self._worlds.get(objects.shape)
        if world is None:
            world = compile_world(self.arm, objects.shape, self.friction)
            self._worlds[objects.shape] = world
            if len(self._worlds) > _MAX_WORLDS:
                self._worlds.popitem(last=False)
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
