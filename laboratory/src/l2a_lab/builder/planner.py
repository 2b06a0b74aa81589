"""The builder as a planner: the same answer as the exact one's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from l2a_lab.builder.network import DEFAULT, Builder, load_builder
from l2a_lab.builder.search import BUDGET, SearchOutcome, build
from learn2assemble.assembly.kit import Kit, orientations
from learn2assemble.errors import InputError
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.plan import SearchReport, SearchStage
from learn2assemble.planning.tiling.cover.tile import MORE_TIME, Tiling
from learn2assemble.planning.tiling.exact import prop_and_order
from learn2assemble.planning.tiling.ordering import Ordering, order
from learn2assemble.planning.tiling.planners import PlanLimits, PlannerChoice
from learn2assemble.planning.tiling.world import LatticeWorld, make_site, run

MAX_CANDIDATES = 1_000_000
"""Cells times ways to put down a block: what the builder keeps grows with it."""
_SET_UP = 3.0
"""States that an arm may expand per block before its base stands elsewhere."""


def plan_with_agent(
    wanted: np.ndarray,
    kit: Kit,
    limits: PlanLimits,
    choice: PlannerChoice,
) -> tuple[Tiling, Ordering, SearchReport, str]:
    """Blocks of ``kit`` that fill ``wanted``, chosen by the builder, every state proven again.

    Args:
        wanted: bool[X, Y, Z].
        limits: temporary blocks are used only where no arm builds: at once where some cell is
            filled by nothing that stands by itself, else in a second search, with a budget of its
            own, where the first finds no way without.
        choice: its agent is a builder, or the name or file of one; the default one without it.

    Returns:
        as :func:`learn2assemble.planning.tiling.exact.plan_exact`, of what was built where not all
        could be; what the search took; the name of the builder.
    """
    most = MAX_CANDIDATES // len(orientations(kit))
    if int(np.asarray(wanted).sum()) > most:
        raise InputError("planner", "agent", f"exact, for more than {most} cells of kit {kit.name}")
    friction, gap, props, seconds = limits.friction, limits.gap, limits.props, limits.seconds
    clock, hand, seed, builder = Clock(seconds), choice.hand, choice.seed, choice.agent
    agent = builder if isinstance(builder, Builder) else load_builder(str(builder or DEFAULT))
    site = make_site(wanted, kit if hand is None else hand.holds(kit))
    props = props and hand is None
    if props and len(LatticeWorld(site).stranded()):
        site = make_site(wanted, kit, props)
    outcome = build(site, agent, seed=seed, seconds=seconds)
    expanded, first = outcome.expanded, outcome.world
    if props and not site.props and not outcome.complete:
        again = build(make_site(wanted, kit, props), agent, seed=seed, seconds=clock.left)
        expanded += again.expanded
        outcome, site = (again, again.world.site) if again.complete else (outcome, site)
    if hand is not None and outcome.complete:
        outcome = None
        for turn in range(4 if hand.workcell.site.base is None else 1):
            left = BUDGET - expanded / len(first.placed)
            if turn and left <= 1:
                break
            try:
                site = make_site(wanted, hand.set_up(first, turn))
            except InputError:
                if not turn:
                    raise
                continue
            hand.enter(site)
            tried = build(
                site, agent, budget=min(left, _SET_UP), seed=seed, seconds=clock.left, hand=hand
            )
            expanded += tried.expanded
            if outcome is None or tried.world.open < outcome.world.open:
                outcome = tried
            if tried.complete:
                break
        assert outcome is not None
    if outcome.world.propped and not outcome.complete:
        # Nobody places props for what is not finished: up to there it stands by itself.
        alone = run(site, outcome.world.placed[: outcome.world.propped[0]])
        outcome = replace(outcome, world=alone or LatticeWorld(site))
    world, spent = outcome.world, clock.spent
    placements = tuple(site.placement(candidate) for candidate in world.placed)
    missing = tuple(world.cells_open())
    tiling = Tiling(
        placements,
        site.wanted,
        "complete" if world.complete else "incomplete",
        _reason(outcome, seconds),
        missing,
    )
    ordering = Ordering((), tiling.status, tiling.reason)
    if world.complete and world.propped:
        propped = prop_and_order(tiling, kit, clock, friction=friction, gap=gap, props_allowed=True)
        tiling, ordering = propped[0], propped[1] or ordering
    elif placements:
        ordering = order(
            tiling, kit, friction=friction, gap=gap, seconds=max(clock.left, 1.0), given=True
        )
    found = "complete" if world.complete else f"{len(missing)} cells open"
    text = f"{found}; {expanded} states expanded, {outcome.repairs} dead ends repaired"
    if hand is not None:
        text += f"; {hand.tried} placements tried by the arm, {hand.failed} of them failed"
    report = SearchReport(
        "agent with search", BUDGET, (SearchStage("agent with search", text, round(spent, 3)),)
    )
    return tiling, ordering, report, agent.name


def _reason(outcome: SearchOutcome, seconds: float) -> str:
    """Why it is not complete, in one line."""
    world = outcome.world
    if world.complete:
        return ""
    cells = world.cells_open()
    x, y, z = min(cells, key=lambda cell: cell[::-1])
    what = f"{len(cells)} cells are open, the first at ({x}, {y}, {z})"
    if outcome.timed_out:
        return f"time ran out after {seconds:g} s: {what}; {MORE_TIME}"
    never = np.flatnonzero(world.site.wanted.reshape(-1) & (np.diff(world.site.over_start) == 0))
    if len(never):
        what += f"; {len(never)} cells need a prop, which the agent does not use"
    return f"the agent found no way on: {what}; --planner exact may"
