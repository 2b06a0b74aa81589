"""Which blocks fill the cells."""
