"""Franka arms: ``franka://HOST``, through ``franky-control``.

No robot was at hand: the sequence of calls was tested with a stand-in of the library, and nothing
else. Motions are waypoints with velocities and least times; the library finds how to get from one
to the next within its own limits, so the arm may be slower than asked. It needs a kernel of real
time on the machine that runs this.
"""

# pyright: reportMissingImports=false
from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from learn2assemble.controllers.common import Address, WatchedHere, felt, lost, marks_of, not_begun
from learn2assemble.errors import InputError, extra
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.motion.cubics import thinned
from learn2assemble.motion.plant import (
    Guard,
    Motion,
    PlantError,
    Readings,
    Report,
    Request,
    Stop,
    ToolCommand,
    ToolReading,
)
from learn2assemble.motion.program import driver_of
from learn2assemble.motion.setup import Setup

POLL = 0.004
"""Between two looks at the state [s]."""
LATE, SLACK = 1.5, 2.0
"""A motion that takes longer than its time by this factor, and so much more [s], is late."""
STANDS = 0.005
"""Slower joints stand [rad/s]."""
EPSILON = 0.005
"""What the fingers close on may be so much wider or narrower than told [m]."""
MAY_MOVE = ("Idle", "Move")
"""Modes of a robot that is not stopped."""


