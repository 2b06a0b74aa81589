"""Physics by name."""

from __future__ import annotations

from collections.abc import Callable

from learn2assemble.errors import UnknownNameError
from learn2assemble.physics.protocol import Physics
from learn2assemble.physics.static import StaticPhysics
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
