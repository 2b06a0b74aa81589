r"""Blocks chosen together with the bed forces that make them stand: one mixed-integer program.

For every block :math:`p` that may be used, with binary :math:`x_p`, weight :math:`w_p` and centre
:math:`c_p`, forces :math:`f \ge 0` at the corners of the cells below it and :math:`g \ge 0` at
those above it belong to this block alone:

.. math::

    \sum f\,(1, u - c_p) - \sum g\,(1, u - c_p) = w_p x_p\,(1, 0), \qquad \sum g \le W x_p ,

and at every corner between two cells the :math:`f` of all blocks above sum to the :math:`g` of all
blocks below. With integer :math:`x` these are the equations of :mod:`.step_proof`, so an answer
stands. Blocks outside the part that is decided again keep their place: those that rest on it with
their equations, those below as ground that bears anything. So where the part reaches up to the
top, *infeasible* proves that no tiling of the design stands.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from learn2assemble.assembly.kit import Kit, orientations
from learn2assemble.planning.mechanisms import bonded_candidates
from learn2assemble.planning.programs import INF, Program, by_column, solve
from learn2assemble.planning.step_proof import EDGE_INSET, Stack, block_masses, lies_above
from learn2assemble.planning.tiling import (
    COSTS,
    BlockPlacement,
    Costs,
    Tiling,
    chosen_blocks,
    placement_cells,
)

NEAR, LEVELS = 4, 3
"""How far round a block that falls the tiling is decided again [cells], and on how many levels."""
_GAP = 0.02
"""Share of its price by which a tiling may be dearer than the cheapest that stands."""


def region_near(tiling: Tiling, kit: Kit, blocks: list[int]) -> np.ndarray:
    """bool[X, Y, Z]: cells round ``blocks`` and above them, without cutting any block."""
    region = np.zeros(tiling.wanted.shape, bool)
    for number in blocks:
        cells = placement_cells(tiling.placements[number], kit)
        low, high = np.maximum(cells.min(0) - NEAR, 0), cells.max(0) + NEAR + 1
        bottom = int(cells[:, 2].min())
        region[low[0] : high[0], low[1] : high[1], bottom : bottom + LEVELS] = True
    return _whole_blocks(tiling, kit, region)


def region_above(tiling: Tiling, kit: Kit, blocks: list[int]) -> np.ndarray:
    """bool[X, Y, Z]: all cells from the level of the lowest of ``blocks`` on."""
    bottom = min(int(placement_cells(tiling.placements[b], kit)[:, 2].min()) for b in blocks)
    region = np.zeros(tiling.wanted.shape, bool)
    region[:, :, bottom:] = True
    return _whole_blocks(tiling, kit, region)


def _whole_blocks(tiling: Tiling, kit: Kit, region: np.ndarray) -> np.ndarray:
    region &= tiling.wanted
    touched = region.copy()
    for block in tiling.placements:
        index = tuple(placement_cells(block, kit).T)
        if touched[index].any():
            region[index] = True
    return region


def tile_standing(
    tiling: Tiling, kit: Kit, stack: Stack, region: np.ndarray, *, seconds: float = INF,
    costs: Costs = COSTS,
) -> tuple[str, Tiling | None]:  # fmt: skip
    """The tiling, with the blocks of a region chosen anew so that they stand.

    Args:
        stack: of the tiling.
        region: bool[X, Y, Z], cells of whole blocks.

    Returns:
        ``"optimal"``, ``"infeasible"`` or ``"time"``, and the tiling where there is one.
    """
    found, cost = bonded_candidates(tiling, kit, costs)
    inside = np.logical_and.reduceat(region.reshape(-1)[found.cell], found.start[:-1])
    found, cost = found.take(np.flatnonzero(inside)), cost[inside]
    blocks = tiling.placements
    anew = np.array([region[tuple(placement_cells(block, kit)[0])] for block in blocks])
    rests = lies_above(stack, np.flatnonzero(anew).tolist()) & ~anew
    stays = [block for block, again in zip(blocks, anew, strict=True) if not again]
    ways = orientations(kit)
    bodies = [
        BlockPlacement(kit.kinds[ways[way].kind].name, ways[way].turn, origin)
        for way, origin in chosen_blocks(found, np.arange(len(found)))
    ]
    bodies += [blocks[b] for b in np.flatnonzero(rests)]
    used = Counter(block.kind for block in stays)
    heap = [(kind.name, kind.count - used[kind.name]) for kind in kit.kinds
            if kind.count is not None]  # fmt: skip
    program = _program(tiling.wanted, kit, region, bodies, cost, heap)
    answer = solve(program, seconds, gap=_GAP)
    if answer.x is None:
        return answer.status, None
    made = [*stays, *(bodies[p] for p in np.flatnonzero(answer.x[: len(found)] > 0.5))]
    made.sort(key=lambda block: block.origin[::-1])
    return answer.status, replace(tiling, placements=tuple(made))


def _program(
    wanted: np.ndarray, kit: Kit, region: np.ndarray, bodies: list[BlockPlacement],
    cost: np.ndarray, heap: list[tuple[str, int]],
) -> Program:  # fmt: skip
    """Columns: whether each candidate is used, then the forces at four corners of every face.

    Args:
        bodies: the candidates, as many as ``cost`` has, then the blocks that rest on the region.
        heap: how many blocks of these kinds may be used.
    """
    n, count, shape = len(cost), len(bodies), wanted.shape
    cells = [placement_cells(block, kit) for block in bodies]
    body = np.repeat(np.arange(count), [len(c) for c in cells])
    cell = np.concatenate(cells)
    flat: np.ndarray = np.asarray(np.ravel_multi_index(tuple(cell.T), shape))
    loose = region.copy()  # cells of blocks whose balance is part of the program
    for own in cells[n:]:
        loose[tuple(own.T)] = True
    key, size = body * wanted.size + flat, wanted.size
    bottom = ~np.isin(key - 1, key) | (cell[:, 2] == 0)
    under = np.concatenate([np.ones((*shape[:2], 1), bool), wanted[:, :, :-1]], 2).reshape(-1)
    bottom &= under[flat]
    roof = np.concatenate([loose[:, :, 1:], np.zeros((*shape[:2], 1), bool)], 2).reshape(-1)
    top = roof[flat] & (~np.isin(key + 1, key) | (cell[:, 2] == shape[2] - 1))
    face = np.concatenate([np.flatnonzero(bottom), np.flatnonzero(top)])
    sign = np.where(np.arange(len(face)) < bottom.sum(), 1.0, -1.0)
    plane = flat[face] + (sign < 0)  # the cell above the face
    above_loose = loose.reshape(-1)[np.maximum(plane - 1, 0)] & (plane % shape[2] > 0)

    weight, centre = block_masses(tuple(bodies), kit, shape)
    unit = float(weight.mean())
    weight = weight / unit
    middle = centre[:, :2] / np.array(kit.pitch[:2]) + np.array(shape[:2]) / 2
    boxes = all(len(c) == np.prod(np.ptp(c, axis=0) + 1) for c in cells)
    inset = np.full(2, EDGE_INSET * min(kit.pitch[:2])) + kit.joint_gap / 2
    inset = inset / np.array(kit.pitch[:2]) if boxes else np.zeros(2)
    corner = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    corner = np.where(corner == 0, inset, 1 - inset)
    point = cell[face, None, :2] + corner  # float64[faces, 4, 2], in cells
    lever = point - middle[body[face], None]
    column = n + np.arange(4 * len(face)).reshape(-1, 4)

    must: np.ndarray = np.flatnonzero(region.reshape(-1))
    row_of_cell = np.full(size, -1)
    row_of_cell[must] = np.arange(len(must))
    optional = body < n
    rows, columns = [row_of_cell[flat[optional]]], [body[optional]]
    values = [np.ones(len(rows[0]))]

    def add(row: np.ndarray, col: np.ndarray, value: np.ndarray) -> None:
        row, col, value = np.broadcast_arrays(row, col, value)
        live = value.reshape(-1) != 0
        rows.append(row.reshape(-1)[live])
        columns.append(col.reshape(-1)[live])
        values.append(value.reshape(-1)[live].astype(float))

    first = len(must)  # balance of every body: force and two moments
    at = first + 3 * body[face]
    for k, arm in enumerate((np.ones_like(lever[:, :, 0]), lever[:, :, 0], lever[:, :, 1])):
        add(at[:, None] + k, column, sign[:, None] * arm)
    add(first + 3 * np.arange(n), np.arange(n), -weight[:n])
    balance = np.zeros((count, 3))
    balance[n:, 0] = weight[n:]
    first += 3 * count  # what is not used bears nothing
    loads = (sign < 0) & (body[face] < n)
    add((first + body[face])[loads, None], column[loads], np.ones(1))
    add(first + np.arange(n), np.arange(n), np.full(n, -float(weight.sum())))
    first += n  # action is reaction
    joined = np.flatnonzero(above_loose)
    shared, which = np.unique(plane[joined], return_inverse=True)
    row = first + 4 * which.reshape(-1)[:, None] + np.arange(4)
    add(row, column[joined], sign[joined, None])
    first += 4 * len(shared)  # the heap
    for k, (name, _) in enumerate(heap):
        mine = np.array([p for p in range(n) if bodies[p].kind == name], np.int64)
        add(np.full(len(mine), first + k), mine, np.ones(len(mine)))
    nothing = np.zeros(4 * len(shared))
    has = np.array([amount for _, amount in heap], float)
    low = np.concatenate([np.ones(len(must)), balance.reshape(-1), np.full(n, -INF), nothing,
                          np.full(len(heap), -INF)])  # fmt: skip
    high = np.concatenate([np.ones(len(must)), balance.reshape(-1), np.zeros(n), nothing,
                           np.maximum(has, 0.0)])  # fmt: skip
    forces = 4 * len(face)
    return Program(
        np.concatenate([cost, np.zeros(forces)]), np.zeros(n + forces),
        np.concatenate([np.ones(n), np.full(forces, INF)]), low, high,
        *by_column(rows, columns, values, n + forces),
        integer=np.arange(n + forces) < n,
    )  # fmt: skip
