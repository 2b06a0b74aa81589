"""Files of bricks: LDraw, brick text and the JSON of StableLego."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

import brick_data
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.bricks.files import brick_format
from learn2assemble.assembly.bricks.parts import COLOURS, PARTS, SIZES
from learn2assemble.assembly.files import read_assembly, write_assembly
from learn2assemble.assembly.joints import DRY, Joint
from learn2assemble.assembly.kit import load_kit, parse_kit
from learn2assemble.design.read import read_design
from learn2assemble.errors import InputError
from learn2assemble.export.formats import export_assembly

WALL = Path(__file__).parent / "data" / "example_plan" / "assembly.json"
TEXT = "2x4 (0,0,0)\n4x2 (0,2,1)\n\n1x1 (3, 3, 2)\n"
MPD = """0 FILE main.ldr
0 Tower
1 4 0 -24 0 1 0 0 0 1 0 0 0 1 3001.dat
0 STEP
1 16 0 -24 0 1 0 0 0 1 0 0 0 1 side.ldr
1 1 80 -24 0 0 0 1 0 1 0 -1 0 0 Side.ldr
0 FILE side.ldr
0 side
0 // a comment
2 24 0 0 0 1 1 1
1 16 20 -8 0 0 0 1 0 1 0 -1 0 0 parts\\3020.DAT
1 14 20 -32 0 1 0 0 0 1 0 0 0 1 3003p01.dat
"""


def read_ldraw(text: str) -> list[tuple[str, np.ndarray]]:
    """Another reader: colour and box [mm, z up] of every part, in the order of the file."""
    found = []
    for line in text.splitlines():
        words = line.split()
        if words[:1] == ["1"]:
            x, y, z, *turn = map(float, words[2:14])
            a, c, h = SIZES[words[14].removesuffix(".dat")]
            corners = np.array(
                [[i * a / 2, k, j * c / 2] for i in (-1, 1) for j in (-1, 1) for k in (0, h)]
            )
            points = corners @ np.reshape(turn, (3, 3)).T + [x, y, z]
            world = 0.4 * np.stack([points[:, 0], points[:, 2], -points[:, 1]], 1)
            found.append((words[1], np.stack([world.min(0), world.max(0)])))
    return found


def boxes(assembly) -> np.ndarray:
    return np.array([[b.vertices.min(0), b.vertices.max(0)] for b in assembly.blocks])


def write(tmp_path: Path, name: str, text: str) -> Path:
    (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path / name


def test_brick_text_has_real_sizes_and_masses(tmp_path: Path) -> None:
    made = read_assembly(write(tmp_path, "model.txt", TEXT))
    assert [b.kind for b in made.blocks] == ["2x4", "2x4", "1x1"]
    assert [b.id for b in made.blocks] == ["b1", "b2", "b3"]
    assert boxes(made)[1] == pytest.approx(np.array([[0, 0.016, 0.0096], [0.032, 0.032, 0.0192]]))
    assert [b.mass for b in made.blocks] == pytest.approx([2.16e-3, 2.16e-3, 0.43e-3])
    assert made.joint == load_kit("lego").joint
    assert made.joint.law == "clutch"
    assert made.steps == ()
    large = read_assembly(write(tmp_path, "large.txt", "2x4 (0,0,1)\n2x2 (0,0,2)\n"), kit="duplo")
    assert boxes(large)[0] == pytest.approx(np.array([[0, 0, 0], [0.032, 0.064, 0.0192]]))


STICK = [
    *((0, 0, 4), (6, 1, 5), (8, 2, 5), (10, 3, 4), (16, 2, 4)),
    *((22, 3, 6), (26, 2, 6), (30, 3, 6), (34, 2, 6), (38, 3, 6)),
    *((42, 2, 6), (44, 3, 5), (44, 4, 5), (44, 5, 5), (8, 0, 9)),
]
"""x, z and kind of the bricks of one of StableLego's designs; all have y 21 and are turned."""


def test_stablelego_in_both_forms_is_the_same_model(tmp_path: Path) -> None:
    ours = brick_data.design("stick_heavy_good")
    rows = {
        str(k): {"y": 21, "x": x, "z": z, "ori": 1, "brick_id": kind}
        for k, (x, z, kind) in enumerate(STICK, 1)
    }
    theirs = read_assembly(write(tmp_path, "stick.json", json.dumps(rows)))
    assert len(ours.blocks) == len(theirs.blocks) == 15
    assert boxes(ours) == pytest.approx(boxes(theirs))
    assert [b.mass for b in ours.blocks] == pytest.approx([b.mass for b in theirs.blocks])


