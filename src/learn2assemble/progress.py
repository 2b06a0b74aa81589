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


def counted(items: Sequence[Item], what: str, progress: Progress) -> Iterator[Item]:
    """The items one after the other, while ``progress`` is told how many were, and an estimate of
    what the rest takes.

    Args:
        what: is done with all of them.
    """
    began = told = time.monotonic()
    for number, item in enumerate(items):
        now = time.monotonic()
        if number and now - told >= EVERY:
            told, left = now, (now - began) * (len(items) - number) / number
            progress(Detail(f"{what}: {number} of {len(items)}, about {left:.0f} s left"))
        yield item


def silent(text: str) -> None:
    """Tell nobody."""
