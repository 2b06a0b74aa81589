"""What page, cards and terminal say of a plan is true, and can be read one way only."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from html import unescape
from pathlib import Path

import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.assembly.blocks import Assembly, AssemblyStep, hull_block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.instructions import instructions
from learn2assemble.assembly.shapes import rotation
from learn2assemble.cli.commands import _print_plan
from learn2assemble.cli.output import Output
from learn2assemble.constants import GRAVITY
from learn2assemble.export.cards import step_cards
from learn2assemble.export.pictures import booklet
from learn2assemble.export.projection import project
from learn2assemble.planning.plan import Plan
from learn2assemble.viewer.page import render_assembly_page, write_plan_page
from learn2assemble.viewer.words import weakest_words
from read_back import arch, visible_text


@cache
def gate(friction: float | tuple[float, float] | None = None) -> Plan:
    """Two piers and what lies across them."""
    wanted = np.ones((4, 1, 3), bool)
    wanted[1:3, :, :2] = False
    return l2a.build(wanted, kit="bricks-lintels", friction=friction)


def facts(plan: Plan, folder: Path) -> dict[str, str]:
    """The tiles of a page, by name."""
    write_plan_page(plan, folder / "view.html")
    text = (folder / "view.html").read_text(encoding="utf-8")
    found = re.findall(r"<dt>(.*?)</dt><dd><span[^>]*>(.*?)</span>", text)
    return {unescape(name): unescape(value) for name, value in found}


def test_newtons_stand_beside_the_step_they_belong_to(tmp_path: Path) -> None:
    """The weakest step in g is not the one that withstands fewest newtons."""
    plan = gate()
    assert plan.assembly is not None
    steps = tuple(
        replace(step, margin_g=0.3 if step.step < len(plan.steps) else 0.1) for step in plan.steps
    )
    told = facts(replace(plan, steps=steps), tmp_path)
    last = len(steps)
    assert told["weakest step"] == f"step {last}: 0.100 g sideways at friction 0.5"
    first = plan.assembly.block(plan.assembly.steps[0].block).mass
    total = sum(block.mass for block in plan.assembly.blocks)
    assert 0.3 * first < 0.1 * total, "a push on little is a small one"
    push = f"{0.3 * first * GRAVITY:.2g}"
    assert told["least push withstood"] == f"{push} N sideways, after step 1"


@pytest.mark.parametrize(("asked", "least"), [(None, "0.5"), (0.1, "0.1"), ((0.2, 0.4), "0.2")])
def test_a_margin_is_told_with_its_friction(
    asked: float | tuple[float, float] | None,
    least: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    plan = gate(asked)
    assert weakest_words(plan).endswith(f" g sideways at friction {least}")
    assert facts(plan, tmp_path)["weakest step"] == weakest_words(plan)
    page = (tmp_path / "view.html").read_text(encoding="utf-8")
    assert f", friction {least}." in page
    assert f"withstands after the step at friction {least}, in newtons" in page
    _print_plan(Output(as_json=False), plan, {})
    assert f"the weakest is {weakest_words(plan)}\n" in capsys.readouterr().out


def test_a_plan_without_margins_names_no_weakest_step() -> None:
    plan = gate()
    bare = tuple(replace(step, margin_g=None) for step in plan.steps)
    assert not weakest_words(replace(plan, steps=bare))


def turned() -> Assembly:
    """A straight brick, and another one turned by ten degrees about the vertical."""
    straight = box_block("straight", (0, 0, 0), (0.1, 0.05, 0.04))
    other = hull_block("turned", straight.vertices @ rotation((0, 0, 10)).T + (0.2, 0.02, 0))
    return Assembly((straight, other), (AssemblyStep("turned"), AssemblyStep("straight")))


def test_the_corner_of_a_turned_brick_is_told_apart_from_its_place_and_drawn() -> None:
    made = turned()
    for text in (step_cards(made), render_assembly_page(made, title="x")):
        words = visible_text(text)
        assert "of step 1: corner 1 is 200 mm to the right of O, 20 mm behind it." in words
        assert "turned by other than 90° or 180°" in words
        assert "leans" not in words
    [picture] = [card.picture for card in booklet(made).cards]
    placement = instructions(made).placements[0]
    assert placement.askew
    [dot] = picture.dots
    np.testing.assert_allclose(dot, project(np.array(placement.position)))
    assert [len(picture.dots) for _, picture in booklet(made).shapes] == [1]
    assert step_cards(made).count("<circle class=o ") == 2, "on the card and in the bill"


def test_nothing_is_said_of_corners_where_no_block_is_turned_askew() -> None:
    made = replace(turned(), steps=(AssemblyStep("straight"),), blocks=turned().blocks[:1])
    for text in (step_cards(made), render_assembly_page(made, title="x")):
        assert "corner 1" not in visible_text(text)
        assert "<circle class=o " not in text


def test_numbered_shapes_are_drawn_large_enough_to_part_the_numbers() -> None:
    """Beside a post as wide as the arch, the numbers of the corners of a wedge ran together."""
    made = arch()
    post = box_block("post", (-0.2, -1, 0), (0.3, -0.9, 0.35), prop=True)
    made = replace(made, blocks=(*made.blocks, post), steps=(*made.steps, AssemblyStep("post")))
    shapes = {shape.letter: picture for shape, picture in booklet(made).shapes}
    assert shapes["A"].labels
    assert (shapes["A"].within is None, shapes["B"].within is None) == (False, True)


def test_a_prop_that_stands_keeps_its_colour_on_cards() -> None:
    prop = box_block("prop", (0.1, 0, 0), (0.15, 0.05, 0.05), prop=True)
    block, *_ = turned().blocks
    steps = (AssemblyStep("prop"), AssemblyStep("straight"), AssemblyStep(remove="prop"))
    cards = booklet(Assembly((block, prop), steps)).cards
    second = next(card for card in cards if card.group.main.number == 2)
    assert {use.colour for use in second.picture.uses} == {"prop", cards[1].group.main.shape.colour}
