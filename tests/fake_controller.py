"""What fake controllers have in common: the arm and the blocks behind them are the dynamic cell of
the simulation, told cycle by cycle. They run in a process of their own, and are told over a socket
of their own how long to go on and what shall go wrong: their time stands while nobody waits for it.

``python fake_controller.py KIND HOST`` begins one and prints where it listens; tests use
:class:`FakeProcess`.
"""

from __future__ import annotations

import base64
import contextlib
import json
import math
import pickle
import select
import socket
import subprocess
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.motion.driver import driver_of
from learn2assemble.plants.plant import (
    BlockReading,
    Motion,
    Request,
    Stop,
    ToolCommand,
    ToolReading,
)
from learn2assemble.plants.setup import PlantClock, Setup
from learn2assemble.robot.arm import get_arm
from learn2assemble.simulation.plant import DynamicPlant

CYCLE = 0.008
"""Of the control loop [s of the robot]."""
PERIOD = {"ur": 0.04, "ros2": 0.024}
"""Between two looks of who waits, at least [s of the robot]: behind ROS it is we who look at
forces, so we have to be quick."""
AGAIN = 0.05
"""Between two times that the state is told while time stands [s of this machine]."""
HEARD = 5.0
"""Longest wait until the other side has heard what it was told [s of this machine]."""
STANDS = 1e-3
"""An arm whose joints are slower stands [rad/s]."""
CALM = 0.1
"""A cell that has been at rest for so long is not simulated on until something happens [s]."""
CLOSE = 0.004
"""Two blocks cannot be presented so near to one another [m]."""


