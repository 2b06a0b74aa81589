"""How designs are read: arrays, units that fit, holes of meshes, large files, pictures of cells."""

from __future__ import annotations

import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

import learn2assemble as l2a
from learn2assemble.assembly.files import to_json, write_assembly
from learn2assemble.cli import main
from learn2assemble.design.cells import CellDesign
from learn2assemble.design.holes import close_holes
from learn2assemble.design.read import read_design
from learn2assemble.errors import InputError, Remedy
from learn2assemble.viewer.preview import busiest, section

GATE = np.ones((4, 1, 3), bool)
GATE[1:3, :, 0] = False
DESIGNS = Path(__file__).parents[1] / "examples" / "designs"


def cells(path: Path | np.ndarray, **reading: Any) -> CellDesign:
    made = read_design(path, **reading)
    assert isinstance(made, CellDesign)
    return made


def save(mesh: trimesh.Trimesh, path: Path, kind: str | None = None) -> Path:
    data = mesh.export(file_type=kind or path.suffix[1:])
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


# ---------------------------------------------------------------- arrays


@pytest.mark.parametrize(
    "kind", ["bool", "int8", "uint8", ">i4", "int64", "uint64", "float16", "float32", ">f8"]
)
def test_arrays_of_all_kinds_of_numbers_are_designs(kind: str, tmp_path: Path) -> None:
    given = GATE.astype(kind)
    np.save(tmp_path / "gate.npy", given)
    np.savez(tmp_path / "gate.npz", given)
    for design in (given, tmp_path / "gate.npy", tmp_path / "gate.npz"):
        assert np.array_equal(cells(design).wanted, GATE)
    assert given.flags.writeable


def test_an_array_is_built_as_it_is() -> None:
    colours = np.zeros((4, 1, 3, 3), np.uint8)
    colours[:2] = (200, 0, 0)
    plan = l2a.build(GATE, kit="bricks-lintels", cell=0.04, colours=colours)
    assert plan.complete
    assert plan.assembly is not None
    assert plan.design.name == "array"
    assert np.ptp(plan.assembly.blocks[0].vertices[:, 2]) == pytest.approx(0.04)
    assert {b.colour for b in plan.assembly.blocks if not b.prop} == {(200, 0, 0), (0, 0, 0)}
    assert colours.flags.writeable
    turned = cells(GATE.transpose(0, 2, 1), up="y")
    assert turned.wanted.shape == (4, 1, 3)


def test_an_array_of_64_cells_each_way_is_read(tmp_path: Path) -> None:
    whole = np.ones((64, 64, 64))
    np.save(tmp_path / "whole.npy", whole)
    colours = np.zeros((64, 64, 64, 3), np.uint8)
    np.savez(tmp_path / "whole.npz", wanted=whole, colours=colours)
    for design in (whole, tmp_path / "whole.npy", tmp_path / "whole.npz"):
        assert cells(design).wanted.sum() == 64**3
    # More than a megabyte, which the file of goals that it might be may not have.
    found = l2a.preview(tmp_path / "whole.npy", tmp_path / "whole.png")
    assert found.wanted.all()


