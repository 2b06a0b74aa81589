"""A design as a sequence of placements: which are possible, which stand, and what they leave.

The state is the array of filled cells, the blocks put down so far and what is left of the heap. A
*candidate* is a kind of block, turned, at a place, all of whose cells are wanted and open. It is
*legal* where

* every wanted cell directly below it is filled (what is built over could not be filled from above
  any more) and at least one is, or it lies on the table;
* its centroid is above the hull of what carries it, since it would tip at once otherwise;
* the heap has such a block.

A legal placement is carried out only where :mod:`learn2assemble.statics.step_proof` proves that
the new state stands. Candidates are found once; every placement then changes only what it touches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from learn2assemble.assembly.kit import Cell, Kit, orientations
from learn2assemble.planning.tiling.cover.candidates import (
    BlockPlacement,
    Candidates,
    find_candidates,
)
from learn2assemble.planning.tiling.cover.tile import Tiling, check_cells
from learn2assemble.planning.tiling.laying import SiteArrays, WorldArrays, fill, lay, pack, run_out
from learn2assemble.planning.tiling.props import FIRM, choose_props
from learn2assemble.planning.tiling.stack import block_masses, find_stack, grow_stack
from learn2assemble.statics.step_proof import EDGE_INSET, Proof, Stack, lies_below


@dataclass(frozen=True, eq=False)
class LatticeSite:
    """What does not change while a design is built."""

    wanted: np.ndarray
    """bool[X, Y, Z]."""
    kit: Kit
    found: Candidates
    """Every placement whose centroid is above what the design gives it as support; where props may
    be used, also those that fill a cell which none of these does."""
    kind: np.ndarray
    """int64[n]: index of the kind of every candidate."""
    over_start: np.ndarray
    over: np.ndarray
    """Candidates that fill a cell: ``over[over_start[c]:over_start[c + 1]]``, flat cell c."""
    on_start: np.ndarray
    on: np.ndarray
    """Candidates that rest on a cell, likewise."""
    rests: np.ndarray
    """int64[n]: wanted cells directly below a candidate."""
    weight: np.ndarray
    """float64[ways]: weight of a block put down so [kg]."""
    centre: np.ndarray
    """float64[ways, 3]: its centre of mass from the corner of its cells [m]."""
    limits: np.ndarray
    """int64[kinds]: blocks in the heap at the start, -1 without limit."""
    props: bool = False
    """Whether blocks that fall may be propped up."""

    def __len__(self) -> int:
        return len(self.found)

    def cells(self, candidate: int) -> np.ndarray:
        """int64[m]: flat indices of the cells of a candidate."""
        start = self.found.start
        return self.found.cell[start[candidate] : start[candidate + 1]]

    def placement(self, candidate: int) -> BlockPlacement:
        """The candidate as the planners write it."""
        way = self.found.ways[int(self.found.way[candidate])]
        x, y, z = (int(v) for v in self.found.origin[candidate])
        return BlockPlacement(self.kit.kinds[way.kind].name, way.turn, (x, y, z))

    def candidates(self, placements: Sequence[BlockPlacement]) -> np.ndarray:
        """int64[k]: indices of placements; -1 for one that is none, as nothing carries it."""
        if not len(self):
            return np.full(len(placements), -1)
        ways = [self._way_of.get((one.kind, one.turn), -1) for one in placements]
        way = np.array(ways, np.int64)
        origin = np.array([one.origin for one in placements], np.int64).reshape(-1, 3)
        number: np.ndarray = self._place_number(way, *origin.T)
        index = np.searchsorted(self._places, number)
        near = np.minimum(index, len(self) - 1)
        there = (self.found.way[near] == way) & (self.found.origin[near] == origin).all(1)
        return np.where(there & (index < len(self)), near, -1)

    def _place_number(self, way: Any, x: Any, y: Any, z: Any) -> Any:
        """Grows with the way of a candidate, then with x, y and z of its origin."""
        wide, deep, high = self.wanted.shape
        return ((way * wide + x) * deep + y) * high + z

    @cached_property
    def _places(self) -> np.ndarray:
        """int64[n]: numbers by which candidates are in order."""
        x, y, z = self.found.origin.T
        return self._place_number(self.found.way, x, y, z)

    @cached_property
    def arrays(self) -> SiteArrays:
        """What kernels take of it."""
        found = self.found
        return SiteArrays(
            found.start,
            found.cell,
            found.way,
            found.origin,
            self.kind,
            self.over_start,
            self.over,
            self.on_start,
            self.on,
            self.weight,
            self.centre,
        )

    @cached_property
    def _way_of(self) -> dict[tuple[str, int], int]:
        """Numbers of ways by kinds and turns."""
        kinds = self.kit.kinds
        return {(kinds[way.kind].name, way.turn): k for k, way in enumerate(self.found.ways)}


def make_site(wanted: np.ndarray, kit: Kit, props: bool = False) -> LatticeSite:
    """Every candidate of a design.

    Args:
        props: also those that only a prop carries, for cells that nothing else fills.

    Raises:
        InputError: for cells that cannot be used.
    """
    wanted = check_cells(wanted)
    found = find_candidates(wanted, kit)
    good = found.support > FIRM
    if props:
        firm = np.zeros(wanted.size, bool)
        firm[found.take(np.flatnonzero(good)).cell] = True
        needed = np.logical_or.reduceat(~firm[found.cell], found.start[:-1])
        good |= needed & (found.support > -np.inf)
    found = found.take(np.flatnonzero(good))
    n, cells = len(found), wanted.size
    candidate = np.repeat(np.arange(n), found.size())
    over_start, over = _grouped(found.cell, candidate, cells)
    z = found.cell % wanted.shape[2]
    rests = found.lowest & (z > 0) & wanted.reshape(-1)[np.maximum(found.cell - 1, 0)]
    on_start, on = _grouped(found.cell[rests] - 1, candidate[rests], cells)
    weight, centre = _bodies(kit.unlimited)
    limits = [-1 if kind.count is None else kind.count for kind in kit.kinds]
    return LatticeSite(
        wanted,
        kit,
        found,
        found.kind,
        over_start,
        over,
        on_start,
        on,
        np.bincount(candidate[rests], minlength=n),
        weight,
        centre,
        np.array(limits, np.int64),
        props,
    )


@lru_cache(maxsize=16)
def _bodies(kit: Kit) -> tuple[np.ndarray, np.ndarray]:
    """Weight float64[w] [kg] and centre of mass float64[w, 3] [m], from the corner of its cells, of
    a block in every way of a kit (:func:`orientations`)."""
    ways = orientations(kit)
    shapes = [np.max(way.cells, axis=0) + 1 for way in ways]
    masses = [
        block_masses(
            (BlockPlacement(kit.kinds[way.kind].name, way.turn, (0, 0, 0)),),
            kit,
            tuple(int(v) for v in shape),
        )
        for way, shape in zip(ways, shapes, strict=True)
    ]
    weight = np.array([w[0] for w, _ in masses])
    centre = np.array(
        [
            at[0] + np.array([*shape[:2] / 2, 0.0]) * kit.pitch
            for (_, at), shape in zip(masses, shapes, strict=True)
        ]
    ).reshape(-1, 3)
    return weight, centre


def _grouped(key: np.ndarray, value: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Values by key: those of key k are ``values[start[k]:start[k + 1]]``."""
    order = np.argsort(key, kind="stable")
    return np.searchsorted(key[order], np.arange(count + 1)), value[order]


