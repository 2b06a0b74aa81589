"""The arm for real: every pick and place is simulated, blocks are held by friction alone.

Open loop: the same commands to the same cell, without looking.
"""

from __future__ import annotations

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.handling.execution import Execution, Rig
from learn2assemble.handling.prepare import prepare, require_held, rest_pose
from learn2assemble.handling.recovery import abandon
from learn2assemble.handling.rest import ShiftRule, check_rest
from learn2assemble.handling.ways import WorldChecker
from learn2assemble.kinematics.time_law import load_ruckig
from learn2assemble.plants.plant import BlockReading, Readings, Report, Request
from learn2assemble.robot.arm import Arm, Limits
from learn2assemble.robot.moves import Attempt, Failure, Move, Outcome, Scene
from learn2assemble.robot.scene import rotation_matrix
from learn2assemble.robot.studs import Studs
from learn2assemble.simulation.bench import Bench
from learn2assemble.simulation.clutch import Clutch
from learn2assemble.simulation.contacts import BLIND
from learn2assemble.simulation.model import TIMESTEP, SimulatedWorld
from learn2assemble.simulation.objects import Objects, Order, rigid_objects, take_order
from learn2assemble.simulation.simulation import SimulatedState, Simulation, Trace
from learn2assemble.simulation.worlds import WorldForces, Worlds

LOADED_SPEED = 0.6
"""Share of the arm's speed that is used while the hand holds something."""
REST_TIME = 1.0
"""Longest time to wait for rest after a move [s]."""
SETTLE_TIME = 2.0
"""Longest time to wait for a whole structure to rest [s]."""


