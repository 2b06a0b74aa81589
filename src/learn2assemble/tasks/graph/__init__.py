"""State to graph: node features, connectivity and batches for the networks."""
