"""A plan as a value: one schema writes and reads it, and refuses what is none; what page, cards and
terminal say of it is true, and can be read one way only."""

from __future__ import annotations

import dataclasses
import io
import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import learn2assemble as l2a
from learn2assemble.assembly.blocks import Assembly, AssemblyStep, hull_block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.instructions.shapes import rotation
from learn2assemble.assembly.instructions.steps import instructions
from learn2assemble.cli.commands import _print_plan
from learn2assemble.cli.output import Output
from learn2assemble.constants import GRAVITY
from learn2assemble.design.cells import CellDesign
from learn2assemble.errors import InputError
from learn2assemble.export.cards import step_cards
from learn2assemble.export.pictures import booklet
from learn2assemble.export.projection import project
from learn2assemble.planning.plan import CellCount, Plan, Step
from learn2assemble.viewer import preview
from learn2assemble.viewer.html import asset
from learn2assemble.viewer.page import Verdict, render_assembly_page, write_plan_page
from learn2assemble.viewer.words import weakest_words
from read_back import arch, visible_text

EXAMPLE = Path(__file__).parent / "data" / "example_plan"
NUMBER = st.floats(-9, 9)


def example() -> dict[str, Any]:
    return json.loads((EXAMPLE / "plan.json").read_text())


@pytest.mark.parametrize("version", [1, 2, 4])
def test_plans_of_other_versions_are_refused(version: int) -> None:
    with pytest.raises(InputError) as caught:
        Plan.from_dict(example() | {"version": version}, "my/plan.json")
    assert str(caught.value) == f"my/plan.json: version: got {version}, expected 3"


@given(
    positions=st.lists(st.tuples(NUMBER, NUMBER, NUMBER), max_size=5),
    margin=st.none() | st.floats(0, 10),
    kind=st.none() | st.text(max_size=5),
    prop=st.booleans(),
    action=st.sampled_from(["place", "remove"]),
    cells=st.none() | st.builds(CellCount, *[st.integers(0, 999)] * 3),
)
def test_writing_and_reading_changes_nothing(
    positions: list, margin: float | None, kind: str | None, prop: bool, action: Any, cells: Any
) -> None:
    steps = tuple(
        Step(
            k, k, where, (1.0, 0.0, 0.0, 0.0), action, kind, prop, margin_g=margin, tilt_deg=margin
        )
        for k, where in enumerate(positions, 1)
    )
    plan = dataclasses.replace(
        Plan.load(EXAMPLE), steps=steps, assembly=None, cells=cells, kit="bricks"
    )
    text = json.dumps(plan.to_dict(), allow_nan=False)
    again = Plan.from_dict(json.loads(text))
    assert again == plan
    assert json.dumps(again.to_dict()) == text


def test_saving_and_loading(tmp_path: Path) -> None:
    plan = Plan.load(EXAMPLE)
    files = plan.save(tmp_path / "deep" / "folder", page=False)
    names = ["assembly.json", "bill.csv", "cards.html", "plan.json"]
    assert sorted(path.name for path in files.values()) == names
    assert sorted(path.name for path in (tmp_path / "deep" / "folder").iterdir()) == names
    assert Plan.load(tmp_path / "deep" / "folder") == plan
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="can be made"):
        plan.save(tmp_path / "file")


def test_a_step_names_a_block_of_the_assembly() -> None:
    plan = Plan.load(EXAMPLE)
    steps = (*plan.steps[:-1], dataclasses.replace(plan.steps[-1], block=9))
    with pytest.raises(InputError, match=r"steps\[7\]\.block: got 9, expected 0 to 8"):
        dataclasses.replace(plan, steps=steps)


