"""The wing of the paper: its tasks, their world, networks, search, learning and evaluation.

Most of it needs the extra ``learn``. The product, from a design to the program of a robot, imports
nothing of it.
"""
