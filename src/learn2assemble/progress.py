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


class Pace:
    """How long the rest of something takes if it goes on as it did, from how much is left."""

    def __init__(self) -> None:
        self._began: float = time.monotonic()
        self._first: int | None = None

    def about(self, left: int) -> str:
        """The estimate in words; none before it rests on anything, or at the end.

        Args:
            left: of the same things as in the calls before.
        """
        now = time.monotonic()
        if self._first is None or left > self._first:
            self._began, self._first = now, left
        done, passed = self._first - left, now - self._began
        return f", about {passed / done * left:.0f} s" if done and left and passed >= EVERY else ""


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
        self.done: int = done
        self._pace = Pace()
        self._pace.about(total - done)
        self._told: float = time.monotonic()

    def add(self, number: int = 1) -> None:
        """So many more are done."""
        self.done += number
        now = time.monotonic()
        if now - self._told >= EVERY and self.done < self.total:
            self._told = now
            left = f"{self._pace.about(self.total - self.done)} left"
            self.progress(Detail(f"{self.what}: {self.done} of {self.total}{left}"))


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
