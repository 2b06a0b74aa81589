"""The main job: plan, verify, widen until it holds, and say what it took."""

from __future__ import annotations

import time
from typing import Any

from learn2assemble.networks.agent import Agent
from learn2assemble.planning.planner import Progress, Sequence, plan_sequences
from learn2assemble.planning.problem import Problem
from learn2assemble.planning.report import report
from learn2assemble.planning.verify import Proof, verify


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
        return report(problem, agent, source, nothing, Proof([], False), started)
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
    return report(problem, agent, source, *best, started)


def _rank(proof: Proof) -> tuple[bool, float]:
    held = [step.coverage for step in proof.steps if step.stable]
    return proof.stable and proof.filled, held[-1] if held else 0.0
