"""Where an arm may move among simulated things: what it is near to, and ways that meet nothing,
straight lines of the joints where possible, else found with trees."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections import deque

import mujoco
import numpy as np

from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.kinematics.collisions import Collision, CollisionChecker
from learn2assemble.kinematics.inverse import solve
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.moves import Failure, Outcome
from learn2assemble.simulation.model import (
    ARM,
    LOOK,
    PAD,
    PLAN_MARGIN,
    TABLE,
    ArmParts,
    SimulatedWorld,
    set_held,
)

DEPTH = 0.001
"""What is held may be so deep in other things [m], as it is where it rests on them."""
SELF_MARGIN = 0.002
"""Distance the arm keeps from itself on planned ways and approach paths [m]."""
STRIDE = 0.05
"""Largest step of a joint between two checks of a way [rad]."""
KEEP = 0.003
"""Distance that is certain between two checks [m]: more than the arm strays from what it is told
(the tool by 2.4 mm at most, measured), less than :data:`~.model.PLAN_MARGIN`."""
_GROW = 0.4
"""Largest step of a joint when a tree grows [rad]."""
_TRIES, _SHORTCUTS = 600, 40
_AWAY, _MOST_AWAY = np.array([0.0, 0.0, 0.01]), 15
"""Steps [m] in which the tool leaves what it is too near to, and how many at most."""


class WorldChecker(CollisionChecker):
    """Answers whether the arm, and what it holds, is free at given joints.

    Args:
        arm: the robot.
        world: model of the cell.
        poses: float64[b, 7] of the objects: position [m] and quaternion (w, x, y, z).
        names: what to call them.
    """

    world: SimulatedWorld
    names: list[str]
    opening: float

    def __init__(
        self, arm: Arm, world: SimulatedWorld, poses: np.ndarray, names: list[str]
    ) -> None:
        super().__init__(arm, world.plan)
        self.world, self.names, m = world, names, self.model
        self.parts: ArmParts = world.arms[0]
        self._poses = self.data.qpos[world.pose :].reshape(-1, 7)
        self._begin = poses
        self._is_arm = (world.kind == ARM) | (world.kind == PAD)
        bodies = [m.body(name).id for name in (arm.gripper.hand, *arm.gripper.fingers)]
        self._is_link = self._is_arm & ~np.isin(m.geom_bodyid, bodies)
        pads = world.kind == PAD
        self._sort = np.add.outer(self._is_arm, self._is_arm, dtype=np.int8)
        self._sort[np.ix_(pads, pads)] = 3
        """int8[g, g]: of two geoms: none is the arm's (0), one (1), both (2), both are pads (3)."""
        self._arm_reach = _reaches(m, world)
        self._held: tuple[int, np.ndarray, np.ndarray] | None = None
        self._boxes = np.zeros(0, np.int64), np.zeros(0, np.int64)
        """Geoms of what is held, and of all else that it may meet, where they are boxes."""
        self.empty(0.0)

    def empty(self, width: float) -> None:
        """The hand is empty, its opening ``width`` [m], and all objects are where they began."""
        self.opening, self._held = width, None
        self._poses[:] = self._begin
        set_held(self.world, None)

    def carry(self, target: int, position: np.ndarray, rotation: np.ndarray, width: float) -> None:
        """The hand holds an object, at this pose in the tool frame: float64[3] [m] and
        float64[3, 3]."""
        self.opening, self._held = width, (target, position, rotation)
        set_held(self.world, target)
        kind, boxes = self.world.kind, self.model.geom_type == mujoco.mjtGeom.mjGEOM_BOX
        things = (self.model.geom_contype | self.model.geom_conaffinity) > 0
        own = boxes & (kind == target)
        self._boxes = (
            np.flatnonzero(own),
            np.flatnonzero(boxes & things & ~own & ~self._is_arm),
        )

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

    def check(self, joints: np.ndarray) -> Collision | None:
        """See :class:`CollisionChecker`; the arm keeps :data:`~.model.PLAN_MARGIN`."""
        return self.near(joints, PLAN_MARGIN)[0]

    def blocked(self, start: np.ndarray, end: np.ndarray) -> Collision | None:
        """What is nearer than :data:`KEEP` on the straight way between joints, or nearer than
        :data:`~.model.PLAN_MARGIN` where it was looked at, both ends included; None if nothing.

        No point of the arm moves farther than ``sum |dq_j| reach_j`` between two positions, so the
        way between them is free where their distances from everything say so; else it is halved.
        """
        move = np.abs(end - start)
        way, stride = float(move @ self.reach()), float(move.max())
        known: dict[float, float] = {}
        parts = deque([(0.0, 1.0)])
        while parts:
            part = parts.popleft()
            for share in part:
                if share not in known:
                    hit, known[share] = self.near(start + (end - start) * share, PLAN_MARGIN)
                    if hit is not None:
                        return hit
            low, high = part
            size = high - low
            free = (known[low] + known[high] - size * way) / 2
            if free < KEEP or size * stride > STRIDE:
                middle = (low + high) / 2
                parts += [(low, middle), (middle, high)]
        return None

    def near(
        self, joints: np.ndarray, margin: float, besides: int | None = None
    ) -> tuple[Collision | None, float]:
        """What touches what, and the distance of the arm and of what it holds from everything else
        [m], at most :data:`~.model.LOOK`."""
        m, d, w = self.model, self.data, self.world
        self.move_arm(joints)
        if self._held is not None:
            target, position, rotation = self._held
            site = self.parts.tool
            tool = d.site_xmat[site].reshape(3, 3)
            self._poses[target, :3] = d.site_xpos[site] + tool @ position
            mujoco.mju_mat2Quat(self._poses[target, 3:], (tool @ rotation).ravel())
            mujoco.mj_kinematics(m, d)
        mujoco.mj_collision(m, d)
        pairs, distance = d.contact.geom, d.contact.dist
        if self._held is not None:
            edges, apart = self._past_edges()
            if len(apart):
                pairs = np.concatenate([pairs, edges])
                distance = np.concatenate([distance, apart])
        if not len(distance):
            return None, LOOK
        if besides is not None:
            others = (w.kind[pairs] != besides).all(1)
            pairs, distance = pairs[others], distance[others]
        sort = self._sort[pairs[:, 0], pairs[:, 1]]
        hits = distance < np.array([margin - DEPTH, margin, SELF_MARGIN, -np.inf])[sort]
        hit = self._say(pairs[hits.argmax()]) if hits.any() else None
        return hit, float(distance[sort < 2].min(initial=LOOK))

    def _past_edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Boxes that are near to one in the hand, int[k, 2] pairs of geoms, and how near [m].

        MuJoCo finds no contact within the margins of two boxes of which one is past the edge of
        the other: what comes down beside a block from diagonally above it would count as free.
        """
        m, d = self.model, self.data
        own, others = self._boxes
        where, size = d.geom_xpos, m.geom_size
        way = where[own][:, None] - where[others]
        away = np.sqrt((way * way).sum(2))
        near = (away < m.geom_rbound[own][:, None] + m.geom_rbound[others] + LOOK).nonzero()
        one, two = own[near[0]], others[near[1]]
        gap = np.abs(way[near])
        for geoms in (one, two) if len(one) else ():
            turn = np.abs(d.geom_xmat[geoms].reshape(-1, 3, 3))
            gap -= (turn @ size[geoms][:, :, None])[..., 0]
        close = (gap < LOOK).all(1)
        pairs = np.array([one[close], two[close]]).T
        if not len(pairs):
            return pairs, np.zeros(0)
        apart = [mujoco.mj_geomDistance(m, d, a, b, LOOK, None) for a, b in pairs.tolist()]
        found = np.array(apart, float)
        return pairs[found < LOOK], found[found < LOOK]

    def room(self, besides: int | None) -> float:
        """Distance of the arm from everything but the object ``besides`` and what it holds [m],
        where it was looked at last; at most :data:`~.model.LOOK`."""
        pairs, distance = self.data.contact.geom, self.data.contact.dist
        if not len(distance):
            return LOOK
        kinds, sort = self.world.kind[pairs], self._sort[pairs[:, 0], pairs[:, 1]]
        skip = [besides, None if self._held is None else self._held[0]]
        others = ~np.isin(kinds, [kind for kind in skip if kind is not None]).any(1)
        return float(np.min(distance[(sort == 1) & others], initial=LOOK))

    def reach(self) -> np.ndarray:
        """float64[n]: no point of what a joint moves is farther from its axis [m]."""
        held = 0.0
        if self._held is not None:
            target, position, _ = self._held
            size = self.model.geom_rbound + np.linalg.norm(self.model.geom_pos, axis=1)
            held = np.linalg.norm(position) + size[self.world.kind == target].max()
        return self._arm_reach + held

    def _say(self, pair: np.ndarray) -> Collision:
        first, second = sorted(pair, key=lambda g: not self._is_arm[g])
        return Collision(self._name(first), self._name(second), bool(self._is_link[pair].any()))

    def _name(self, geom: int) -> str:
        kind = int(self.world.kind[geom])
        if kind >= 0:
            return self.names[kind]
        return "table" if kind == TABLE else self.model.body(self.model.geom_bodyid[geom]).name


def _reaches(model: mujoco.MjModel, world: SimulatedWorld) -> np.ndarray:
    """float64[n]: bounds of the distances of the arm's points from its joints' axes [m]."""
    arm = world.arms[0]
    first = model.jnt_bodyid[arm.joint]
    length = np.linalg.norm(model.body_pos, axis=1)
    length[model.jnt_bodyid[arm.finger]] += model.jnt_range[arm.finger, 1]
    away = np.linalg.norm(model.geom_pos, axis=1) + model.geom_rbound
    out = np.zeros(len(first))
    own = np.flatnonzero(np.isin(world.kind, arm.kinds))
    parts = [(int(model.geom_bodyid[g]), away[g]) for g in own]
    parts.append((int(model.site_bodyid[arm.tool]), np.linalg.norm(model.site_pos[arm.tool])))
    for body, reach in parts:
        while body:
            out[first == body] = np.maximum(out[first == body], reach)
            reach += length[body]
            body = int(model.body_parentid[body])
    return out


def straight_or_tree(
    checker: WorldChecker, start: np.ndarray, end: np.ndarray
) -> np.ndarray | Collision:
    """Joint positions float64[k, n] whose straight connections are free, or what is in the way.

    An arm that stands too near to something first leaves it upwards. Two trees grow towards each
    other (RRT-Connect) where the straight line is blocked.
    """
    leaving = _leaving(checker, start)
    if isinstance(leaving, Collision):
        return leaving
    free = leaving[-1]
    hit = checker.blocked(free, end)
    if hit is None:
        return np.array([*leaving, end])
    at_end = checker.check(end)
    if at_end is not None:
        return at_end
    way = _connect(checker, free, end, np.random.default_rng(0))
    if way is None:
        return hit
    return np.vstack([*leaving[:-1], _shortened(checker, way, np.random.default_rng(0))])


def _leaving(checker: WorldChecker, start: np.ndarray) -> list[np.ndarray] | Collision:
    """From a start that may be too near to something, straight up to where nothing is near and
    nothing gets nearer on the way; or what is in the way."""
    way = [start]
    hit, distance = checker.near(start, PLAN_MARGIN)
    least = distance - DEPTH
    position, rotation = forward(get_chain(checker.arm), start)
    while hit is not None:
        found = solve(checker.arm, position + len(way) * _AWAY, rotation, way[-1], restarts=0)
        if len(way) > _MOST_AWAY or not found.ok or distance < least:
            return hit
        way.append(found.joints)
        hit, distance = checker.near(found.joints, PLAN_MARGIN)
    return way


def _connect(
    checker: WorldChecker, start: np.ndarray, end: np.ndarray, rng: np.random.Generator
) -> list[np.ndarray] | None:
    lower, upper = checker.arm.limits()
    trees = [([start], [0]), ([end], [0])]
    for _ in range(_TRIES):
        grown = _extend(checker, trees[0], rng.uniform(lower, upper))
        if grown is not None:
            aim = trees[0][0][grown]
            while True:
                met = _extend(checker, trees[1], aim)
                if met is None:
                    break
                if np.array_equal(trees[1][0][met], aim):
                    ways = _back(trees[0], grown)[::-1], _back(trees[1], met)[1:]
                    way = [*ways[0], *ways[1]]
                    return way if way[0] is start else way[::-1]
        trees.reverse()
    return None


def _extend(
    checker: WorldChecker, tree: tuple[list[np.ndarray], list[int]], aim: np.ndarray
) -> int | None:
    """A new leaf towards ``aim``, or None where something is in the way."""
    nodes, parents = tree
    near = int(np.argmin([np.abs(node - aim).max() for node in nodes]))
    step = aim - nodes[near]
    size = np.abs(step).max()
    if size == 0:
        return near
    leaf = aim if size <= _GROW else nodes[near] + step * (_GROW / size)
    if checker.blocked(nodes[near], leaf) is not None:
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


def _shortened(
    checker: WorldChecker, way: list[np.ndarray], rng: np.random.Generator
) -> np.ndarray:
    """The way without corners that can be cut."""
    for _ in range(_SHORTCUTS):
        if len(way) < 3:
            break
        a, b = sorted(map(int, rng.integers(0, len(way), 2)))
        if b - a > 1 and checker.blocked(way[a], way[b]) is None:
            way = way[: a + 1] + way[b:]
    return np.array(way)


def free_way(checker: WorldChecker, start: np.ndarray, end: np.ndarray, stage: str) -> np.ndarray:
    """As :func:`straight_or_tree`.

    Raises:
        Failure: where there is none.
    """
    way = straight_or_tree(checker, start, end)
    if isinstance(way, Collision):
        raise Failure(Outcome.UNREACHABLE, stage, f"no free way: {way}")
    return way