class FrankaPlant:
    """An arm of Franka with its own gripper.

    Args:
        place: host of the robot.
        setup: the cell.

    Raises:
        InputError: for an address that is none, another arm, and another tool.
        MissingExtraError: without the extra ``franka``.
        PlantError: where nobody answers.
    """

    def __init__(self, place: str, setup: Setup) -> None:
        self.place, self.arm, self.around = (
            Address.read("franka", place, 0),
            setup.arm,
            setup.around,
        )
        if setup.arm.name != "panda" or setup.arm.suction is not None:
            got = f"the arm {setup.arm.name} with the tool {setup.arm.tool_name}"
            raise InputError("robot", got, "the arm panda with its gripper")
        with extra("franky-control", "franka"):
            import franky
        self._lib: Any = franky
        self.driver = driver_of(setup.arm)
        self._base = quaternion_matrix(self.driver.base[3:])
        try:
            self._robot: Any = franky.Robot(self.place.host)
            self._gripper: Any = franky.Gripper(self.place.host)
        except Exception as error:  # noqa: BLE001  the library has classes of its own for each case
            raise lost(_line(error)) from None

    # ------------------------------------------------------------ what is sensed

    def sense(self) -> Readings:
        """See :class:`~learn2assemble.motion.plant.Plant`."""
        state = self._state()
        q, v = np.array(state.q, float).ravel(), np.array(state.dq, float).ravel()
        moving = float(np.abs(v).max()) > STANDS
        mode = "stopped" if self._stopped(state) else "moving" if moving else "ready"
        look = self.around.look
        blocks = () if look is None else tuple(look())
        now = float(state.time.to_sec())
        return Readings(now, q, v, blocks, self._tool(state), self.arm.name, mode)

    def _state(self) -> Any:
        try:
            return self._robot.state
        except Exception as error:  # noqa: BLE001
            raise lost(_line(error)) from None

    def _tool(self, state: Any) -> ToolReading:
        gripper = self._gripper.state
        force = self._base @ np.array(state.O_F_ext_hat_K, float).ravel()[:3]
        x, y, z = force.tolist()
        grip = self.arm.gripper.force if gripper.is_grasped else 0.0
        return ToolReading(width=float(gripper.width), grip=grip, force=(x, y, z))

    def _stopped(self, state: Any) -> bool:
        return state.robot_mode.name not in MAY_MOVE

    # ------------------------------------------------------------ what is carried out

    def execute(
        self,
        motion: Motion,
        commands: Sequence[ToolCommand] = (),
        guards: Sequence[Guard] = (),
    ) -> Report:
        """See :class:`~learn2assemble.motion.plant.Plant`."""
        now = self.sense()
        amiss = not_begun(now, motion, self.around.program.start_tolerance)
        if amiss is not None:
            return self._report(amiss[0], motion, 0.0, now.time, amiss[1])
        left = sorted(commands, key=lambda one: one.at)
        moves = bool(motion.seconds) and float(np.ptp(motion.joints, axis=0).max()) > 0
        try:
            if moves:
                thin = thinned(motion, marks_of(motion, commands, guards))
                self._robot.move(self._waypoints(thin), asynchronous=True)
            stop, why = self._watch(
                motion, left, WatchedHere(felt(guards, self.around.feel)), now.time, moves
            )
            if stop is Stop.END:
                self._tell(left)
            elif moves:
                self.stop()
        except PlantError as error:
            stop, why = error.stop, error.why
        except Exception as error:  # noqa: BLE001
            stop, why = Stop.PROTECTIVE, _line(error)
        past = self.sense().time - now.time if stop is not Stop.LOST else 0.0
        share = 1.0 if stop is Stop.END else min(max(past / max(motion.seconds, 1e-9), 0.0), 1.0)
        return self._report(stop, motion, share, now.time, why)

    def _waypoints(self, motion: Motion) -> Any:
        lib, points = self._lib, []
        for k, step in enumerate(np.diff(motion.time), 1):
            state = lib.JointState(motion.joints[k], motion.velocity[k])
            least = lib.Duration(round(1e3 * float(step)))
            points.append(lib.JointWaypoint(state, minimum_time=least))
        return lib.JointWaypointMotion(points)

    def _watch(
        self,
        motion: Motion,
        left: list[ToolCommand],
        watched: WatchedHere,
        begun: float,
        moves: bool,
    ) -> tuple[Stop, str]:
        """Tell the tool what is due, until the motion has ended or something ends it."""
        while True:
            state = self._state()
            if self._stopped(state):
                return Stop.PROTECTIVE, f"the robot is in the mode {state.robot_mode.name}"
            past = float(state.time.to_sec()) - begun
            due = [one for one in left if one.at <= min(past, motion.seconds) + 1e-6]
            self._tell(due)
            del left[: len(due)]
            found = watched.broken(past, self._tool(state))
            if found is not None:
                return found
            # This raises what went wrong in the motion.
            over = not self._robot.poll_motion() if moves else past >= motion.seconds
            if over:
                return Stop.END, ""
            if past > LATE * motion.seconds + SLACK:
                return Stop.LATE, f"not there after {past:.1f} s"
            time.sleep(POLL)

    def _tell(self, commands: Sequence[ToolCommand]) -> None:
        """Tell the gripper, and the robot what it carries."""
        for one in commands:
            speed = one.speed or self.arm.gripper.speed
            if one.width is not None and one.force > 0:
                self._gripper.grasp_async(one.width, speed, one.force, EPSILON, EPSILON)
            elif one.width is not None:
                self._gripper.move_async(one.width, speed)
            if one.load is not None:
                centre = (self.driver.tcp[:3]).tolist()
                self._robot.set_load(one.load, centre, [0.0] * 9)

    def _report(
        self, stop: Stop, motion: Motion, done: float, begun: float, why: str = ""
    ) -> Report:
        if stop is Stop.LOST:
            joints = motion.joints[0] if len(motion.joints) else self.arm.home
            return Report(stop, done, joints.copy(), 0.0, why)
        now = self.sense()
        joints = now.joints
        if stop is Stop.END and len(motion.joints):
            joints = motion.joints[-1].copy()
        return Report(stop, done, joints, max(now.time - begun, 0.0), why, now.tool)

    def request(self, request: Request) -> Report:
        """See :class:`~learn2assemble.motion.plant.Plant`."""
        begun = self.sense().time
        if self.around.serve is not None:
            self.around.serve(request)
        return self._report(Stop.END, Motion(request.what, *[np.zeros(0)] * 3), 1.0, begun)

    def stop(self) -> None:
        """See :class:`~learn2assemble.motion.plant.Plant`."""
        try:
            self._robot.stop()
        except Exception as error:  # noqa: BLE001
            raise lost(_line(error)) from None

    def close(self) -> None:
        """See :class:`~learn2assemble.motion.plant.Plant`; the library ends its connections when
        nobody holds them any more."""
        self.stop()


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
