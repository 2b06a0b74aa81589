"""Physical constants, and the cube that a block is where nothing else is said."""

EDGE = 0.05
"""Edge of the cube [m]."""
HALF = EDGE / 2
MASS = 0.1
"""Its mass [kg]."""
FRICTION = 1.0
"""Its coefficient of friction."""
GRAVITY = 9.81
"""Gravity [m/s^2] (the published simulation of the tasks has its own)."""
