"""The motion of an arm: recorded, written to files, and made into programs within limits."""
