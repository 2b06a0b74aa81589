"""What is around the hand that would place an object, seen by the hand (deviation D23).

Whether a gripper has room is decided by what stands along the way its fingers close. The viewer's
frames of the sides cannot say: which of them is which carries no meaning, so four sides a quarter
turn apart leave no axis. Here everything is in the frame of the hand over the target, relative to
the cell it holds, so it does not change when the world is turned together with the hand.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from learn2assemble.graph.features import Graph
from learn2assemble.graph.placements import Placements
from learn2assemble.graph.relations import OFFSETS, offset_number
from learn2assemble.graph.representatives import in_the_way
from learn2assemble.world.actions import Ways, quarter_turn

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
    :mod:`learn2assemble.graph.relations`, with the hand's x for right and its -y for outward."""
    place: np.ndarray
    """float32[B, P, 6]: where the grasped cell would stand and where it waits [m, world]: an arm
    does not reach everywhere."""


@njit(cache=True)
def _seen(origin, other, turns, pitch):
    """Number of the offset from ``origin`` to ``other`` [m] for a hand turned by quarter turns."""
    x, y = quarter_turn(other[0] - origin[0], other[1] - origin[1], -turns % 4)
    return offset_number(x, -y, other[2] - origin[2], pitch)


@njit(cache=True)
def _look(
    nodes, object_id, num_targets, num_placed, num_nodes, cells, action, members, count, ways,
    around, place,
):  # fmt: skip
    most = 0
    for row in range(len(count)):
        first = num_targets[row]
        end = first + num_placed[row]
        for n in range(count[row]):
            block = action[row, n, 0]
            pick, put = ways.hands[action[row, n, 2] % len(ways.turns)]
            held = cells[row, members[row, n, 0]]
            for axis in range(3):
                place[row, n, axis] = held[axis]
                place[row, n, 3 + axis] = nodes[row, block, axis]
            out, last = around[row, n], 0
            for other in range(first, end):
                out[last] = _seen(held, nodes[row, other], put, ways.pitch)
                last += 1
            for k in range(1, members.shape[2]):
                if members[row, n, k] >= 0:
                    out[last] = OFFSETS
                    out[last] += _seen(held, cells[row, members[row, n, k]], put, ways.pitch)
                    last += 1
            for other in range(end, num_nodes[row]):
                if in_the_way(nodes[row], object_id[row], block, other, pick, ways.pitch):
                    out[last] = 2 * OFFSETS
                    out[last] += _seen(nodes[row, block], nodes[row, other], pick, ways.pitch)
                    last += 1
            most = max(most, last)
    return most


def look_around(graph: Graph, placements: Placements, ways: Ways) -> Hands:
    """What the hand meets at every placement of ``placements``, those of ``graph``.

    Args:
        ways: what the actions mean, :attr:`Task.ways`.
    """
    batch, most, largest = placements.members.shape
    length = int((graph.num_nodes - graph.num_targets).max()) + largest
    out = Hands(
        np.full((batch, most, length), AROUND, np.int64),
        np.zeros((batch, most, PLACE_FEATURES), np.float32),
    )
    used = _look(
        graph.nodes, graph.object_id, graph.num_targets, graph.num_placed, graph.num_nodes,
        placements.cells, placements.action, placements.members, placements.count, ways, *out,
    )  # fmt: skip
    return out._replace(around=out.around[..., :used])
