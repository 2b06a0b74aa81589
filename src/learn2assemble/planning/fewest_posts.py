"""The fewest posts with which a few blocks are put down one after the other.

States are looked at by the number of posts it took to get there, the nearest to the end first
(uniform-cost search), so the first order that is complete has the fewest. A state is proven when it
is looked at, not when it is first seen: most never are.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from itertools import count

from learn2assemble.linear_programs import Clock
from learn2assemble.planning.forward import Forward
from learn2assemble.planning.sequence import Doing, Transition
from learn2assemble.statics.states import State

_MOST = 4000
"""States that are looked at."""


def fewest_posts(rules: Forward, clock: Clock) -> list[Doing] | None:
    """An order of all blocks with the fewest posts, which stay until all blocks are there or one is
    in the way.

    Args:
        rules: whose posts may be used; no hand holds anything.
        clock: the time that is left; what is looked at is counted, too.

    Returns:
        The steps; None where there is no such order, or none was found in time.
    """
    number = count()
    queue: list[tuple[int, int, int, State, tuple[Doing, ...]]] = [(0, 0, 0, rules.start, ())]
    seen: set[bytes] = set()
    while queue and len(seen) < _MOST and clock.left > 0:
        used, _, _, state, path = heapq.heappop(queue)
        if state.key in seen:
            continue
        seen.add(state.key)
        if path and not _proven(rules, state, path[-1]):
            continue
        if not any(rules.missing(state)):
            return list(path)
        for done in _next(rules, state):
            after = done.after(state)
            if after.key not in seen:
                more = done.action == "place" and done.block >= rules.count
                left = sum(rules.missing(after))
                heapq.heappush(queue, (used + more, left, next(number), after, (*path, done)))
    return None


def _next(rules: Forward, state: State) -> Iterator[Doing]:
    """What may be done next, whether it can be done or not."""
    missing, _ = rules.missing(state)
    ready = list(rules.ready(Transition((), state))) if missing else []
    posts = range(rules.count, len(state.present))
    for block in ready:
        yield Doing("place", block)
    for post in posts if missing else ():
        base = rules.posts[post - rules.count].base
        if not state.present[post] and (base < 0 or state.present[base]):
            yield Doing("place", post)
    if not all(rules.site.ways.free(block, state.present, sliding=False) for block in ready):
        missing = 0  # A post may be in the way.
    for prop in (rules.site.prop & state.present).nonzero()[0].tolist() if not missing else ():
        yield Doing("remove", prop)


def _proven(rules: Forward, state: State, done: Doing) -> bool:
    """Whether the last step to a state can be done, and all stands and rests after it."""
    action, block, *_ = done
    if not rules.site.ways.free(block, state.present, sliding=False):
        return False
    if action == "remove":
        return rules.stands(state, rules.on(block, state))
    if block >= rules.count:
        return rules.stands(state)
    return any(law.rests(state, block) for law in rules.laws) and rules.stands(state, [block])
