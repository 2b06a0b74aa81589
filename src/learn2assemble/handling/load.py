"""What something in the hand loads a cup with while the arm moves, computed before it does."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.constants import GRAVITY
from learn2assemble.kinematics.chain import Chain, forward_many
from learn2assemble.robot.scene import rotation_matrix
from learn2assemble.robot.tool import Cup
from learn2assemble.simulation.model import SimulatedWorld


class Payload(NamedTuple):
    """What hangs from the tool, in its frame."""

    mass: float
    """[kg]"""
    centre: np.ndarray
    """float64[3]: of mass [m]."""
    inertia: np.ndarray
    """float64[3, 3]: about it [kg m2]."""


def hanging(
    world: SimulatedWorld, number: int, position: np.ndarray, rotation: np.ndarray
) -> Payload:
    """An object in the hand.

    Args:
        world: model of the cell as it is meant to be.
        number: of the object.
        position: float64[3] of the object in the tool frame [m], and
        rotation: float64[3, 3].
    """
    m, body = world.model, world.first + number
    own = rotation @ rotation_matrix(m.body_iquat[body])
    centre = position + rotation @ m.body_ipos[body]
    return Payload(float(m.body_mass[body]), centre, own * m.body_inertia[body] @ own.T)


def peak_load(
    cup: Cup, chain: Chain, load: Payload, joints: np.ndarray, period: float
) -> tuple[float, float]:
    """Largest shares of pull-off force and friction on a motion that is followed exactly.

    Args:
        cup: that holds it.
        chain: of the arm.
        load: what hangs from the tool.
        joints: float64[k, n] at equal steps of time [rad].
        period: between them [s].
    """
    if len(joints) < 3:
        joints = np.repeat(joints[:1], 3, axis=0)
    where, turn = forward_many(chain, np.ascontiguousarray(joints))
    middle = where + turn @ load.centre
    up = np.array([0.0, 0.0, GRAVITY])
    force = load.mass * (np.diff(middle, 2, axis=0) / period**2 + up)
    spin = turn[1:] @ turn[:-1].transpose(0, 2, 1)  # by small angles
    rate = np.stack(
        [
            spin[:, 2, 1] - spin[:, 1, 2],
            spin[:, 0, 2] - spin[:, 2, 0],
            spin[:, 1, 0] - spin[:, 0, 1],
        ],
        -1,
    ) / (2 * period)
    inertia = turn[1:-1] @ load.inertia @ turn[1:-1].transpose(0, 2, 1)
    mean = (rate[1:] + rate[:-1]) / 2
    swing = np.einsum("kij,kj->ki", inertia, np.diff(rate, axis=0) / period)
    swing += np.cross(mean, np.einsum("kij,kj->ki", inertia, mean))
    lip, frame = where + turn @ np.array(cup.lip.at), turn @ cup.lip.frame()
    moment = swing + np.cross(middle[1:-1] - lip[1:-1], force)
    # The cup is loaded with what it does to the block, the other way.
    shares = [
        cup.load(-f, -m)
        for f, m in zip(
            np.einsum("kji,kj->ki", frame[1:-1], force),
            np.einsum("kji,kj->ki", frame[1:-1], moment),
            strict=True,
        )
    ]
    # A way so short that it has no middle loads nothing.
    return max((off for off, _ in shares), default=0.0), max((s for _, s in shares), default=0.0)
