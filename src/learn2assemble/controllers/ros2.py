"""Controllers behind ROS 2: ``ros2://HOST`` or ``ros2://HOST:PORT`` of a rosbridge (port 9090).

Motions are goals of ``FollowJointTrajectory``; joint states, the tool and stops are topics
(:data:`TOPICS`). Nothing in a trajectory controller notices that the connection is gone: the arm
then goes on to the end of the motion that was sent, and stands.
"""

from __future__ import annotations

import contextlib
import logging
import re
import threading
from functools import partial
from typing import Any, cast

import numpy as np

from learn2assemble.controllers.common import Address, lost, refused
from learn2assemble.controllers.controller import (
    CONNECT,
    POLL,
    STANDS,
    ControllerState,
    WatchingController,
)
from learn2assemble.errors import extra
from learn2assemble.plants.plant import Commands, Motion, PlantError, Stop, ToolReading
from learn2assemble.plants.setup import Setup

PORT = 9090
ACTION = "/joint_trajectory_controller/follow_joint_trajectory"
TOPICS = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/suction/held": "std_msgs/msg/Bool",
    "/gripper/width": "std_msgs/msg/Float64",
    "/tool/wrench": "geometry_msgs/msg/WrenchStamped",
    "/robot/stopped": "std_msgs/msg/Bool",
    "/robot_description": "std_msgs/msg/String",
}
"""What is listened to; the first one has to come, in the frame of the base where it has one."""
COMMANDS = {
    "/suction/vacuum": "std_msgs/msg/Bool",
    "/gripper/command": "control_msgs/msg/GripperCommand",
    "/tool/load": "std_msgs/msg/Float64",
}
"""What the tool is told, as in the bags of :mod:`learn2assemble.export.ros2`."""
WAIT = 0.5
"""Longest wait for what not every robot says [s]."""
SHORTEST = 0.02
"""In which the arm comes to rest at least where a motion is broken off [s]."""
SUCCEEDED, CANCELED = 4, 5
INVALID = (-1, -2, -3)
"""Error codes of goals that were not taken."""


