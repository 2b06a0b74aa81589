"""The main job: plan, verify, widen until it holds, and say what it took."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from learn2assemble.networks.agent import Agent
from learn2assemble.planning.planner import Progress, Sequence, plan_sequences
from learn2assemble.planning.problem import Problem
from learn2assemble.planning.verify import Proof, VerifiedStep, method, verify
from learn2assemble.simulator import Simulator
from learn2assemble.world.actions import RELATIONS
from learn2assemble.world.blocks import EDGE

FORMAT, VERSION = "learn2assemble-plan", 1


def build(
    problem: Problem,
    agent: Agent,
    source: str,
    *,
    seed: int = 0,
    seconds: float = 20.0,
    progress: Progress = lambda text: None,
) -> dict[str, Any]:
    """The plan of a problem as the content of ``plan.json`` (``docs/plan.md``).

    Args:
        source: where the problem comes from, for the report.
        seconds: limit of the last, widest search.
        progress: told what is being tried.
    """
    started = time.perf_counter()
    if problem.refusal is not None:
        nothing = Sequence([], False, "none: refused before planning", 0)
        return _report(problem, agent, source, nothing, Proof([], False), started)
    best: tuple[Sequence, Proof] | None = None
    for sequence in plan_sequences(problem, agent.network, seed, seconds, progress):
        progress("verifying by rigid-body simulation")
        proof = verify(problem, sequence.placements)
        held = proof.stable and proof.filled
        if sequence.success and not held:
            sequence.attempts[-1].result = "fills the target, but does not hold in simulation"
        if best is None or _rank(proof) > _rank(best[1]):
            best = sequence, proof
        best[0].attempts = sequence.attempts
        if proof.stable and proof.filled:
            break
    assert best is not None
    return _report(problem, agent, source, *best, started)


def _rank(proof: Proof) -> tuple[bool, float]:
    held = [step.coverage for step in proof.steps if step.stable]
    return proof.stable and proof.filled, held[-1] if held else 0.0


def _report(
    problem: Problem,
    agent: Agent,
    source: str,
    sequence: Sequence,
    proof: Proof,
    started: float,
) -> dict[str, Any]:
    state = problem.state
    count = int(state.num_blocks[0])
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
            "frames": Simulator(problem.task).frames.tolist(),
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
            "waiting": state.position[0, :count].tolist(),
        },
        "first_block": {
            "block": 0,
            "position": state.position[0, 0].tolist(),
            "quaternion": state.quaternion[0, 0].tolist(),
        },
        "steps": [_step(number, step) for number, step in enumerate(proof.steps, 1)],
        "coverage": coverage,
        "verified_by": method(),
        "seconds": round(time.perf_counter() - started, 3),
    }


def _step(number: int, step: VerifiedStep) -> dict[str, Any]:
    return {
        "step": number,
        "block": step.placement.block,
        "reference": step.placement.reference,
        "relation": RELATIONS[step.placement.relation],
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
