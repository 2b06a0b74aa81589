"""Whoever is shown or given a plan with holds or posts gets all of it: words, pictures, files."""

from __future__ import annotations

import csv
import io
import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from headless import SPATIAL, find_browser, pixels, shoot
from learn2assemble.assembly.blocks import Assembly, AssemblyStep, Block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.compas import from_compas, to_compas
from learn2assemble.assembly.cuts import cut_of
from learn2assemble.assembly.files import read_assembly
from learn2assemble.assembly.instructions.steps import instructions
from learn2assemble.cli import main
from learn2assemble.export.cards import step_cards
from learn2assemble.export.formats import bill_of_blocks, export_assembly
from learn2assemble.export.pictures import Card, booklet
from learn2assemble.planning.given import plan_assembly
from learn2assemble.planning.plan import Plan
from learn2assemble.statics.proofs import BED
from learn2assemble.viewer.page import render_assembly_page
from learn2assemble.viewer.tables import StepNote
from read_back import ALLOWED, PRINTED, arch, largest_error, visible_text

HELD = "#7d4fd6"


@cache
def planned(kind: str) -> Plan:
    if kind == "holds":
        plan = plan_assembly(replace(arch(7), steps=(), friction=0.7), holds=1, supports="none")
    else:
        plan = plan_assembly(replace(arch(5), steps=(), friction=0.7), supports="posts")
    assert plan.complete, plan.reason
    return plan


def blocks_of(kind: str) -> Assembly:
    made = planned(kind).assembly
    assert made is not None
    return made


def first(assembly: Assembly, action: str) -> int:
    """The number of the first step that does so, from 1."""
    return next(k for k, step in enumerate(assembly.steps, 1) if step.action == action)


@cache
def saved(kind: str, folder: Path) -> Path:
    planned(kind).save(folder)
    return folder


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("plans")
    return {kind: saved(kind, root / kind) for kind in ("holds", "posts")}


def caption(page: str, step: int) -> str:
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', page)
    assert data
    return json.loads(data[1])["captions"][step]


@pytest.mark.parametrize("document", PRINTED)
@pytest.mark.parametrize("kind", ["holds", "posts"])
def test_the_printed_numbers_are_enough(kind: str, document: str) -> None:
    if document == "PDF":
        pytest.importorskip("pypdf")
    assembly = blocks_of(kind)
    assert largest_error(assembly, PRINTED[document](assembly)) <= ALLOWED


def test_the_page_says_what_a_hand_does(folders: dict[str, Path]) -> None:
    page = (folders["holds"] / "view.html").read_text()
    assembly = blocks_of("holds")
    hold, release = first(assembly, "hold"), first(assembly, "release")
    id_ = assembly.steps[hold - 1].block
    assert caption(page, hold).startswith(
        f"Hold block {id_} (a hand keeps it in its place). "
        "Stands: on joints that weight presses, with friction."
    )
    assert f"Still in a hand: {id_}." in caption(page, hold + 1)
    assert caption(page, release).startswith(
        f"Let go of block {assembly.steps[release - 1].block}."
    )
    actions = re.findall(r'<tr data-step="\d+"><td><button.*?</td><td>(\w+)', page)
    assert actions == [step.action for step in assembly.steps]
    assert "held by a hand" in visible_text(page)


def test_the_page_tells_the_scripts_when_blocks_are_held(folders: dict[str, Path]) -> None:
    page = (folders["holds"] / "view.html").read_text()
    data = json.loads(re.findall(r'id="data">(.*?)</script>', page)[0])
    told = {(data["blocks"][number][-1], *ends) for number, *ends in data["holds"]}
    steps, wanted, since = blocks_of("holds").steps, set(), {}
    for number, step in enumerate(steps, 1):
        if step.action == "hold":
            since[step.block] = number
        elif step.action == "release":
            wanted.add((step.block, since.pop(step.block), number))
    assert told == wanted
    assert len(wanted) >= 2


def test_a_block_that_is_never_let_go_is_held_to_the_end() -> None:
    blocks = (box_block("a", (0, 0, 0), (1, 1, 1)), box_block("b", (0, 0, 1), (1, 1, 2)))
    assembly = Assembly(blocks, (AssemblyStep("a"), AssemblyStep(hold="a"), AssemblyStep("b")))
    page = render_assembly_page(assembly, title="x")
    assert '"holds":[[0,2,4]]' in page.replace(" ", "")
    assert "Still in a hand: a." in caption(page, 3)
    assert [group.held for group in instructions(assembly).groups] == [{0}, {0}], (
        "placed and held is one step"
    )


