r"""A better bond with the same blocks: layers exchange blocks, a few layers at a time.

Where a heap is limited, which layer gets which block decides how many joints can be bridged. With
:math:`g_e` the number of chosen blocks that fill both cells of an edge :math:`e` between
neighbouring cells (0 or 1), a joint that is continued in the next layer is

.. math:: u_e \ge 1 - g_e^{z} - g_e^{z+1}, \quad u_e \ge 0 ,

which is linear, so one program decides neighbouring layers together. It uses exactly the blocks
that these layers have, and the layers around them stay as they are.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import chain

import numpy as np

from learn2assemble.assembly.kit import Kit
from learn2assemble.planning.programs import INF, Clock, Model, solve
from learn2assemble.planning.tiling import (
    COSTS,
    BlockPlacement,
    Candidates,
    Tiling,
    filled_pairs,
    find_candidates,
    find_seams,
    from_below,
    owners,
    standing_cost,
)

MAX_CANDIDATES, MAX_EDGES, PASSES = 1500, 320, 2
"""Places of blocks in layers that are decided together and edges between their cells, more of which
take minutes; and how often all layers are gone through."""
_SECONDS = 6.0
"""Of one program; where one takes longer, the layers stay as they are from there on."""

_Layers = list[list[BlockPlacement]]


def improve_bond(tiling: Tiling, kit: Kit, clock: Clock) -> Tiling:
    """The same blocks, filling the same cells and bridging more joints, where any do.

    Blocks taller than a layer are left as they are.
    """
    wanted = tiling.wanted
    if not kit.flat:
        return tiling
    layers = [[block for block in tiling.placements if block.origin[2] == z]
              for z in range(wanted.shape[2])]  # fmt: skip
    _improve(layers, wanted, kit, clock)
    return replace(tiling, placements=from_below(chain.from_iterable(layers)))


def _improve(layers: _Layers, wanted: np.ndarray, kit: Kit, clock: Clock) -> None:
    found = find_candidates(wanted, kit, flat_only=True)
    price = standing_cost(found)
    size = np.bincount(found.origin[:, 2], minlength=len(layers))
    started = clock.spent
    for _ in range(PASSES):
        low, better = 0, False
        while low < len(size):
            high = low + max(1, int((np.cumsum(size[low:]) <= MAX_CANDIDATES).sum()))
            before = _continued(layers, wanted, kit, low, high)
            if before and size[low:high].sum() <= MAX_CANDIDATES and clock.left > 0:
                made = _window(layers, wanted, kit, found, price, low, high, clock)
                if made is None and clock.spent - started > _SECONDS:
                    return
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


def _seams(layers: _Layers, wanted: np.ndarray, kit: Kit) -> tuple[np.ndarray, np.ndarray]:
    return find_seams(owners(chain.from_iterable(layers), kit, wanted.shape))


def _continued(layers: _Layers, wanted: np.ndarray, kit: Kit, low: int, high: int) -> int:
    """Joints at, below and above the layers ``low`` to ``high`` that the next layer continues."""
    low, high = max(low - 1, 0), min(high + 1, len(layers))
    return sum(int((seam[:, :, low : high - 1] & seam[:, :, low + 1 : high]).sum())
               for seam in _seams(layers, wanted, kit))  # fmt: skip


def _window(
    layers: _Layers, wanted: np.ndarray, kit: Kit, found: Candidates, price: np.ndarray, low: int,
    high: int, clock: Clock,
) -> _Layers | None:  # fmt: skip
    """The blocks of the layers ``low`` to ``high``, chosen together."""
    level = found.origin[:, 2]
    keep = np.flatnonzero((level >= low) & (level < high))
    part, cost = found.take(keep), price[keep]
    inside = (np.arange(len(layers)) >= low) & (np.arange(len(layers)) < high)
    must = np.flatnonzero(wanted & inside)
    row_of_cell = np.full(wanted.size, -1)
    row_of_cell[must] = np.arange(len(must))
    used = Counter(block.kind for layer in layers[low:high] for block in layer)
    limits = [k for k, kind in enumerate(kit.kinds) if used[kind.name]]
    if not set(part.kind.tolist()) >= set(limits):
        return None
    row_of_kind = np.full(len(kit.kinds), -1)
    row_of_kind[limits] = np.arange(len(limits))
    kinds = row_of_kind[part.kind]
    # Kinds that the layers do not have may not be used: their upper bound is 0.
    has = kinds >= 0
    model = Model()
    chosen = model.columns(np.where(has, cost, 0.0), np.where(has, 1.0, 0.0), integer=True)
    model.rows(np.ones(len(must)), 1.0,
               (row_of_cell[part.cell], np.repeat(chosen, part.size()), 1.0))  # fmt: skip
    number = np.array([float(used[kit.kinds[k].name]) for k in limits])
    model.rows(number, number, (kinds[has], chosen[has], 1.0))
    # Edges that may be joints in two layers, and the rows of those below and above each layer.
    joints, extra = _seams(layers, wanted, kit), 0
    rows = [np.full((*joint.shape[:2], len(layers) + 1), -1) for joint in joints]
    for z in range(max(low, 1), min(high + 1, len(layers))):
        for axis, (first, second) in enumerate((
            (wanted[:-1], wanted[1:]), (wanted[:, :-1], wanted[:, 1:])
        )):  # fmt: skip
            edge = (first & second)[:, :, z - 1 : z + 1].all(2)
            edge &= joints[axis][:, :, z - 1] | (z - 1 >= low)
            edge &= joints[axis][:, :, z] | (z < high)
            rows[axis][edge, z] = extra + np.arange(edge.sum())
            extra += int(edge.sum())
    if extra > MAX_EDGES:
        return None
    glue = []
    for axis in (0, 1):
        which, place = filled_pairs(part, axis)
        x, y, z = place.T
        for row in (rows[axis][x, y, z], rows[axis][x, y, z + 1]):
            glue.append((row[row >= 0], which[row >= 0], 1.0))
    joined = model.columns(np.full(extra, COSTS.seam), 1.0)
    model.rows(np.ones(extra), INF, (np.arange(extra), joined, 1.0), *glue)
    answer = solve(model.program(), min(_SECONDS, clock.left), gap=0.01)
    if answer.status != "optimal" or answer.x is None:
        return None
    blocks = part.blocks(kit, np.flatnonzero(answer.x[chosen] > 0.5))
    return [[block for block in blocks if block.origin[2] == z] for z in range(low, high)]