class LatticeWorld:
    """A design while it is built.

    Args:
        site: see :func:`make_site`.
    """

    def __init__(self, site: LatticeSite) -> None:
        self.site = site
        size = site.wanted.size
        self.owner: np.ndarray = np.full(size, -1)
        """int64[cells]: number of the block that fills a flat cell, -1 for none."""
        self.alive: np.ndarray = np.ones(len(site), bool)
        """bool[n]: candidates whose cells are open and whose kind the heap has."""
        self.waits: np.ndarray = site.rests.copy()
        """int64[n]: cells below a candidate that have to be filled before."""
        self.cover: NDArray[np.int64] = np.diff(site.over_start).astype(np.int64)
        """int64[cells]: candidates that are alive and would fill a cell."""
        self.heap: np.ndarray = site.limits.copy()
        """int64[kinds]: blocks that are left, -1 without limit."""
        self.placed: list[int] = []
        """Candidates in the order they were put down."""
        self.propped: list[int] = []
        """Numbers of those of them that did not stand when they were put down: props hold them, so
        they carry what is put on them, and are not balanced before all is built."""
        self.open: int = int(site.wanted.sum())
        """Number of wanted cells that are open."""
        self.proof: Proof = _nothing(site.kit)
        for kind in np.flatnonzero(self.heap == 0):
            run_out(int(kind), site.arrays, self.arrays)

    def copy(self) -> LatticeWorld:
        """A world that goes its own way."""
        other = object.__new__(LatticeWorld)
        other.site, other.open, other.proof = self.site, self.open, self.proof
        for name in ("owner", "alive", "waits", "cover", "heap", "placed", "propped"):
            setattr(other, name, getattr(self, name).copy())
        return other

    @property
    def arrays(self) -> WorldArrays:
        """What kernels change of it."""
        return WorldArrays(self.owner, self.alive, self.waits, self.cover, self.heap)

    @property
    def complete(self) -> bool:
        """Whether every wanted cell is filled."""
        return self.open == 0

    def legal(self) -> np.ndarray:
        """int64[m]: legal candidates; what stands is only known when it is tried."""
        return np.flatnonzero(self.alive & (self.waits == 0))

    def stranded(self) -> np.ndarray:
        """int64[k]: flat indices of open cells that no candidate fills any more: a dead end."""
        wanted = self.site.wanted.reshape(-1)
        return np.flatnonzero(wanted & (self.owner < 0) & (self.cover == 0))

    def room(self) -> np.ndarray:
        """int64[kinds]: how many blocks of a kind, all alike, could still be put beside each other.

        Packed greedily, which is exact for walls one cell thick and else may be too few.
        """
        found = self.site.found
        return pack(
            np.flatnonzero(self.alive),
            self.site.kind,
            len(self.heap),
            found.start,
            found.cell,
            len(self.owner),
        )

    def place(self, candidate: int, program: bool = False) -> bool:
        """Put down a legal candidate if the new state is proven to stand.

        Args:
            program: where the local proof fails, ask the linear program.
        """
        if self.lay([candidate]):
            return True
        proof = self._by_program(candidate) if program else None
        if proof is None:
            return False
        self.proof = proof
        self.put(candidate)
        return True

    def lay(self, candidates: list[int]) -> list[int]:
        """Put down, again and again in the given order, what lies on what is there and stands by
        the local proof, until nothing more does: compiled as a whole.

        Returns:
            the candidates that were put down, in the order in which they were.
        """
        site, stack, count = self.site, self.proof.stack, len(self.placed)
        (x, y, z), (dx, dy, dz) = site.wanted.shape, site.kit.pitch
        arrays, force, laid = lay(
            np.array(candidates, np.int64),
            site.arrays,
            self.arrays,
            np.array(self.propped, np.int64),
            (x, y, z),
            (float(dx), float(dy), float(dz)),
            site.kit.joint_gap / 2 + EDGE_INSET * min(dx, dy),
            stack.arrays,
            self.proof.force,
            count,
        )
        done: list[int] = laid.tolist()
        if done:
            self.proof = Proof(Stack(*arrays, stack.cell))
            self.proof.force = force
            self.placed += done
            self.open -= sum(len(site.cells(candidate)) for candidate in done)
        return done

    def stands(self, candidate: int) -> bool:
        """Whether the local proof holds with one more block; nothing is put down."""
        proof = self._grown(candidate)
        placed, dirty = np.ones(len(proof.stack), bool), np.zeros(len(proof.stack), bool)
        dirty[-1] = True
        return proof.settle(dirty, placed)

    def prop_up(self, candidate: int) -> bool:
        """Put down a legal candidate that falls, where a stack of blocks below it can be a prop."""
        site, block = self.site, self.site.placement(candidate)
        alone = Tiling((block,), site.wanted, "complete")
        if choose_props(alone, site.kit, {0: frozenset((0,))}) is None:
            return False
        self.proof = self._grown(candidate)
        self.propped.append(len(self.placed))
        self.put(candidate)
        return True

    def falls(self) -> list[int]:
        """Numbers of blocks that would have to be held, were all props taken away."""
        if not self.propped:
            return []
        blocks = tuple(self.site.placement(c) for c in self.placed)
        proof = Proof(find_stack(blocks, self.site.kit, self.site.wanted.shape))
        every = np.ones(len(blocks), bool)
        if proof.settle(every, every) or proof.program(every, every):
            return []
        return proof.held(every) or self.propped

    def put(self, candidate: int) -> None:
        """Put down a candidate that is known to stand."""
        site, kind = self.site, int(self.site.kind[candidate])
        fill(site.cells(candidate), len(self.placed), site.arrays, self.arrays)
        self.open -= len(site.cells(candidate))
        self.placed.append(candidate)
        if self.heap[kind] > 0:
            self.heap[kind] -= 1
            if self.heap[kind] == 0:
                run_out(kind, site.arrays, self.arrays)

    def _by_program(self, candidate: int) -> Proof | None:
        """The proof of the state with one more block by the linear program; None where it falls."""
        proof = self._grown(candidate)
        stack, count = proof.stack, len(proof.stack)
        placed = np.ones(count, bool)
        free = placed.copy()
        free[self.propped] = False
        for changing in (lies_below(stack, [count - 1], placed), free):
            if proof.program(placed, changing):
                return proof
        return None

    def _grown(self, candidate: int) -> Proof:
        """The forces with one more block, which nothing balances yet."""
        proof = Proof(grow(self, candidate))
        proof.force[: len(self.proof.force)] = self.proof.force
        return proof

    def cells_open(self) -> list[Cell]:
        """Wanted cells that are open."""
        at = np.argwhere(self.site.wanted & (self.owner < 0).reshape(self.site.wanted.shape))
        return [(int(x), int(y), int(z)) for x, y, z in at]


