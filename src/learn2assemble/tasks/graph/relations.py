"""How cells lie to outlines and blocks, seen from each side, and what is around the hand that
places an object there (deviation D23).

Relations to a side are in its viewer's frame (x right, depth towards the viewer, z up) relative to
the cell, so they do not change when the structure is turned with its sides.

Whether a gripper has room depends on the axis its fingers close along, so what is around the hand
is in the frame of the hand over the target, relative to the cell it holds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.constants import EDGE, HALF
from learn2assemble.kernels import kernel
from learn2assemble.tasks.graph.features import Graph
from learn2assemble.tasks.graph.placements import Placements, in_the_way
from learn2assemble.tasks.world.blocks import ActionSpec, quarter_turn
from learn2assemble.tasks.world.coverage import pixel_vertex, unproject
from learn2assemble.tasks.world.layouts import side_frames

EDGE_FEATURES = 13
"""Inward normal (right, up); how far the cell's centre is inside the line of the edge, and its most
inward corner (coarse and, times eight, fine); both ends of the edge (right, up); how far the cell
stands before the face plane, and whether it lies in it; whether the edge is one of the roof of a
five-sided outline, which binds only its own columns; height of the cell. Lengths in block edges,
clipped and scaled to about one."""
_NORMAL, _INSIDE, _MARGIN, _FINE_MARGIN, _BEGIN, _END = 0, 2, 3, 4, 5, 7
"""The features by name; normals and ends have two numbers."""
_DEPTH, _IN_PLANE, _ROOF, _HEIGHT = range(9, EDGE_FEATURES)
REACH = 3
"""Offsets between a cell and a placed block are told apart up to this many blocks."""
WINDOW = 2 * REACH + 1
OFFSETS = WINDOW**3


class Relations(NamedTuple):
    """``K`` cells, ``S`` sides, ``E`` edges a side at most, ``M`` placed blocks at most."""

    edges: np.ndarray
    """float32[B, K, S, E, EDGE_FEATURES]."""
    edge_used: np.ndarray
    """bool[B, S, E]."""
    offsets: np.ndarray
    """int64[B, K, S, M]: number of the offset of every placed block, ``OFFSETS`` beyond."""
    area: np.ndarray
    """float32[B]: area of all outlines [block faces]."""


@kernel(inline="always")
def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


@kernel
def _line(a: np.ndarray, b: np.ndarray, turn: float, x: float, z: float, out: np.ndarray) -> None:
    """The first nine features: the edge from corner ``a`` to ``b`` seen from the cell (x, z)."""
    ax, az = (a[0] - x) / EDGE, (a[1] - z) / EDGE
    bx, bz = (b[0] - x) / EDGE, (b[1] - z) / EDGE
    length = max(np.sqrt((bx - ax) ** 2 + (bz - az) ** 2), 1e-6)
    # ``turn`` makes the normal point inward whichever way round the outline is listed.
    normal_x, normal_z = -turn * (bz - az) / length, turn * (bx - ax) / length
    inside = -(ax * normal_x + az * normal_z)
    margin = inside + 0.5 * (abs(normal_x) + abs(normal_z))
    out[_NORMAL], out[_NORMAL + 1] = normal_x, normal_z
    out[_INSIDE] = _clip(inside, 4.0) / 2
    out[_MARGIN] = _clip(margin, 1.0)
    out[_FINE_MARGIN] = _clip(8 * margin, 1.0)
    out[_BEGIN], out[_BEGIN + 1] = _clip(ax, 6.0) / 2, _clip(az, 6.0) / 2
    out[_END], out[_END + 1] = _clip(bx, 6.0) / 2, _clip(bz, 6.0) / 2


@kernel
def offset_number(right: float, out: float, up: float, pitch: float) -> int:
    """Number of an offset [m] to the right, outward and up, in whole cells up to ``REACH``."""
    i = int(_clip(np.rint(right / pitch), REACH)) + REACH
    j = int(_clip(np.rint(out / pitch), REACH)) + REACH
    k = int(_clip(np.rint(up / EDGE), REACH)) + REACH
    return (i * WINDOW + j) * WINDOW + k


@kernel
def _relate(
    graph: Graph,
    cells: np.ndarray,
    num_cells: np.ndarray,
    frames: np.ndarray,
    pitch: float,
    sight: float,
    out: Relations,
) -> None:
    nodes, object_id, num_targets, num_placed, _ = graph
    edges, edge_used, offsets, total_area = out
    most_edges = edges.shape[3]
    corner = np.empty((most_edges, 2))
    for row in range(len(num_targets)):
        targets, placed = num_targets[row], num_placed[row]
        first = 0
        # The corners of an outline follow each other and share a number, one for each side.
        while first < targets:
            side = -1 - object_id[row, first]
            last = first
            while last < targets and object_id[row, last] == object_id[row, first]:
                last += 1
            # The viewer's right and the outward normal; the camera stands before the middle of the
            # side, which the rounding to pixels needs.
            right_x, right_y = frames[side, 0], frames[side, 1]
            out_x, out_y = right_y, -right_x
            middle_x, middle_y = frames[side, 2], frames[side, 3]
            area = 0.0
            # Corners are taken where the mask shows them, as rewards are counted in its pixels.
            for k in range(last - first):
                node = nodes[row, first + k]
                x = (node[0] - middle_x) * right_x + (node[1] - middle_y) * right_y
                u, v = pixel_vertex(x, node[2])  # where the mask has it
                corner[k, 0], corner[k, 1] = unproject(u, v)
            for k in range(last - first):
                n = (k + 1) % (last - first)
                area += corner[k, 0] * corner[n, 1] - corner[n, 0] * corner[k, 1]
                edge_used[row, side, k] = True
            turn = -1.0 if area < 0 else 1.0
            total_area[row] += abs(area) / (2 * EDGE * EDGE)
            for c in range(num_cells[row]):
                dx = cells[row, c, 0] - nodes[row, first, 0]
                dy = cells[row, c, 1] - nodes[row, first, 1]
                depth = (dx * out_x + dy * out_y + HALF) / EDGE
                x = (cells[row, c, 0] - middle_x) * right_x
                x += (cells[row, c, 1] - middle_y) * right_y
                z = cells[row, c, 2]
                for k in range(last - first):
                    n = (k + 1) % (last - first)
                    edge = edges[row, c, side, k]
                    _line(corner[k], corner[n], turn, x, z, edge)
                    edge[_DEPTH] = _clip(depth, 2.0)
                    edge[_IN_PLANE] = 1.0 if abs(depth) < 0.25 else 0.0
                    edge[_ROOF] = 1.0 if last - first == 5 and (k == 1 or k == 2) else 0.0
                    edge[_HEIGHT] = z / EDGE / 4
                for b in range(placed):
                    node = nodes[row, targets + b]
                    dx, dy = node[0] - cells[row, c, 0], node[1] - cells[row, c, 1]
                    # What is out of sight keeps the number beyond all offsets.
                    if max(abs(dx) / pitch, abs(dy) / pitch, abs(node[2] - z) / EDGE) > sight:
                        continue
                    offsets[row, c, side, b] = offset_number(
                        dx * right_x + dy * right_y, dx * out_x + dy * out_y, node[2] - z, pitch
                    )
            first = last


def relate(graph: Graph, placements: Placements, pitch: float = EDGE, sight: int = 0) -> Relations:
    """Relations of every cell of ``placements`` to its graph.

    Args:
        pitch: horizontal distance of the centres of neighbouring cells [m].
        sight: cells do not look at blocks farther than this many cells along any axis; 0: at all.
    """
    batch, most = placements.cells.shape[:2]
    targets = np.arange(int(graph.nodes.shape[1])) < graph.num_targets[:, None]
    side = np.where(targets, -1 - graph.object_id, -1)
    sides = int(side.max()) + 1
    most_edges = max(int((side == s).sum(1).max()) for s in range(sides))
    out = Relations(
        np.zeros((batch, most, sides, most_edges, EDGE_FEATURES), np.float32),
        np.zeros((batch, sides, most_edges), np.bool_),
        np.full((batch, most, sides, int(graph.num_placed.max())), OFFSETS, np.int64),
        np.zeros(batch, np.float32),
    )
    frames, seen = side_frames(sides, pitch), sight + 0.5 if sight else np.inf
    _relate(graph, placements.cells, placements.num_cells, frames, pitch, seen, out)
    return out


KINDS = 3
"""Told apart: placed blocks, the other cells of the object, and what is in the way where it waits.
"""
AROUND = KINDS * OFFSETS
PLACE_FEATURES = 6


class Hands(NamedTuple):
    """``B`` graphs, ``P`` placements a graph at most, ``L`` cells around a hand at most."""

    around: np.ndarray
    """int64[B, P, L]: number of the offset of every placed block, then, ``OFFSETS`` further, of
    every other cell of the object, then, ``OFFSETS`` further again and as the hand sees it that
    picks, of every waiting cell in the way; ``AROUND`` beyond. In the order of
    :mod:`learn2assemble.tasks.graph.relations`, with the hand's x for right and its -y for
    outward."""
    place: np.ndarray
    """float32[B, P, 6]: where the grasped cell would stand and where it waits [m, world]: an arm
    does not reach everywhere."""


@kernel
def _seen(origin: np.ndarray, other: np.ndarray, turns: int, pitch: float) -> int:
    """Number of the offset from ``origin`` to ``other`` [m] for a hand turned by quarter turns."""
    x, y = quarter_turn(other[0] - origin[0], other[1] - origin[1], -turns % 4)
    return offset_number(x, -y, other[2] - origin[2], pitch)


@kernel
def _look(graph: Graph, placements: Placements, spec: ActionSpec, hands: Hands) -> int:
    nodes, object_id, num_targets, num_placed, num_nodes = graph
    cells, _, action, members, count, _ = placements
    around, place = hands
    most = 0
    for row in range(len(count)):
        first = num_targets[row]
        end = first + num_placed[row]
        for n in range(count[row]):
            block = action[row, n, 0]
            pick, put = spec.hands[action[row, n, 2] % len(spec.turns)]
            held = cells[row, members[row, n, 0]]
            for axis in range(3):
                place[row, n, axis] = held[axis]
                place[row, n, 3 + axis] = nodes[row, block, axis]
            # Three kinds follow one another without gaps; numbers tell them apart.
            out, last = around[row, n], 0
            for other in range(first, end):
                out[last] = _seen(held, nodes[row, other], put, spec.pitch)
                last += 1
            for k in range(1, members.shape[2]):
                if members[row, n, k] >= 0:
                    out[last] = OFFSETS
                    out[last] += _seen(held, cells[row, members[row, n, k]], put, spec.pitch)
                    last += 1
            for other in range(end, num_nodes[row]):
                if in_the_way(nodes[row], object_id[row], block, other, pick, spec.pitch):
                    out[last] = 2 * OFFSETS
                    out[last] += _seen(nodes[row, block], nodes[row, other], pick, spec.pitch)
                    last += 1
            most = max(most, last)
    return most


def look_around(graph: Graph, placements: Placements, spec: ActionSpec) -> Hands:
    """What the hand meets at every placement of ``placements``, those of ``graph``.

    Args:
        spec: what the actions mean, :attr:`Task.action_spec`.
    """
    batch, most, largest = placements.members.shape
    length = int((graph.num_nodes - graph.num_targets).max()) + largest
    out = Hands(
        np.full((batch, most, length), AROUND, np.int64),
        np.zeros((batch, most, PLACE_FEATURES), np.float32),
    )
    used = _look(graph, placements, spec, out)
    return out._replace(around=out.around[..., :used])
