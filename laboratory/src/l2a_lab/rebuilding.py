"""Pairs of random designs of one heap, the one turned into the other, measured.

The first design of a pair is built of any blocks; these are the heap that the second one is built
of. Every second pair goes the other way round: what is missing then comes from the heap. The first
ones are also carried out, by an arm in the dynamic cell, and by two.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import replace

import numpy as np

from l2a_lab.measured import Result
from learn2assemble.assembly.kit import DEFAULT_KIT, Kit, load_kit
from learn2assemble.jobs.build import build
from learn2assemble.jobs.kinds import PHYSICS, ArmChoice, rebuilt_by
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.rebuilding.rebuild import rebuild
from learn2assemble.statics.rigid_blocks import FALLS, check
from learn2assemble.tasks.designs import FAMILIES, draw

PAIRS = 20
LEAST, MOST = 20, 80
"""Blocks of a design."""
SECONDS, DESIGN_SECONDS = 120.0, 5.0
"""Limits of an order with its proof, and of the plan of a design of a pair."""
RATIO = 1.1
"""Moves over their bound, asked at most."""
CARRIED, ARM, CELL = 5, "ur5e", 0.032
"""So many pairs are carried out, by which arm or arms, and the edge of a cell of their blocks [m].
"""


def rebuild_entry(seed: int) -> Result:
    """One pair by its seed; seconds are of the processor."""
    old, new, drawn = _pair(seed, load_kit(DEFAULT_KIT))
    assert old.assembly is not None
    started = time.process_time()
    plan = rebuild(old.assembly, new, seconds=SECONDS)
    used = time.process_time() - started
    assert plan.rebuilt is not None
    found = plan.rebuilt
    return {
        "old": old.design.name,
        "new": new.design.name,
        "old_blocks": old.blocks.used,
        "new_blocks": new.blocks.used,
        "designs_drawn": drawn,
        "status": plan.status,
        "reason": plan.reason,
        "moves": found.moves,
        "moves_bound": found.moves_bound,
        "kept": found.kept,
        "taken": found.taken,
        "placed": found.placed,
        "states_that_fall": _falling(plan),
        "seconds": round(used, 3),
    }


def carried_entry(seed: int, arms: int = 1) -> Result:
    """One pair by its seed, carried out by one arm or two; seconds are of the processor."""
    old, new, _ = _pair(seed, load_kit(DEFAULT_KIT).at_pitch((CELL, CELL, CELL)))
    assert old.assembly is not None
    started = time.process_time()
    plan = rebuild(old.assembly, new, seconds=SECONDS)
    how = ArmChoice((ARM,) * arms, None, None, PHYSICS[0], (0.0, 0.0), None, 0)
    done = rebuilt_by(how, plan, load_kit(DEFAULT_KIT).joint_gap, lambda text: None)
    used = time.process_time() - started
    told = {"old": old.design.name, "new": new.design.name, "steps": len(plan.steps)}
    told |= {"status": done.status, "reason": done.reason}
    reports = [done.arm] if done.arm else [one.did for one in done.arms if one.did]
    if not reports:  # There was no order to carry out.
        return told
    return {
        **told,
        "attempts": sum(one.attempts for one in reports),
        "error_worst": max(one.error_worst or 0.0 for one in reports),
        "robot_s": reports[0].seconds if done.arm else done.robot_s,
        "states_that_fall": _falling(done) if done.complete else None,
        "seconds": round(used, 3),
    }


def _pair(seed: int, kit: Kit) -> tuple[Plan, Plan, int]:
    """A structure and what it is turned into, of one heap, and how many designs were drawn."""
    rng, count = np.random.default_rng([seed, 28]), 0
    while True:
        first, drawn = _design(rng, kit, 30, MOST, 6 * MOST)
        count += drawn
        if first is None or first.assembly is None:
            continue
        there = Counter(block.kind for block in first.assembly.finished.blocks)
        kinds = tuple(
            replace(kind, count=there[kind.name]) for kind in kit.kinds if there[kind.name]
        )
        cells = sum(len(kind.cells) * there[kind.name] for kind in kinds)
        second, drawn = _design(rng, replace(kit, kinds=kinds), LEAST, first.blocks.used, cells)
        count += drawn
        if second is not None:
            return (second, first, count) if seed % 2 else (first, second, count)


def _design(
    rng: np.random.Generator, kit: Kit, low: int, high: int, cells: int
) -> tuple[Plan | None, int]:
    """A random design of so many blocks that needs no props, if one of some is.

    Args:
        cells: of the largest drawing that is tried.
    """
    tried = 0
    for _ in range(200):
        family, goal = str(rng.choice(list(FAMILIES))), float(rng.uniform(low, high))
        wanted = draw(family, rng, (4 * goal) ** 0.5, False)
        if wanted is None or not 2 * low <= wanted.sum() <= min(cells, 6 * high):
            continue
        tried += 1
        plan = build(wanted, kit=kit, supports="none", seconds=DESIGN_SECONDS)
        if plan.complete and low <= plan.blocks.used <= high:
            return replace(plan, design=replace(plan.design, name=family)), tried
        if tried == 12:
            break
    return None, tried


def _falling(plan: Plan) -> int:
    """States of a plan that fall by the check of any structure, which knows no order."""
    assert plan.assembly is not None
    whole = replace(plan.assembly, steps=())
    there = {b.id for b, at in zip(whole.blocks, plan.assembly.at_first, strict=True) if at}
    falls = 0
    for step in plan.assembly.steps:
        there ^= {step.block}
        blocks = tuple(block for block in whole.blocks if block.id in there)
        falls += bool(blocks) and check(replace(whole, blocks=blocks)).verdict == FALLS
    return falls
