"""Franka arms: ``franka://HOST``, through ``franky-control``.

No robot was at hand: the sequence of calls was tested with a stand-in of the library, and nothing
else. Motions are waypoints with velocities and least times; the library finds how to get from one
to the next within its own limits, so the arm may be slower than asked. It needs a kernel of real
time on the machine that runs this.
"""

# pyright: reportMissingImports=false
from __future__ import annotations

from typing import Any

import numpy as np

from learn2assemble.controllers.common import Address, lost
from learn2assemble.controllers.controller import ControllerState, WatchingController
from learn2assemble.errors import InputError, extra
from learn2assemble.plants.plant import Commands, Motion, PlantError, Stop, ToolReading
from learn2assemble.plants.setup import Setup

EPSILON = 0.005
"""What the fingers close on may be so much wider or narrower than told [m]."""
MAY_MOVE = ("Idle", "Move")
"""Modes of a robot that is not stopped."""


class FrankaPlant(WatchingController):
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
        super().__init__(Address.read("franka", place, 0), setup)
        if setup.arm.name != "panda" or setup.arm.suction is not None:
            got = f"the arm {setup.arm.name} with the tool {setup.arm.tool_name}"
            raise InputError("robot", got, "the arm panda with its gripper")
        with extra("franky-control", "franka"):
            import franky
        self._lib: Any = franky
        try:
            self._robot: Any = self._lib.Robot(self.place.host)
            self._gripper: Any = self._lib.Gripper(self.place.host)
        except Exception as error:  # noqa: BLE001  the library has classes of its own for each case
            raise lost(_line(error)) from None

    # ------------------------------------------------------------ what is sensed

    def _read(self) -> ControllerState:
        state, mode = self._state(), ""
        if state.robot_mode.name not in MAY_MOVE:
            mode = f"the robot is in the mode {state.robot_mode.name}"
        q, v = np.array(state.q, float).ravel(), np.array(state.dq, float).ravel()
        return ControllerState(float(state.time.to_sec()), q, v, self._tool(state), mode)

    def _came(self) -> float:
        return float(self._state().time.to_sec())

    def _state(self) -> Any:
        try:
            return self._robot.state
        except Exception as error:  # noqa: BLE001
            raise lost(_line(error)) from None

    def _tool(self, state: Any) -> ToolReading:
        gripper = self._gripper.state
        force = self._force(np.array(state.O_F_ext_hat_K, float).ravel()[:3].tolist())
        grip = self.arm.gripper.force if gripper.is_grasped else 0.0
        return ToolReading(width=float(gripper.width), grip=grip, force=force)

    # ------------------------------------------------------------ what is carried out

    def _go(self, motion: Motion) -> None:
        try:
            self._robot.move(self._waypoints(motion), asynchronous=True)
        except Exception as error:  # noqa: BLE001
            raise PlantError(Stop.PROTECTIVE, _line(error)) from None

    def _ended(self) -> tuple[Stop, str] | None:
        try:
            # This raises what went wrong in the motion.
            return None if self._robot.poll_motion() else (Stop.END, "")
        except Exception as error:  # noqa: BLE001
            return Stop.PROTECTIVE, _line(error)

    def _waypoints(self, motion: Motion) -> Any:
        lib, points = self._lib, list[Any]()
        for k, step in enumerate(np.diff(motion.time), 1):
            state = lib.JointState(motion.joints[k], motion.velocity[k])
            least = lib.Duration(round(1e3 * float(step)))
            points.append(lib.JointWaypoint(state, minimum_time=least))
        return lib.JointWaypointMotion(points)

    def _tell(self, commands: Commands) -> None:
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

    def stop(self) -> None:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        try:
            self._robot.stop()
        except Exception as error:  # noqa: BLE001
            raise lost(_line(error)) from None

    def close(self) -> None:
        """See :class:`~learn2assemble.plants.plant.Plant`; the library ends its connections when
        nobody holds them any more."""
        self.stop()


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
