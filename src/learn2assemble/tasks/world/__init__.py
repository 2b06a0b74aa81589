"""The block world: sides, targets, waiting layouts, state, placements and rewards."""
