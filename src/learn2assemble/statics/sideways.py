"""What sideways acceleration a stack withstands in every direction, kept as it grows."""

from __future__ import annotations

import math

import numpy as np

from learn2assemble.geometry.circles import inner_circle
from learn2assemble.linear_programs import Clock
from learn2assemble.statics.step_proof import Proof, Stack

_DIRECTIONS = 16
"""In how many directions a sideways acceleration is proven; all others follow from these."""
_ANGLES = 2 * np.pi / _DIRECTIONS * np.arange(_DIRECTIONS)
_WAYS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], 1)
_ENOUGH = 1 / math.cos(2 * np.pi / _DIRECTIONS)
"""How far, in the least reach of all, the neighbours of that direction have to reach so that a line
across it does not cut them off; more does not help."""
_LEAST, _PRECISION = 2e-3, 0.005
"""Smallest sideways acceleration looked for [g], and how exactly it is found (relative)."""
_FIRM = 0.05
"""How exactly a margin is found by programs (relative)."""


class Sideways:
    """Sideways accelerations for which proofs are at hand, in directions all round.

    The forces that prove two accelerations, mixed, prove the same mixture of the two, with no more
    friction than the one that needs more: what lies in the hull of what is proven is proven, too.
    """

    def __init__(self, stack: Stack, most: float) -> None:
        self.loads: list[_SidewaysLoad] = [_SidewaysLoad(stack, way, most) for way in _WAYS]
        self.most = most
        self._radius: float | None = None

    @property
    def radius(self) -> float:
        """The largest acceleration that is proven in every direction [g]."""
        if self._radius is None:
            levels = np.array([load.level for load in self.loads])
            self._radius = inner_circle(levels[:, None] * _WAYS)[0]
        return self._radius

    def drop(self) -> None:
        """Forget all proofs."""
        for load in self.loads:
            load.level = 0.0
        self._radius = None

    def follow(
        self, dirty: np.ndarray, placed: np.ndarray, upright: np.ndarray, clock: Clock
    ) -> None:
        """The state has changed to ``placed``; keep the levels that hold, or find lower ones.

        Args:
            dirty: bool[n], blocks to balance again.
            upright: float64[P], forces that balance it without acceleration.
        """
        before = [load.level for load in self.loads]
        lost = [n for n, load in enumerate(self.loads) if not load.keep(dirty, placed)]
        if not lost:
            return
        self._radius = None
        enough = math.inf
        for n in sorted(lost, key=lambda n: before[n]):
            load = self.loads[n]
            done = before[n] > enough and load.reach(enough, placed, upright)
            if not done and not load.mend(dirty, placed, before[n]):
                load.search(placed, upright, min(before[n], enough))
            if load.level <= 0:
                load.spread(placed, before[n], clock.left)
            enough = min(enough, _ENOUGH * load.level) if load.level > 0 else enough

    def search(self, placed: np.ndarray, upright: np.ndarray, clock: Clock) -> None:
        """Look for larger levels, first in the direction that is weakest now."""
        self._radius, enough = None, self.most
        for load in sorted(self.loads, key=lambda load: load.level):
            load.search(placed, upright, enough, clock.left)
            enough = min(enough, _ENOUGH * load.level) if load.level > 0 else enough

    def firm(self, placed: np.ndarray, clock: Clock) -> None:
        """Levels that programs prove, which take longer than local proofs and find more."""
        self.drop()
        enough = self.most
        for load in self.loads:
            load.firm(placed, enough, clock)
            enough = min(enough, _ENOUGH * max(load.level, _LEAST))


class _SidewaysLoad:
    """The largest acceleration along one direction for which a proof is at hand."""

    def __init__(self, stack: Stack, way: np.ndarray, most: float) -> None:
        self.stack, self.way = stack, way
        self.level = most
        self.proof = self._fresh(most)

    def _fresh(self, level: float) -> Proof:
        return Proof(self.stack, (level * self.way[0], level * self.way[1]))

    def keep(self, dirty: np.ndarray, placed: np.ndarray) -> bool:
        """Whether the level holds after a change of the blocks ``dirty``; else it is 0."""
        if self.level > 0 and not self.proof.settle(dirty, placed):
            self.level = 0.0
            return False
        return True

    def mend(self, dirty: np.ndarray, placed: np.ndarray, level: float) -> bool:
        """Take a level that the last proof holds once blocks that are near are balanced
        together; whether it does."""
        if self.proof.settle(dirty, placed, mends=True):
            self.level = level
        return self.level > 0

    def spread(self, placed: np.ndarray, level: float, seconds: float) -> bool:
        """Take a level that a program over all blocks proves; whether there is one.

        Its forces begin from nothing, so that they are spread and leave room for what comes next.
        """
        proof = self._fresh(level)
        if not proof.program(placed, placed, seconds):
            return False
        self.level, self.proof = level, proof
        return True

    def search(
        self, placed: np.ndarray, upright: np.ndarray, most: float, seconds: float = 0.0
    ) -> None:
        """The highest level above the present one, up to ``most``, that a fresh proof reaches.

        Args:
            seconds: for programs, where the local proof finds nothing.
        """
        low, high = self.level, most
        if high <= low or self.reach(high, placed, upright):
            return
        if low <= 0 and not (
            self.reach(_LEAST, placed, upright) or self._by_program(placed, most, seconds)
        ):
            return
        low = self.level
        while high - low > max(_PRECISION * low, _LEAST / 4):
            middle = math.sqrt(low * high)
            if self.reach(middle, placed, upright):
                low = middle
            else:
                high = middle

    def _by_program(self, placed: np.ndarray, most: float, seconds: float) -> bool:
        for level in (16 * _LEAST, 4 * _LEAST, _LEAST):
            if level < most and seconds > 0 and self.spread(placed, level, seconds):
                return True
        return False

    def firm(self, placed: np.ndarray, most: float, clock: Clock) -> None:
        """The highest level above the present one, up to ``most``, that a program proves."""
        low, high, level = self.level, most, most
        while high - low > max(_FIRM * low, _LEAST / 4) and clock.left > 0:
            if self.spread(placed, level, clock.left):
                low = level
            else:
                high = level
            level = math.sqrt(max(low, _LEAST / 4) * high)

    def reach(self, level: float, placed: np.ndarray, upright: np.ndarray) -> bool:
        # Linear pressures from nothing are smoothest; else the forces of the upright state guide.
        for start in (None, upright):
            proof = self._fresh(level)
            if start is not None:
                proof.force = start.copy()
            if proof.settle(placed, placed):
                self.level, self.proof = level, proof
                return True
        return False