def cards_of(assembly: Assembly) -> dict[int, Card]:
    """By the number of every step of the assembly, the card that tells it."""
    book = booklet(assembly)
    return {p.number: card for card in book.cards for p in card.group.placements}


def test_cards_say_and_draw_what_a_hand_does() -> None:
    assembly = blocks_of("holds")
    hold, release = first(assembly, "hold"), first(assembly, "release")
    cards = cards_of(assembly)
    held, let_go = (assembly.steps[k - 1].block for k in (hold, release))
    card = cards[hold]
    assert assembly.steps[hold - 2].place == held
    assert card is cards[hold - 1], "a block is placed and held in one step"
    [words] = card.words
    assert words.endswith(f" Place block {held} and hold it.")
    [outline] = card.picture.outlines
    assert outline.mark == "held"
    assert outline.colour not in (None, "held"), "what is new keeps its colour"
    assert len(card.wanted) == 1
    assert [row[0] for row in card.rows] == [f"{hold - 1}, {hold}"]
    words = cards[release].words[0]
    new = next(p for p in cards[release].group.placements if p.action == "place")
    id_ = assembly.blocks[new.block].id
    placed = next(k for k, s in enumerate(assembly.steps, 1) if s.place == let_go)
    assert words.endswith(
        f"Place block {id_} and hold it; let go of block {let_go} of step {placed}."
    )
    assert assembly.steps[-1].action == "release"
    assert cards[len(assembly.steps)].group.held == frozenset()
    assert 'aria-label="Step' in step_cards(assembly)


def three(*steps: AssemblyStep) -> Assembly:
    """A column of three blocks."""
    blocks = tuple(box_block(name, (0, 0, k), (1, 1, k + 1)) for k, name in enumerate("abc"))
    return Assembly(blocks, steps)


def test_who_holds_another_block_does_so_for_the_next_one() -> None:
    made = three(
        AssemblyStep("a"),
        AssemblyStep("b"),
        AssemblyStep(hold="a"),
        AssemblyStep("c"),
        AssemblyStep(release="a"),
    )
    cards = booklet(made).cards
    assert [[p.action for p in card.group.placements] for card in cards] == [
        ["place"],
        ["place"],
        ["hold", "place", "release"],
    ]
    assert cards[2].words[0].endswith("Hold block a of step 1; place block c; let go of block a.")
    marks = {use.mark for use in cards[2].picture.outlines}
    assert marks == {"held", "new"}, "while it is done a is held"
    assert not cards[2].group.held
    text = step_cards(three(AssemblyStep("a"), AssemblyStep(hold="a", wait=24.0)))
    assert "Wait 24 h first" in text, "time passes between two steps"
    assert "hold a block" in text


def test_arrows_point_at_what_is_held_and_away_from_what_is_let_go() -> None:
    assembly = blocks_of("holds")
    cards = cards_of(assembly)
    for action, inward in (("hold", True), ("release", False)):
        *_, left, right = cards[first(assembly, action)].picture.arrows
        assert (left[0][0] < left[1][0]) == inward
        assert (right[0][0] > right[1][0]) == inward


def test_a_post_comes_from_the_side_where_something_stands_above() -> None:
    beam = box_block("beam", (0, 0, 1), (3, 1, 2))
    post = box_block("post-beam", (1, 0.2, 0), (1.5, 0.7, 1), kind="post", prop=True)
    feet = [box_block(f"foot{k}", (k, 0, 0), (k + 0.5, 1, 1)) for k in (0, 2.5)]
    ids = ("foot0", "foot2.5", "beam", "post-beam")
    assembly = Assembly((*feet, beam, post), tuple(map(AssemblyStep, ids)))
    [arrow] = booklet(assembly).cards[-1].picture.arrows
    assert abs(arrow[0][0] - arrow[1][0]) > 0.1, "not from straight above"


