"""The main job with an arm: plan on the kinematic cell, carry out on the dynamic one, replan from
what really happened."""

from __future__ import annotations

import time
from typing import Any

import mujoco
import numpy as np

from learn2assemble.networks.agent import Agent
from learn2assemble.planning.arm_course import ArmBuild
from learn2assemble.planning.planner import (
    Progress,
)
from learn2assemble.planning.problem import Problem
from learn2assemble.planning.reality import RealCell
from learn2assemble.planning.report import report
from learn2assemble.planning.verify import Proof, VerifiedStep
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.dynamic import DynamicCell
from learn2assemble.robot.grasps import get_grasps
from learn2assemble.robot.outcome import Outcome
from learn2assemble.robot.record import BuildRecord

CLOSING = ("along x", "along y")
"""The axis on which the fingers close, in words."""


def real_cell(arm: Arm) -> DynamicCell:
    """The cell builds are carried out in."""
    return DynamicCell(arm, recover=True)


def method() -> str:
    """One line on how steps are verified."""
    return f"MuJoCo {mujoco.__version__}, arm and blocks simulated together, grasps by friction"


def build_with_arm(
    problem: Problem,
    agent: Agent,
    source: str,
    cell: DynamicCell,
    *,
    seed: int = 0,
    seconds: float = 20.0,
    progress: Progress = lambda text: None,
) -> tuple[dict[str, Any], BuildRecord]:
    """Build with an arm; the content of ``plan.json`` and what the arm did.

    Every step is an attempt of the cell. After one that fails, the rest is planned anew from where
    arm and blocks really are, without the placement that failed.

    Args:
        problem: its blocks wait where the arm can take them, see :mod:`~.site`.
        source: where the problem comes from, for the report.
        cell: carries the plan out.
        seconds: limit of the last, widest search of each plan.
        progress: told what is going on.
    """
    started = time.perf_counter()
    build = ArmBuild(problem, cell)
    if problem.refusal is None:
        build.carry_out(agent, seed, seconds, progress)
    steps, real = build.steps(), build.real
    real.log.number_steps(build.step_numbers())
    words = build.summary(steps)
    plan = report(problem, agent, source, words, Proof(steps, build.filled), started, method())
    return _with_arm(plan, problem, steps, real), real.log.record()


def _with_arm(
    plan: dict[str, Any], problem: Problem, steps: list[VerifiedStep], real: RealCell
) -> dict[str, Any]:
    """The plan with what concerns the arm (``docs/plan.md``)."""
    pairs = get_grasps(problem.task.grasps)
    attempts = {s.plan_step: s.outcome for s in real.log.steps if s.plan_step is not None}
    for entry, step in zip(plan["steps"], steps, strict=True):
        pair = pairs[step.placement.action % len(pairs)]
        entry["outcome"] = attempts[entry["step"]].label
        entry["grasp"], entry["place"] = (
            CLOSING[int(abs(np.cos(attitude.yaw)) > 0.5)] for attitude in pair
        )
    plan["arm"] = {
        "name": real.cell.arm.name,
        "pitch": problem.task.pitch,
        "attempts": len(real.log.steps),
        "failures": [
            {"attempt": step.number, "outcome": step.outcome.label, "detail": step.detail,
             "replanned": step.replanned}
            for step in real.log.steps if step.outcome != Outcome.REACHED
        ],
        "seconds": round(real.log.now, 2),
    }  # fmt: skip
    return plan
