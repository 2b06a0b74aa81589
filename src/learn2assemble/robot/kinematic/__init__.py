"""The kinematic cell: inverse kinematics and collision checks, no dynamics."""
