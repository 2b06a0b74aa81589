r"""A better bond with the same blocks: layers exchange blocks, a few layers at a time.

Where a heap is limited, which layer gets which block decides how many joints can be bridged. With
:math:`g_e` the number of chosen blocks that fill both cells of an edge :math:`e` between
neighbouring cells (0 or 1), a joint that is continued in the next layer is

.. math:: u_e \ge 1 - g_e^{z} - g_e^{z+1}, \quad u_e \ge 0 ,

which is linear, so one program decides neighbouring layers together. It uses exactly the blocks
that these layers have, and the layers around them stay as they are.
"""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import replace

import numpy as np

from learn2assemble.assembly.kit import Cell, Kit, orientations
from learn2assemble.planning.programs import INF, Clock, Program, by_column, solve
from learn2assemble.planning.tiling import (
    COSTS,
    Candidates,
    Costs,
    Tiling,
    chosen_blocks,
    find_candidates,
    find_seams,
    standing_cost,
    to_placements,
)

MAX_CANDIDATES, MAX_EDGES, PASSES = 1500, 320, 2
"""Places of blocks in layers that are decided together and edges between their cells, more of which
take minutes; and how often all layers are gone through."""
_SECONDS = 6.0
"""Of one program; where one takes longer, the layers stay as they are from there on."""


def improve_bond(tiling: Tiling, kit: Kit, clock: Clock, costs: Costs = COSTS) -> Tiling:
    """The same blocks, filling the same cells and bridging more joints, where any do.

    Blocks taller than a layer are left as they are.
    """
    ways, wanted = orientations(kit), tiling.wanted
    if any(cell[2] for way in ways for cell in way.cells):
        return tiling
    number = {(kit.kinds[way.kind].name, way.turn): k for k, way in enumerate(ways)}
    chosen = [(number[block.kind, block.turn], block.origin) for block in tiling.placements]
    better = _improved(chosen, wanted, kit, costs, clock)
    return replace(tiling, placements=to_placements(better, kit))


