"""A plant in another process or on another machine: the same questions and answers over a
connection of the standard library.

What travels are the values of :mod:`learn2assemble.plants.plant`. The connection pickles them, so
both ends have to trust each other, as two processes of one user do.

A plant that can be asked while it carries something out (it has a method ``latest``) tells where
its arm is, and is stopped as soon as it is told to or nobody is at the other end any more.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any

from learn2assemble.errors import Learn2AssembleError
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
)
from learn2assemble.plants.setup import Setup

ASKED = ("sense", "execute", "request")
SIMULATED = ("truth", "state", "restore")
"""What is answered, and what only a simulation answers: to its reports and its file."""
TOLD = 0.05
"""Between two times that it is told where an arm is that moves [s]."""
STANDS = 10.0
"""Longest wait until an arm that is given back stands [s]."""


def serve(plant: Plant, connection: Connection) -> None:
    """Answer what comes over a connection until it ends; the arm stands then."""
    asked: SimpleQueue[tuple[str, tuple[Any, ...]] | None] = SimpleQueue()
    sending, acting, over = threading.Lock(), threading.Event(), threading.Event()
    latest: Callable[[], Readings | None] | None = getattr(plant, "latest", None)

    def send(what: str, value: object) -> None:
        with sending:
            connection.send((what, value))

    def halt() -> None:
        with suppress(PlantError, OSError):
            plant.stop()

    def listen() -> None:
        """What comes is answered in its order; but who can be stopped in between, is."""
        with suppress(EOFError, OSError):
            while (question := connection.recv())[0] != "close":
                if question[0] == "stop" and latest is not None:
                    halt()
                else:
                    asked.put(question)
        if latest is not None:
            halt()
        asked.put(None)

    def tell(now: Callable[[], Readings | None]) -> None:
        with suppress(EOFError, OSError):
            while not over.wait(TOLD):
                if acting.is_set():  # Else nobody listens, and what is told would pile up.
                    send("latest", now())

    threading.Thread(target=listen, daemon=True).start()
    if latest is not None:
        threading.Thread(target=tell, args=(latest,), daemon=True).start()
    try:
        while (question := asked.get()) is not None:
            name, given = question
            if name == "stop":
                halt()
                continue
            acting.set()
            try:
                kind, said = "answer", _answer(plant, name, given)
            except PlantError as error:
                kind, said = "error", error
            acting.clear()
            send(kind, said)
    except (EOFError, OSError):
        pass  # Nobody asks any more.
    finally:
        over.set()
        halt()
        plant.close()
        connection.close()


def _answer(plant: Plant, name: str, given: tuple[Any, ...]) -> Any:
    method = getattr(plant, name, None) if name in (*ASKED, *SIMULATED) else None
    if method is None:
        raise PlantError(Stop.REFUSED, f"nobody answers {name!r}")
    return method(*given)


class RemotePlant:
    """A plant at the other end of a connection.

    Args:
        connection: to :func:`serve`.
        patience: how long an answer may take [s].
        ended: called when it is closed: returns when the arm stands.
    """

    def __init__(
        self,
        connection: Connection,
        patience: float = 600.0,
        ended: Callable[[], object] = lambda: None,
    ) -> None:
        self.connection = connection
        self.patience = patience
        self._ended = ended
        self._latest: Readings | None = None

    def _ask(self, name: str, *given: Any) -> Any:
        with suppress(OSError):  # That it has ended is seen as no answer comes.
            self.connection.send((name, given))
        return self.answer()

    def answer(self) -> Any:
        """What comes back of what was asked.

        Raises:
            PlantError: also where nothing does in time, or the other side has ended.
        """
        until = time.monotonic() + self.patience
        while True:
            try:
                heard = self.heard(max(until - time.monotonic(), 0.0))
            except (EOFError, OSError):
                raise PlantError(Stop.LOST, "the process that drives it has ended") from None
            if heard is None:
                break
            what, value = heard
            if what == "error":
                raise value
            if what == "answer":
                return value
        raise PlantError(Stop.LATE, f"no answer in {self.patience:g} s")

    def heard(self, seconds: float) -> tuple[str, Any] | None:
        """The next that comes from the other side: an answer, an error, or where its arm is; None:
        nothing in so long [s]."""
        if not self.connection.poll(seconds):
            return None
        found = self.connection.recv()
        if found[0] == "latest":
            self._latest = found[1]
        return found

    def latest(self) -> Readings | None:
        """What was sensed last of an arm that carries something out, as far as its plant tells;
        any thread may ask."""
        return self._latest

    def sense(self) -> Readings:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        return self._ask("sense")

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        return self._ask("execute", motion, tuple(commands), tuple(guards))

    def request(self, request: Request) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        return self._ask("request", request)

    def stop(self) -> None:
        """See :class:`~learn2assemble.plants.plant.Plant`; does not wait until the arm stands. Any
        thread may call it."""
        with suppress(OSError):  # Where nobody hears it, the other side stops by itself.
            self.connection.send(("stop", ()))

    def close(self) -> None:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        with suppress(OSError):  # It may be closed already.
            self.connection.send(("close", ()))
            self._ended()
        self.connection.close()


class RemoteSimulation(RemotePlant):
    """A simulated plant at the other end: it also answers reports of the simulation."""

    def truth(self) -> Any:
        """See :class:`~learn2assemble.simulation.things.SimulatedCell`."""
        return self._ask("truth")

    def state(self) -> Any:
        """See :class:`~learn2assemble.simulation.things.SimulatedCell`."""
        return self._ask("state")

    def restore(self, state: Any) -> None:
        """See :class:`~learn2assemble.simulation.things.SimulatedCell`."""
        self._ask("restore", state)


def in_process(open_it: Callable[[Setup], Plant], setup: Setup) -> RemoteSimulation:
    """A plant in a process of its own, which ends with the connection.

    Args:
        open_it: makes the plant there; a function of a module, or a part of one that can be sent.
        setup: that it is called with.

    Raises:
        Learn2AssembleError: as ``open_it`` does.
    """
    context = get_context("spawn")
    near, far = context.Pipe()
    process = context.Process(target=_run, args=(open_it, setup, far), daemon=True)
    process.start()
    far.close()
    plant = RemoteSimulation(near, ended=lambda: process.join(STANDS))
    plant.answer()
    return plant


def _run(open_it: Callable[[Setup], Plant], setup: Setup, connection: Connection) -> None:
    # Who is interrupted at the terminal tells it to stop: both at once would leave no time for it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        plant = open_it(setup)
    except Learn2AssembleError as error:
        connection.send(("error", error))
        return
    connection.send(("answer", None))
    serve(plant, connection)
