"""Compiled cells, which are remembered."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from typing import NamedTuple

from learn2assemble.constants import FRICTION, GRAVITY
from learn2assemble.geometry.hulls import Hull
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.studs import Studs
from learn2assemble.simulation.model import SimulatedWorld, compile_world, hold_still
from learn2assemble.simulation.objects import Objects

_MAX_WORLDS = 32


class WorldForces(NamedTuple):
    """What acts on blocks."""

    friction: float = FRICTION
    """Between blocks, and of blocks on the table."""
    gravity: float = GRAVITY
    """[m/s^2]"""


_USUAL = WorldForces()


class Worlds:
    """Compiled cells, which are remembered.

    Args:
        arms: in all of them; ways are planned for the first one.
        forces: of the world.
    """

    arms: tuple[Arm, ...]
    forces: WorldForces

    def __init__(self, arms: Sequence[Arm], forces: WorldForces = _USUAL) -> None:
        self.arms, self.forces = tuple(arms), forces
        self._known: OrderedDict[tuple[object, int, frozenset[Hull], int], SimulatedWorld] = (
            OrderedDict()
        )

    def of(self, objects: Objects, studs: Studs | None = None) -> SimulatedWorld:
        """The compiled cell for these objects, with room for joints of studs; remembered."""
        count, joints = len(objects.still), 0 if studs is None else len(studs.joints)
        room = 64 * math.ceil(count / 64)
        hulls = objects.hulls()
        known = [
            key
            for key in self._known
            if key[0] == objects.shape and key[1] >= count and hulls <= key[2] and key[3] >= joints
        ]
        key = known[0] if known else (objects.shape, room, hulls, 32 * math.ceil(joints / 32))
        world = self._known.get(key)
        if world is None:
            friction, gravity = self.forces
            shape = objects.shape
            world = compile_world(self.arms, shape, friction, room, hulls, gravity, key[3])
            self._known[key] = world
            if len(self._known) > _MAX_WORLDS:
                self._known.popitem(last=False)
        if world.num_still:
            hold_still(world, objects)
        return world