def _improved(
    chosen: list[tuple[int, Cell]], wanted: np.ndarray, kit: Kit, costs: Costs, clock: Clock
) -> list[tuple[int, Cell]]:
    layers: list[list[tuple[int, Cell]]] = [
        [block for block in chosen if block[1][2] == z] for z in range(wanted.shape[2])
    ]
    found = find_candidates(wanted, kit, flat_only=True)
    price = standing_cost(found, costs)
    size = np.bincount(found.origin[:, 2], minlength=wanted.shape[2])
    started = clock.spent
    for _ in range(PASSES):
        low, better = 0, False
        while low < len(size):
            high = low + max(1, int((np.cumsum(size[low:]) <= MAX_CANDIDATES).sum()))
            before = _continued(layers, wanted, kit, low, high)
            if before and size[low:high].sum() <= MAX_CANDIDATES and clock.left > 0:
                made = _window(layers, wanted, kit, found, price, low, high, costs, clock)
                if made is None and clock.spent - started > _SECONDS:
                    return [block for layer in layers for block in layer]
                old = layers[low:high]
                layers[low:high] = made or old
                after = _continued(layers, wanted, kit, low, high)
                better |= after < before
                if after >= before:
                    layers[low:high] = old
            if high == len(size):
                break
            low += max(1, (high - low) // 2)
        if not better:
            break
    return [block for layer in layers for block in layer]


def _owner(layer: list[tuple[int, Cell]], shape: tuple[int, ...], kit: Kit) -> np.ndarray:
    """int64[X, Y]: which block of a layer fills each cell, -1 for none."""
    owner, ways = np.full(shape[:2], -1), orientations(kit)
    for number, (way, (x, y, _)) in enumerate(layer):
        cells = np.array(ways[way].cells)
        owner[cells[:, 0] + x, cells[:, 1] + y] = number
    return owner


def _continued(
    layers: list[list[tuple[int, Cell]]], wanted: np.ndarray, kit: Kit, low: int, high: int
) -> int:
    """Joints at, below and above the layers ``low`` to ``high`` that the next layer continues."""
    seams = [find_seams(_owner(layers[z], wanted.shape, kit))
             for z in range(max(low - 1, 0), min(high + 1, len(layers)))]  # fmt: skip
    return sum(int((a[k] & b[k]).sum()) for a, b in itertools.pairwise(seams)
               for k in (0, 1))  # fmt: skip


def _window(
    layers: list[list[tuple[int, Cell]]], wanted: np.ndarray, kit: Kit, found: Candidates,
    price: np.ndarray, low: int, high: int, costs: Costs, clock: Clock,
) -> list[list[tuple[int, Cell]]] | None:  # fmt: skip
    """The blocks of the layers ``low`` to ``high``, chosen together."""
    ways, shape = orientations(kit), wanted.shape
    keep = np.flatnonzero((found.origin[:, 2] >= low) & (found.origin[:, 2] < high))
    part, cost = found.take(keep), price[keep].copy()
    n = len(part)
    must = np.flatnonzero((wanted & _between(shape, low, high)).reshape(-1))
    row_of_cell = np.full(wanted.size, -1)
    row_of_cell[must] = np.arange(len(must))
    rows, columns = [row_of_cell[part.cell]], [np.repeat(np.arange(n), part.size())]
    kinds = np.array([way.kind for way in ways])[part.way]
    used = Counter(ways[way].kind for layer in layers[low:high] for way, _ in layer)
    limits = sorted(used)
    if not set(kinds.tolist()) >= set(limits):
        return None
    of_kind = np.full(len(kit.kinds), -1)
    of_kind[limits] = len(must) + np.arange(len(limits))
    cost[of_kind[kinds] < 0] = 0.0
    rows.append(of_kind[kinds[of_kind[kinds] >= 0]])
    columns.append(np.flatnonzero(of_kind[kinds] >= 0))
    # Kinds that the layers do not have may not be used: their upper bound is 0.
    upper = [np.where(of_kind[kinds] >= 0, 1.0, 0.0)]
    first, extra = len(must) + len(limits), 0
    glue = _glued_edges(part, shape)
    joints = [find_seams(_owner(layer, shape, kit)) for layer in layers]
    for z in range(max(low, 1), min(high + 1, shape[2])):
        for axis in (0, 1):
            pair = _filled_pairs(wanted, axis, z) & _filled_pairs(wanted, axis, z - 1)
            if z - 1 < low:
                pair = pair & joints[z - 1][axis]
            if z >= high:
                pair = pair & joints[z][axis]
            for x, y in np.argwhere(pair).tolist():
                row = first + extra
                for level in (z - 1, z):
                    mine = glue.get((axis, x, y, level)) if low <= level < high else None
                    if mine is not None:
                        rows.append(np.full(len(mine), row))
                        columns.append(mine)
                rows.append(np.array([row]))
                columns.append(np.array([n + extra]))
                extra += 1
    if extra > MAX_EDGES:
        return None
    values = [np.ones(len(row)) for row in rows]
    number = np.array([float(used[k]) for k in limits])
    ones = np.ones(len(must))
    program = Program(
        np.concatenate([cost, np.full(extra, costs.seam)]), np.zeros(n + extra),
        np.concatenate([*upper, np.ones(extra)]),
        np.concatenate([ones, number, np.ones(extra)]),
        np.concatenate([ones, number, np.full(extra, INF)]),
        *by_column(rows, columns, values, n + extra), integer=np.arange(n + extra) < n,
    )  # fmt: skip
    answer = solve(program, min(_SECONDS, clock.left), gap=0.01)
    if answer.status != "optimal" or answer.x is None:
        return None
    blocks = chosen_blocks(part, np.flatnonzero(answer.x[:n] > 0.5))
    return [[block for block in blocks if block[1][2] == z] for z in range(low, high)]


def _between(shape: tuple[int, ...], low: int, high: int) -> np.ndarray:
    level = np.arange(shape[2])
    return np.broadcast_to((level >= low) & (level < high), shape)


def _filled_pairs(wanted: np.ndarray, axis: int, z: int) -> np.ndarray:
    """bool: pairs of neighbours along an axis that are both filled at level ``z``."""
    layer = wanted[:, :, z]
    return layer[:-1] & layer[1:] if axis == 0 else layer[:, :-1] & layer[:, 1:]


def _glued_edges(
    part: Candidates, shape: tuple[int, ...]
) -> dict[tuple[int, int, int, int], np.ndarray]:
    """Candidates that fill both cells of an edge ``(axis, x, y, z)``."""
    found: dict[tuple[int, int, int, int], list[int]] = {}
    for number in range(len(part)):
        flat = part.cell[part.start[number] : part.start[number + 1]]
        own = set(zip(*(k.tolist() for k in np.unravel_index(flat, shape)), strict=True))
        for x, y, z in own:
            for axis, near in ((0, (x + 1, y, z)), (1, (x, y + 1, z))):
                if near in own:
                    found.setdefault((axis, x, y, z), []).append(number)
    return {edge: np.array(blocks) for edge, blocks in found.items()}