def test_posts_are_billed_as_props_with_their_cut(folders: dict[str, Path]) -> None:
    assembly = blocks_of("posts")
    posts = [block for block in assembly.blocks if block.prop]
    assert posts
    assert all(block.kind == "post" for block in posts)
    rows = [
        row
        for row in csv.DictReader(io.StringIO((folders["posts"] / "bill.csv").read_text()))
        if row["kind"] == "post"
    ]
    assert sum(int(row["props"]) for row in rows) == len(posts)
    assert {row["built_in"] for row in rows} == {"0"}
    for row in rows:
        assert 0 < float(row["shortest_edge_m"]) < float(row["height_m"])
        assert float(row["height_m"]) == pytest.approx(
            max(float(np.ptp(b.vertices[:, 2])) for b in posts), abs=1e-4
        )
        run = float(row["length_m"]) * np.tan(np.radians(float(row["cut_deg"])))
        drop = float(row["height_m"]) - float(row["shortest_edge_m"])
        assert run == pytest.approx(drop, abs=1e-4), "the section is square here"
    for text in (
        visible_text((folders["posts"] / name).read_text()) for name in ("view.html", "cards.html")
    ):
        assert "Posts to cut" in text
        assert "Longest edge [mm]" in text
        assert f"{float(rows[0]['cut_deg']):.1f}°" in text
    assert "Posts to cut" not in step_cards(blocks_of("holds"))


