"""The distinct placements of a graph: one representative action for every resulting structure.

Many actions (block, reference, relation) put like objects into the same cells; of |U| x |P| x Na
actions a structure of cubes has only a few dozen distinct ones. With a gripper, placements that
differ by the grip or by the cell the hand holds are distinct; of like objects one that it can
reach is taken. No rule and no physics is asked, so blocked and floating placements are included.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.constants import EDGE
from learn2assemble.kernels import kernel
from learn2assemble.tasks.graph.features import Graph
from learn2assemble.tasks.world.blocks import DIRECTIONS, MAX_CELLS, ActionSpec, quarter_turn
from learn2assemble.tasks.world.rules import waiting_level


@kernel(inline="always")
def _mix(value: np.uint64) -> np.uint64:
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))


@kernel(inline="always")
def cell_key(x: float, y: float, z: float) -> np.uint64:
    # In units of a tenth of a block: finer than a lattice, coarser than what settling moves. A
    # gripper may leave blocks beside their places by more, then like placements may look different.
    unit = 10.0 / EDGE
    a = np.uint64(int(np.rint(x * unit)) + (1 << 20))
    b = np.uint64(int(np.rint(y * unit)) + (1 << 20))
    c = np.uint64(int(np.rint(z * unit)) + (1 << 20))
    return _mix((a << np.uint64(42)) ^ (b << np.uint64(21)) ^ c ^ np.uint64(0x9E3779B97F4A7C15))


@kernel
def object_offsets(
    nodes: np.ndarray,
    object_id: np.ndarray,
    block: int,
    first: int,
    used: int,
    spec: ActionSpec,
    out: np.ndarray,
) -> int:
    """Cells of the block's object relative to it in whole cells, itself first; their number."""
    out[0, 0], out[0, 1], out[0, 2] = 0, 0, 0
    count = 1
    for other in range(first, used):
        if other != block and object_id[other] == object_id[block]:
            for axis in range(3):
                step = spec.pitch if axis < 2 else EDGE
                out[count, axis] = np.rint((nodes[other, axis] - nodes[block, axis]) / step)
            count += 1
    return count


@kernel
def fill_cells(
    nodes: np.ndarray,
    reference: int,
    relation: int,
    way: int,
    spec: ActionSpec,
    offsets: np.ndarray,
    count: int,
    lift: float,
    cells: np.ndarray,
) -> np.uint64:
    """Cells filled by a placement; gives its key.

    It is the same for the same set of cells and, where a hand holds the object, the same grip on
    the same of its cells: what one cell leaves no room for may be easy by another.
    """
    turns, pitch = spec.turns[way], spec.pitch
    key = np.uint64(spec.grips[way]) * np.uint64(0xD6E8FEB86659FD93)
    for k in range(count):
        a, b = quarter_turn(offsets[k, 0], offsets[k, 1], turns)
        cells[k, 0] = nodes[reference, 0] + pitch * (DIRECTIONS[relation, 0] + a)
        cells[k, 1] = nodes[reference, 1] + pitch * (DIRECTIONS[relation, 1] + b)
        up = EDGE * (DIRECTIONS[relation, 2] + offsets[k, 2])
        cells[k, 2] = nodes[reference, 2] + lift + up
        cell = cell_key(cells[k, 0], cells[k, 1], cells[k, 2])
        key += cell
        if k == 0 and count > 1 and spec.level:
            key += _mix(cell)
    return key


@kernel
def enter(
    table: np.ndarray, stamp: int, stamps: np.ndarray, keys: np.ndarray, key: np.uint64, number: int
) -> int:
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


@kernel
def _keys(
    nodes: np.ndarray,
    object_id: np.ndarray,
    targets: int,
    first: int,
    used: int,
    spec: ActionSpec,
    out: np.ndarray,
) -> None:
    offsets = np.empty((MAX_CELLS, 3))
    cells = np.empty((MAX_CELLS, 3))
    for i in range(used - first):
        size = object_offsets(nodes, object_id, first + i, first, used, spec, offsets)
        lift = waiting_level(nodes[first + i, 2]) if spec.level else 0.0
        for j in range(first - targets):
            for k in range(out.shape[2]):
                relation, way = divmod(k, len(spec.turns))
                out[i, j, k] = fill_cells(
                    nodes, targets + j, relation, way, spec, offsets, size, lift, cells
                )


