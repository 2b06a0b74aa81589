"""Instructions to build by: who has only the printed numbers builds the same structure.

Shapes are drawn as blocks stand, so that sizes and corners are the plain ones.
"""

from __future__ import annotations

import csv
import importlib.util
import inspect
import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.assembly.blocks import Assembly, AssemblyStep, Block, hull_block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.files import write_assembly
from learn2assemble.assembly.instructions.shapes import corners_at, rotation
from learn2assemble.assembly.instructions.steps import MOST_TOGETHER, instructions, shapes_of
from learn2assemble.assembly.instructions.words import corner_words
from learn2assemble.cli import main
from learn2assemble.export.cards import step_cards
from learn2assemble.export.formats import bill_of_blocks
from learn2assemble.export.pdf import pdf
from learn2assemble.export.pictures import booklet
from learn2assemble.export.projection import DrawnScene
from learn2assemble.fonts import font_file
from learn2assemble.viewer.page import render_assembly_page
from read_back import (
    ALLOWED,
    PRINTED,
    STRUCTURES,
    arch,
    cards_text,
    largest_error,
)


@pytest.mark.parametrize("document", PRINTED)
@pytest.mark.parametrize("name", STRUCTURES)
def test_the_printed_numbers_are_enough(name: str, document: str) -> None:
    if document == "PDF":
        pytest.importorskip("pypdf")
    assembly = STRUCTURES[name]()
    assert largest_error(assembly, PRINTED[document](assembly)) <= ALLOWED


def test_layers_are_numbered_alike_on_cards_and_page() -> None:
    """What stands from the start has layers, too; what only goes has none."""
    pier = box_block("pier", (0, 0, 0), (0.1, 0.2, 1.0), support=True)
    old = box_block("old", (0, 0, 1.0), (0.2, 0.2, 1.1))
    new = box_block("new", (0, 0, 1.1), (0.2, 0.2, 1.2))
    gone = box_block("gone", (0, 0, 1.2), (0.2, 0.2, 1.3))
    steps = (AssemblyStep(remove="gone"), AssemblyStep(place="new"))
    assembly = Assembly((pier, old, new, gone), steps)
    told = instructions(assembly)
    assert [told.layers, told.groups[-1].layer] == [3, 3]
    for text in (step_cards(assembly), render_assembly_page(assembly, title="pier")):
        assert "Layer 3 of 3, from 1100 mm" in text
    assert "3 layers, told on" in step_cards(assembly)


def test_the_house_is_large_has_props_and_colours() -> None:
    made = STRUCTURES["house"]()
    placed = [made.block(step.place) for step in made.steps if step.place]
    assert sum(not block.prop for block in placed) >= 60
    assert any(block.prop for block in placed)
    assert len({block.colour for block in placed if not block.prop}) == 3


def test_blocks_of_a_tenth_of_a_millimetre_are_told_too() -> None:
    """As metres are read that were taken for millimetres: no corner stands for another one."""
    blocks = [replace(block, vertices=block.vertices / 2000) for block in arch().blocks]
    shapes = shapes_of(Assembly(tuple(blocks)))
    assert len(shapes.found) == 1
    for block in blocks:
        pose = shapes.pose(block)
        told = corners_at(pose.shape.corners, pose.position, pose.turn) + shapes.origin
        away = np.linalg.norm(told[:, None] - block.vertices, axis=-1)
        assert away.min(0).max() < 1e-3 * block.extent


def test_a_wrong_number_is_noticed() -> None:
    assembly = STRUCTURES["gate"]()
    text = cards_text(assembly)
    wrong = text.replace("|300|0|0|0|", "|301|0|0|0|")
    assert wrong != text
    assert largest_error(assembly, wrong) > ALLOWED


def wide(count: int) -> Assembly:
    blocks = [
        box_block(f"b{k}", (0.1 * k, 0, 0), (0.1 * k + 0.05, 0.05, 0.05)) for k in range(count)
    ]
    return Assembly(tuple(blocks), tuple(AssemblyStep(b.id) for b in blocks))


def test_blocks_where_nothing_is_at_stake_are_one_step() -> None:
    groups = instructions(wide(MOST_TOGETHER + 2)).groups
    assert [len(group.placements) for group in groups] == [MOST_TOGETHER, 2]


