"""Checks of stability of the lattice world: the column rule, an equilibrium program, MuJoCo."""
