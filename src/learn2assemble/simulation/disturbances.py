"""What goes otherwise than planned in a simulated cell, and what of it is seen.

Everything is chances with seeds of its own: the same cell, seed and motions give the same numbers,
whatever else draws.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from learn2assemble.geometry.rotations import (
    matrix_quaternion,
    quaternion_matrix,
    quaternion_product,
    yaw_matrix,
    yaw_quaternion,
)
from learn2assemble.plants.plant import BlockReading
from learn2assemble.plants.setup import BlockKind, Disturbance, Noise, Simulated
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.bodies import Part, Shape

PERIOD = 0.1
"""Between two pictures of the cell [s]: who looks twice within it sees the same."""
OUTLIER = (0.02, 0.06)
"""How far an outlier is off [m]."""
PUSH = 0.015
"""How far a block is pushed [m]."""
PERIODS = (2.0, 10.0)
"""Within which the error of a joint that moves varies once [s]."""
SEEN, PRESENTED, CELL, PUSHED, DROPPED, JOINTS = range(1, 7)
"""Streams of random numbers."""


class Chances:
    """The numbers of one cell.

    Args:
        told: what is asked for.
    """

    seed: int
    noise: Noise
    disturbance: Disturbance

    def __init__(self, told: Simulated) -> None:
        self.seed, self.noise, self.disturbance = told.seed, told.noise, told.disturbance

    def stream(self, kind: int, number: int = 0) -> np.random.Generator:
        """The numbers of one event of a kind."""
        return np.random.default_rng([self.seed, kind, number])

    def table(self) -> np.ndarray:
        """float64[7]: pose of the table, which should be that of the world."""
        height, lean = self.disturbance.table
        rng = self.stream(CELL)
        rise, angle, way = rng.uniform(-height, height), rng.uniform(0, lean), rng.uniform(0, 7)
        axis = np.array([math.cos(way), math.sin(way), 0.0])
        return np.array([0.0, 0.0, rise, math.cos(angle / 2), *(math.sin(angle / 2) * axis)])

    def block(self, kind: BlockKind, pose: np.ndarray, number: int) -> tuple[BlockKind, np.ndarray]:
        """A block that is presented: how heavy and high it is, and where it stands.

        Args:
            kind: as it is meant to be.
            pose: float64[7] where it should stand.
            number: how many were presented before.
        """
        rng, told = self.stream(PRESENTED, number), self.disturbance
        heavier, higher = rng.uniform(-told.mass, told.mass), rng.uniform(-told.height, told.height)
        place, turn = told.supply
        pose = pose.copy()
        pose[:2] += rng.normal(0.0, 1.0, 2) * place
        pose[3:] = quaternion_product(yaw_quaternion(rng.normal() * turn), pose[3:])
        shape = kind.shape
        if higher:
            shape = stretched(shape, int(np.abs(quaternion_matrix(pose[3:])[2]).argmax()), higher)
            pose[2] += higher / 2
        return BlockKind(shape, kind.density * (1 + heavier)), pose


def stretched(shape: Shape, axis: int, by: float) -> Shape:
    """A block of boxes that is longer along an axis of its frame [m]; with cut parts it stays as it
    is."""
    if any(part.hull is not None for part in shape):
        return shape
    ends = [
        (part.centre[axis] - part.half[axis], part.centre[axis] + part.half[axis]) for part in shape
    ]
    size = max(high for _, high in ends) - min(low for low, _ in ends)
    scale = 1 + by / size

    def longer(values: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = (value * (scale if k == axis else 1.0) for k, value in enumerate(values))
        return x, y, z

    return tuple(Part(longer(part.centre), longer(part.half)) for part in shape)


class Straying:
    """How the joints of an arm are elsewhere than they are told.

    Args:
        chances: the numbers.
        arm: whose joints.
        number: of the arm in the cell.
    """

    moving: float

    def __init__(self, chances: Chances, arm: Arm, number: int = 0) -> None:
        zero, self.moving = chances.disturbance.tracking
        rng, n = chances.stream(JOINTS, number), len(arm.joints)
        self.zero: np.ndarray = zero * rng.normal(size=n)
        """float64[n]: what encoders do not see [rad]."""
        self._rate = 2 * math.pi / rng.uniform(*PERIODS, n)
        self._phase = rng.uniform(0, 2 * math.pi, n)
        self._fastest = arm.velocity

    def of(self, time: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """float64[k, n]: by how much joints are elsewhere [rad].

        Args:
            time: float64[k] of the clock of the cell [s].
            velocity: float64[k, n] that they are told [rad/s].
        """
        wave = np.sin(time[:, None] * self._rate + self._phase)
        return self.zero + self.moving * velocity / self._fastest * wave


class Pictures:
    """What is seen of blocks, picture by picture.

    Args:
        chances: the numbers.
    """

    chances: Chances
    noise: Noise

    def __init__(self, chances: Chances) -> None:
        self.chances, self.noise = chances, chances.noise
        self.before: tuple[float, Mapping[str, np.ndarray]] | None = None
        self.last: int = -1

    def covariance(self) -> np.ndarray:
        """float64[6, 6] of a reading."""
        noise = self.noise
        height = noise.place if noise.height is None else noise.height
        return np.diag([noise.place, noise.place, height, *[noise.turn] * 3]) ** 2

    def look(self, time: float, poses: Mapping[str, np.ndarray]) -> tuple[BlockReading, ...]:
        """Readings at a time [s] of blocks that are at poses float64[7]."""
        noise, covariance = self.noise, self.covariance()
        if noise == Noise():
            return tuple(
                BlockReading(name, pose.copy(), covariance, time) for name, pose in poses.items()
            )
        number = math.floor(time / PERIOD + 1e-6)
        rng = self.chances.stream(SEEN, number)
        found: list[BlockReading] = []
        for name in sorted(poses):
            missing, far, late = rng.uniform(size=3) < (noise.missing, noise.outliers, noise.late)
            step = rng.normal(size=6) * np.sqrt(np.diag(covariance))
            way, off = rng.uniform(0, 2 * math.pi), rng.uniform(*OUTLIER)
            pose, when = poses[name], time
            if late and self.before is not None and name in self.before[1]:
                when, pose = self.before[0], self.before[1][name]
            if far:
                step[:2] += off * np.array([math.cos(way), math.sin(way)])
            if not missing:
                found.append(BlockReading(name, noisy(pose, step), covariance, when))
        if number != self.last:
            self.before, self.last = (time, {name: p.copy() for name, p in poses.items()}), number
        return tuple(found)

    def state(self) -> list[Any]:
        """What of it is needed to go on elsewhere."""
        time, poses = self.before or (0.0, {})
        return [self.last, time, {name: pose.tolist() for name, pose in poses.items()}]

    def restore(self, state: list[Any]) -> None:
        """As it was."""
        self.last, time, poses = state
        self.before = time, {name: np.array(pose) for name, pose in poses.items()}


def noisy(pose: np.ndarray, step: np.ndarray) -> np.ndarray:
    """float64[7]: a pose moved by a small step float64[6]."""
    angle = float(np.linalg.norm(step[3:]))
    turn = np.array([1.0, 0.0, 0.0, 0.0])
    if angle > 0:
        turn = np.array([math.cos(angle / 2), *(math.sin(angle / 2) * step[3:] / angle)])
    quaternion = quaternion_product(turn, pose[3:])
    return np.array([*(pose[:3] + step[:3]), *(quaternion / np.linalg.norm(quaternion))])


def on_table(table: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """float64[7]: a pose that is meant on the table of the world, on a table that is elsewhere."""
    if not table[:3].any() and table[3] == 1.0:
        return pose
    turn = quaternion_matrix(table[3:])
    place = table[:3] + turn @ pose[:3]
    return np.array([*place, *matrix_quaternion(turn @ quaternion_matrix(pose[3:]))])


def pushed(rng: np.random.Generator) -> list[np.ndarray]:
    """Steps float64[3] by which a block may be pushed [m], in the order they are tried."""
    ways = rng.permutation(4)
    return [PUSH * yaw_matrix(way * math.pi / 2)[:, 0] for way in ways.tolist()]
