"""Whether one state of an assembly after another stands, and what pushes it withstands.

The states of a building differ by one block, one support or one hand. Each is proven by the coupled
analysis from the motion of the state before (:mod:`.elastic_joints`), in a few sparse
factorisations, and its margin follows from the forces of the state before, of which only those near
a block that they no longer balance are found again.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.contacts import Contacts
from learn2assemble.assembly.hands import Hand
from learn2assemble.constants import GRAVITY
from learn2assemble.geometry.circles import inner_circle
from learn2assemble.statics.forces.block_factors import elimination_ranks, ranks_of
from learn2assemble.statics.forces.block_forces import (
    BALANCED,
    BALANCED_COUPLED,
    MOVES,
    corner_softness,
    corner_wrenches,
)
from learn2assemble.statics.forces.elastic_joints import Joined, add_wrenches
from learn2assemble.statics.forces.equilibrium import STIFFNESS, solve
from learn2assemble.statics.forces.hands import NO_HANDS, held_blocks

_HOPS = 2
"""Contacts by which what a change reaches grows before everything is looked at."""
_DIRECTIONS = 8
"""In how many directions a push is proven; all others follow from these."""
_LOWER, _HIGHER = 0.75, 1.5
"""By how much pushes that are tried next differ, at first."""
_LEAST = 1e-3
"""Smallest push that is looked for [g]."""
ROCKS = 0.02
"""Sideways acceleration [g] that a block on edges or points has to withstand: where these are is
known to 1 % of the edge of the block, whose centre is half an edge above them."""
_PAUSE = 16
"""Most states between two looks for larger pushes."""


@dataclass(frozen=True, eq=False)
class State:
    """Which blocks are there, and which of them a hand holds.

    Attributes:
        present: bool[B].
        held: bool[B].
        cured: bool[B], those that were there when one last waited until mortar holds; None before.
        hands: of blocks that are held, what the hand can give; without it, it bears any load.
    """

    present: np.ndarray
    held: np.ndarray
    cured: np.ndarray | None = None
    hands: Mapping[int, Hand] = field(default_factory=dict[int, Hand])

    @property
    def rigid(self) -> np.ndarray:
        """bool[B]: blocks that a hand holds which bears any load."""
        found = self.held.copy()
        found[list(self.hands)] = False
        return found

    @property
    def key(self) -> bytes:
        """Of tables of states."""
        cured = b"" if self.cured is None else self.cured.tobytes()
        return self.present.tobytes() + self.held.tobytes() + cured + self._grips(self.hands)

    def near(self, blocks: Sequence[int]) -> bytes:
        """Which of some blocks are there, which of them mortar holds, and what hands give them."""
        cured = b"" if self.cured is None else self.cured[blocks].tobytes()
        some = set(blocks) & set(self.hands)
        return self.present[blocks].tobytes() + cured + self._grips(some)

    def _grips(self, blocks: Iterable[int]) -> bytes:
        return b"".join(b"%d:" % b + self.hands[b].key for b in sorted(blocks))

    def change(
        self,
        *,
        place: Iterable[int] = (),
        remove: Iterable[int] = (),
        hold: Iterable[int] = (),
        release: Iterable[int] = (),
        wait: Sequence[int] = (),
        hand: Hand | None = None,
    ) -> State:
        """The state after blocks were placed, removed, held and released, in this order.

        Args:
            wait: not empty where one has waited until the mortar of all that was there holds.
            hand: that holds a block; by default it bears any load.
        """
        present, held = self.present.copy(), self.held.copy()
        for blocks, array, value in (
            (place, present, True),
            (remove, present, False),
            (hold, held, True),
            (release, held, False),
            (remove, held, False),
        ):
            array[list(blocks)] = value
        cured = self.present if wait else self.cured
        hands = {b: one for b, one in self.hands.items() if held[b]}
        hands |= {} if hand is None else {b: hand for b in hold if held[b]}
        return State(present, held, None if cured is None else cured & present, hands)


class States:
    """Answers for the states of one assembly, one after another.

    Args:
        assembly: blocks where they stand.
        contacts: of that assembly; the patches that may carry. Those whose direction is known too
            little for the smallest of the coefficients do not.
        friction: Coulomb coefficients at which a state has to stand, the smallest first.
    """

    def __init__(self, assembly: Assembly, contacts: Contacts, friction: Sequence[float]) -> None:
        self.assembly = assembly
        self.contacts: Contacts = contacts.known(friction[0])
        contacts = self.contacts
        self.friction: tuple[float, ...] = tuple(friction)
        blocks = assembly.blocks
        mass = np.array([block.mass for block in blocks])
        self.mass: np.ndarray = mass / mass.mean()
        self._newton = GRAVITY * float(mass.mean())
        self.centre: np.ndarray = np.array([block.centroid for block in blocks])
        length = float(np.median([block.volume for block in blocks])) ** (1 / 3)
        self._stiffness = 1 / corner_softness(contacts, length)
        self._wrench = np.stack(corner_wrenches(blocks, contacts))
        self.body: np.ndarray = np.stack([contacts.a, contacts.b])[:, contacts.patch]
        self._sharp = (contacts.area == 0)[contacts.patch]
        """Corners of edges and points."""
        self._fixed = np.array([block.support for block in blocks])
        self._radius = np.array(
            [
                np.linalg.norm(block.vertices - at, axis=1).max()
                for block, at in zip(blocks, self.centre, strict=True)
            ]
        )
        self.near: list[set[int]] = [set[int]() for _ in blocks]
        """Blocks that share a patch with each block."""
        pairs: list[list[int]] = np.column_stack([contacts.a, contacts.b]).tolist()
        for a, b in pairs:
            if a >= 0:
                self.near[a].add(b)
                self.near[b].add(a)
        count = len(blocks)
        self.limit: dict[float, np.ndarray] = {mu: contacts.friction(mu) for mu in self.friction}
        """float64[C]: coefficients at the corners."""
        self._motion = {mu: np.zeros((count, 6)) for mu in self.friction}
        self._last = State(self._fixed.copy(), np.zeros(count, bool))
        self._springs = STIFFNESS[0]

    def stands(self, state: State, thorough: bool = True) -> bool:
        """Whether the coupled analysis holds a state with every friction.

        Args:
            thorough: False looks only near the motions of the last state, which takes a fraction of
                the time where there are no forces.
        """
        free = self.free(state)
        near = self._changed(state, free)
        if 2 * len(near) < len(free):
            # Forces that balance everything balance these blocks, too, whatever bears the others.
            joined, corners = self.part(state, near)
            limit = self.limit[self.friction[0]][corners]
            load, zero = self.weight(near), np.zeros((len(corners), 3))
            if not joined.nearest(load, limit, zero, BALANCED)[0]:
                return False
        part, moved = self.part(state, free), dict[float, _JointMotion]()
        for mu in self.friction:
            start = self._start(free, self._motion[mu])
            found = self._coupled(part, free, mu, start, thorough)
            if found is None:
                return False
            moved[mu] = found
        for mu, found in moved.items():
            self._motion[mu][free] = found.motion
            self._springs = found.springs
        self._last = state
        return True

    def _changed(self, state: State, free: np.ndarray) -> np.ndarray:
        """int64: free blocks near what is not as it was in the last state that stands."""
        last = self._last
        other = (state.present != last.present) | (state.held != last.held)
        for block in {*state.hands, *last.hands}:
            other[block] |= state.hands.get(block) is not last.hands.get(block)
        blocks = np.flatnonzero(other).tolist()
        touched = {n for block in blocks for n in (block, *self.near[block])} & set(free.tolist())
        return self.grown(np.array(sorted(touched), np.int64), free)

    def rests(self, state: State, block: int) -> bool:
        """Whether the coupled analysis holds a block where every other one bears any load.

        A block that friction could squeeze in, but that nothing presses, does not pass, nor one
        that is balanced on an edge or a point.
        """
        alone = np.array([block])
        part, start = self.part(state, alone), np.zeros((1, 6))
        if not all(self._coupled(part, alone, mu, start) is not None for mu in self.friction):
            return False
        return not self._sharp[part[1]].any() or self._withstands(part, block, ROCKS)

    def _withstands(self, part: tuple[Joined, np.ndarray], block: int, push: float) -> bool:
        """Whether forces balance a block under a sideways acceleration [g] to each of four sides,
        where every other one bears any load."""
        joined, corners = part
        limit, zero = self.limit[self.friction[0]][corners], np.zeros((len(corners), 3))
        for side in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)):
            load = self.weight(np.array([block]))
            load[0, :2] = push * self.mass[block] * np.array(side)
            if not joined.nearest(load, limit, zero, BALANCED)[0]:
                return False
        return True

    def falls(self, state: State) -> bool:
        """Whether no forces balance a state: it falls for certain."""
        found = solve(
            self.assembly,
            self.contacts,
            self.friction[0],
            present=state.present,
            held=state.held,
            coupled=False,
            hands=state.hands,
        )
        return not found.stands

    def moving(self, state: State) -> list[int]:
        """Blocks that move first in a state that does not stand."""
        free = self.free(state)
        joined, corners = self.part(state, free)
        limit = self.limit[self.friction[0]][corners]
        load = self.weight(free)
        found, answer = joined.nearest(load, limit, np.zeros((len(corners), 3)), BALANCED)
        if found:
            _, answer = joined.coupled(load, limit, STIFFNESS[0], BALANCED_COUPLED)
        size = np.linalg.norm(answer.motion, axis=1)
        return free[size > MOVES * size.max(initial=0.0)].tolist()

    # ------------------------------------------------------------ parts

    def free(self, state: State) -> np.ndarray:
        """int64: the blocks that have to be balanced."""
        return np.flatnonzero(state.present & ~self._fixed & ~state.rigid)

    def live(self, state: State) -> np.ndarray:
        """bool[C]: corners between blocks that are there."""
        a, b = self.body
        return state.present[b] & ((a < 0) | state.present[a])

    @cached_property
    def _rank(self) -> np.ndarray:
        """int64[B]: when each block is eliminated; parts keep the order."""
        return elimination_ranks(len(self.mass), self.body)

    def part(
        self, state: State, blocks: np.ndarray, bears: np.ndarray | None = None
    ) -> tuple[Joined, np.ndarray]:
        """Some blocks and the corners between them and what bears any load.

        Args:
            blocks: int64, ascending.
            bears: bool[B], the other blocks that do; all others by default.

        Returns:
            The part, and which corners of the contacts are its own (int64).
        """
        number = np.full(len(self.mass) + 1, -1)
        number[blocks] = np.arange(len(blocks))
        body = number[self.body]
        mine = self.live(state) & (body >= 0).any(0)
        if bears is not None:
            may = np.append(bears, True)
            may[blocks] = True
            mine &= may[self.body].all(0)
        corners = np.flatnonzero(mine)
        held = held_blocks(state.hands, number, self.centre, self._newton, self._radius)
        joined = Joined(
            body[:, corners],
            self._wrench[:, corners],
            self._stiffness[corners],
            self.mass[blocks],
            held,
            ranks_of(self._rank, blocks),
        )
        return joined, corners

    def weight(self, blocks: np.ndarray) -> np.ndarray:
        """float64[n, 6]: what has to be balanced at some blocks."""
        load = np.zeros((len(blocks), 6))
        load[:, 2] = self.mass[blocks]
        return load

    def bears(self, state: State) -> np.ndarray:
        """bool[B]: blocks that bear any load."""
        return self._fixed | state.rigid

    def loads(self, forces: np.ndarray) -> np.ndarray:
        """float64[B, 6]: what forces float64[C, 3] at the corners do to all blocks."""
        result = np.zeros((len(self.mass), 6))
        add_wrenches(self.body, self._wrench, forces, result)
        return result

    def grown(self, blocks: np.ndarray, free: np.ndarray, hops: int = _HOPS) -> np.ndarray:
        """int64: free blocks within some contacts of the given ones."""
        may, region = set(free.tolist()), set(blocks.tolist())
        front = region
        for _ in range(hops):
            front = {n for block in front for n in self.near[block] if n in may} - region
            region |= front
        return np.array(sorted(region), np.int64)

    def _start(self, free: np.ndarray, known: np.ndarray) -> np.ndarray:
        """float64[n, 6]: motions to start from, of what is new as if one with what it touches."""
        start, last = known[free].copy(), self._last
        moved = last.present & ~last.rigid & ~self._fixed
        blocks: list[int] = free.tolist()
        for k, block in enumerate(blocks):
            if not moved[block]:
                start[k] = 0.0
                base = next((n for n in sorted(self.near[block]) if moved[n]), None)
                if base is not None:
                    turn = known[base, 3:] / self._radius[base]
                    arm = self.centre[block] - self.centre[base]
                    start[k, :3] = known[base, :3] + np.cross(turn, arm)
                    start[k, 3:] = turn * self._radius[block]
        return start

    def _coupled(
        self,
        part: tuple[Joined, np.ndarray],
        blocks: np.ndarray,
        friction: float,
        start: np.ndarray,
        thorough: bool = True,
    ) -> _JointMotion | None:
        """A motion at which forces of the coupled law balance some blocks, or None."""
        joined, corners = part
        load, limit = self.weight(blocks), self.limit[friction][corners]
        # Joints like those of the last state come first: its motions are theirs.
        springs = sorted(STIFFNESS, key=lambda ratio: ratio != self._springs)
        still, zero = np.zeros_like(start), np.zeros((len(corners), 3))
        balances, near = True, None
        if thorough:
            # Most states that fall do so for certain: where no forces balance, no law will.
            balances, near = joined.nearest(load, limit, zero, BALANCED_COUPLED)
        if not balances:
            return None
        for ratio in springs if thorough else springs[:1]:
            starts = start, still
            found, answer = joined.coupled(load, limit, ratio, BALANCED_COUPLED, starts)
            if found:
                return _JointMotion(answer.motion, ratio)
        for ratio in springs:
            if near is None:
                break
            terms = load, limit, ratio, BALANCED_COUPLED
            found, answer = joined.coupled_by_rounds(*terms, near)
            if found:
                return _JointMotion(answer.motion, ratio)
        return None


class _JointMotion(NamedTuple):
    """A motion at which forces balance, and the springs across of the joints, over those along."""

    motion: np.ndarray
    springs: float


class Pushes:
    """Sideways accelerations that states withstand for certain, in directions all round.

    Forces that balance a state under an acceleration prove it, and what lies in the hull of what is
    proven is proven, too. They are kept from state to state.

    Args:
        states: of the assembly.
        most: no larger acceleration is looked for [g].
    """

    def __init__(self, states: States, most: float) -> None:
        self.states = states
        self.most = most
        self.friction: float = states.friction[0]
        angle = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        self.ways: np.ndarray = np.stack([np.cos(angle), np.sin(angle)], 1)
        self.level: np.ndarray = np.full(_DIRECTIONS, most)
        self.forces: NDArray[np.float64] = np.zeros((_DIRECTIONS, states.body.shape[1], 3))
        self.wrenches: NDArray[np.float64] = np.zeros((_DIRECTIONS, len(states.mass), 6))
        """What bounded hands give."""
        self._hands: Mapping[int, Hand] = NO_HANDS
        self._wait = self._waited = 0

    def follow(self, state: State) -> float:
        """An acceleration that this state, the next one, withstands in every direction [g]."""
        free = self.states.free(state)
        if not len(free):
            return self.most
        self.forces[:, ~self.states.live(state)] = 0.0
        other = [b for b, hand in self._hands.items() if state.hands.get(b) is not hand]
        self.wrenches[:, other] = 0.0
        self._hands = state.hands
        off = np.array([self._unbalanced(k, free) for k in range(_DIRECTIONS)])
        lost = np.flatnonzero(off.any(1)).tolist()
        if lost:
            region = self.states.grown(free[off.any(0)], free)
            for blocks in (region, free) if len(region) < len(free) else (free,):
                part = self._part(state, blocks)
                lost = [k for k in lost if not self._settle(k, self.level[k], part)]
                if not lost:
                    break
        whole = self._part(state, free)
        for k in lost:
            self._lower(k, whole)
        self._raise(whole)
        return inner_circle(self.level[:, None] * self.ways)[0]

    def _part(self, state: State, blocks: np.ndarray) -> _StatePart:
        bears = self.states.bears(state)
        return _StatePart(blocks, *self.states.part(state, blocks, bears))

    def _load(self, k: int, level: float) -> np.ndarray:
        load = np.zeros((len(self.states.mass), 6))
        load[:, 2] = self.states.mass
        load[:, :2] = level * self.states.mass[:, None] * self.ways[k]
        return load

    def _unbalanced(self, k: int, free: np.ndarray) -> np.ndarray:
        """bool[n]: free blocks that the forces along a direction do not balance."""
        rest = self._load(k, self.level[k]) - self.states.loads(self.forces[k]) - self.wrenches[k]
        return np.linalg.norm(rest[free], axis=1) > BALANCED * self.states.mass[free]

    def _settle(self, k: int, level: float, part: _StatePart) -> bool:
        """Balance some blocks under an acceleration along a direction; False: nothing changed."""
        blocks, joined, corners = part
        other = self.forces[k].copy()
        near = other[corners]
        other[corners] = 0.0
        load = (self._load(k, level) - self.states.loads(other))[blocks]
        limit, held = self.states.limit[self.friction][corners], blocks[joined.hands.body]
        terms = load, limit, near, 0.5 * BALANCED, None, self.wrenches[k][held]
        found, answer = joined.nearest(*terms)
        if found:
            self.forces[k][corners], self.level[k] = answer.forces, level
            self.wrenches[k][held] = answer.wrenches
        return found

    def _lower(self, k: int, whole: _StatePart) -> None:
        share = _LOWER
        while (level := self.level[k] * share) >= _LEAST:
            if self._settle(k, level, whole):
                return
            share *= share  # Where much has changed, a few tries lead far down.
        self.level[k] = 0.0
        self._settle(k, 0.0, whole)

    def _raise(self, whole: _StatePart) -> None:
        """Look for larger pushes in the weakest directions, less often where there are none."""
        self._waited += 1
        if self._waited < self._wait or self.level.min() >= self.most:
            return
        raised = False
        while self.level.min() < self.most:
            k = int(self.level.argmin())
            higher = min(max(_HIGHER * self.level[k], 4 * _LEAST), self.most)
            if not self._settle(k, higher, whole):
                break
            raised = True
        self._waited, self._wait = 0, 0 if raised else min(max(2 * self._wait, 1), _PAUSE)


class _StatePart(NamedTuple):
    blocks: np.ndarray
    joined: Joined
    corners: np.ndarray
