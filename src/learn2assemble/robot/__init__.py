"""The robot cell: arms, their kinematics, and what picking and placing a block comes to."""