def change(path: str, value: Any) -> Callable[[dict[str, Any]], None]:
    """Set, or with ``...`` remove, what is at a path such as ``steps.2.position``."""

    def act(data: Any) -> None:
        *parents, last = [int(key) if key.isdigit() else key for key in path.split(".")]
        for key in parents:
            data = data[key]
        if value is ...:
            del data[last]
        else:
            data[last] = value

    return act


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("format", "other", "plan: format"),
        ("version", True, "an integer"),
        ("status", "complet", "did you mean 'complete'"),
        ("design", ..., "the key 'design'"),
        ("blocks.used", ..., "the key 'used' in blocks"),
        ("steps.2.blok", 1, "did you mean 'block'"),
        ("steps.2.relation", "under", "steps[2].relation"),
        ("steps.2.reference", 3, "steps[2].reference"),
        ("steps.2.block", -1, "steps[2].block"),
        ("steps.2.sides", [0.5], "2 shares, one for each target"),
        ("steps.2.step", 7, "steps[2].step"),
        ("steps.2.position", [0, 0], "a list of 3 values"),
        ("steps.2.position", [0, 0, math.nan], "a finite number"),
        ("steps.2.position", [0, 0, 1e308], "steps[2].position[2]: got 1e+308"),
        ("steps.2.quaternion", [0, 0, 0, 0], "steps[2].quaternion"),
        ("steps.2.prop", 1, "true or false"),
        ("design.targets.0.outline", [[0, 0]], "design.targets[0].outline[0]"),
        ("design.block_edge", 0, "design.block_edge"),
        ("design.name", 5, "expected text"),
        ("steps", 3, "expected a list"),
    ],
)
def test_a_broken_plan_is_refused_in_one_line(path: str, value: Any, words: str) -> None:
    data = example()
    change(path, value)(data)
    with pytest.raises(InputError) as caught:
        Plan.from_dict(data)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


# ---------------------------------------------------------------- words


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


@pytest.mark.parametrize(("depth", "told"), [(0.0395, "y 40"), (0.07417, "y 80"), (0.1, "y 100")])
def test_the_last_line_of_a_grid_is_not_well_behind_what_stands(depth: float, told: str) -> None:
    """A wall 39.5 mm thick had `y 50` at its back corner, where it ends."""
    ends = [(k * 0.16, (k + 1) * 0.16) for k in range(5)]
    blocks = tuple(box_block(f"b{k}", (a, 0, 0), (b, depth, 0.04)) for k, (a, b) in enumerate(ends))
    made = Assembly(blocks, tuple(AssemblyStep(block.id) for block in blocks))
    book = booklet(made)
    for picture in (book.cover, *(card.picture for card in book.cards)):
        labels = [text for _, text, side in picture.grid.labels if text.startswith("y ")]
        assert labels == [told]


def test_a_kind_does_not_repeat_the_size() -> None:
    """Blocks without a kind are called by their size, which has a column of its own."""
    text = render_assembly_page(turned(), title="x")
    row = re.search(r'<tr data-step="1">(.*?)</tr>', text)
    assert row
    assert row[1].count("100 × 50 × 40") == 1
    bill = text.split("Bill of blocks")[1].split("</table>")[0]
    assert "</svg>A</td><td>block</td>" in bill


def test_names_between_backticks_are_code_on_a_page() -> None:
    reason = "no blocks of kit `my <bricks>` fill 2 cells"
    text = render_assembly_page(turned(), title="x", verdict=Verdict("refused", reason))
    assert "No blocks of kit <code>my &lt;bricks&gt;</code> fill 2 cells." in text


def test_tables_break_no_words_and_captions_have_one_weight() -> None:
    style = re.sub(r"\s+", " ", asset("page.css"))
    cells = [
        rule for rule in re.findall(r"[^{}]*\{[^{}]*\}", style) if re.match(r" ?t[hd]\b", rule)
    ]
    assert cells
    assert not any("anywhere" in rule for rule in cells)
    captions = re.findall(r"\.caption \{[^{}]*\}", style)
    assert captions
    assert not any("font-weight" in rule for rule in captions)


def test_a_preview_is_as_large_as_what_it_shows() -> None:
    """Of a long low design most of the picture was empty, and the last view far to the right."""
    wanted = np.ones((10, 1, 5), bool)
    image = Image.open(io.BytesIO(preview.draw(CellDesign("bench", wanted, (0.05,) * 3))))
    around = preview.HEAD + preview.MARGIN + preview.FOOT
    assert image.height == around + preview.SIDE // 2
    paper = np.asarray(image.convert("RGB"))
    cell = np.abs(paper.astype(int) - (236, 202, 144)).sum(-1) < 30
    columns = np.flatnonzero(cell.any(0))
    assert image.width - columns[-1] <= preview.MARGIN + 2
    assert np.diff(columns).max() < 0.2 * image.width
