"""The released fast mode of the authors' robot cell, for comparison with their recorded steps.

Protocol 8: free motions are teleports, the grasp is a constraint, the links of the arm touch
nothing, the fingers stay open, and inverse kinematics knows no joint limits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.errors import look_up
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.attempt import Attempt
from learn2assemble.robot.descent import CONVERGED, descend_published
from learn2assemble.robot.handworld import HandWorld
from learn2assemble.robot.inverse import solve
from learn2assemble.robot.kinematics import forward, get_chain, jacobian
from learn2assemble.robot.outcome import Outcome
from learn2assemble.robot.scene import Move, Scene
from learn2assemble.robot.servo import TIMESTEP, Servo
from learn2assemble.world.blocks import EDGE

HOME = np.array([0.0, -0.215, 0.0, -2.57, 0.0, 2.356, 2.356])
LOWER = np.array([-2.9671, -1.8326, -2.9671, -3.1416, -2.9671, -0.0873, -2.9671])
UPPER = np.array([2.9671, 1.8326, 2.9671, 0.0, 2.9671, 3.8223, 2.9671])
G = (
    np.array([0.4904, -0.5005, 0.1023, -2.7084, 0.0610, 2.2092, 1.3292]),
    np.array([0.5402, 0.2053, -0.0501, -2.2307, 0.0150, 2.4366, 2.8357]),
)
P = (
    np.array([0.1030, 0.3711, 0.0257, -2.5515, -0.0449, 2.9237, 0.9485]),
    np.array([-0.1668, 0.3903, 0.2273, -2.5430, -0.3584, 2.9223, 2.7669]),
    np.array([0.2349, 0.3726, -0.0794, -2.5509, 0.1234, 2.9235, 0.8360]),
    np.array([0.0652, 0.3777, 0.0531, -2.5578, -0.0884, 2.9480, 2.5584]),
)
OPENING = 0.08
MASSES = {
    "link1": (2.7, (0.0, -0.04, -0.05), (0.02297, 0.01777, 0.01148)),
    "link2": (2.73, (0.0, -0.04, 0.06), (0.02349, 0.01161, 0.01823)),
    "link3": (2.04, (0.01, 0.01, -0.05), (0.01092, 0.01258, 0.01197)),
    "link4": (2.08, (-0.03, 0.03, 0.02), (0.01134, 0.01225, 0.01306)),
    "link5": (3.0, (0.0, 0.04, -0.12), (0.03568, 0.02985, 0.0128)),
    "link6": (1.3, (0.04, 0.0, 0.0), (0.003428, 0.005117, 0.005988)),
    "link7": (0.2, (0.0, 0.0, 0.08), (0.0003616, 0.0003622, 0.0005921)),
    "hand": (0.81, (0.0, 0.0, 0.04), (0.003719, 0.001016, 0.003388)),
    "left_finger": (0.1, (0.0, 0.01, 0.02), (4.168e-05, 3.874e-05, 1.694e-05)),
    "right_finger": (0.1, (0.0, 0.01, 0.02), (4.168e-05, 3.874e-05, 1.694e-05)),
}
RELEASE_LIMIT = 0.75
WATCH_LIMIT = 1.0
HEIGHT_LIMIT = 1e-3


class Rules(NamedTuple):
    limit: float
    axes: int
    objects: bool


RULES = {
    "one-sided": Rules(0.035, 3, False),
    "cubes": Rules(0.01, 2, False),
    "objects": Rules(0.01, 2, True),
}


class _Failed(Exception):
    def __init__(self, outcome: Outcome, stage: str, detail: str = "") -> None:
        self.attempt = Attempt(outcome, stage, detail)


class PublishedCell:
    name = "published"

    def __init__(self, arm: Arm, rules: str = "cubes", opening: float = OPENING, torque: float = 500.0, limits=True, masses=True) -> None:
        self.arm = arm
        self.rules = look_up("rules", rules, RULES)
        wide = np.full(7, 1e3)
        self.servo = Servo(arm, LOWER if limits else -wide, UPPER if limits else wide, torque, MASSES if masses else None)
        self.world = HandWorld(arm, opening, TIMESTEP, self.servo)
        self.chain = get_chain(arm)
        self.trace = None

    def attempt(self, scene: Scene, move: Move, top: bool | None = None) -> Attempt:
        self.world.place(scene)
        self.scene, self.move = scene, move
        self.steps = 0
        self.total = np.zeros(7)
        self.servo.powered = False
        if top is None:
            below = scene.position[: scene.num_placed] - (move.target - [0, 0, EDGE])
            top = bool(np.any(np.abs(below).max(1) < EDGE / 2))
        try:
            self._grasp()
            self._place(top)
        except _Failed as failure:
            return failure.attempt
        return self._judge()

    # ---------------- stages

    def _grasp(self) -> None:
        scene, move = self.scene, self.move
        centre = scene.position[move.cell].copy()
        rotation = move.grasp.rotation()
        start = HOME
        if self.rules.objects and centre[1] > 0:
            start = G[0 if abs(np.sin(move.grasp.yaw)) < 0.5 else 1]
        self.before = self.world.centres()
        self.watched = np.zeros(len(scene.position))
        joints = self._reach(centre + [0, 0, 0.15], rotation, start, "grasp")
        self._jump(joints)
        joints = self._solve(centre + [0, 0, 0.05], rotation, self.servo.joints, "grasp")
        self._jump(joints)
        joints = self._solve(centre, rotation, self.servo.joints, "grasp")
        self._servo(joints, 25)
        if self.rules.objects:
            waiting = np.arange(scene.num_placed, len(scene.position))
            hit = self.world.touched() & self.world.objects(waiting)
            if hit:
                raise _Failed(Outcome.GRASP_COLLISION, "grasp contact")
            if self.watched[waiting].max() > WATCH_LIMIT:
                raise _Failed(Outcome.GRASP_COLLISION, "grasp velocity")
        self._idle(10)
        self.world.grip(move.cell)
        joints = self._solve(centre + [0, 0, 0.2], rotation, self.servo.joints, "lift")
        self._jump(joints)

    def _place(self, top: bool) -> None:
        scene, move, rules = self.scene, self.move, self.rules
        rotation = move.place.rotation()
        if rules.objects:
            a, b = (abs(np.sin(att.yaw)) > 0.5 for att in (move.grasp, move.place))
            start = P[2 * a + b]
        else:
            start = self.servo.joints
        heights = (0.25, 0.025, 0.010, 0.005)
        if top and not rules.objects:
            heights = (0.20, 0.025, 0.005, 0.005)
        for number, (height, steps) in enumerate(zip(heights, (50, 50, 50, 100), strict=True)):
            point = move.target + [0, 0, height]
            start = self._solve(point, rotation, start, f"waypoint {number}")
            self._servo(start, steps, point)
            if number == 1 and rules.objects and self.world.on_table(move.cell):
                raise _Failed(Outcome.PLACE_COLLISION, "table contact")
        placed = np.arange(scene.num_placed)
        structure = self.world.objects(placed)
        self.before_open = self.world.centres()
        if self.world.touched() & structure:
            raise _Failed(Outcome.PLACE_COLLISION, "contact before opening")
        self.before_open = self.world.centres()
        self.world.release(move.cell)
        self.watched[:] = 0
        self._idle(50)
        if self.world.touched() & structure:
            raise _Failed(Outcome.PLACE_COLLISION, "contact after opening")
        if self.watched[placed].max() > RELEASE_LIMIT:
            raise _Failed(Outcome.DISTURBED_STRUCTURE, "speed after opening")
        if rules.objects:
            for _ in range(200):
                if abs(self.speed[move.cell, 2]) <= 0.1:
                    break
                self._idle(1)
        base = move.target - ([0, 0, EDGE] if top else [0, 0, 0])
        for offset in ([0, 0, 0.10], [0, 0, 0.25]):
            start = self._solve(base + offset, rotation, start, "retreat")
            self._jump(start)
        self._jump(self._reach(base + [0, -0.15, 0.25], rotation, start, "retreat"))

    def _judge(self) -> Attempt:
        scene, rules = self.scene, self.rules
        now = self.world.centres()
        members = scene.members(self.move.cell)
        others = np.setdiff1d(np.arange(len(now)), members)
        if not rules.objects:
            others = others[others < scene.num_placed]
        shift = np.linalg.norm((now - self.before)[others, : rules.axes], axis=1)
        if shift.max(initial=0) >= rules.limit:
            return Attempt(Outcome.DISTURBED_STRUCTURE, "moved", f"{shift.max():.4f}")
        if rules.objects:
            rise = (now - self.before)[members, 2]
            if np.ptp(rise) > HEIGHT_LIMIT:
                return Attempt(Outcome.UNSTABLE, "tilted")
        return Attempt(Outcome.REACHED)

    # ---------------- motion

    def _solve(self, point, rotation, start, stage) -> np.ndarray:
        found = solve(self.arm, point, rotation, start, method="published")
        if found.failure:
            raise _Failed(Outcome.UNREACHABLE, stage, found.failure.name)
        return found.joints

    def _reach(self, point, rotation, start, stage) -> np.ndarray:
        """Position only: the first three rows of log6."""
        joints, converged = np.array(start), False
        state, *_ = descend_published(self.chain, point, rotation, 3, 1e-6, 1000, joints)
        if state != CONVERGED:
            raise _Failed(Outcome.UNREACHABLE, stage, "position")
        return joints

    def _jump(self, joints: np.ndarray) -> None:
        self.servo.jump(joints)
        self._stepped()

    def _servo(self, goal: np.ndarray, steps: int, point: np.ndarray | None = None) -> None:
        servo, near = self.servo, False
        for _ in range(steps):
            servo.powered = True
            servo.command = servo.joints + 0.5 * (goal - servo.joints)
            if point is not None:
                left = point - self.world.centres()[self.move.cell]
                near = near or np.abs(left).max() < 0.01
                if not near:
                    self.total = np.zeros(len(goal))
                else:
                    jac = self._spatial(servo.joints)
                    self.total = self.total + jac.T @ np.linalg.solve(jac @ jac.T, left)
                    servo.command = servo.command + 0.0075 * self.total
            self._stepped()

    def _spatial(self, joints: np.ndarray) -> np.ndarray:
        """float64[3, n]: velocity of the point of the hand that is at the base, in world axes."""
        jac = jacobian(self.chain, joints)
        away = forward(self.chain, joints)[0] - self.arm.base_position
        return jac[:3] + np.cross(away, jac[3:].T).T

    def _idle(self, steps: int) -> None:
        for _ in range(steps):
            self._stepped()

    def _stepped(self) -> None:
        before = self.world.centres()
        self.world.step()
        self.steps += 1
        now = self.world.centres()
        self.speed = (now - before) / TIMESTEP
        self.watched += np.abs(self.speed).sum(1)
        if self.trace is not None:
            self.trace.append((self.servo.joints.copy(), forward(self.chain, self.servo.joints)[0], now))
