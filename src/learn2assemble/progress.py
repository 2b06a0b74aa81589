"""What is going on, told in lines of text: phases, and how far one has come."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

Progress = Callable[[str], None]
"""Called with a line of text for everything that takes long."""
Item = TypeVar("Item")
EVERY = 1.5
"""How far a phase has come is told after so long [s]."""


class Detail(str):
    """How far a phase has come: the best so far, and what is left of the limit.

    The next one takes its place, where lines can be taken away.

    Args:
        what: without the time that is left.
        left: of the limit [s].
    """

    __slots__ = ("what",)

    what: str

    def __new__(cls, what: str, left: float = math.inf) -> Detail:
        """The line."""
        rest = f", at most {left:.0f} s left" if math.isfinite(left) else ""
        made = super().__new__(cls, f"{what}{rest}")
        made.what = what
        return made


class Counting:
    """Tells how many of many are done, not too often, with an estimate of what the rest takes.

    Args:
        what: is done with all of them.
        done: before this began.
    """

    def __init__(self, what: str, total: int, progress: Progress, done: int = 0) -> None:
        self.what: str = what
        self.total: int = total
        self.progress: Progress = progress
        self.first: int = done
        self.done: int = done
        self._began = self._told = time.monotonic()

    def add(self, number: int = 1) -> None:
        """So many more are done."""
        self.done += number
        now = time.monotonic()
        if now - self._told >= EVERY and self.done < self.total:
            self._told = now
            rate = (now - self._began) / (self.done - self.first)
            left = f"about {rate * (self.total - self.done):.0f} s left"
            self.progress(Detail(f"{self.what}: {self.done} of {self.total}, {left}"))


def counted(items: Sequence[Item], what: str, progress: Progress) -> Iterator[Item]:
    """The items one after the other, while ``progress`` is told how many were (:class:`Counting`).

    Args:
        what: is done with all of them.
    """
    count = Counting(what, len(items), progress)
    for item in items:
        yield item
        count.add()


def silent(text: str) -> None:
    """Tell nobody."""