class FakeController(ABC):
    """A robot with a suction cup and blocks, and what goes wrong with it.

    Args:
        host: address of this machine.
    """

    def __init__(self, host: str) -> None:
        self.host = host
        self.ports: dict[str, int] = {}
        self.lock = threading.RLock()
        self._taken = set[socket.socket]()
        """Connections from which something was read that nobody has acted on yet."""
        self.begin(Setup(get_arm("ur5e", "suction"), {}, {}))

    def begin(self, setup: Setup) -> None:
        """A cell as its setup has it; the arm stands, and nothing goes wrong."""
        self.protective, self.refused, self.slow, self.jump = False, 0, 1.0, 0.0
        self.cut_until = self._owed = 0.0
        self._armed: list[tuple[float, str, dict[str, Any]]] = []
        self._plan: list[tuple[float, str, dict[str, Any]]] = []
        self.setup, self.arm = setup, setup.arm
        self.base = quaternion_matrix(driver_of(self.arm).base[3:])
        """float64[3, 3]: how the base of the arm stands in the cell."""
        self.plant = DynamicPlant(setup)
        self.told = self.plant.where()
        """float64[n]: where the drives were told to be last [rad], ..."""
        self.speed = np.zeros_like(self.told)
        """... and how fast [rad/s]."""
        self.tool, self.vacuum = ToolReading(vacuum=False), False
        self.skipped = self.carried = 0.0
        """How long nothing moved [s], and something has hung on the cup."""
        self.odd: list[str] = []
        """What cannot be in a real cell."""
        self.most_share = 0.0
        """Of the speeds of the arm that was used."""
        self._calm = 0.0
        """How long everything has been at rest [s]."""
        self._wanted: tuple[np.ndarray, np.ndarray] | None = None
        self._commands: list[ToolCommand] = []

    # ------------------------------------------------------------ for each kind

    @abstractmethod
    def cycle(self) -> None:
        """What happens in a cycle of the control loop: the arm may be told where to be."""

    @abstractmethod
    def publish(self) -> None:
        """Tell everybody the state."""

    @abstractmethod
    def cut(self) -> None:
        """All connections break."""

    @abstractmethod
    def end(self) -> None:
        """A protective stop ends what the arm was about to do."""

    @abstractmethod
    def busy(self) -> bool:
        """Whether it carries something out, though the arm may stand."""

    @abstractmethod
    def open(self) -> list[socket.socket]:
        """Connections."""

    @abstractmethod
    def heard(self) -> bool:
        """Whether anybody is told the state."""

    # ------------------------------------------------------------ the robot

    @property
    def time(self) -> float:
        """Of the clock of the robot [s]."""
        return self.plant.time + self.skipped

    def drive(self, joints: np.ndarray, velocity: np.ndarray) -> None:
        """The arm shall be there at the end of this cycle, so fast; in a cycle in which it is told
        nothing it brakes, or stands."""
        self._wanted = joints, velocity

    def switch(self, vacuum: bool) -> None:
        """The output of the vacuum."""
        if vacuum != self.vacuum:
            self.vacuum = vacuum
            self._commands.append(ToolCommand(vacuum=vacuum))

    def load(self, mass: float) -> None:
        """What hangs on the tool is so heavy [kg]."""
        self._commands.append(ToolCommand(load=mass))

    def force(self) -> list[float]:
        """What a sensor at the tool says, in the frame of the base [N]."""
        return (np.array(self.tool.force) @ self.base).tolist()

    def comes(self, connection: socket.socket, within: bool = False) -> None:
        """Wait until there is something to read; what was read before has been acted on.

        What has come lies in the connection or counts as taken, at every moment: so time cannot go
        on between its arrival and its effect.

        Args:
            connection: where it comes.
            within: what was read before is a part of something; the rest is on its way.
        """
        if not within:
            with self.lock:
                self._taken.discard(connection)
        select.select([connection], [], [])
        with self.lock:
            self._taken.add(connection)

    def gone(self, connection: socket.socket) -> None:
        """Nothing comes from it any more."""
        with self.lock:
            self._taken.discard(connection)
        connection.close()

    def loop(self) -> None:
        """Say again how things are, also while time stands."""
        while True:
            time.sleep(AGAIN)
            with self.lock:
                self.publish()

    def go(self, seconds: float) -> dict[str, Any]:
        """Let time pass, once all that was sent before has been heard.

        Args:
            seconds: of the robot; what is no whole cycle is left for the next time.

        Returns:
            Its time, the time that its states have, and whether anybody is told them.
        """
        until = time.perf_counter() + HEARD
        while time.perf_counter() < until:
            # One may be closed just now.
            with contextlib.suppress(OSError, ValueError), self.lock:
                if not self._taken and not select.select(self.open(), [], [], 0)[0]:
                    break
            time.sleep(1e-4)
        with self.lock:
            self._owed += seconds
            while self._owed >= CYCLE:
                self._owed -= CYCLE * self.slow
                self._happen()
                if not self.protective:
                    self.cycle()
                self._step()
            self.publish()
            return {"time": self.time, "stamp": self.time + self.jump, "heard": self.heard()}

    def _step(self) -> None:
        """A cycle of the cell."""
        wanted, self._wanted = self._wanted, None
        if wanted is None and self.speed.any():
            self.plant.stop()
            self.told, self.speed = self.plant.where(), self.speed * 0
        span = CYCLE * self.slow
        waits = self.vacuum != bool(self.tool.vacuum) or self._commands
        self._calm = 0.0 if wanted or waits or not self.plant.rests() else self._calm + span
        if self._calm > CALM:
            self.skipped += span
            return
        joints, speed = wanted or (self.told, self.speed)
        speed = speed / self.slow
        ends, speeds = np.stack([self.told, joints]), np.stack([self.speed, speed])
        path = Motion("cross", np.array([0.0, span]), ends, speeds)
        commands, self._commands = self._commands, []
        self.tool = self.plant.execute(path, commands).tool
        share = np.abs(joints - self.told) / span / self.arm.velocity
        self.most_share = max(self.most_share, float(share.max()))
        self.told, self.speed = joints.copy(), speed
        self.carried = self.carried + span if self.tool.vacuum else 0.0

    def _happen(self) -> None:
        """What was to go wrong by now: its time counts from when the arm next moves."""
        if self._armed and self.speed.any():
            self._plan += [(self.time + after, *rest) for after, *rest in self._armed]
            self._plan.sort(key=lambda one: one[0])
            self._armed.clear()
        while self._plan and self._plan[0][0] <= self.time:
            if self.carried < self._plan[0][2].get("carried", 0.0):
                break  # Something has to have hung on the cup for so long first.
            _, what, given = self._plan.pop(0)
            self.tell({"op": what, **given})

    # ------------------------------------------------------------ what it is told

    def tell(self, said: dict[str, Any]) -> dict[str, Any]:
        """One line of the socket for tests."""
        op = said["op"]
        if op == "go":
            return self.go(said["seconds"])
        with self.lock:
            if op == "cell":
                self.end()
                self.begin(pickle.loads(base64.b64decode(said["setup"])))
            elif op == "request":
                self._request(said)
            elif op == "drop":
                # The pump fails: its output stays on.
                self._commands.append(ToolCommand(vacuum=False))
            elif op == "protective":
                self.protective = said.get("on", True)
                if self.protective:
                    self.end()
            elif op == "refuse":
                self.refused = said.get("count", 1)
            elif op == "slow":
                # The program goes on as it was: its steps take longer, so the arm is slower.
                self.speed = self.speed * self.slow / said["factor"]
                self.slow = said["factor"]
            elif op == "clock":
                self.jump += said["by"]
            elif op == "cut":
                self.cut_until = self.time + said.get("seconds", 0.0)
                self.cut()
            elif op == "later":
                what = {key: said[key] for key in said if key not in ("op", "what", "after")}
                self._armed.append((said["after"], said["what"], what))
            joints, velocity = self.plant.measured()
            poses = self.plant.truth()
            seen = self.plant.pictures.look(self.time, poses) if op == "look" else ()
            return {
                "time": self.time,
                "joints": joints.tolist(),
                "moves": bool(self.busy() or self.speed.any() or np.abs(velocity).max() > STANDS),
                "share": self.most_share,
                "held": self.plant.held(),
                "odd": self.odd,
                "vacuum": self.vacuum,
                "poses": {name: pose.tolist() for name, pose in poses.items()},
                "seen": base64.b64encode(pickle.dumps(seen)).decode(),
                "worked": time.process_time(),
                "ports": self.ports,
            }

    def _request(self, said: dict[str, Any]) -> None:
        """A magazine or a person does something; a block that lies there is not presented again."""
        pose, block = np.array(said["pose"], float), said["block"]
        if said["what"] == "present":
            for name, known in self.plant.truth().items():
                near = math.dist(known[:3], pose[:3]) < CLOSE
                if near != (name == block):
                    self.odd.append(f"{block} is presented, and {name} is at {known[:3].tolist()}")
                elif near:
                    return
        request = Request(said["what"], block, said["kind"], pose)
        report = self.plant.request(request)
        if report.stop is not Stop.END:
            self.odd.append(report.detail)
        self.tool = self.plant.bench.feel()

    def serve(self) -> None:
        """Answer tests, one line a question, until the input ends."""
        listener = socket.create_server(("127.0.0.1", 0))
        self.ports["control"] = listener.getsockname()[1]
        threading.Thread(target=self.loop, daemon=True).start()
        print(json.dumps(self.ports), flush=True)
        connection, _ = listener.accept()
        with connection, connection.makefile("rw") as lines:
            for line in lines:
                lines.write(json.dumps(self.tell(json.loads(line))) + "\n")
                lines.flush()