def test_steps_have_one_number_and_cards_another() -> None:
    """Page, plan and cards count the same steps; a card says which of them it tells."""
    made = wide(MOST_TOGETHER + 2)
    count = MOST_TOGETHER + 2
    text = cards_text(made)
    assert f"|{count} blocks in {count} steps and 1 layer, told on 2 cards|" in text
    assert f"|Steps 1 to {MOST_TOGETHER}|card 1 of 2|" in text
    assert f"|Steps {count - 1} and {count}|card 2 of 2|" in text
    lone = Assembly(made.blocks[:1], made.steps[:1])
    assert "|Step 1|card 1 of 1|" in cards_text(lone)
    if importlib.util.find_spec("pypdf"):
        assert f"|Steps 1 to {MOST_TOGETHER}|card 1 of 2|" in PRINTED["PDF"](made)


def test_what_is_said_of_other_steps_are_numbers_of_the_plan() -> None:
    """Six blocks on one card, a prop as step 7 on the second, which step 9 takes away."""
    row = wide(MOST_TOGETHER).blocks
    more = (
        box_block("p", (0.05, 0, 0), (0.1, 0.05, 0.05), prop=True),
        box_block("l", (0, 0, 0.05), (0.15, 0.05, 0.1)),
    )
    blocks = (*row, *more)
    steps = (*(AssemblyStep(block.id) for block in blocks), AssemblyStep(remove="p"))
    text = cards_text(Assembly(blocks, steps))
    assert f"|Step {MOST_TOGETHER + 1}|card 2 of 4|" in text
    assert f"it stands only for a while until step {MOST_TOGETHER + 3}" in text


def test_what_hangs_over_and_props_are_steps_of_their_own() -> None:
    posts = wide(2).blocks
    lintels = [
        box_block(f"l{k}", (0, 0.025 * k, 0.05), (0.15, 0.025 * k + 0.025, 0.1)) for k in range(2)
    ]
    prop = box_block("p", (0.05, 0, 0), (0.1, 0.05, 0.05), prop=True)
    ids = ["b0", "p", "b1", "l0", "l1"]
    steps = (*map(AssemblyStep, ids), AssemblyStep(remove="p"))
    groups = instructions(Assembly((*posts, prop, *lintels), steps)).groups
    assert [len(group.placements) for group in groups] == [1] * 6
    text = cards_text(Assembly((*posts, prop, *lintels), steps))
    assert "it stands only for a while until step 6" in text
    assert "Take the prop away" in text


def test_near_blocks_are_drawn_over_far_ones() -> None:
    blocks = (
        box_block("front", (0, 0, 0), (1, 1, 1)),
        box_block("back", (0, 1, 0), (1, 2, 1)),
        box_block("top", (0, 0, 1), (1, 2, 2)),
        box_block("right", (1, 0, 0), (2, 1, 1)),
    )
    scene = DrawnScene(instructions(Assembly(blocks)))
    order = [blocks[drawn.block].id for drawn in scene.drawn]
    assert order.index("back") < order.index("front") < order.index("top")
    assert order.index("right") < order.index("front")


def test_pages_have_numbers_and_none_is_empty() -> None:
    pypdf = pytest.importorskip("pypdf")
    made = pdf(wide(40))
    pages = pypdf.PdfReader(io.BytesIO(made)).pages
    assert len(pages) > 2
    for number, page in enumerate(pages, 1):
        text = page.extract_text()
        assert f"page {number} of" in text
        assert len(text) > 60
    assert made == pdf(wide(40)), "equal instructions are equal files"


@pytest.mark.parametrize("name", ["Ödön", "Żółć", "Школа Ђурђевић", "Στοά"])
def test_names_of_european_languages_are_written(name: str) -> None:
    """By a font of ours where the fonts of every PDF lack a letter."""
    pypdf = pytest.importorskip("pypdf")
    made = pdf(Assembly(wide(3).blocks, name=name))
    text = "".join(page.extract_text() for page in pypdf.PdfReader(io.BytesIO(made)).pages)
    assert name in text
    assert pdf(Assembly(wide(3).blocks, name=f"{name} 塔"))
    assert (b"DejaVu" in made) == (name != "Ödön")


