"""Whether one state of an assembly after another stands, by changing few contact forces each time.

The states of a building differ by one block, one support or one hand. The forces that balance a
state are kept, and only those near a block that they no longer balance are found again: by a cone
program over that block and what is within a few contacts of it, all other forces as they are; then
over more, at last over everything. A solution of any of these is a solution of the whole (rigid-
block equilibrium, :mod:`.block_forces`), so nothing is called balanced that is not; only the
program over everything can say that a state falls.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.sparse as sp

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.contacts import Contacts
from learn2assemble.statics.block_forces import balancing_forces, corner_softness, corner_wrenches
from learn2assemble.statics.rigid_blocks import margin, solve

HOPS = 2
"""Contacts by which the region grows from one program to the next."""
FEW = 16
"""Blocks up to which everything is looked at at once."""
LOCAL = 60
"""Blocks of the largest region before everything."""
_BALANCED = 1e-6
"""Imbalance of a block, in its own weight, that is rounding."""

Answer = Literal["stands", "falls", "not found"]


@dataclass(frozen=True, eq=False)
class State:
    """Which blocks are there, and which of them a hand holds.

    Attributes:
        present: bool[B].
        held: bool[B]; a block that is held bears any load.
    """

    present: np.ndarray
    held: np.ndarray

    @property
    def key(self) -> bytes:
        """Of tables of states."""
        return self.present.tobytes() + self.held.tobytes()

    def change(
        self,
        *,
        place: Iterable[int] = (),
        remove: Iterable[int] = (),
        hold: Iterable[int] = (),
        release: Iterable[int] = (),
    ) -> State:
        """The state after blocks were placed, removed, held and released, in this order."""
        present, held = self.present.copy(), self.held.copy()
        for blocks, array, value in (
            (place, present, True),
            (remove, present, False),
            (hold, held, True),
            (release, held, False),
            (remove, held, False),
        ):
            array[list(blocks)] = value
        return State(present, held)


class States:
    """Answers for the states of one assembly, and the forces of the last one that stands.

    Args:
        assembly: blocks where they stand.
        contacts: of that assembly; the patches that may carry.
        friction: Coulomb coefficient.
    """

    def __init__(self, assembly: Assembly, contacts: Contacts, friction: float) -> None:
        self.assembly, self.contacts, self.friction = assembly, contacts, friction
        blocks = assembly.blocks
        mass = np.array([block.mass for block in blocks])
        self._mass = mass / mass.mean()
        self._wrench = corner_wrenches(blocks, contacts)
        length = float(np.median([block.volume for block in blocks])) ** (1 / 3)
        self._soft = corner_softness(contacts, length)
        self._fixed = np.array([block.support for block in blocks])
        self._near: list[set[int]] = [set() for _ in blocks]
        for a, b in zip(contacts.a.tolist(), contacts.b.tolist(), strict=True):
            if a >= 0:
                self._near[a].add(b)
                self._near[b].add(a)
        self.forces = np.zeros((len(contacts.points), 3))
        """In the frame of their patch, in mean weights; zero where nothing is."""
        self._a, self._b = contacts.a[contacts.patch], contacts.b[contacts.patch]
        self.programs = 0
        """Solved so far: the measure of work."""

    def answer(self, state: State, *, thorough: bool = True) -> Answer:
        """Whether a state stands; where it does, its forces are kept.

        Args:
            thorough: look at everything where a region finds nothing; without it the answer may be
                ``not found``.
        """
        bears = self._fixed | state.held
        free = state.present & ~bears
        live = self._live(state)
        kept = np.where(live[:, None], self.forces, 0.0)
        off = self._imbalance(kept)
        dirty = np.flatnonzero(free & (off > _BALANCED * self._mass))
        region, last = set(dirty.tolist()), 0
        everything = int(free.sum())
        if region and everything <= FEW:
            region = set(np.flatnonzero(free).tolist())
        while region and len(region) > last:
            if len(region) > LOCAL and len(region) < everything:
                break
            found = self._balance(sorted(region), live, bears, kept)
            if found is not None:
                self.forces = found
                return "stands"
            last = len(region)
            region = self._grown(region, free)
        if not region:
            self.forces = kept
            return "stands"
        if last == everything or not thorough:
            return "falls" if last == everything else "not found"
        found = self._balance(np.flatnonzero(free).tolist(), live, bears, kept)
        if found is None:
            return "falls"
        self.forces = found
        return "stands"

    def rests(self, state: State, block: int) -> bool:
        """Whether the coupled analysis holds a block where every other one bears any load.

        A block that friction could squeeze in, but that nothing presses, does not pass.
        """
        held = np.ones(len(self._fixed), bool)
        held[block] = False
        near = np.zeros(len(self._fixed), bool)
        near[[block, *self._near[block]]] = True
        found = solve(
            self.assembly, self.contacts, self.friction, present=near & state.present, held=held
        )
        return found.stands

    def corners(self, state: State) -> int:
        """Corners of the contacts between what is there: the size of a program over everything."""
        return int(self._live(state).sum())

    def coupled(self, state: State, friction: float) -> bool:
        """Whether the coupled analysis holds the whole of a state."""
        return solve(
            self.assembly, self.contacts, friction, present=state.present, held=state.held
        ).stands

    def margin(self, state: State) -> float:
        """Sideways acceleration that a state withstands in every direction [g]."""
        return margin(
            self.assembly, self.contacts, self.friction, present=state.present, held=state.held
        )

    def _live(self, state: State) -> np.ndarray:
        """bool[C]: corners between blocks that are there."""
        return state.present[self._b] & ((self._a < 0) | state.present[self._a])

    def moving(self, state: State) -> list[int]:
        """Blocks that move first in a state that falls."""
        found = solve(
            self.assembly,
            self.contacts,
            self.friction,
            present=state.present,
            held=state.held,
            coupled=False,
        )
        return found.moving.tolist()

    def near(self, block: int) -> set[int]:
        """Blocks that share a patch with this one."""
        return self._near[block]

    def _grown(self, region: set[int], free: np.ndarray) -> set[int]:
        for _ in range(HOPS):
            region = region | {n for block in region for n in self._near[block] if free[n]}
        return region

    def _imbalance(self, forces: np.ndarray) -> np.ndarray:
        """float64[B]: size of the wrench that is missing at every block, in mean weights."""
        rest = np.zeros((len(self._mass), 6))
        rest[:, 2] = self._mass
        for body, wrench in zip((self._a, self._b), self._wrench, strict=True):
            on = body >= 0
            np.subtract.at(rest, body[on], np.einsum("ck,ckw->cw", forces[on], wrench[on]))
        return np.abs(rest).max(1)

    def _balance(
        self, region: list[int], live: np.ndarray, bears: np.ndarray, kept: np.ndarray
    ) -> np.ndarray | None:
        """Forces of which only those between blocks of a region, and what bears them, are new."""
        inside = np.zeros(len(bears) + 1, bool)
        inside[region] = True
        rigid = np.append(bears, True)  # index -1: the ground
        touch = live & (inside[self._a] | inside[self._b])
        new = touch & (inside | rigid)[self._a] & (inside | rigid)[self._b]
        self.programs += 1
        row = np.full(len(bears), -1)
        row[region] = np.arange(len(region))
        corners = np.flatnonzero(new)
        load = np.zeros((len(region), 6))
        load[:, 2] = self._mass[region]
        entries = []
        for body, wrench in zip((self._a, self._b), self._wrench, strict=True):
            on = touch & inside[body]
            old = np.flatnonzero(on & ~new)
            np.subtract.at(load, row[body[old]], np.einsum("ck,ckw->cw", kept[old], wrench[old]))
            mine = np.flatnonzero(on[corners])
            at = 6 * row[body[corners[mine]]][:, None, None] + np.arange(6)
            column = 3 * mine[:, None, None] + np.arange(3)[:, None]
            entries.append(
                (
                    np.broadcast_to(at, (len(mine), 3, 6)).ravel(),
                    np.broadcast_to(column, (len(mine), 3, 6)).ravel(),
                    wrench[corners[mine]].ravel(),
                )
            )
        rows, columns, values = map(np.concatenate, zip(*entries, strict=True))
        shape = 6 * len(region), 3 * len(corners)
        matrix = sp.csc_matrix((values, (rows, columns)), shape)
        found = balancing_forces(matrix, load.reshape(-1), self._soft[corners], self.friction)
        if found is None:
            return None
        result = kept.copy()
        result[corners] = found
        return result