class FakeProcess:
    """A fake controller in a process of its own.

    Args:
        kind: ``ur`` or ``ros2``.
        host: address of this machine.
    """

    def __init__(self, kind: str, host: str = "127.0.0.1") -> None:
        command = [sys.executable, __file__, kind, host]
        self.host, self.kind = host, kind
        self.time = 0.0
        self.clock = PlantClock(lambda: self.time, self.wait)
        """Of the robot: who waits by it lets it go on."""
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parent
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError("the fake controller did not begin")
        self.ports: dict[str, int] = json.loads(line)
        # Minutes, as a cell with a hundred blocks may take long to change on a busy machine.
        self.socket = socket.create_connection(("127.0.0.1", self.ports["control"]), 300)
        self.lines = self.socket.makefile("rw")

    def ask(self, op: str, **given: Any) -> dict[str, Any]:
        """Tell it something; what it is like then."""
        self.lines.write(json.dumps({"op": op, **given}) + "\n")
        self.lines.flush()
        return json.loads(self.lines.readline())

    def go(self, seconds: float) -> dict[str, Any]:
        """Let its time pass [s]; what was sent before is on its way."""
        if self.kind == "ros2":
            from twisted.internet import reactor, threads

            if reactor.running:  # In one turn it is told what to send, behind that it sends.
                for _ in range(2):
                    threads.blockingCallFromThread(reactor, int)
        said = self.ask("go", seconds=seconds)
        self.time = said["time"]
        return said

    def wait(self, seconds: float, came: Callable[[], float]) -> None:
        """Let its time pass, until what it says then has come."""
        said = self.go(max(seconds, PERIOD[self.kind]))
        if not said["heard"]:
            time.sleep(AGAIN / 10)  # Who was cut off has to notice.
            return
        until = time.perf_counter() + HEARD
        while abs(came() - said["stamp"]) > CYCLE / 10 and time.perf_counter() < until:
            time.sleep(1e-4)

    def cell(self, setup: Setup) -> None:
        """Put it into another cell."""
        said = self.ask("cell", setup=base64.b64encode(pickle.dumps(setup)).decode())
        self.time = said["time"]

    def look(self) -> tuple[BlockReading, ...]:
        """What cameras over it see now."""
        return pickle.loads(base64.b64decode(self.ask("look")["seen"]))

    def close(self) -> None:
        """End it."""
        self.lines.close()
        self.socket.close()
        self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


def main() -> None:
    kind, host = sys.argv[1:3]
    if kind == "ur":
        from fake_ur import FakeUr

        FakeUr(host).serve()
    else:
        from fake_rosbridge import FakeRosbridge

        FakeRosbridge(host).serve()


if __name__ == "__main__":
    main()
