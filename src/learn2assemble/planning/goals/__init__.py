"""Goals without a drawing: tasks, the relaxed plan, search, and the exact program."""
