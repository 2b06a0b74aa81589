"""Drawn designs in mortar: filled, ordered and proven by the law of the kit."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.files import read_assembly
from learn2assemble.assembly.joints import DRY, Joint
from learn2assemble.assembly.kit import Kit, load_kit
from learn2assemble.cli import main
from learn2assemble.constants import GRAVITY
from learn2assemble.planning.given import plan_assembly
from learn2assemble.planning.plan import Plan
from learn2assemble.statics.proofs import MORTAR
from learn2assemble.statics.rigid_blocks import STANDS, check

WINDOW = Path(__file__).resolve().parents[1] / "examples" / "designs" / "window.svg"
BRICKS = load_kit("bricks-mortar")
AGE = 72.0


def mortared(tensile: float, age: float = 24.0) -> Kit:
    """Bricks four cells long and no others."""
    joint = Joint("mortar", tensile=tensile, shear=1e9, age=age)
    kit = load_kit("bricks")
    return replace(kit, joint=joint, joint_gap=0.0, kinds=(kit.kind("1x4"),))


def stair(count: int) -> np.ndarray:
    """Bricks four cells long, each a cell farther out than the one below."""
    wanted = np.zeros((count + 3, 1, count), bool)
    for z in range(count):
        wanted[z : z + 4, 0, z] = True
    return wanted


def told(plan: Plan) -> list[str]:
    """What is done, in words."""
    assert plan.assembly is not None
    return ["wait " * (s.wait is not None) + s.action for s in plan.assembly.steps]


def built(plan: Plan) -> Assembly:
    """The blocks of a plan whose every state is proven once more, as of given blocks."""
    assert plan.complete, plan.reason
    assert plan.assembly is not None
    again = plan_assembly(plan.assembly)
    assert again.complete, again.reason
    assert len(again.steps) == len(plan.steps)
    return plan.assembly


def test_a_wall_with_a_window_has_no_lintel() -> None:
    plan = l2a.build(WINDOW, kit=BRICKS)
    made = built(plan)
    assert plan.cells is not None
    assert (plan.cells.missing, plan.cells.outside) == (0, 0)
    assert made.joint == BRICKS.joint
    removed = [k for k, word in enumerate(told(plan)) if "remove" in word]
    assert len(removed) == sum(block.prop for block in made.blocks) >= 4
    waits = [(k, s.wait_h) for k, s in enumerate(plan.steps) if s.wait_h is not None]
    assert waits == [(removed[0], AGE)], "all props stay until the mortar holds"
    assert any(plan.steps[k].proof == MORTAR for k in removed)
    assert check(made).verdict == STANDS


def test_dry_a_window_without_lintel_falls() -> None:
    wanted = np.ones((7, 1, 3), bool)
    wanted[2:5, 0, :2] = False
    assert l2a.build(wanted, kit=BRICKS).complete
    # Dry, with a mortar that holds nothing, and where joints may open and are not filled.
    weak = Joint("mortar", tensile=0.0, shear=0.0, age=AGE)
    for joint in (DRY, weak):
        fallen = l2a.build(wanted, kit=replace(BRICKS, joint=joint, joint_gap=1e-4))
        assert fallen.status == "refused"
        assert fallen.blamed
    assert not l2a.build(wanted, kit=BRICKS, gap=0.001).complete


def test_strength_decides_what_a_stair_of_bricks_bears() -> None:
    """The upper four bricks hang on the joint of the lowest: their middle is two cells beside that
    of the joint, which reaches one and a half, so its preload P has 4 W 2 = (4 W + P) 1.5; P is a
    third of the tensile strength over three cells."""
    kit = mortared(1.0)
    x, y, z = kit.pitch
    needed = 4 * (4 * x * y * z * kit.density * GRAVITY) / (3 * x * y)
    plan = l2a.build(stair(5), kit=mortared(1.02 * needed))
    assert not any(block.prop for block in built(plan).blocks)
    assert told(plan) == ["place", "place", "place", "wait place", "place"]
    assert [step.wait_h for step in plan.steps] == [None, None, None, 24.0, None]
    assert [step.proof == MORTAR for step in plan.steps] == [False, False, False, True, True]
    assert all(step.margin_g is not None for step in plan.steps)
    weak = l2a.build(stair(5), kit=mortared(0.98 * needed))
    assert weak.status == "not found"
    assert "1.02 times its strength" in (weak.reason or "")
    at_once = l2a.build(stair(5), kit=mortared(1.02 * needed, age=0.0))
    assert told(at_once) == ["place"] * 5
    built(at_once)


def test_what_stands_dry_waits_for_nothing() -> None:
    wall = np.ones((6, 1, 4), bool)
    plan = l2a.build(wall, kit=BRICKS)
    dry = l2a.build(wall, kit=replace(BRICKS, joint=DRY))
    built(plan)
    assert plan.steps == dry.steps
    assert dry.complete


def test_the_command_line_takes_a_kit_of_ones_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kit = tmp_path / "mine.toml"
    kit.write_text(
        'format = "learn2assemble-kit"\nversion = 1\nname = "mine"\njoint_gap = 0.0\n'
        '[joint]\nlaw = "mortar"\ntensile = 1e5\nshear = 1e5\nage = 48\n'
        '[[kinds]]\nname = "long"\nbox = [4, 1, 1]\n'
    )
    np.save(tmp_path / "stair.npy", stair(5))
    asked = ["build", str(tmp_path / "stair.npy"), "--kit", str(kit), "--out"]
    assert main([*asked, str(tmp_path / "out")]) == 0
    assert "wait until the mortar holds before steps 4 (48 h)" in capsys.readouterr().out
    plan = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert [step.get("wait_h") for step in plan["steps"]] == [None, None, None, 48.0, None]
    for name in ("cards.html", "view.html"):
        assert "Wait 48 h first, until the mortar holds." in (tmp_path / "out" / name).read_text()
    assert read_assembly(tmp_path / "out").steps[3].wait == 48.0
    assert main([*asked, str(tmp_path / "arm"), "--arm", "panda"]) == 2
    assert "lays no mortar" in capsys.readouterr().err
