"""Controllers of robots as plants: what is sensed and carried out goes over the network.

Every module is one make; it is loaded when its scheme is used, and needs the extra of that name.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from learn2assemble.plants.plant import Plant
    from learn2assemble.plants.setup import Setup
    from learn2assemble.registry import Registry


def register_plant(table: Registry[object]) -> None:
    """Add the addresses ``ur://``, ``ros2://`` and ``franka://``."""
    table.register("ur", _ur)
    table.register("ros2", _ros2)
    table.register("franka", _franka)


def _ur(place: str, setup: Setup) -> Plant:
    from learn2assemble.controllers.ur import UrPlant

    return UrPlant(place, setup)


def _ros2(place: str, setup: Setup) -> Plant:
    from learn2assemble.controllers.ros2 import RosPlant

    return RosPlant(place, setup)


def _franka(place: str, setup: Setup) -> Plant:
    from learn2assemble.controllers.franka import FrankaPlant

    return FrankaPlant(place, setup)
