"""The motion of an arm: recorded, written to files, and turned into programs within limits."""
