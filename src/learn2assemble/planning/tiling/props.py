"""Temporary blocks: which stacks of them carry what cannot be put down on its own."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from learn2assemble.assembly.kit import Cell, Kit, orientations
from learn2assemble.linear_programs import INF, Clock, Model, solve
from learn2assemble.planning.tiling.cover.candidates import (
    BlockPlacement,
    from_below,
    placement_cells,
)
from learn2assemble.planning.tiling.cover.tile import Tiling
from learn2assemble.planning.tiling.cover.ways import support_margin
from learn2assemble.planning.tiling.ordering import leaves, way_out

FIRM = 1e-9
"""How far inside its support a centroid has to be [cells]."""


def unsupported(tiling: Tiling, kit: Kit) -> list[int]:
    """Blocks whose centroid is not above what carries them: they need a prop to be put down."""
    found = list[int]()
    for number, block in enumerate(tiling.placements):
        cells, carried = _carried(tiling, kit, block)
        if not block.prop and support_margin(cells, carried, kit) <= FIRM:
            found.append(number)
    return found


def _carried(tiling: Tiling, kit: Kit, block: BlockPlacement) -> tuple[np.ndarray, np.ndarray]:
    """Cells of a block, and which of them rest on the design or the table."""
    cells = placement_cells(block, kit)
    own = {tuple(cell) for cell in cells.tolist()}
    carried = [
        z == 0 or ((x, y, z - 1) not in own and bool(tiling.wanted[x, y, z - 1]))
        for x, y, z in cells.tolist()
    ]
    return cells, np.array(carried)


def choose_props(
    tiling: Tiling,
    kit: Kit,
    demands: dict[int, frozenset[int]],
    seconds: float = INF,
    largest: int | None = None,
) -> list[BlockPlacement] | None:
    """The fewest temporary blocks under blocks that cannot be put down on their own.

    A prop is a stack of like blocks from the table, or from the top of the structure, up to the
    underside of what it carries. Which stacks to use is a set-cover program.

    Args:
        tiling: without props.
        demands: which blocks need one; any block of the value will do as the one propped up.
        largest: most cells of a prop. Stacks that what they carry would wall in are not used.

    Returns:
        blocks from below; None where no stack reaches some demand or the heap has too few.
    """
    clock, barred = Clock(seconds), set[BlockPlacement]()
    while demands:
        made = _fewest_props(tiling, kit, demands, clock.left, barred, largest)
        if made is None:
            return None
        cells = {block: placement_cells(block, kit) for block in made}
        top = {block: _top_of_stack(block, tuple(made)) for block in made}
        barred |= (
            walled := {
                block
                for block in set(top.values())
                if not way_out(tiling.wanted[:, :, : block.origin[2] + 2], cells[block])
            }
        )
        caught = (
            []
            if walled
            else [
                len(cells[block])
                for level in sorted({block.origin[2] for block in top.values()})
                for block in _caught(tiling.wanted[:, :, : level + 2], cells)
                if top[block].origin[2] == level
            ]
        )
        if caught:
            # Props that keep one another in are made smaller.
            largest = max(caught) - 1
        elif not walled:
            return made
    return []


def _top_of_stack(block: BlockPlacement, placements: tuple[BlockPlacement, ...]) -> BlockPlacement:
    """The uppermost of the like props that stand on one another with ``block`` among them."""
    there, (x, y, z) = set(placements), block.origin
    while replace(block, origin=(x, y, z + 1)) in there:
        z += 1
    return replace(block, origin=(x, y, z))


def _caught(wanted: np.ndarray, props: dict[BlockPlacement, np.ndarray]) -> set[BlockPlacement]:
    """Those of ``props`` (with their cells) that cannot be moved out, one after the other."""
    filled, left = wanted.copy(), dict[BlockPlacement, np.ndarray]()
    for block, cells in sorted(props.items(), key=lambda item: -item[0].origin[2]):
        left[block] = cells[cells[:, 2] < wanted.shape[2]]
        filled[tuple(left[block].T)] = True
    while free := [b for b, cells in left.items() if len(cells) and leaves(filled, cells)]:
        for block in free:
            filled[tuple(left.pop(block).T)] = False
    return set(left)


def _fewest_props(
    tiling: Tiling,
    kit: Kit,
    demands: dict[int, frozenset[int]],
    seconds: float,
    barred: Collection[BlockPlacement],
    largest: int | None,
) -> list[BlockPlacement] | None:
    """:func:`choose_props`, without the stacks with the uppermost blocks ``barred``."""
    wanted, blocks = tiling.wanted, tiling.placements
    heap = {kind.name: kind.count for kind in kit.kinds if kind.count is not None}
    for block in blocks:
        if block.kind in heap:
            heap[block.kind] -= 1
    stacks: dict[tuple[int, int, int, int], int] = {}
    serves: list[tuple[int, int]] = []
    ways = orientations(kit)
    need = sorted(demands)
    for row, demand in enumerate(need):
        for number in sorted(demands[demand]):
            cells, carried = _carried(tiling, kit, blocks[number])
            own = {tuple(cell) for cell in cells.tolist()}
            under = np.array([(x, y, z - 1) not in own for x, y, z in cells.tolist()])
            firm = support_margin(cells, carried, kit) > FIRM
            for stack in _stacks_below(wanted, kit, cells[under]):
                way, x, y, z = stack
                kind = kit.kinds[ways[way].kind].name
                top = BlockPlacement(kind, ways[way].turn, (x, y, z - 1), True)
                if top in barred or (largest is not None and len(ways[way].cells) > largest):
                    continue
                foot = {(x + u, y + v, z) for u, v, _ in ways[way].cells}
                held = carried | np.array([tuple(cell) in foot for cell in cells.tolist()])
                if firm or support_margin(cells, held & under, kit) > FIRM:
                    serves.append((row, stacks.setdefault(stack, len(stacks))))
    if {row for row, _ in serves} != set(range(len(need))):
        return None
    listed = list(stacks)
    bottoms = [_base(wanted, kit, ways[way].cells, x, y, z) for way, x, y, z in listed]
    # Of equally many blocks, the widest stack stands best.
    height = np.array(
        [z - (b or 0) for (_, _, _, z), b in zip(listed, bottoms, strict=True)], float
    )
    width = np.array([len(ways[way].cells) for way, *_ in listed])
    model = Model()
    used = model.columns(height - 1e-3 * width / width.max(), 1.0, integer=True)
    row, column = np.array(sorted(set(serves))).T
    model.rows(np.ones(len(need)), INF, (row, column, 1.0))
    cell_rows: dict[Cell, int] = {}
    taken = [
        (cell_rows.setdefault((x + u, y + v, w), len(cell_rows)), number)
        for number, ((way, x, y, z), base) in enumerate(zip(listed, bottoms, strict=True))
        for u, v, _ in ways[way].cells
        for w in range(base or 0, z)
    ]
    row, column = np.array(taken).T
    model.rows(np.full(len(cell_rows), -INF), 1.0, (row, column, 1.0))
    kinds = [kit.kinds[ways[way].kind].name for way, *_ in listed]
    for name in sorted(heap):
        mine = np.flatnonzero(np.array(kinds) == name)
        model.rows(-INF, float(max(heap[name], 0)), (0, used[mine], height[mine]))
    answer = solve(model.program(), seconds)
    if answer.x is None:
        return None
    made = list[BlockPlacement]()
    for number in np.flatnonzero(answer.x > 0.5):
        way, x, y, z = listed[number]
        made += [
            BlockPlacement(kinds[number], ways[way].turn, (x, y, w), True)
            for w in range(bottoms[number] or 0, z)
        ]
    return list(from_below(made))


def _stacks_below(
    wanted: np.ndarray, kit: Kit, under: np.ndarray
) -> list[tuple[int, int, int, int]]:
    """``way, x, y, z`` of flat stacks with their top at ``z`` under one of the cells ``under``."""
    found = list[tuple[int, int, int, int]]()
    for number, way in enumerate(orientations(kit)):
        if any(cell[2] for cell in way.cells):
            continue
        places = {(x - u, y - v, z) for x, y, z in under.tolist() if z for u, v, _ in way.cells}
        for x, y, z in sorted(places):
            if _base(wanted, kit, way.cells, x, y, z) is not None:
                found.append((number, x, y, z))
    return found


def _base(
    wanted: np.ndarray, kit: Kit, cells: tuple[Cell, ...], x: int, y: int, z: int
) -> int | None:
    """Lowest level of a stack of flat blocks up to ``z``; None where it cannot stand there."""
    at = np.array(cells, np.int64)[:, :2] + np.array((x, y))
    if (at < 0).any() or (at >= wanted.shape[:2]).any():
        return None
    column = wanted[at[:, 0], at[:, 1], :z]
    filled = np.flatnonzero(column.any(0))
    base = int(filled[-1]) + 1 if len(filled) else 0
    if base >= z:
        return None
    carried = np.ones(len(at), bool) if base == 0 else wanted[at[:, 0], at[:, 1], base - 1]
    return base if support_margin(np.array(cells), carried, kit) > FIRM else None
