"""Robots in one cell, each behind a plant of its own: one decides at a time, all move at once.

Whoever lets them work does so in a thread for each, as with the arms of a simulated cell
(:mod:`learn2assemble.simulation.clock`), but time goes on by itself. A thread decides until it asks
its robot to do something; while that takes, others decide. All readings are on one clock.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

from learn2assemble.plants.plant import (
    Commands,
    Guards,
    Motion,
    Plant,
    PlantError,
    Readings,
    Report,
    Request,
    Stop,
    WrappedPlant,
)
from learn2assemble.plants.setup import Surroundings
from learn2assemble.plants.trust import Placements

T = TypeVar("T")
ALONE = Surroundings()
"""Nothing sees blocks, magazines are never empty."""
BY_HAND = ("place", "remove")
"""Requests that bring a person among the robots: all of them stand meanwhile."""


class Robots:
    """Robots in one cell; the thread that makes it is the one that decides, until it lets others.

    Args:
        plants: one of each robot, which stands.
        around: what sees blocks and what serves the cell, for all of them alike, and the clock that
            times are told by from now on [s].
        known: where blocks are taken to be; kept in the file of a build.
    """

    plants: Sequence[OneOfRobots]
    piecewise: bool = False
    """Each motion is a program of its own."""

    def __init__(
        self,
        plants: Sequence[Plant],
        around: Surroundings = ALONE,
        known: Placements | None = None,
    ) -> None:
        self.around: Surroundings = around
        self.known: Placements | None = known
        self.deciding: threading.Lock = threading.Lock()
        self.stands: threading.Condition = threading.Condition(threading.Lock())
        """Told whenever a robot has come to stand."""
        self.ended: str = ""
        """Why nobody is to move any more."""
        self.deciding.acquire()
        self.plants = tuple(OneOfRobots(plant, self) for plant in plants)

    @property
    def clock(self) -> Robots:
        """What lets work of several robots run side by side."""
        return self

    def run(self, jobs: Sequence[Callable[[], T]]) -> list[T]:
        """Run jobs side by side until all are over; the n-th one moves the n-th robot.

        Where one of them ends in an error of this program, or somebody interrupts them, all robots
        are stopped before that is raised.

        Returns:
            What they return, in their order.
        """

        def work(job: Callable[[], T]) -> T:
            with self.deciding:
                return job()

        self.deciding.release()
        try:
            with ThreadPoolExecutor(len(jobs)) as pool:
                found = [pool.submit(work, job) for job in jobs]
                try:
                    over, _ = wait(found, return_when=FIRST_EXCEPTION)
                    if any(one.exception() for one in over):
                        self.end("the side that decides has failed")
                    wait(found)
                except BaseException:
                    self.end("interrupted")
                    raise
        finally:
            self.deciding.acquire()
        return [one.result() for one in found]

    def end(self, why: str) -> None:
        """Stop all robots; from now on nobody moves any more. Any thread may call it."""
        self.ended = self.ended or why
        for one in self.plants:
            if one.busy is not None:
                with suppress(PlantError, OSError):
                    one.plant.stop()

    @contextmanager
    def aside(self) -> Generator[None]:
        """Others decide meanwhile."""
        self.deciding.release()
        try:
            yield
        finally:
            self.deciding.acquire()

    def loosen(self) -> None:
        """Of a simulation: nothing here."""

    def sense(self) -> Readings:
        """What is sensed now, with the first robot."""
        return self.plants[0].sense()

    def state(self) -> dict[str, Any]:
        """What the file of a build keeps, from which another one goes on."""
        known = None if self.known is None else self.known.state()
        return {"time": self.sense().time, "known": known}

    def restore(self, state: dict[str, Any]) -> None:
        """As :meth:`state` said; times go on from those of the file."""
        later = state["time"] - self.sense().time
        for one in self.plants:
            one.ahead += later
        if self.known is not None and state["known"] is not None:
            self.known.restore(state["known"])


class OneOfRobots(WrappedPlant):
    """A robot that shares its cell.

    Args:
        plant: the one behind it.
        cell: that it is in.
    """

    def __init__(self, plant: Plant, cell: Robots) -> None:
        super().__init__(plant)
        self.cell: Robots = cell
        self.busy: int | None = None
        """The thread for which it carries something out."""
        self.last: Readings = plant.sense()
        """What was sensed, on its own clock."""
        self.ahead: float = cell.around.clock.now() - self.last.time
        """How much later it is on the clock of all robots [s]."""

    def sense(self) -> Readings:
        """See :class:`~learn2assemble.plants.plant.Plant`. While the robot moves, others get what
        it was seen to do last, without blocks."""
        if self.busy not in (None, threading.get_ident()):
            latest: Callable[[], Readings | None] = getattr(self.plant, "latest", lambda: None)
            found = latest() or self.last
            return found._replace(time=found.time + self.ahead, blocks=())
        found = self.last = self.plant.sense()
        look = self.cell.around.look
        now = found.time + self.ahead
        seen = [one._replace(time=one.time + self.ahead) for one in found.blocks]
        # What was just seen may be newer than the last state that has come.
        seen += [] if look is None else [one._replace(time=min(one.time, now)) for one in look()]
        return found._replace(time=now, blocks=tuple(seen))

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`.

        Raises:
            PlantError: also where nobody is to move any more.
        """
        self._check()
        self.busy = threading.get_ident()
        with self.cell.aside():
            try:
                report = self.plant.execute(motion, commands, guards)
            finally:
                with self.cell.stands:
                    self.busy = None
                    self.cell.stands.notify_all()
        self._check()
        if report.played is None:
            return report
        return report._replace(played=report.played._replace(time=report.played.time + self.ahead))

    def request(self, request: Request) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`; a person comes when all robots stand,
        and they do so until the person is gone."""
        self._check()
        if request.what in BY_HAND:
            with self.cell.stands:
                self.cell.stands.wait_for(lambda: all(r.busy is None for r in self.cell.plants))
            return self._asked(request)
        if request.what == "join":
            return self._asked(request)
        with self.cell.aside():
            return self._asked(request)

    def _asked(self, request: Request) -> Report:
        if self.cell.around.serve is None:
            return self.plant.request(request)
        self.cell.around.serve(request)
        return Report(Stop.END, 1.0, self.last.joints, 0.0)

    def _check(self) -> None:
        if self.cell.ended:
            raise PlantError(Stop.REFUSED, self.cell.ended)
