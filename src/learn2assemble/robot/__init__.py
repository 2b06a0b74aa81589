"""Arms and tools as data, and what picking and placing a block comes to."""