@pytest.mark.parametrize("name", sorted(brick_data.designs()))
def test_ldraw_that_is_written_and_read_is_the_same_model(name: str, tmp_path: Path) -> None:
    first = brick_data.design(name)
    file = export_assembly(first, "ldraw", tmp_path)
    assert file.name == "model.ldr"
    again = read_assembly(file)
    assert again.name == name
    assert boxes(first) == pytest.approx(boxes(again), abs=1e-9)
    assert [b.kind for b in first.blocks] == [b.kind for b in again.blocks]
    mine = read_ldraw(file.read_text())
    assert np.array([box for _, box in mine]) == pytest.approx(1e3 * boxes(first), abs=1e-6)
    assert export_assembly(again, "ldraw", tmp_path / "again.ldr").read_text() == file.read_text()


def test_submodels_turns_colours_and_steps(tmp_path: Path) -> None:
    made = read_assembly(write(tmp_path, "tower.mpd", MPD))
    assert made.name == "Tower"
    assert [b.kind for b in made.blocks] == ["2x4", "plate 2x4", "2x2", "plate 2x4", "2x2"]
    red, blue, yellow = COLOURS[4], COLOURS[1], COLOURS[14]
    assert [b.colour for b in made.blocks] == [red, None, yellow, blue, yellow]
    assert [s.place for s in made.steps] == ["b1", "b2", "b3", "b4", "b5"]
    # The second submodel is turned: what was at x = 20 is at z = -20, our y = -8 mm.
    assert boxes(made)[4] * 1e3 == pytest.approx(np.array([[24, -16, 12.8], [40, 0, 22.4]]))
    file = export_assembly(made, "ldraw", tmp_path / "out.ldr")
    assert file.read_text().count("0 STEP") == 5
    again = read_assembly(file)
    assert [b.colour for b in again.blocks] == [b.colour for b in made.blocks]
    assert again.steps == made.steps
    assert boxes(again) == pytest.approx(boxes(made))


def test_a_colour_of_the_file_comes_back(tmp_path: Path) -> None:
    own = "0 !COLOUR Mine CODE 999 VALUE #0A0B0C EDGE #000000\n"
    lines = line("3003.dat").replace("1 4 ", "1 999 ")
    lines += line("3003.dat", "40 -24 0").replace("1 4 ", "1 0x2102030 ")
    made = read_assembly(write(tmp_path, "own.ldr", own + lines))
    assert [b.colour for b in made.blocks] == [(10, 11, 12), (16, 32, 48)]
    again = read_assembly(export_assembly(made, "ldraw", tmp_path / "again.ldr"))
    assert [b.colour for b in again.blocks] == [b.colour for b in made.blocks]


