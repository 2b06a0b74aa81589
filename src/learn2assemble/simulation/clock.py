"""One time for several arms: it goes on when every arm that moves waits for it.

Whoever lets an arm move does so as if it was alone; the arms take turns, in an order that nothing
but the simulation decides.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import TypeVar

T = TypeVar("T")


class SharedClock:
    """Lets jobs run side by side, one at a time.

    Args:
        advance: lets time go on by one step; called with the numbers of those that wait for it, all
            others stand.
    """

    def __init__(self, advance: Callable[[frozenset[int]], None]) -> None:
        self._advance = advance
        self._turns: dict[int, Lock] = {}
        """Of the jobs that are not over, in their order: a lock that opens when it is its turn. A
        semaphore, whose counting is Python, takes longer than many a step."""
        self._waiting: set[int] = set()

    def tick(self, who: int) -> None:
        """Wait until a step of time is over.

        Args:
            who: number of the arm that waits.
        """
        if not self._turns:
            self._advance(frozenset({who}))
            return
        self._waiting.add(who)
        while who in self._waiting:
            ready = [number for number in self._turns if number not in self._waiting]
            if not ready:
                waiting, self._waiting = frozenset(self._waiting), set()
                self._advance(waiting)
                ready = list(self._turns)
            if ready[0] != who:
                self._turns[ready[0]].release()
                self._turns[who].acquire()

    def run(self, jobs: Sequence[Callable[[], T]]) -> list[T]:
        """Run jobs side by side until all are over; the n-th one moves the n-th arm.

        An error of one ends that one alone; the first error is raised when all are over.

        Returns:
            What they return, in their order.
        """
        self._turns = {number: Lock() for number in range(len(jobs))}
        for turn in self._turns.values():
            turn.acquire()

        def work(number: int) -> T:
            self._turns[number].acquire()
            try:
                return jobs[number]()
            finally:
                self._leave(number)

        with ThreadPoolExecutor(len(jobs)) as pool:
            found = [pool.submit(work, number) for number in range(len(jobs))]
            self._turns[0].release()
        return [one.result() for one in found]

    def _leave(self, who: int) -> None:
        """A job is over: it is the turn of another one."""
        del self._turns[who]
        ready = [number for number in self._turns if number not in self._waiting]
        for number in (ready or list(self._turns))[:1]:
            self._turns[number].release()