def test_posts_of_two_cuts_have_two_lines() -> None:
    def post(id_: str, x: float, *heights: float) -> Block:
        flat = [(0, 0), (0.1, 0), (0.1, 0.05), (0, 0.05)]
        points = [(x + u, v, 0.0) for u, v in flat]
        points += [(x + u, v, z) for (u, v), z in zip(flat, heights, strict=True)]
        box = ((3, 2, 1, 0), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
        return Block(id_, np.array(points), box, "post", prop=True)

    level = (0.3,) * 4
    blocks = (
        box_block("base", (0, 0, -0.1), (2, 1, 0), support=True),
        post("l", 0, *level),
        post("up", 0.5, 0.2, 0.3, 0.3, 0.2),
        post("down", 1, 0.3, 0.2, 0.2, 0.3),
    )
    cut = cut_of(blocks[2].vertices, blocks[2].faces)
    assert cut[:4] == pytest.approx((0.1, 0.05, 0.3, 0.2))
    assert cut.angles == pytest.approx((45,))
    rows = list(csv.DictReader(io.StringIO(bill_of_blocks(Assembly(blocks)))))
    found = sorted((row["props"], row["shortest_edge_m"], row["cut_deg"]) for row in rows)
    assert found == [("1", "0.3", "0"), ("2", "0.2", "45")]


@pytest.mark.parametrize("kind", ["holds", "posts"])
def test_files_keep_the_order(kind: str, folders: dict[str, Path]) -> None:
    plan, made = planned(kind), blocks_of(kind)
    again = from_compas(json.loads(json.dumps(to_compas(made))))
    assert again.steps == made.steps
    assert [(b.id, b.kind, b.prop) for b in again.blocks] == [
        (b.id, b.kind, b.prop) for b in made.blocks
    ]
    assert read_assembly(folders[kind] / "assembly.json").steps == made.steps
    loaded = Plan.load(folders[kind])
    assert loaded == plan
    assert [step.action for step in loaded.steps] == [step.action for step in made.steps]


@pytest.mark.parametrize("kind", ["holds", "posts"])
def test_programs_get_what_stands_in_the_end(kind: str, tmp_path: Path) -> None:
    import trimesh

    assembly = blocks_of(kind)
    names = {block.id for block in assembly.blocks if not block.prop}
    scene = trimesh.load_scene(export_assembly(assembly, "glb", tmp_path))
    assert set(scene.geometry) == names
    model = mujoco.MjModel.from_xml_path(str(export_assembly(assembly, "mjcf", tmp_path)))
    assert {model.body(k).name for k in range(1, model.nbody)} == names
    export_assembly(assembly, "pdf", tmp_path)
    assert (tmp_path / "instructions.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("kind", ["holds", "posts"])
def test_what_stands_already_is_kept_and_told(kind: str, tmp_path: Path) -> None:
    """An old wall beside, and the base of an arch that is built on it."""
    bare = replace(arch(5), steps=(), friction=0.7)
    ends = np.array([[b.vertices.min(0), b.vertices.max(0)] for b in bare.blocks])
    low, high = ends[:, 0].min(0), ends[:, 1].max(0)
    base = box_block("base", (low[0], low[1], low[2] - 0.1), (high[0], high[1], low[2]))
    wall = box_block("old wall", (high[0] + 0.3, low[1], low[2]), (high[0] + 0.4, high[1], high[2]))
    old = [replace(block, support=True) for block in (base, wall)]
    given = replace(bare, blocks=(*old, *bare.blocks))
    plan = plan_assembly(
        given, holds=kind == "holds", supports="none" if kind == "holds" else "auto"
    )
    assert plan.complete, plan.reason
    made = plan.assembly
    assert made is not None
    assert any(step.hold for step in made.steps) == (kind == "holds")
    assert any(block.prop for block in made.blocks) == (kind == "posts")
    plan.save(tmp_path / "plan")
    assert Plan.load(tmp_path / "plan") == plan
    for read in (
        read_assembly(tmp_path / "plan"),
        read_assembly(export_assembly(made, "assembly", tmp_path)),
        read_assembly(export_assembly(made, "compas", tmp_path)),
    ):
        assert read.steps == made.steps
        assert {b.id for b in read.blocks if b.support} == {"base", "old wall"}
        assert {b.id for b in read.blocks if b.prop} == {b.id for b in made.blocks if b.prop}
        for block in made.blocks:
            other = read.block(block.id)
            assert other.volume == pytest.approx(block.volume, rel=1e-6)
            assert other.centroid == pytest.approx(block.centroid, abs=1e-8)
    model = mujoco.MjModel.from_xml_path(str(export_assembly(made, "mjcf", tmp_path)))
    fixed = {model.body(k).name for k in range(1, model.nbody) if not model.body(k).jntnum[0]}
    assert fixed == {"base", "old wall"}
    standing = sum(line.standing for line in instructions(made).bill)
    assert standing == 2
    for text in (step_cards(made), visible_text((tmp_path / "plan" / "view.html").read_text())):
        assert "standing" in text or "2 fixed supports" in text


def test_a_proof_is_told_in_words_that_fit(tmp_path: Path) -> None:
    plan = planned("holds")
    steps = list(plan.steps)
    assert {step.proof for step in steps} == {BED}, "the plan keeps what it has always said"
    steps[2] = steps[2].with_proof(BED, None)
    plan = replace(plan, steps=tuple(steps))
    assert plan.without_margin == 1
    plan.save(tmp_path)
    page = (tmp_path / "view.html").read_text()
    text = visible_text(page)
    assert "bed faces" not in text
    assert "|not computed|–|" in text
    assert "What push it withstands was not computed." in caption(page, 3)
    assert "Withstands" in caption(page, 2)
    assert "push not computed|" in text


def test_level_joints_keep_their_name(tmp_path: Path) -> None:
    block = box_block("a", (0, 0, 0), (1, 1, 1))
    page = render_assembly_page(
        Assembly((block,), (AssemblyStep("a"),)), title="x", step_notes=[StepNote()]
    )
    assert "not computed" not in page.split("<script")[0], "without a proof nothing was to compute"
    plan = plan_assembly(Assembly((block,)))
    steps = tuple(step.with_proof(BED, 0.1) for step in plan.steps)
    replace(plan, steps=steps).save(tmp_path)
    assert "|on bed faces, with friction|" in visible_text((tmp_path / "view.html").read_text())


@pytest.mark.parametrize("source", ["assembly.json", "plan"])
def test_an_arm_refuses_holds(
    source: str, folders: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = folders["holds"] / "assembly.json"
    more: list[Any] = []
    if source == "plan":
        file, more = tmp_path / "arch.json", ["--holds", "1", "--supports", "none"]
        made = replace(blocks_of("holds"), steps=())
        export_assembly(made, "assembly", file)
    out = tmp_path / "out"
    code = main(["build", str(file), "--arm", "panda", "--out", str(out), *more])
    holds = sum(step.action == "hold" for step in planned("holds").steps)
    *_, line = capsys.readouterr().err.strip().splitlines()
    assert code == 2
    assert line == (
        f"l2a: error: steps that hold a block: got {holds}, expected a plan without holds; one arm "
        "has one hand"
    )
    assert not out.exists() or not list(out.iterdir())


def test_the_page_draws_what_is_held_in_its_colour(folders: dict[str, Path]) -> None:
    browser = find_browser()
    assembly = blocks_of("holds")
    hold = first(assembly, "hold")
    anchors = (f"step={hold}", f"step={len(assembly.steps)}")
    (held, end), log = shoot(browser, folders["holds"], anchors, (420, 560), *SPATIAL)
    assert "Uncaught" not in log
    assert _violet(held) > _violet(end) + 300, "in the end only the swatch of the legend has it"


def _violet(picture: np.ndarray) -> int:
    """Pixels of the colour of held blocks, in any light."""
    red, green, blue = (255 * picture[..., k] for k in range(3))
    shade = blue / 0xD6
    near = (np.abs(red - 0x7D * shade) < 8) & (np.abs(green - 0x4F * shade) < 8)
    return int((near & (blue > 60) & (blue > 1.5 * green)).sum()) + pixels(picture, HELD)
