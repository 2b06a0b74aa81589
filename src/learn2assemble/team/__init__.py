"""Several arms in one cell."""
