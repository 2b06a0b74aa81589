"""The robot: arm models, inverse kinematics, grasps, and three fidelities of pick and place."""