@pytest.mark.parametrize("bold", [False, True])
def test_fonts_have_the_letters_of_european_languages(bold: bool) -> None:
    fonts = pytest.importorskip("reportlab.pdfbase.ttfonts")
    letters = fonts.TTFont("test", str(font_file(bold))).face.charToGlyph
    names = {
        "Latin": range(0xC0, 0x180),
        "Greek": range(0x3B1, 0x3CA),
        "Cyrillic": range(0x400, 0x460),
    }
    for name, codes in names.items():
        assert not {chr(code) for code in codes} - {chr(code) for code in letters}, name


def test_many_steps_stay_small() -> None:
    """Blocks of a bond that hangs over, so that every block is a step of its own."""
    post = box_block("post", (0, 0, 0), (0.03, 0.05, 0.05))
    rows = [
        box_block(
            f"b{k}",
            (0.1 * x + 0.05 * (z % 2), 0, 0.05 * (z + 1)),
            (0.1 * x + 0.05 * (z % 2) + 0.1, 0.05, 0.05 * (z + 2)),
        )
        for k, (z, x) in enumerate((z, x) for z in range(20) for x in range(15))
    ]
    blocks = (post, *rows)
    made = Assembly(blocks, tuple(AssemblyStep(b.id) for b in blocks))
    assert len(instructions(made).groups) == 301
    for size in (len(step_cards(made)), len(pdf(made))):
        assert size / 301 < 4e6 / 2400


def test_wedges_that_are_alike_are_one_shape_of_one_kind() -> None:
    told = instructions(arch(9))
    assert [(line.built, line.shape.kind) for line in told.bill] == [(9, "100 × 93.77 × 68.94 mm")]
    assert len({placement.turn for placement in told.placements}) == 9


def test_mirror_images_are_two_shapes() -> None:
    def corner(name: str, side: float, x: float) -> Block:
        points = np.array([(0, 0, 0), (0.1 * side, 0, 0), (0, 0.05, 0), (0, 0, 0.03)])
        faces = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
        turned = tuple(face[::-1] for face in faces) if side < 0 else faces
        return Block(name, points + np.array([x, 0, 0]), turned)

    blocks = (corner("a", 1, 0), corner("b", -1, 0.5), corner("c", 1, 1))
    bill = instructions(Assembly(blocks, tuple(AssemblyStep(b.id) for b in blocks))).bill
    assert [line.built for line in bill] == [2, 1]


def test_triangles_in_one_plane_are_drawn_as_one_face() -> None:
    """Between two drawn side by side, what is behind shows as a hairline."""
    whole = box_block("whole", (0, 0, 0), (0.3, 0.1, 0.2))
    halves = tuple(part for a, b, c, d in whole.faces for part in ((a, b, c), (a, c, d)))
    cut = Block("cut", whole.vertices, halves)
    (figure,), (same,) = (
        DrawnScene(instructions(Assembly((block,)))).figures for block in (cut, whole)
    )
    assert len(figure.faces) == len(same.faces) == 3
    for (face, light), (other, like) in zip(figure.faces, same.faces, strict=True):
        assert light == pytest.approx(like)
        assert np.sort(face, axis=0) == pytest.approx(np.sort(other, axis=0))


def test_what_is_not_built_is_not_told_to_stand() -> None:
    """Two of nine wedges stand; the other seven hang over nothing."""
    whole = arch(9)
    made = replace(whole, steps=whole.steps[:2]).as_far_as_placed()
    assert made.not_built == tuple(f"v{k}" for k in range(2, 9))
    assert [block.id for block in made.finished.blocks] == ["v0", "v1"]
    told = instructions(made)
    assert not told.start
    assert [line.built for line in told.bill] == [2]
    for text in (cards_text(made), PRINTED["PDF"](made)):
        assert "not finished: 7 blocks of the design have no step" in text
        assert "Stands from the start" not in text
    assert "Start: 0 blocks in place." in step_captions(made)


def step_captions(assembly: Assembly) -> str:
    return render_assembly_page(assembly, title="x").split('"captions":')[1][:200]


def test_what_stands_from_the_start_has_its_shape_in_the_bill() -> None:
    plate = box_block("plate", (0, 0, -0.02), (0.3, 0.1, 0), support=True)
    made = Assembly((plate, *wide(2).blocks), wide(2).steps)
    lines = [(line.built, line.standing) for line in instructions(made).bill]
    assert lines == [(0, 1), (2, 0)]
    text = cards_text(made)
    assert "|Stands from the start|" in text
    assert "|0 + 1 standing|" in text


