"""What may come next while blocks are put down one after the other, from below.

Each block comes after those it lies on, along a way that is free. A block that does not stand yet
waits; where every block waits, a hand holds one while the next one comes, or a post is put under
one, whatever needs the least. What nothing needs any more is let go or taken away at once; props
that belong to the structure, and a centring, stay until everything stands, or until the block that
would close their way out has to come. Every state is proven by one of some laws
(:mod:`~..statics.laws`), and each new block rests without being squeezed in.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations, islice

import numpy as np
from numpy.typing import NDArray

from learn2assemble.planning.clearance import Ways
from learn2assemble.planning.crew import ANYHOW, Anybody, Bringing, Crew
from learn2assemble.planning.posts import Post
from learn2assemble.planning.sequence import WAIT, Doing, FoundOrder, Transition, let_go, let_go_of
from learn2assemble.statics.laws import Law, Proven
from learn2assemble.statics.states import State

_TRIES = 4000
"""Moves looked at before the search gives up, besides one for each block."""
_TOGETHER = 3
"""Most posts that are placed at once."""
ANY_GRIPS = 10_000
"""More than there are."""
_NEAREST = 8
"""Posts that are looked at for that."""


@dataclass(frozen=True, eq=False)
class BuildingSite:
    """What is to be built of B blocks, and what is known of it.

    Attributes:
        fixed: bool[B], what stands there from the first.
        prop: bool[B], what has to go again.
        near: of each block, those it touches.
        below: of each block, those that have to be there, or have been, before it comes.
        rank: int64[B], its place from below.
        laws: what may carry a state, tried in this order.
        ways: along which blocks come and go.
        mortar: whether one may wait until joints hold.
        onward: whether the block that comes next is looked for behind the last one, not again from
            below.
        crew: who brings blocks and holds them.
    """

    fixed: np.ndarray
    prop: np.ndarray
    near: Sequence[Sequence[int]]
    below: Sequence[Sequence[int]]
    rank: np.ndarray
    laws: Sequence[Law]
    ways: Ways
    mortar: bool = False
    onward: bool = False
    crew: Crew = field(default_factory=Anybody)


class Forward(Proven):
    """Blocks put down from below; the rules of a search (:class:`~.sequence.OrderRules`).

    Args:
        site: what is to be built; its last blocks are the ``posts``.
        posts: that may be allowed; at first nothing helps.
    """

    def __init__(self, site: BuildingSite, posts: Sequence[Post] = ()) -> None:
        self.site = site
        super().__init__(site.laws)
        self.posts = posts
        self.holds: int = 0
        total = len(site.fixed)
        self.count: int = total - len(posts)
        self.tries: int = _TRIES + total
        self.wanted: NDArray[np.bool_] = ~site.fixed & ~site.prop
        self.start: State = State(site.fixed.copy(), np.zeros(total, bool))
        self.first: Transition = Transition((), self.start)
        self.end: State = State(self.wanted | site.fixed, np.zeros(total, bool))
        if site.mortar:
            self.end = self.end.change(wait=[-1])
        self.allowed: set[int] = set()
        """Posts that may be used."""
        self._staying = self.count
        """Posts before this one stay until all blocks are there."""
        self._whole = False
        """Whether these have been waiting to go."""
        self._order = np.argsort(site.rank[: self.count], kind="stable")
        self._under = [
            sorted(
                (p for p in site.near[k] if p >= self.count and posts[p - self.count].base != k),
                key=lambda p, k=k: (posts[p - self.count].carries != k, p),
            )
            for k in range(self.count if posts else 0)
        ]
        self.grips: int = ANY_GRIPS
        """In how many ways blocks are held before other ones are."""
        self._gripped: Counter[tuple[bytes, tuple[tuple[int, str], ...]]] = Counter()
        """Of what is there, and who holds what: in how many ways that was tried."""
        self._kept: set[tuple[int, bytes]] = set()
        self._failed: set[tuple[int, tuple[int, ...], int | None, bytes]] = set()
        """Blocks that fell, with which posts, and which of their neighbours were there."""
        self._shut: dict[int, bool] = {}

    def allow(self, posts: Iterable[int], holds: int, grips: int = ANY_GRIPS) -> None:
        """What may be used from now on; what is known of states is kept.

        Args:
            posts: these alone.
            holds: how many blocks may be held while the next one comes.
            grips: in how many ways each of them by the same hand, with the same blocks there.
        """
        self.allowed, self.holds, self.grips = set(posts), holds, grips
        self._kept.clear()
        self._gripped.clear()

    def begin_with_posts(self) -> None:
        """Every post stands there from the first, and stays until all blocks are there.

        Those that could not be taken away then, or that do not stand alone, are left out.
        """
        self._staying, state, steps = len(self.site.fixed), self.start, list[Doing]()
        for p in range(self.count, self._staying):
            after = state.change(place=[p])
            free = not self._encloses(p) and self.site.ways.free(p, state.present)
            if free and self.stands(after, [p]):
                steps += self._comes(p, state)
                state = after
        self.first = Transition(tuple(steps), state)

    def learn(self, other: Forward, state: State) -> None:
        """Take over what is known without posts, and go on from a state without them that stands.

        Args:
            other: of the same blocks and laws, without posts.
        """
        count, none = other.count, bytes(len(self.posts))
        for key, found in other.known.items():
            parts = (key[k : k + count] + none for k in range(0, len(key), count))
            self.known[b"".join(parts)] = found
        more = np.zeros(len(self.posts), bool)
        cured = None if state.cured is None else np.append(state.cured, more)
        present, held = np.append(state.present, more), np.append(state.held, more)
        whole = State(present, held, cured, state.hands)
        number = self.law(whole)
        if number is not None:
            self.laws[number].stands(whole)

    @property
    def patient(self) -> bool:
        """Dead ends are left again and again where something helps."""
        return bool(self.allowed or self.holds or self._whole)

    # ------------------------------------------------------------ states

    def key(self, move: Transition) -> tuple[bytes, frozenset[int]]:
        """What is there, and what is not to come again."""
        return move.state.key, move.gone

    def left(self, move: Transition) -> tuple[int, int]:
        """Blocks that are missing, and props and hands that are still there."""
        return self.missing(move.state)

    def missing(self, state: State) -> tuple[int, int]:
        """The same of a state."""
        missing = int((self.wanted & ~state.present).sum())
        return missing, int((state.present & self.site.prop).sum() + state.held.sum())

    def stuck(self, found: FoundOrder[Transition]) -> tuple[int, ...]:
        """What could not be placed, or not be taken away, behind an order that is not complete."""
        state = found.last.state
        if state.present[self.wanted].all():
            return tuple(np.flatnonzero(state.present & self.site.prop).tolist())
        ready = list(self.ready(found.last))
        walled = {b: self.walled(state.change(place=[b])) for b in ready}
        free = [b for b in ready if not walled[b]]
        return tuple(free or sorted({p for props in walled.values() for p in props}))

    # ------------------------------------------------------------ moves

    def ready(self, last: Transition) -> Iterator[int]:
        """Blocks that are missing and whose bases are there, from below."""
        gone, order, there, below = last.gone, self._order, last.state.present, self.site.below
        left = order[~there[order]]
        if self.site.onward and [step.action for step in last.steps] == ["place"]:
            turn = np.searchsorted(self.site.rank[left], int(self.site.rank[last.steps[0].block]))
            left = np.concatenate([left[turn:], left[:turn]])
        some: list[int] = [b for b in left.tolist() if b not in gone]
        ringed = True
        for b in some:
            if all(there[k] or k in gone for k in below[b]):
                ringed = False
                yield b
        if ringed:
            # Stones that lie on one another in a ring have no first one.
            yield from some

    def moves(self, last: Transition) -> Iterator[Transition]:
        """What may come next, the least help first."""
        state, ready, closing, tight = last.state, list[int](), list[int](), list[int]()
        waiting = list[tuple[int, list[int]]]()
        if self._staying > self.count and not self.missing(state)[0]:
            yield from self._clearing(last)
        for b in self.ready(last):
            if not self.site.ways.free(b, state.present, sliding=False):
                tight.append(b)
                continue
            after = state.change(place=[b])
            if self._closes(after, b):
                closing.append(b)
                continue
            if walled := self.walled(after):
                waiting.append((b, walled))
                continue
            ready.append(b)
            yield from self._with(last, b, (), len(self.laws) - 1)
        if self.holds or not self.allowed:
            for b in ready:
                yield from self._with(last, b, ())
        if self.holds:
            yield from self._holding(last, ready)
        # To tell that a state falls takes long: a post that helps comes before it is asked at
        # length whether it does without, and what failed among the same neighbours comes last.
        for again in (False, True) if self.allowed else ():
            for b in ready:
                for p in self._under[b]:
                    yield from self._with(last, b, (p,), again=again)
            for b in ready:
                yield from self._with(last, b, (), again=again)
            yield from self._posted(last, ready, again)
        yield from self._waiting(last)
        for b, walled in waiting:
            yield from self._freeing(last, b, walled)
        # What stands there stays: these may be dead ends, as far as straight ways tell.
        for b in closing:
            if self.stands(after := state.change(place=[b]), [b]):
                for step in self._comes(b, state):
                    yield Transition((step,), after, last.gone)
        # What slides in between others may need more room than it has: where nothing else comes.
        for b in tight:
            if not self.walled(state.change(place=[b])):
                yield from self._with(last, b, ())

    def _clearing(self, last: Transition) -> Iterator[Transition]:
        """What stayed until all blocks were there goes, one after the other from outside."""
        self._whole, state = True, last.state
        there = np.flatnonzero(state.present[self.count :]) + self.count
        for p in sorted(there.tolist(), key=lambda p: -self._away(p)):
            after = state.change(remove=[p])
            if self.site.ways.free(p, state.present) and self.stands(after, self.on(p, after)):
                yield Transition((self._goes(p, state),), after, last.gone)

    def _away(self, prop: int) -> float:
        """How far a post is from the middle of all [m]."""
        at = np.array([post.block.centroid[:2] for post in self.posts])
        return round(float(np.linalg.norm(at[prop - self.count] - at.mean(0))), 6)

    def on(self, block: int, state: State) -> list[int]:
        """Blocks that stand beside one, and could move."""
        near, fixed = self.site.near[block], self.site.fixed
        return [n for n in near if state.present[n] and not fixed[n]]

    def _waiting(self, last: Transition) -> Iterator[Transition]:
        """A wait until mortar holds, where some of it is young."""
        if self._young(last.state):
            yield Transition((WAIT,), last.state.change(wait=[-1]), last.gone)

    def _young(self, state: State) -> bool:
        """Whether there is mortar that one may wait for."""
        before = self.site.fixed if state.cured is None else state.cured
        return self.site.mortar and bool((state.present & ~before & ~self.site.prop).any())

    def _closes(self, state: State, block: int) -> bool:
        """Whether a block that was placed shuts out one beside it, though all props have gone."""
        there = state.present & ~self.site.prop
        if not self.wanted[block]:
            return False
        beside = [n for n in self.site.near[block] if self.wanted[n] and not there[n]]
        return not all(self.site.ways.free(n, there, sliding=False) for n in beside)

    def _holding(self, last: Transition, ready: list[int]) -> Iterator[Transition]:
        """A block that is held as it comes, while others may be let go."""
        state, near = last.state, self.site.near
        held = np.flatnonzero(state.held).tolist()
        left = np.flatnonzero(~state.present[: self.count]).tolist()
        beside = [b for b in left if b not in ready and state.present[list(near[b])].any()]
        beside = [b for b in beside if self.site.ways.free(b, state.present, sliding=False)]
        close, rank = {n for b in held for n in near[b]}, self.site.rank
        order = sorted([*ready, *beside], key=lambda b: (b not in close, b in beside, rank[b]))
        for size in range(self.holds + 1):
            for b in order:
                if not self._could_hold(b, state, held, size):
                    continue
                for arm, hand in self.site.crew.grips(b, state):
                    hold = Doing("hold", b, None, arm, hand)
                    taken = hold.after(state.change(place=[b]))
                    if not self.stands(taken):
                        continue
                    for keep in combinations([b, *held], size):
                        gone = [h for h in (b, *held) if h not in keep]
                        after = taken.change(release=gone)
                        kind = after.present.tobytes(), self._hands(after)
                        if keep and self._gripped[kind] >= self.grips:
                            continue
                        freed = let_go_of(gone, taken, self.stands)
                        if freed is not None:
                            self._gripped[kind] += 1
                            steps = Doing("place", b, None, arm), hold, *freed
                            yield Transition(steps, after, last.gone)
                            break
                    else:
                        continue
                    if not size:
                        break  # However it came, nothing of it is held any more.

    def _could_hold(self, block: int, state: State, held: Sequence[int], size: int) -> bool:
        """Whether a block could come if its hand bore any load, with ``size`` of it and those that
        are ``held`` not let go: what an arm could give is found out only then."""
        taken = state.change(place=[block], hold=[block])
        if size and not self.stands(taken):
            return False
        for keep in combinations([block, *held], size):
            gone = [h for h in (block, *held) if h not in keep]
            if self.stands(taken.change(release=gone), gone):
                return True
        return False

    def _hands(self, state: State) -> tuple[tuple[int, str], ...]:
        """Who holds what."""
        held = np.flatnonzero(state.held).tolist()
        return tuple((b, state.hands[b].name if b in state.hands else "") for b in held)

    def _posted(self, last: Transition, ready: list[int], again: bool) -> Iterator[Transition]:
        """A block with posts under what would move with it; ``again`` as of :meth:`_with`."""
        for b in ready:
            moving = self.laws[-1].moving(last.state.change(place=[b]))
            posts = {p for m in moving if m < self.count for p in self._under[m]}
            some = sorted(posts & self.allowed, key=lambda p: -self.site.rank[p])[:_NEAREST]
            for size in range(1, _TOGETHER + 1):
                for chosen in combinations(some, size):
                    yield from self._with(last, b, chosen, again=again)

    def _with(
        self,
        last: Transition,
        block: int,
        posts: tuple[int, ...],
        most: int | None = None,
        again: bool = False,
    ) -> Iterator[Transition]:
        """A block placed, after some posts where they are given, if all of it is proven.

        Args:
            most: as of :meth:`law`.
            again: look at what failed among the same neighbours, else at the rest alone.
        """
        state, steps = last.state, list[Doing]()
        key = block, posts, most, state.near(self.site.near[block])
        if self.allowed and (key in self._failed) != again:
            return
        for p in posts:
            base, after = self.posts[p - self.count].base, state.change(place=[p])
            based = base < 0 or state.present[base]
            if p not in self.allowed or state.present[p] or not based:
                return
            if not (self.site.ways.free(p, after.present) and self.stands(after, (), most)):
                return
            steps += list(self._comes(p, state))
            state = after
        after = state.change(place=[block])
        comes = any(law.rests(after, block) for law in self.laws)
        comes = comes and self.site.ways.free(block, state.present, sliding=not posts)
        if comes and self.stands(after, [block], most):
            for step in self._comes(block, state):
                yield Transition((*steps, step), after, last.gone)
        elif most is None:
            self._failed.add(key)

    def _comes(self, block: int, state: State) -> Iterator[Doing]:
        """The step in which a block comes that is not held, by the first who can; a prop that
        nobody can bring is placed by hand."""
        some = [ANYHOW] if self.site.prop[block] else []
        for grip in (*islice(self.site.crew.grips(block, state), 1), *some)[:1]:
            yield Doing("place", block, None, grip.arm)

    def _goes(self, block: int, state: State) -> Doing:
        """The step in which a prop is taken away, by the first who can, else by hand."""
        grip: Bringing = next(self.site.crew.takes(block, state), ANYHOW)
        return Doing("remove", block, None, grip.arm)

    # ------------------------------------------------------------ what goes again

    def settled(self, move: Transition) -> Transition:
        """A move, with what is let go and taken away because nothing needs it: posts at once, props
        of the structure when all else is there, and where some of them need mortar that holds,
        all after it."""
        state, steps, gone = move.state, [*move.steps], move.gone
        last = bool(state.present[self.wanted].all())
        some = self.site.prop.copy()
        some[: 0 if last else self.count] = False
        some[self.count : self._staying] = False
        again = bool(some.any() or state.held.any())
        while again:
            again = False
            for b in np.flatnonzero(state.held).tolist():
                after = state.change(release=[b])
                if self.stands(after, [b]):
                    steps.append(let_go(b, state))
                    state, again = after, True
            taken, state = self._taken(state, some, False)
            if last and not taken:
                taken, state = self._taken(state, some, True)
            steps, again = [*steps, *taken], again or bool(taken)
            gone |= self._own(taken)
        if last and (state.present & self.site.prop).any() and self._young(state):
            return move
        return Transition(tuple(steps), state, gone)

    def _taken(self, state: State, some: np.ndarray, sure: bool) -> tuple[list[Doing], State]:
        """Take away those of some props (bool[B]) that nothing needs, from above.

        Args:
            sure: look at everything that could carry the rest, not only at what is near, until one
                has gone.
        """
        steps = list[Doing]()
        there = np.flatnonzero(state.present & some).tolist()
        for p in sorted(there, key=lambda p: -self.site.rank[p]):
            key = p, b"" if sure else state.near(self._wide(p))
            if key in self._kept and not sure:
                continue
            after = state.change(remove=[p])
            most = None if sure else self.law(state)
            if self.stands(after, self.on(p, state), most) and self.site.ways.free(
                p, state.present
            ):
                steps.append(self._goes(p, state))
                state = after
                if sure:
                    break  # What is near this state is looked at first again.
            elif not sure:
                self._kept.add(key)
        return steps, state

    def _wide(self, block: int) -> list[int]:
        """Blocks within three contacts."""
        found = {block}
        for _ in range(3):
            found |= {n for b in found for n in self.site.near[b]}
        return sorted(found)

    def _own(self, steps: Iterable[Doing]) -> frozenset[int]:
        """Props of the structure that are taken away."""
        return frozenset(s.block for s in steps if s.action == "remove" and s.block < self.count)

    def walled(self, state: State) -> list[int]:
        """Props that stand and that the structure walls in, and the props on them."""
        props = state.present & self.site.prop
        there = [p for p in np.flatnonzero(props).tolist() if self._encloses(p)]
        if not there:
            return []
        # Another prop in the way goes first: only the structure walls one in.
        open_ = state.present & ~self.site.prop
        found = [p for p in there if not self.site.ways.free(p, open_)]
        for p in found:
            beside = [n for n in self.site.near[p] if props[n] and n not in found]
            found += [n for n in beside if p in self.site.below[n]]
        return found

    def _encloses(self, prop: int) -> bool:
        """Whether the finished structure walls a prop in."""
        if prop not in self._shut:
            self._shut[prop] = not self.site.ways.free(prop, self.end.present)
        return self._shut[prop]

    def _freeing(self, last: Transition, block: int, walled: list[int]) -> Iterator[Transition]:
        """A block that comes after the props have gone that it would wall in, or these steps alone
        where that is not all."""
        state, steps, some = last.state, list[Doing](), np.zeros_like(self.site.prop)
        some[walled] = True
        taken = [Doing("remove", walled[0])]
        while taken:
            taken, state = self._taken(state, some, True)
            steps += taken
        if not steps:
            return
        gone = last.gone | self._own(steps)
        after = state.change(place=[block])
        if not state.present[walled].any() and self.stands(after, [block]):
            for step in self._comes(block, state):
                steps, state = [*steps, step], after
        yield Transition(tuple(steps), state, gone)
