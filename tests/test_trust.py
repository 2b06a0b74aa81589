"""Blocks that nobody sees are taken to be where they were put, and what clutches goes along."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from learn2assemble.motion.plant import (
    Guard,
    Motion,
    Readings,
    Report,
    Request,
    Stop,
    ToolCommand,
    ToolReading,
    standing,
)
from learn2assemble.motion.setup import BlockKind, Setup
from learn2assemble.motion.trust import Trusted
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.kinematics import forward, get_chain

ARM = get_arm("panda", "suction")


class Blind:
    """A plant that moves at once, and whose cup holds whatever it is told to."""

    def __init__(self) -> None:
        self.joints, self.time = ARM.home.copy(), 0.0

    def sense(self) -> Readings:
        self.time += 1.0
        return Readings(self.time, self.joints, 0 * self.joints, (), ToolReading(), ARM.name)

    def execute(
        self, motion: Motion, commands: Sequence[ToolCommand] = (), guards: Sequence[Guard] = ()
    ) -> Report:
        self.joints = motion.joints[-1].copy()
        return Report(Stop.END, 1.0, self.joints, motion.seconds, "", ToolReading(vacuum=True))

    def request(self, request: Request) -> Report:
        return Report(Stop.END, 1.0, self.joints, 0.0)

    def stop(self) -> None: ...

    def close(self) -> None: ...


def test_what_clutches_a_block_in_the_hand_goes_along_until_it_is_let_go() -> None:
    tip, _ = forward(get_chain(ARM), ARM.home)
    kind = BlockKind((Part((0.0, 0.0, 0.0), (0.02, 0.02, 0.01)),), 600.0)
    x, y, z = tip.tolist()
    places = {
        "lead": np.array([x, y, z - 0.01, 1, 0, 0, 0]),
        "other": np.array([x, y, z - 0.03, 1, 0, 0, 0]),
        "apart": np.array([x + 0.2, y, z - 0.01, 1, 0, 0, 0]),
    }
    plant = Trusted(Blind(), Setup(ARM, dict.fromkeys(places, kind), places))
    plant.request(Request("join", "other", "lead", places["other"]))
    plant.execute(standing("pick", ARM.home, 0.5), (ToolCommand(vacuum=True),))
    there = ARM.home + np.array([0.4, 0, 0, 0, 0, 0, 0])
    plant.execute(standing("carry", there, 0.5))
    seen = {one.block: one.pose for one in plant.sense().blocks}
    point, _ = forward(get_chain(ARM), there)
    assert np.allclose(seen["lead"][:3], point - [0, 0, 0.01], atol=1e-9)
    assert np.allclose(seen["other"][:3], point - [0, 0, 0.03], atol=1e-9)
    assert (seen["apart"] == places["apart"]).all()
    assert plant.state()["poses"].keys() == {"apart"}
    plant.execute(standing("release", there, 0.5), (ToolCommand(vacuum=False),))
    plant.execute(standing("retreat", ARM.home, 0.5))
    after = {one.block: one.pose for one in plant.sense().blocks}
    assert all((after[name] == seen[name]).all() for name in places)
