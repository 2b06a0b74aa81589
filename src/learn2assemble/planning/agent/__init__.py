"""The learned builder of designs: tasks, world, network, search and training."""
