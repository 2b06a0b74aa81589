"""The cell in motion: the arm follows joint paths, and every contact is watched."""

# The compiled module has no stubs that pyright finds.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.cellstate import CellState
from learn2assemble.robot.contacts import Contacts, Event, Rules, Watch
from learn2assemble.robot.diverged import diverged
from learn2assemble.robot.drives import Drives
from learn2assemble.robot.mjcf import TIMESTEP, World
from learn2assemble.robot.recording import Recorder
from learn2assemble.robot.trajectory import (
    JointPath,
    Leg,
    Limits,
    Motion,
    Pace,
    motion,
    pace_of,
    stop,
)

SLIP = 0.01
"""What is held has been lost when it has moved so far in the hand [m]."""
BLOCK = 10
"""Steps whose commands are computed at once; also between two looks at what need not be seen
at once."""


class Simulation(CellState):
    """One attempt in the making.

    Args:
        arm: the robot.
        world: model of the cell.
        poses: float64[b, 7] of the objects: position [m] and quaternion (w, x, y, z).
        names: what to call them in messages.
        target: number of the object to be moved.
        joints: float64[n] the arm begins with [rad].
        width: opening the gripper begins with [m].
        sample_steps: steps between samples of the recording.
        dump: folder for model and state should the simulation diverge; a new one by default.
    """

    def __init__(
        self,
        arm: Arm,
        world: World,
        poses: np.ndarray,
        names: list[str],
        target: int,
        joints: np.ndarray,
        width: float,
        sample_steps: int,
        dump: Path | None = None,
    ) -> None:
        super().__init__(world, poses, target, joints, width)
        self.arm, self.dump = arm, dump
        self.limits = Limits(arm.velocity, arm.acceleration, arm.jerk)
        """What brakes may use."""
        self.drives = Drives(arm, world, self.data)
        self.contacts = Contacts(world, self.data, names, target)
        self.stage, self.steps, self.sample_steps = "approach", 0, sample_steps
        self.recorder = Recorder()
        self.joints, self.velocity, self.width = joints.copy(), np.zeros_like(joints), width
        self._grip: np.ndarray | None = None
        self._record()

    @property
    def time(self) -> float:
        """Since the beginning [s]."""
        return self.steps * TIMESTEP

    # ------------------------------------------------------------ motion

    def follow(
        self,
        path: JointPath,
        pace: Pace,
        stage: str,
        watches: tuple[Watch, ...],
        legs: tuple[Leg, ...] = (),
    ) -> Event | None:
        """Move along a path; brakes at a collision, a loss, or where a watch says so.

        Returns:
            None where the end was reached.
        """
        self.stage = stage
        run = motion(path, pace, TIMESTEP, legs)
        begins = np.searchsorted(run.progress[:, 0], [w.start for w in watches]).tolist()
        for watch, begin, end in zip(
            watches, begins, [*begins[1:], len(run.progress)], strict=True
        ):
            event, k = self._play(run, begin, end, watch)
            if event is not None:
                s, rate, change = run.progress[k]
                brake = pace_of(path, self.limits)
                rest = stop(path, brake, TIMESTEP, (s, rate, change))
                self._play(rest, 0, len(rest.progress), Watch(Rules(None)))
                return event
        return None

    def run(
        self,
        run: Motion,
        widths: np.ndarray,
        stage: str,
        watch: Watch,
        payloads: np.ndarray | None = None,
    ) -> Event | None:
        """Follow samples one step apart, with openings of the gripper float64[k] [m] and, if
        given, payloads float64[k] [kg]."""
        self.stage = stage
        return self._play(run, 0, len(widths), watch, widths, payloads)[0]

    def squeeze(
        self, widths: np.ndarray, stage: str, watch: Watch, payloads: np.ndarray | None = None
    ) -> Event | None:
        """Stand still while the gripper is told one opening [m] (and payload [kg]) after the
        other, a step each."""
        still = np.zeros((2, len(widths), len(self.joints)))
        there = np.tile(self.joints, (len(widths), 1))
        run = Motion(np.zeros((len(widths), 3)), there, *still)
        return self.run(run, widths, stage, watch, payloads)

    def load(self, payload: float, steps: int, stage: str, watch: Watch) -> Event | None:
        """Tell the controller of another payload [kg], little by little in a number of steps."""
        change = np.linspace(self.drives.payload, payload, steps + 1)[1:]
        return self.squeeze(np.full(steps, self.width), stage, watch, change)

    def wait(self, steps: int, stage: str, watch: Watch) -> Event | None:
        """Stand still for a number of steps, or until the watch ends it."""
        return self.squeeze(np.full(steps, self.width), stage, watch)

    def skip(self, path: JointPath, pace: Pace, stage: str) -> None:
        """Let the time of a motion pass for the arm alone: the objects rest and it meets none."""
        self.stage = stage
        run = motion(path, pace, TIMESTEP)
        for position, velocity in zip(run.position, run.velocity, strict=True):
            self._count(position, velocity)
        self.put_arm(path.joints[-1])

    def hold(self) -> None:
        """From now on the target must stay where it is in the hand."""
        self._grip = self.in_hand()

    def let_go(self) -> None:
        """The target may leave the hand."""
        self._grip = None

    def _play(
        self,
        run: Motion,
        begin: int,
        end: int,
        watch: Watch,
        widths: np.ndarray | None = None,
        payloads: np.ndarray | None = None,
    ) -> tuple[Event | None, int]:
        """Samples begin..end of a motion; what broke it off, and at which sample."""
        thresholds = watch.rules.thresholds()
        for first in range(begin, end, BLOCK):
            part = slice(first, min(first + BLOCK, end))
            if payloads is not None:
                self.drives.payload = float(payloads[part][-1])
            rows = self.drives.commands(
                run.position[part], run.velocity[part], run.acceleration[part],
                np.array(self.width) if widths is None else widths[part],
            )  # fmt: skip
            for k, row in enumerate(rows, first):
                self.data.ctrl[:] = row
                mujoco.mj_step(self.model, self.data)
                if widths is not None:
                    self.width = float(widths[k])
                self._count(run.position[k], run.velocity[k])
                event = self._look(thresholds, watch.until)
                if event is not None:
                    return event, k
        return None, end

    def _look(self, thresholds: np.ndarray, until: Callable[[], bool] | None) -> Event | None:
        if self.data.ncon:
            hit = self.contacts.collision(thresholds)
            if hit is not None:
                return Event("touch", hit)
        if self._grip is not None and self.steps % BLOCK == 0:
            moved = np.linalg.norm(self.in_hand() - self._grip)
            if moved > SLIP:
                name = self.contacts.names[self.target]
                return Event("lost", f"{name} moved by {1e3 * moved:.0f} mm in the hand")
        return Event("until") if until is not None and until() else None

    # ------------------------------------------------------------ bookkeeping

    def _count(self, position: np.ndarray, velocity: np.ndarray) -> None:
        """A step is done."""
        self.joints, self.velocity = position, velocity
        self.steps += 1
        if self.steps % BLOCK == 0:
            self._guard()
        if self.steps % self.sample_steps == 0:
            self._record()

    def _record(self) -> None:
        self.recorder.add(
            self.time,
            self.joints,
            self.velocity,
            self.opening,
            self.width,
            self.drives.payload,
            self.stage,
            self.poses,
        )

    def _guard(self) -> None:
        """Stops a simulation that diverged, with everything needed to look into it."""
        d = self.data
        if not (np.isfinite(d.qpos).all() and np.isfinite(d.qvel).all()):
            began = self.recorder.first_poses()
            raise diverged(self.world, d, self.time, self.dump, began=began, stage=self.stage)
