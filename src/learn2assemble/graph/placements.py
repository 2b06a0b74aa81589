"""The distinct placements of a graph: one representative action for every resulting structure.

Many actions (block, reference, relation) put like objects into the same cells. Of |U| x |P| x Na
actions a structure of cubes has only a few dozen distinct ones. With a gripper, what fills the same
cells by another grip is another placement, and so is what the hand holds by another cell; of like
objects it takes one that it can get at. They are read from the graph alone: no rule, no physics, so
placements that are blocked or float are among them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from learn2assemble.graph.features import Graph
from learn2assemble.graph.placement_keys import (
    MAX_CELLS,
    cell_key,
    enter,
    fill_cells,
    object_offsets,
)
from learn2assemble.graph.representatives import choose
from learn2assemble.world.actions import DIRECTIONS, Ways
from learn2assemble.world.rules import waiting_level


class Placements(NamedTuple):
    """Distinct placements of a batch of graphs, padded to the largest row.

    ``K`` cells and ``P`` placements a row at most; a placement fills up to ``C`` of the cells. For
    cubes every placement is one cell.
    """

    cells: np.ndarray
    """float32[B, K, 3]: centres of all cells some placement fills, then of those that only placed
    blocks fill [m, world]."""
    num_cells: np.ndarray
    """int64[B]."""
    action: np.ndarray
    """int64[B, P, 3]: node action of the first placement found with this result."""
    members: np.ndarray
    """int64[B, P, C]: cells it fills, the chosen block's first; -1 beyond."""
    count: np.ndarray
    """int64[B]."""
    key: np.ndarray
    """uint64[B, P]: number of the result; equal for actions with the same result and grip."""

    @property
    def used(self) -> np.ndarray:
        """bool[B, P]."""
        return np.arange(self.action.shape[1]) < self.count[:, None]


@njit(cache=True, inline="always")
def _enter_cell(table, stamp, stamps, keys, cell, cells, count):
    """Number of a cell among ``cells`` float32[K, 3], ``count`` of which are known; a new one is
    entered as the next. -1 where there is no room."""
    number = enter(table, stamp, stamps, keys, cell_key(cell[0], cell[1], cell[2]), count)
    if number == count:
        if number >= len(cells):
            return -1
        for axis in range(3):
            cells[number, axis] = cell[axis]
    return number


@njit(cache=True)
def _enumerate(
    nodes, object_id, num_targets, num_placed, num_nodes, ways,
    out_cells, num_cells, out_action, out_members, count, out_key,
):  # fmt: skip
    """Write all rows; returns False where the arrays are too small."""
    slots = 4 * out_action.shape[1]
    tables = np.empty((3, slots), np.int64)
    stamps = np.full((3, slots), -1, np.int64)
    keys = np.empty((3, slots), np.uint64)
    grips, rotations = ways.grips, len(ways.turns)
    best = np.empty((nodes.shape[1], rotations), np.int64)
    offsets = np.empty((rotations, MAX_CELLS, 3))
    cells = np.empty((MAX_CELLS, 3))
    for row in range(len(num_targets)):
        first = num_targets[row] + num_placed[row]
        shapes = choose(
            nodes[row], object_id[row], first, num_nodes[row], ways, tables[0], stamps[0], keys[0],
            row, offsets[0], best,
        )  # fmt: skip
        for shape in range(shapes):
            lift, size = 0.0, 0
            for way in range(rotations):
                block = best[shape, way]
                size = object_offsets(
                    nodes[row], object_id[row], block, first, num_nodes[row], ways, offsets[way]
                )
                # Like objects stand alike.
                lift = waiting_level(nodes[row, block, 2]) if ways.level else 0.0
            for reference in range(num_targets[row], first):
                for relation in range(len(DIRECTIONS)):
                    for way in range(rotations):
                        if way > 0 and size == 1 and grips[way] == grips[way - 1]:
                            continue  # A turned cube is the same cube.
                        key = fill_cells(
                            nodes[row], reference, relation, way, ways, offsets[way], size, lift,
                            cells,
                        )  # fmt: skip
                        n = count[row]
                        if enter(tables[1], row, stamps[1], keys[1], key, n) != n:
                            continue
                        if n >= out_action.shape[1]:
                            return False
                        out_action[row, n, 0] = best[shape, way]
                        out_action[row, n, 1] = reference
                        out_action[row, n, 2] = relation * rotations + way
                        out_key[row, n] = key
                        for k in range(size):
                            c = _enter_cell(
                                tables[2], row, stamps[2], keys[2], cells[k], out_cells[row],
                                num_cells[row],
                            )  # fmt: skip
                            if c < 0:
                                return False
                            num_cells[row] = max(num_cells[row], c + 1)
                            out_members[row, n, k] = c
                        count[row] += 1
        for block in range(num_targets[row], first):
            c = _enter_cell(
                tables[2], row, stamps[2], keys[2], nodes[row, block], out_cells[row],
                num_cells[row],
            )  # fmt: skip
            if c < 0:
                return False
            num_cells[row] = max(num_cells[row], c + 1)
    return True


def distinct_placements(graph: Graph, ways: Ways) -> Placements:
    """Enumerate the distinct placements of every row, in order of block, reference and action.

    Args:
        ways: what the actions mean, :attr:`Task.ways`.
    """
    batch, capacity = len(graph.num_nodes), 256
    while True:
        out = Placements(
            np.zeros((batch, capacity, 3), np.float32),
            np.zeros(batch, np.int64),
            np.zeros((batch, capacity, 3), np.int64),
            np.full((batch, capacity, MAX_CELLS), -1, np.int64),
            np.zeros(batch, np.int64),
            np.empty((batch, capacity), np.uint64),
        )
        if _enumerate(
            graph.nodes, graph.object_id, graph.num_targets, graph.num_placed, graph.num_nodes,
            ways, *out,
        ):  # fmt: skip
            break
        capacity *= 2
    most_cells, most = max(1, int(out.num_cells.max())), max(1, int(out.count.max()))
    members = out.members[:, :most]
    largest = max(1, int((members >= 0).any((0, 1)).sum()))
    return Placements(
        out.cells[:, :most_cells], out.num_cells, out.action[:, :most], members[..., :largest],
        out.count, out.key[:, :most],
    )  # fmt: skip


@njit(cache=True)
def _locate(nodes, object_id, num_targets, num_placed, num_nodes, ways, action, count, keys, out):
    offsets = np.empty((MAX_CELLS, 3))
    cells = np.empty((MAX_CELLS, 3))
    for row in range(len(action)):
        first = num_targets[row] + num_placed[row]
        size = object_offsets(
            nodes[row], object_id[row], action[row, 0], first, num_nodes[row], ways, offsets
        )
        relation, way = divmod(action[row, 2], len(ways.turns))
        lift = waiting_level(nodes[row, action[row, 0], 2]) if ways.level else 0.0
        key = fill_cells(
            nodes[row], action[row, 1], relation, way, ways, offsets, size, lift, cells
        )
        for n in range(count[row]):
            if keys[row, n] == key:
                out[row] = n
                break


def locate(placements: Placements, graph: Graph, action: np.ndarray, ways: Ways) -> np.ndarray:
    """Number of the placement that has the result of each node action int64[B, 3]: int64[B].

    -1 where none has it.
    """
    out = np.full(len(action), -1, np.int64)
    _locate(
        graph.nodes, graph.object_id, graph.num_targets, graph.num_placed, graph.num_nodes,
        ways, action, placements.count, placements.key, out,
    )  # fmt: skip
    return out
