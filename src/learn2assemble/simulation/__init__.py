"""A cell with its arms and blocks in MuJoCo, seen by nobody but through readings."""
