"""What plants behind controllers do in the same way, whatever the make of the robot."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from learn2assemble.controllers.common import (
    Address,
    ControllerClock,
    WatchedHere,
    felt,
    lost,
    marks_of,
    not_begun,
    thinned,
)
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.motion.driver import Driver, driver_of
from learn2assemble.plants.plant import (
    BlockReading,
    Commands,
    Guards,
    Motion,
    PlantError,
    Readings,
    Report,
    Request,
    Stop,
    ToolCommand,
    ToolReading,
)
from learn2assemble.plants.setup import PlantClock, Setup, Surroundings
from learn2assemble.values import three

if TYPE_CHECKING:
    from learn2assemble.plants.settings import ProgramSettings
    from learn2assemble.robot.arm import Arm

CONNECT = 3.0
"""Longest wait for an answer while connecting, and for an arm that is to stop [s]."""
POLL = 0.004
"""Between two looks at the state [s]."""
LATE, SLACK = 1.5, 2.0
"""A motion that takes longer than its time by this factor, and so much more [s], is late."""
STANDS = 0.005
"""Slower joints stand [rad/s]."""


class ControllerState(NamedTuple):
    """What a controller says at one moment."""

    time: float
    """[s of its clock]"""
    joints: np.ndarray
    """float64[n] in the order of the arm [rad]."""
    velocity: np.ndarray
    """float64[n] [rad/s]."""
    tool: ToolReading
    stopped: str = ""
    """Why it does not let the arm move, in words; empty where it does."""
    playing: bool = False
    """It carries something out, though the arm may stand."""

    @property
    def moving(self) -> bool:
        """Whether the arm does not stand."""
        return self.playing or float(np.abs(self.velocity).max()) > STANDS


class Controller(ABC):
    """Base of a plant behind a controller: what is sensed and reported.

    Args:
        address: where it is.
        setup: the cell.
    """

    def __init__(self, address: Address, setup: Setup) -> None:
        self.place = address
        self.arm: Arm = setup.arm
        self.around: Surroundings = setup.around
        self.settings: ProgramSettings = self.around.program
        self.driver: Driver = driver_of(setup.arm)
        self.clock: PlantClock = self.around.clock
        self._clock = ControllerClock(self.around.silence)
        self._base = quaternion_matrix(self.driver.base[3:])
        self._last: ControllerState | None = None

    @abstractmethod
    def _read(self) -> ControllerState:
        """What the controller said last.

        Raises:
            PlantError: where it cannot be asked.
        """

    def _silence(self) -> str:
        """What is wrong with the connection, in words; empty where nothing is."""
        return ""

    @abstractmethod
    def stop(self) -> None:
        """See :class:`~learn2assemble.plants.plant.Plant`."""

    @abstractmethod
    def _came(self) -> float:
        """Of when the last state is that has come [s of the controller]."""

    def _wait(self, seconds: float = POLL) -> None:
        """Let time pass."""
        self.clock.wait(seconds, self._came)

    def _now(self) -> ControllerState:
        """What the controller says now.

        Raises:
            PlantError: where the connection is lost.
        """
        why = self._silence()
        if why:
            raise lost(why)
        self._last = self._read()
        return self._last

    def _force(self, force: Sequence[float]) -> tuple[float, float, float]:
        """A force [N] of the frame of the base in that of the world."""
        return three((self._base @ np.asarray(force, float)).tolist())

    def sense(self) -> Readings:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        look = self.around.look
        blocks = () if look is None else tuple(look())
        now, until = self._now(), self.clock.now() + self.around.silence
        # What was just seen may be newer than the last state that has come.
        while any(one.time > now.time for one in blocks) and self.clock.now() < until:
            self._wait()
            now = self._now()
        return self._readings(now, blocks)

    def latest(self) -> Readings | None:
        """What was sensed last, without blocks; None: nothing was. Any thread may ask, also while
        the arm moves."""
        return None if self._last is None else self._readings(self._last)

    def _readings(self, now: ControllerState, blocks: tuple[BlockReading, ...] = ()) -> Readings:
        state = "stopped" if now.stopped else "moving" if now.moving else "ready"
        return Readings(now.time, now.joints, now.velocity, blocks, now.tool, self.arm.name, state)

    def request(self, request: Request) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        begun = self.sense().time
        if self.around.serve is not None:
            self.around.serve(request)
        return self._report(Stop.END, Motion(request.what, *[np.zeros(0)] * 3), 1.0, begun)

    def rate(self) -> float | None:
        """States a second that were seen."""
        return self._clock.rate()

    def _begin(self, motion: Motion) -> tuple[float, Report | None]:
        """The time at which a motion begins [s of the controller]; a report where it may not."""
        now = self.sense()
        stopped = self._last.stopped if self._last else ""
        amiss = not_begun(now, motion, self.settings.start_tolerance, stopped)
        if amiss is None:
            return now.time, None
        return now.time, self._report(amiss[0], motion, 0.0, now.time, amiss[1])

    def _report(
        self, stop: Stop, motion: Motion, past: float, begun: float, why: str = ""
    ) -> Report:
        """What came of a motion.

        Args:
            past: so much of it was carried out [s].
            begun: when [s of the controller].
        """
        with contextlib.suppress(PlantError):
            self._last = self._read()
        if self._last is None:
            return Report(stop, 0.0, self.arm.home.copy(), 0.0, why)
        joints = self._last.joints
        if stop is Stop.END and len(motion.joints):
            joints = motion.joints[-1].copy()
        done = min(max(past / max(motion.seconds, 1e-9), 0.0), 1.0)
        done = 1.0 if stop is Stop.END else done
        seconds = max(self._last.time - begun, 0.0)
        return Report(stop, done, joints, seconds, why, self._last.tool)


class WatchingController(Controller):
    """Base of those whose guards and tool commands are looked after from here, as the controller
    does not do it itself."""

    @abstractmethod
    def _go(self, motion: Motion) -> None:
        """Send a motion, and do not wait for its end."""

    @abstractmethod
    def _ended(self) -> tuple[Stop, str] | None:
        """How the motion that was sent last ended; None: it goes on."""

    @abstractmethod
    def _tell(self, commands: Commands) -> None:
        """Tell the tool."""

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        """See :class:`~learn2assemble.plants.plant.Plant`."""
        begun, odd = self._begin(motion)
        if odd is not None:
            return odd
        moves = bool(motion.seconds) and float(np.ptp(motion.joints, axis=0).max()) > 0
        left = sorted(commands, key=lambda one: one.at)
        past = 0.0
        try:
            if moves:
                self._go(thinned(motion, marks_of(motion, commands, guards)))
            stop, why, past = self._watch(motion, left, guards, moves)
            if stop is Stop.END:
                self._tell(left)
            elif moves:
                self.stop()
        except (PlantError, OSError) as error:
            stop = error.stop if isinstance(error, PlantError) else Stop.LOST
            why = error.why if isinstance(error, PlantError) else str(error)
            # Whoever lost sight of the arm stops it, where it can still be told.
            with contextlib.suppress(PlantError, OSError):
                self.stop()
        return self._report(stop, motion, past, begun, why)

    def _watch(
        self, motion: Motion, left: list[ToolCommand], guards: Guards, moves: bool
    ) -> tuple[Stop, str, float]:
        """Tell the tool what is due, until the motion has ended or something ends it.

        Returns:
            Why it ended, in words, and after how long [s of the controller].
        """
        watched, begun = WatchedHere(felt(guards, self.around.feel)), self._read().time
        while True:
            now = self._now()
            past = now.time - begun
            if now.stopped:
                return Stop.PROTECTIVE, now.stopped, past
            due = [one for one in left if one.at <= min(past, motion.seconds) + 1e-6]
            self._tell(due)
            del left[: len(due)]
            found = watched.broken(past, now.tool)
            if found is None and moves:
                found = self._ended()
            elif found is None and past >= motion.seconds:
                found = Stop.END, ""
            if found is None and past > LATE * motion.seconds + SLACK:
                found = Stop.LATE, f"not there after {past:.1f} s"
            if found is not None:
                return found[0], found[1], past
            self._wait()
