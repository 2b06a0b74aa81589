"""The order in which given bricks are put together."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import brick_data
import learn2assemble as l2a
from brick_data import bricks
from learn2assemble.assembly.blocks import Assembly, AssemblyStep
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.bricks.lattice import GROUND, StudLattice
from learn2assemble.assembly.files import read_assembly, write_assembly
from learn2assemble.assembly.instructions.steps import instructions
from learn2assemble.assembly.joints import DRY
from learn2assemble.cli import main
from learn2assemble.errors import InputError
from learn2assemble.export.cards import step_cards
from learn2assemble.export.pictures import booklet
from learn2assemble.planning.given import plan_assembly
from learn2assemble.planning.plan import Plan
from learn2assemble.statics.holding.check import stands_by_joints
from learn2assemble.statics.holding.program import Push, balance_of
from learn2assemble.statics.laws import ByStrength
from learn2assemble.statics.rigid_blocks import check
from learn2assemble.statics.states import State
from learn2assemble.viewer.scene import block_parts, scene_data

SAMPLES = [n for n, d in brick_data.designs().items() if "StableLego" not in d["source"]]
BRIDGE = bricks(((2, 4), (0, 0, 0)), ((2, 4), (0, 3, 1)), ((2, 4), (0, 6, 2)))
"""Three bricks, each on one row of knobs of the one before."""
ARM_OVER_A_BASE = bricks(
    ((4, 2), (0, 0, 0)),
    ((8, 2), (4, 0, 0)),
    *(((2, 2), (0, 0, z)) for z in (1, 2, 3)),
    ((4, 2), (0, 0, 4)),
    ((8, 2), (2, 0, 3)),
    ((2, 2), (8, 0, 2)),
)
"""Its last two bricks hang, one from the far end of the other, and nothing gets below them."""
_FEW = 50
"""Bricks up to which every state is looked at again, else every fifth."""


@pytest.fixture(autouse=True)
def _other_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    """States are proven by the simplex method while an order is found, and here, in ``need``, by
    interior points."""
    monkeypatch.setattr("learn2assemble.statics.holding.program._MANY", 0)


def replay(plan: Plan) -> None:
    """Every state of a plan stands, and stood while the brick was pressed home where it clutches.

    Ways are looked at again, cell by cell, and every press is tried at the brick's own joints: all
    together, or one after the other with the brick it is pressed on held.
    """
    assembly = plan.assembly
    assert assembly is not None
    blocks = assembly.blocks
    lattice = StudLattice(blocks, assembly.joint.pitch)
    joints = lattice.clutches(ground=True)
    middle = (joints.first + joints.last) / 2 * assembly.joint.pitch[0] + lattice.offset[:2]
    knobs = (joints.last - joints.first).prod(1)
    pairs = list(zip(joints.lower.tolist(), joints.upper.tolist(), strict=True))
    balance = balance_of(assembly)
    present = np.zeros(len(blocks), bool)
    held = np.zeros_like(present)
    beside: set[int] = set()
    lead = -1
    """What is held of the part that is built beside."""
    for step in plan.steps:
        b = step.block
        if step.action == "hold":
            held[b] = True
        elif step.action == "release":
            held[b] = False
            if beside and b == lead:
                above = [k for k in range(len(blocks)) if present[k] and k not in beside]
                over = [k for k in above for g in beside if covers(lattice, k, g)]
                under = [k for k in above for g in beside if covers(lattice, g, k)]
                assert not over or not under
                beside.clear()
        else:
            before = present.copy()
            present[b] = True
            if step.way == "beside":
                beside.add(b)
                held[b] |= len(beside) == 1
                lead = b if len(beside) == 1 else lead
            else:
                beside.clear()  # What was brought is built upon.
                sign = 1.0 if step.way == "above" else -1.0
                ends = [(k, b) if sign > 0 else (b, k) for k in np.flatnonzero(before).tolist()]
                other = [pair for pair in ends if covers(lattice, *pair)]
                assert not other
                mates = [
                    (k, a if u == b else u)
                    for k, (a, u) in enumerate(pairs)
                    if (u == b and sign > 0) or (a == b and sign < 0)
                ]
                mates = [(k, m) for k, m in mates if m == GROUND or before[m]]
                assert mates
                at = np.average([middle[k] for k, _ in mates], 0, [knobs[k] for k, _ in mates])
                force = sign * assembly.joint.press
                if not balance.stands(present, held, Push(b, force, (at[0], at[1]))):
                    for k, m in mates:
                        if m != GROUND:
                            hand = held.copy()
                            hand[m] = True
                            x, y = middle[k]
                            assert balance.stands(present, hand, Push(b, force, (x, y)))
                    assert held.any()
        # The hand that has put a brick down has it still where it holds it next.
        ahead = plan.steps[step.step : step.step + 1]
        if ahead and ahead[0].action == "hold" and ahead[0].block == b:
            continue
        if len(blocks) < _FEW or step.step % 5 == 0:
            assert balance.need(present, held).stands, step
    assert present.all()
    assert not held.any()


def covers(lattice: StudLattice, upper: int, lower: int) -> bool:
    """Whether a brick stands over another, however high."""
    low, high = lattice.low, lattice.high
    meet = (low[upper, :2] < high[lower, :2]).all() and (high[upper, :2] > low[lower, :2]).all()
    return bool(meet and low[upper, 2] >= high[lower, 2])


@pytest.mark.parametrize("name", SAMPLES)
def test_hands_build_every_sample(name: str) -> None:
    plan = plan_assembly(brick_data.design(name), hands=True)
    assert plan.status == "complete"
    assert len([s for s in plan.steps if s.action == "place"]) == len(
        brick_data.design(name).blocks
    )
    replay(plan)


def test_who_presses_inside_a_part_that_is_built_beside_is_told_what_to_hold() -> None:
    plan = plan_assembly(ARM_OVER_A_BASE, hands=True)
    replay(plan)
    told = [(step.action, step.block) for step in plan.steps]
    last = told.index(("place", 7))
    assert told[last - 1 : last + 2] == [("hold", 6), ("place", 7), ("release", 6)]
    assert told.index(("hold", 5)) < last < told.index(("release", 5))
    assert plan.assembly is not None
    balance, law = balance_of(plan.assembly), plan.assembly.joint
    there, head, both = (np.isin(np.arange(8), some) for some in ([5, 6, 7], [5], [5, 6]))
    middle = plan.assembly.blocks[7].vertices.mean(0)
    press = Push(7, -law.press, (middle[0], middle[1]))
    assert not balance.stands(there, head, press)
    assert balance.stands(there, both, press)


def test_bricks_from_above_need_no_help() -> None:
    wall = bricks(*[((2, 4), (0, 4 * k + 2 * (z % 2), z)) for z in range(4) for k in range(3)])
    plan = plan_assembly(wall)
    assert plan.status == "complete"
    assert {s.action for s in plan.steps} == {"place"}
    assert {s.way for s in plan.steps} == {"above"}
    heights = [s.position[2] for s in plan.steps]
    assert heights == sorted(heights)
    replay(plan)


def test_what_hangs_comes_from_below_and_only_by_hand() -> None:
    hanging = bricks(
        ((2, 2), (0, 0, 0)), ((2, 2), (0, 0, 1)), ((2, 6), (0, 0, 2)), ((2, 2), (0, 4, 1))
    )
    plan = plan_assembly(hanging)
    assert plan.status == "refused"
    # A name of a block does not begin the reason, of which the page makes a sentence.
    assert (plan.reason or "").startswith("what hangs on bricks above has to come from below")
    assert (plan.reason or "").endswith(": b4")
    plan = plan_assembly(hanging, hands=True)
    assert plan.status == "complete"
    assert [s.way for s in plan.steps if s.block == 3 and s.action == "place"] == ["below"]
    replay(plan)


def test_what_hangs_over_another_is_attached_with_its_brick() -> None:
    """Under the hanging brick there is no way for a hand: both are one before they come."""
    tower = [((2, 2), (0, 0, z)) for z in range(3)]
    shut = bricks(*tower, ((2, 6), (0, 2, 0)), ((2, 6), (0, 0, 3)), ((2, 2), (0, 4, 2)))
    plan = plan_assembly(shut, hands=True)
    assert plan.status == "complete"
    ways = {s.block: s.way for s in plan.steps if s.action == "place"}
    assert {ways[4], ways[5]} <= {"beside", "above"}
    assert "beside" in ways.values()
    replay(plan)


def test_a_press_that_is_not_withstood_is_not_hidden() -> None:
    first = replace(BRIDGE, blocks=BRIDGE.blocks[:2])
    assert plan_assembly(first).status == "complete"  # Pressed over its knobs, it stands.
    alone = plan_assembly(BRIDGE)
    assert alone.status == "not found"
    assert "with hands it is built" in (alone.reason or "")
    helped = plan_assembly(BRIDGE, holds=1)
    assert helped.status == "complete"
    assert any(s.action == "hold" for s in helped.steps)
    replay(helped)


def test_a_finished_structure_that_falls_is_refused() -> None:
    plan = plan_assembly(brick_data.design("stair_20").with_capacity(0.98), hands=True)
    assert plan.status == "refused"
    assert "1.007 times the strength" in (plan.reason or "")


def test_the_order_of_a_file_is_kept_or_told_to_fall() -> None:
    wall = bricks(((2, 4), (0, 0, 0)), ((2, 4), (0, 4, 0)), ((2, 4), (0, 2, 1)))
    good = replace(wall, steps=tuple(AssemblyStep(place=i) for i in ("b2", "b1", "b3")))
    plan = plan_assembly(good)
    assert [plan.assembly.blocks[s.block].id for s in plan.steps if plan.assembly] == [
        "b2",
        "b1",
        "b3",
    ]
    assert plan.design.note is None
    for order, words in (("b2 b3 b1", "b1) has no free way"), ("b3 b1 b2", "(b3) ")):
        bad = replace(wall, steps=tuple(AssemblyStep(place=i) for i in order.split()))
        plan = plan_assembly(bad)
        assert plan.status == "complete"
        assert words in (plan.design.note or "")
        replay(plan)


def test_wrong_help_is_refused() -> None:
    box = Assembly((box_block("a", (0, 0, 0), (1, 1, 1)),))
    with pytest.raises(InputError, match="bricks that clutch"):
        plan_assembly(box, hands=True)
    with pytest.raises(InputError, match="hands and holds alone"):
        plan_assembly(BRIDGE, gap=0.001)
    with pytest.raises(InputError, match="hands and holds alone"):
        plan_assembly(BRIDGE, supports="posts")
    with pytest.raises(InputError, match="for given blocks and bricks that clutch"):
        l2a.build(np.ones((2, 2, 2), bool), hands=True)


def test_cards_say_whence_a_brick_comes(tmp_path: Path) -> None:
    # A brick that hangs on the last one, and is pressed on it from below.
    hook = bricks(
        ((2, 2), (0, 0, 0)), ((2, 2), (0, 0, 1)), ((2, 6), (0, 0, 2)), ((2, 2), (0, 4, 1))
    )
    plan = plan_assembly(hook, hands=True)
    assert plan.assembly is not None
    ways = [step.way for step in plan.assembly.steps if step.action == "place"]
    assert ways.count("below") + ways.count("beside") >= 1
    cards = step_cards(plan.assembly)
    assert "comes from below" in cards or "built beside" in cards
    write_assembly(plan.assembly, tmp_path / "hook.json")
    assert read_assembly(tmp_path / "hook.json").steps == plan.assembly.steps
    with pytest.raises(InputError, match="way"):
        AssemblyStep(place="b1", way="under")  # pyright: ignore[reportArgumentType]


def test_where_none_of_many_bricks_is_left_nothing_falls() -> None:
    """More than a hundred, so that programs are of those that are there."""
    row = bricks(*(((1, 1), (2 * k, 0, 0)) for k in range(101)))
    law, none = ByStrength(row, stands_by_joints(row)), np.zeros(101, bool)
    for present in (~none, none, np.arange(101) < 3):
        assert law.stands(State(present, none))


def test_bricks_are_drawn_with_knobs_and_several_are_one_step() -> None:
    below = [((2, 2), (2 * k, 0, 0)) for k in range(8)]
    wall = bricks(*below, ((2, 4), (0, 0, 1)), ((1, 2), (15, 0, 1)))
    plan = plan_assembly(wall)
    assert plan.assembly is not None
    told = instructions(plan.assembly)
    # Bricks of one layer that follow one another, however they stand.
    assert [len(group.placements) for group in told.groups] == [6, 2, 2]
    numbers = [p.number for p in told.placements]
    assert numbers == sorted(numbers)
    book = booklet(plan.assembly)
    assert "In the order of their numbers." in book.cards[0].words[0]
    # Side and top of each knob.
    rims = {
        len(book.scene.figures[use.name].rims) for card in book.cards for use in card.picture.uses
    }
    assert rims == {2 * 4, 2 * 8, 2 * 2}
    parts, shapes, layers = block_parts(plan.assembly)
    data = scene_data(parts, shapes, layers, 10, plan.assembly.joint)
    assert sorted(map(len, data["knobs"])) == [2, 4, 8]
    assert data["knobs"][0] == [[0.004, 0.004], [0.004, 0.012], [0.012, 0.004], [0.012, 0.012]]
    dry = replace(plan.assembly, joint=DRY)
    assert scene_data(*block_parts(dry), 10, dry.joint)["knobs"] == [[], [], []]
    assert not any(figure.rims for figure in booklet(dry).scene.figures)


def test_the_command_line_builds_brick_text(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = tmp_path / "t.txt"
    text.write_text("2x2 (0,0,0)\n2x2 (0,0,1)\n2x6 (0,0,2)\n2x2 (0,4,1)\n")
    out = tmp_path / "out"
    words = ["build", str(text), "--kit", "lego", "--hands", "--json", "--out", str(out)]
    assert main(words) == 0
    summary = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert summary["status"] == "complete"
    made = read_assembly(out)
    size = np.array([np.ptp(b.vertices, axis=0) for b in made.blocks])
    assert size[2] == pytest.approx([0.016, 0.048, 0.0096])
    assert made.joint.law == "clutch"
    assert main(["check", str(out), "--capacity", "0.98", "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert found["verdict"] == "stands"
    assert 0 < found["margin_n"] < 0.98
    ldr = tmp_path / "m.ldr"
    assert main(["export", str(out), "--format", "ldraw", "--out", str(ldr)]) == 0
    assert ldr.read_text().count("0 STEP") == 4
    assert main(["build", str(ldr), "--out", str(tmp_path / "again")]) == 1  # One hangs.


def test_every_step_has_the_margins_of_what_stands_after_it() -> None:
    """Against a check of the bricks alone that stand, where no hand holds any."""
    model = brick_data.design("apex_R")
    plan = plan_assembly(model, hands=True)
    assert plan.assembly is not None
    assert plan.status == "complete"
    held: set[int] = set()
    looked = 0
    for number, step in enumerate(plan.steps, 1):
        held ^= {step.block} if step.action in ("hold", "release") else set()
        ahead = plan.steps[number : number + 1]
        if held or any((s.action, s.block) == ("hold", step.block) for s in ahead):
            continue
        there = {s.block for s in plan.steps[:number] if s.action == "place"}
        found = check(replace(model, blocks=tuple(model.blocks[k] for k in sorted(there))))
        assert step.margin_n == pytest.approx(found.margin_n, abs=1e-5)
        assert step.margin_g == pytest.approx(found.margin_g, rel=0.02, abs=1e-5)
        looked += 1
    assert looked > len(model.blocks) // 2
