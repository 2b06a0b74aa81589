"""One of two arms is stopped in the middle of a build, at a moment drawn from its first seconds.

Measured is whether the other one is safe, and whether the build, gone on with from its file, is
complete.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from l2a_lab.arm_distances import WatchedCell
from l2a_lab.measured import Result
from learn2assemble.cell.workcell import Workcell
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.reports import ArmFailure
from learn2assemble.plants.plant import PlantError, Stop
from learn2assemble.plants.setup import Setup
from learn2assemble.robot.moves import Outcome
from learn2assemble.team.crew import Member
from learn2assemble.team.in_turn import build_by_two

RESTS = 1e-2
"""What is slower stands [rad/s]."""
APART = 0.01
"""What the arms shall keep from each other [m]."""


class Pressed(NamedTuple):
    """A stop of one arm."""

    arm: int
    """Which."""
    at: float
    """When [s since the build began]."""


class StoppedCell(WatchedCell):
    """A cell in which somebody presses the button of one arm, once.

    Args:
        setup: of the cell.
        pressed: which and when; None: nobody does.
    """

    def __init__(self, setup: Setup, pressed: Pressed | None = None) -> None:
        super().__init__(setup)
        self.stage = ""
        """Of what the arm did then."""
        if pressed is None:
            return
        sim = self.plants[pressed.arm].bench.sim
        step = sim.step

        def stopped() -> None:
            if not self.stage and sim.time >= pressed.at:
                self.stage = sim.stage
                raise PlantError(Stop.PROTECTIVE, "somebody has pressed the button")
            step()

        sim.step = stopped


class Job(NamedTuple):
    """What is built."""

    plan: Plan
    members: list[Member]
    workcell: Workcell
    joint: float
    """Width of a vertical joint [m]."""


def stopped(job: Job, pressed: Pressed) -> Result:
    """A build that is stopped, and gone on with from its file."""
    with tempfile.TemporaryDirectory() as folder:
        workcell = replace(job.workcell, log=Path(folder) / "build.jsonl")
        first, cell = _built(job, workcell, pressed)
        least = cell.least().distance
        resting = [float(np.abs(one.sense().velocity).max()) < RESTS for one in cell.plants]
        other = first.arms[1 - pressed.arm].did
        failures = () if other is None else other.failures
        # To put a block back that comes after the one that is lost is no harm.
        failed = [one.detail for one in failures if not _gave_up(one)]
        told: Result = {
            "arm": first.arms[pressed.arm].name,
            "at_s": round(pressed.at, 2),
            "stage": cell.stage,
            "steps_done": len(first.steps),
            "least_distance": round(least, 5),
            "other_failed": failed,
            "other_rests": resting[1 - pressed.arm],
            "other_safe": bool(least >= APART and resting[1 - pressed.arm] and not failed),
        }
        again, cell = _built(job, workcell, None)
        worst = [arm.did.error_worst for arm in again.arms if arm.did is not None]
        return told | {
            "status": again.status,
            "reason": again.reason,
            "resumed_least_distance": round(cell.least().distance, 5),
            "error_worst": max((one for one in worst if one is not None), default=None),
        }


def _gave_up(failure: ArmFailure) -> bool:
    """Whether an attempt was given up without harm: its block is back where it came from."""
    back = ("put back", "the arm is home")
    return failure.outcome == Outcome.UNREACHABLE.label and failure.detail.endswith(back)


def _built(job: Job, workcell: Workcell, pressed: Pressed | None) -> tuple[Plan, StoppedCell]:
    cells: list[StoppedCell] = []

    def opened(setup: Any) -> StoppedCell:
        cells.append(StoppedCell(setup, pressed))
        return cells[-1]

    done = build_by_two(job.plan, job.members, workcell, joint=job.joint, opened=opened)
    return done, cells[0]


def drawn(count: int, seconds: float, seed: int = 0) -> list[Pressed]:
    """So many stops of either arm, somewhere in a build that takes ``seconds``."""
    rng = np.random.default_rng(seed)
    return [Pressed(int(rng.integers(2)), float(rng.uniform(0, seconds))) for _ in range(count)]