# ---------------------------------------------------------------- equilibrium, one block at a time


@lru_cache(maxsize=64)
def _nothing(kit: Kit) -> Proof:
    """The proof of no block at all."""
    return Proof(
        Stack(
            np.empty(0),
            np.empty((0, 3)),
            np.empty((0, 3)),
            np.empty(0, np.int64),
            np.empty(0, np.int64),
            np.empty(0),
            np.zeros(1, np.int64),
            np.empty(0, np.int64),
            np.array(kit.pitch[:2]),
        )
    )


def grow(world: LatticeWorld, candidate: int) -> Stack:
    """The stack with one more block, the same as :func:`find_stack` makes of all of them."""
    site, old, pitch = world.site, world.proof.stack, world.site.kit.pitch
    x, y, z = site.wanted.shape
    way = int(site.found.way[candidate])
    made = grow_stack(
        site.cells(candidate),
        world.owner,
        np.array(world.propped, np.int64),
        (x, y, z),
        (float(pitch[0]), float(pitch[1]), float(pitch[2])),
        site.kit.joint_gap / 2 + EDGE_INSET * min(pitch[:2]),
        (site.weight[way], site.centre[way], site.found.origin[candidate]),
        old.arrays,
    )
    return Stack(*made, old.cell)


def run(site: LatticeSite, order: list[int]) -> LatticeWorld | None:
    """The world after some candidates, None where one of them is not legal or falls."""
    world = LatticeWorld(site)
    for candidate in order:
        legal = world.alive[candidate] and world.waits[candidate] == 0
        if not legal or not world.place(candidate, program=True):
            return None
    return world


def only(site: LatticeSite, candidates: np.ndarray) -> LatticeWorld:
    """A world in which nothing but some candidates may be put down."""
    world = LatticeWorld(site)
    chosen = np.zeros(len(site), bool)
    chosen[candidates] = True
    world.alive &= chosen
    alive = np.repeat(world.alive, site.found.size())
    world.cover = np.bincount(site.found.cell[alive], minlength=site.wanted.size)
    return world
