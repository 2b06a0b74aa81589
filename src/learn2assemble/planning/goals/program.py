r"""The exact program for goals: fewest blocks, chosen together with the forces that hold them.

With a binary :math:`x_p` for every candidate :math:`p`,

.. math::

    \min \sum_p x_p \quad \text{s.t.} \quad \sum_{p \ni c} x_p = 1 \;\text{(goals)}, \le 1
    \;\text{(all cells)}, \qquad \sum_{p \in k} x_p \le n_k ,

and, for every set of loads, forces under and on every candidate as in
:mod:`learn2assemble.planning.tiling.standing`. Sets of loads are added where an answer does not
bear them.
A block that is put down stands on its own bed: on every side of its centroid something that
carries it is chosen, too. An answer still needs an order; where there is none it is ruled out and
the next best is looked for. So the number of blocks is the optimum where an order is found, and a
lower bound before. *Infeasible* proves that no structure meets the goals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from learn2assemble.design.goals import Surface
from learn2assemble.linear_programs import INF, Clock, LinearProgram, Model, solve
from learn2assemble.planning.goals.loads import failing_load
from learn2assemble.planning.goals.search import finished
from learn2assemble.planning.goals.world import GoalProblem, legal, put
from learn2assemble.planning.tiling.cover.candidates import BlockPlacement
from learn2assemble.planning.tiling.cover.tile import owners
from learn2assemble.planning.tiling.stack import find_stack
from learn2assemble.planning.tiling.standing import add_forces, face_points, find_faces
from learn2assemble.planning.tiling.world import LatticeWorld
from learn2assemble.progress import Progress, silent

MOST = 24
"""Blocks of a structure the program looks for."""
MAX_STATES = 20_000
"""Partial structures that are looked at for an order."""


@dataclass(frozen=True)
class ProgramResult:
    """What the program came to."""

    status: str
    """``"optimal"``, ``"feasible"``, ``"infeasible"`` or ``"time"``."""
    placements: tuple[BlockPlacement, ...]
    """In the order of building; empty where none was found."""
    bound: int
    """No structure has fewer blocks."""
    seconds: float


def plan_program(
    problem: GoalProblem, *, seconds: float = 60.0, most: int = MOST, progress: Progress = silent
) -> ProgramResult:
    """The structure with the fewest blocks that meets the goals, and an order.

    Args:
        seconds: wall-clock limit.
        most: blocks of a structure at most.
        progress: told how many blocks there are at least.
    """
    clock = Clock(seconds, progress=progress)
    goals = problem.goals
    cases: list[tuple[Surface, ...]] = [goals.loads]
    ruled_out: list[np.ndarray] = []
    bound = 1
    while True:
        clock.tell(f"solving the exact program: at least {bound} blocks")
        answer = solve(_program(problem, cases, ruled_out, most), clock.left, gap=0.0)
        if answer.status == "infeasible":
            status = "infeasible" if not ruled_out else "time"
            return ProgramResult(status, (), bound, clock.spent)
        if np.isfinite(answer.bound):
            bound = max(bound, int(np.ceil(answer.bound - 1e-6)))
        if answer.x is None:
            return ProgramResult("time", (), bound, clock.spent)
        chosen = np.flatnonzero(answer.x[: len(problem.site)] > 0.5)
        blocks = tuple(problem.site.placement(int(k)) for k in chosen)
        owner = owners(blocks, goals.kit, goals.shape)
        failing = failing_load(goals, find_stack(blocks, goals.kit, goals.shape), owner)
        if failing is None and not finished(problem, blocks):
            failing = ()
        if failing is not None and failing not in cases:
            cases.append(failing)
            continue
        order = find_order(problem, chosen.tolist())
        if order is not None:
            made = tuple(problem.site.placement(k) for k in order)
            status = "optimal" if answer.status == "optimal" else "feasible"
            return ProgramResult(status, made, bound, clock.spent)
        ruled_out.append(chosen)
        if clock.left <= 0:
            return ProgramResult("time", (), bound, clock.spent)


def find_order(problem: GoalProblem, candidates: list[int]) -> list[int] | None:
    """An order in which candidates can be put down, every state standing; None for none."""
    seen: set[frozenset[int]] = set()

    def go(world: LatticeWorld, left: frozenset[int]) -> list[int] | None:
        if not left:
            return list(world.placed)
        if left in seen or len(seen) > MAX_STATES:
            return None
        seen.add(left)
        ready = [k for k in legal(problem, world).tolist() if k in left]
        for k in sorted(ready, key=lambda k: problem.site.found.origin[k, 2]):
            grown = put(world, k)
            made = None if grown is None else go(grown, left - {k})
            if made is not None:
                return made
        return None

    return go(LatticeWorld(problem.site), frozenset(candidates))


def _program(
    problem: GoalProblem, cases: list[tuple[Surface, ...]], ruled_out: list[np.ndarray], most: int
) -> LinearProgram:
    """Columns: whether each candidate is used, then for every case the forces at the corners of
    bed faces and of top faces."""
    site, found, goals = problem.site, problem.site.found, problem.goals
    n, shape, kit = len(site), goals.shape, goals.kit
    planar = shape[1] == 1
    cell, body = found.cell, np.repeat(np.arange(n), found.size())
    where = np.stack(np.unravel_index(cell, shape), -1)
    model = Model()
    used = model.columns(np.ones(n), 1.0, integer=True)
    # Cells and heap.
    model.rows(goals.must.reshape(-1), 1.0, (cell, body, 1.0))
    limited = np.flatnonzero(site.limits >= 0)
    of_kind = np.full(len(site.limits) + 1, -1)
    of_kind[limited] = np.arange(len(limited))
    counted = np.flatnonzero(of_kind[site.kind] >= 0)
    model.rows(
        np.zeros(len(limited)), site.limits[limited], (of_kind[site.kind[counted]], counted, 1.0)
    )
    model.rows(0.0, float(most), (0, used, 1.0))
    for chosen in ruled_out:
        model.rows(-INF, len(chosen) - 1.0, (0, used, np.where(np.isin(used, chosen), 1.0, -1.0)))
    # A way down from the highest goal: a block on every level.
    pairs = np.unique(np.stack([where[:, 2], body]), axis=1)
    pairs = pairs[:, pairs[0] <= int(np.argwhere(goals.must)[:, 2].max())]
    model.rows(np.ones(int(pairs[0].max()) + 1), INF, (pairs[0], pairs[1], 1.0))
    # On every side of the centroid something that carries.
    bed_body = np.repeat(np.arange(n), np.diff(problem.bed_start))
    bed_at = np.stack(np.unravel_index(problem.bed, shape), -1)
    above = bed_at[:, 2] > 0
    raised = np.unique(bed_body[above])
    row_of = np.full(n, -1)
    row_of[raised] = np.arange(len(raised))
    away = bed_at[:, :2] - problem.centre[bed_body]
    sides = [
        side
        for axis in range(1 if planar else 2)
        for side in (away[:, axis] > -1 + 1e-6, away[:, axis] < -1e-6)
    ]
    for side in sides if not goals.props else [np.ones(len(away), bool)]:
        pairs = np.flatnonzero(side & above)
        below = problem.bed[pairs] - 1
        counts = np.diff(site.over_start)[below]
        inner = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
        q = site.over[np.repeat(site.over_start[below], counts) + inner]
        p, q = np.unique(np.stack([np.repeat(bed_body[pairs], counts), q]), axis=1)
        model.rows(
            np.zeros(len(raised)), INF, (row_of[p], q, 1.0), (np.arange(len(raised)), raised, -1.0)
        )
    # Forces.
    weight = site.weight[found.way]
    unit = float(weight.mean())
    weight = weight / unit
    middle = site.centre[found.way][:, :2] / np.array(kit.pitch[:2]) + found.origin[:, :2]
    points = np.array([[0, 0.5], [1, 0.5]] if planar else [[0, 0], [1, 0], [0, 1], [1, 1]])
    faces = find_faces(body, where, site.wanted, site.wanted, middle, face_points(kit, points))
    for case in cases:
        own = np.zeros((n, 2 if planar else 3))
        own[:, 0] = weight
        for load in case:
            at = np.array(load.point[:2]) / kit.pitch[:2] + np.array(shape[:2]) / 2
            bears = body[cell == np.ravel_multi_index(load.cell, shape)]
            mass = load.mass / unit
            own[bears, 0] += mass
            own[bears, 1:] += mass * (at - middle[bears])[:, : own.shape[1] - 1]
        total = float(weight.max()) * min(most, site.wanted.size)
        total += sum(load.mass for load in case) / unit
        add_forces(model, used, faces, own, total)
    return model.program()
