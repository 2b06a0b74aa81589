"""Physics by name."""

from __future__ import annotations

from collections.abc import Callable

from learn2assemble.errors import UnknownNameError
from learn2assemble.physics.protocol import Physics
from learn2assemble.physics.static import StaticPhysics


def _static(stability: str) -> Physics:
    return StaticPhysics()


def _rigid(stability: str) -> Physics:
    # MuJoCo is loaded only by those who ask for it.
    from learn2assemble.physics.rigid import RigidPhysics

    return RigidPhysics(stability)


PHYSICS: dict[str, Callable[[str], Physics]] = {"static": _static, "rigid": _rigid}


def resolve_physics(physics: str | Physics, stability: str = "block") -> Physics:
    """A physics by name, or the one given.

    Args:
        stability: the rule of a simulated placement, :attr:`Task.stability` of the task.

    Raises:
        UnknownNameError: naming the nearest physics.
    """
    if not isinstance(physics, str):
        return physics
    if physics not in PHYSICS:
        raise UnknownNameError("physics", physics, PHYSICS)
    return PHYSICS[physics](stability)
