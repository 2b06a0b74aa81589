"""Shapes are drawn as blocks stand, so that sizes and corners are the plain ones."""

from __future__ import annotations

import csv
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
from learn2assemble.assembly.instruction_words import corner_words
from learn2assemble.assembly.instructions import instructions
from learn2assemble.assembly.shapes import rotation
from learn2assemble.cli import main
from learn2assemble.export.formats import bill_of_blocks
from read_back import ALLOWED, PRINTED, largest_error


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
    """``docs/design_files.md`` gives the arguments in the order of the functions."""
    text = (Path(__file__).resolve().parents[1] / "docs" / "design_files.md").read_text("utf-8")
    told = dict(re.findall(r"^\| `l2a\.(\w+)\(([\w, ]+), \*\*more\)` \|", text, re.MULTILINE))
    assert set(told) == {"box_block", "hull_block", "Block"}
    for name, words in told.items():
        parameters = list(inspect.signature(getattr(l2a, name)).parameters)
        assert parameters[: words.count(",") + 1] == words.split(", "), name
    fields = inspect.signature(Block).parameters
    more = re.findall(r"`(\w+)` \(", text.split("`more`, by name")[1].split("\n")[0])
    assert set(more) == set(fields) - {"id", "vertices", "faces"}
