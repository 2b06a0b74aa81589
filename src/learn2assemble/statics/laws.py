"""What may carry a state of blocks, as one interface over several proofs.

Where all joints are level, loads are passed down block by block (:mod:`.step_proof`), which needs
no friction; else forces in Coulomb's cone balance the state (:mod:`.states`). Joints that hold bear
what their strength allows (:mod:`.holding.program`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.contacts import Contacts, shrunk
from learn2assemble.assembly.hands import Hand
from learn2assemble.linear_programs import INF, Clock
from learn2assemble.statics.holding.check import JointAnswer, margin_n, reference
from learn2assemble.statics.holding.forces import among
from learn2assemble.statics.holding.near import NearForces
from learn2assemble.statics.holding.program import Balance, Push, balance_of
from learn2assemble.statics.proofs import CLUTCH, CLUTCH_TIGHT, LOCAL, MORTAR, PROGRAM
from learn2assemble.statics.sideways import Sideways
from learn2assemble.statics.states import Pushes, State, States
from learn2assemble.statics.step_proof import (
    EDGE_INSET,
    Proof,
    Stack,
    changed,
    lies_below,
    stack_of_contacts,
)

_LEVEL = 1 - 1e-6
_KEPT = 2e8
"""Bytes of forces that are kept."""
_FEW = 50, 100
"""Blocks of joints that hold up to which margins are found in g, and in newtons."""
_LARGE, _NARROW = 100, 0.75
"""Blocks from which programs are made anew, when so small a share of theirs is there."""


class Shown(NamedTuple):
    """What is known of a state that stands."""

    proof: str
    """What proves it."""
    margin_g: float | None
    """The sideways acceleration in every direction that it withstands [g], where it is known."""
    margin_n: float | None = None
    """Of clutches, what a contact point can pull more than it needs to [N], where it is known."""


class Law(Protocol):
    """What may carry."""

    def stands(self, state: State, thorough: bool = True) -> bool:
        """Whether a state is proven; where it is, its forces are the ones to go on from.

        Args:
            thorough: False gives up early where it is not close to the last state that stands.
        """
        ...

    def rests(self, state: State, block: int) -> bool:
        """Whether a block is carried where all others bear any load, without being squeezed in."""
        ...

    def report(self, state: State) -> Shown:
        """Of a state that stands."""
        ...

    def moving(self, state: State) -> list[int]:
        """Blocks that move first in a state that falls."""
        ...

    def falls(self, state: State) -> bool:
        """Whether no forces balance a state: it falls for certain."""
        ...


class Proven:
    """States that are proven by one of some laws, remembered.

    Args:
        laws: what may carry a state, asked in this order.
    """

    def __init__(self, laws: Sequence[Law]) -> None:
        self.laws: Sequence[Law] = laws
        self.known: dict[bytes, tuple[int, int | None]] = {}
        """Of a state, the last law that was asked, and by which it stands."""

    def law(self, state: State, most: int | None = None) -> int | None:
        """The number of the first law by which a state stands, or None.

        Args:
            most: laws behind this one are not asked, and others give up early.
        """
        last = len(self.laws) - 1 if most is None else most
        asked, found = self.known.get(state.key, (-1, None))
        for number in range(asked + 1, last + 1):
            if found is None and self.laws[number].stands(state, most is None):
                found = number
        if most is None or found is not None:
            self.known[state.key] = last, found
        return found

    def stands(self, state: State, new: Iterable[int] = (), most: int | None = None) -> bool:
        """Whether a state is proven, and its ``new`` blocks rest in it; ``most`` as in law."""
        number = self.law(state, most)
        return number is not None and all(self.laws[number].rests(state, b) for b in new)


class ByForces:
    """Forces of elastic joints with Coulomb friction: the coupled analysis.

    Args:
        proof: what a step is called whose state it proves.
        friction: coefficients at which a state has to stand, the smallest first.
        clock: margins are found until so long after its time is over as that was; without one all.
    """

    def __init__(
        self,
        assembly: Assembly,
        contacts: Contacts,
        proof: str,
        friction: list[float],
        clock: Clock | None = None,
    ) -> None:
        self.states: States = States(assembly, contacts, friction)
        self.proof = proof
        self.clock = clock
        self._pushes = Pushes(self.states, friction[0])
        self._rests: dict[tuple[int, bytes], bool] = {}

    def stands(self, state: State, thorough: bool = True) -> bool:
        return self.states.stands(state, thorough)

    def rests(self, state: State, block: int) -> bool:
        near = sorted(self.states.near[block])
        if state.rigid[block]:
            return True
        key = block, state.near([block, *near])
        if key not in self._rests:
            self._rests[key] = self.states.rests(state, block)
        return self._rests[key]

    def report(self, state: State) -> Shown:
        over = self.clock is not None and self.clock.spent > 2 * self.clock.limit
        return Shown(self.proof, None if over else self._pushes.follow(state))

    def moving(self, state: State) -> list[int]:
        return self.states.moving(state)

    def falls(self, state: State) -> bool:
        return self.states.falls(state)


class ByLoads:
    """Loads passed down through level joints, without friction; hands hold nothing here.

    States may have more blocks than the assembly, behind its own: what stands on these is not
    proven here.

    Args:
        stack: the blocks and their level joints.
        fixed: bool[B], supports.
        friction: that bounds the margins.
    """

    def __init__(self, stack: Stack, fixed: np.ndarray, friction: float, clock: Clock) -> None:
        self.stack = stack
        self.fixed = fixed
        self.clock = clock
        self.proof: Proof = Proof(stack)
        self._upright = Proof(stack)
        self._before = self._told = np.zeros(len(fixed), bool)
        self._sideways = Sideways(stack, friction)
        self._rank = -1
        self._solved: dict[bytes, np.ndarray] = {}
        """Forces of states that took more than a local proof."""

    @classmethod
    def of_contacts(
        cls, assembly: Assembly, contacts: Contacts, friction: float, clock: Clock
    ) -> ByLoads:
        """That of an assembly with level contacts only."""
        blocks = assembly.blocks
        least = min(float(np.ptp(block.vertices, axis=0)[:2].min()) for block in blocks)
        stack = stack_of_contacts(blocks, shrunk(contacts, EDGE_INSET * least))
        return cls(stack, np.array([block.support for block in blocks]), friction, clock)

    @staticmethod
    def fits(contacts: Contacts) -> bool:
        """Whether all contacts are level, and known to be."""
        level = (np.abs(contacts.normal[:, 2]) > _LEVEL) & (contacts.spread == 0)
        return bool(level.all())

    def stands(self, state: State, thorough: bool = True) -> bool:
        placed = self._placed(state)
        if state.held.any() or state.present[len(placed) :].any():
            return False
        if self._balance(self.proof, self._before, placed, self.clock.left) is None:
            return False
        self._before = placed
        return True

    def rests(self, state: State, block: int) -> bool:
        return True  # Without friction nothing is squeezed.

    def report(self, state: State) -> Shown:
        """States come in the order in which they are built."""
        placed = self._placed(state)
        dirty = changed(self.stack, self._told, placed)
        # It was proven before, so no time is too short for telling how.
        method = self._balance(self._upright, self._told, placed, INF)
        assert method is not None
        self._sideways.follow(dirty, placed, self._upright.force, self.clock)
        rank = int(self.stack.rank[placed & ~self._told].max(initial=-1))
        # What was taken away, and states in between that were proven otherwise, may leave more.
        more = (self._told & ~placed).any() or (placed ^ self._told).sum() > 1
        weak = method == PROGRAM and self._sideways.radius <= 0
        if rank > self._rank or more or weak:
            self._rank = max(rank, self._rank)
            self._sideways.search(placed, self._upright.force, self.clock)
        self._told = placed
        return Shown(method, self._sideways.radius)

    def moving(self, state: State) -> list[int]:
        return self.proof.held(self._placed(state), self.clock.left)

    def falls(self, state: State) -> bool:
        return False  # With friction it may stand.

    def _placed(self, state: State) -> np.ndarray:
        """bool[n]: blocks that have to be carried."""
        return state.present[: len(self.fixed)] & ~self.fixed

    def _balance(
        self, proof: Proof, before: np.ndarray, placed: np.ndarray, seconds: float
    ) -> str | None:
        """How the forces of a state are made those of the next, or None where it falls, or where
        one of the programs takes longer than so many seconds."""
        dirty = changed(self.stack, before, placed)
        if proof.settle(dirty, placed):
            return LOCAL
        key, some = placed.tobytes(), np.flatnonzero(dirty).tolist()
        if key in self._solved:
            proof.force = self._solved[key].copy()
            return PROGRAM
        forces = proof.force.copy()
        for block in some:
            alone = np.zeros_like(placed)
            alone[block] = True
            # With nothing on it, a block that its own bed faces cannot balance falls for sure.
            free = not placed[self.stack.tops[block]].any()
            if free and proof.program(placed, alone, seconds) is False:
                return None
        # That was a question: with its answer kept, the blocks below would not be looked at.
        proof.force = forces
        found = proof.settle(dirty, placed, mends=True)
        for blocks in (lies_below(self.stack, some, placed), placed):
            found = found or bool(proof.program(placed, blocks, seconds))
        if found and len(self._solved) * proof.force.nbytes < _KEPT:
            self._solved[key] = proof.force.copy()
        return PROGRAM if found else None


class ByStrength:
    """Forces of joints that hold, up to their strength.

    Args:
        assembly: steps are not looked at.
        found: the answer for all of it.
    """

    def __init__(self, assembly: Assembly, found: JointAnswer) -> None:
        self.assembly = assembly
        self.balance: Balance = found.balance
        self.sides: bool = found.tight
        self.proof = CLUTCH_TIGHT if found.tight else CLUTCH
        self._forces, self._narrow = found.forces, found.balance
        self._scope = np.arange(len(assembly.blocks))
        self._near = NearForces(found.balance, found.forces)
        self._known: dict[tuple[bytes, Push | None], bool] = {}

    def stands(self, state: State, thorough: bool = True, push: Push | None = None) -> bool:
        """As of a :class:`Law`, also while something pushes a block; answers are kept.

        Args:
            thorough: False asks for no program of all bricks, which many bricks make slow.
        """
        key = state.key, push
        if key not in self._known:
            # What is close by knows hands that bear any load alone.
            if not state.hands and self._near.stands(state.present, state.held, push):
                self._known[key] = True
            elif not thorough:
                return False
            else:
                self._known[key] = self._asked(state, push)
        return self._known[key]

    def rests(self, state: State, block: int) -> bool:
        return True  # Joints that hold squeeze nothing in.

    def report(self, state: State) -> Shown:
        """Margins of few bricks alone: they take longer than the order of many."""
        count = len(self.assembly.blocks)
        g = self.margin_g(state) if count <= _FEW[0] else None
        return Shown(self.proof, g, self.margin_n(state) if count <= _FEW[1] else None)

    def margin_g(self, state: State) -> float:
        """Sideways acceleration [g] in every direction that a state withstands that stands."""
        balance, scope = self._program(state)
        return balance.margin_g(*_parts(state, scope))

    def margin_n(self, state: State) -> float | None:
        """What a contact point can pull more than a state needs [N]."""
        balance, scope = self._program(state)
        present, held, hands = _parts(state, scope)
        # Forces of any kind to begin with: from far away the least share takes far longer.
        balance.stands(present, held, hands=hands)
        need = balance.need(present, held, hands=hands)
        return margin_n(need.share, reference(self.assembly))

    def moving(self, state: State) -> list[int]:
        return self.balance.holding(state.present, state.held, state.hands).moving

    def falls(self, state: State) -> bool:
        return not self.stands(state)

    def _program(self, state: State) -> tuple[Balance, np.ndarray]:
        """A program over not many more blocks than are there, and int64[n] these blocks."""
        scope, present = self._scope, state.present
        few = len(scope) > _LARGE and present.sum() < _NARROW * len(scope)
        if few or present[scope].sum() != present.sum():
            self._scope = scope = np.flatnonzero(present if few else np.ones_like(present))
            blocks = tuple(self.assembly.blocks[k] for k in scope.tolist())
            forces = among(self._forces, scope)
            self._narrow = Balance(replace(self.assembly, blocks=blocks), forces, self.sides)
        return self._narrow, scope

    def _asked(self, state: State, push: Push | None) -> bool:
        if not state.present.any():
            return True
        balance, scope = self._program(state)
        if push is not None:
            push = push._replace(block=int(np.searchsorted(scope, push.block)))
        present, held, hands = _parts(state, scope)
        stands = balance.stands(present, held, push, hands)
        if stands and push is None and not hands:
            self._near.begin(state.present, state.held)
        return stands


def _parts(state: State, scope: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict[int, Hand]]:
    """Of some blocks int64[n], which are there, which are held, and what the hands can give."""
    number = {b: k for k, b in enumerate(scope.tolist())}
    hands = {number[b]: hand for b, hand in state.hands.items()}
    return state.present[scope], state.held[scope], hands


class ByMortar:
    """Forces of joints of which those hold that mortar has had its time to hold; the rest is dry.

    Args:
        assembly: steps are not looked at.
        dry: the law of the same blocks where no mortar holds.
        clock: where its time is over, no state is known to stand by mortar.
    """

    def __init__(self, assembly: Assembly, dry: Law, clock: Clock) -> None:
        self.assembly = assembly
        self.dry = dry
        self.clock = clock
        self._young = np.zeros(len(assembly.blocks), bool)
        self._at_once = any(joint.holds and joint.age == 0 for joint in assembly.laws)
        self._cured, self._balance = self._young, self._made(self._young)

    def _made(self, cured: np.ndarray) -> Balance:
        balance = balance_of(self.assembly, cured=cured)
        balance.clock = self.clock
        return balance

    def stands(self, state: State, thorough: bool = True) -> bool:
        balance = self._of(state)
        if balance is None:
            return False
        return balance.stands(state.present, state.held, hands=state.hands)

    def rests(self, state: State, block: int) -> bool:
        """What mortar holds is not squeezed; a block that has just come is dry."""
        held = self._at_once or (state.cured is not None and bool(state.cured[block]))
        return held or self.dry.rests(state, block)

    def report(self, state: State) -> Shown:
        """Margins of few blocks alone: they take longer than the order of many."""
        balance = self._of(state)
        assert balance is not None
        few = len(self.assembly.blocks) <= _FEW[0]
        g = balance.margin_g(state.present, state.held, state.hands) if few else None
        return Shown(MORTAR, g)

    def moving(self, state: State) -> list[int]:
        balance = self._of(state)
        if balance is None:
            return self.dry.moving(state)
        return balance.holding(state.present, state.held, state.hands).moving

    def falls(self, state: State) -> bool:
        return self.dry.falls(state) and not self.stands(state) and self.clock.left > 0

    def _of(self, state: State) -> Balance | None:
        """The program where the joints of a state hold that are old enough; None where none do."""
        if state.cured is None and not self._at_once:
            return None
        cured = self._young if state.cured is None else state.cured
        if (cured != self._cured).any():
            self._cured, self._balance = cured, self._made(cured)
        return self._balance