def action_keys(graph: Graph, row: int, spec: ActionSpec) -> np.ndarray:
    """Number of the result of every legal action of a row: uint64[U, P, Na]."""
    targets, first = graph.num_targets[row], graph.num_targets[row] + graph.num_placed[row]
    used = graph.num_nodes[row]
    num_actions = len(DIRECTIONS) * len(spec.turns)
    out = np.empty((used - first, first - targets, num_actions), np.uint64)
    _keys(graph.nodes[row], graph.object_id[row], targets, first, used, spec, out)
    return out


HAND_REACH, FINGER_REACH = 2.25, 1.25
"""How far from the grasped cell other ones may hinder a hand along the way its fingers close, above
that cell and beside it [pitches]."""


@kernel
def in_the_way(
    nodes: np.ndarray, object_id: np.ndarray, block: int, other: int, turns: int, pitch: float
) -> bool:
    """Whether a waiting cell of another object is where a hand comes down that grasps ``block``.

    Beside it along the way the fingers close, that is what the fingers meet or, a level higher,
    what the width of the hand does.
    """
    up = nodes[other, 2] - nodes[block, 2]
    if object_id[other] == object_id[block] or up < -0.5 * EDGE:
        return False
    x, y = nodes[other, 0] - nodes[block, 0], nodes[other, 1] - nodes[block, 1]
    x, y = quarter_turn(x, y, -turns % 4)
    reach = HAND_REACH if up > 0.5 * EDGE else FINGER_REACH
    return abs(x) < 0.75 * pitch and abs(y) < reach * pitch


@kernel
def choose(
    nodes: np.ndarray,
    object_id: np.ndarray,
    first: int,
    used: int,
    spec: ActionSpec,
    table: np.ndarray,
    stamps: np.ndarray,
    keys: np.ndarray,
    stamp: int,
    offsets: np.ndarray,
    best: np.ndarray,
) -> int:
    """Tell shapes of waiting objects, seen from one of their cells, apart; their number.

    Of like ones each way gets the first, or for a hand the first that the fewest are in the way of.

    Args:
        best: int64[N, R], written: cell to choose for each shape and way.
    """
    shapes = 0
    rotations = len(spec.turns)
    fewest = np.empty((used - first, rotations), np.int64)
    for block in range(first, used):
        size = object_offsets(nodes, object_id, block, first, used, spec, offsets)
        key = np.uint64(0)
        for k in range(size):
            key += cell_key(EDGE * offsets[k, 0], EDGE * offsets[k, 1], EDGE * offsets[k, 2])
        shape = enter(table, stamp, stamps, keys, key, shapes)
        new = shape == shapes
        shapes += new
        if not (new or spec.level):
            continue
        for way in range(rotations):
            crowd = 0
            if spec.level:
                for other in range(first, used):
                    turns = spec.hands[way, 0]
                    crowd += in_the_way(nodes, object_id, block, other, turns, spec.pitch)
            if new or crowd < fewest[shape, way]:
                best[shape, way], fewest[shape, way] = block, crowd
    return shapes


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
    count: np.ndarray  # pyright: ignore[reportIncompatibleMethodOverride]
    """int64[B]."""
    key: np.ndarray
    """uint64[B, P]: number of the result; equal for actions with the same result and grip."""

    @property
    def used(self) -> np.ndarray:
        """bool[B, P]."""
        return np.arange(int(self.action.shape[1])) < self.count[:, None]


@kernel(inline="always")
def _enter_cell(
    table: np.ndarray,
    row: int,
    stamps: np.ndarray,
    keys: np.ndarray,
    cell: np.ndarray,
    cells: np.ndarray,
    num_cells: np.ndarray,
) -> int:
    """Number of a cell among the ``num_cells[row]`` known ones in ``cells`` float32[K, 3]; a new
    one is entered as the next. -1 where there is no room."""
    count = num_cells[row]
    number = enter(table, row, stamps, keys, cell_key(cell[0], cell[1], cell[2]), count)
    if number == count:
        if number >= len(cells):
            return -1
        num_cells[row] += 1
        for axis in range(3):
            cells[number, axis] = cell[axis]
    return number


