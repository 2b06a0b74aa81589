"""From cells and a kit to blocks in an order: the room where planning knows a lattice."""
