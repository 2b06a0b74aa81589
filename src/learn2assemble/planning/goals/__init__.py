"""Goals without a drawing: tasks, the relaxed plan, search, network, and the exact program."""
