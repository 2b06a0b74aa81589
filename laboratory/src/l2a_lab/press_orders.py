"""Whether bricks that clutch have any order that bears its presses: all states are looked at.

An order of building, read backwards, takes bricks off a structure. Here everything is taken off
that an order without supports could take off, whatever an arm reaches: a brick that is free from
above, or any bricks of which one, held alone, carries the others, so that they can be built beside
it and brought as one, perhaps in such parts again. Where no way of taking off leads from the whole
structure to nothing, every order has a press, or a state, that does not stand without a support.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.bricks.lattice import GROUND
from learn2assemble.cell.bricks import BrickStates
from learn2assemble.errors import InputError

MOST_BRICKS = 14
"""Sets of more bricks are too many to look at."""


class PressOrders(NamedTuple):
    """What all states of a structure show."""

    alone: bool
    """Whether an order of single bricks bears its presses."""
    beside: bool
    """Whether one does where bricks are built beside, too, brick by brick, ..."""
    within: bool
    """... and where what is built beside may have parts that are built beside that."""
    states: int
    """How many states were reached from the whole structure, itself included."""


def press_orders(assembly: Assembly) -> PressOrders:
    """Whether orders without supports exist, found by exhaustion.

    Args:
        assembly: bricks on a lattice of studs whose joints clutch; its steps are not looked at.

    Raises:
        InputError: for blocks that are no such bricks, and for more than :data:`MOST_BRICKS`.
    """
    count = len(assembly.blocks)
    if not 0 < count <= MOST_BRICKS:
        raise InputError("bricks", count, f"1 to {MOST_BRICKS} bricks, all states are looked at")
    search = _Exhaustion(assembly)
    alone, few = search.reach(parts=False)
    beside, many = (alone, few) if alone else search.reach(parts=True)
    within = beside
    if not beside:
        within, many = _Exhaustion(assembly, within=True).reach(parts=True)
    return PressOrders(alone, beside, within, many)


class _Exhaustion:
    """Everything that may be taken off, of every state.

    Args:
        assembly: the bricks.
        within: whether what is built beside may have parts of its own.
    """

    def __init__(self, assembly: Assembly, within: bool = False) -> None:
        self.states, self.within = BrickStates(assembly), within
        self.over = [frozenset(over.tolist()) for over in self.states.mates.over]
        self.whole = frozenset(range(len(assembly.blocks)))
        self._beside: dict[frozenset[int], bool] = {}

    def reach(self, parts: bool) -> tuple[bool, int]:
        """Whether everything can be taken off, and how many states are reached.

        Args:
            parts: whether bricks that were built beside come off as one, too.
        """
        if not self.states.stands(self.whole):
            return False, 1
        seen, left = {self.whole}, [self.whole]
        while left:
            present = left.pop()
            for rest in self._after(present, parts):
                if rest not in seen:
                    seen.add(rest)
                    left.append(rest)
        return frozenset() in seen, len(seen)

    def _after(self, present: frozenset[int], parts: bool) -> Iterator[frozenset[int]]:
        """What is left where something comes off a state that stands."""
        for group in self._free(present, len(present) if parts else 1):
            if _bears(self.states, tuple(sorted(group)), present - group):
                yield present - group

    def _free(self, present: frozenset[int], most: int) -> Iterator[frozenset[int]]:
        """What nothing is over: a brick, then up to so many that can be built beside."""
        for size in range(1, most + 1):
            for group in map(frozenset, combinations(sorted(present), size)):
                over = any(self.over[b] & (present - group) for b in group)
                if not over and (size == 1 or self.built_beside(group)):
                    yield group

    def built_beside(self, group: frozenset[int]) -> bool:
        """Whether bricks stand on a table, can be put together there, and are carried by one."""
        if group not in self._beside:
            self._beside[group] = self._carried(group) and self._put_together(group)
        return self._beside[group]

    def _carried(self, group: frozenset[int]) -> bool:
        return any(self.states.stands(group, held) for held in group)

    def _put_together(self, group: frozenset[int]) -> bool:
        bricks = tuple(sorted(group))
        table, number = self.states.on_table(bricks), {b: n for n, b in enumerate(bricks)}
        if not table.stands(frozenset(range(len(bricks)))):
            return False
        seen, left = {group}, [group]
        while left:
            present = left.pop()
            # A part of it is smaller than all of it.
            most = min(len(present), len(group) - 1) if self.within else 1
            for part in self._free(present, most):
                rest = present - part
                there = frozenset(number[b] for b in rest)
                own = tuple(number[b] for b in sorted(part))
                if rest not in seen and _bears(table, own, there):
                    if not rest:
                        return True
                    seen.add(rest)
                    left.append(rest)
        return False


def _bears(states: BrickStates, group: tuple[int, ...], rest: frozenset[int]) -> bool:
    """Whether what is left stands, meets what comes to it, and bears its press."""
    lower = (a for b in group for a in states.mates.lower[b])
    if not any(a == GROUND or a in rest for a in lower):
        return False
    if rest and not states.stands(rest):
        return False
    return states.stands(rest | set(group)) and states.stands_pressed(group, rest)
