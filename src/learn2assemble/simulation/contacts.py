"""The contacts of a simulation as they matter when one arm moves one object."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

from learn2assemble.kernels import kernel
from learn2assemble.simulation.model import TABLE, ArmParts, SimulatedWorld

TOUCH = 0.5
"""Smallest force between things that must not meet that counts as a collision [N]: half the weight
of a block. A brush without force is none; a block that it moves nevertheless is noticed later."""
PUSH = 5.0
"""The same between the open hand and the block it is about to grasp [N]: a finger that slides a
free block (friction holds it with 1 N) is none, one that lands on it is."""
SLIDES = 0.1
"""What the target moves along rather than against: cosine of the angle between its way and the
normal of a contact."""
WEDGED = 0.04
"""What opposes its way by less of its normal (2 degrees) it slides along whatever that presses: an
upright side. By more it is a wedge, such as the last block of an arch, which rests on its sides."""
_CLASSES = _TABLE, _ARM, _PAD, _TARGET, _OTHER = range(5)
_SUBJECT = (4, 0, 0, 1, 3)
"""Which of two things touches the other, by class."""


class Rules(NamedTuple):
    """Smallest forces [N] that count as a collision; None where contact is allowed."""

    arm: float | None = TOUCH
    """Arm or hand with table, other blocks or itself."""
    target: float | None = None
    """Arm or hand with the object that is to be moved."""
    held: float | None = None
    """That object with table or other blocks."""

    def thresholds(self) -> np.ndarray:
        """float64[5, 5]: the forces [N] by classes of the two geoms; to be read only."""
        return _thresholds(self)


@lru_cache(maxsize=256)
def _thresholds(rules: Rules) -> np.ndarray:
    arm, target, held = (np.inf if force is None else force for force in rules)
    table = np.full((len(_CLASSES), len(_CLASSES)), np.inf)
    for part in (_ARM, _PAD):
        table[part, [_TABLE, _OTHER, _ARM]] = arm
        table[part, _TARGET] = target
    table[_TARGET, [_TABLE, _OTHER]] = held
    return np.minimum(table, table.T)


class Watch(NamedTuple):
    """What is looked for from some point of a path on."""

    rules: Rules
    start: float = 0.0
    """s from which this holds."""
    until: Callable[[], bool] | None = None
    """Brake as soon as this is so."""


BLIND = Watch(Rules(None, None, None))
"""Nothing is looked for."""


class SimulatedContacts:
    """The contacts of a simulation as they matter when one object is moved.

    Args:
        world: model of the cell.
        data: its state.
        names: what to call the objects.
        target: number of the object that is moved.
        number: of the arm that moves it; the others are things like all others.
    """

    world: SimulatedWorld
    data: mujoco.MjData
    names: list[str]

    def __init__(
        self,
        world: SimulatedWorld,
        data: mujoco.MjData,
        names: list[str],
        target: int,
        number: int = 0,
    ) -> None:
        self.world, self.data, self.names = world, data, names
        self.parts: ArmParts = world.arms[number]
        self.along: np.ndarray | None = None
        """float64[3]: unit vector along which the target comes to its place; what it slides along
        does not count as its support. None: everything does."""
        self._wrench = np.empty(6)
        self.aim(target)

    def aim(self, target: int) -> None:
        """From now on it is this object that is moved; -9: none."""
        kind, (arm, pad) = self.world.kind, self.parts.kinds
        self._class = np.select(
            [kind == TABLE, kind == arm, kind == pad, kind == target],
            [_TABLE, _ARM, _PAD, _TARGET],
            _OTHER,
        )

    def collision(self, thresholds: np.ndarray) -> str | None:
        """The first collision in words, by thresholds of :meth:`Rules.thresholds`, or None."""
        begin = 0
        while begin < self.data.ncon:
            pairs = self.data.contact.geom
            begin = _first(pairs, self._class, thresholds, begin)
            if begin < len(pairs):
                first, second = pairs[begin]
                force = self.force(begin)
                if force >= thresholds[self._class[first], self._class[second]]:
                    if _SUBJECT[self._class[second]] < _SUBJECT[self._class[first]]:
                        first, second = second, first
                    names = f"{self.name(first)} touches {self.name(second)}"
                    return f"{names} with {force:.1f} N"
            begin += 1
        return None

    def grip(self) -> float:
        """What the weaker of the pads presses the target with [N]."""
        force = dict.fromkeys(self.parts.pads, 0.0)
        for k, pair in enumerate(self._pairs()):
            if _TARGET in self._class[pair]:
                for geom in pair.tolist():
                    if geom in force:
                        force[geom] += self.force(k)
        return min(force.values())

    def support(self) -> float:
        """What the target and everything but the hand press on each other [N]."""
        total = 0.0
        for k, (a, b) in enumerate(self._class[self._pairs()].tolist()):
            if _TARGET in (a, b) and {a, b} & {_TABLE, _OTHER}:
                share = 1.0
                if self.along is not None:
                    # The frame's normal points from the first geom to the second.
                    share = float(self.data.contact.frame[k, :3] @ self.along)
                    share = share if a == _TARGET else -share
                if abs(share) >= SLIDES or share >= WEDGED:
                    total += abs(share) * self.force(k)
        return total

    def pressure(self, held: bool) -> np.ndarray:
        """float64[3]: what the arm, with the target where that is ``held``, gets from everything
        else; world frame [N]."""
        total, frame = np.zeros(3), self.data.contact.frame if self.data.ncon else ()
        mine = (_ARM, _PAD, _TARGET) if held else (_ARM, _PAD)
        for k, (a, b) in enumerate(self._class[self._pairs()].tolist()):
            if (a in mine) == (b in mine):
                continue
            mujoco.mj_contactForce(self.world.model, self.data, k, self._wrench)
            # The frame's normal points from the first geom to the second.
            push = self._wrench[:3] @ frame[k].reshape(3, 3)
            total += push if b in mine else -push
        return total

    def force(self, contact: int) -> float:
        """Normal force of a contact [N]."""
        mujoco.mj_contactForce(self.world.model, self.data, int(contact), self._wrench)
        return float(self._wrench[0])

    def name(self, geom: int) -> str:
        """The block or part of the arm a geom belongs to."""
        kind, m = int(self.world.kind[geom]), self.world.model
        if kind >= 0:
            return self.names[kind]
        return "table" if kind == TABLE else m.body(m.geom_bodyid[geom]).name

    def _pairs(self) -> np.ndarray:
        return self.data.contact.geom if self.data.ncon else np.empty((0, 2), np.int32)


@kernel
def _first(pairs: np.ndarray, classes: np.ndarray, thresholds: np.ndarray, begin: int) -> int:
    """Index of the first contact from ``begin`` on that may be a collision, or their number."""
    for k in range(begin, pairs.shape[0]):
        if thresholds[classes[pairs[k, 0]], classes[pairs[k, 1]]] < np.inf:
            return k
    return pairs.shape[0]
