"""Time in which kernels are compiled: once on a machine, and no part of what a limit is for.

The first plan on a fresh machine compiles for up to a minute. Counted, that would use up the limit
of a search that takes a second, and the answer would be that time ran out.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import lru_cache
from typing import Any

TOLD = 1.0
"""Compiling that took longer is told [s]."""


class _Compiling:
    """The seconds that kernels took to be compiled so far, by each timer.

    Compilers of numba call one another: the time of the outermost one is taken.
    """

    def __init__(self) -> None:
        self.spent = {time.monotonic: 0.0, time.process_time: 0.0}
        self._began = dict(self.spent)
        self._depth = 0

    def begin(self) -> None:
        if self._depth == 0:
            self._began = {timer: timer() for timer in self.spent}
        self._depth += 1

    @property
    def now(self) -> float:
        """Seconds for which something is being compiled right now; 0 where nothing is."""
        return time.monotonic() - self._began[time.monotonic] if self._depth else 0.0

    def end(self) -> None:
        self._depth -= 1
        if self._depth == 0:
            for timer, began in self._began.items():
                self.spent[timer] += timer() - began


def compiling_seconds(timer: Callable[[], float]) -> float:
    """Seconds of compiling since this was first called.

    Args:
        timer: by which they are measured, ``time.monotonic`` or ``time.process_time``; by any
            other one no time passes.
    """
    return _watched().spent.get(timer, 0.0)


def compiling_so_far() -> tuple[float, float]:
    """Seconds by the clock in which kernels were compiled, and for which one is compiled right now;
    nothing is loaded for it, so both are 0 until somebody has called :func:`compiling_seconds`."""
    if not _watched.cache_info().currsize:
        return 0.0, 0.0
    now = _watched().now
    return _watched().spent[time.monotonic] + now, now


def compiling_words(seconds: float, compiled: float) -> str:
    """What compiling took of a time, e.g. ``38 s of these compiling, once for this machine``.

    Args:
        seconds: in all.
        compiled: of these, in which kernels were compiled; of a second or less nothing is told.
    """
    if min(compiled, seconds) <= TOLD:
        return ""
    return f"{min(round(compiled), int(seconds))} s of these compiling, once for this machine"


@lru_cache(maxsize=1)
def _watched() -> _Compiling:
    from numba.core import event  # no library is loaded before one is needed

    compiling = _Compiling()

    class Listener(event.Listener):
        def on_start(self, event: event.Event) -> None:
            compiling.begin()

        def on_end(self, event: event.Event) -> None:
            compiling.end()

    library: Any = event  # Without types.
    library.register("numba:compile", Listener())
    return compiling
