"""A heuristic in the benchmark: of what stands, the lowest, and of those the largest.

    l2a benchmark run lowest-largest.jsonl.gz --policy examples/benchmark/lowest_largest.py:choose

It uses what any policy is told. Blocks of the tasks of placements are cubes; there it stays within
the outline of the target, the nearest to its middle first.
"""

import numpy as np


def choose(observation, info):
    """Number of an action."""
    if "blocks" in observation:
        # Given blocks, numbered from below; the first action behind theirs is to be done.
        count = len(observation["blocks"])
        offered = np.flatnonzero(info["action_masks"][:count])
        if not len(offered):
            return count
        height = observation["blocks"][offered, 2].round(3)
        size = observation["blocks"][offered, 3:5].prod(1)
        return int(offered[np.lexsort((-size, height))[0]])
    if "placements" not in observation:
        # Candidates of a design are offered lowest first; the first feature is their size.
        offered = np.flatnonzero(info["action_masks"])
        return int(offered[np.argmax(observation["candidates"][offered[:4], 0])])
    stands = np.flatnonzero(info["physics_mask"])
    if not len(stands):
        return int(np.flatnonzero(info["action_masks"])[0])
    place = observation["placements"][stands]
    outside = np.full(len(stands), np.inf)
    for side in range(1, 5):
        corners = observation["nodes"][observation["object_id"] == -side, :3]
        corners = corners[: observation["num_targets"]]
        if len(corners):
            low, high = corners.min(0) - 0.03, corners.max(0) + 0.03
            beyond = np.maximum(low - place, 0) + np.maximum(place - high, 0)
            outside = np.minimum(outside, np.abs(beyond).sum(1).round(2))
    middle = np.linalg.norm(place[:, :2] - place[:, :2].mean(0), axis=1)
    return int(stands[np.lexsort((middle, place[:, 2].round(3), outside))[0]])
