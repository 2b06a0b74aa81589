"""From goals to a plan: what is impossible is refused; then stacks, search and exact program."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from learn2assemble.design.cells import CellDesign
from learn2assemble.design.goals import Goals
from learn2assemble.errors import InputError
from learn2assemble.planning import plan as plans
from learn2assemble.planning.goals.loads import failing_load
from learn2assemble.planning.goals.program import MOST, plan_program
from learn2assemble.planning.goals.search import Found, search
from learn2assemble.planning.goals.stacks import TIGHT, find_stacks
from learn2assemble.planning.goals.world import (
    MAX_CANDIDATES,
    GoalProblem,
    make_problem,
    relax,
)
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.construct import report_plan
from learn2assemble.planning.tiling.cover.candidates import BlockPlacement, placement_cells
from learn2assemble.planning.tiling.cover.tile import MORE_TIME, Tiling, owners
from learn2assemble.planning.tiling.ordering import order
from learn2assemble.planning.tiling.planners import EXACT, PlanLimits
from learn2assemble.planning.tiling.stack import find_stack
from learn2assemble.planning.tiling.world import LatticeWorld
from learn2assemble.statics.proofs import Bounds, widest_joint

SEARCH, STACKS = "search", "stacks"
"""Who else plans: :mod:`.search`, and :mod:`.stacks` where one stack under every goal is enough."""
WAYS = (SEARCH, EXACT)
SEARCH_SECONDS = (10.0, 30.0)
"""Limits of the search in front of the exact program: planar and spatial goals [s]."""
STACK_SECONDS = 10.0
"""Limit of the program that shares blocks out among stacks, which mostly takes less than one."""
_DIRECTIONS = 16


def plan_goals(
    goals: Goals,
    *,
    ways: tuple[str, ...] = WAYS,
    seed: int = 0,
    seconds: float = 60.0,
    friction: Bounds = None,
    gap: Bounds = None,
    timer: Callable[[], float] = time.monotonic,
    progress: Callable[[str], None] = lambda text: None,
) -> Plan:
    """A structure that meets some goals, its order, and the proof of every step.

    Args:
        ways: what is asked for a structure until one is found: the search, the mixed-integer
            program, or the search and then the program. Where the goals need most of a heap, or
            nothing else is found, a program shares the blocks out among one stack under every goal
            (:mod:`.stacks`).
        seed: of the search.
        seconds: limit of choosing the blocks, for the search as ``timer`` tells them.
        friction, gap: to prove it for, as for the exact planner.
        progress: told what is being done.

    Returns:
        The plan; its cells are those of the structure that was found.

    Raises:
        InputError: for loads that the heap cannot carry, and goals that are too large.
    """
    started = time.perf_counter()
    widest_joint(gap, goals.kit.joint_gap, goals.kit.pitch)
    problem, reason = prepare(goals)
    stages: list[plans.SearchStage] = []
    blocks: tuple[BlockPlacement, ...] = ()
    chosen, status = ways[0], "refused" if reason else "incomplete"
    tight = not reason and SEARCH in ways and _is_tight(problem)
    if tight:
        blocks, chosen = _stack(problem, seconds, stages, progress), STACKS
    if SEARCH in ways and not reason and not blocks:
        progress("searching for a structure")
        limit = seconds
        if EXACT in ways:
            limit = min(SEARCH_SECONDS[min(goals.shape[:2]) > 1], seconds / 3)
        found = search(problem, seconds=limit, seed=seed, timer=timer, progress=progress)
        blocks, chosen = found.placements, SEARCH
        stages.append(plans.SearchStage(SEARCH, _words(found), round(found.seconds, 3)))
        reason = "" if blocks else _nothing(found, limit)
    if EXACT in ways and not blocks and status != "refused":
        progress("solving the exact program")
        spent = time.perf_counter() - started if stages else 0.0
        exact = plan_program(problem, seconds=seconds - spent, progress=progress)
        blocks, chosen = exact.placements, EXACT
        words = f"{exact.status}: {len(blocks)} blocks, at least {exact.bound}"
        stages.append(plans.SearchStage("exact program", words, round(exact.seconds, 3)))
        reason = "" if blocks else f"time ran out after {seconds:g} s; {MORE_TIME}"
        if exact.status == "infeasible":
            status = "refused"
            reason = (
                f"no structure of up to {MOST} blocks of kit `{goals.kit.name}` meets the "
                "goals and stands (mixed-integer program)"
            )
    if not blocks and not tight and status != "refused":
        blocks = _stack(problem, seconds, stages, progress)
        chosen, reason = (STACKS, "") if blocks else (chosen, reason)
    limits = PlanLimits(friction, gap, goals.props, seconds)
    answer = _GoalAnswer(blocks, chosen, status, reason, time.perf_counter() - started)
    plan = _report(goals, answer, limits)
    also = ", and under every set of the loads" if goals.loads else ""
    design = replace(plan.design, boxes=tuple(plans.PlanBox(*box) for box in goals.boxes()))
    return replace(
        plan,
        design=design,
        search=plans.SearchReport(chosen, 0, tuple(stages)),
        verified_by=f"{plan.verified_by}{also}",
    )


def _is_tight(problem: GoalProblem) -> bool:
    """Whether the goals need most of the blocks that there are."""
    heap = LatticeWorld(problem.site).heap
    return bool((heap >= 0).all()) and (
        relax(problem, LatticeWorld(problem.site)).blocks >= TIGHT * heap.sum()
    )


def _stack(
    problem: GoalProblem,
    seconds: float,
    stages: list[plans.SearchStage],
    progress: Callable[[str], None],
) -> tuple[BlockPlacement, ...]:
    """Stacks under all goals, and a note of what came of it."""
    progress("sharing the blocks out among stacks")
    started = time.perf_counter()
    blocks = find_stacks(problem, seconds=min(seconds, STACK_SECONDS))
    words = f"{len(blocks)} blocks" if blocks else "nothing found"
    stages.append(plans.SearchStage(STACKS, words, round(time.perf_counter() - started, 3)))
    return blocks


def prepare(goals: Goals) -> tuple[GoalProblem, str]:
    """The candidates of some goals, and why they cannot be met where that is known at once.

    Raises:
        InputError: for loads that the heap cannot carry, and goals that are too large.
    """
    if not goals.open[:, :, 0].any():
        raise InputError(f"{goals.source}: obstacles", "no free cell on the table", "at least one")
    check_loads(goals)
    ways = sum(4 if kind.turns == "z" else 24 for kind in goals.kit.kinds)
    if goals.open.size * ways > MAX_CANDIDATES:
        most = MAX_CANDIDATES // ways
        raise InputError(f"{goals.source}: site", f"{goals.open.size} cells", f"at most {most}")
    problem = make_problem(goals)
    return problem, impossible(problem)


def impossible(problem: GoalProblem) -> str:
    """Why no structure meets the goals, where a simple bound proves it; else an empty text."""
    goals, kit = problem.goals, problem.goals.kit
    cells, asked = kit.most_cells, int(goals.must.sum())
    if cells is not None:
        if asked > cells:
            return f"{asked} cells have to be filled; the heap fills {cells}"
        sizes = [np.ptp(kind.cells, axis=0) + 1 for kind in kit.kinds]
        tall = [
            int(size.max() if kind.turns == "any" else size[2])
            for kind, size in zip(kit.kinds, sizes, strict=True)
        ]
        reached = sum((kind.count or 0) * t for kind, t in zip(kit.kinds, tall, strict=True))
        level = int(np.argwhere(goals.must)[:, 2].max()) + 1
        if reached < level:
            return f"a goal is {level} levels high; the whole heap on one another is {reached}"
    if not goals.props and not np.isfinite(relax(problem, LatticeWorld(problem.site)).blocks):
        return (
            f"no chain of blocks of kit `{kit.name}`, each carried below its centroid, leads "
            "from the table to every goal around the obstacles"
        )
    return ""


def check_loads(goals: Goals) -> None:
    """Refuse a load whose moment about the ground is more than the heap can balance.

    Beyond an edge of all the ground there is, a load has to be balanced by blocks behind the edge:
    by no more than the cells with the longest levers, filled with the densest blocks of the heap.

    Raises:
        InputError: naming the load and the largest mass.
    """
    kit, pitch = goals.kit, np.array(goals.kit.pitch)
    dense = max(kind.density or kit.density for kind in kit.kinds) * float(np.prod(pitch))
    middle = np.array(goals.shape[:2]) / 2
    ground = (np.argwhere(goals.open[:, :, 0]) - middle) * pitch[:2]
    corners = np.concatenate(
        [ground + np.array(c) * pitch[:2] for c in ((0, 0), (0, 1), (1, 0), (1, 1))]
    )
    centres = (np.argwhere(goals.open)[:, :2] + 0.5 - middle) * pitch[:2]
    for load in goals.loads:
        for angle in np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS:
            way = np.array([np.cos(angle), np.sin(angle)])
            edge = float((corners @ way).max())
            beyond = float(np.array(load.point[:2]) @ way) - edge
            if beyond <= 1e-9:
                continue
            levers = np.sort(edge - centres @ way)[::-1][: kit.most_cells]
            most = dense * float(np.maximum(levers, 0).sum()) / beyond
            if load.mass > most:
                raise InputError(
                    f"{goals.source}: load at {list(load.point)}",
                    f"{load.mass:g} kg",
                    f"at most {most:.3g} kg, which is what the heap can balance there",
                )


class _GoalAnswer(NamedTuple):
    """What the ways came to."""

    blocks: tuple[BlockPlacement, ...]
    """In their order; empty where none was found."""
    planner: str
    """Who found them."""
    status: str
    """Without blocks."""
    reason: str
    seconds: float


def _report(goals: Goals, answer: _GoalAnswer, limits: PlanLimits) -> Plan:
    """The plan of blocks in their order, with the same proof as any other."""
    kit, blocks, gap = goals.kit, answer.blocks, limits.gap
    wanted = np.zeros(goals.shape, bool)
    for block in blocks:
        if not block.prop:
            wanted[tuple(placement_cells(block, kit).T)] = True
    tiling = Tiling(blocks, wanted, "complete" if blocks else answer.status, answer.reason)
    ordering = None
    if blocks:
        seconds = max(limits.seconds, 10.0)
        ordering = order(
            tiling, kit, friction=limits.friction, gap=gap, seconds=seconds, given=True
        )
        widest = widest_joint(gap, kit.joint_gap, kit.pitch)
        kept = tuple(block for block in blocks if not block.prop)
        stack = find_stack(kept, kit, goals.shape, widest)
        owner = owners(kept, kit, goals.shape)
        failing = failing_load(goals, stack, owner)
        left = goals.unmet(owner >= 0)
        if failing is not None or left:
            points = [list(load.point) for load in failing or ()]
            why = left[0] if left else f"it falls under the loads at {points}"
            tiling = replace(tiling, status="incomplete", reason=why)
    name = CellDesign(goals.name, wanted, kit.pitch, None, 0.0, None, goals.source, kit.name)
    return report_plan(name, kit, tiling, ordering, seconds=answer.seconds, planner=answer.planner)


def _words(found: Found) -> str:
    if not found.placements:
        return f"nothing found; {found.expanded} structures looked at"
    props = len(found.placements) - found.blocks
    also = f" and {props} props" if props else ""
    return f"{found.blocks} blocks{also}; {found.expanded} structures looked at"


def _nothing(found: Found, limit: float) -> str:
    if found.exhausted:
        return "the search has tried everything it can"
    return f"no structure was found in {limit:g} s; {MORE_TIME}"
