"""The cell in motion: the arm follows joint paths, and every contact is watched."""

# The compiled module has no stubs that pyright finds.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.contacts import Contacts, Rules
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


class Watch(NamedTuple):
    """What is looked for from some point of a path on."""

    rules: Rules
    start: float = 0.0
    """s from which this holds."""
    until: Callable[[], bool] | None = None
    """Brake as soon as this is so."""


class Event(NamedTuple):
    """Why a motion was broken off."""

    what: str
    """``touch``, ``lost`` or ``until``."""
    detail: str = ""


class Simulation:
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
        self.arm, self.world, self.dump, self.target = arm, world, dump, target
        self.model, self.data = world.model, mujoco.MjData(world.model)
        self.limits = Limits(arm.velocity, arm.acceleration, arm.jerk)
        """What brakes may use."""
        self.drives = Drives(arm, world, self.data)
        self.contacts = Contacts(world, self.data, names, target)
        self.stage, self.steps, self.sample_steps = "approach", 0, sample_steps
        self.recorder = Recorder()
        self.poses = self.data.qpos[world.pose :].reshape(-1, 7)
        self.poses[:] = poses
        self.joints, self.velocity = joints.copy(), np.zeros_like(joints)
        self.width = width
        self.data.qpos[world.finger] = width / len(world.finger)
        self.jump(joints)
        self._grip: np.ndarray | None = None
        self._record()

    # ------------------------------------------------------------ what is known

    @property
    def time(self) -> float:
        """Since the beginning [s]."""
        return self.steps * TIMESTEP

    @property
    def opening(self) -> float:
        """Between the pads [m]."""
        return float(self.data.qpos[self.world.finger].sum())

    def tool(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the tool float64[3] [m] and float64[3, 3], of the same instant as the objects
        (a step leaves its own one behind)."""
        mujoco.mj_kinematics(self.model, self.data)
        d, tool = self.data, self.world.tool
        return d.site_xpos[tool].copy(), d.site_xmat[tool].reshape(3, 3).copy()

    def in_hand(self) -> np.ndarray:
        """float64[3]: the target object in the tool frame [m]."""
        position, rotation = self.tool()
        return rotation.T @ (self.poses[self.target, :3] - position)

    def asleep(self, besides: bool = False) -> bool:
        """Whether every object rests, or every one but the target."""
        rest = self.data.tree_asleep[self.world.tree :] >= 0
        return bool(rest.all() or (besides and np.delete(rest, self.target).all()))

    def speed(self, number: int) -> float:
        """Of an object [m/s]."""
        first = self.model.nv - 6 * (len(self.poses) - number)
        return float(np.linalg.norm(self.data.qvel[first : first + 3]))

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

    def run(self, run: Motion, widths: np.ndarray, stage: str, watch: Watch) -> Event | None:
        """Follow samples one step apart, the gripper openings float64[k] [m]."""
        self.stage = stage
        return self._play(run, 0, len(widths), watch, widths)[0]

    def squeeze(self, widths: np.ndarray, stage: str, watch: Watch) -> Event | None:
        """Stand still while the gripper is told one opening [m] after the other, a step each."""
        still = np.zeros((2, len(widths), len(self.joints)))
        there = np.tile(self.joints, (len(widths), 1))
        return self.run(Motion(np.zeros((len(widths), 3)), there, *still), widths, stage, watch)

    def wait(self, steps: int, stage: str, watch: Watch) -> Event | None:
        """Stand still for a number of steps, or until the watch ends it."""
        return self.squeeze(np.full(steps, self.width), stage, watch)

    def jump(self, joints: np.ndarray) -> None:
        """Put the arm somewhere, at rest."""
        d, joint = self.data, self.world.joint
        d.qpos[joint], d.qvel[joint] = joints, 0.0
        self.joints, self.velocity = joints.copy(), np.zeros_like(joints)
        mujoco.mj_forward(self.model, d)

    def skip(self, path: JointPath, pace: Pace, stage: str) -> None:
        """Let the time of a motion pass for the arm alone: the objects rest and it meets none."""
        self.stage = stage
        run = motion(path, pace, TIMESTEP)
        for position, velocity in zip(run.position, run.velocity, strict=True):
            self._count(position, velocity)
        self.jump(path.joints[-1])

    def hold(self) -> None:
        """From now on the target must stay where it is in the hand."""
        self._grip = self.in_hand()

    def let_go(self) -> None:
        """The target may leave the hand."""
        self._grip = None

    def _play(
        self, run: Motion, begin: int, end: int, watch: Watch, widths: np.ndarray | None = None
    ) -> tuple[Event | None, int]:
        """Samples begin..end of a motion; what broke it off, and at which sample."""
        thresholds = watch.rules.thresholds()
        for first in range(begin, end, BLOCK):
            part = slice(first, min(first + BLOCK, end))
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
            self.time, self.joints, self.velocity, self.opening, self.width, self.stage, self.poses
        )

    def _guard(self) -> None:
        """Stops a simulation that diverged, with everything needed to look into it."""
        d = self.data
        if not (np.isfinite(d.qpos).all() and np.isfinite(d.qvel).all()):
            began = self.recorder.first_poses()
            raise diverged(self.world, d, self.time, self.dump, began=began, stage=self.stage)