@pytest.mark.parametrize(
    ("given", "reading", "fragment"),
    [
        (np.zeros((0, 2, 2), bool), {}, "shape [0, 2, 2]"),
        (np.ones((65, 65, 65), bool), {}, "65 × 65 × 65 cells"),
        (np.full((2, 2, 2), np.nan), {}, "a value nan"),
        (np.full((2, 2, 2), None), {}, "an array of object"),
        (np.ones((2, 2, 2), complex), {}, "an array of complex128"),
        (np.full((2, 2, 2), "1"), {}, "an array of <U1"),
        (np.ones((2, 2), bool), {}, "shape [2, 2]"),
        (np.zeros((2, 2, 2), bool), {}, "half full"),
        (GATE, {"colours": np.zeros((4, 1, 3), np.uint8)}, "uint8[4, 1, 3]"),
        (GATE, {"colours": np.zeros((4, 1, 3, 3))}, "float64[4, 1, 3, 3]"),
        (GATE, {"colours": [1]}, "expected uint8[4, 1, 3, 3]"),
        (GATE, {"unit": "mm"}, "no such option for ARRAY"),
        (GATE, {"cels": 0.1}, "did you mean 'cell'"),
        (GATE, {"reading": {"cell": 0.1}}, "argument of build"),
        ([[[True]]], {}, "a file, cells or an assembly"),
        ("examples/designs/gate.svg", {"colours": GATE}, "no such option for SVG"),
        (Path("examples/designs/dome.stl"), {"unit": "mm", "repair": 1}, "True or False"),
    ],
)
def test_what_cannot_be_built_is_refused(
    given: Any, reading: dict[str, Any], fragment: str
) -> None:
    with pytest.raises(InputError) as caught:
        l2a.build(given, **reading)
    assert fragment in str(caught.value)
    assert "\n" not in str(caught.value)


# ---------------------------------------------------------------- units


def test_a_mesh_without_a_unit_is_told_what_fits(tmp_path: Path) -> None:
    box = save(trimesh.creation.box((400, 200, 300)), tmp_path / "box.stl")
    for reading in ({}, {"unit": "m"}):
        with pytest.raises(InputError) as caught:
            read_design(box, **reading)
        assert "400 × 200 × 300 units" in str(caught.value)
        assert str(caught.value).endswith("; unit='mm' gives 8 × 4 × 6 cells")
    assert cells(box, unit="mm").wanted.shape == (8, 4, 6)
    large = save(trimesh.creation.box((90_000, 30_000, 60_000)), tmp_path / "large.stl")
    with pytest.raises(InputError, match="cells_wide=32 gives 32 × 11 × 21 cells"):
        read_design(large, unit="m")
    assert cells(large, cells_wide=32).wanted.shape == (32, 11, 21)
    small = save(trimesh.creation.box((0.4, 0.2, 0.3)), tmp_path / "small.stl")
    with pytest.raises(InputError, match=r"half full.*unit='m' gives 8 × 4 × 6 cells"):
        read_design(small, unit="mm")
    drawing = tmp_path / "box.svg"
    drawing.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg"><rect width="30" height="20"/></svg>'
    )
    with pytest.raises(InputError, match=r"30 × 20 units: .*unit='cm' gives 6 × 4 cells"):
        read_design(drawing, unit="m", cell=0.05, up=None, depth=None, size=None, kit=None)
    # What was tried does not help: 0.3 × 0.2 m in a cell of 0.4 m.
    with pytest.raises(InputError, match="half full") as caught:
        read_design(drawing, unit="cm", cell=0.4)
    assert "unit='in' gives 2 × 1 cells" in str(caught.value)
    assert "unit='cm'" not in str(caught.value)
    assert cells(drawing, unit="in", cell=0.4).wanted.shape == (2, 1, 1)


@pytest.mark.parametrize("said", [{"unit": "mm"}, {"unit": "cm"}, {"cells_wide": 32}])
def test_no_size_is_named_in_which_nothing_of_it_is_half_a_cell(
    tmp_path: Path, said: dict[str, object]
) -> None:
    # A shell of 1 unit: in every size that fits the lattice its walls are a fifth of a cell.
    hollow = trimesh.creation.box((300, 300, 300))
    inside = trimesh.creation.box((298, 298, 298))
    inside.invert()
    shell = save(trimesh.util.concatenate([hollow, inside]), tmp_path / "shell.stl")
    with pytest.raises(InputError, match="half full") as caught:
        read_design(shell, **said)
    assert not caught.value.remedies


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"unit": "mm", "size": 0.4}, "unit: got 'mm', expected either unit or size"),
        ({"unit": "cm", "cells_wide": 8}, "unit: got 'cm', expected either unit or cells_wide"),
        ({"size": 0.4, "cells_wide": 8}, "size: got 0.4, expected either size or cells_wide"),
    ],
)
def test_a_size_is_said_once(tmp_path: Path, said: dict[str, Any], words: str) -> None:
    box = save(trimesh.creation.box((400, 200, 300)), tmp_path / "box.stl")
    drawing = tmp_path / "box.svg"
    drawing.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg"><rect width="30" height="20"/></svg>'
    )
    for path in (box, drawing):
        with pytest.raises(InputError, match=words):
            read_design(path, **said)


