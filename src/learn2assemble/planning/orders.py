"""The order of given blocks by the law of their joints: dry, or of bricks that clutch.

Dry blocks are put down from below (:mod:`.forward`): without help first, then with hands as far as
they are there, then with posts, at last with both. Of a few blocks the fewest posts are found; of
many, a centring is tried before posts that are placed where nothing else helps. Bricks are taken
apart (:mod:`.disassembly`). Both are one search (:mod:`.sequence`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Assembly, AssemblyStep, Block
from learn2assemble.assembly.contacts import Contacts, contact_tolerance, find_contacts
from learn2assemble.assembly.cuts import ground_of
from learn2assemble.errors import InputError
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.centring import find_centring
from learn2assemble.planning.clearance import FreeWays
from learn2assemble.planning.crew import NOBODY
from learn2assemble.planning.disassembly import TakingApart
from learn2assemble.planning.fewest_posts import fewest_posts
from learn2assemble.planning.forward import ANY_GRIPS, BuildingSite, Forward
from learn2assemble.planning.posts import Post, find_posts, with_own_ids
from learn2assemble.planning.sequence import (
    WAIT,
    Doing,
    Sequenced,
    Supports,
    depth_first,
    held_at_once,
    list_ids,
    reported,
)
from learn2assemble.statics.holding.check import JointAnswer, stands_by_joints, words_of
from learn2assemble.statics.laws import ByForces, ByLoads, ByMortar, ByStrength, Law
from learn2assemble.statics.rigid_blocks import SIDE
from learn2assemble.statics.states import State

if TYPE_CHECKING:
    from learn2assemble.statics.holding.program import Need

_SMALL = 10
"""Blocks up to which the fewest posts are looked for."""
GRIPS = (2, 8, ANY_GRIPS)
"""In how many ways a block is held by the same hand with the same blocks there, one after the
other: what cannot come past one that holds comes past few others, and all ways of all of them are
too many."""
_ASKED = 4
"""So many of the blocks with none of which a step is found are asked whether all falls for
certain."""
_IDLE = 40
"""Moves of which none came farther, after which a search with hands is not the next thing to try:
those that end well had 21 at most in our arches."""
_NO_SUPPORTS = Supports()
Progress = Callable[[str], None]


class ContactLayer(NamedTuple):
    """Contacts that may carry, and what a step is called that is proven with them."""

    contacts: Contacts
    proof: str


@dataclass(frozen=True)
class OrderProblem:
    """Blocks that come dry to put in order.

    Attributes:
        assembly: where they stand; its steps are not looked at.
        layers: what may carry, tried in this order in every state.
        friction: coefficients to prove every state for, the smallest first.
        margin_friction: for which margins are told of loads that need none; by default the
            smallest.
        mortar: whether what mortar holds carries, too, once it is old enough.
    """

    assembly: Assembly
    layers: tuple[ContactLayer, ...]
    friction: tuple[float, ...]
    margin_friction: float | None = None
    mortar: bool = False


# ---------------------------------------------------------------- dry blocks


def find_sequence(
    problem: OrderProblem, supports: Supports, clock: Clock, progress: Progress = lambda text: None
) -> Sequenced:
    """Order, supports and proof for dry blocks that are given where they stand."""
    plain = _DryOrder(problem, supports, (), clock, progress)
    end, last = plain.rules.end, plain.rules.laws[-1]
    stands = plain.rules.law(end) is not None
    order, found = plain, plain.run()
    for other, steps in _helped(problem, supports, plain, found):
        if other.worth(steps) > order.worth(found):
            order, found = other, steps
        if found.complete or clock.left <= 0 or not stands:
            break
    made = order.sequenced(found)
    if stands or (problem.mortar and clock.left <= 0):
        return made  # What mortar holds is not decided where time is over.
    certain, moving = last.falls(end), last.moving(end)
    names = list_ids(order.blocks, moving) or "some blocks"
    reason = f"the finished structure falls: {names} would move first"
    if not certain:
        reason = f"that the finished structure stands is not proven: {names} may move"
    status = "refused" if certain else "not found"
    return replace(made, status=status, reason=reason, stuck=tuple(moving))


class _Aid(NamedTuple):
    """What an order is looked for with."""

    posts: bool
    holds: int
    grips: int = ANY_GRIPS
    idle: float = math.inf
    """Given up after so many moves of which none came farther, and after half of the time."""


def _aids(supports: Supports) -> Iterator[_Aid]:
    """What is tried, the least help first. What a search with hands that come past one another
    does not find soon it looks for very long, so where posts may stand they come before that."""
    posts, holds, (few, *more) = supports.posts, supports.holds, GRIPS
    if holds:
        yield _Aid(False, holds, few, _IDLE if posts else math.inf)
    if posts:
        # Where these could stand takes longer to find than an order that needs none.
        yield _Aid(True, 0)
    if holds:
        yield from (_Aid(False, holds, grips) for grips in (GRIPS if posts else more))
    if holds and posts:
        yield _Aid(True, holds)


def _helped(
    problem: OrderProblem, supports: Supports, plain: _DryOrder, found: _Steps
) -> Iterator[tuple[_DryOrder, _Steps]]:
    """Orders with more and more help, each as far as it comes; the first one has none.

    Args:
        plain: the search without help.
        found: the steps that it has found.
    """
    yield plain, found
    known = dict[bool, _DryOrder | None]()
    for aid in _aids(supports):
        if not aid.posts:
            plain.rules.allow((), aid.holds, aid.grips)
            steps = plain.run(aid.idle)
            found = max(found, steps, key=plain.worth)
            yield plain, steps
            continue
        before = plain.after(found.steps)
        for centring in (True, False):
            if centring not in known:
                known[centring] = plain.with_posts(problem, supports, centring, before)
            helped = known[centring]
            if helped is None:
                continue
            posts = () if centring else range(helped.count, len(helped.blocks))
            helped.rules.allow(posts, aid.holds)
            steps = helped.run()
            if not centring and supports.fewest:
                steps = helped.fewest(steps)
            yield helped, steps


def follow_steps(
    problem: OrderProblem, clock: Clock, progress: Progress = lambda text: None
) -> Sequenced:
    """Proof of the steps that an assembly comes with, up to the first state that is not proven.

    Raises:
        InputError: where what stands before the first step is not proven to.
    """
    order = _DryOrder(problem, _NO_SUPPORTS, (), clock, progress)
    rules, index = order.rules, problem.assembly.index
    begin = replace(rules.start, present=rules.start.present | problem.assembly.at_first)
    if begin.key != rules.start.key and not rules.stands(begin):
        names = list_ids(order.blocks, rules.laws[-1].moving(begin)) or "some blocks"
        got = f"no step that places {names}, not proven to stand at the start"
        raise InputError("steps", got, "blocks that stand, or not_built, where no step places them")
    rules.start = begin
    steps: list[Doing] = []
    for step in problem.assembly.steps:
        cures = step.wait is not None and step.wait >= problem.assembly.age
        done = Doing(step.action, index(step.block), None, step.arm, step.hand)
        steps += [WAIT] * cures + [done]
    state, proven, stuck = begin, 0, ()
    for number, step in enumerate(steps):
        state = step.after(state)
        if step.action == "wait":
            continue
        if held_at_once(steps, number) is not None:
            continue  # The hand that placed it has it still: both steps are proven as one.
        new = [step.block] if step.action in ("place", "release") else []
        if clock.left <= 0 or not rules.stands(state, new):
            stuck = (step.block,)
            break
        proven = number + 1
        told = sum(one.action != "wait" for one in steps[:proven])
        progress(f"step {told}: {order.blocks[step.block].id}")
    return order.sequenced(_Steps(steps[:proven], stuck, not stuck))


class _Steps(NamedTuple):
    """Steps of which every state is proven, and what comes behind them where that is not all."""

    steps: list[Doing]
    stuck: tuple[int, ...]
    complete: bool


class _DryOrder:
    """The search for an order of dry blocks, at first without supports."""

    def __init__(
        self,
        problem: OrderProblem,
        supports: Supports,
        posts: Sequence[Post],
        clock: Clock,
        progress: Progress,
    ) -> None:
        given = problem.assembly.blocks
        count, layers = len(given), problem.layers
        made = with_own_ids(given, [post.block for post in posts])
        whole = Assembly((*given, *made), friction=problem.assembly.friction)
        self.blocks, self.count = whole.blocks, count
        self.clock = clock
        self.progress: Progress = progress
        if posts:
            own = find_contacts(whole)
            own = own.only((own.b >= count) & (own.a < count))
            layers = tuple(one._replace(contacts=_joined(one.contacts, own)) for one in layers)
        site = site_of(problem, whole, layers, clock)
        self._contacts = problem.layers[-1].contacts
        self.rules = Forward(replace(site, crew=supports.crew(whole.blocks)), posts)

    def posts(self, centring: bool, table: bool, state: State) -> list[Post]:
        """Those that could carry blocks, or a centring below most of what is missing in a state.

        Args:
            table: as :attr:`Supports.table`.
        """
        given, missing = self.blocks[: self.count], self.rules.wanted & ~state.present
        ground = ground_of(given, table)
        if not centring:
            return find_posts(given, self._contacts, ground)
        if self.rules.wanted.sum() <= _SMALL:
            return []
        found, carried = find_centring(given, self._contacts, ground)
        return found if 2 * missing[carried].sum() > missing.sum() else []

    def with_posts(
        self, problem: OrderProblem, supports: Supports, centring: bool, state: State
    ) -> _DryOrder | None:
        """The search with a centring, or with posts wherever they could stand; None without any.

        Args:
            state: how far it came without them.
        """
        posts = self.posts(centring, supports.table, state)
        if not posts:
            return None
        found = _DryOrder(problem, supports, posts, self.clock, self.progress)
        if centring:
            found.rules.begin_with_posts()
        else:
            found.rules.learn(self.rules, state)
        return found

    def run(self, idle: float = math.inf) -> _Steps:
        """The first complete order that is found, or the longest one.

        Args:
            idle: it gives up after so many moves of which none came farther, and after half of the
                time that is left.
        """
        clock = self.clock
        if idle < math.inf:
            clock = Clock(clock.left / 2, clock.timer)
        found = depth_first(self.rules, clock, self.progress, idle)
        steps = [step for move in (self.rules.first, *found.path) for step in move.steps]
        return _Steps(steps, () if found.complete else self.rules.stuck(found), found.complete)

    def fewest(self, found: _Steps) -> _Steps:
        """An order with the fewest posts, where the blocks are few and nothing else helps."""
        rules, count = self.rules, self.count
        used = {step.block for step in found.steps if step.block >= count}
        few = int(rules.wanted.sum()) <= _SMALL and not rules.site.prop[:count].any()
        if not few or rules.holds or rules.site.mortar or (found.complete and len(used) < 2):
            return found
        self.progress("looking for fewer posts")
        steps = fewest_posts(rules, self.clock)
        some = {step.block for step in steps or () if step.block >= count}
        if steps is None or (found.complete and len(some) == len(used)):
            return found
        # With these alone, posts come where they are needed and go as soon as they are not.
        rules.allow(some, 0)
        self.progress = lambda text: None
        again = self.run()
        return again if again.complete else _Steps(steps, (), True)

    def sequenced(self, found: _Steps) -> Sequenced:
        """The steps with what is proven of every state, and the posts they use."""
        used = sorted({step.block for step in found.steps if step.block >= self.count})
        number = {b: self.count + k for k, b in enumerate(used)}
        told = reported(self.rules.laws, self.rules.law, self.rules.start, found.steps)
        made = tuple(step._replace(block=number.get(step.block, step.block)) for step in told)
        blocks = (*self.blocks[: self.count], *(self.blocks[b] for b in used))
        if found.complete:
            return Sequenced(blocks, made, "complete")
        reason = self._why(self.after(found.steps), found.stuck)
        return Sequenced(blocks, made, "not found", reason, found.stuck)

    def worth(self, found: _Steps) -> tuple[bool, int]:
        """Larger where an order is complete, or has more blocks at its end."""
        return found.complete, int(self.after(found.steps).present[: self.count].sum())

    def after(self, steps: Sequence[Doing]) -> State:
        """The state that some steps end in."""
        state = self.rules.start
        for step in steps:
            state = step.after(state)
        return state

    def _why(self, state: State, stuck: tuple[int, ...]) -> str:
        present, site = state.present, self.rules.site
        if self.clock.left <= 0:
            there = int(present[self.rules.wanted].sum())
            return f"time ran out after {self.clock.limit:g} s with {there} blocks placed"
        names = list_ids(self.blocks, stuck)
        if present[self.rules.wanted].all():
            return f"{names} cannot be taken away: without, or on the way, something falls"
        if not any(site.ways.free(b, present) for b in stuck):
            return f"no way to the place of {names} is free"
        if not any(True for b in stuck for _ in site.crew.grips(b, state)):
            return f"no order found: {NOBODY} {names}"
        law = self.rules.laws[-1]
        mine = np.arange(len(present))
        after = (replace(state, present=present | (mine == b)) for b in stuck[:_ASKED])
        certain = all(law.falls(one) for one in after)
        what = "falls" if certain else "is not proven to stand"
        return f"no order found: the next step {what} with any of {names}"


def site_of(
    problem: OrderProblem, whole: Assembly, layers: Sequence[ContactLayer], clock: Clock
) -> BuildingSite:
    """What is known of dry blocks: what carries them, and along which ways they come.

    Args:
        whole: the blocks of the problem, then posts.
        layers: those of the problem, with the contacts of the posts.
    """
    blocks, given, level = whole.blocks, problem.assembly.blocks, problem.layers[0].contacts
    fixed, contacts = np.array([block.support for block in blocks]), layers[-1].contacts
    friction, count = list(problem.friction), len(given)
    laws: list[Law] = [ByForces(whole, *layer, friction, clock) for layer in layers]
    if ByLoads.fits(level):
        least = friction[0] if problem.margin_friction is None else problem.margin_friction
        laws.insert(0, ByLoads.of_contacts(problem.assembly, level, least, clock))
    if problem.mortar:
        bare = replace(problem.assembly, steps=(), not_built=())
        laws.append(ByMortar(replace(bare, blocks=blocks, friction=friction[0]), laws[-1], clock))
    return BuildingSite(
        fixed=fixed,
        prop=np.array([block.prop for block in blocks]),
        near=_neighbours(contacts, len(blocks)),
        below=_lies_on(level, count, fixed),
        rank=_from_below(blocks),
        laws=laws,
        ways=FreeWays(blocks, contacts, 2 * float(contact_tolerance(given).max()), count),
        mortar=problem.mortar and problem.assembly.age > 0,
    )


def _joined(contacts: Contacts, more: Contacts) -> Contacts:
    shifted = more._replace(patch=more.patch + len(contacts.a))
    return Contacts(*map(np.concatenate, zip(contacts, shifted, strict=True)))


def _neighbours(contacts: Contacts, count: int) -> list[list[int]]:
    near: list[set[int]] = [set[int]() for _ in range(count)]
    pairs: list[list[int]] = np.column_stack([contacts.a, contacts.b]).tolist()
    for a, b in pairs:
        if a >= 0:
            near[a].add(b)
            near[b].add(a)
    return [sorted(blocks) for blocks in near]


def _lies_on(contacts: Contacts, count: int, fixed: np.ndarray) -> list[list[int]]:
    """The blocks, supports aside, that each block lies on."""
    below: list[set[int]] = [set[int]() for _ in range(count)]
    pairs: list[list[int]] = np.column_stack([contacts.a, contacts.b]).tolist()
    for (a, b), normal in zip(pairs, contacts.normal, strict=True):
        if a >= 0 and b < count and abs(normal[2]) > SIDE:
            lower, upper = (a, b) if normal[2] > 0 else (b, a)
            if not fixed[lower]:
                below[upper].add(lower)
    return [sorted(bases) for bases in below]


def _from_below(blocks: Sequence[Block]) -> np.ndarray:
    """int64[B]: the place of every block from below; of those level, from one side to the other."""
    low = np.array([block.vertices[:, 2].min() for block in blocks])
    middle = np.array([block.centroid[2] for block in blocks])
    size = float(np.ptp(blocks[0].vertices, axis=0).max()) * 1e-6
    order = np.lexsort((np.arange(len(low)), (middle / size).round(), (low / size).round()))
    return order.argsort()


# ---------------------------------------------------------------- bricks that clutch


class BrickOrder:
    """The order of bricks that clutch, every state of which stands, pressed, too.

    Args:
        assembly: bricks on a lattice of studs whose joints clutch; steps are not looked at.
        answer: whether all of it stands, where that is known.

    Raises:
        InputError: for blocks that are no bricks on one lattice.
    """

    def __init__(self, assembly: Assembly, answer: JointAnswer | None = None) -> None:
        self.blocks: tuple[Block, ...] = assembly.blocks
        self.assembly: Assembly = replace(assembly, steps=())
        found = stands_by_joints(self.assembly) if answer is None else answer
        self.need: Need = found.need
        self.law: ByStrength = ByStrength(self.assembly, found)

    def find(
        self, supports: Supports, clock: Clock, progress: Progress = lambda text: None
    ) -> Sequenced:
        """An order with what may help."""
        if not self.need.stands:
            moving = self.law.balance.holding().moving
            reason = f"the finished structure falls: {words_of(self.need)}"
            reason += f"; {list_ids(self.blocks, moving)} would move first" if moving else ""
            return Sequenced(self.blocks, (), "refused", reason, tuple(moving))
        rules = TakingApart(self.assembly, self.law, supports)
        hanging = rules.hanging()
        if hanging and not supports.hands:
            names = list_ids(self.blocks, hanging)
            reason = f"what hangs on bricks above has to come from below (`hands=`): {names}"
            return Sequenced(self.blocks, (), "refused", reason, tuple(hanging))
        found = depth_first(rules, clock, progress)
        if found.complete:
            return self._sequenced(rules, rules.read(found.path))
        stuck = np.flatnonzero(found.last.state.present & ~rules.fixed).tolist()
        reason = f"time ran out after {clock.limit:g} s"
        if clock.left > 0:
            names = list_ids(self.blocks, stuck)
            reason = f"no order found: none of {names} can be the last one put there"
        return Sequenced(self.blocks, (), "not found", reason, tuple(stuck))

    def follow(
        self, steps: Sequence[AssemblyStep], supports: Supports
    ) -> tuple[Sequenced | None, str | None]:
        """The order of a file, where every state of it stands, pressed, too.

        Returns:
            The order, or None and a note of what its first fault is.
        """
        if not self.need.stands:
            return None, None
        rules = TakingApart(self.assembly, self.law, supports)
        index = {block.id: k for k, block in enumerate(self.blocks)}
        state, made = rules.ground, list[Doing]()
        for number, step in enumerate(steps, 1):
            done = rules.follow(state, step, index.get(step.block))
            if isinstance(done, str):
                return None, f"step {number} of the file {done}: another order was found"
            made.append(done)
            state = state.change(place=[done.block])
        return self._sequenced(rules, made), None

    def _sequenced(self, rules: TakingApart, steps: Sequence[Doing]) -> Sequenced:
        made = tuple(reported([self.law], lambda state: 0, rules.ground, steps))
        return Sequenced(self.blocks, made, "complete")
