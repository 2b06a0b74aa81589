"""Ways of the arm that meet nothing: a straight line of the joints where possible, else a tree."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import math
from typing import NamedTuple

import mujoco
import numpy as np

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.dynamic.model import ARM, PAD, PLAN_MARGIN, TABLE, World, set_held

DEPTH = 0.001
"""What is held may be so deep in other things [m], as it is where it rests on them."""
SELF_MARGIN = 0.002
"""Distance the arm keeps from itself on planned ways and in columns [m]."""
STRIDE = 0.05
"""Largest step of a joint between two checks of a way [rad]."""
_GROW = 0.4
"""Largest step of a joint when a tree grows [rad]."""
_TRIES, _SHORTCUTS = 600, 40


class Touch(NamedTuple):
    """Two things that meet."""

    words: str
    by_link: bool
    """A link of the arm is one of them, not its hand."""


class Surroundings:
    """Answers whether the arm, and what it holds, is free at given joints.

    Args:
        arm: the robot.
        world: model of the cell.
        poses: float64[b, 7] of the objects: position [m] and quaternion (w, x, y, z).
        names: what to call them.
    """

    def __init__(self, arm: Arm, world: World, poses: np.ndarray, names: list[str]) -> None:
        self.arm, self.world, self.names = arm, world, names
        self.model = m = world.plan
        self.data = d = mujoco.MjData(m)
        self._poses = d.qpos[world.pose :].reshape(-1, 7)
        self._begin = poses
        self._is_arm = (world.kind == ARM) | (world.kind == PAD)
        bodies = [m.body(name).id for name in (arm.gripper.hand, *arm.gripper.fingers)]
        self._is_link = self._is_arm & ~np.isin(m.geom_bodyid, bodies)
        self._width = 0.0
        self._held: tuple[int, np.ndarray, np.ndarray] | None = None
        self.empty(0.0)

    def empty(self, width: float) -> None:
        """The hand is empty, its opening ``width`` [m], and all objects are where they began."""
        self._width, self._held = width, None
        self._poses[:] = self._begin
        set_held(self.world, None)

    def carry(self, target: int, position: np.ndarray, rotation: np.ndarray, width: float) -> None:
        """The hand holds an object, at this pose in the tool frame: float64[3] [m] and
        float64[3, 3]."""
        self._width, self._held = width, (target, position, rotation)
        set_held(self.world, target)

    def put(self, target: int, position: np.ndarray, rotation: np.ndarray, width: float) -> None:
        """As :meth:`empty`, but one object stands here: float64[3] [m] and float64[3, 3]."""
        self.empty(width)
        self._poses[target, :3] = position
        mujoco.mju_mat2Quat(self._poses[target, 3:], rotation.ravel())

    def overlap(self, target: int) -> str | None:
        """What an object is inside of, or None."""
        m, d = self.model, self.data
        set_held(self.world, target)
        mujoco.mj_kinematics(m, d)
        mujoco.mj_collision(m, d)
        for pair, distance in zip(d.contact.geom, d.contact.dist, strict=True) if d.ncon else ():
            own = self.world.kind[pair[0]] == target
            if distance <= -DEPTH and (own or self.world.kind[pair[1]] == target):
                return self._name(pair[1] if own else pair[0])
        return None

    def touch(
        self, joints: np.ndarray, margin: float = PLAN_MARGIN, besides: int | None = None
    ) -> Touch | None:
        """What touches what at joints float64[n] [rad], or None where everything is free.

        Args:
            joints: of the arm.
            margin: distance the arm keeps [m], at most :data:`PLAN_MARGIN`.
            besides: an object it may touch.
        """
        m, d, w = self.model, self.data, self.world
        d.qpos[w.joint] = joints
        d.qpos[w.finger] = self._width / len(w.finger)
        mujoco.mj_kinematics(m, d)
        if self._held is not None:
            target, position, rotation = self._held
            tool = d.site_xmat[w.tool].reshape(3, 3)
            self._poses[target, :3] = d.site_xpos[w.tool] + tool @ position
            mujoco.mju_mat2Quat(self._poses[target, 3:], (tool @ rotation).ravel())
            mujoco.mj_kinematics(m, d)
        mujoco.mj_collision(m, d)
        for pair, distance in zip(d.contact.geom, d.contact.dist, strict=True) if d.ncon else ():
            hit = self._collision(pair, distance, margin)
            if hit is not None and besides not in self.world.kind[pair].tolist():
                return hit
        return None

    def blocked(self, start: np.ndarray, end: np.ndarray) -> Touch | None:
        """What is touched on the straight way between joints, both ends included, or None."""
        count = max(1, math.ceil(np.abs(end - start).max() / STRIDE))
        # From the middle outwards finds what is in the way sooner than from one end.
        for k in sorted(range(count + 1), key=lambda k: abs(2 * k - count)):
            hit = self.touch(start + (end - start) * (k / count))
            if hit is not None:
                return hit
        return None

    def _collision(self, pair: np.ndarray, distance: float, margin: float) -> Touch | None:
        kind = self.world.kind[pair]
        own = self._is_arm[pair]
        if own.all():
            near = distance < SELF_MARGIN and not (kind == PAD).all()
            return self._say(pair) if near else None
        if not own.any():
            return self._say(pair) if distance <= -DEPTH else None
        return self._say(pair) if distance < margin else None

    def _say(self, pair: np.ndarray) -> Touch:
        first, second = sorted(pair, key=lambda g: not self._is_arm[g])
        by_link = bool(self._is_link[pair].any())
        return Touch(f"{self._name(first)} touches {self._name(second)}", by_link)

    def _name(self, geom: int) -> str:
        kind = int(self.world.kind[geom])
        if kind >= 0:
            return self.names[kind]
        return "table" if kind == TABLE else self.model.body(self.model.geom_bodyid[geom]).name


def straight_or_tree(
    around: Surroundings, start: np.ndarray, end: np.ndarray, seed: int = 0
) -> np.ndarray | Touch:
    """Joint positions float64[k, n] whose straight connections are free, or what is in the way.

    Two trees grow towards each other (RRT-Connect) where the straight line is blocked.
    """
    hit = around.blocked(start, end)
    if hit is None:
        return np.array([start, end])
    for joints in (start, end):
        at_end = around.touch(joints)
        if at_end is not None:
            return at_end
    way = _connect(around, start, end, np.random.default_rng(seed))
    return hit if way is None else _shortened(around, way, np.random.default_rng(seed))


def _connect(
    around: Surroundings, start: np.ndarray, end: np.ndarray, rng: np.random.Generator
) -> list[np.ndarray] | None:
    lower, upper = around.arm.limits()
    trees = [([start], [0]), ([end], [0])]
    for _ in range(_TRIES):
        grown = _extend(around, trees[0], rng.uniform(lower, upper))
        if grown is not None:
            aim = trees[0][0][grown]
            while True:
                met = _extend(around, trees[1], aim)
                if met is None:
                    break
                if np.array_equal(trees[1][0][met], aim):
                    ways = _back(trees[0], grown)[::-1], _back(trees[1], met)[1:]
                    way = [*ways[0], *ways[1]]
                    return way if way[0] is start else way[::-1]
        trees.reverse()
    return None


def _extend(
    around: Surroundings, tree: tuple[list[np.ndarray], list[int]], aim: np.ndarray
) -> int | None:
    """A new leaf towards ``aim``, or None where something is in the way."""
    nodes, parents = tree
    near = int(np.argmin([np.abs(node - aim).max() for node in nodes]))
    step = aim - nodes[near]
    size = np.abs(step).max()
    if size == 0:
        return near
    leaf = aim if size <= _GROW else nodes[near] + step * (_GROW / size)
    if around.blocked(nodes[near], leaf) is not None:
        return None
    nodes.append(leaf)
    parents.append(near)
    return len(nodes) - 1


def _back(tree: tuple[list[np.ndarray], list[int]], leaf: int) -> list[np.ndarray]:
    """From a leaf to the root."""
    nodes, parents = tree
    way = [nodes[leaf]]
    while leaf:
        leaf = parents[leaf]
        way.append(nodes[leaf])
    return way


def _shortened(around: Surroundings, way: list[np.ndarray], rng: np.random.Generator) -> np.ndarray:
    """The way without corners that can be cut."""
    for _ in range(_SHORTCUTS):
        if len(way) < 3:
            break
        a, b = sorted(rng.integers(0, len(way), 2))
        if b - a > 1 and around.blocked(way[a], way[b]) is None:
            way = way[: a + 1] + way[b:]
    return np.array(way)