_USUAL, _TRACE = WorldForces(), Trace()


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
        forces: of the world.
        trace: what simulations leave.

    Attempts depend on their arguments only. One instance serves one thread.

    Raises:
        InputError: for a value out of range.
        MissingExtraError: without the extra ``robot``.
    """

    limits: Limits
    loaded: Limits
    recover: bool
    precheck: bool
    skip_free_motion: bool
    trace: Trace
    worlds: Worlds

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
        forces: WorldForces = _USUAL,
        trace: Trace = _TRACE,
    ) -> None:
        if not 0 < speed <= 1:
            raise InputError("speed", speed, "a share, above 0 and at most 1")
        if trace.sample_steps < 1:
            raise InputError("sample_steps", trace.sample_steps, "1 or more")
        load_ruckig()
        self.arm = arm
        self.limits, self.loaded = arm.bounds.scaled(speed), arm.bounds.scaled(LOADED_SPEED)
        self.recover, self.precheck, self.skip_free_motion = recover, precheck, skip_free_motion
        self.shift_rule: ShiftRule = shift_rule or ShiftRule()
        self.trace, self.worlds = trace, Worlds((arm,), forces)

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
        world = self.world(order.objects, scene.studs)
        try:
            if self.precheck:
                require_held(self.arm, scene, move)
            course = prepare(self.arm, world, order, joints, self.precheck)
        except Failure as failure:
            return _report(order, order.poses, self.arm.home if joints is None else joints, failure)
        width = order.opening if self.arm.suction is None else 0.0
        state = SimulatedState(world, order.poses, order.names, dump=self.trace.dump)
        sim = Simulation(state, self.arm, course.there[0], width, order.target, self.trace)
        state.clutch = clutch_of(sim, order.objects, scene.studs, order.target)
        known = ExactSenses(sim, order, self.skip_free_motion)
        rig = Rig(known, known, self.arm, world, self.limits, self.loaded)
        run = Execution(rig, order, course, sim.joints)
        failure = None
        try:
            known.settle("approach")
            run.bring()
            run.leave()
            known.settle("home")
            speed = sim.speed(order.target)
            check_rest(order, sim.poses, speed, run.landed, self.shift_rule)
            known.check_home()
        except Failure as found:
            failure = abandon(run, found, self.recover)
        found = _report(order, sim.poses, sim.joints.copy(), failure)
        home = None if sim.clutch is None else sim.clutch.home
        return found._replace(held=run.holding, trajectory=sim.trajectory(order.objects), home=home)

    def settle(
        self,
        scene: Scene,
        quaternion: np.ndarray | None = None,
    ) -> tuple[Scene, np.ndarray, bool]:
        """Let all blocks go at once and wait: whether a whole structure stands by itself, also
        those parts that single moves hold still.

        Args:
            scene: as things are.
            quaternion: float64[n, 4] orientations of the cells where not all stand upright.

        Returns:
            the scene as it is then, float64[n, 4] orientations of its cells, and whether
            everything has come to rest.

        Raises:
            InputError: for numbers that are not finite.
            SimulationDivergedError: where the simulation left the numbers.
        """
        objects, poses, names = rigid_objects(scene, quaternion)
        world = self.world(objects, scene.studs)
        joints = rest_pose(self.arm, WorldChecker(self.arm, world, poses, names))
        state = SimulatedState(world, poses, names, dump=self.trace.dump)
        trace = self.trace._replace(sample_steps=10**9)
        sim = Simulation(state, self.arm, joints, 0.0, 0, trace)
        state.clutch = clutch_of(sim, objects, scene.studs, -1)
        sim.wait(round(SETTLE_TIME / TIMESTEP), "home", BLIND._replace(until=sim.asleep))
        position, turns, yaw = objects.cells(sim.poses)
        there = None if scene.quaternion is None else turns
        after = scene._replace(position=position, yaw=yaw, quaternion=there)
        return after, turns, sim.asleep()

    def world(self, objects: Objects, studs: Studs | None = None) -> SimulatedWorld:
        """See :meth:`Worlds.of`."""
        return self.worlds.of(objects, studs)


def clutch_of(sim: Simulation, objects: Objects, studs: Studs | None, target: int) -> Clutch | None:
    """The joints of studs of a simulation that is about to begin."""
    return None if studs is None else Clutch(sim.world, sim.data, objects, studs, [target])


class ExactSenses(Bench):
    """The simulation of one attempt as a plant, and what is known of it: everything, exactly."""

    def __init__(self, sim: Simulation, order: Order, skip_free: bool) -> None:
        super().__init__(sim, skip_free)
        self.order = order

    def sense(self) -> Readings:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        sim, exact = self.sim, np.zeros((6, 6))
        poses = zip(self.order.names, sim.poses.copy(), strict=False)
        blocks = tuple(BlockReading(name, pose, exact, sim.time) for name, pose in poses)
        return Readings(sim.time, sim.joints, sim.velocity, blocks, self.feel(), sim.arm.name)

    def request(self, request: Request) -> Report:
        """Nobody else is in this cell."""
        raise InputError("request", request.what, "none, in the cell of a single move")

    def stop(self) -> None:
        """It stands between two motions."""

    def close(self) -> None:
        """Nothing is kept open."""

    def check_home(self) -> None:
        """Refuse a brick that is not home at the end.

        Raises:
            Failure: TOPPLED.
        """
        clutch = self.sim.clutch
        if clutch is not None and clutch.loose:
            name = self.order.names[self.order.target]
            words = f"pressed with {self.hardest:.1f} N of {clutch.press:g} N"
            raise Failure(Outcome.TOPPLED, "rest", f"{name} is loose on its studs, {words}")

    def settle(self, stage: str) -> None:
        """See :class:`~learn2assemble.handling.execution.Senses`."""
        sim = self.sim
        rest = BLIND._replace(until=lambda: sim.asleep(besides=self.holding))
        sim.let_go()
        sim.wait(round(REST_TIME / TIMESTEP), stage, rest)

    def taken(self) -> None:
        """It is known anyway."""

    def let_go(self) -> None:
        """It is known anyway."""

    def lost(self) -> None:
        """It is known anyway."""

    def in_hand(self) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`~learn2assemble.handling.execution.Senses`."""
        sim = self.sim
        position, rotation = sim.tool()
        pose = sim.poses[sim.target]
        return rotation.T @ (pose[:3] - position), rotation.T @ rotation_matrix(pose[3:])

    def look(self) -> np.ndarray:
        """See :class:`~learn2assemble.handling.execution.Senses`."""
        return self.sim.poses.copy()


def _report(
    order: Order, poses: np.ndarray, joints: np.ndarray, failure: Failure | None
) -> Attempt:
    after, quaternion = order.after(poses)
    error = np.linalg.norm(after.position[order.scene.num_placed] - order.move.target)
    return Attempt(
        Outcome.REACHED if failure is None else failure.outcome,
        "" if failure is None else failure.stage,
        "" if failure is None else failure.detail,
        after=after,
        quaternion=quaternion,
        error=float(error),
        joints=joints,
    )
