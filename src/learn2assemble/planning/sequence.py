"""In which order given blocks are put down, and what has to carry them until they carry themselves.

Blocks go from below, each after those it lies on, along a way that is free. A block that does not
stand yet waits; where every block waits, a hand holds one while the next one comes (*holds*), or a
post is put under one (*posts*), whatever needs the least. What nothing needs any more is let go or
taken away at once. Every state is proven by one of the laws (:mod:`.laws`), and each new block
rests without being squeezed in. A dead end is left by the last choice before it; a block that
closes the way out of a prop comes after the prop has gone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal, NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.assembly.contacts import Contacts, contact_tolerance, find_contacts
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.clearance import LEVEL, Clearance, ways_out
from learn2assemble.planning.posts import Post, find_posts
from learn2assemble.statics.laws import ByForces, ByLoads, Law
from learn2assemble.statics.rigid_blocks import SIDE
from learn2assemble.statics.states import State

Action = Literal["place", "remove", "hold", "release"]
_SMALL = 10
"""Blocks up to which the fewest posts are looked for among all sets of them ..."""
_SETS = 4000
"""... as long as these are no more, over the cube of the number of blocks."""
_TRIES = 4000
"""Moves looked at before the search gives up."""
_TOGETHER = 3
"""Most posts that are placed at once."""
_NEAREST = 8
"""Posts that are looked at for that."""


@dataclass(frozen=True)
class Supports:
    """What may carry blocks until they carry themselves.

    Attributes:
        posts: whether posts may be placed.
        holds: how many blocks may be held while the next one comes.
    """

    posts: bool = False
    holds: int = 0


class SequenceStep(NamedTuple):
    """One step, and what is proven of the state after it."""

    action: Action
    block: int
    """Index in the blocks of the sequence."""
    proof: str
    margin_g: float | None
    way: str | None = None
    """Of a brick, whence it comes: ``above``, ``below``, or ``beside``, where it was built."""


class Transition(NamedTuple):
    """Steps that belong together, and the state after them."""

    steps: tuple[tuple[Action, int], ...]
    state: State


class ContactLayer(NamedTuple):
    """Contacts that may carry, and what a step is called that is proven with them."""

    contacts: Contacts
    proof: str


@dataclass(frozen=True)
class OrderProblem:
    """Blocks to put in order.

    Attributes:
        assembly: where they stand; its steps are not looked at.
        layers: what may carry, tried in this order in every state.
        friction: coefficients to prove every state for, the smallest first.
    """

    assembly: Assembly
    layers: tuple[ContactLayer, ...]
    friction: tuple[float, ...]


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


def find_sequence(
    problem: OrderProblem,
    supports: Supports,
    clock: Clock,
    progress: Callable[[str], None] = lambda text: None,
) -> Sequenced:
    """Order, supports and proof for blocks that are given where they stand.

    Without help first, then with hands as far as they are there, at last with posts. Of a few
    blocks the fewest posts are found; of many, those that were placed where nothing else helped.
    """
    search = _OrderSearch(problem, supports, clock, progress)
    end, last = search.end(), search.laws[-1]
    stands = search.law(end) is not None
    order = search.run()
    # What is known of states without help stays known with it.
    if stands and supports.holds and not order.complete and clock.left > 0:
        search.allow(holds=supports.holds)
        order = _longer(order, search.run())
    if stands and supports.posts and not order.complete and clock.left > 0:
        search.allow(posts=True, holds=supports.holds)
        order = _longer(order, search.run())
        order = search.fewest(order) if order.complete else order
    found = search.sequenced(order)
    if stands:
        return found
    certain, moving = last.falls(end), last.moving(end)
    names = list_ids(search.blocks, moving) or "some blocks"
    reason = f"the finished structure falls: {names} would move first"
    if not certain:
        reason = f"that the finished structure stands is not proven: {names} may move"
    status = "refused" if certain else "not found"
    return replace(found, status=status, reason=reason, stuck=tuple(moving))


def _longer(order: _FoundOrder, other: _FoundOrder) -> _FoundOrder:
    """The one that is complete, or else the longer one."""
    return other if other.complete or len(other.steps) > len(order.steps) else order


def follow_steps(
    problem: OrderProblem, clock: Clock, progress: Callable[[str], None] = lambda text: None
) -> Sequenced:
    """Proof of the steps that an assembly comes with, up to the first state that is not proven."""
    search = _OrderSearch(problem, Supports(), clock, progress)
    index = problem.assembly.index
    steps: list[tuple[Action, int]] = [
        (step.action, index(step.block)) for step in problem.assembly.steps
    ]
    state, proven = search.start(), 0
    for number, (action, block) in enumerate(steps):
        state = state.change(**{action: [block]})
        # A block that is held at once is not let go before.
        ahead = number + 1 < len(steps) and steps[number + 1] == ("hold", block)
        new = [block] if action in ("place", "release") and not ahead else []
        if clock.left <= 0:
            break
        if not ahead and not search.stands(state, new):
            break
        proven = number + 1
        progress(f"step {proven}: {search.blocks[block].id}")
    done = proven == len(steps)
    order = _FoundOrder(steps[:proven], done, steps[proven][1:] if not done else ())
    return search.sequenced(order)


def _posts_of(problem: OrderProblem) -> list[Post]:
    lowest = [float(b.vertices[:, 2].min()) for b in problem.assembly.blocks if b.support]
    contacts = problem.layers[-1].contacts
    return find_posts(problem.assembly.blocks, contacts, min(lowest) if lowest else 0.0)


class _FoundOrder(NamedTuple):
    """Steps of which every state is proven."""

    steps: list[tuple[Action, int]]
    complete: bool
    stuck: tuple[int, ...] = ()


class _OrderSearch:
    """Depth first over what comes next.

    Args:
        supports: that may be allowed; at first none are.
    """

    def __init__(
        self,
        problem: OrderProblem,
        supports: Supports,
        clock: Clock,
        progress: Callable[[str], None],
    ) -> None:
        given = problem.assembly.blocks
        posts = _posts_of(problem) if supports.posts else []
        self.problem, self.posts, self.holds = problem, posts, 0
        self.clock, self.progress, self.count = clock, progress, len(given)
        made = _distinct(given, [post.block for post in posts])
        whole = Assembly((*given, *made), friction=problem.assembly.friction)
        self.blocks = whole.blocks
        self.fixed = np.array([block.support for block in self.blocks])
        self.prop = np.array([block.prop for block in self.blocks])
        self.wanted = ~self.fixed & ~self.prop
        layers, friction = problem.layers, list(problem.friction)
        if posts:
            own = find_contacts(whole)
            own = own.only((own.b >= self.count) & (own.a < self.count))
            layers = tuple(one._replace(contacts=_joined(one.contacts, own)) for one in layers)
        self.contacts = layers[-1].contacts
        self.laws: list[Law] = [ByForces(whole, *layer, friction) for layer in layers]
        level = problem.layers[0].contacts
        if ByLoads.fits(level):
            self.laws.insert(0, ByLoads(problem.assembly, level, friction[0], clock))
        self.near = _neighbours(self.contacts, len(self.blocks))
        self.below = _lies_on(level, self.count, self.fixed)
        depth = float(contact_tolerance(given).max())
        self.clearance = Clearance(self.blocks, 2 * depth)
        self.rank = _from_below(self.blocks)
        self.under = [
            sorted(
                (p for p in self.near[k] if p >= self.count and posts[p - self.count].base != k),
                key=lambda p, k=k: (posts[p - self.count].carries != k, p),
            )
            for k in range(self.count)
        ]
        self.allowed: set[int] = set()
        """Posts that may be used."""
        self.guards: dict[int, set[int]] = {}
        """Blocks that close the way out of props, which have to go before."""
        self._known: dict[bytes, tuple[int, int | None]] = {}
        """Of a state, the last law that was asked, and by which it stands."""
        self._kept: set[tuple[int, bytes]] = set()
        self._ways: dict[tuple[int, bytes], bool] = {}

    def start(self) -> State:
        """What stands before the first step."""
        return State(self.fixed.copy(), np.zeros_like(self.fixed))

    def end(self) -> State:
        """What stands after the last one."""
        return State(self.wanted | self.fixed, np.zeros_like(self.fixed))

    def allow(self, *, posts: bool = False, holds: int = 0) -> None:
        """What may be used from now on."""
        self.allowed = set(range(self.count, len(self.blocks))) if posts else set()
        self.holds = holds

    # ------------------------------------------------------------ states

    def law(self, state: State, most: int | None = None) -> int | None:
        """The number of the first law by which a state stands, or None.

        Args:
            most: laws behind this one are not asked, and others give up early.
        """
        last = len(self.laws) - 1 if most is None else most
        asked, found = self._known.get(state.key, (-1, None))
        for number in range(asked + 1, last + 1):
            if found is None and self.laws[number].stands(state, most is None):
                asked, found = number, number
        if most is None or found is not None:
            self._known[state.key] = last, found
        return found

    def stands(self, state: State, new: Iterable[int] = (), most: int | None = None) -> bool:
        """Whether a state is proven, and its ``new`` blocks rest in it; ``most`` as in law."""
        number = self.law(state, most)
        return number is not None and all(self.laws[number].rests(state, b) for b in new)

    def pushing(self, state: State, block: int) -> np.ndarray:
        """float64[n, 3]: normals of the contacts of a block with what is there, towards it."""
        mine, other = self.contacts.a == block, self.contacts.b == block
        there = np.where(mine, self.contacts.b, self.contacts.a)
        live = (mine | other) & ((there < 0) | state.present[there])
        return np.where(mine[live, None], -self.contacts.normal[live], self.contacts.normal[live])

    def enters(self, state: State, block: int) -> bool:
        """Whether a way of a block to its place, or from it, is free; posts go sideways first."""
        key = block, state.present.tobytes()
        if key not in self._ways:
            self._ways[key] = self._enters(state, block)
        return self._ways[key]

    def _enters(self, state: State, block: int) -> bool:
        normals = self.pushing(state, block)
        ways = ways_out(normals)
        if block >= self.count:
            ways = LEVEL[(LEVEL @ normals.T > -1e-6).all(1)]
        return self.clearance.leaves(block, state.present, ways)

    # ------------------------------------------------------------ search

    def run(self) -> _FoundOrder:
        """The first complete order that is found, or the longest one."""
        path = self._descend()
        steps = [step for move in path for step in move.steps]
        state = path[-1].state if path else self.start()
        if state.key == self.end().key:
            return _FoundOrder(steps, True)
        return _FoundOrder(steps, False, self._stuck(state))

    def _descend(self) -> list[Transition]:
        path: list[Transition] = []
        best: list[Transition] = []
        start, end = self.start(), self.end()
        queue, seen, tries = [self.moves(start)], set(), 0
        while queue and self.clock.left > 0 and tries < _TRIES:
            move = next(queue[-1], None)
            if move is None:
                queue.pop()
                if path:
                    path.pop()
                if not self.allowed and not self.holds and len(best) > _SMALL:
                    break  # What helps is tried next.
                continue
            tries += 1
            complete = bool(move.state.present[self.wanted].all())
            more, state = self.shed(move.state, complete)
            if state.key in seen:
                continue
            seen.add(state.key)
            path.append(Transition((*move.steps, *more), state))
            if len(path) > len(best):
                best = list(path)
                there = int(state.present[self.wanted].sum())
                self.progress(f"{there} of {int(self.wanted.sum())} blocks in order")
            if state.key == end.key:
                return path
            depth = self._closed_in(path) if complete else None
            if depth is not None:
                del path[depth:], queue[depth + 1 :]
                queue[-1] = self.moves(path[-1].state if path else start)
                seen.clear()
                continue
            queue.append(self.moves(state))
        return best

    def _closed_in(self, path: list[Transition]) -> int | None:
        """The first move that closed the way out of a prop that should go; None where none did, or
        where that was known."""
        last, first = path[-1].state, None
        for p in np.flatnonzero(last.present & self.prop).tolist():
            if self.enters(last, p):
                continue
            depth = len(path) - 1
            while (
                depth > 0
                and path[depth - 1].state.present[p]
                and not self.enters(path[depth - 1].state, p)
            ):
                depth -= 1
            for action, b in path[depth].steps:
                if action == "place" and p not in self.guards.setdefault(b, set()):
                    self.guards[b].add(p)
                    first = depth if first is None else min(first, depth)
        return first

    def ready(self, state: State) -> list[int]:
        """Blocks that are missing and whose bases are there, from below."""
        left = np.flatnonzero(~state.present[: self.count]).tolist()
        found = [b for b in left if state.present[self.below[b]].all()]
        # Stones that lie on one another in a ring have no first one.
        return sorted(found or left, key=lambda b: self.rank[b])

    def moves(self, state: State) -> Iterator[Transition]:
        """What may come next, the least help first."""
        ready = [b for b in self.ready(state) if not self.prop[b] or not self.allowed]
        ready = [b for b in ready if self.enters(state, b)]
        waits = [b for b in ready if any(state.present[p] for p in self.guards.get(b, ()))]
        if waits:
            steps, after = self.shed(state, True)
            if steps:
                yield Transition(steps, after)
            ready = [b for b in ready if b not in waits]
        alone = [b for b in ready if self._rests(state.change(place=[b]), b)]
        for b in alone:
            after = state.change(place=[b])
            if self.stands(after, [b]):
                yield Transition((("place", b),), after)
        if self.holds:
            yield from self._holding(state, ready)
        if self.allowed:
            yield from self._posted(state, ready)

    def _rests(self, state: State, block: int) -> bool:
        return any(law.rests(state, block) for law in self.laws)

    def _holding(self, state: State, ready: list[int]) -> Iterator[Transition]:
        """A block that is held as it comes, while others may be let go."""
        held = np.flatnonzero(state.held).tolist()
        left = np.flatnonzero(~state.present[: self.count]).tolist()
        beside = [b for b in left if b not in ready and state.present[list(self.near[b])].any()]
        beside = [b for b in beside if self.enters(state, b)]
        close = {n for b in held for n in self.near[b]}
        order = sorted([*ready, *beside], key=lambda b: (b not in close, b in beside, self.rank[b]))
        for size in range(self.holds + 1):
            for b in order:
                taken = state.change(place=[b], hold=[b])
                if not self.stands(taken):
                    continue
                for keep in combinations([b, *held], size):
                    gone = [h for h in (b, *held) if h not in keep]
                    after = taken.change(release=gone)
                    if self.stands(after, gone):
                        steps: list[tuple[Action, int]] = [("place", b), ("hold", b)]
                        yield Transition((*steps, *(("release", h) for h in gone)), after)
                        break

    def _posted(self, state: State, ready: list[int]) -> Iterator[Transition]:
        """A block with a post under it, or under what would move with it."""
        for b in ready:
            for p in self.under[b]:
                move = self._with(state, b, (p,))
                if move is not None:
                    yield move
        for b in ready:
            moving = self.laws[-1].moving(state.change(place=[b]))
            posts = {p for m in moving if m < self.count for p in self.under[m]}
            some = sorted(posts & self.allowed, key=lambda p: -self.rank[p])[:_NEAREST]
            for size in range(1, _TOGETHER + 1):
                for chosen in combinations(some, size):
                    move = self._with(state, b, chosen)
                    if move is not None:
                        yield move

    def _with(self, state: State, block: int, posts: tuple[int, ...]) -> Transition | None:
        """A block placed after some posts, if all of it is proven."""
        steps: list[tuple[Action, int]] = []
        for p in posts:
            base, after = self.posts[p - self.count].base, state.change(place=[p])
            based = base < 0 or state.present[base]
            if p not in self.allowed or state.present[p] or not based:
                return None
            if not (self.enters(after, p) and self.stands(after)):
                return None
            steps.append(("place", p))
            state = after
        after = state.change(place=[block])
        if self.enters(state, block) and self.stands(after, [block]):
            return Transition((*steps, ("place", block)), after)
        return None

    def shed(self, state: State, last: bool) -> tuple[tuple[tuple[Action, int], ...], State]:
        """Let go, and take away, what nothing needs.

        Args:
            last: look at everything that could carry the rest, not only at what is near.
        """
        steps: list[tuple[Action, int]] = []
        again = True
        while again:
            again = False
            for b in np.flatnonzero(state.held).tolist():
                after = state.change(release=[b])
                if self.stands(after, [b]):
                    steps.append(("release", b))
                    state, again = after, True
            there = np.flatnonzero(state.present & self.prop)
            for p in sorted(there.tolist(), key=lambda p: -self.rank[p]):
                key = p, state.present[self._wide(p)].tobytes()
                if key in self._kept and not last:
                    continue
                after = state.change(remove=[p])
                carried = [n for n in self.near[p] if state.present[n] and not self.fixed[n]]
                most = None if last else self.law(state)
                if self.stands(after, carried, most) and self.enters(state, p):
                    steps.append(("remove", p))
                    state, again = after, True
                else:
                    self._kept.add(key)
        return tuple(steps), state

    def _wide(self, block: int) -> list[int]:
        """Blocks within three contacts."""
        found = {block}
        for _ in range(3):
            found |= {n for b in found for n in self.near[b]}
        return sorted(found)

    # ------------------------------------------------------------ results

    def fewest(self, found: _FoundOrder) -> _FoundOrder:
        """An order with fewer posts than one that was found, where the blocks are few."""
        used = {block for _, block in found.steps if block >= self.count}
        count = int(self.wanted.sum())
        if count > _SMALL or len(used) < 2:
            return found
        self.progress("looking for fewer posts")
        self.progress = lambda text: None
        sets = 0
        for size in range(1, len(used)):
            for some in combinations(range(self.count, len(self.blocks)), size):
                sets += 1
                if sets * count**3 > _SETS or self.clock.left <= 0:
                    return found
                # States that were looked at for other sets are known.
                self.allowed = set(some)
                self._kept.clear()
                answer = self.run()
                if answer.complete:
                    return answer
        return found

    def sequenced(self, order: _FoundOrder) -> Sequenced:
        """The steps with what is proven of every state, and the posts they use."""
        steps = order.steps
        used = sorted({b for _, b in steps if b >= self.count})
        number = {b: b for b in range(self.count)} | {b: self.count + k for k, b in enumerate(used)}
        state, made = self.start(), []
        for place, (action, block) in enumerate(steps):
            state = state.change(**{action: [block]})
            shown = state
            if steps[place + 1 : place + 2] == [("hold", block)]:
                shown = state.change(hold=[block])  # The hand that placed it has it still.
            law = self.law(shown)
            assert law is not None
            proof, margin = self.laws[law].report(shown)
            made.append(SequenceStep(action, number[block], proof, margin))
        blocks = (*self.blocks[: self.count], *(self.blocks[b] for b in used))
        if order.complete:
            return Sequenced(blocks, tuple(made), "complete")
        reason = self._why(state, order.stuck)
        return Sequenced(blocks, tuple(made), "not found", reason, order.stuck)

    def _stuck(self, state: State) -> tuple[int, ...]:
        """What could not be placed, or not be taken away."""
        if state.present[self.wanted].all():
            return tuple(np.flatnonzero(state.present & self.prop).tolist())
        return tuple(self.ready(state))

    def _why(self, state: State, stuck: tuple[int, ...]) -> str:
        if self.clock.left <= 0:
            there = int(state.present[self.wanted].sum())
            return f"time ran out after {self.clock.limit:g} s with {there} blocks placed"
        names = list_ids(self.blocks, stuck)
        if state.present[self.wanted].all():
            return f"{names} cannot be taken away: without, or on the way, something falls"
        shut = [b for b in stuck if not self.enters(state, b)]
        if len(shut) == len(stuck):
            return f"no way to the place of {names} is free"
        return f"no order found: the next step falls with any of {names}"


def list_ids(blocks: Sequence[Block], some: Iterable[int]) -> str:
    """The ids of some blocks in words, the first four of them."""
    ids = [blocks[k].id for k in some]
    return ", ".join(ids[:4]) + (f" and {len(ids) - 4} more" if len(ids) > 4 else "")


def _distinct(blocks: Sequence[Block], more: Sequence[Block]) -> list[Block]:
    """The blocks ``more`` with ids that no other has."""
    ids = {block.id for block in blocks}
    made = []
    for block in more:
        name = block.id
        while name in ids:
            name += "'"
        ids.add(name)
        made.append(replace(block, id=name))
    return made


def _joined(contacts: Contacts, more: Contacts) -> Contacts:
    shifted = more._replace(patch=more.patch + len(contacts.a))
    return Contacts(*map(np.concatenate, zip(contacts, shifted, strict=True)))


def _neighbours(contacts: Contacts, count: int) -> list[list[int]]:
    near: list[set[int]] = [set() for _ in range(count)]
    for a, b in zip(contacts.a.tolist(), contacts.b.tolist(), strict=True):
        if a >= 0:
            near[a].add(b)
            near[b].add(a)
    return [sorted(blocks) for blocks in near]


def _lies_on(contacts: Contacts, count: int, fixed: np.ndarray) -> list[list[int]]:
    """The blocks, supports aside, that each block lies on."""
    below: list[set[int]] = [set() for _ in range(count)]
    for a, b, normal in zip(contacts.a.tolist(), contacts.b.tolist(), contacts.normal, strict=True):
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
