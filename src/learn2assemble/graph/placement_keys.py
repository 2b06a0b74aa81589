"""When two placements are the same: numbers of the cells they fill and of the grip they need."""

from __future__ import annotations

import numpy as np
from numba import njit

from learn2assemble.graph.features import Graph
from learn2assemble.world.actions import DIRECTIONS, Ways, quarter_turn
from learn2assemble.world.blocks import EDGE
from learn2assemble.world.rules import waiting_level

MAX_CELLS = 4
"""Cells of the largest object."""


@njit(cache=True, inline="always")
def _mix(value):
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))


@njit(cache=True, inline="always")
def cell_key(x, y, z):
    # In units of a tenth of a block: finer than a lattice, coarser than what settling moves. A
    # gripper may leave blocks beside their places by more, then like placements may look different.
    unit = 10.0 / EDGE
    a = np.uint64(int(np.rint(x * unit)) + (1 << 20))
    b = np.uint64(int(np.rint(y * unit)) + (1 << 20))
    c = np.uint64(int(np.rint(z * unit)) + (1 << 20))
    return _mix((a << np.uint64(42)) ^ (b << np.uint64(21)) ^ c ^ np.uint64(0x9E3779B97F4A7C15))


@njit(cache=True)
def object_offsets(nodes, object_id, block, first, used, ways, out):
    """Cells of the block's object relative to it in whole cells, itself first; their number."""
    out[0, 0], out[0, 1], out[0, 2] = 0, 0, 0
    count = 1
    for other in range(first, used):
        if other != block and object_id[other] == object_id[block]:
            for axis in range(3):
                step = ways.pitch if axis < 2 else EDGE
                out[count, axis] = np.rint((nodes[other, axis] - nodes[block, axis]) / step)
            count += 1
    return count


@njit(cache=True)
def fill_cells(nodes, reference, relation, way, ways, offsets, count, lift, cells):
    """Cells filled by a placement; gives its key.

    It is the same for the same set of cells and, where a hand holds the object, the same grip on
    the same of its cells: what one cell leaves no room for may be easy by another.
    """
    turns, pitch = ways.turns[way], ways.pitch
    key = np.uint64(ways.grips[way]) * np.uint64(0xD6E8FEB86659FD93)
    for k in range(count):
        a, b = quarter_turn(offsets[k, 0], offsets[k, 1], turns)
        cells[k, 0] = nodes[reference, 0] + pitch * (DIRECTIONS[relation, 0] + a)
        cells[k, 1] = nodes[reference, 1] + pitch * (DIRECTIONS[relation, 1] + b)
        up = EDGE * (DIRECTIONS[relation, 2] + offsets[k, 2])
        cells[k, 2] = nodes[reference, 2] + lift + up
        cell = cell_key(cells[k, 0], cells[k, 1], cells[k, 2])
        key += cell
        if k == 0 and count > 1 and ways.level:
            key += _mix(cell)
    return key


@njit(cache=True)
def enter(table, stamp, stamps, keys, key, number):
    """Number under which ``key`` is known; enters it as ``number`` where it is new.

    The tables are a power of two long and never full.
    """
    last = len(table) - 1
    slot = np.int64(key & np.uint64(last))
    while stamps[slot] == stamp:
        if keys[slot] == key:
            return table[slot]
        slot = (slot + 1) & last
    stamps[slot], keys[slot], table[slot] = stamp, key, number
    return number


@njit(cache=True)
def _keys(nodes, object_id, targets, first, used, ways, out):
    offsets = np.empty((MAX_CELLS, 3))
    cells = np.empty((MAX_CELLS, 3))
    for i in range(used - first):
        size = object_offsets(nodes, object_id, first + i, first, used, ways, offsets)
        lift = waiting_level(nodes[first + i, 2]) if ways.level else 0.0
        for j in range(first - targets):
            for k in range(out.shape[2]):
                relation, way = divmod(k, len(ways.turns))
                out[i, j, k] = fill_cells(
                    nodes, targets + j, relation, way, ways, offsets, size, lift, cells
                )


def action_keys(graph: Graph, row: int, ways: Ways) -> np.ndarray:
    """Number of the result of every legal action of a row: uint64[U, P, Na]."""
    targets, first = graph.num_targets[row], graph.num_targets[row] + graph.num_placed[row]
    used = graph.num_nodes[row]
    num_actions = len(DIRECTIONS) * len(ways.turns)
    out = np.empty((used - first, first - targets, num_actions), np.uint64)
    _keys(graph.nodes[row], graph.object_id[row], targets, first, used, ways, out)
    return out
