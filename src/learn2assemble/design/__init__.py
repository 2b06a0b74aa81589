"""What people draw, as cells to fill and cells to leave empty."""
