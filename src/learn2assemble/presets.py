"""The paper's tasks by name. Adding one is one line.

The label "a-b blocks" fixes the number of nodes: N = a + 5 S = b + 3 S for S sides (protocol 0).
Tasks on grids larger than the training grid draw only shapes that leave the 3x3 box
(protocol 13.8).
"""

from __future__ import annotations

from learn2assemble.errors import UnknownNameError
from learn2assemble.task import Task

_ALL = (
    Task("two-sided-3x3-20-24", num_sides=2, grid=3, num_nodes=30),
    Task("two-sided-3x3-30-34", num_sides=2, grid=3, num_nodes=40),
    Task("two-sided-4x4-20-24", num_sides=2, grid=4, num_nodes=30, unseen_shapes_only=True),
    Task("two-sided-4x4-30-34", num_sides=2, grid=4, num_nodes=40, unseen_shapes_only=True),
    Task("two-sided-5x5-40-44", num_sides=2, grid=5, num_nodes=50, unseen_shapes_only=True),
    Task("one-sided-3x3-22-24", num_sides=1, grid=3, num_nodes=27, layout="rows"),
    Task("four-sided-3x3-10-18", num_sides=4, grid=3, num_nodes=30),
    Task("four-sided-5x5-30-38", num_sides=4, grid=5, num_nodes=50, unseen_shapes_only=True),
)

PRESETS: dict[str, Task] = {task.name: task for task in _ALL}


def get_task(name: str) -> Task:
    """The preset called ``name``.

    Raises:
        UnknownNameError: naming the nearest preset.
    """
    if name not in PRESETS:
        raise UnknownNameError("task", name, PRESETS)
    return PRESETS[name]