def test_every_part_is_a_kind_of_a_kit() -> None:
    lego = {tuple(sorted((np.max(k.cells, 0) + 1)[:2].tolist())): k for k in load_kit("lego").kinds}
    assert len(PARTS) == len(SIZES)
    small = [size for size in SIZES.values() if size[2] != 48]
    assert {(min(x, z) // 20, max(x, z) // 20) for x, z, _ in small} == set(lego)


def test_our_own_files_keep_the_laws_of_joints(tmp_path: Path) -> None:
    made = brick_data.bricks(((2, 4), (0, 0, 0)), ((2, 4), (0, 2, 1)))
    document = {"joints": [{"blocks": ["b1", "b2"], "law": "mortar", "tensile": 1e5, "shear": 2e5}]}
    write_assembly(made, tmp_path / "one.json")
    root = json.loads((tmp_path / "one.json").read_text())
    assert root["joint"] == {
        "law": "clutch",
        "capacity": 0.7,
        "base": "grips",
        "press": 10.0,
        "pitch": [0.008, 0.0032],
    }
    (tmp_path / "two.json").write_text(json.dumps(root | document))
    again = read_assembly(tmp_path / "two.json")
    assert again.joint == made.joint
    assert again.joints[0].joint == Joint("mortar", tensile=1e5, shear=2e5)
    write_assembly(again, tmp_path / "three.json")
    assert read_assembly(tmp_path / "three.json").joints == again.joints


def test_a_kit_says_how_dry_blocks_hold() -> None:
    wall = WALL
    assert read_assembly(wall).joint == DRY
    assert read_assembly(wall, kit="bricks").joint == DRY
    assert read_assembly(wall, kit="duplo").joint.law == "clutch"


def test_a_file_of_large_parts_needs_no_name_of_their_kit(tmp_path: Path) -> None:
    file = Path(__file__).parents[1] / "examples" / "bricks" / "tower.ldr"
    told, found = read_assembly(file, kit="duplo"), read_assembly(file)
    assert len(found.blocks) == 60
    assert all(
        np.array_equal(a.vertices, b.vertices)
        for a, b in zip(told.blocks, found.blocks, strict=True)
    )
    with pytest.raises(InputError, match="kit lego"):
        read_assembly(file, kit="lego")
    # Small and large ones in one file fit neither.
    mixed = file.read_text(encoding="utf-8") + "1 4 80 -72 -40 1 0 0 0 1 0 0 0 1 3005.dat\n"
    with pytest.raises(InputError, match=r"mixed\.ldr: line"):
        read_assembly(write(tmp_path, "mixed.ldr", mixed))


def test_kinds_of_files_are_found_by_content() -> None:
    assert brick_format(TEXT.encode()) == "brick text"
    assert brick_format(MPD.encode()) == "ldraw"
    for other in (b"", b"0\nSECTION\n2\nHEADER\n", b"v 1 2 3\nf 1 2 3\n", b"1 2 3", b"2x"):
        assert brick_format(other) is None


def line(part: str = "3001.dat", at: str = "0 -24 0", turn: str = "1 0 0 0 1 0 0 0 1") -> str:
    return f"1 4 {at} {turn} {part}\n"


DEEP = "".join(f"0 FILE m{k}.ldr\n1 4 0 0 0 1 0 0 0 1 0 0 0 1 m{k + 1}.ldr\n" for k in range(40))
MANY = "".join(
    f"0 FILE m{k}.ldr\n" + 10 * f"1 4 0 0 0 1 0 0 0 1 0 0 0 1 m{k + 1}.ldr\n" for k in range(9)
)
BAD = {
    "loop": ("0 FILE a.ldr\n" + line("b.ldr") + "0 FILE b.ldr\n" + line("a.ldr"),
             "a.ldr in b.ldr in a.ldr"),
    "itself": ("0 FILE a.ldr\n" + line() + line("a.ldr"), "holds itself"),
    "deep": (DEEP + "0 FILE m40.ldr\n" + line(), "deeper nesting"),
    "many": (MANY + "0 FILE m9.ldr\n" + line(), "1000000000"),
    "lines": (line() * 200_001, "200001 lines"),
    "unknown": (line() + line("3004b2x.dat"), "nearest 3004.dat (brick 1x2)"),
    "far name": (line() + line("wheel.dat"), "nearest"),
    "off": (line() + line(at="43 -48 0"), "place on the lattice of the first part"),
    "off up": (line() + line(at="0 -50 0"), "place on the lattice"),
    "lying": (line(turn="1 0 0 0 0 -1 0 1 0"), "upright part turned by quarters"),
    "head down": (line(turn="1 0 0 0 -1 0 0 0 -1"), "upright part"),
    "turned": (line(turn="0.8 0 0.6 0 1 0 -0.6 0 0.8"), "turned by quarters"),
    "scaled": (line(turn="2 0 0 0 1 0 0 0 1"), "turned by quarters"),
    "twice": (line() + line(at="20 -24 0"), "overlap"),
    "colour": (line().replace("1 4 ", "1 47 ") + line(), "opaque colour, as 15"),
    "no colour": (line().replace("1 4 ", "1 9999 ") + line(), "opaque colour, or 0x2RRGGBB"),
    "no submodel": (line() + line("roof.ldr"), "a submodel that is in the same file"),
    "no number": ("0 title\n" + line().replace(" 0 ", " nan ", 1), "line 2"),
    "few numbers": ("0 title\n1 4 0 0 0 3001.dat\n", "line 2"),
    "numbers": (line() + "1 4 0 a 0 1 0 0 0 1 0 0 0 1 3001.dat\n", "twelve numbers"),
    "nan": (line() + "1 4 0 nan 0 1 0 0 0 1 0 0 0 1 3001.dat\n", "numbers up to"),
    "short": (line() + "1 4 0 0 0 3001.dat\n", "1 colour x y z"),
    "large": (line() + line("3437.dat", "0 -72 0"), "kit lego"),
    "letters": ("2x4 (0,0,0)\n2x4 (a,0,1)\n", "line 2"),
    "brick x": ("2x4 (0,0,0)\naxb (1,2,3)\n", "line 2"),
    "below": ("2x4 (0,0,0)\n2x4 (0,0,-1)\n", "z >= 0"),
    "no such size": ("2x4 (0,0,0)\n3x7 (0,0,1)\n", "nearest 2x"),
    "text overlap": ("2x4 (0,0,0)\n1x1 (1,3,0)\n", "line 2"),
    "far": ("2x4 (0,0,0)\n2x4 (999999,0,1)\n", "coordinates up to"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_files_that_cannot_be_used_are_refused_in_one_line(name: str, tmp_path: Path) -> None:
    content, words = BAD[name]
    file = write(tmp_path, "bad.ldr", content)
    for read in (read_assembly, read_design):
        with pytest.raises(InputError) as error:
            read(file)
        assert words in str(error.value)
        assert "\n" not in str(error.value)
        assert len(str(error.value)) < 400


JSON_BAD = {
    "no size": ({"bricks": [{"at": [0, 0, 0]}]}, "the key 'size'"),
    "none": ({"bricks": []}, "1 to"),
    "half": ({"bricks": [{"size": [2.5, 2], "at": [0, 0, 0]}]}, "an integer"),
    "zero": ({"bricks": [{"size": [0, 2], "at": [0, 0, 0]}]}, "from 1"),
    "mass": ({"bricks": [{"size": [2, 2], "at": [0, 0, 0], "mass": -1}]}, "a mass"),
    "id": ({"1": {"x": 0, "y": 0, "z": 0, "brick_id": 77, "ori": 0}}, "brick_id"),
    "turn": ({"1": {"x": 0, "y": 0, "z": 0, "brick_id": 9, "ori": 7}}, "ori: got 7"),
}


@pytest.mark.parametrize("name", JSON_BAD)
def test_json_that_cannot_be_used_is_refused(name: str, tmp_path: Path) -> None:
    document, words = JSON_BAD[name]
    with pytest.raises(InputError, match=words):
        read_assembly(write(tmp_path, "bad.json", json.dumps(document)))


HEAD = 'format = "learn2assemble-kit"\nversion = 1\nname = "k"\npitch = [0.008, 0.008, 0.0096]\n'
KIND = '[[kinds]]\nname = "2x2"\nbox = [2, 2, 1]\n'
KITS = {
    "negative": ('[joint]\nlaw = "clutch"\ncapacity = -0.5\n' + KIND, "capacity"),
    "nan": ('[joint]\nlaw = "clutch"\ncapacity = nan\n' + KIND, "capacity"),
    "absurd": ('[joint]\nlaw = "clutch"\ncapacity = 1e9\n' + KIND, "1000 N"),
    "word": ('[joint]\nlaw = "glue"\n' + KIND, "one of clutch, dry, mortar"),
    "base": ('[joint]\nlaw = "clutch"\nbase = "floor"\n' + KIND, "one of grips, table"),
    "key": ('[joint]\nlaw = "clutch"\ncapacty = 1\n' + KIND, "did you mean 'capacity'"),
    "foreign": ('[joint]\nlaw = "dry"\ncapacity = 1\n' + KIND, "capacity"),
    "pitch": ('[joint]\nlaw = "clutch"\npitch = [1, 1]\n' + KIND, "pitch of the kit"),
    "nothing": ('[joint]\nlaw = "clutch"\n[[kinds]]\nname = "L"\n'
                "cells = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]\n", "studs on nothing"),
    "side": ('[joint]\nlaw = "clutch"\n' + KIND + 'turns = "any"\n', "studs on a side"),
    "tensile": ('[joint]\nlaw = "mortar"\ntensile = -1\n' + KIND, "tensile"),
    "mass": (KIND + "mass = 0.001\ndensity = 3\n", "one of them"),
    "table": ("joint = 3\n" + KIND, "JSON object"),
}  # fmt: skip


@pytest.mark.parametrize("name", KITS)
def test_kits_whose_joints_mean_nothing_are_refused(name: str) -> None:
    words, message = KITS[name]
    with pytest.raises(InputError) as error:
        parse_kit(HEAD + words, "k.toml")
    assert message in str(error.value)


def test_a_kit_has_masses() -> None:
    kit = parse_kit(HEAD + KIND + "mass = 0.00115\n", "k.toml")
    density = kit.kinds[0].density
    assert density is not None
    assert math.isclose(density * 4 * 0.008**2 * 0.0096, 0.00115)
    assert kit.joint == DRY


def test_blocks_that_are_no_bricks_are_not_written_as_ldraw(tmp_path: Path) -> None:
    block = box_block("a", (0.0, 0.0, 0.0), (0.1, 0.05, 0.05))
    write_assembly(Assembly((block,)), tmp_path / "wall.json")
    with pytest.raises(InputError, match="the size of a brick"):
        export_assembly(tmp_path / "wall.json", "ldraw", tmp_path / "out")
    assert not (tmp_path / "out" / "model.ldr").exists()
