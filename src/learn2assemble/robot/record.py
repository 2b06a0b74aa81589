"""What the arm did in a whole build, as plain data: the content of ``trajectory.json``.

One sequence of samples at a fixed rate, cut into steps; a step is one attempt to pick up an object
and to put it down. Cells are numbered as the blocks of the plan, for the whole build. Times count
from the beginning of the build. The fields are described in ``docs/trajectory.md``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.outcome import Outcome

RATE = 50.0
"""Samples per second."""


class Stage(NamedTuple):
    """A part of a step."""

    name: str
    """One of :data:`~.recording.STAGES`."""
    start: float
    """[s]."""
    end: float
    """[s]."""


@dataclass(frozen=True, eq=False)
class ArmFacts:
    """The arm of a record: what a reader of its samples has to know."""

    name: str
    joints: tuple[str, ...]
    lower: np.ndarray
    """float64[n] [rad]."""
    upper: np.ndarray
    """float64[n] [rad]."""
    velocity: np.ndarray
    """float64[n], largest magnitude [rad/s]."""
    acceleration: np.ndarray
    """float64[n], largest magnitude [rad/s^2]."""
    base_position: np.ndarray
    """float64[3] [m, world]."""
    base_yaw: float
    """Turn of the base about z [rad]."""
    tool: str
    """Name of the tool frame."""
    max_width: float
    """Largest opening between the pads [m]."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Joint motion at equal steps of time; T may be 0."""

    time: np.ndarray
    """float64[T] [s]."""
    joints: np.ndarray
    """float64[T, n], commanded positions [rad]."""
    velocity: np.ndarray
    """float64[T, n], commanded velocities [rad/s]."""
    width: np.ndarray
    """float64[T], opening between the pads [m]."""


@dataclass(frozen=True, eq=False)
class StepRecord:
    """One attempt to pick up an object and to put it down."""

    number: int
    """1, 2, ... in the order of execution."""
    plan_step: int | None
    """The step of ``plan.json`` it carries out, also where it failed and was tried again; None
    where the plan has no such step (any more)."""
    cells: tuple[int, ...]
    """Cells of the object, the grasped one first."""
    target: np.ndarray
    """float64[7]: pose the grasped cell shall have."""
    outcome: Outcome
    detail: str
    """Why it failed, in one line; empty for a success."""
    replanned: bool
    """After it the rest of the build was planned anew from where the blocks really were."""
    stages: tuple[Stage, ...]
    grip: float | None
    """When the object follows the hand from [s]; None: never."""
    release: float | None
    """When it does not any more, on purpose or not [s]; None: never held, or still at the end."""
    samples: Samples
    before: np.ndarray
    """float64[C, 7]: poses of all cells before the step: x, y, z [m, world], quaternion
    (w, x, y, z)."""
    after: np.ndarray
    """The same when everything has come to rest."""

    @property
    def seconds(self) -> float:
        """How long the arm takes for it [s]."""
        return float(np.ptp(self.samples.time)) if len(self.samples.time) else 0.0

    @property
    def error(self) -> float:
        """Distance of the grasped cell from where it should stand, at the end [m]."""
        return float(np.linalg.norm(self.after[self.cells[0], :3] - self.target[:3]))

    def stage_at(self, time: float) -> str:
        """The stage at a time [s]; empty outside all of them."""
        for stage in reversed(self.stages):
            if stage.start - 1e-9 <= time <= stage.end + 1e-9:
                return stage.name
        return ""


@dataclass(frozen=True, eq=False)
class BuildRecord:
    """A build by an arm."""

    arm: ArmFacts
    rate: float
    """Samples per second."""
    block_edge: float
    """[m]."""
    objects: tuple[tuple[int, ...], ...]
    """Cells of every rigid object; each cell of the build is in exactly one."""
    simulated_by: str
    """What the outcomes come from, in words."""
    steps: tuple[StepRecord, ...]

    @property
    def num_cells(self) -> int:
        return sum(map(len, self.objects))

    def spans(self) -> list[tuple[float, float]]:
        """Start and end of every step [s]; one without samples takes no time."""
        now, found = 0.0, []
        for step in self.steps:
            start = now
            if len(step.samples.time):
                now = float(step.samples.time[-1])
            found.append((start, now))
        return found

    def joined(self) -> tuple[Samples, np.ndarray]:
        """All samples in a row, and int64[T], the number of the step of each."""
        width = len(self.arm.joints)
        none = Samples(np.empty(0), np.empty((0, width)), np.empty((0, width)), np.empty(0))
        parts = [none, *(step.samples for step in self.steps)]
        numbers = [np.full(len(step.samples.time), step.number) for step in self.steps]
        return Samples(
            np.concatenate([part.time for part in parts]),
            np.concatenate([part.joints for part in parts]),
            np.concatenate([part.velocity for part in parts]),
            np.concatenate([part.width for part in parts]),
        ), np.concatenate([np.empty(0, np.int64), *numbers])


def arm_facts(arm: Arm) -> ArmFacts:
    """What a record says about an arm."""
    return ArmFacts(
        arm.name, arm.joints, arm.lower, arm.upper, arm.velocity, arm.acceleration,
        arm.base_position, arm.base_yaw, arm.tool, arm.gripper.max_width,
    )  # fmt: skip
