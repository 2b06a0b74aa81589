"""Assemblies as files of other programs: each is read back by another library."""

from __future__ import annotations

import csv
import io
import json
import re
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from cell_shapes import wall
from learn2assemble.assembly.blocks import Assembly, AssemblyStep, Block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.files import read_assembly, write_assembly
from learn2assemble.assembly.instructions.steps import instructions
from learn2assemble.assembly.kit import load_kit
from learn2assemble.cli import main
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.export.formats import FORMATS, bill_of_blocks, export_assembly, step_cards
from learn2assemble.export.pictures import booklet
from learn2assemble.planning.plan import block_step
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.planning.tiling.ordering import to_assembly
from learn2assemble.viewer.page import render_assembly_page


@pytest.fixture
def bridge() -> Assembly:
    """Two posts and a lintel, with a prop under it that is taken away again."""
    blocks = (
        box_block("left", (0, 0, 0), (0.05, 0.05, 0.05), kind="1x1", colour=(200, 30, 30)),
        box_block("right", (0.1, 0, 0), (0.15, 0.05, 0.05), kind="1x1"),
        box_block("prop", (0.05, 0, 0), (0.1, 0.05, 0.05), kind="1x1", prop=True),
        box_block("lintel", (0, 0, 0.05), (0.15, 0.05, 0.1), kind="1x3"),
    )
    steps = [AssemblyStep(place=id_) for id_ in ("left", "right", "prop", "lintel")]
    return Assembly(blocks, (*steps, AssemblyStep(remove="prop")), name="Bridge <1>")


def test_bill_counts_blocks_and_props(bridge: Assembly) -> None:
    """By kind and colour; a prop may have any."""
    rows = {
        (row["kind"], row["colour"]): row
        for row in csv.DictReader(io.StringIO(bill_of_blocks(bridge)))
    }
    counts = {key: (row["built_in"], row["props"], row["total"]) for key, row in rows.items()}
    assert counts == {
        ("1x1", ""): ("1", "1", "2"),
        ("1x1", "#c81e1e"): ("1", "0", "1"),
        ("1x3", ""): ("1", "0", "1"),
    }
    assert float(rows["1x3", ""]["length_m"]) == pytest.approx(0.15)
    assert float(rows["1x3", ""]["mass_kg"]) == pytest.approx(0.15 * 0.05 * 0.05 * 1000)


def test_the_bill_of_the_cards_and_the_page_tells_colours(bridge: Assembly) -> None:
    for text in (step_cards(bridge), render_assembly_page(bridge, title="x")):
        assert len(re.findall(r"1x1,? #c81e1e</td>|1x1,? #c81e1e<td>", text)) == 1
    plain = Assembly(tuple(replace(b, colour=None) for b in bridge.blocks), bridge.steps)
    assert ", #" not in "".join(row[1] for row in booklet(plain).bill)


def test_colours_and_the_name_are_kept_in_the_file(bridge: Assembly, tmp_path: Path) -> None:
    """What is exported from a folder looks as what was written with the plan."""
    again = read_assembly(export_assembly(bridge, "assembly", tmp_path))
    assert again.name == bridge.name
    assert [b.colour for b in again.blocks] == [b.colour for b in bridge.blocks]
    assert step_cards(again) == step_cards(bridge)
    broken = tmp_path / "broken.json"
    broken.write_text(
        (tmp_path / "assembly.json").read_text("utf-8").replace("[200,30,30]", "[300,30,30]")
    )
    with pytest.raises(InputError, match="colour"):
        read_assembly(broken)


@pytest.mark.parametrize("format", ["assembly", "bill", "cards", "compas", "mjcf"])
def test_no_zero_has_a_minus(format: str, tmp_path: Path) -> None:
    """Of blocks whose middles and corners are a hair below zero."""
    low, size = -1e-13, 0.05
    blocks = (
        box_block("a", (low, low, 0), (size + low, size + low, 0.05), kind="1x1"),
        box_block("b", (-size / 2 + low, -size / 2, 0.05), (size / 2 + low, size / 2, 0.1)),
    )
    steps = tuple(AssemblyStep(place=block.id) for block in blocks)
    made = Assembly(blocks, steps)
    text = export_assembly(made, format, tmp_path).read_text("utf-8")
    assert not re.search(r"(?<![\w.-])-0(\.0+)?(?![\w.])", text)
    step = block_step(1, 1, made.blocks[1], "place", 1.0)
    assert [str(value) for value in step.position[:2]] == ["0.0", "0.0"]


