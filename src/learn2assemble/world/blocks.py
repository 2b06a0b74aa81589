"""The primitive block (protocol 1.1)."""

EDGE = 0.05
"""Edge of a block [m]."""
HALF = EDGE / 2
MASS = 0.1
"""Mass of a block [kg]."""
FRICTION = 1.0
GRAVITY = 10.0
"""Gravity of the published simulation [m/s^2] (not 9.81)."""
