r"""Goals at the top of separate stacks: which block goes on which level of which stack.

Below every goal stands a stack that fills all cells down to the table, one of which at least each
of its blocks fills. With a binary :math:`x_p` for every candidate :math:`p` that fills such a cell,

.. math::

    \min \sum_p c_p x_p \quad \text{s.t.} \quad \sum_{p \ni c} x_p = 1 \;\text{(cells of stacks)},
    \le 1 \;\text{(all cells)}, \qquad \sum_{p \in k} x_p \le n_k , \qquad
    x_p \le \sum_{q \text{ carries } p} x_q ,

where :math:`q` carries :math:`p` where it bears the centroid of :math:`p` alone, and :math:`c_p` is
1 and a little for a centroid away from the middle of the stack. So a heap that just suffices is
shared out exactly, which a search block by block hardly finds. Every state is proven afterwards.
"""

from __future__ import annotations

import numpy as np

from learn2assemble.linear_programs import INF, Clock, Model, solve
from learn2assemble.planning.goals.loads import bears
from learn2assemble.planning.goals.world import GoalProblem, legal, put, unmet
from learn2assemble.planning.tiling.cover.candidates import BlockPlacement
from learn2assemble.planning.tiling.cover.ways import support_margin
from learn2assemble.planning.tiling.props import FIRM
from learn2assemble.planning.tiling.world import LatticeWorld

TIGHT = 0.75
"""Share of the blocks of a heap that goals need at least for stacks to be tried before a search."""
_ROUNDS = 12
"""Choices of blocks that are tried, one after the other where one falls."""
_OFF_CENTRE = 0.01
"""Price of a centroid a cell away from the middle of its stack [blocks]."""


def find_stacks(problem: GoalProblem, *, seconds: float = INF) -> tuple[BlockPlacement, ...]:
    """Stacks under all goals, in the order of building; empty where none were found.

    Args:
        seconds: limit of the program.
    """
    goals, site, clock = problem.goals, problem.site, Clock(seconds)
    below = np.flip(np.maximum.accumulate(np.flip(goals.must, 2), 2), 2)
    if (below & ~goals.open).any() or not len(site):
        return ()
    found, inside = site.found, below.reshape(-1)[site.found.cell]
    keep = np.flatnonzero(np.logical_or.reduceat(inside, found.start[:-1]))
    number = np.full(len(found), -1)
    number[keep] = np.arange(len(keep))
    part = found.take(keep)
    middle = np.argwhere(below.any(2)) + 0.5
    away = np.linalg.norm(problem.centre[keep, None] - middle, axis=2).min(1)
    model = Model()
    used = model.columns(1 + _OFF_CENTRE * away, 1.0, integer=True)
    model.rows(below.reshape(-1), 1.0, (part.cell, np.repeat(used, part.size()), 1.0))
    limited = np.flatnonzero(site.limits >= 0)
    row_of = np.full(len(site.limits), -1)
    row_of[limited] = np.arange(len(limited))
    kinds = row_of[site.kind[keep]]
    counted = np.flatnonzero(kinds >= 0)
    model.rows(
        np.full(len(limited), -INF),
        site.limits[limited].astype(float),
        (kinds[counted], used[counted], 1.0),
    )
    raised = np.flatnonzero(part.origin[:, 2] > 0)
    carried, carries = list[int](), list[int]()
    for row, top in enumerate(raised):
        for base in _carriers(problem, int(keep[top])):
            if number[base] >= 0:
                carried.append(row)
                carries.append(number[base])
    model.rows(
        np.full(len(raised), -INF),
        0.0,
        (np.arange(len(raised)), used[raised], 1.0),
        (np.array(carried, np.int64), np.array(carries, np.int64), -1.0),
    )
    for _ in range(_ROUNDS):
        answer = solve(model.program(), clock.left)
        if answer.x is None:
            break
        chosen = np.flatnonzero(answer.x > 0.5)
        order = keep[chosen[np.argsort(part.origin[chosen, 2], kind="stable")]]
        if _holds(problem, order.tolist()):
            return tuple(site.placement(int(k)) for k in order)
        model.rows(-INF, len(chosen) - 1.0, (0, used[chosen], 1.0))
    return ()


def _carriers(problem: GoalProblem, candidate: int) -> list[int]:
    """Candidates that bear the centroid of one alone."""
    site, shape = problem.site, problem.goals.shape
    flat = site.cells(candidate)
    cells = np.stack(np.unravel_index(flat, shape), 1)
    lowest = (cells[:, 2] > 0) & ~np.isin(flat - 1, flat)
    near = {
        int(q)
        for c in flat[lowest] - 1
        for q in site.over[site.over_start[c] : site.over_start[c + 1]]
    }
    return [
        q
        for q in sorted(near)
        if support_margin(cells, lowest & np.isin(flat - 1, site.cells(q)), problem.goals.kit)
        > FIRM
    ]


def _holds(problem: GoalProblem, candidates: list[int]) -> bool:
    """Whether candidates can be put down in this order, every state standing, and meet the goals
    and bear their loads."""
    world: LatticeWorld | None = LatticeWorld(problem.site)
    for k in candidates:
        if k not in legal(problem, world):
            return False
        world = put(world, k)
        if world is None:
            return False
    return not len(unmet(problem, world)) and bears(problem, world)