def test_a_prop_used_twice_is_billed_once(bridge: Assembly) -> None:
    again = (*bridge.steps, AssemblyStep(place="prop"), AssemblyStep(remove="prop"))
    rows = bill_of_blocks(Assembly(bridge.blocks, again)).splitlines()
    assert rows[1].startswith("1x1,,1,1,2,")


def test_the_bill_of_an_incomplete_plan_says_what_is_not_placed(bridge: Assembly) -> None:
    blocks = tuple(replace(block, colour=None) for block in bridge.blocks)

    def told(steps: tuple[AssemblyStep, ...]) -> dict[str, tuple[str, str, str]]:
        text = bill_of_blocks(Assembly(blocks, steps).as_far_as_placed())
        rows = csv.DictReader(io.StringIO(text))
        return {r["kind"]: (r["built_in"], r["placed"], r["not_placed"]) for r in rows}

    whole = {"1x1": ("2", "2", "0"), "1x3": ("1", "1", "0")}
    assert told(bridge.steps) == told(()) == whole
    assert told(bridge.steps[:1]) == {"1x1": ("2", "1", "1"), "1x3": ("1", "0", "1")}


def test_what_is_taken_away_and_comes_again_is_billed_once() -> None:
    def cube(name: str, x: float, z: float) -> Block:
        return box_block(name, (x, 0, z), (x + 0.1, 0.1, z + 0.1), kind="cube")

    # Of a tower of three two go to their new places, one more comes.
    old = [cube(f"t{n}", 0.0, n / 10) for n in range(3)]
    new = [cube(f"r{n}", 0.1 * n, 0.0) for n in range(1, 4)]
    steps = (
        AssemblyStep(place="r3"),
        AssemblyStep(remove="t2"),
        AssemblyStep(place="r1"),
        AssemblyStep(remove="t1"),
        AssemblyStep(place="r2"),
    )
    for count, want in ((5, ("4", "3", "0")), (4, ("4", "2", "1"))):
        made = Assembly((*old, *new), steps[:count]).as_far_as_placed(b.id for b in old)
        (row,) = csv.DictReader(io.StringIO(bill_of_blocks(made)))
        assert (row["built_in"], row["placed"], row["not_placed"]) == want
        assert row["total"] == "4"
    (line,) = instructions(made).bill
    assert line.built + line.standing == 4


def test_cards_have_one_card_a_step(bridge: Assembly) -> None:
    page = step_cards(bridge)
    assert page.count("<article>") == len(bridge.steps) - 1, "both posts at once"
    assert "Bridge &lt;1&gt;" in page
    assert "Take the prop away" in page


def test_glb_is_read_by_another_library(bridge: Assembly, tmp_path: Path) -> None:
    file = export_assembly(bridge, "glb", tmp_path)
    scene = trimesh.load(file)
    assert set(scene.geometry) == {"left", "right", "lintel"}
    # y is up in glTF.
    assert np.allclose(scene.bounds, [[0, 0, -0.05], [0.15, 0.1, 0]], atol=1e-6)
    assert scene.volume == pytest.approx(sum(b.volume for b in bridge.finished.blocks))


