"""Controllers of Universal Robots: ``ur://HOST`` or ``ur://HOST:PORT``.

State comes through ``ur-rtde`` from port 30004, motions go as programs to the secondary interface
(``PORT``, by default 30002), and the dashboard (29999), where it answers, is asked for the model. A
second connection to port 30004 carries the beat by which the controller knows that somebody
watches: the arm stops by itself where that ends.
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct
from typing import Any

import numpy as np

from learn2assemble.controllers.common import (
    Address,
    felt,
    lost,
    marks_of,
    refused,
    thinned,
)
from learn2assemble.controllers.controller import (
    CONNECT,
    LATE,
    SLACK,
    STANDS,
    Controller,
    ControllerState,
)
from learn2assemble.controllers.ur_motion import (
    BEAT,
    OUTCOME,
    PROGRESS,
    SERIAL,
    ScriptOutcome,
    motion_script,
    stop_script,
)
from learn2assemble.errors import InputError, extra
from learn2assemble.plants.plant import (
    Commands,
    Guards,
    Motion,
    PlantError,
    Report,
    Stop,
    ToolReading,
)
from learn2assemble.plants.setup import Setup

STATE, SCRIPTS, DASHBOARD = 30004, 30002, 29999
"""Ports."""
RATE = 125.0
"""States per second."""
ENDED = 0.1
"""So long a program may seem to have ended without saying what came of it [s of the controller]:
what is read of the state may be of two instants."""
RUNNING = 7
"""Mode of a robot that may move."""
VARIABLES = (
    "timestamp",
    "actual_q",
    "actual_qd",
    "actual_TCP_force",
    "actual_digital_input_bits",
    "standard_analog_input0",
    "standard_analog_input1",
    "robot_mode",
    "runtime_state",
    "safety_status_bits",
    f"output_int_register_{SERIAL}",
    f"output_int_register_{OUTCOME}",
    f"output_int_register_{PROGRESS}",
)
_PLAYING = 2
_SAFE = 0b011
"""Safety bits of a robot that may move: normal and reduced mode."""
_STOPS = {
    ScriptOutcome.DONE: Stop.END,
    ScriptOutcome.CONTACT: Stop.CONTACT,
    ScriptOutcome.HELD: Stop.HELD,
    ScriptOutcome.FORCE: Stop.FORCE,
    ScriptOutcome.RELEASED: Stop.VACUUM,
    ScriptOutcome.SILENCE: Stop.LOST,
}


class _Closed:
    """In the place of a connection that was closed: whatever it is asked for is an error."""

    def isConnected(self) -> bool:
        return False

    def __getattr__(self, name: str) -> Any:
        raise PlantError(Stop.LOST, "the connection was closed")


class UrPlant(Controller):
    """An arm behind its controller.

    Args:
        place: host, and port of the secondary interface where it is another one.
        setup: the cell; its arm has to be a UR5e with a tool on a digital output.

    Raises:
        InputError: for an address that is none, another arm, and an input that cannot be read.
        MissingExtraError: without the extra ``ur``.
        PlantError: where nobody answers, or somebody else.
    """

    def __init__(self, place: str, setup: Setup) -> None:
        super().__init__(Address.read("ur", place, SCRIPTS), setup)
        if setup.arm.name != "ur5e":
            raise InputError("robot", f"ur://{place}", f"a controller of the arm {setup.arm.name}")
        held = self.settings.input
        if held.threshold is not None and held.bank == "tool":
            got = "an analog input of the tool connector"
            raise InputError(
                "program.input", got, "a digital one, or one of the standard connector"
            )
        with extra("ur-rtde", "ur"):
            import rtde_receive
        # Another connection's programs have other numbers.
        self.serial: int = int.from_bytes(os.urandom(2)) * 30_000
        self._beat = _Beat(self.place.host)
        self._model()
        try:
            library: Any = rtde_receive
            self._state: Any = library.RTDEReceiveInterface(
                self.place.host, RATE, list(VARIABLES), False, True
            )
        except (RuntimeError, ValueError) as error:
            self._beat.close()
            raise lost(" ".join(str(error).split())) from None

    # ------------------------------------------------------------ what is sensed

    def _read(self) -> ControllerState:
        return ControllerState(
            self._state.getTimestamp(),
            np.array(self._state.getActualQ()),
            np.array(self._state.getActualQd()),
            self._tool(),
            self._stopped(),
            self._state.getRuntimeState() == _PLAYING,
        )

    def _came(self) -> float:
        return self._state.getTimestamp()

    def _tool(self) -> ToolReading:
        vacuum = None if self.arm.suction is None else self._held()
        return ToolReading(vacuum=vacuum, force=self._force(self._state.getActualTCPForce()[:3]))

    def _held(self) -> bool:
        held = self.settings.input
        if held.threshold is not None:
            volts = getattr(self._state, f"getStandardAnalogInput{held.number}")()
            return (volts >= held.threshold) == held.held
        first = 16 if held.bank == "tool" else 0
        bits = self._state.getActualDigitalInputBits()
        return bool(bits >> (first + held.number) & 1) == held.held

    def _stopped(self) -> str:
        """Why the controller does not let the arm move, in words; empty where it does."""
        bits = self._state.getSafetyStatusBits()
        if bits & ~_SAFE:
            return "protective stop" if bits & 4 else f"safety stop (status bits {bits:#x})"
        mode = self._state.getRobotMode()
        return "" if mode == RUNNING else f"the robot is not running (mode {mode})"

    def _speed(self) -> float:
        return float(np.abs(self._state.getActualQd()).max())

    def _silence(self) -> str:
        """What is wrong with the connection, in words; empty where nothing is."""
        if not self._state.isConnected():
            return "the controller closed the connection"
        return self._clock.odd(self._state.getTimestamp(), self.clock.now())

    # ------------------------------------------------------------ what is carried out

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        _, odd = self._begin(motion)
        if odd is not None:
            return odd
        self.serial += 1
        thin = thinned(motion, marks_of(motion, commands, guards))
        script = motion_script(
            thin,
            sorted(commands, key=lambda one: one.at),
            felt(guards, self.around.feel),
            self.driver,
            self.settings,
            self.serial,
            self.around.patience,
        )
        return self._watched(script, motion)

    def _watched(self, script: str, motion: Motion) -> Report:
        """Send a program, and wait for what comes of it."""
        begun, ended = -1.0, -1.0
        first = self._state.getTimestamp()
        try:
            with self._connection(self.place.port) as scripts:
                scripts.sendall(script.encode("ascii"))
                while True:
                    self._beat.beat()
                    why = self._silence()
                    if why:
                        where = Stop.LOST
                        break
                    self._last = self._read()
                    why = self._last.stopped
                    if why:
                        where = Stop.PROTECTIVE
                        break
                    now, ours = self._state.getTimestamp(), self._ours()
                    outcome = self._state.getOutputIntRegister(OUTCOME) if ours else 0
                    if outcome:
                        where = _STOPS[ScriptOutcome(outcome)]
                        why = _WORDS.get(where, "")
                        break
                    begun = now if begun < 0 and ours else begun
                    if begun < 0 and now - first > self.around.answer:
                        where, why = Stop.REFUSED, "the controller did not begin with the program"
                        break
                    runs = ours and self._state.getRuntimeState() == _PLAYING
                    ended = -1.0 if runs or begun < 0 else now if ended < 0 else ended
                    if ended > 0 and now - ended > ENDED:
                        where, why = Stop.REFUSED, "the program was ended by somebody else"
                        break
                    late = LATE * motion.seconds + SLACK
                    if begun >= 0 and now - begun > late:
                        where, why = Stop.LATE, f"not there after {late:.1f} s"
                        break
                    self._wait()
        except (OSError, PlantError) as error:
            where, why = Stop.LOST, getattr(error, "why", str(error))
        past = self._state.getOutputIntRegister(PROGRESS) / 1000 if self._ours() else 0.0
        if where in (Stop.LOST, Stop.LATE, Stop.REFUSED, Stop.PROTECTIVE):
            # Others were found by the program, which has stopped the arm.
            with contextlib.suppress(PlantError):
                self.stop()
        return self._report(where, motion, past, first, why)

    def _ours(self) -> bool:
        """Whether the last program that has begun is the last one that was sent."""
        return self._state.getOutputIntRegister(SERIAL) == self.serial

    def stop(self) -> None:
        """The arm stands when this returns, or nobody can be told to stop it, and it stops by
        itself.

        Raises:
            PlantError: where it still moves after :data:`CONNECT`.
        """
        until = self.clock.now() + CONNECT
        self.serial += 1
        with contextlib.suppress(OSError), self._connection(self.place.port) as scripts:
            scripts.sendall(stop_script(self.serial).encode("ascii"))
            while self.clock.now() < until and self._state.isConnected():
                stood = self._ours() and self._state.getOutputIntRegister(OUTCOME)
                if self._speed() <= STANDS and (stood or self._stopped()):
                    return
                self._wait()
        if self._state.isConnected() and not self._silence() and self._speed() > STANDS:
            raise PlantError(Stop.LATE, "the arm does not stop")

    def close(self) -> None:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        if self._state.isConnected() and self._state.getRuntimeState() == _PLAYING:
            with contextlib.suppress(PlantError):
                self.stop()
        self._beat.close()
        # Its end disconnects. That takes the library half a second, in which no Python runs: now,
        # not when garbage is collected, as another connection may be watching its arm by then.
        self._state = _Closed()

    # ------------------------------------------------------------ connections

    def _connection(self, port: int) -> socket.socket:
        return socket.create_connection((self.place.host, port), CONNECT)

    def _model(self) -> None:
        """Ask the dashboard, where there is one, which robot this is.

        Raises:
            PlantError: for another one.
        """
        try:
            with self._connection(DASHBOARD) as connection, connection.makefile("rw") as lines:
                lines.readline()
                lines.write("get robot model\n")
                lines.flush()
                model = lines.readline().strip()
        except (OSError, UnicodeDecodeError):
            return  # Not every controller lets one in.
        if not model.upper().startswith("UR5"):
            self._beat.close()
            raise refused(f"the robot is a {model!r}, not a UR5e")


_WORDS = {
    Stop.VACUUM: "the input says that nothing is held",
    Stop.LOST: "the controller heard nothing from here",
    Stop.FORCE: "the force is larger than it may be",
}


class _Beat:
    """A number that the controller sees change as long as we watch; and the first look at whether
    it is one: the client library waits without end for one that does not answer.

    Args:
        host: of the controller.

    Raises:
        PlantError: where nobody answers, or something else than a controller.
    """

    def __init__(self, host: str) -> None:
        self.number = 0
        try:
            self.connection = socket.create_connection((host, STATE), CONNECT)
        except OSError as error:
            raise lost(f"{host}:{STATE}: {_line(error)}") from None
        try:
            self.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if self._ask(b"V", struct.pack("!H", 2)) != b"\1":
                raise refused(f"{host}:{STATE} does not speak version 2 of RTDE")
            major = struct.unpack("!4I", self._ask(b"v", b""))[0]
            if major < 5:
                raise refused(f"{host} is a controller of version {major}, not of an e-Series")
            recipe = self._ask(b"I", f"input_int_register_{BEAT}".encode())
            if recipe[:1] == b"\0" or b"INT32" not in recipe:
                raise refused(f"input register {BEAT} of {host} is in use")
            self._recipe = recipe[:1]
        except (OSError, struct.error) as error:
            self.connection.close()
            raise refused(f"{host}:{STATE} is no controller: {_line(error)}") from None
        except PlantError:
            self.connection.close()
            raise

    def _ask(self, kind: bytes, content: bytes) -> bytes:
        self._send(kind, content)
        while True:
            size, found = struct.unpack("!Hc", self._exactly(3))
            answer = self._exactly(size - 3)
            if found == kind:
                return answer
            if found != b"M":  # Messages may come at any time.
                raise OSError(f"an answer of kind {found!r}")

    def _send(self, kind: bytes, content: bytes) -> None:
        self.connection.sendall(struct.pack("!Hc", 3 + len(content), kind) + content)

    def _exactly(self, count: int) -> bytes:
        found = b""
        while len(found) < count:
            part = self.connection.recv(count - len(found))
            if not part:
                raise OSError("it closed the connection")
            found += part
        return found

    def beat(self) -> None:
        """Change the number.

        Raises:
            PlantError: where the connection is lost.
        """
        self.number = (self.number + 1) % 10**6
        try:
            self._send(b"U", self._recipe + struct.pack("!i", self.number))
        except OSError as error:
            raise lost(_line(error)) from None

    def close(self) -> None:
        """Give the connection back."""
        self.connection.close()


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
