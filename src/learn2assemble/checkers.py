"""Placement checkers by name: physics, and the arm at its fidelities.

Placements of a task without an arm are checked by ``static`` or ``rigid`` physics. With one, these
names mean the kinematic workcell with that check of balance; ``kinematic`` means ``static`` then,
``dynamic`` simulates arm and blocks together, and ``published`` is the fast mode of the authors.
"""

from __future__ import annotations

from collections.abc import Callable

from learn2assemble.errors import InputError, UnknownNameError, look_up
from learn2assemble.physics.protocol import Physics
from learn2assemble.physics.static import StaticPhysics
from learn2assemble.registry import Registry
from learn2assemble.tasks import Task
from learn2assemble.world.blocks import EDGE


def _static(stability: str, pitch: float) -> Physics:
    return StaticPhysics()


def _rigid(stability: str, pitch: float) -> Physics:
    # MuJoCo is loaded only by those who ask for it.
    from learn2assemble.physics.rigid import RigidPhysics

    return RigidPhysics(stability, pitch=pitch)


PHYSICS: dict[str, Callable[[str, float], Physics]] = {"static": _static, "rigid": _rigid}


def resolve_physics(
    physics: str | Physics, stability: str = "block", pitch: float = EDGE
) -> Physics:
    """A physics by name, or the one given.

    Args:
        stability: the rule of a simulated placement, :attr:`Task.stability` of the task.
        pitch: horizontal distance of neighbouring cells, :attr:`Task.pitch` of the task [m].

    Raises:
        UnknownNameError: naming the nearest physics.
    """
    if not isinstance(physics, str):
        return physics
    if physics not in PHYSICS:
        raise UnknownNameError("physics", physics, PHYSICS)
    return PHYSICS[physics](stability, pitch)


BALANCE = {"static": "static", "rigid": "rigid", "kinematic": "static"}
"""What checks balance beside the kinematic workcell."""


def _kinematic(task: Task, balance: str) -> Physics:
    # MuJoCo is loaded only by those who ask for it.
    from learn2assemble.robot.arm import get_arm
    from learn2assemble.robot.checker import ArmPhysics
    from learn2assemble.robot.grasps import get_grasps
    from learn2assemble.robot.kinematic import KinematicCell

    cell = KinematicCell(get_arm(task.arm), task.max_blocks)
    balance_check = resolve_physics(balance, task.stability, task.pitch)
    return ArmPhysics(cell, get_grasps(task.grasps), balance_check)


def _dynamic(task: Task) -> Physics:
    from learn2assemble.robot.arm import get_arm
    from learn2assemble.robot.checker import ArmPhysics
    from learn2assemble.robot.dynamic.cell import DynamicCell
    from learn2assemble.robot.dynamic.execution import ONE_SIDED
    from learn2assemble.robot.grasps import get_grasps

    rule = ONE_SIDED if task.num_sides == 1 else None
    # What the hand does where nothing is near changes nothing for the blocks.
    cell = DynamicCell(get_arm(task.arm), shift_rule=rule, skip_free_motion=True)
    return ArmPhysics(cell, get_grasps(task.grasps))


CELLS: Registry[Callable[[Task], Physics]] = Registry("physics", {"dynamic": _dynamic})
"""Checkers that find out about balance themselves."""


def checker_names() -> tuple[str, ...]:
    """Every name that :func:`resolve_checker` knows."""
    return (*BALANCE, *CELLS)


def resolve_checker(checker: str | Physics | None, task: Task) -> Physics:
    """A checker by name, the one given, or by default static physics, with the task's arm if any.

    Raises:
        UnknownNameError: naming the nearest checker.
        InputError: for a robot cell where the task has no arm.
    """
    if checker is not None and not isinstance(checker, str):
        return checker
    name = "static" if checker is None else checker
    look_up("physics", name, dict.fromkeys(checker_names()))
    if not task.has_arm:
        if name not in ("static", "rigid"):
            raise InputError("physics", name, f"static or rigid ({task.name} has no arm)")
        return resolve_physics(name, task.stability, task.pitch)
    return CELLS[name](task) if name in CELLS else _kinematic(task, BALANCE[name])
