"""Where the knobs of bricks are, what is pressed on what, and what hangs together."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.assembly.bricks.lattice import GROUND, StudLattice
from learn2assemble.assembly.joints import Joint
from learn2assemble.errors import InputError

RADIUS, HEIGHT = 0.3, 0.21
"""Of a knob, as shares of the distance of studs."""
_OFF = 0.05
"""Sides are whole numbers of studs but for this share of one."""


def knobs_on(block: Block, joint: Joint) -> np.ndarray:
    """float64[k, 3]: the middles of the lower ends of the knobs of a block, from its smallest
    corner [m]; none where it is no upright box of whole studs, or its joints have none."""
    size = np.ptp(block.vertices, axis=0)
    studs = np.rint(size[:2] / joint.pitch[0])
    whole = np.abs(size[:2] / joint.pitch[0] - studs).max() <= _OFF and studs.min() >= 1
    box = block.is_convex and abs(float(size.prod()) - block.volume) <= 1e-6 * block.volume
    if joint.law != "clutch" or not whole or not box or block.prop:
        return np.empty((0, 3))
    x, y = ((np.arange(int(n)) + 0.5) * side / n for n, side in zip(studs, size[:2], strict=True))
    return np.array([(a, b, size[2]) for a in x for b in y])


class Knobs(NamedTuple):
    """A joint of two bricks."""

    # The method of tuples of this name is not used.
    count: int  # pyright: ignore[reportIncompatibleMethodOverride]
    middle: tuple[float, float]
    """Of its knobs in the structure [m]."""


class Press(NamedTuple):
    """Where bricks are pressed home."""

    brick: int
    """The one of them with most knobs."""
    knobs: int
    """Of all of them; 0: they meet none."""
    at: tuple[float, float]
    """The middle of these knobs, x and y; without knobs the middle of the brick [m]."""


class BrickMates:
    """The joints of bricks on a lattice of studs.

    Args:
        assembly: whose joints clutch; steps are not looked at.

    Raises:
        InputError: for joints of several laws, and for blocks that are no bricks on one lattice.
    """

    count: int
    lattice: StudLattice

    def __init__(self, assembly: Assembly) -> None:
        joint, blocks = assembly.joint, assembly.blocks
        if joint.law != "clutch" or assembly.joints:
            raise InputError("joints", "several laws", "one clutch for all bricks")
        self.count = count = len(blocks)
        self.fixed: np.ndarray = np.array([block.support for block in blocks])
        self.lattice = lattice = StudLattice(blocks, joint.pitch)
        self.lower: list[list[int]] = [[] for _ in range(count)]
        """Of each brick those it is pressed on, GROUND among them."""
        self.upper: list[list[int]] = [[] for _ in range(count)]
        self.knobs: dict[tuple[int, int], Knobs] = {}
        """By lower and upper brick."""
        clutches = lattice.clutches(ground=not self.fixed.any())
        middle = (clutches.first + clutches.last) / 2 * joint.pitch[0] + lattice.offset[:2]
        many = (clutches.last - clutches.first).prod(1)
        ends: list[list[int]] = np.column_stack([clutches.lower, clutches.upper]).tolist()
        for (a, b), n, (x, y) in zip(ends, many.tolist(), middle.tolist(), strict=True):
            self.knobs[a, b] = Knobs(n, (x, y))
            self.lower[b].append(a)
            if a != GROUND:
                self.upper[a].append(b)
        self._pairs = clutches.lower, clutches.upper
        self.based: np.ndarray = np.array([GROUND in lower for lower in self.lower])
        low, high = lattice.low, lattice.high
        meet = (low[:, None, :2] < high[None, :, :2]).all(2)
        meet &= (high[:, None, :2] > low[None, :, :2]).all(2)
        over = meet & (low[None, :, 2] >= high[:, None, 2])
        self.over: list[NDArray[np.intp]] = [np.flatnonzero(row) for row in over]
        """Of each brick those that are above it, wherever; and those below."""
        self.under: list[NDArray[np.intp]] = [np.flatnonzero(row) for row in over.T]
        self._over = sp.csr_matrix(over.astype(float))
        self._under = self._over.T.tocsr()
        self._centre = np.array([block.centroid[:2] for block in blocks])

    def open(self, present: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """bool[B] each: bricks over which, and under which, nothing is there, wherever.

        Args:
            present: bool[B], bricks that are there.
        """
        there = present.astype(float)
        return np.equal(self._over @ there, 0), np.equal(self._under @ there, 0)

    def loose(self, present: np.ndarray, held: np.ndarray | None = None) -> np.ndarray:
        """int64[n]: bricks that hang on nothing that stands.

        Args:
            present: bool[B], bricks that are there.
            held: bool[B], those that hands hold.
        """
        still = self.fixed if held is None else self.fixed | held
        return np.flatnonzero(hanging(*self._pairs, present, still))

    def meets(self, brick: int, present: np.ndarray, below: bool = False) -> list[int]:
        """What is there of what a brick is pressed on, or from below on its own knobs."""
        others = self.upper[brick] if below else self.lower[brick]
        return [m for m in others if m == GROUND or present[m]]

    def press(self, group: Iterable[int], present: np.ndarray, below: bool = False) -> Press:
        """Where some bricks that come to what is there are pressed home: over the middle of the
        knobs they meet. Whoever presses chooses where, and does not tilt the brick."""
        most, chosen, total, where = -1, -1, 0, np.zeros(2)
        for b in group:
            own = 0
            for other in self.meets(b, present, below):
                one = self.knobs[(b, other) if below else (other, b)]
                own, where = own + one.count, where + one.count * np.array(one.middle)
            total += own
            if own > most:
                most, chosen = own, b
        return Press(chosen, total, _rounded(where / total) if total else self.middle(chosen))

    def middle(self, brick: int) -> tuple[float, float]:
        """Of a brick, x and y [m]."""
        return _rounded(self._centre[brick])


def hanging(
    lower: np.ndarray, upper: np.ndarray, present: np.ndarray, still: np.ndarray
) -> np.ndarray:
    """bool[B]: bricks that hang on nothing that stands.

    Args:
        lower, upper: int64[k], the two of every joint; lower below 0 is the ground.
        present: bool[B], bricks that are there.
        still: bool[B], those that stand by themselves, where they are there.
    """
    count = len(present)
    on = present[upper] & ((lower < 0) | present[lower])
    stand = np.flatnonzero(present & still)
    first = np.concatenate([np.where(lower < 0, count, lower)[on], np.full(len(stand), count)])
    pair = first, np.concatenate([upper[on], stand])
    graph = sp.coo_matrix((np.ones(len(first)), pair), (count + 1, count + 1))
    piece = connected_components(graph, directed=False)[1]
    return present & (piece[:-1] != piece[-1])


def _rounded(at: np.ndarray) -> tuple[float, float]:
    x, y = (round(v, 9) for v in at.tolist())
    return x, y