@kernel
def _enumerate(graph: Graph, spec: ActionSpec, out: Placements) -> bool:
    """Write all rows; returns False where the arrays are too small."""
    nodes, object_id, num_targets, num_placed, num_nodes = graph
    out_cells, num_cells, out_action, out_members, count, out_key = out
    slots = 4 * out_action.shape[1]
    tables = np.empty((3, slots), np.int64)
    stamps = np.full((3, slots), -1, np.int64)
    keys = np.empty((3, slots), np.uint64)
    grips, rotations = spec.grips, len(spec.turns)
    best = np.empty((nodes.shape[1], rotations), np.int64)
    offsets = np.empty((rotations, MAX_CELLS, 3))
    cells = np.empty((MAX_CELLS, 3))
    for row in range(len(num_targets)):
        first = num_targets[row] + num_placed[row]
        shapes = choose(
            nodes[row],
            object_id[row],
            first,
            num_nodes[row],
            spec,
            tables[0],
            stamps[0],
            keys[0],
            row,
            offsets[0],
            best,
        )
        for shape in range(shapes):
            lift, size = 0.0, 0
            for way in range(rotations):
                block = best[shape, way]
                size = object_offsets(
                    nodes[row], object_id[row], block, first, num_nodes[row], spec, offsets[way]
                )
                # Like objects stand alike.
                lift = waiting_level(nodes[row, block, 2]) if spec.level else 0.0
            for reference in range(num_targets[row], first):
                for relation in range(len(DIRECTIONS)):
                    for way in range(rotations):
                        if way > 0 and size == 1 and grips[way] == grips[way - 1]:
                            continue  # A turned cube is the same cube.
                        key = fill_cells(
                            nodes[row],
                            reference,
                            relation,
                            way,
                            spec,
                            offsets[way],
                            size,
                            lift,
                            cells,
                        )
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
                                tables[2],
                                row,
                                stamps[2],
                                keys[2],
                                cells[k],
                                out_cells[row],
                                num_cells,
                            )
                            if c < 0:
                                return False
                            out_members[row, n, k] = c
                        count[row] += 1
        for block in range(num_targets[row], first):
            if (
                _enter_cell(
                    tables[2], row, stamps[2], keys[2], nodes[row, block], out_cells[row], num_cells
                )
                < 0
            ):
                return False
    return True


def distinct_placements(graph: Graph, spec: ActionSpec) -> Placements:
    """Enumerate the distinct placements of every row, in order of block, reference and action.

    Args:
        spec: what the actions mean, :attr:`Task.action_spec`.
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
        if _enumerate(graph, spec, out):
            break
        capacity *= 2
    most_cells, most = max(1, int(out.num_cells.max())), max(1, int(out.count.max()))
    members = out.members[:, :most]
    largest = max(1, int((members >= 0).any((0, 1)).sum()))
    return Placements(
        out.cells[:, :most_cells],
        out.num_cells,
        out.action[:, :most],
        members[..., :largest],
        out.count,
        out.key[:, :most],
    )


@kernel
def _locate(
    graph: Graph,
    spec: ActionSpec,
    action: np.ndarray,
    count: np.ndarray,
    keys: np.ndarray,
    out: np.ndarray,
) -> None:
    nodes, object_id, num_targets, num_placed, num_nodes = graph
    offsets = np.empty((MAX_CELLS, 3))
    cells = np.empty((MAX_CELLS, 3))
    for row in range(len(action)):
        first = num_targets[row] + num_placed[row]
        size = object_offsets(
            nodes[row], object_id[row], action[row, 0], first, num_nodes[row], spec, offsets
        )
        relation, way = divmod(action[row, 2], len(spec.turns))
        lift = waiting_level(nodes[row, action[row, 0], 2]) if spec.level else 0.0
        key = fill_cells(
            nodes[row], action[row, 1], relation, way, spec, offsets, size, lift, cells
        )
        for n in range(count[row]):
            if keys[row, n] == key:
                out[row] = n
                break


def locate(
    placements: Placements, graph: Graph, action: np.ndarray, spec: ActionSpec
) -> np.ndarray:
    """Number of the placement that has the result of each node action int64[B, 3]: int64[B].

    -1 where none has it.
    """
    out = np.full(len(action), -1, np.int64)
    _locate(graph, spec, action, placements.count, placements.key, out)
    return out