def test_mjcf_stands_in_mujoco(bridge: Assembly, tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_path(str(export_assembly(bridge, "mjcf", tmp_path)))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    before = {b.id: data.body(b.id).xipos.copy() for b in bridge.finished.blocks}
    for block in bridge.finished.blocks:
        assert np.allclose(before[block.id], block.centroid, atol=1e-6)
        assert model.body(block.id).mass[0] == pytest.approx(block.mass)
    for _ in range(300):
        mujoco.mj_step(model, data)
    for id_, place in before.items():
        assert np.abs(data.body(id_).xipos - place).max() < 2e-3


@pytest.mark.parametrize("foot", [None, -0.3, 0.0])
def test_mjcf_has_no_ground_but_its_supports(foot: float | None, tmp_path: Path) -> None:
    """Blocks in a pit, and a post that was left there, stay where they are: no plane is in it."""
    low, posts = -0.2 if foot is None else foot, int(foot is not None)
    blocks = (
        box_block("slab", (0, 0, -0.3), (0.5, 0.5, -0.2), support=True),
        box_block("low", (0.1, 0.1, -0.2), (0.2, 0.2, -0.1)),
        box_block("high", (0.1, 0.1, -0.1), (0.2, 0.2, 0.05)),
        box_block("post", (0.6, 0.1, low), (0.7, 0.2, low + 0.2), prop=True),
    )
    placed = [AssemblyStep(place=b.id) for b in blocks[1 : 3 + posts]]
    made = Assembly(blocks[: 3 + posts], tuple(placed))
    model = mujoco.MjModel.from_xml_path(str(export_assembly(made, "mjcf", tmp_path)))
    assert mujoco.mjtGeom.mjGEOM_PLANE not in model.geom_type
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 300)
    for block in made.blocks:
        assert np.allclose(data.body(block.id).xipos, block.centroid, atol=1e-4)


def test_mjcf_of_a_block_that_is_not_convex(tmp_path: Path) -> None:
    """An L of three cubes has its centre of mass and its mass in the model, too."""
    low = box_block("a", (0, 0, 0), (2, 1, 1))
    high = box_block("b", (0, 0, 1), (1, 1, 2))
    faces = (*low.faces, *(tuple(k + 8 for k in face) for face in high.faces))
    shape = type(low)("L", np.concatenate([low.vertices, high.vertices]), faces)
    model = mujoco.MjModel.from_xml_path(str(export_assembly(Assembly((shape,)), "mjcf", tmp_path)))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert np.allclose(data.body("L").xipos, [5 / 6, 0.5, 5 / 6], atol=1e-6)
    assert model.body("L").mass[0] == pytest.approx(3000)