def test_what_would_help_is_an_option_on_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    box = save(trimesh.creation.box((400, 200, 300)), tmp_path / "box.stl")
    assert main(["build", str(box), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.endswith("; --unit mm gives 8 × 4 × 6 cells\n")
    assert not (tmp_path / "out").exists()
    made = InputError("mesh", "open", "closed", Remedy("repair", True, "closes 1 hole"))
    assert pickle.loads(pickle.dumps(made)).for_command_line() == (
        "mesh: got 'open', expected closed; --repair closes 1 hole"
    )
    assert str(made).endswith("; repair=True closes 1 hole")


# ---------------------------------------------------------------- holes


def holed(*faces: int, subdivisions: int = 2) -> trimesh.Trimesh:
    """A ball without some of its faces."""
    ball = trimesh.creation.icosphere(subdivisions, 200)
    keep = np.ones(len(ball.faces), bool)
    keep[list(faces)] = False
    return trimesh.Trimesh(ball.vertices, ball.faces[keep], process=False)


def test_small_holes_are_closed_where_that_is_asked_for(tmp_path: Path) -> None:
    whole = cells(save(holed(), tmp_path / "whole.ply"), unit="mm")
    path = save(holed(0, 200), tmp_path / "open.ply")
    with pytest.raises(InputError, match=r"an open mesh: \d+ .*repair=True closes 2 holes up to"):
        read_design(path, unit="mm")
    with pytest.raises(InputError, match="an open mesh"):
        read_design(path, unit="mm", repair=False)
    made = cells(path, unit="mm", repair=True)
    assert np.array_equal(made.wanted, whole.wanted)
    assert whole.note == ""
    assert made.note.startswith("2 holes of the mesh closed, up to ")
    wide = float(made.note.split()[-3])
    assert 40 < wide < 130  # edges are 60 mm
    plan = l2a.build(path, unit="mm", cell=0.1, repair=True, kit="cubes")
    assert plan.design.note == cells(path, unit="mm", repair=True, cell=0.1).note


def test_what_is_no_small_hole_is_not_closed(tmp_path: Path) -> None:
    """Half a ball, a face that is turned round, and two holes that touch."""
    half = trimesh.creation.icosphere(3, 200)
    half = trimesh.Trimesh(half.vertices, half.faces[half.triangles_center[:, 0] > 0])
    turned = holed()
    turned.faces[5] = turned.faces[5][::-1]
    ball = holed()
    at = np.flatnonzero((ball.faces == 30).any(1))
    touching = holed(int(at[0]), int(at[3]))
    for mesh in (half, turned, touching):
        assert close_holes(mesh.vertices, np.asarray(mesh.faces)) is None
        with pytest.raises(InputError, match="an open mesh") as caught:
            read_design(save(mesh, tmp_path / "x.ply"), unit="mm", repair=True)
        assert "repair" not in str(caught.value)


def test_a_hole_is_closed_by_triangles_that_face_outward() -> None:
    box = trimesh.creation.box((1, 1, 1)).subdivide().subdivide().subdivide().subdivide()
    keep = np.abs(box.triangles_center - (0, 0, 0.5)).max(1) > 0.06
    mended = close_holes(box.vertices, np.asarray(box.faces[keep]))
    assert mended is not None
    made = trimesh.Trimesh(*mended.mesh, process=False)
    assert made.is_watertight
    assert made.volume == pytest.approx(1)
    assert mended.widths[0] == pytest.approx(0.125 * 2**0.5)


# ---------------------------------------------------------------- large files


def test_meshes_are_read_up_to_their_limits(tmp_path: Path) -> None:
    """More than a megabyte, which goals may not have; more than 16 MB of text; not 51 MB."""
    ball = trimesh.creation.uv_sphere(200, count=[120, 120])
    path = save(ball, tmp_path / "ball.stl")
    assert path.stat().st_size > 1_000_000
    found = l2a.preview(path, tmp_path / "ball.png", unit="mm", cell=0.05)
    assert found.wanted.shape == (8, 8, 8)
    box = save(trimesh.creation.box((200, 200, 200)), tmp_path / "box.obj")
    with box.open("a") as file:
        file.write("# a comment of a program\n" * 700_000)
    assert box.stat().st_size > 17_000_000
    assert cells(box, unit="mm").wanted.shape == (4, 4, 4)
    facets = 1_020_000
    with (tmp_path / "large.stl").open("wb") as file:
        file.write(bytes(80) + facets.to_bytes(4, "little"))
        file.truncate(84 + 50 * facets)
    with pytest.raises(InputError, match=r"51 MB.*at most 50 MB"):
        l2a.build(tmp_path / "large.stl", unit="mm")


# ---------------------------------------------------------------- pictures


def test_blurred_colours_of_a_jpeg_are_one(tmp_path: Path) -> None:
    left = np.zeros((48, 64, 3), np.uint8)
    left[:, :32], left[:, 32:] = (190, 30, 30), (30, 30, 190)
    for kind in ("JPEG", "WEBP"):
        Image.fromarray(left).save(tmp_path / "two.x", kind, quality=60)
        made = cells(tmp_path / "two.x", cells_wide=8)
        assert made.wanted.all()
        assert made.colours is not None
        seen = np.unique(made.colours.reshape(-1, 3), axis=0)
        assert len(seen) == 2, (kind, seen)
        assert np.abs(seen.astype(int) - ((30, 30, 190), (190, 30, 30))).max() < 25


def test_a_picture_stands_as_a_viewer_turns_it(tmp_path: Path) -> None:
    """A phone stores a picture as the sensor lies and says how to turn it."""
    pixels = np.full((16, 32), 255, np.uint8)
    pixels[:, :16], pixels[8:] = 0, 0  # high on the left, low on the right
    tag = Image.Exif()
    tag[0x0112] = 6  # turn clockwise to see it
    Image.fromarray(np.rot90(pixels)).save(tmp_path / "x.jpg", exif=tag)
    made = cells(tmp_path / "x.jpg", cells_wide=4)
    assert made.wanted[:, 0].T[::-1].tolist() == [[True, True, False, False], [True] * 4]


# ---------------------------------------------------------------- preview


def test_a_preview_shows_what_was_drawn_over_the_cells(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "gate.png"
    assert main(["build", str(DESIGNS / "gate.svg"), "--preview", str(path), "--json"]) == 0
    said = capsys.readouterr()
    assert '"shape": [8, 1, 6]' in said.out
    assert sorted(tmp_path.iterdir()) == [path]  # Nothing was planned.
    image = np.asarray(Image.open(path).convert("RGB")).astype(int)
    cell, line = (np.abs(image - rgb).sum(-1) < 30 for rgb in ((236, 202, 144), (11, 114, 133)))
    assert cell.sum() > 20_000
    assert line.sum() > 2_000
    made = l2a.preview("examples/designs/gate.svg", path, overwrite=True)
    assert isinstance(made, CellDesign)
    with pytest.raises(InputError, match="a picture of them"):
        l2a.preview("tests/data/example_plan/assembly.json", path, overwrite=True)


@pytest.mark.parametrize(
    "name",
    [
        "gate.svg",
        "courtyard.svg",
        "circle.svg",
        "figure.png",
        "dome.stl",
        "keep.json",
        "off_centre_tower.json",
    ],
)
def test_the_surface_that_is_drawn_is_that_of_the_design(name: str) -> None:
    """Its section through the busiest layer has the area of what was drawn there."""
    import shapely

    reading = {"unit": "mm"} if name.endswith("stl") else {}
    reading |= {"cells_wide": 8} if name.endswith("png") else {}
    made = cells(DESIGNS / name, **reading)
    assert made.surface is not None
    for axis in (0, 1, 2) if not name.endswith("png") else (1,):
        layer = busiest(made.wanted, axis)
        lines = section(made.surface, axis, layer + 0.5 + 1e-6)
        axes = [a for a in range(3) if a != axis]
        ends = np.round(lines[:, :, axes], 4)
        kept = [shapely.LineString(e) for e in ends if (e[0] != e[1]).any()]
        noded = shapely.get_parts(shapely.unary_union(kept))
        regions = shapely.get_parts(shapely.polygonize(noded))
        # Every filled cell of a layer is at least half inside; holes are regions, too.
        inside = shapely.union_all(regions)
        filled = np.argwhere(made.wanted.take(layer, axis))
        share = [inside.intersection(shapely.box(i, j, i + 1, j + 1)).area for i, j in filled]
        assert np.mean(np.array(share) > 0.4) > 0.9


def test_sections_of_a_box() -> None:
    box = trimesh.creation.box((2, 4, 6)).triangles
    lines = section(np.asarray(box), 2, 0.5)
    assert np.ptp(lines.reshape(-1, 3), axis=0).tolist() == pytest.approx([2, 4, 0])
    assert np.linalg.norm(lines[:, 0] - lines[:, 1], axis=1).sum() == pytest.approx(12)
    assert len(section(np.asarray(box), 2, 9.0)) == 0


def test_objects_of_a_mesh_are_blocks_where_that_is_asked_for() -> None:
    """As `check` reads them; options of cells, and a file without a unit, are refused."""
    path = DESIGNS.parent / "structures" / "arch.obj"
    read = read_design(path, blocks=True, unit="mm")
    assert isinstance(read, l2a.Assembly)
    assert {block.id for block in read.blocks} == {f"v{k}" for k in range(9)}
    top = max(float(block.vertices[:, 2].max()) for block in read.blocks)
    assert abs(top - 0.34 * np.cos(np.pi / 18)) < 0.01  # outer radius 0.34 m
    with pytest.raises(InputError, match="mm, cm, m or in"):
        read_design(path, blocks=True)
    with pytest.raises(InputError, match="unit and up alone"):
        read_design(path, blocks=True, unit="mm", cells_wide=5)


def test_meshes_of_a_folder_are_blocks(tmp_path: Path) -> None:
    """As `check` reads them: one file a block, of a plan that lies in it those."""
    whole = read_design(DESIGNS.parent / "structures" / "arch.obj", blocks=True, unit="mm")
    assert isinstance(whole, l2a.Assembly)
    folder = tmp_path / "stones"
    folder.mkdir()
    for block in whole.blocks:
        mesh = trimesh.convex.convex_hull(block.vertices * 1e3)
        mesh.export(folder / f"{block.id}.stl")
    for asked in ({}, {"blocks": True}):
        read = read_design(folder, unit="mm", **asked)
        assert isinstance(read, l2a.Assembly)
        volumes = {b.id: b.volume for b in whole.blocks}
        assert {b.id: b.volume for b in read.blocks} == pytest.approx(volumes, rel=1e-5)
    with pytest.raises(InputError, match="mm, cm, m or in"):
        read_design(folder)
    with pytest.raises(InputError, match="cells_wide"):
        read_design(folder, unit="mm", cells_wide=5)
    write_assembly(whole, folder / "assembly.json")
    again = read_design(folder)
    assert isinstance(again, l2a.Assembly)
    assert to_json(again) == to_json(whole)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="a folder without a plan or meshes"):
        read_design(tmp_path / "empty")


# What is said where cells cannot show a feature of a drawing.


def _drawing(folder: Path, path: str) -> Path:
    file = folder / "drawing.svg"
    file.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="500mm" height="500mm" '
        f'viewBox="0 0 500 500"><path fill-rule="evenodd" d="{path}"/></svg>'
    )
    return file


def _read(folder: Path, path: str, **options: Any) -> CellDesign:
    found = read_design(_drawing(folder, path), **options)
    assert isinstance(found, CellDesign)
    return found


WINDOW = "M100 500V100H300V500Z M175 200H225V300H175Z"
"""A window across the middle of four cells of 50 mm, half of each."""
TEETH = "M50 500V300H90V340H130V300H170V340H210V300H250V500Z"


@pytest.mark.parametrize(
    ("left", "words"),
    [
        (126, "an opening of 148 × 200 mm becomes 100 × 200 mm"),
        (124, "an opening of 152 × 200 mm becomes 200 × 200 mm"),
        (100, ""),
    ],
)
def test_an_opening_that_gets_narrower_or_wider_is_said(
    tmp_path: Path, left: int, words: str
) -> None:
    """A doorway in the middle of a wall of 400 x 300 mm."""
    right = 400 - left
    note = _read(tmp_path, f"M0 300V0H400V300H{right}V100H{left}V300Z").note
    assert words in note
    assert ("becomes" in note) == bool(words)


@pytest.mark.parametrize(
    ("path", "words"),
    [
        (WINDOW, "an opening of 50 × 100 mm"),
        (TEETH, "40 × 40 mm"),
    ],
)
def test_what_vanishes_is_said_and_the_cell_that_is_advised_shows_it(
    tmp_path: Path, path: str, words: str
) -> None:
    note = _read(tmp_path, path).note
    assert note.startswith("not shown by the cells: ")
    assert words in note
    advised = re.search(r"shown by cells of ([0-9.]+) mm$", note)
    assert advised is not None
    assert not _read(tmp_path, path, cell=float(advised[1]) / 1000).note


@pytest.mark.parametrize("high", [0.05, 0.025])
def test_what_vanishes_is_told_in_its_own_size_whatever_the_cell(
    tmp_path: Path, high: float
) -> None:
    note = _read(tmp_path, WINDOW, cell=(0.05, 0.05, high)).note
    assert note.startswith("not shown by the cells: an opening of 50 × 100 mm")
    assert "becomes" not in note
    wide = "M0 300V0H400V300H274V100H126V300Z"
    note = _read(tmp_path, wide, cell=(0.05, 0.05, high)).note
    assert note.startswith("an opening of 148 × 200 mm becomes 100 × 200 mm")


@pytest.mark.parametrize(
    "path",
    [
        "M100 500V100H300V500Z M150 200H250V300H150Z",  # on the lattice
        "M50 500A200 200 0 0 1 450 500Z",  # round
        "M50 500L250 100L450 500Z",  # slopes
        "M50 500L50 480L450 150V500Z",
        "M60 500V117H333V500Z",  # off the lattice by parts of a cell
    ],
)
@pytest.mark.parametrize(
    "cell", [(0.05, 0.05, 0.05), (0.05, 0.05, 0.02), (0.025, 0.05, 0.05), (0.025, 0.025, 0.01)]
)
def test_what_every_lattice_does_to_an_edge_is_not_called_lost(
    tmp_path: Path, path: str, cell: tuple[float, float, float]
) -> None:
    note = _read(tmp_path, path, cell=cell).note
    assert "not shown" not in note
    assert "becomes" not in note


@pytest.mark.parametrize(
    ("path", "options", "words"),
    [
        ("M0 395V0H400V395Z M120 120H290V290H120Z", {}, "edges move by up to 25 mm"),
        ("M60 500V117H333V500Z", {}, "edges move by up to 17 mm"),
        ("M100 500V112H300V500Z", {"depth": 0.12}, "walls 120 mm thick become 100 mm"),
        ("M100 500V102H300V500Z", {"depth": 0.101}, ""),  # by less than anybody sees
        ("M107 500V100H307V500Z", {"depth": 0.1}, ""),  # on the cells
        ("M50 500A200 200 0 0 1 450 500Z", {}, ""),  # round
        ("M50 500L250 100L450 500Z", {}, ""),  # slopes
    ],
)
def test_that_straight_edges_are_rounded_to_cells_is_said(
    tmp_path: Path, path: str, options: dict[str, float], words: str
) -> None:
    note = _read(tmp_path, path, **options).note
    assert words in note
    assert note.startswith("rounded to cells of 50 mm: ") == bool(words)
    assert note.count("rounded") == bool(words)


BENCH = "M0 240V0H480V240H400V80H80V240Z"
"""480 x 240 mm, on two feet: nearly as well in cells of 50 mm that are not symmetric."""


def test_a_symmetric_drawing_stays_so_where_that_costs_hardly_anything(tmp_path: Path) -> None:
    wanted = _read(tmp_path, BENCH).wanted
    assert np.array_equal(wanted, wanted[::-1])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            ["--depth", "0.12"],
            "warning: only 69% of drawing and cells are common: rounded to cells of 50 mm: edges "
            "move by up to 10 mm, walls 120 mm thick become 100 mm; cells of 40 mm show all of it",
        ),
        (["--cell", "0.04"], ""),
    ],
)
def test_a_call_says_what_is_rounded_and_warns_where_little_is_common(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], words: str
) -> None:
    file = _drawing(tmp_path, BENCH)
    for asked in (["--preview", "p.png"], ["--out", "plan", "--seconds", "1"]):
        path = str(tmp_path / asked[1])
        assert main(["build", str(file), asked[0], path, *asked[2:], *options]) in (0, 1)
    assert capsys.readouterr().out.count(words or "100% of drawing and cells are common") == 2


