"""What came of planning, as the content of ``plan.json`` (``docs/plan.md``)."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from learn2assemble.networks.agent import Agent
from learn2assemble.planning.planner import Sequence
from learn2assemble.planning.problem import Problem
from learn2assemble.planning.verify import Proof, VerifiedStep, method
from learn2assemble.world.actions import RELATIONS
from learn2assemble.world.blocks import EDGE

FORMAT, VERSION = "learn2assemble-plan", 1


def report(
    problem: Problem,
    agent: Agent,
    source: str,
    sequence: Sequence,
    proof: Proof,
    started: float,
    verified_by: str | None = None,
) -> dict[str, Any]:
    """What ``plan.json`` holds.

    Args:
        proof: its steps refer to one another by number, 0 is the first block.
        started: :func:`time.perf_counter` when planning began.
        verified_by: by default :func:`~.verify.method`.
    """
    state = problem.state
    count = int(state.num_blocks[0])
    waiting = np.empty((count, 3))
    waiting[state.object_id[0, :count]] = state.position[0, :count]
    held = [step for step in proof.steps if step.stable]
    status = "complete" if proof.stable and proof.filled else "incomplete"
    if problem.refusal is not None:
        status = "refused"
    coverage = held[-1].coverage if held else 0.0
    return {
        "format": FORMAT,
        "version": VERSION,
        "design": {
            "name": problem.name,
            "source": source,
            "num_sides": problem.task.num_sides,
            "frames": problem.frames.tolist(),
            "elevations": [
                {"name": name, "outline": outline.tolist()}
                for name, outline in zip(problem.elevation_names, problem.outlines, strict=True)
            ],
            "success_threshold": problem.task.success_threshold,
            "block_edge": EDGE,
        },
        "agent": agent.name,
        "status": status,
        "reason": _reason(problem, status, proof, coverage, count),
        "search": {
            "needed": sequence.stage,
            "budget": sequence.budget,
            "attempts": [
                {"stage": a.stage, "result": a.result, "seconds": round(a.seconds, 3)}
                for a in sequence.attempts
            ],
            "backtracks": sequence.backtracks,
            "dropped": sequence.dropped,
        },
        "blocks": {
            "available": count,
            "used": len(held) + 1,
            "waiting": waiting.tolist(),
        },
        "first_block": {
            "block": 0,
            "position": state.position[0, 0].tolist(),
            "quaternion": state.quaternion[0, 0].tolist(),
            "coverage": round(float(state.complete_coverage[0]), 6),
            "plane_coverage": round(float(state.plane_coverage[0]), 6),
        },
        "steps": [
            _step(number, step, problem.task.rotations)
            for number, step in enumerate(proof.steps, 1)
        ],
        "coverage": coverage,
        "verified_by": verified_by or method(),
        "seconds": round(time.perf_counter() - started, 3),
    }


def _step(number: int, step: VerifiedStep, ways: int) -> dict[str, Any]:
    return {
        "step": number,
        "block": step.placement.block,
        "reference": step.placement.reference,
        "relation": RELATIONS[step.placement.action // ways],
        "position": np.round(step.position, 6).tolist(),
        "quaternion": np.round(step.quaternion, 6).tolist(),
        "coverage": round(step.coverage, 6),
        "plane_coverage": round(step.plane_coverage, 6),
        "stability_margin": round(step.stability_margin, 4),
        "speed_sum": round(step.speed_sum, 6) if math.isfinite(step.speed_sum) else None,
        "stable": step.stable,
        "outside": step.outside,
    }


def _reason(
    problem: Problem, status: str, proof: Proof, coverage: float, available: int
) -> str | None:
    """What is missing, in one sentence."""
    if status == "complete":
        return None
    if problem.refusal is not None:
        return problem.refusal
    threshold = problem.task.success_threshold
    text = f"filled {coverage:.1%} of the target, more than {threshold:.1%} is needed"
    if not proof.stable:
        return f"step {len(proof.steps)} does not hold in rigid-body simulation; {text}"
    if len(proof.steps) + 1 >= available:
        text += f"; all {available} blocks are used"
    return text