def test_what_is_written_at_a_grid_lies_inside_the_picture() -> None:
    text = step_cards(STRUCTURES["house"]())
    cover = re.search(r'<svg viewBox="(-?\d+) -?\d+ (\d+) \d+" font-size="(\d+)"', text)
    assert cover
    left, width, font = map(int, cover.groups())
    labels = re.findall(r'<text class=e x="(-?\d+)" y="-?\d+">([^<]*)</text>', text)
    assert any(words.startswith("z ") for _, words in labels)
    assert all(left <= int(x) - 0.6 * font * len(words) for x, words in labels)
    assert all(int(x) <= left + width for x, _ in labels)


def test_shapes_are_drawn_at_one_scale() -> None:
    """On the cards a block of eight studs is some eight times as long as one of one stud."""
    blocks = (
        box_block("one", (0, 0, 0), (0.05, 0.05, 0.05)),
        box_block("eight", (0, 0.1, 0), (0.4, 0.15, 0.05)),
        box_block("ground", (-1, -1, -0.1), (1, 1, 0), support=True),
    )
    steps = tuple(AssemblyStep(block.id) for block in blocks[:2])
    figures = re.findall(
        r'<figure><svg viewBox="\S+ \S+ (\d+) (\d+)".*? style="width:([\d.]+)rem">.*?'
        r"<figcaption>([^<]*)<",
        step_cards(Assembly(blocks, steps)),
    )
    scales = {words: float(width) / float(units) for units, _, width, words in figures}
    assert list(scales) == ["A", "B", "C (smaller scale)"]
    assert scales["A"] == pytest.approx(scales["B"], rel=0.03)
    assert scales["C (smaller scale)"] < 0.5 * scales["A"]
    shapes = {shape.letter: picture for shape, picture in booklet(Assembly(blocks, steps)).shapes}
    assert shapes["A"].within == shapes["B"].within
    assert shapes["C"].within is None


def test_a_card_is_no_higher_than_what_it_shows() -> None:
    """Cards have one scale and one place of O; their pictures grow with what stands."""
    rows = [box_block(f"b{k}", (0, 0, 0.05 * k), (0.05, 0.05, 0.05 * k + 0.05)) for k in range(12)]
    made = Assembly(tuple(rows), tuple(AssemblyStep(block.id) for block in rows))
    pictures = [card.picture for card in booklet(made).cards]
    assert len({picture.within for picture in pictures}) == 1
    assert len({(*picture.low.tolist(), picture.high[0]) for picture in pictures}) == 1
    scene = booklet(made).scene
    for picture in pictures:
        drawn = [scene.figures[use.name].frame[1, 1] + use.at[1] for use in picture.uses]
        ends = [arrow[0][1] for arrow in picture.arrows] + [
            line.max(0)[1] for line in picture.grid.lines
        ]
        assert picture.high[1] - max(drawn + ends) < 0.1 * pictures[-1].size[1]
    blocks_alone = booklet(made).cover
    assert blocks_alone.size[1] <= pictures[-1].size[1], "nothing comes any more"


def frustum(
    name: str,
    at: tuple[float, float, float] = (0, 0, 0),
    foot: float = 0.08,
    top: float = 0.06,
    height: float = 0.1,
) -> Block:
    """A square column that is wider or narrower above, about a middle of its foot [m]."""
    ends = ((foot / 2, 0.0), (top / 2, height))
    points = [(x * r, y * r, z) for r, z in ends for x in (-1, 1) for y in (-1, 1)]
    return hull_block(name, np.array(points) + at)


def turned(block: Block, turn: tuple[float, float, float], name: str = "") -> Block:
    """A block turned about x, y and z [deg], and moved aside."""
    return replace(
        block, id=name or block.id, vertices=block.vertices @ rotation(turn).T + (1, 2, 3)
    )


