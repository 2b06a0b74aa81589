"""Whether blocks stand on some patches of contact, and which sideways acceleration they withstand.

Rigid-block equilibrium comes first, then the coupled analysis, which refuses what stands only by
friction that squeezes itself; both are programs of :mod:`.block_forces`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from learn2assemble.assembly.blocks import Assembly, check_friction
from learn2assemble.assembly.contacts import Contacts
from learn2assemble.assembly.hands import Hand
from learn2assemble.geometry.circles import inner_circle
from learn2assemble.statics.forces.block_forces import MOST_G, Equilibrium, System
from learn2assemble.statics.forces.hands import NO_HANDS

STIFFNESS = (1.0, 0.2)
"""Tangential over normal stiffness of a joint; a fixed point with either one is one."""
_MARGIN_GAP = 0.01
_FIRST = np.pi / 8 + np.pi / 2 * np.arange(4)
"""Directions looked at first [rad]: across none of the sides of what is built along x and y, or
halfway between, so that each finds a corner of the set of accelerations."""
_LOADS = (4, 40, 30_000)
"""Of a margin: fewest and most directions, and corners times directions in between."""


def _standing(
    method: Literal["frictionless", "rbe", "cra"], forces: np.ndarray, stiffness: float = 0.0
) -> Equilibrium:
    return Equilibrium(True, method, 0.0, np.empty(0, np.int64), forces, stiffness)


def solve(
    assembly: Assembly,
    contacts: Contacts,
    friction: float | None = None,
    *,
    present: np.ndarray | None = None,
    held: np.ndarray | None = None,
    hands: Mapping[int, Hand] = NO_HANDS,
    coupled: bool = True,
    stiffness: tuple[float, ...] = STIFFNESS,
) -> Equilibrium:
    """Whether the blocks stand on some patches of contact.

    Args:
        assembly: blocks where they stand.
        contacts: of that assembly; those of absent blocks are ignored.
        friction: Coulomb coefficient instead of the assembly's.
        present: bool[B], the blocks that are there; all by default.
        held: bool[B], those of them that a hand holds.
        hands: what the hands can give; a block that is held by any other bears any load.
        coupled: False answers by RBE alone, which refutes but cannot prove.
        stiffness: tangential over normal stiffness of the joints, in the order they are tried.

    Raises:
        Learn2AssembleError: where the solver fails.
    """
    friction = assembly.friction if friction is None else friction
    check_friction(friction)
    system = System(assembly, contacts, present, held, hands)
    found = answer(system, friction, stiffness if coupled else ())
    return found if isinstance(found, Equilibrium) else lacking(system, friction, found)


LastForces = list[tuple[float, np.ndarray]]
"""By the stiffness of joints, forces that the coupled analysis has reached where it finds none."""


def answer(
    system: System, friction: float, stiffness: tuple[float, ...] = STIFFNESS
) -> Equilibrium | LastForces:
    """The answer, but for what lacks where that takes another program; RBE's alone without any
    ``stiffness`` (see :func:`solve`)."""
    if system.count == 0:
        return _standing("frictionless", system.newtons(None))
    if system.upright:
        # Forces that need no friction are a fixed point.
        still = system.nearest(0.0)
        if still is not None:
            return _standing("frictionless", system.newtons(still))
    if not stiffness:
        forces = system.nearest(friction)
        if forces is not None:
            return _standing("rbe", system.newtons(forces))
    for ratio in stiffness:
        stands, forces = system.coupled(friction, ratio)
        if stands:
            return _standing("cra", system.newtons(forces), ratio)
    forces, held, motion = system.least_holding(friction)
    if system.excess(held) > 1:
        return system.fall("rbe", forces, held, motion)
    if not stiffness:
        return _standing("rbe", system.newtons(forces))
    found: LastForces = []
    for ratio in stiffness:
        stands, last = system.coupled(friction, ratio, forces)
        if stands:
            return _standing("cra", system.newtons(last), ratio)
        found.append((ratio, last))
    return found


def lacking(system: System, friction: float, found: LastForces) -> Equilibrium:
    """The answer where the coupled analysis finds no forces."""
    lacks = [system.held_back(friction, last, ratio) for ratio, last in found]
    return system.fall("cra", *min(lacks, key=lambda one: one[1].sum()))


def margin(
    assembly: Assembly,
    contacts: Contacts,
    friction: float | None = None,
    *,
    present: np.ndarray | None = None,
    held: np.ndarray | None = None,
    hands: Mapping[int, Hand] = NO_HANDS,
) -> float:
    """Sideways acceleration [g] that RBE withstands in every direction, from below.

    The accelerations that contact forces can balance are a convex set. Each program gives a point
    of its border and a line that it does not cross, so the largest circle about zero is known from
    both sides. The next direction is the one in which the hull of the points is nearest to zero,
    until both agree to 1 % or as many as the size allows were tried. Arguments as :func:`solve`.
    """
    friction = assembly.friction if friction is None else friction
    check_friction(friction)
    system = System(assembly, contacts, present, held, hands)
    if system.count == 0:
        return min(friction, MOST_G)
    fewest, most, work = _LOADS
    tries = int(np.clip(work // max(system.corners, 1), fewest, most))
    program = system.load_program(friction)
    angles, points, above, below = list[float](), list[np.ndarray](), MOST_G, 0.0
    queue = list(_FIRST)
    while queue:
        angle = queue.pop(0)
        found = program(np.array([np.cos(angle), np.sin(angle)]))
        if found is None:
            return 0.0
        angles.append(angle)
        points.append(found[0])
        above = min(above, found[1])
        if queue:
            continue
        if above > 0.99 * MOST_G:
            return MOST_G
        below, angle = inner_circle(np.array(points))
        repeated = min(abs(np.angle(np.exp(1j * (angle - a)))) for a in angles) < 1e-3
        if len(angles) < tries and below < (1 - _MARGIN_GAP) * above and not repeated:
            queue.append(angle)
    return max(0.0, min(below, above))
