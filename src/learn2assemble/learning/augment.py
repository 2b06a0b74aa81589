"""Symmetries of the task without a robot: mirror images and exchanged sides.

They act on targets and placed blocks only. Waiting blocks are a heap in front of side 1 whichever
way the structure is turned, and nothing about them changes what is valid or covered.
"""

from __future__ import annotations

import numpy as np

from learn2assemble.learning.replay import Batch
from learn2assemble.world.blocks import EDGE

MIRROR = np.array([0, 2, 1, 3, 4])
"""Relative actions under x -> -x: left and right exchange."""
EXCHANGE = np.array([0, 1, 2, 4, 3])
"""Relative actions under y -> c - y: front and behind exchange."""
_AXIS = {2: EDGE, 3: None, 4: 2 * EDGE}


def random_symmetry(batch: Batch, num_sides: int, rng: np.random.Generator) -> Batch:
    """Apply to every transition its own random symmetry of a structure with ``num_sides`` sides."""
    count = len(batch.reward)
    mirror = rng.random(count) < 0.5
    axis = _AXIS.get(num_sides)
    exchange = (rng.random(count) < 0.5) & (axis is not None)
    action, valid = batch.action.copy(), batch.valid
    for chosen, permutation in ((mirror, MIRROR), (exchange, EXCHANGE)):
        action[chosen, 2] = permutation[action[chosen, 2]]
        valid = np.where(chosen[:, None, None], valid[..., permutation], valid)
    graphs = []
    for graph in (batch.graph, batch.next_graph):
        nodes = graph.nodes.copy()
        settled = np.arange(nodes.shape[1]) < (graph.num_targets + graph.num_placed)[:, None]
        flip_x = settled & mirror[:, None]
        nodes[..., 0] = np.where(flip_x, -nodes[..., 0], nodes[..., 0])
        if axis is not None:
            flip_y = settled & exchange[:, None]
            nodes[..., 1] = np.where(flip_y, axis - nodes[..., 1], nodes[..., 1])
        graphs.append(graph._replace(nodes=nodes))
    return batch._replace(graph=graphs[0], next_graph=graphs[1], action=action, valid=valid)
