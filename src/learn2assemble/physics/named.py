"""Physics by name."""

from __future__ import annotations

from collections.abc import Callable

from learn2assemble.errors import UnknownNameError
from learn2assemble.physics.protocol import Physics
from learn2assemble.physics.static import StaticPhysics


def _rigid() -> Physics:
    # MuJoCo is loaded only by those who ask for it.
    from learn2assemble.physics.rigid import RigidPhysics

    return RigidPhysics()


PHYSICS: dict[str, Callable[[], Physics]] = {"static": StaticPhysics, "rigid": _rigid}


def resolve_physics(physics: str | Physics) -> Physics:
    """A physics by name, or the one given.

    Raises:
        UnknownNameError: naming the nearest physics.
    """
    if not isinstance(physics, str):
        return physics
    if physics not in PHYSICS:
        raise UnknownNameError("physics", physics, PHYSICS)
    return PHYSICS[physics]()
