"""A rosbridge for tests, with the joint trajectory controller and the suction tool behind it: a
websocket server of a few lines, without any library for that."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import json
import math
import socket
import struct
import threading
from typing import Any

import numpy as np

from fake_controller import CYCLE, FakeController
from learn2assemble.motion.driver import driver_of
from learn2assemble.plants.plant import Motion
from learn2assemble.robot.arm import get_arm

TEXT, CLOSE = 1, 8
"""Kinds of frames."""
_GUID = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"


class FakeRosbridge(FakeController):
    """See the module."""

    def __init__(self, host: str) -> None:
        self.names = list(driver_of(get_arm("ur5e", "suction")).joints)
        self.goal: dict[str, Any] | None = None
        self.points: list[tuple[float, np.ndarray, np.ndarray]] = []
        self.since = 0.0
        self._open: dict[socket.socket, set[str]] = {}
        super().__init__(host)
        listener = socket.create_server((host, 0))
        self.ports["bridge"] = listener.getsockname()[1]
        threading.Thread(target=self._accept, args=(listener,), daemon=True).start()

    # ------------------------------------------------------------ the controller

    def cycle(self) -> None:
        """One step along the trajectory."""
        if not self.points:
            return
        self.since += CYCLE
        while len(self.points) > 1 and self.points[1][0] <= self.since + 1e-9:
            self.points.pop(0)
        if len(self.points) == 1:
            self.drive(self.points[0][1], np.zeros_like(self.told))
            self._end(4, 0)
            return
        (t, q, v), (s, r, w) = self.points[:2]
        path = Motion("", np.array([t, s]), np.stack([q, r]), np.stack([v, w]))
        there, velocity = path.at(np.array([self.since]))
        self.drive(there[0], velocity[0])

    def busy(self) -> bool:
        """See the base."""
        return bool(self.points)

    def open(self) -> list[socket.socket]:
        """See the base."""
        return list(self._open)

    def heard(self) -> bool:
        """See the base."""
        return any("/joint_states" in topics for topics in self._open.values())

    def _end(self, status: int, code: int, words: str = "") -> None:
        goal, self.goal, self.points = self.goal, None, []
        if goal is not None:
            values = {"error_code": code, "error_string": words}
            said = {"op": "action_result", "id": goal["id"], "action": goal["action"]}
            self._tell(
                goal["by"], {**said, "values": values, "status": status, "result": status == 4}
            )

    def _take(self, connection: socket.socket, said: dict[str, Any]) -> None:
        self._end(5, 0, "another goal came")
        self.goal = {"id": said["id"], "action": said["action"], "by": connection}
        told = said["args"]["trajectory"]
        if self.refused and len(told["points"]) > 1:
            self.refused -= 1
            self._end(6, -1, "Goal was rejected by the server")
            return
        if sorted(told["joint_names"]) != sorted(self.names) or self.protective:
            self._end(6, -2, "joints")
            return
        said = {"op": "action_feedback", "id": said["id"], "action": said["action"], "values": {}}
        self._tell(connection, said)
        row = [told["joint_names"].index(name) for name in self.names]
        self.points, self.since = [(0.0, self.told.copy(), self.speed.copy())], 0.0
        for point in told["points"]:
            at = point["time_from_start"]
            q, v = (np.array(point[key])[row] for key in ("positions", "velocities"))
            self.points.append((at["sec"] + 1e-9 * at["nanosec"], q, v))

    def end(self) -> None:
        """The goal is aborted."""
        self._end(6, -4, "the robot was stopped")

    def tell(self, said: dict[str, Any]) -> dict[str, Any]:
        """Joints may have other names."""
        if said["op"] == "names":
            self.names = said["names"]
        return super().tell(said)

    # ------------------------------------------------------------ topics

    def publish(self) -> None:
        """The state, to everybody who listens; the joints come last, as their time says that all of
        it has come."""
        if not self._open:
            return
        joints, velocity = self.plant.measured()
        at = self.time + self.jump
        stamp = {"sec": math.floor(at), "nanosec": int(at % 1 * 1e9)}
        said = {
            "/tool/wrench": {"wrench": {"force": dict(zip("xyz", self.force(), strict=True))}},
            "/suction/held": {"data": bool(self.tool.vacuum)},
            "/robot/stopped": {"data": self.protective},
            "/robot_description": {"data": f'<?xml version="1.0"?><robot name="{self.arm.name}">'},
            "/joint_states": {
                "header": {"stamp": stamp, "frame_id": ""},
                "name": self.names,
                "position": joints.tolist(),
                "velocity": velocity.tolist(),
                "effort": [],
            },
        }
        texts = {
            topic: json.dumps({"op": "publish", "topic": topic, "msg": message}).encode()
            for topic, message in said.items()
        }
        for connection, topics in list(self._open.items()):
            frames = [_framed(TEXT, text) for topic, text in texts.items() if topic in topics]
            with contextlib.suppress(OSError):
                connection.sendall(b"".join(frames))

    def _heard(self, connection: socket.socket, said: dict[str, Any]) -> None:
        op = said["op"]
        if op == "subscribe":
            self._open[connection].add(said["topic"])
            self.publish()
        elif op == "send_action_goal":
            self._take(connection, said)
        elif op == "publish" and said["topic"] == "/suction/vacuum":
            self.switch(bool(said["msg"]["data"]))
        elif op == "publish" and said["topic"] == "/tool/load":
            self.load(float(said["msg"]["data"]))

    # ------------------------------------------------------------ websocket

    def _accept(self, listener: socket.socket) -> None:
        while True:
            connection, _ = listener.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if self.time < self.cut_until:
                connection.close()
                continue
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with contextlib.suppress(OSError, ValueError):
            head = b""
            while not head.endswith(b"\r\n\r\n"):
                part = connection.recv(1)
                if not part:
                    return
                head += part
            lines = dict(line.split(": ", 1) for line in head.decode().splitlines() if ": " in line)
            key = {name.lower(): text for name, text in lines.items()}["sec-websocket-key"]
            accept = base64.b64encode(hashlib.sha1((key + _GUID).encode()).digest()).decode()
            connection.sendall(
                "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\n"
                f"Connection: Upgrade\r\nSec-WebSocket-Accept: {accept}\r\n\r\n".encode()
            )
            with self.lock:
                self._open[connection] = set()
            text = b""
            while True:
                self.comes(connection, within=bool(text))
                last, code, content = _frame(connection)
                if code == CLOSE:
                    break
                text += content if code in (0, 1) else b""
                if last and code in (0, 1):
                    with self.lock:
                        self._heard(connection, json.loads(text))
                    text = b""
        with self.lock:
            self._open.pop(connection, None)
        self.gone(connection)

    def _tell(self, connection: socket.socket, said: dict[str, Any]) -> None:
        with contextlib.suppress(OSError):
            connection.sendall(_framed(TEXT, json.dumps(said).encode()))

    def cut(self) -> None:
        """All connections break; nobody is let in for a while."""
        for connection in list(self._open):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        self._open.clear()


def _framed(code: int, content: bytes) -> bytes:
    """A whole message as one frame."""
    size = struct.pack("!BBH", 128 | code, 126, len(content))
    if len(content) < 126:
        size = struct.pack("!BB", 128 | code, len(content))
    return size + content


def _frame(connection: socket.socket) -> tuple[bool, int, bytes]:
    """The next frame: whether it is the last of its message, its kind, its content."""

    def exactly(count: int) -> bytes:
        found = b""
        while len(found) < count:
            part = connection.recv(count - len(found))
            if not part:
                raise OSError("closed")
            found += part
        return found

    first, second = exactly(2)
    size = second & 127
    if size == 126:
        (size,) = struct.unpack("!H", exactly(2))
    elif size == 127:
        (size,) = struct.unpack("!Q", exactly(8))
    mask = exactly(4) if second & 128 else b"\0\0\0\0"
    content = np.frombuffer(exactly(size), np.uint8)
    key = np.resize(np.frombuffer(mask, np.uint8), size)
    return bool(first & 128), first & 15, (content ^ key).tobytes()
