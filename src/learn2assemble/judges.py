"""Judges of placements by name: physics, and the arm at its fidelities.

A task without an arm is judged by ``static`` or ``rigid`` physics. With one, these names mean the
kinematic cell with that judge of balance; ``kinematic`` is another word for ``static`` then,
``dynamic`` simulates arm and blocks together, and ``published`` is the fast mode of the authors.
"""

from __future__ import annotations

from collections.abc import Callable

from learn2assemble.errors import InputError, look_up
from learn2assemble.physics.named import resolve_physics
from learn2assemble.physics.protocol import Physics
from learn2assemble.task import Task

BALANCE = {"static": "static", "rigid": "rigid", "kinematic": "static"}
"""What judges balance beside the kinematic cell."""


def _kinematic(task: Task, balance: str) -> Physics:
    # MuJoCo is loaded only by those who ask for it.
    from learn2assemble.robot.arm import get_arm
    from learn2assemble.robot.grasps import get_grasps
    from learn2assemble.robot.judge import ArmPhysics
    from learn2assemble.robot.kinematic import KinematicCell

    cell = KinematicCell(get_arm(task.arm), task.max_blocks)
    balance_judge = resolve_physics(balance, task.stability, task.pitch)
    return ArmPhysics(cell, get_grasps(task.grasps), balance_judge)


CELLS: dict[str, Callable[[Task], Physics]] = {}
"""Judges that find out about balance themselves."""
JUDGES = (*BALANCE, *CELLS)
"""All names."""


def resolve_judge(judge: str | Physics | None, task: Task) -> Physics:
    """A judge by name, the one given, or by default static physics, with the task's arm if any.

    Raises:
        UnknownNameError: naming the nearest judge.
        InputError: for a robot cell where the task has no arm.
    """
    if judge is not None and not isinstance(judge, str):
        return judge
    name = "static" if judge is None else judge
    look_up("physics", name, dict.fromkeys(JUDGES))
    if not task.has_arm:
        if name not in ("static", "rigid"):
            raise InputError("physics", name, f"static or rigid ({task.name} has no arm)")
        return resolve_physics(name, task.stability, task.pitch)
    return CELLS[name](task) if name in CELLS else _kinematic(task, BALANCE[name])
