"""The released fast mode of the authors' robot cell, to compare with what they recorded.

Free motions are teleports, the grasp is a constraint, the links of the arm touch nothing, the
fingers stay open, and inverse kinematics knows no joint limits and plans no way.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from typing import NamedTuple

import numpy as np

from l2a_lab.bullet.inverse import solve_as_published
from l2a_lab.bullet.resolution import HAND, TABLE
from l2a_lab.bullet.world import (
    GRASP_STARTS,
    HOME,
    PLACE_STARTS,
    TIMESTEP,
    BulletWorld,
    turned,
)
from learn2assemble.constants import EDGE, HALF
from learn2assemble.errors import InputError, look_up
from learn2assemble.robot.arm import Arm, get_arm
from learn2assemble.robot.grasps import get_grasps
from learn2assemble.robot.moves import Attempt, Move, Outcome, Scene, put_down
from learn2assemble.tasks.checkers import ArmPhysics
from learn2assemble.tasks.physics.protocol import Physics
from learn2assemble.tasks.task import Task

OPENING = 0.08
"""Between the pads [m]: the fingers are told to open farther, but their stops hold them."""
ABOVE, BEFORE, LIFTED = 0.15, 0.05, 0.20
"""Heights of the tool over the block while approaching and after the grasp [m]."""
APPROACH_STEPS, IDLE_STEPS, OPEN_STEPS, WAIT_STEPS = 25, 10, 50, 200
WAYPOINTS = ((0.25, 50), (0.025, 50), (0.010, 50), (0.005, 100))
"""Heights of the held block over its target [m], and steps to get there (8.4)."""
TOP_WAYPOINTS = ((0.20, 50), (0.025, 50), (0.005, 50), (0.005, 100))
"""The same for a cube that goes on top of its reference."""
AWAY = ((0.0, 0.0, 0.10), (0.0, 0.0, 0.25), (0.0, -0.15, 0.25))
"""Of the retreat, relative to the reference's level [m]; of the last only the position matters."""
SERVO_GAIN, INTEGRAL_GAIN, NEAR = 0.5, 0.0075, 0.01
"""Share of the way that is commanded, share of the accumulated error, and the error below which
it accumulates [m]."""
WATCH_LIMIT, RELEASE_LIMIT = 1.0, 0.75
"""Largest sum over steps of |vx| + |vy| + |vz| of a waiting cell while the hand comes, and of a
placed one while the fingers open [m/s]."""
STILL_SPEED = 0.1
"""An object that rises or falls faster [m/s] is waited for."""
HEIGHT_LIMIT = 1e-3
"""The cells of the placed object keep their heights, relative to each other [m]."""


class BulletRules(NamedTuple):
    """What counts as a disturbance."""

    limit: float
    """No earlier placed cell may move so far [m] ..."""
    axes: int
    """... in this many axes, x first."""
    objects: bool
    """Objects of several cells: the hand may touch no waiting cell, waiting ones count as placed
    ones do, and the object must not tilt."""


RULES = {
    "one-sided": BulletRules(0.035, 3, False),
    "cubes": BulletRules(0.01, 2, False),
    "objects": BulletRules(0.01, 2, True),
}
"""BulletRules by name."""


class _FailedError(Exception):
    """Outcome, stage and perhaps a detail."""