def test_a_part_that_vanishes_is_one(tmp_path: Path) -> None:
    """A chimney that stands on the line between two cells."""
    note = _read(tmp_path, "M50 500V300H282V180H318V300H450V500Z").note
    assert "a part of 36 × 120 mm" in note


def test_a_narrow_slit_that_vanishes_is_an_opening(tmp_path: Path) -> None:
    note = _read(tmp_path, "M100 500V100H300V500Z M190 200H205V300H190Z").note
    assert "an opening of 15 × 100 mm" in note


@pytest.mark.parametrize(
    ("path", "advised"),
    [
        ("M100 500V100H300V500Z M180 180H240V340H180Z", 20.0),  # multiples of 20 mm
        ("M100 500V140H340V500H100Z", 60.0),  # larger than the cell
        ("M100 500V150H300V500Z", None),  # on the cells
        ("M107 500V100H307V500Z", None),  # on the cells, which may be moved along the wall
        ("M100 500V173H304V500Z", None),  # no common measure
        ("M100 500V120H320L300 500Z", None),  # a slope
    ],
)
def test_cells_that_show_all_of_a_drawing_are_named_and_show_it(
    tmp_path: Path, path: str, advised: float | None
) -> None:
    note = _read(tmp_path, path).note
    found = re.search(r"cells of ([0-9.]+) mm show all of it$", note)
    assert (float(found[1]) if found else None) == advised
    if advised:
        again = _read(tmp_path, path, cell=advised / 1000)
        assert again.iou == pytest.approx(1.0, abs=1e-6)
        assert not again.note


def test_what_is_not_all_of_a_drawing_is_not_called_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A slope over half of one cell of 110: 99.5 % in common is not rounded up."""
    path = "M0 0H1050L1100 50V500H0Z"
    file = tmp_path / "slope.svg"
    file.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="1100mm" height="500mm" '
        f'viewBox="0 0 1100 500"><path d="{path}"/></svg>'
    )
    words = ["build", str(file), "--cell", "0.05", "--preview", str(tmp_path / "p.png")]
    assert main(words) == 0
    assert "; 99% of drawing and cells are common" in capsys.readouterr().out
