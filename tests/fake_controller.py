"""What fake controllers have in common: they run in a process of their own, keep the time of a
robot, and are told over a socket of their own what shall go wrong.

``python fake_controller.py KIND HOST RATE`` begins one and prints where it listens; tests use
:class:`FakeProcess`.
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from fake_world import KinematicWorld
from learn2assemble.robot.arm import get_arm

CYCLE = 0.008
"""Of the control loop [s of the robot]."""


class FakeController:
    """A robot with a suction cup and blocks, and what goes wrong with it.

    Args:
        host: address of this machine.
        rate: seconds of the robot in one second.
        arm: name of the arm.
    """

    def __init__(self, host: str, rate: float, arm: str = "ur5e") -> None:
        self.host, self.rate, self.arm = host, rate, get_arm(arm, "suction")
        self.world = KinematicWorld(self.arm)
        self.joints, self.velocity = self.arm.home.copy(), np.zeros(len(self.arm.home))
        self.vacuum = False
        self.time, self.jump = 0.0, 0.0
        self.protective, self.refused, self.slow = False, 0, 1.0
        self.cut_until = 0.0
        self.ports: dict[str, int] = {}
        self.lock = threading.RLock()
        self.most_share: list[float] = []
        """Of the speeds of the arm that were used."""
        self._carried = 0.0
        """How long something has hung on the cup [s]."""
        self._armed: list[tuple[float, str, dict[str, Any]]] = []
        self._plan: list[tuple[float, str, dict[str, Any]]] = []

    # ------------------------------------------------------------ for each kind

    def cycle(self) -> None:
        """What happens in a cycle of the control loop: the arm may move."""
        raise NotImplementedError

    def publish(self) -> None:
        """Tell everybody the state."""
        raise NotImplementedError

    def cut(self) -> None:
        """All connections break."""
        raise NotImplementedError

    def end(self) -> None:
        """A protective stop ends what the arm was about to do."""
        raise NotImplementedError

    # ------------------------------------------------------------ the loop

    def move(self, joints: np.ndarray) -> None:
        """The arm is there at the end of this cycle."""
        self.velocity = (joints - self.joints) / CYCLE
        self.joints = joints.copy()
        self.most_share.append(float((np.abs(self.velocity) / self.arm.velocity).max()))
        del self.most_share[:-20000]

    def loop(self) -> None:
        """Keep time: cycles as the clock of this machine asks for, and the state 200 times a
        second."""
        last, owed = time.perf_counter(), 0.0
        while True:
            now = time.perf_counter()
            # A machine that is busy makes the robot slow, not its steps long.
            owed += min((now - last) * self.rate, 0.02 * self.rate)
            last = now
            with self.lock:
                while owed >= CYCLE:
                    owed -= CYCLE
                    self.time += CYCLE
                    self._happen()
                    if not self.protective:
                        self.cycle()
                    self.world.advance(self.joints, self.vacuum)
                self.publish()
            time.sleep(0.005)

    def _happen(self) -> None:
        """What was to go wrong by now: its time counts from when the arm next moves."""
        if self._armed and self.velocity.any():
            self._plan += [(self.time + after, *rest) for after, *rest in self._armed]
            self._plan.sort(key=lambda one: one[0])
            self._armed.clear()
        if self.world.held is None:
            self._carried = 0.0
        self._carried += CYCLE
        while self._plan and self._plan[0][0] <= self.time:
            if self._plan[0][1] == "drop" and self._carried < 0.5:
                break  # It has to hang there first.
            _, what, given = self._plan.pop(0)
            self.tell({"op": what, **given})

    # ------------------------------------------------------------ what it is told

    def tell(self, said: dict[str, Any]) -> dict[str, Any]:
        """One line of the socket for tests."""
        op, world = said["op"], self.world
        with self.lock:
            if op == "present":
                world.present(said["name"], said["half"], said["pose"])
            elif op == "take":
                world.take(said.get("name") or world.held or "")
            elif op == "drop":
                world.drop()
            elif op == "protective":
                self.protective, self.velocity = said.get("on", True), self.velocity * 0
                if self.protective:
                    self.end()
            elif op == "refuse":
                self.refused = said.get("count", 1)
            elif op == "slow":
                self.slow = said["factor"]
            elif op == "clock":
                self.jump += said["by"]
            elif op == "stand":
                self.arm = get_arm(self.arm.name, "suction", tuple(said["base"]))
                stiff = self.world.stiff
                self.world = KinematicWorld(self.arm)
                self.world.stiff = stiff
                self.joints = np.array(said["joints"], float)
            elif op == "joints":
                self.joints = np.array(said["joints"], float)
            elif op == "cut":
                self.cut_until = time.perf_counter() + said.get("seconds", 0.0)
                self.cut()
            elif op == "later":
                what = {key: said[key] for key in said if key not in ("op", "what", "after")}
                self._armed.append((said["after"], said["what"], what))
            return {
                "time": self.time,
                "joints": self.joints.tolist(),
                "speed": float(np.abs(self.velocity).max()),
                "share": max(self.most_share, default=0.0),
                "held": world.held,
                "odd": world.odd,
                "vacuum": self.vacuum,
                "poses": {name: pose.tolist() for name, pose in world.pose.items()},
                "ports": self.ports,
            }

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
        rate: seconds of the robot in one second.
    """

    def __init__(self, kind: str, host: str = "127.0.0.1", rate: float = 1.0) -> None:
        command = [sys.executable, __file__, kind, host, str(rate)]
        self.host = host
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parent
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError("the fake controller did not begin")
        self.ports: dict[str, int] = json.loads(line)
        self.socket = socket.create_connection(("127.0.0.1", self.ports["control"]), 10)
        self.lines = self.socket.makefile("rw")

    def ask(self, op: str, **given: Any) -> dict[str, Any]:
        """Tell it something; what it is like then."""
        self.lines.write(json.dumps({"op": op, **given}) + "\n")
        self.lines.flush()
        return json.loads(self.lines.readline())

    def close(self) -> None:
        """End it."""
        self.lines.close()
        self.socket.close()
        self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


def main() -> None:
    kind, host, rate = sys.argv[1:4]
    if kind == "ur":
        from fake_ur import FakeUr

        FakeUr(host, float(rate)).serve()
    else:
        from fake_rosbridge import FakeRosbridge

        FakeRosbridge(host, float(rate)).serve()


if __name__ == "__main__":
    main()