def temple() -> Assembly:
    """Columns, capitals, an architrave of two and a pediment."""
    blocks = [frustum(f"column{k}", (0.12 * k, 0, 0)) for k in range(3)]
    blocks += [
        frustum(f"capital{k}", (0.12 * k, 0, 0.1), foot=0.06, top=0.1, height=0.03)
        for k in range(3)
    ]
    blocks += [
        box_block(f"beam{k}", (0.17 * k - 0.05, -0.05, 0.13), (0.17 * k + 0.12, 0.05, 0.17))
        for k in range(2)
    ]
    roof = [
        (x, y, z) for x, z in ((-0.05, 0.17), (0.29, 0.17), (0.12, 0.25)) for y in (-0.05, 0.05)
    ]
    blocks.append(hull_block("pediment", roof))
    return Assembly(tuple(blocks), tuple(AssemblyStep(b.id) for b in blocks), name="temple")


def test_a_column_that_stands_is_told_as_it_stands() -> None:
    told = instructions(temple())
    lines = [(line.shape.letter, line.built, line.shape.kind) for line in told.bill]
    assert lines == [
        ("A", 3, "80 × 80 × 100 mm"),
        ("B", 3, "100 × 100 × 30 mm"),
        ("C", 2, "170 × 100 × 40 mm"),
        ("D", 1, "340 × 100 × 80 mm"),
    ]
    assert {placement.turn for placement in told.placements} == {(0, 0, 0)}
    assert corner_words(told.shapes[0]) == (
        "1 (0, 0, 0); 2 (80, 0, 0); 3 (0, 80, 0); 4 (80, 80, 0); "
        "5 (10, 10, 100); 6 (70, 10, 100); 7 (10, 70, 100); 8 (70, 70, 100)"
    )
    sizes = [np.round(1000 * line.shape.size, 6).tolist() for line in told.bill]
    assert sizes == [[80, 80, 100], [100, 100, 30], [170, 100, 40], [340, 100, 80]]


@pytest.mark.parametrize("document", PRINTED)
def test_the_printed_numbers_of_any_pose_are_enough(document: str) -> None:
    if document == "PDF":
        pytest.importorskip("pypdf")
    turns = [(0, 0, 0), (0, 0, 30), (180, 0, 0), (20, 35, -70), (90, 0, 0)]
    blocks = [turned(frustum(f"c{k}"), turn) for k, turn in enumerate(turns)]
    blocks = [
        replace(block, vertices=block.vertices + np.array((0.3 * k, 0, 0)))
        for k, block in enumerate(blocks)
    ]
    made = Assembly(tuple(blocks), tuple(AssemblyStep(block.id) for block in blocks))
    told = instructions(made)
    assert [line.built for line in told.bill] == [5], "one shape at any pose"
    assert told.placements[0].turn == (0, 0, 0)
    assert told.placements[1].turn == pytest.approx((0, 0, 30))
    assert largest_error(made, PRINTED[document](made)) <= ALLOWED


def test_the_bill_lists_the_shapes_of_the_cards() -> None:
    made = temple()
    told = instructions(made)
    rows = list(csv.DictReader(io.StringIO(bill_of_blocks(made))))
    assert [(row["shape"], row["kind"], int(row["built_in"])) for row in rows] == [
        (line.shape.letter, line.shape.kind, line.built) for line in told.bill
    ]
    for row, line in zip(rows, told.bill, strict=True):
        sizes = [float(row[name]) for name in ("length_m", "width_m", "height_m")]
        assert sizes == pytest.approx(line.shape.size, rel=1e-5)
        assert float(row["mass_kg"]) == pytest.approx(line.shape.mass, rel=1e-5)
    mass = sum(int(row["built_in"]) * float(row["mass_kg"]) for row in rows)
    assert mass == pytest.approx(sum(block.mass for block in made.blocks), rel=1e-5)


