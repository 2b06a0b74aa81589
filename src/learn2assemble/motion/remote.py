"""A plant in another process or on another machine: the same questions and answers over a
connection of the standard library.

What travels are the values of :mod:`learn2assemble.motion.plant`. The connection pickles them, so
both ends have to trust each other, as two processes of one user do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

from learn2assemble.motion.plant import (
    Guard,
    Motion,
    Plant,
    PlantError,
    Readings,
    Report,
    Request,
    Stop,
    ToolCommand,
)
from learn2assemble.motion.setup import Setup

ASKED = ("sense", "execute", "request", "stop")
SIMULATED = ("truth", "state", "restore")
"""What is answered, and what only a simulation answers: to its reports and its file."""


def serve(plant: Plant, connection: Connection) -> None:
    """Answer what comes over a connection until it ends; the arm stands then."""
    try:
        while True:
            name, given = connection.recv()
            if name == "close":
                break
            try:
                connection.send((None, _answer(plant, name, given)))
            except PlantError as error:
                connection.send((error, None))
    except (EOFError, OSError):
        pass  # Nobody asks any more.
    finally:
        plant.stop()
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
    """

    def __init__(self, connection: Connection, patience: float = 600.0) -> None:
        self.connection = connection
        self.patience = patience

    def _ask(self, name: str, *given: Any) -> Any:
        self.connection.send((name, given))
        if not self.connection.poll(self.patience):
            raise PlantError(Stop.LATE, f"no answer in {self.patience:g} s")
        error, answer = self.connection.recv()
        if error is not None:
            raise error
        return answer

    def sense(self) -> Readings:
        """See :class:`~learn2assemble.motion.plant.Plant`."""
        return self._ask("sense")

    def execute(
        self,
        motion: Motion,
        commands: Sequence[ToolCommand] = (),
        guards: Sequence[Guard] = (),
    ) -> Report:
        """See :class:`~learn2assemble.motion.plant.Plant`."""
        return self._ask("execute", motion, tuple(commands), tuple(guards))

    def request(self, request: Request) -> Report:
        """See :class:`~learn2assemble.motion.plant.Plant`."""
        return self._ask("request", request)

    def stop(self) -> None:
        """See :class:`~learn2assemble.motion.plant.Plant`."""
        self._ask("stop")

    def close(self) -> None:
        """See :class:`~learn2assemble.motion.plant.Plant`."""
        with suppress(OSError):  # It may be closed already.
            self.connection.send(("close", ()))
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
    """A simulated plant in a process of its own, which ends with the connection.

    Args:
        open_it: makes the plant there; a function of a module.
        setup: that it is called with.
    """
    context = get_context("spawn")
    near, far = context.Pipe()
    process = context.Process(target=_run, args=(open_it, setup, far), daemon=True)
    process.start()
    far.close()
    return RemoteSimulation(near)


def _run(open_it: Callable[[Setup], Plant], setup: Setup, connection: Connection) -> None:
    serve(open_it(setup), connection)
