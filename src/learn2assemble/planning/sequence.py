"""The search for an order of building: depth first over what may come next, of any blocks.

What may come next, what is proven of the state after it, and along which ways blocks come are
values of :class:`OrderRules`: blocks that are put down one after the other (:mod:`.forward`), or a
finished structure that is taken apart, read backwards (:mod:`.disassembly`, and
:mod:`learn2assemble.cell.taking_apart` by an arm). A dead end is left by
the last choice before it; states that led to one are not looked at again. The search stops by
counted work, with seconds as a cap.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Literal, NamedTuple, Protocol, TypeVar

from learn2assemble.assembly.blocks import Action as BlockAction
from learn2assemble.assembly.blocks import Block
from learn2assemble.assembly.hands import Hand
from learn2assemble.errors import listed
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.crew import CrewOf, anybody
from learn2assemble.progress import Detail
from learn2assemble.statics.laws import Law
from learn2assemble.statics.states import State

Action = Literal["place", "remove", "hold", "release", "wait"]
"""``wait``: until the mortar of all that is there holds; of no block."""
Way = Literal["above", "below", "beside"]
Move = TypeVar("Move")
_FEW = 10
"""Moves up to which a search without patience tries other ones before a dead end."""


class Doing(NamedTuple):
    """What is done to which block."""

    action: Action
    block: int
    way: Way | None = None
    """Of a brick: whence it comes."""
    arm: str | None = None
    """Which arm does it, where there are several."""
    hand: Hand | None = None
    """Of a block that is held: what the hand can give; without it, it bears any load."""

    def after(self, state: State) -> State:
        """The state behind it."""
        what: dict[str, Any] = {self.action: [self.block], "hand": self.hand}
        return state.change(**what)


WAIT = Doing("wait", -1)


def let_go(block: int, state: State) -> Doing:
    """The step in which the hand that holds a block lets it go."""
    hand = state.hands.get(block)
    return Doing("release", block, None, hand.name or None if hand is not None else None)


def let_go_of(
    held: Sequence[int], state: State, stands: Callable[[State, Sequence[int]], bool]
) -> list[Doing] | None:
    """The steps in which hands let go of blocks one after the other, or None.

    Args:
        held: the blocks; the first of them that can be let go is.
        state: with all of these held.
        stands: whether a state is proven, in which some blocks are not held any more.
    """
    if not held:
        return []
    for block in held:
        if stands(after := state.change(release=[block]), [block]):
            rest = let_go_of([other for other in held if other != block], after, stands)
            return None if rest is None else [let_go(block, state), *rest]
    return None


@dataclass(frozen=True)
class Supports:
    """What may carry blocks until they carry themselves.

    Attributes:
        posts: whether posts may be placed.
        holds: how many blocks may be held meanwhile.
        crew: who brings and holds them, given the blocks.
        hands: of bricks that clutch, whether they may come from below, and several as one.
        fewest: whether a few blocks get the fewest posts, which may be wide ones.
        table: whether posts stand no lower than z = 0, an arm's table, which supports may.
    """

    posts: bool = False
    holds: int = 0
    crew: CrewOf = anybody
    hands: bool = False
    fewest: bool = False
    table: bool = False


class Transition(NamedTuple):
    """Steps that belong together, and the state after them."""

    steps: tuple[Doing, ...]
    state: State
    gone: frozenset[int] = frozenset()
    """Props that have been there and been taken away: they do not come again."""


class SequenceStep(NamedTuple):
    """One step, and what is proven of the state after it."""

    action: BlockAction
    block: int
    """Index in the blocks of the sequence."""
    proof: str
    margin_g: float | None
    way: Way | None = None
    """Of a brick, whence it comes: ``above``, ``below``, or ``beside``, where it was built."""
    wait: bool = False
    """Whether one waits before it until the mortar of all that is there holds."""
    margin_n: float | None = None
    """Of bricks that clutch, what a contact point can pull more than it needs to [N]."""
    arm: str | None = None
    """Which arm does it, where there are several."""
    hand: Hand | None = None
    """Of a block that is held: what the hand can give; without it, it bears any load."""


@dataclass(frozen=True)
class Sequenced:
    """An order of building with its supports."""

    blocks: tuple[Block, ...]
    """Those of the assembly, then the posts that are used."""
    steps: tuple[SequenceStep, ...]
    status: Literal["complete", "refused", "not found"]
    reason: str | None = None
    stuck: tuple[int, ...] = ()
    """Blocks that could not be placed, or that move first."""


class OrderRules(Protocol[Move]):
    """What an order is, of some blocks; a move is steps that belong together and what they leave.

    Attributes:
        first: where the search begins, a move without steps.
        tries: moves looked at before it gives up.
    """

    first: Move
    tries: int

    @property
    def patient(self) -> bool:
        """Whether dead ends are left again and again; else only early ones are."""
        ...

    def moves(self, last: Move) -> Iterator[Move]:
        """What may come next, the least help first; every state of it is proven."""
        ...

    def settled(self, move: Move) -> Move:
        """A move, with what is let go or taken away at once behind it."""
        ...

    def key(self, move: Move) -> Hashable:
        """Of what a move leaves: what may come next depends on it alone."""
        ...

    def left(self, move: Move) -> tuple[int, int]:
        """Blocks that are still to come, and what is still to go then; zeros where all is done."""
        ...


class FoundOrder(NamedTuple, Generic[Move]):
    """Of :func:`depth_first`."""

    path: list[Move]
    """To the end, or as far as it came."""
    last: Move
    """Of the path, or where the search began."""
    complete: bool


def depth_first(
    rules: OrderRules[Move],
    clock: Clock,
    progress: Callable[[str], None] = lambda text: None,
    idle: float = math.inf,
) -> FoundOrder[Move]:
    """The first order to the end, or the one that came farthest.

    Args:
        idle: it gives up after so many moves of which none came farther.
    """
    path: list[Move] = []
    best: list[Move] = []
    most = fewest = rules.left(rules.first)
    queue, seen = [rules.moves(rules.first)], set[Hashable]()
    tries = farther = 0
    while any(fewest) and queue and clock.left > 0 and tries < min(rules.tries, farther + idle):
        move = next(queue[-1], None)
        if move is None:
            queue.pop()
            if path:
                path.pop()
            if not rules.patient and len(best) > _FEW:
                break  # What helps is tried next.
            continue
        tries += 1
        move = rules.settled(move)
        key = rules.key(move)
        if key in seen:
            continue
        seen.add(key)
        path.append(move)
        left = rules.left(move)
        if left < fewest:
            best, fewest, farther = list(path), left, tries
            progress(Detail(f"{most[0] - left[0]} of {most[0]} blocks in order"))
        queue.append(rules.moves(move))
    return FoundOrder(best, best[-1] if best else rules.first, not any(fewest))


def reported(
    laws: Sequence[Law], by: Callable[[State], int | None], start: State, steps: Sequence[Doing]
) -> Iterator[SequenceStep]:
    """The steps with what is proven of every state.

    Args:
        by: the number of the law by which a state stands.
    """
    state, wait = start, False
    for number, step in enumerate(steps):
        state = shown = step.after(state)
        if step.action == "wait":
            wait = True
            continue
        if holds := held_at_once(steps, number):
            shown = holds.after(state)  # The hand that placed it has it still.
        law = by(shown)
        assert law is not None
        proof, margin_g, margin_n = laws[law].report(shown)
        told = SequenceStep(step.action, step.block, proof, margin_g, step.way, wait, margin_n)
        yield told._replace(arm=step.arm, hand=step.hand)
        wait = False


def held_at_once(steps: Sequence[Doing], number: int) -> Doing | None:
    """The step behind one, where it holds the same block."""
    for ahead in steps[number + 1 : number + 2]:
        if ahead.action == "hold" and ahead.block == steps[number].block:
            return ahead
    return None


def list_ids(blocks: Sequence[Block], some: Iterable[int]) -> str:
    """The ids of some blocks in words, the first four of them."""
    return listed([blocks[k].id for k in some], 4)
