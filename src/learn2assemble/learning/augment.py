"""Symmetries of the task without a robot: mirror images and exchanged sides (deviation D7).

They act on targets and placed blocks only. Waiting blocks are a heap in front of side 1 whichever
way the structure is turned, and nothing about them changes what is valid or covered.
"""

from __future__ import annotations

import numpy as np

from learn2assemble.graph.features import Graph
from learn2assemble.learning.replay import Batch
from learn2assemble.world.blocks import EDGE
from learn2assemble.world.prospects import Prospects

MIRROR = np.array([0, 2, 1, 3, 4])
"""Relative actions under x -> -x: left and right exchange."""
EXCHANGE = np.array([0, 1, 2, 4, 3])
"""Relative actions under y -> c - y: front and behind exchange."""
_MIDDLE = {2: EDGE, 4: 2 * EDGE}
"""c for the structures that exchange maps onto themselves."""


def random_symmetry(batch: Batch, num_sides: int, rng: np.random.Generator) -> Batch:
    """Apply to every transition its own random symmetry of a structure with ``num_sides`` sides."""
    count = len(batch.reward)
    mirror = rng.random(count) < 0.5
    exchange = (rng.random(count) < 0.5) & (num_sides in _MIDDLE)
    middle = _MIDDLE.get(num_sides, 0.0)
    action = batch.action.copy()
    for chosen, permutation in ((mirror, MIRROR), (exchange, EXCHANGE)):
        action[chosen, 2] = permutation[action[chosen, 2]]

    def permute(prospects: Prospects | None) -> Prospects | None:
        if prospects is None:
            return None
        for chosen, permutation in ((mirror, MIRROR), (exchange, EXCHANGE)):
            swap = chosen[:, None, None]
            prospects = Prospects(*[np.where(swap, a[..., permutation], a) for a in prospects])
        return prospects

    searched = batch.searched
    if searched is not None:
        explored = searched.action.copy()
        for chosen, permutation in ((mirror, MIRROR), (exchange, EXCHANGE)):
            explored[chosen, :, 2] = permutation[explored[chosen, :, 2]]
        searched = searched._replace(action=explored)

    def turn(graph: Graph) -> Graph:
        nodes = graph.nodes.copy()
        settled = np.arange(nodes.shape[1]) < (graph.num_targets + graph.num_placed)[:, None]
        x, y = nodes[..., 0], nodes[..., 1]
        nodes[..., 0] = np.where(settled & mirror[:, None], -x, x)
        nodes[..., 1] = np.where(settled & exchange[:, None], middle - y, y)
        return graph._replace(nodes=nodes)

    return batch._replace(
        graph=turn(batch.graph), next_graph=turn(batch.next_graph), action=action,
        prospects=permute(batch.prospects), next_prospects=permute(batch.next_prospects),
        searched=searched,
    )  # fmt: skip