class RosPlant(WatchingController):
    """An arm behind a rosbridge.

    Args:
        place: host and port of the bridge.
        setup: the cell.

    Raises:
        InputError: for an address that is none.
        MissingExtraError: without the extra ``ros2``.
        PlantError: where nobody answers, and for other joints or another robot.
    """

    def __init__(self, place: str, setup: Setup) -> None:
        super().__init__(Address.read("ros2", place, PORT), setup)
        with extra("roslibpy", "ros2"):
            import roslibpy  # pyright: ignore[reportMissingTypeStubs]
        self._lib: Any = roslibpy
        self._said: dict[str, Any] = {}
        self._known = False
        self._hears = threading.Condition()
        self._goal: Any = ""
        self._result = _Result(0.0)
        # What goes wrong is told in one line, by us; whoever listens to logs hears it as before.
        logging.getLogger("twisted").addHandler(logging.NullHandler())
        self._ros: Any = self._lib.Ros(self.place.host, self.place.port, transport="twisted")
        try:
            self._ros.run(CONNECT)
        except self._lib.core.RosTimeoutError:
            self.close()
            raise lost(f"{self.place.host}:{self.place.port}: no rosbridge answers") from None
        # A connection that comes back by itself would go on with half a motion.
        self._ros.factory.stopTrying()
        self._action: Any = self._lib.ActionClient(
            self._ros, ACTION, "control_msgs/action/FollowJointTrajectory"
        )
        self._heard = [self._lib.Topic(self._ros, name, kind) for name, kind in TOPICS.items()]
        for topic in self._heard:
            topic.subscribe(partial(self._hear, topic.name))
        self._told = {n: self._lib.Topic(self._ros, n, kind) for n, kind in COMMANDS.items()}
        for topic in self._told.values():
            topic.advertise()
        self._check()
        self._known = True

    def _hear(self, name: str, said: dict[str, Any]) -> None:
        with self._hears:
            self._said[name] = said
            self._hears.notify_all()

    def _check(self) -> None:
        """Whether this is the robot of the plan.

        Raises:
            PlantError: where it is not, or says nothing.
        """
        with self._hears:
            known = self._hears.wait_for(lambda: "/joint_states" in self._said, CONNECT)
            # Who has these says them at once; an arm must not begin with a full hand.
            others = {
                "/robot_description",
                "/suction/held" if self.arm.suction else "/gripper/width",
            }
            self._hears.wait_for(lambda: others <= self._said.keys(), WAIT)
        if not known:
            self.close()
            raise lost(f"no /joint_states within {CONNECT:g} s")
        names = self._said["/joint_states"].get("name", [])
        missing = [name for name in self.driver.joints if name not in names]
        told = self._said.get("/robot_description", {}).get("data", "")
        found = re.search(r"<robot[^>]*\bname\s*=\s*[\"']([^\"']*)", told)
        if missing:
            self.close()
            raise refused(f"joints {', '.join(names)}; {', '.join(missing)} is missing")
        if found and self.arm.name not in found[1].lower():
            self.close()
            raise refused(f"the robot is {found[1]!r}, not {self.arm.name!r}")

    # ------------------------------------------------------------ what is sensed

    def _read(self) -> ControllerState:
        now, joints, velocity = self._joints()
        stopped = "the robot is stopped" if self._stopped() else ""
        return ControllerState(now, joints, velocity, self._tool(), stopped)

    def _came(self) -> float:
        return self._joints()[0]

    def _joints(self) -> tuple[float, np.ndarray, np.ndarray]:
        """Time [s], positions and velocities of the joints in the order of the arm."""
        said = self._said["/joint_states"]
        stamp = said["header"]["stamp"]
        row = [said["name"].index(name) for name in self.driver.joints]
        position = np.array(said["position"], float)[row]
        velocity = np.array(said.get("velocity") or np.zeros(len(said["name"])), float)[row]
        now = stamp.get("sec", stamp.get("secs", 0)) + 1e-9 * stamp.get(
            "nanosec", stamp.get("nsecs", 0)
        )
        return now, position, velocity

    def _tool(self) -> ToolReading:
        held, width = self._said.get("/suction/held"), self._said.get("/gripper/width")
        force = self._said.get("/tool/wrench", {}).get("wrench", {}).get("force", {})
        return ToolReading(
            vacuum=None if held is None else bool(held["data"]),
            width=None if width is None else float(width["data"]),
            force=self._force([float(force.get(axis, 0.0)) for axis in "xyz"]),
        )

    def _stopped(self) -> bool:
        return bool(self._said.get("/robot/stopped", {}).get("data", False))

    def _silence(self) -> str:
        """What is wrong with the connection, in words; empty where nothing is."""
        if not self._ros.is_connected:
            return "the rosbridge closed the connection"
        try:
            now = self._joints()[0]
        except (KeyError, ValueError, IndexError, TypeError) as error:
            return f"/joint_states without {error}"
        return self._clock.odd(now, self.clock.now())

    # ------------------------------------------------------------ what is carried out

    def _ended(self) -> tuple[Stop, str] | None:
        result = self._result
        if result.came.is_set():
            return result.stop()
        if not result.begun.is_set() and self._came() - result.sent > self.around.answer:
            if np.abs(self._joints()[2]).max() <= STANDS:
                return Stop.REFUSED, "the controller did not begin with the motion"
            result.begun.set()
        return None

    def _go(self, motion: Motion) -> None:
        """Send a motion as a goal."""
        points = [
            {
                "positions": q.tolist(),
                "velocities": v.tolist(),
                "time_from_start": {"sec": int(t), "nanosec": int(round((t % 1) * 1e9)) % 10**9},
            }
            for t, q, v in zip(motion.time[1:], motion.joints[1:], motion.velocity[1:], strict=True)
        ]
        goal = {"trajectory": {"joint_names": list(self.driver.joints), "points": points}}
        result = self._result = _Result(self._came())
        self._goal = self._action.send_goal(
            self._lib.Goal(goal), result.take, result.begin, result.take
        )

    def _tell(self, commands: Commands) -> None:
        """Tell the tool."""
        for one in commands:
            if one.vacuum is not None:
                self._told["/suction/vacuum"].publish({"data": one.vacuum})
            if one.width is not None:
                said = {"position": one.width, "max_effort": one.force}
                self._told["/gripper/command"].publish(said)
            if one.load is not None:
                self._told["/tool/load"].publish({"data": one.load})

    def stop(self) -> None:
        """The arm stands when this returns, or nobody can be told to stop it: the goal is
        cancelled, and as not every bridge passes that on, a short one takes its place.

        Raises:
            PlantError: where it still moves after :data:`CONNECT`.
        """
        if not self._ros.is_connected or self._stopped():
            return
        if self._goal and not self._result.came.is_set():
            self._action.cancel_goal(self._goal)
        elif np.abs(self._joints()[2]).max() <= STANDS:
            return
        _, q, v = self._joints()
        seconds = max(2 * float((np.abs(v) / self.arm.acceleration).max()), SHORTEST)
        there = np.clip(q + v * seconds / 2, self.arm.lower, self.arm.upper)
        rest = np.zeros_like(q)
        brake = Motion("", np.array([0.0, seconds]), np.stack([q, there]), np.stack([v, rest]))
        self._go(brake)
        until, still = self.clock.now() + CONNECT, 0
        while self.clock.now() < until and self._ros.is_connected:
            still = still + 1 if np.abs(self._joints()[2]).max() <= STANDS else 0
            if still > 3 or self._stopped():
                return
            self._wait(2 * POLL)
        if self._ros.is_connected:
            raise PlantError(Stop.LATE, "the arm does not stop")

    def close(self) -> None:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        if self._known:
            with contextlib.suppress(PlantError):
                self.stop()
        with contextlib.suppress(self._lib.core.RosTimeoutError):
            self._ros.close(1.0)
        # In the thread of the connections: one may just be tried again.
        self._ros.factory.manager.call_later(0, self._ros.factory.stopTrying)


class _Result:
    """What comes of a goal.

    Args:
        sent: when it was sent [s of the controller].
    """

    def __init__(self, sent: float) -> None:
        self.begun, self.came, self.sent = threading.Event(), threading.Event(), sent
        self.said: dict[str, Any] = {}

    def begin(self, _: Any) -> None:
        """Something is told on the way."""
        self.begun.set()

    def take(self, said: Any) -> None:
        """The answer, of whatever kind."""
        data: Any = getattr(said, "data", {})
        self.said = dict(cast("dict[str, Any]", said)) if isinstance(said, dict) else dict(data)
        self.came.set()

    def stop(self) -> tuple[Stop, str]:
        """As the end of a motion."""
        if not self.said:
            return Stop.END, ""
        status = self.said.get("status")
        status = getattr(status, "value", status)
        values: Any = self.said.get("values") or {}
        code, words = 0, ""
        if isinstance(values, dict):
            values = cast("dict[str, Any]", values)
            values = values.get("result", values)
            code, words = int(values.get("error_code", 0)), str(values.get("error_string", ""))
        else:
            words = str(values)
        if status == SUCCEEDED and code == 0:
            return Stop.END, ""
        what = words or f"status {status}, error code {code}"
        if code in INVALID or status not in (SUCCEEDED, CANCELED, 6):
            return Stop.REFUSED, what
        return Stop.PROTECTIVE, what