class PublishedCell:
    """Dynamics of hand and blocks as published. One instance serves one thread.

    Args:
        arm: the Panda.
        rules: a name in :data:`RULES`.
        opening: between the pads [m].

    Raises:
        InputError: for another arm, or an opening too narrow for a block.
        UnknownNameError: for other rules.
    """

    name = "published"

    def __init__(self, arm: Arm, rules: str = "cubes", opening: float = OPENING) -> None:
        self.rules = look_up("rules", rules, RULES)
        if not opening > EDGE:
            raise InputError("opening", opening, f"more than the {EDGE} m of a block")
        self.arm, self.world = arm, BulletWorld(arm, opening)
        self.steps = 0
        """Simulated steps so far."""

    def attempt(self, scene: Scene, move: Move, top: bool | None = None) -> Attempt:
        """What becomes of a move; the scene is left alone.

        Args:
            scene: what stands where; at rest, however it stands.
            move: the order.
            top: whether the reference is below the target, by default whether a block is.
        """
        self._scene, self._move = scene, move
        self.world.place(scene)
        self._before = self._now = self.world.centres()
        self._speed = np.zeros_like(self._now)
        self._travel = np.zeros(len(self._now))
        self._integral = np.zeros(len(self.arm.joints))
        if top is None:
            gap = np.abs(scene.position[: scene.num_placed] - _over(move.target, -EDGE))
            top = bool((gap.max(1) < HALF).any())
        try:
            self._grasp()
            self._place(top)
            self._compare()
        except _FailedError as failure:
            return Attempt(*failure.args, after=self._after())
        return Attempt(Outcome.REACHED, after=self._after())

    def _grasp(self) -> None:
        scene, move = self._scene, self._move
        centre, rotation = scene.position[move.cell], move.grasp.rotation()
        start = HOME
        if self.rules.objects and centre[1] > 0:
            start = GRASP_STARTS[turned(move.grasp)]
        self._jump(self._reach(_over(centre, ABOVE), rotation, start, "approach"))
        joints = self._solve(_over(centre, BEFORE), rotation, self.world.joints, "approach")
        self._jump(joints)
        joints = self._solve(centre, rotation, self.world.joints, "approach")
        self._servo(joints, APPROACH_STEPS)
        if self.rules.objects:
            waiting = np.arange(scene.num_placed, len(scene.position))
            if self.world.touches(HAND, waiting):
                raise _FailedError(Outcome.GRASP_COLLISION, "grasp contact")
            if not self._travel[waiting].max() <= WATCH_LIMIT:
                raise _FailedError(Outcome.GRASP_COLLISION, "grasp speed")
        self._idle(IDLE_STEPS)
        self.world.grip(move.cell)
        self._jump(self._solve(_over(centre, LIFTED), rotation, self.world.joints, "lift"))

    def _place(self, top: bool) -> None:
        scene, move, rules = self._scene, self._move, self.rules
        rotation, joints = move.place.rotation(), self.world.joints
        if rules.objects:
            joints = PLACE_STARTS[2 * turned(move.grasp) + turned(move.place)]
        waypoints = TOP_WAYPOINTS if top and not rules.objects else WAYPOINTS
        for number, (height, steps) in enumerate(waypoints):
            point = _over(move.target, height)
            joints = self._solve(point, rotation, joints, f"waypoint {number}")
            self._servo(joints, steps, point)
            if number == 1 and rules.objects and self.world.touches(TABLE, np.array([move.cell])):
                raise _FailedError(Outcome.PLACE_COLLISION, "table contact")
        placed = np.arange(scene.num_placed)
        if self.world.touches(HAND, placed):
            raise _FailedError(Outcome.PLACE_COLLISION, "contact before opening")
        self.world.release()
        self._travel[:] = 0
        self._idle(OPEN_STEPS)
        if self.world.touches(HAND, placed):
            raise _FailedError(Outcome.PLACE_COLLISION, "contact after opening")
        if not self._travel[placed].max(initial=0) <= RELEASE_LIMIT:
            raise _FailedError(Outcome.DISTURBED_STRUCTURE, "speed after opening")
        for _ in range(WAIT_STEPS if rules.objects else 0):
            if abs(self._speed[move.cell, 2]) <= STILL_SPEED:
                break
            self._idle(1)
        level = _over(move.target, -EDGE if top else 0.0)
        for offset in AWAY[:-1]:
            joints = self._solve(level + offset, rotation, joints, "retreat")
            self._jump(joints)
        self._jump(self._reach(level + AWAY[-1], rotation, joints, "retreat"))

    def _compare(self) -> None:
        """What moved meanwhile."""
        scene, rules = self._scene, self.rules
        members = scene.members(self._move.cell)
        others = np.setdiff1d(np.arange(len(self._now)), members)
        if not rules.objects:
            others = others[others < scene.num_placed]
        shift = self._now - self._before
        far = np.linalg.norm(shift[others, : rules.axes], axis=1).max(initial=0)
        if not far < rules.limit:
            raise _FailedError(Outcome.DISTURBED_STRUCTURE, "moved", f"{1e3 * far:.1f} mm")
        if rules.objects and not np.ptp(shift[members, 2]) <= HEIGHT_LIMIT:
            raise _FailedError(Outcome.TOPPLED, "tilted")

    def _after(self) -> Scene:
        """Where everything is, the moved object listed as the last placed one."""
        meant = put_down(self._scene, self._move)
        members = self._scene.members(self._move.cell)
        placed = np.arange(self._scene.num_placed)
        rest = np.setdiff1d(np.arange(len(self._now)), np.concatenate([placed, members]))
        order = np.concatenate([placed, members, rest])
        return meant._replace(position=self._now[order], yaw=self.world.yaws()[order])

    # ------------------------------------------------------------ motion

    def _solve(
        self, point: np.ndarray, rotation: np.ndarray, start: np.ndarray, stage: str
    ) -> np.ndarray:
        found = solve_as_published(self.arm, point, rotation, start)
        if not found.ok:
            raise _FailedError(Outcome.UNREACHABLE, stage, found.failure.name.lower())
        return found.joints

    def _reach(
        self, point: np.ndarray, rotation: np.ndarray, start: np.ndarray, stage: str
    ) -> np.ndarray:
        """Only the position: the first three rows of the error to a pose with that rotation."""
        found = solve_as_published(self.arm, point, rotation, start, turned=False)
        if not found.ok:
            raise _FailedError(Outcome.UNREACHABLE, stage, "no convergence")
        return found.joints

    def _jump(self, joints: np.ndarray) -> None:
        self.world.jump(joints)
        self._step()

    def _servo(self, goal: np.ndarray, steps: int, point: np.ndarray | None = None) -> None:
        """Towards joints; with a point, the held cell's centre shall get there."""
        near = False
        for _ in range(steps):
            joints = self.world.joints
            command = joints + SERVO_GAIN * (goal - joints)
            if point is not None:
                left = point - self._now[self._move.cell]
                near = near or np.abs(left).max() < NEAR
                if near:
                    self.world.correct(left, self._integral)
                    command = command + INTEGRAL_GAIN * self._integral
                else:
                    self._integral[:] = 0
            self.world.drive(command)
            self._step()

    def _idle(self, steps: int) -> None:
        """The motors keep their command."""
        for _ in range(steps):
            self._step()

    def _step(self) -> None:
        before = self._now
        self.world.step()
        self._now = self.world.centres()
        self._speed = (self._now - before) / TIMESTEP
        self._travel += np.abs(self._speed).sum(1)
        self.steps += 1


def _over(point: np.ndarray, height: float) -> np.ndarray:
    """float64[3]: the point that is so much higher [m]."""
    return point + np.array([0.0, 0.0, height])


def published_rules(task: Task) -> str:
    """Which of the published rules of disturbance are those of a task."""
    if task.objects != "cubes":
        return "objects"
    return "one-sided" if task.num_sides == 1 else "cubes"


def published_physics(task: Task) -> Physics:
    cell = PublishedCell(get_arm(task.arm), published_rules(task))
    return ArmPhysics(cell, get_grasps(task.grasps))
