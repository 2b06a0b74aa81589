"""Graphs turned about the vertical axis together with their sides."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.constants import EDGE
from learn2assemble.tasks.graph.features import Graph

_MIDDLE = {2: EDGE / 2, 4: EDGE}
_NEXT = {2: {0: 1, 1: 0}, 4: {0: 2, 2: 1, 1: 3, 3: 0}}
"""Which side stands where each side stood after a half turn (two sides), a quarter (four)."""


class Turn(NamedTuple):
    graph: Graph
    sides: list[int]
    """Which side each side becomes."""
    middle: float
    quarters: int

    def points(self, world: np.ndarray) -> np.ndarray:
        """Where points (x, y, z) [m] go."""
        x, y = world[..., 0], world[..., 1] - self.middle
        for _ in range(self.quarters):
            x, y = -y, x
        return np.stack([x, y + self.middle, world[..., 2]], -1)


def turned_graph(graph: Graph, num_sides: int, quarters: int) -> Turn:
    """Targets and placed blocks turned by quarter turns to the left; waiting blocks stay.

    Vertices stay listed side by side, as an observation lists them.
    """
    sides = list(range(num_sides))
    for _ in range(quarters // (4 // num_sides)):
        sides = [_NEXT[num_sides][side] for side in sides]
    nodes, object_id = graph.nodes.copy(), graph.object_id.copy()
    turn = Turn(
        graph._replace(nodes=nodes, object_id=object_id), sides, _MIDDLE[num_sides], quarters
    )
    for row, (targets, placed) in enumerate(zip(graph.num_targets, graph.num_placed, strict=True)):
        settled = slice(0, int(targets + placed))
        nodes[row, settled, :3] = turn.points(graph.nodes[row, settled, :3].astype(float))
        ids = np.array([-1 - sides[-1 - n] for n in graph.object_id[row, :targets].tolist()])
        order = np.argsort(-ids, kind="stable")
        nodes[row, :targets] = nodes[row, :targets][order]
        object_id[row, :targets] = ids[order]
    return turn
