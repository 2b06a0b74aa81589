"""The plan of given blocks that are in an order."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from learn2assemble.assembly.blocks import Assembly, AssemblyStep
from learn2assemble.planning import plan as plans
from learn2assemble.planning.plan import Plan, PlanDesign, Step
from learn2assemble.planning.sequence import Sequenced
from learn2assemble.values import rounded


def plan_of(
    assembly: Assembly,
    found: Sequenced,
    ends: tuple[float, float],
    gaps: tuple[float, float] | None,
    started: float,
    before: np.ndarray | None = None,
    wanted: np.ndarray | None = None,
) -> Plan:
    """The plan of blocks in an order.

    Args:
        assembly: the given blocks.
        found: their order.
        ends: friction it is proven for.
        gaps: widths of vertical joints it is proven for.
        started: when planning began, of ``time.perf_counter``.
        before: bool[B], what stands before the first step; by default the supports.
        wanted: bool[B], what has to stand at last; by default all but supports and props.
    """
    support = np.array([block.support for block in found.blocks])
    if wanted is None:
        wanted = ~support & ~np.array([block.prop for block in found.blocks])
    present = (support if before is None else before).copy()
    steps, made = list[Step](), list[AssemblyStep]()
    for number, step in enumerate(found.steps, 1):
        block = found.blocks[step.block]
        if step.action in ("place", "remove"):
            present[step.block] = step.action == "place"
        covered = float((present & wanted).sum()) / max(int(wanted.sum()), 1)
        way = None if step.way == "above" else step.way
        done: dict[str, Any] = {step.action: block.id}
        wait = assembly.age if step.wait else None
        made.append(AssemblyStep(**done, way=way, wait=wait, hand=step.hand, arm=step.arm))
        steps.append(
            replace(
                plans.block_step(number, step.block, block, step.action, covered).with_proof(
                    step.proof, step.margin_g
                ),
                way=step.way,
                wait_h=wait,
                arm=step.arm,
                margin_n=None if step.margin_n is None else round(step.margin_n, 6),
            )
        )
    blocks = replace(assembly, blocks=found.blocks, steps=tuple(made), not_built=())
    first = [] if before is None else np.flatnonzero(before).tolist()
    blocks = blocks.as_far_as_placed(found.blocks[k].id for k in first)
    return Plan(
        design=PlanDesign(name=assembly.name or "assembly", source="", block_edge=1.0),
        status="incomplete" if found.status == "not found" and found.steps else found.status,
        reason=found.reason,
        blocks=plans.BlockSupply(int(wanted.sum()), int((present & wanted).sum()), ()),
        steps=tuple(steps),
        coverage=steps[-1].coverage if steps else 0.0,
        seconds=round(time.perf_counter() - started, 3),
        planner="exact",
        verified_by="rigid-block equilibrium of every step",
        friction_range=ends,
        gap_range=gaps,
        margin_friction=rounded(ends[0]),
        assembly=blocks,
    )
