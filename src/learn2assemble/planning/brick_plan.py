"""The plan of given bricks that clutch: their order, or that of their file, with its proof."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.given_plan import plan_of
from learn2assemble.planning.orders import BrickOrder
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.sequence import Sequenced, SequenceStep, Supports
from learn2assemble.statics.holding.check import JointAnswer, stands_by_joints, words_of

VERIFIED = "balance of joints that hold, in every step, also under its press"
_LEAST = 1.0
"""Seconds that are left to try what would help."""
_TRIED = 10.0
"""Seconds for that where no limit was said."""


def plan_for_arm(assembly: Assembly) -> Plan:
    """Bricks that an arm orders itself, since that depends on how it holds them: listed from below,
    none of their states proven but the last.

    Raises:
        InputError: for blocks that are no bricks on one lattice.
    """
    started, assembly = time.perf_counter(), assembly.finished
    found, blocks = stands_by_joints(assembly), assembly.blocks
    friction = assembly.friction, assembly.friction
    if not found.need.stands:
        reason = f"the finished structure falls: {words_of(found.need)}"
        return plan_of(assembly, Sequenced(blocks, (), "refused", reason), friction, None, started)
    rank = sorted(range(len(blocks)), key=lambda k: round(float(blocks[k].vertices[:, 2].min()), 6))
    steps = tuple(SequenceStep("place", k, "", None, "above") for k in rank)
    plan = plan_of(assembly, Sequenced(blocks, steps, "complete"), friction, None, started)
    listed = tuple(replace(step, proof=None) for step in plan.steps)
    return replace(plan, verified_by=VERIFIED, steps=listed)


def plan_bricks(
    assembly: Assembly,
    help_: Supports,
    clock: Clock,
    progress: Callable[[str], None],
    answer: JointAnswer | None = None,
) -> Plan:
    """Order and proof of bricks.

    The order of the file is kept where every state of it stands, pressed, too; else another one is
    found, and a note says so.

    Args:
        assembly: bricks on a lattice of studs whose joints clutch.
        help_: what may help.
        clock: limits the search.
        progress: called with a line of text for everything that takes long.
        answer: whether all of it stands, where that is known.

    Raises:
        InputError: for blocks that are no bricks on one lattice.
    """
    started = time.perf_counter()
    found, note = None, None
    order = BrickOrder(assembly.finished if assembly.steps else assembly, answer)
    if assembly.steps:
        found, note = order.follow(assembly.steps, help_)
    if found is None:
        found = order.find(help_, clock, progress)
    alone = found.status == "not found" and not help_.hands and clock.left > _LEAST
    if alone and (said := _by_hands(order, help_.holds, clock)):
        found = replace(found, reason=f"{found.reason}; {said}")
    friction = assembly.friction, assembly.friction
    plan = plan_of(order.assembly, found, friction, None, started)
    design = replace(plan.design, note=note)
    return replace(plan, verified_by=VERIFIED, design=design)


def with_hands(assembly: Assembly) -> str:
    """That hands build bricks that an arm does not, in one clause; empty where that is not found
    in some seconds.

    Args:
        assembly: bricks on a lattice of studs whose joints clutch, that stand when finished.
    """
    said = _by_hands(BrickOrder(assembly.finished), 0, Clock(_TRIED, time.process_time))
    return f"without an arm, {said}" if said else ""


def _by_hands(order: BrickOrder, holds: int, clock: Clock) -> str:
    """The same of bricks whose order is looked for.

    Args:
        holds: hands there are, at least.
    """
    found = order.find(Supports(holds=max(1, holds), hands=True), clock)
    if found.status != "complete":
        return ""
    held = sum(step.action == "hold" for step in found.steps)
    return f"with hands it is built (`hands=`), which hold {held} times"