def test_the_terminal_lists_the_shapes_of_the_cards(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_assembly(temple(), tmp_path / "temple.json")
    main(["build", str(tmp_path / "temple.json"), "--gap", "0", "--out", str(tmp_path / "out")])
    said = re.findall(r"^ *(\S+ × \S+ × \S+ mm) +(\d+)$", capsys.readouterr().out, re.MULTILINE)
    assert said == [
        ("80 × 80 × 100 mm", "3"),
        ("100 × 100 × 30 mm", "3"),
        ("170 × 100 × 40 mm", "2"),
        ("340 × 100 × 80 mm", "1"),
    ]


def test_one_that_stands_shows_how_a_shape_is_drawn() -> None:
    """Also where it comes after others that lean; letters follow the blocks."""
    blocks = (
        turned(frustum("leans"), (20, 35, -70)),
        box_block("box", (0, 0, 0), (0.1, 0.1, 0.1)),
        turned(frustum("lies"), (97, 0, 10)),
        frustum("stands", (0.5, 0, 0)),
    )
    told = instructions(Assembly(blocks))
    assert [shape.letter for shape in told.shapes] == ["A", "B"]
    assert told.placements[0].shape is told.placements[3].shape
    assert told.shapes[0].size == pytest.approx((0.08, 0.08, 0.1))
    assert told.placements[3].turn == (0, 0, 0)


def test_the_longest_level_edge_goes_along_x() -> None:
    box = box_block("b", (0, 0, 0), (0.03, 0.1, 0.05))
    told = instructions(Assembly((turned(box, (0, 0, 25)), turned(box, (0, 0, 0), "other"))))
    assert [line.shape.size for line in told.bill] == [pytest.approx((0.1, 0.03, 0.05))]
    roof = hull_block("r", [(0, 0, 0), (0.1, 0, 0), (0, 0.4, 0), (0.1, 0.4, 0), (0.05, 0.2, 0.1)])
    [shape] = instructions(Assembly((turned(roof, (0, 0, 40)),))).shapes
    assert shape.size == pytest.approx((0.4, 0.1, 0.1))


def test_diagonals_of_a_mesh_are_no_edges() -> None:
    """A leaning pillar of triangles, as meshes have them."""
    box = turned(box_block("b", (0, 0, 0), (0.2, 0.1, 0.3)), (0, 0, 10))
    halves = tuple(half for a, b, c, d in box.faces for half in ((a, b, c), (a, c, d)))
    [shape] = instructions(Assembly((replace(box, faces=halves),))).shapes
    assert shape.size == pytest.approx((0.2, 0.1, 0.3))


@pytest.mark.parametrize("count", [6, 8, 24])
def test_a_round_column_has_no_turn(count: int) -> None:
    angles = 2 * np.pi * np.arange(count) / count
    points = [(0.1 * np.cos(a), 0.1 * np.sin(a), z) for a in angles for z in (0, 0.4)]
    told = instructions(Assembly((hull_block("column", points),)))
    assert told.placements[0].turn == (0, 0, 0)
    assert told.shapes[0].size == pytest.approx(np.ptp(points, axis=0))


def test_mirror_images_that_stand_are_two_shapes_in_the_order_of_the_blocks() -> None:
    flat = np.array([(0, 0), (0.1, 0), (0.03, 0.06)])
    points = np.array([(*p, z) for p in flat for z in (0, 0.05)])
    blocks = [hull_block("a", points)]
    blocks.append(
        hull_block(
            "tip", np.array([(0, 0, 0.2), (0.1, 0, 0.2), (0.03, 0.06, 0.2), (0.02, 0.02, 0.3)])
        )
    )
    blocks.append(hull_block("pit", blocks[1].vertices * (-1, 1, 1) + (0.5, 0, 0)))
    blocks.append(turned(blocks[1], (15, 25, 35), "tip2"))
    told = instructions(Assembly(tuple(blocks)))
    assert [p.shape.letter for p in told.placements] == ["A", "B", "C", "B"]


def test_the_ways_to_make_blocks_are_as_documented() -> None:
    """``docs/given_blocks.md`` gives the arguments in the order of the functions."""
    text = (Path(__file__).resolve().parents[1] / "docs" / "given_blocks.md").read_text("utf-8")
    told = dict(re.findall(r"^\| `l2a\.(\w+)\(([\w, ]+), \*\*more\)` \|", text, re.MULTILINE))
    assert set(told) == {"box_block", "hull_block", "Block"}
    for name, words in told.items():
        parameters = list(inspect.signature(getattr(l2a, name)).parameters)
        assert parameters[: words.count(",") + 1] == words.split(", "), name
    fields = inspect.signature(Block).parameters
    more = re.findall(r"`(\w+)` \(", text.split("`more`, by name")[1].split("\n")[0])
    assert set(more) == set(fields) - {"id", "vertices", "faces"}
