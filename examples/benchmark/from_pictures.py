"""A policy that sees pictures in place of states.

    l2a benchmark run seen.jsonl.gz --policy examples/benchmark/from_pictures.py:Seen

Of what may be put down it takes the lowest, and of those what covers most that is wanted and not
there yet. The channels of a picture are what is wanted, what is there, and what waits.
"""

import numpy as np


class Seen:
    """Number of an action; without ``begin`` it is told no more than what it sees."""

    observations = "picture"

    def __call__(self, observation, info):
        mask = info["action_masks"]
        stands = info.get("physics_mask", mask)
        boxes = observation["boxes"]
        allowed = np.flatnonzero((stands if stands.any() else mask) & boxes.any((1, 2)))
        if not len(allowed):
            return int(np.flatnonzero(mask)[0])
        wanted, there, _ = observation["picture"].astype(int).transpose(2, 0, 1)
        missing = np.pad(np.maximum(wanted - there, 0).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
        top, left, bottom, right = boxes[allowed].round().astype(int).transpose(2, 0, 1)
        gain = missing[bottom, right] - missing[top, right] - missing[bottom, left]
        gain = (gain + missing[top, left]).sum(1)
        # Elevations count rows from above.
        lowest = boxes[allowed][..., 2].max(1).round(1)
        useful = gain > 0
        return int(allowed[np.lexsort((-gain, -lowest, ~useful))[0]])