@pytest.mark.parametrize("format", ["mjcf", "compas", "assembly"])
def test_check_and_exports_of_what_is_not_all_built_say_so(
    bridge: Assembly, format: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both look at what stands in the end, which of a refused plan is not the whole structure."""
    some = replace(bridge, steps=bridge.steps[:2], not_built=("lintel", "prop"))
    part, whole = str(tmp_path / "part.json"), str(tmp_path / "whole.json")
    write_assembly(some, part)
    write_assembly(bridge, whole)
    words = "2 of 3; lintel is not built"
    assert main(["check", part]) == 0
    assert words in " ".join(capsys.readouterr().out.split())
    assert main(["export", part, "--format", format, "--out", str(tmp_path / "some")]) == 0
    assert f"blocks: {words}" in capsys.readouterr().out
    main(["check", whole])
    assert main(["export", whole, "--format", format, "--out", str(tmp_path / "all")]) == 0
    assert "not built" not in capsys.readouterr().out


class _Tags(HTMLParser):
    """Counts elements, and refuses those that are closed in another order than opened."""

    def __init__(self) -> None:
        super().__init__()
        self.count: Counter[str] = Counter()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.count[tag] += 1
        if tag not in ("meta", "br", "img", "link", "input", "tr", "td", "th"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def _as_json(file: Path, made: Assembly) -> tuple[int, float]:
    blocks = {block["id"]: block for block in json.loads(file.read_text("utf-8"))["blocks"]}
    stands = [blocks[block.id] for block in made.finished.blocks]
    solids = [
        trimesh.Trimesh(
            block["vertices"],
            [(face[0], *two) for face in block["faces"] for two in pairwise(face[1:])],
        )
        for block in stands
    ]
    assert all(solid.is_watertight for solid in solids)
    return len(stands), float(sum(solid.volume for solid in solids))


def _as_bill(file: Path, made: Assembly) -> tuple[int, float]:
    rows = list(csv.DictReader(io.StringIO(file.read_text("utf-8"))))
    mass = sum(int(row["built_in"]) * float(row["mass_kg"]) for row in rows)
    return sum(int(row["built_in"]) for row in rows), mass / made.blocks[0].density


def _as_cards(file: Path, made: Assembly) -> tuple[int, float]:
    tags = _Tags()
    tags.feed(file.read_text("utf-8"))
    assert not tags.open
    # Table rows but for heads and the bill; a step that takes away stands for no block.
    rows = re.findall(r"<tr><td>\d+<td>[A-Z]+<td>", file.read_text("utf-8"))
    removed = sum(step.remove is not None for step in made.steps)
    return len(rows) - 2 * removed, 0.0


def _as_pdf(file: Path, made: Assembly) -> tuple[int, float]:
    """The numbers of the bill of blocks."""
    pypdf = pytest.importorskip("pypdf")
    text: list[str] = []
    visitor = lambda words, *_: text.append(words.strip())  # noqa: E731
    pypdf.PdfReader(file).pages[0].extract_text(visitor_text=visitor)
    cells = [words for words in text if words]
    start = cells.index("Mass of one") + 1
    return sum(
        int(cells[k + 2]) for k in range(start, len(cells) - 6, 7) if cells[k + 6].endswith("kg")
    ), 0.0


def _as_compas(file: Path, made: Assembly) -> tuple[int, float]:
    compas = pytest.importorskip("compas")
    pytest.importorskip("compas_assembly")
    graph = compas.json_load(file).graph
    stand = [node for node in graph.nodes() if not graph.node_attribute(node, "ground")]
    ids = {block.id for block in made.finished.blocks}
    steps = {k for k, step in enumerate(made.steps, 1) if step.place in ids}
    assert {graph.node_attribute(node, "step") for node in stand} == steps
    assert read_assembly(file).steps == made.steps
    solids = [graph.node_attribute(node, "block") for node in stand]
    return len(solids), float(sum(abs(solid.volume()) for solid in solids))


def _as_glb(file: Path, made: Assembly) -> tuple[int, float]:
    scene = trimesh.load(file)
    return len(scene.geometry), float(scene.volume)


def _as_mjcf(file: Path, made: Assembly) -> tuple[int, float]:
    model = mujoco.MjModel.from_xml_path(str(file))
    return model.nbody - 1, float(model.body_mass.sum()) / made.blocks[0].density


READERS = {
    "assembly": _as_json,
    "bill": _as_bill,
    "cards": _as_cards,
    "compas": _as_compas,
    "glb": _as_glb,
    "mjcf": _as_mjcf,
    "pdf": _as_pdf,
}


@pytest.mark.parametrize("format", [name for name in FORMATS if name != "ldraw"])
@pytest.mark.parametrize("kit", ["bricks-lintels", "tetrominoes"])
def test_every_export_of_a_plan_is_read_back(kit: str, format: str, tmp_path: Path) -> None:
    """Blocks that stand in the end and their volume, as another library reads them. LDraw knows
    bricks only (``test_bricks``)."""
    wanted = np.ones((6, 2, 2), bool)
    if kit == "bricks-lintels":
        wanted = wall(9, 1, 3, (2, 7, 0, 2))
    tiling, ordering = plan_exact(wanted, load_kit(kit))
    assert ordering is not None
    assert ordering.status == "complete"
    made = to_assembly(tiling, ordering, load_kit(kit))
    count, volume = READERS[format](export_assembly(made, format, tmp_path), made)
    assert count == len(made.finished.blocks)
    if format not in ("cards", "pdf"):
        solid = sum(block.volume for block in made.finished.blocks)
        assert volume == pytest.approx(solid, rel=1e-4)


def test_unknown_format_names_the_nearest(bridge: Assembly, tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'mjcf'"):
        export_assembly(bridge, "mjfc", tmp_path / "x")
    assert not list(tmp_path.iterdir())


def test_a_mesh_that_says_no_unit_is_not_taken_for_one_in_metres(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "box.stl"
    box = trimesh.creation.box((100, 100, 100))
    box.apply_translation((0, 0, 50)).export(file)
    assert main(["export", str(file), "--format", "bill", "--out", str(tmp_path / "b.csv")]) == 2
    assert "does not say its unit" in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize("name", ["bench.txt", "arch.ldr"])
def test_it_is_said_that_mujoco_gets_no_joints_of_studs(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(Path(__file__).parents[1] / "examples" / "bricks" / name)
    for format, warns in (("mjcf", True), ("glb", False)):
        assert main(["export", file, "--format", format, "--out", str(tmp_path)]) == 0
        assert ("joints of studs or mortar are not in it" in capsys.readouterr().out) == warns
