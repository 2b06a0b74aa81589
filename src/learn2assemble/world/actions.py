"""Placements: which unplaced block, against which placed block, in which relation (protocol 5)."""

from __future__ import annotations

import numpy as np

RELATIONS = ("top", "left", "right", "front", "behind")
"""Names of the five relative placements, in the order of the action index."""

DIRECTIONS = np.array([[0, 0, 1], [-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0]], np.float64)
"""float64[5, 3]: unit direction of each relation in the reference block's frame."""
