"""Symmetries of the task without a robot: mirror images and exchanged sides (deviation D7).

They act on targets and placed blocks only. Waiting blocks are a heap in front of side 1 whichever
way the structure is turned, and nothing about them changes what is valid or covered.
"""

from __future__ import annotations

import numpy as np

from learn2assemble.graph.features import Graph
from learn2assemble.learning.replay import Batch
from learn2assemble.world.blocks import EDGE

MIRROR = np.array([0, 2, 1, 3, 4])
"""Relative actions under x -> -x: left and right exchange."""
EXCHANGE = np.array([0, 1, 2, 4, 3])
"""Relative actions under y -> c - y: front and behind exchange."""
_MIRRORED_SIDES, _EXCHANGED_SIDES = np.array([0, 1, 3, 2]), np.array([1, 0, 2, 3])
"""Which side each side becomes."""
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
        object_id = graph.object_id.copy()
        vertex = np.arange(nodes.shape[1]) < graph.num_targets[:, None]
        for chosen, permutation in ((mirror, _MIRRORED_SIDES), (exchange, _EXCHANGED_SIDES)):
            turned = vertex & chosen[:, None]
            object_id[turned] = -1 - permutation[-1 - object_id[turned]]
        return graph._replace(nodes=nodes, object_id=object_id)

    return batch._replace(
        graph=turn(batch.graph), next_graph=turn(batch.next_graph), action=action,
        searched=searched,
    )  # fmt: skip
