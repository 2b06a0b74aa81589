"""Which of like waiting objects stands for all of them, and by which of its cells it is taken."""

from __future__ import annotations

import numpy as np
from numba import njit

from learn2assemble.graph.placement_keys import cell_key, enter, object_offsets
from learn2assemble.world.actions import quarter_turn
from learn2assemble.world.blocks import EDGE

HAND_REACH, FINGER_REACH = 2.25, 1.25
"""How far from the grasped cell other ones may hinder a hand along the way its fingers close, above
that cell and beside it [pitches]."""


@njit(cache=True)
def in_the_way(nodes, object_id, block, other, turns, pitch):
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


@njit(cache=True)
def choose(nodes, object_id, first, used, ways, table, stamps, keys, stamp, offsets, best):
    """Tell shapes of waiting objects, seen from one of their cells, apart; their number.

    Of like ones each way gets the first, or for a hand the first that the fewest are in the way of.

    Args:
        best: int64[N, R], written: cell to choose for each shape and way.
    """
    shapes = 0
    rotations = len(ways.turns)
    fewest = np.empty((used - first, rotations), np.int64)
    for block in range(first, used):
        size = object_offsets(nodes, object_id, block, first, used, ways, offsets)
        key = np.uint64(0)
        for k in range(size):
            key += cell_key(EDGE * offsets[k, 0], EDGE * offsets[k, 1], EDGE * offsets[k, 2])
        shape = enter(table, stamp, stamps, keys, key, shapes)
        new = shape == shapes
        shapes += new
        if not (new or ways.level):
            continue
        for way in range(rotations):
            crowd = 0
            if ways.level:
                for other in range(first, used):
                    turns = ways.hands[way, 0]
                    crowd += in_the_way(nodes, object_id, block, other, turns, ways.pitch)
            if new or crowd < fewest[shape, way]:
                best[shape, way], fewest[shape, way] = block, crowd
    return shapes
