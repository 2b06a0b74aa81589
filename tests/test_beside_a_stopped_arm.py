"""An arm beside one that was stopped: what it sets out on, and what it does with what it has just
taken hold of."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from learn2assemble.assembly.blocks import Assembly, box_block
from learn2assemble.cell.carry_out import carry_out, prepare, setup_of
from learn2assemble.cell.traffic import APART, PLANNED, Leg, Route, Traffic
from learn2assemble.cell.workcell import Workcell
from learn2assemble.motion.plant import Guard, Motion, Report, ToolCommand, WrappedPlant
from learn2assemble.planning.given import plan_assembly
from learn2assemble.robot.arm import Arm, get_arm
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.capsules import capsules_of, in_hand, solid_capsules
from learn2assemble.robot.moves import Outcome
from learn2assemble.robot.sweeps import Sweep, clear, still, sweep
from learn2assemble.simulation.model import Failure
from learn2assemble.simulation.plant import DynamicPlant

LEFT = get_arm("ur5e", "suction", (-0.42, 0.0, 0.0, 0.0))
RIGHT = get_arm("panda", "suction", (0.42, 0.0, 0.0, np.pi))
BRICK = (Part((0.0, 0.0, 0.0), (0.03, 0.02, 0.02)),)
AWAY = still(solid_capsules(BRICK, np.array([0.0, 3.0, 0.0]), np.eye(3)))


def drawn(rng: np.random.Generator, arm: Arm) -> np.ndarray:
    return np.clip(arm.home + rng.normal(0, 0.5, len(arm.home)), *arm.limits())


def swept(arm: Arm, *joints: np.ndarray) -> Sweep:
    return sweep(arm, capsules_of(arm), np.array(joints))


def test_what_passes_somewhere_on_the_leg_of_a_stopped_arm_is_not_set_out_on() -> None:
    rng, refused = np.random.default_rng(0), 0
    held = in_hand(LEFT, solid_capsules(BRICK, np.array([0.0, 0.0, 0.02]), np.eye(3)))
    for _ in range(300):
        far, mine = drawn(rng, RIGHT), drawn(rng, LEFT)
        other, ways = swept(RIGHT, RIGHT.home, far), [LEFT.home, mine, LEFT.home]
        legs = [Leg("cross", swept(LEFT, *way)) for way in pairwise(ways)]
        past = all(clear(leg.swept, other.end, PLANNED) for leg in legs)
        if not past or all(clear(leg.swept, other, PLANNED) for leg in legs):
            continue
        traffic, route = Traffic((LEFT, RIGHT)), Route("a", held, tuple(legs), AWAY)
        told = Motion("home", np.array([0.0, 1]), np.array([RIGHT.home, far]), np.zeros((2, 7)))
        if not traffic.enter(1, told):
            continue
        # It waits for the leg to be over before it moves, as long as that will be.
        assert traffic.fits(0, route)
        traffic.stopped(1)
        assert not traffic.fits(0, route)
        refused += 1
    assert refused >= 3
    assert APART <= PLANNED


class Refuses(WrappedPlant):
    """Lets an arm lift nothing."""

    told: tuple[tuple[Motion, tuple[ToolCommand, ...]], ...] = ()

    def execute(
        self,
        motion: Motion,
        commands: Sequence[ToolCommand] = (),
        guards: Sequence[Guard] = (),
    ) -> Report:
        if motion.stage == "lift" and np.ptp(motion.joints, axis=0).any():
            raise Failure(Outcome.UNREACHABLE, "lift", "the other arm is in the way")
        self.told = (*self.told, (motion, tuple(commands)))
        return self.plant.execute(motion, commands, guards)


@pytest.mark.parametrize("tool", ["suction", "gripper"])
def test_what_was_taken_and_not_moved_is_let_go_where_it_lies(tool: str) -> None:
    block = box_block("block", (-0.03, -0.02, 0.0), (0.03, 0.02, 0.04), density=600.0)
    plan = plan_assembly(Assembly((block,), friction=0.6))
    workcell = Workcell("panda", tool)
    found = prepare(plan, workcell, 0.0)
    plant = Refuses(DynamicPlant(setup_of(found.job, workcell)))
    done = carry_out(plan, workcell, joint=0.0, found=found, plant=plant)
    assert done.arm is not None
    details = [one.detail for one in done.arm.failures]
    assert details
    assert all(one.endswith("the other arm is in the way; put back") for one in details)
    moved = [bool(np.ptp(motion.joints, axis=0).any()) for motion, _ in plant.told]
    takes = [n for n, (_, some) in enumerate(plant.told) if any(_holds(one) for one in some)]
    opens = [n for n, (_, some) in enumerate(plant.told) if any(_opens(one) for one in some)]
    assert len(takes) == len(details)
    for n in takes:
        until = next(k for k in opens if k > n)
        assert not any(moved[n:until])


def _holds(command: ToolCommand) -> bool:
    return bool(command.vacuum) or bool(command.force)


def _opens(command: ToolCommand) -> bool:
    return command.vacuum is False or (command.width is not None and not command.force)
