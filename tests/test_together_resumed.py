"""Builds by two arms that were stopped, or ended by force, and are gone on with from their file."""

from __future__ import annotations

import contextlib
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l2a_lab.arm_distances import WatchedCell
from l2a_lab.shapes import wall
from l2a_lab.stopped_arm import Pressed, StoppedCell, drawn
from learn2assemble.assembly.kit import load_kit
from learn2assemble.cell import together
from learn2assemble.cell.crew import Member
from learn2assemble.cell.site import Site
from learn2assemble.cell.site_arms import SiteArm
from learn2assemble.cell.team import plan_by_team, set_up_team
from learn2assemble.cell.together import build_together
from learn2assemble.cell.workcell import Workcell
from learn2assemble.cli import main
from learn2assemble.design.cells import CellDesign
from learn2assemble.errors import InputError
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.construct import plan_cells

KIT = load_kit("bricks")
COUNT = 10
"""Blocks of the wall."""


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


@pytest.mark.parametrize(("arm", "at"), [(0, 8.0), (1, 12.0)])
def test_a_build_whose_arm_was_stopped_is_gone_on_with(
    planned: tuple[Plan, list[Member]], tmp_path: Path, arm: int, at: float
) -> None:
    log = tmp_path / "build.jsonl"
    first, cell = build(planned, log, Pressed(arm, at))
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
    planned: tuple[Plan, list[Member]], tmp_path: Path
) -> None:
    """That of the same plan by arms of other names is one."""
    log = tmp_path / "build.jsonl"
    plan, members = planned
    build(planned, log, Pressed(0, 5.0))
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
