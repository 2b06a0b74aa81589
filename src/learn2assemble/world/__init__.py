"""The block world: sides, targets, waiting layouts, state, placements and rewards."""

EDGE = 0.05
"""Edge of a block [m]."""
