"""Builds by two arms of which one, or both, were stopped; they are gone on with from their file."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l2a_lab.arm_distances import WatchedCell
from l2a_lab.shapes import wall
from l2a_lab.stopped_arm import Pressed, StoppedCell, drawn
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.kit import load_kit
from learn2assemble.cell import together
from learn2assemble.cell.carry_out import carry_out, prepare, setup_of
from learn2assemble.cell.crew import Member
from learn2assemble.cell.site import Site
from learn2assemble.cell.site_arms import SiteArm
from learn2assemble.cell.team import plan_by_team, set_up_team
from learn2assemble.cell.together import build_together
from learn2assemble.cell.traffic import APART, PLANNED, Leg, Route, Traffic
from learn2assemble.cell.workcell import Workcell
from learn2assemble.cli import main
from learn2assemble.design.cells import CellDesign
from learn2assemble.errors import InputError
from learn2assemble.motion.plant import Guard, Motion, Report, ToolCommand, WrappedPlant
from learn2assemble.planning.given import plan_assembly
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.robot.arm import Arm, get_arm
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.capsules import capsules_of, in_hand, solid_capsules
from learn2assemble.robot.moves import Outcome
from learn2assemble.robot.sweeps import Sweep, clear, still, sweep
from learn2assemble.simulation.model import Failure
from learn2assemble.simulation.plant import DynamicPlant

KIT = load_kit("bricks")
COUNT = 10
"""Blocks of the wall."""
STOP = 0, 8.0
"""The arm that is stopped, and when [s]."""


@pytest.fixture(scope="module")
def planned() -> tuple[Plan, list[Member]]:
    design = CellDesign("wall", wall(10, 2, 3), KIT.pitch, None, 0.0, None, "", None)
    plan = plan_cells(design, KIT)
    assert plan.assembly is not None
    members = set_up_team(plan.assembly, [SiteArm(a, a) for a in ("ur5e", "panda")], Site())
    options = {"friction": None, "gap": KIT.joint_gap, "seconds": 60.0}
    return plan_by_team(plan.assembly, members, options=options), members


def build(
    planned: tuple[Plan, list[Member]], log: Path, pressed: Pressed | None = None
) -> tuple[Plan, StoppedCell]:
    cells: list[StoppedCell] = []

    def opened(setup: Any) -> StoppedCell:
        cells.append(StoppedCell(setup, pressed))
        return cells[-1]

    plan, members = planned
    cell = Workcell("ur5e", log=log)
    return build_together(plan, members, cell, joint=KIT.joint_gap, opened=opened), cells[0]


@pytest.fixture(scope="module")
def stopped(
    planned: tuple[Plan, list[Member]], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[int, float], tuple[Plan, StoppedCell, str]]:
    """What came of a build of which an arm was stopped at a time [s], its cell, and its file."""

    @cache
    def made(arm: int, at: float) -> tuple[Plan, StoppedCell, str]:
        log = tmp_path_factory.mktemp("stopped") / "build.jsonl"
        return *build(planned, log, Pressed(arm, at)), log.read_text(encoding="utf-8")

    return made


def is_whole(plan: Plan, cell: WatchedCell) -> None:
    """Every block is where it shall be, each placed once."""
    assert plan.complete, plan.reason
    assert plan.assembly is not None
    truth = cell.truth()
    standing = [pose for pose in truth.values() if pose[2] > 0]
    for block in plan.assembly.blocks:
        middle = (block.vertices.min(0) + block.vertices.max(0)) / 2
        off = [np.linalg.norm(pose[:3] - middle) for pose in standing]
        assert sum(far < 1e-3 for far in off) == 1, block.id
    assert [step.step for step in plan.steps] == [*range(1, COUNT + 1)]
    assert sum(len(record.steps) for record in plan.records) >= COUNT
    for arm, record in zip(plan.arms, plan.records, strict=True):
        assert arm.did is not None
        assert arm.did.attempts == len(record.steps)


@pytest.mark.parametrize(("arm", "at"), [STOP, (1, 12.0)])
def test_a_build_whose_arm_was_stopped_is_gone_on_with(
    planned: tuple[Plan, list[Member]],
    stopped: Callable[[int, float], tuple[Plan, StoppedCell, str]],
    tmp_path: Path,
    arm: int,
    at: float,
) -> None:
    log = tmp_path / "build.jsonl"
    first, cell, text = stopped(arm, at)
    log.write_text(text, encoding="utf-8")
    assert first.status == "incomplete"
    assert "pressed the button" in (first.reason or "")
    assert cell.stage
    # The other one does what it can, and stands then.
    assert np.abs(cell.plants[1 - arm].sense().velocity).max() < 1e-2
    assert cell.least().distance >= 0.010
    before = len(first.steps)
    assert before < COUNT
    again, cell = build(planned, log)
    is_whole(again, cell)
    assert cell.least().distance >= 0.010
    assert again.robot_s is not None
    assert first.robot_s is not None
    assert again.robot_s > first.robot_s


def test_a_build_that_was_ended_by_force_is_gone_on_with(
    planned: tuple[Plan, list[Member]], tmp_path: Path
) -> None:
    """While one arm ended an attempt the other one was in the middle of its own, which never
    happened then."""
    log = tmp_path / "build.jsonl"
    whole, cell = build(planned, log)
    is_whole(whole, cell)
    lines = log.read_text(encoding="utf-8").splitlines(keepends=True)
    assert len(lines) == 1 + COUNT
    log.write_text("".join(lines[:5]) + lines[5][:40], encoding="utf-8")
    again, cell = build(planned, log)
    is_whole(again, cell)
    assert len(log.read_text(encoding="utf-8").splitlines()) >= 1 + COUNT
    assert sum(len(record.steps) for record in again.records) == COUNT


def test_the_file_of_another_build_is_refused(
    planned: tuple[Plan, list[Member]],
    stopped: Callable[[int, float], tuple[Plan, StoppedCell, str]],
    tmp_path: Path,
) -> None:
    """That of the same plan by arms of other names is one."""
    log = tmp_path / "build.jsonl"
    plan, members = planned
    log.write_text(stopped(*STOP)[2], encoding="utf-8")
    other = [replace(members[0], name="left"), members[1]]
    with pytest.raises(InputError, match="--resume"):
        build((plan, other), log)


def test_the_command_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.save(tmp_path / "wall.npy", wall(6, 2, 2))
    words = ["build", str(tmp_path / "wall.npy"), "--arm", "ur5e", "--arm", "panda"]
    words += ["--no-video", "--out", str(tmp_path / "out")]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        with monkeypatch.context() as patch:
            patch.setattr(together, "simulated", lambda setup: StoppedCell(setup, Pressed(0, 3.0)))
            assert main(words) == 1
        state = tmp_path / "out" / "build.jsonl"
        assert state.exists()
        assert main([*words, "--resume"]) == 0
    assert not state.exists()
    plan = Plan.load(tmp_path / "out")
    assert plan.complete
    assert {step.arm for step in plan.steps} == {"ur5e", "panda"}


def test_stops_are_drawn_of_the_whole_build() -> None:
    found = drawn(200, 40.0)
    assert {one.arm for one in found} == {0, 1}
    times = np.array([one.at for one in found])
    assert times.min() >= 0
    assert times.max() <= 40
    assert np.histogram(times, 4, (0, 40))[0].min() > 30
    assert drawn(200, 40.0) == found


# An arm beside one that was stopped: what it sets out on, and what it does with what it has just
# taken hold of.

LEFT = get_arm("ur5e", "suction", (-0.42, 0.0, 0.0, 0.0))
RIGHT = get_arm("panda", "suction", (0.42, 0.0, 0.0, np.pi))
BRICK = (Part((0.0, 0.0, 0.0), (0.03, 0.02, 0.02)),)
AWAY = still(solid_capsules(BRICK, np.array([0.0, 3.0, 0.0]), np.eye(3)))


def random_joints(rng: np.random.Generator, arm: Arm) -> np.ndarray:
    return np.clip(arm.home + rng.normal(0, 0.5, len(arm.home)), *arm.limits())


def swept(arm: Arm, *joints: np.ndarray) -> Sweep:
    return sweep(arm, capsules_of(arm), np.array(joints))


def test_what_passes_somewhere_on_the_leg_of_a_stopped_arm_is_not_set_out_on() -> None:
    rng, refused = np.random.default_rng(0), 0
    held = in_hand(LEFT, solid_capsules(BRICK, np.array([0.0, 0.0, 0.02]), np.eye(3)))
    for _ in range(300):
        far, mine = random_joints(rng, RIGHT), random_joints(rng, LEFT)
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
