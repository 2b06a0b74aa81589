"""Joints that hold: the balance of blocks that clutch, or stand in mortar."""
