"""Bricks on a lattice of studs: their files, their sizes, and which clutch which."""
