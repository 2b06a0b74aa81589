"""The exact planner on what people draw: as drawn, proven, and a plan that can be written."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import learn2assemble as l2a
from cell_shapes import wall
from headless import SPATIAL, pixels, shoot
from learn2assemble.assembly.blocks import Assembly, AssemblyStep
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.compas import write_compas
from learn2assemble.assembly.kit import Kind, Kit, load_kit
from learn2assemble.cli import main
from learn2assemble.design.cells import CellDesign
from learn2assemble.design.read import read_design
from learn2assemble.errors import InputError
from learn2assemble.planning.given import plan_assembly
from learn2assemble.planning.plan import BlamedCells, Plan
from learn2assemble.planning.tiling.advice import _trials
from learn2assemble.planning.tiling.construct import plan_cells, report_plan
from learn2assemble.planning.tiling.cover.candidates import placement_cells
from learn2assemble.planning.tiling.cover.tile import tile
from learn2assemble.planning.tiling.ordering import order, to_assembly
from learn2assemble.statics.rigid_blocks import check
from test_ordering import deck

DESIGNS = Path(__file__).resolve().parents[1] / "examples" / "designs"
DRAWN = (
    "gate.svg",
    "t.svg",
    "h.svg",
    "arch.svg",
    "two_towers.svg",
    "circle.svg",
    "figure.png",
    "dome.npy",
    "off_centre_tower.json",
)


def filled(plan: Plan, design: CellDesign) -> np.ndarray:
    """bool[X, Y, Z]: cells whose centre lies in a block that stands in the end."""
    assert plan.assembly is not None
    size = np.array(design.cell)
    index = np.stack(np.meshgrid(*map(np.arange, design.wanted.shape), indexing="ij"), -1)
    shift = np.array([design.wanted.shape[0] / 2, design.wanted.shape[1] / 2, 0])
    centres = (index + 0.5 - shift) * size
    found = np.zeros(design.wanted.shape, int)
    for block in plan.assembly.finished.blocks:
        low, high = block.vertices.min(0), block.vertices.max(0)
        found += ((centres > low) & (centres < high)).all(-1)
    assert found.max() <= 1
    return found.astype(bool)


@pytest.mark.parametrize("name", DRAWN)
def test_drawings_are_built_as_drawn(name: str) -> None:
    design = read_design(DESIGNS / name)
    assert isinstance(design, CellDesign)
    plan = plan_cells(design, "bricks-lintels")
    assert plan.complete, plan.reason
    assert plan.cells is not None
    assert (plan.cells.missing, plan.cells.outside) == (0, 0)
    assert (filled(plan, design) == design.wanted).all()
    assert all(step.proof and step.margin_g is not None for step in plan.steps)
    assert Plan.from_dict(plan.to_dict()) == plan


@pytest.mark.parametrize(
    ("given", "fragment"),
    [
        ({"kit": 5}, "kit: got 5"),
        ({"seed": "x"}, "seed: got 'x'"),
        ({"seed": -1}, "seed: got -1"),
        ({"seconds": -1}, "seconds: got -1"),
        ({"seconds": float("nan")}, "seconds: got nan"),
        ({"friction": "x"}, "friction: got 'x'"),
        ({"friction": (0.1, 0.2, 0.3)}, "friction: got"),
        ({"reading": {"unit": "mm"}}, "argument of build: got 'reading'"),
        ({"unitt": "mm"}, "did you mean 'unit'"),
        ({"frictio": 0.5}, "did you mean 'friction'"),
        ({"supports": "no"}, "supports: got 'no'"),
        ({"supports": "posts"}, "posts carry given blocks"),
        ({"holds": 1}, "they are for given blocks"),
        ({"holds": -1}, "holds: got -1"),
        ({"progress": 3}, "progress: got 3"),
        ({"arm": "panda", "noise": 1}, "noise: got 1"),
        ({"arm": "panda", "noise": ("a", 0)}, "noise: got"),
        ({"arm": "panda", "layout": 3}, "layout: got 3"),
    ],
)
def test_arguments_of_another_kind_are_refused(given: dict[str, Any], fragment: str) -> None:
    with pytest.raises(InputError, match=re.escape(fragment)):
        l2a.build(DESIGNS / "stepped_tower.json", **given)


def test_what_is_no_assembly_is_refused() -> None:
    with pytest.raises(InputError, match="read_assembly"):
        check("wall.json")  # pyright: ignore[reportArgumentType]


def test_colours_of_a_picture_go_to_the_blocks() -> None:
    design = read_design(DESIGNS / "figure.png")
    assert isinstance(design, CellDesign)
    assert design.colours is not None
    plan = plan_cells(design)
    assert plan.assembly is not None
    colours = {block.colour for block in plan.assembly.blocks if not block.prop}
    assert len(colours) > 1


RED, BLUE = (200, 0, 0), (0, 0, 200)


def coloured(wanted: np.ndarray, blue: np.ndarray) -> CellDesign:
    """Cells in red, those of ``blue`` (bool[X, Y, Z]) in blue."""
    colours = np.where(blue[..., None], BLUE, RED).astype(np.uint8)
    return CellDesign("two", wanted, (0.05, 0.05, 0.05), colours, source="test")


def test_a_block_takes_the_most_frequent_colour_of_its_cells() -> None:
    """A lintel that nothing else can stand in for; the report counts its other cells."""
    wanted = np.ones((5, 1, 2), bool)
    wanted[1:4, :, 0] = False
    plan = plan_cells(
        coloured(wanted, np.arange(10).reshape(5, 1, 2) // 2 > 2), "bricks-lintels", props=False
    )
    assert plan.assembly is not None
    assert plan.complete
    found = {(block.kind, block.colour) for block in plan.assembly.blocks}
    assert found == {("1x1", RED), ("1x1", BLUE), ("1x5", RED)}
    assert plan.cells is not None
    assert plan.cells.other_colour == 2


def test_blocks_keep_to_one_colour_where_they_can() -> None:
    """A wall whose left part is red; near shades of red are one colour, and a design of one colour
    is planned as one without."""
    wanted = np.ones((7, 1, 4), bool)
    blue = np.zeros(wanted.shape, bool)
    blue[3:] = True
    design = coloured(wanted, blue)
    plain = replace(design, colours=None)
    tilings = [tile(wanted, load_kit("bricks-lintels"), shades=d.shades) for d in (design, plain)]
    crossing = [
        sum(
            len(set(blue[tuple(placement_cells(p, load_kit("bricks-lintels")).T)])) > 1
            for p in tiling.placements
        )
        for tiling in tilings
    ]
    assert crossing[0] == 0 < crossing[1]
    assert design.colours is not None
    noise = np.random.default_rng(0).integers(0, 12, design.colours.shape)
    noisy = replace(design, colours=(design.colours + noise).astype(np.uint8))
    assert noisy.shades is not None
    assert design.shades is not None
    assert np.array_equal(noisy.shades == noisy.shades[0, 0, 0], ~blue)
    red = replace(design, colours=np.broadcast_to(np.array(RED, np.uint8), (*wanted.shape, 3)))
    assert red.shades is plain.shades is None
    plan = plan_cells(design, "bricks-lintels")
    assert plan.complete
    assert plan.cells is not None
    assert plan.cells.other_colour == 0
    assert plan_cells(plain).cells == replace(plan.cells, other_colour=None)


def test_the_blocks_of_an_elevation_are_enough_or_it_is_refused() -> None:
    wanted = np.ones((4, 1, 3), bool)
    cell = (0.05, 0.05, 0.05)
    design = CellDesign("wall", wanted, cell, None, 0.0, None, "test", "cubes", 12)
    assert plan_cells(design).complete
    plan = plan_cells(replace(design, blocks=11))
    assert plan.status == "refused"
    assert plan.reason == '12 blocks of kit `cubes` are needed; the design has 11 ("blocks")'
    assert plan_cells(replace(design, blocks=3), "bricks-lintels").complete
    keep = read_design(DESIGNS / "keep.json")
    assert isinstance(keep, CellDesign)
    assert keep.blocks == 44


def test_a_span_the_kit_has_no_block_for_is_refused_and_says_so(tmp_path: Path) -> None:
    """A table of cubes: the span needs a lintel, which cubes are not."""
    wanted = np.zeros((5, 1, 2), bool)
    wanted[:, :, 1] = True
    wanted[[0, 4], :, 0] = True
    design = CellDesign("table", wanted, (0.05, 0.05, 0.05), None, 0.0, None, "test", None)
    plan = plan_cells(design, "cubes")
    assert plan.status == "refused"
    assert plan.reason is not None
    assert "cubes" in plan.reason
    # Nothing to build from is written for what has no proven order.
    assert {path.name for path in plan.save(tmp_path, page=False).values()} == {
        "plan.json",
        "assembly.json",
    }
    assert plan_cells(design, "bricks-lintels").complete


def test_cells_to_blame_are_data() -> None:
    wanted = np.zeros((5, 1, 2), bool)
    wanted[:, :, 1] = True
    wanted[[0, 4], :, 0] = True
    design = CellDesign("table", wanted, (0.05, 0.05, 0.04), None, 0.0, None, "test", None)
    plan = plan_cells(design, "cubes")
    assert plan.blamed == (BlamedCells("not carried", ((1, 0, 1), (2, 0, 1), (3, 0, 1))),)
    assert plan.design.cell == (0.05, 0.05, 0.04)
    assert Plan.from_dict(json.loads(json.dumps(plan.to_dict()))) == plan
    assert plan_cells(design, "bricks-lintels").blamed == ()


def test_cells_that_a_heap_leaves_open_are_to_blame() -> None:
    """Three cells and two cells do not fill a square of four."""
    bent = Kind("bent", ((0, 0, 0), (1, 0, 0), (0, 1, 0)), count=1)
    kit = Kit("two", (bent, Kind("pair", ((0, 0, 0), (1, 0, 0)), count=1)))
    wanted = np.ones((2, 2, 1), bool)
    plan = plan_cells(CellDesign("s", wanted, kit.pitch, None, 0.0, None, "test", None), kit)
    assert plan.status == "refused"
    assert [(blame.why, len(blame.cells)) for blame in plan.blamed] == [("not filled", 1)]


def test_a_block_that_cannot_be_placed_is_to_blame() -> None:
    """A bar of four on a post of one cell: it turns over, and nothing else moves."""
    wanted = np.zeros((4, 1, 2), bool)
    wanted[0, 0, 0] = wanted[:, 0, 1] = True
    kit = load_kit("bricks")
    tiling = tile(wanted, kit)
    plan = report_plan(
        CellDesign("post", wanted, kit.pitch, None, 0.0, None, "test", None),
        kit,
        tiling,
        order(tiling, kit),
        seconds=0.0,
        planner="exact",
    )
    assert plan.status == "not found"
    bar = tuple((x, 0, 1) for x in range(4))
    assert plan.blamed == (BlamedCells("cannot be placed", bar),)


def test_tight_joints_are_used_where_no_gap_is_asked_for_and_said() -> None:
    """Two blocks of four cells meet over a gap of four: only their side faces hold them."""
    wanted = wall(10, 1, 3, (3, 7, 0, 2))
    design = CellDesign("deck", wanted, (0.05, 0.05, 0.05), None, 0.0, None, "test", None)
    plan = plan_cells(design, "bricks", gap=0.0, friction=(0.5, 0.6))
    assert plan.complete, plan.reason
    assert (plan.friction_range, plan.gap_range) == ((0.5, 0.6), (0.0, 0.0))
    assert "tight joints" in {step.proof for step in plan.steps}
    assert all(0 < (step.margin_g or 0) <= 0.5 for step in plan.steps)
    assert plan.assembly is not None
    for mu in (0.5, 0.6):
        assert check(plan.assembly, friction=mu).verdict == "stands only with tight joints"
        given = plan_assembly(plan.assembly, friction=mu)  # the same states, read back
        assert given.complete
        assert given.steps[-1].proof == "tight joints"
    assert check(plan.assembly, friction=0.3).verdict == "falls"
    # Other blocks, balanced on their edges and against each other, do with less friction.
    slippery = plan_cells(design, "bricks", gap=0.0, friction=(0.3, 0.6))
    assert slippery.complete
    assert slippery.assembly is not None
    assert check(slippery.assembly, friction=0.3).verdict != "falls"
    assert min(step.margin_g or 0 for step in slippery.steps) > 0
    assert not plan_cells(design, "bricks", gap=0.0, friction=(0.0, 0.6)).complete
    open_ = plan_cells(design, "bricks")
    assert open_.status == "refused"
    told = [text for text, *_ in _trials(tile(wanted, load_kit("bricks")), load_kit("bricks"), {})]
    assert "with tight joints (gap 0) it stands" in told
    assert "with a block of 6 x 1 x 1 cells in the kit it stands" in (open_.reason or "")


def test_props_come_before_tight_joints() -> None:
    design = CellDesign("deck", deck(4), (0.05, 0.05, 0.05), None, 0.0, None, "test", None)
    proofs = {
        props: {s.proof for s in plan_cells(design, "bricks", gap=0.0, props=props).steps}
        for props in (True, False)
    }
    assert "tight joints" not in proofs[True]
    assert "tight joints" in proofs[False]


def bridge(*steps: AssemblyStep) -> Assembly:
    return Assembly(
        (
            box_block("lintel", (0, 0, 1), (3, 1, 2)),
            box_block("left", (0, 0, 0), (1, 1, 1)),
            box_block("right", (2, 0, 0), (3, 1, 1)),
        ),
        steps,
    )


def test_given_blocks_get_an_order_from_below() -> None:
    plan = plan_assembly(bridge())
    assert plan.complete
    assert plan.assembly is not None
    assert [step.place for step in plan.assembly.steps] == ["left", "right", "lintel"]
    assert {step.proof for step in plan.steps} == {"bed faces, local"}
    assert plan.steps[-1].coverage == 1


def test_a_given_order_is_kept_and_its_first_falling_state_named() -> None:
    plan = plan_assembly(
        bridge(
            AssemblyStep(place="left"), AssemblyStep(place="lintel"), AssemblyStep(place="right")
        )
    )
    assert not plan.complete
    assert plan.reason is not None
    assert "lintel" in plan.reason
    assert len(plan.steps) == 1


def test_blocks_that_fall_are_not_called_complete() -> None:
    leaning = Assembly(
        (box_block("low", (0, 0, 0), (1, 1, 1)), box_block("high", (0.7, 0, 1), (1.7, 1, 2)))
    )
    plan = plan_assembly(leaning)
    assert plan.status == "refused"
    assert "'high'" in (plan.reason or "") or "high would move first" in (plan.reason or "")
    assert [step.block for step in plan.steps] == [0]


@pytest.mark.parametrize("shift", [0.2, 0.4])
def test_given_blocks_are_proven_for_joints_that_open(shift: float) -> None:
    """A block is carried as far as its centre is above a bed smaller by half the joint."""
    stack = Assembly(
        (
            box_block("low", (0, 0, 0), (1, 1, 1)),
            box_block("high", (shift, 0, 1), (1 + shift, 1, 2)),
        )
    )
    edge = 1 - 2 * shift
    for gap, stands in ((0.9 * edge, True), (1.1 * edge, False)):
        plan = plan_assembly(stack, gap=(0.0, gap), friction=(0.3, 0.7))
        assert plan.complete == stands
        assert plan.gap_range == (0.0, gap)
        assert plan.friction_range == (0.3, 0.7)
    with pytest.raises(InputError, match="narrowest block"):
        plan_assembly(stack, gap=1.0)


def test_given_blocks_that_press_with_their_sides_need_closed_joints() -> None:
    wanted = wall(10, 1, 3, (3, 7, 0, 2))
    tiling = tile(wanted, load_kit("bricks"))
    made = to_assembly(tiling, None, load_kit("bricks"), gap=0.0)
    for gap in (None, 0.0):
        plan = plan_assembly(made, gap=gap)
        assert plan.complete
        assert plan.steps[-1].proof == "tight joints"
    assert not plan_assembly(made, gap=1e-4).complete
    assert not plan_assembly(made, friction=(0.1, 0.5)).complete


# ---------------------------------------------------------------- command line and public face


def test_build_check_and_export_from_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A drawing becomes a folder of files; what stands in them stands; it is exported."""
    out = tmp_path / "gate"
    assert main(["build", str(DESIGNS / "gate.svg"), "--out", str(out), "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    keys = "status planner blocks props cells_wanted cells_missing cells_outside planning_s proof_s"
    assert {*keys.split(), "seconds", "margin_g", "reason", "files"} <= set(summary)
    assert summary["status"] == "complete"
    assert (summary["cells_missing"], summary["cells_outside"]) == (0, 0)
    names = {"assembly.json", "bill.csv", "cards.html", "plan.json", "progress.png", "view.html"}
    assert {path.name for path in out.iterdir()} == names
    assert main(["check", str(out / "assembly.json"), "--json"]) == 0
    verdict = json.loads(capsys.readouterr().out)
    assert verdict["verdict"] == "stands"
    assert verdict["blocks"] == summary["blocks"]
    assert main(["export", str(out), "--format", "glb", "--out", str(tmp_path)]) == 0
    assert (tmp_path / "structure.glb").stat().st_size > 1000
    loaded = l2a.load_plan(out)
    assert loaded.assembly is not None
    assert len(loaded.assembly.steps) == len(loaded.steps)


def test_the_public_face_plans_a_drawing() -> None:
    plan = l2a.build(DESIGNS / "h.svg", kit="bricks-lintels")
    assert plan.complete
    assert plan.planner == "exact"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["{d}/h.svg", "--kit", "brick"], "did you mean 'bricks'"),
        (["{d}/h.svg", "--planner", "exakt"], "did you mean 'exact'"),
        (["{d}/h.svg", "--planner", "auto"], "got 'auto', expected one of "),
        (["{d}/h.svg", "--gap", "5"], "less than half the pitch"),
        (["{d}/h.svg", "--gap", "1:0.5mm"], "LOW:HIGH"),
        (["{d}/h.svg", "--friction", "-1"], "coefficient of friction"),
        (["{d}/dome.stl"], "unit"),
        (["{d}/dome.npy", "--unit", "mm"], "no such option for NPY"),
    ],
)
def test_bad_calls_end_in_one_line(
    words: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call = [word.replace("{d}", str(DESIGNS)) for word in words]
    try:
        code: object = main(["build", *call, "--out", str(tmp_path / "out")])
    except SystemExit as leave:
        code = leave.code
    errors = capsys.readouterr().err.splitlines()
    assert code == 2
    assert len(errors) == 1  # Nothing is planned before it.
    assert "error:" in errors[0]
    assert told in errors[0]
    assert not (tmp_path / "out").exists()


def test_blocks_are_as_large_as_the_cells_that_were_asked_for() -> None:
    """The same drawing on finer cells has smaller blocks, and the same size."""
    heights = {}
    for cell in (0.05, 0.025):
        plan = l2a.build("examples/designs/gate.svg", cell=cell)
        assert plan.status == "complete"
        assert plan.assembly is not None
        points = np.concatenate([block.vertices for block in plan.assembly.blocks])
        heights[cell] = float(np.ptp(points[:, 2]))
        assert plan.design.block_edge == cell
        single = min(float(np.ptp(block.vertices[:, 2])) for block in plan.assembly.blocks)
        assert single == pytest.approx(cell)
    assert heights[0.05] == pytest.approx(heights[0.025], abs=0.05)
    with pytest.raises(InputError, match="cell"):
        load_kit("bricks").at_pitch((1e-4, 1e-4, 1e-4))


def test_blocks_of_a_compas_file_that_overlap_are_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blocks = (box_block("a", (0, 0, 0), (1, 1, 1)), box_block("b", (0.5, 0, 0), (1.5, 1, 1)))
    write_compas(Assembly(blocks), tmp_path / "over.json")
    out = tmp_path / "out"
    out.mkdir()
    (out / "kept.txt").write_text("before")
    for command in ("build", "check"):
        code = main([command, str(tmp_path / "over.json"), "--out", str(out / command)])
        errors = capsys.readouterr().err.strip().splitlines()
        assert code == 2
        assert [line for line in errors if "error:" in line] == errors[-1:]
        assert "overlap" in errors[-1]
    assert [path.name for path in out.iterdir()] == ["kept.txt"]


def test_a_kit_that_cannot_fill_the_cells_is_refused_and_says_where() -> None:
    pairs = Kit("pairs", (Kind("2x2", ((0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0))),))
    design = CellDesign(
        "odd", np.ones((3, 3, 1), bool), (0.05, 0.05, 0.05), None, 0.0, None, "test", None
    )
    with pytest.raises(InputError, match="multiple of 4 cells; the design has 9") as caught:
        plan_cells(design, pairs)
    assert "\n" not in str(caught.value)
    heap = Kit("heap", (replace(pairs.kinds[0], count=9),))
    plan = plan_cells(design, heap)
    assert plan.status == "refused"


@pytest.mark.browser
def test_the_page_shows_what_was_drawn(browser: str, tmp_path: Path) -> None:
    """Of a gate its opening, of a dome that it narrows upwards, of a picture its colours."""
    anchors = []
    for name in ("gate.svg", "dome.npy", "figure.png"):
        plan = plan_cells(read_design(DESIGNS / name, cell=(0.05, 0.05, 0.05)), "bricks-lintels")
        plan.save(tmp_path / name)
        anchors.append(f"{name}/view.html#step={len(plan.steps)}")
    images, log = shoot(browser, tmp_path, tuple(anchors), (1000, 900), *SPATIAL)
    assert "Uncaught" not in log, log
    gate, dome, figure = (image[235:615, 35:560, :3] for image in images)
    if pixels(gate, "#f1efea") > 0.95 * gate[..., 0].size:
        pytest.skip("this browser has no software WebGL")

    def drawn(image: np.ndarray) -> np.ndarray:
        """bool[h, w]: pixels of blocks (coloured, unlike table and shadow), cut to what is one."""
        found = np.ptp(image, axis=-1) > 0.15
        rows, columns = (np.flatnonzero(found.sum(axis) > 3) for axis in (1, 0))
        return found[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]

    gate = drawn(gate)
    low = gate[int(0.55 * len(gate)) : int(0.8 * len(gate))]
    left, middle, right = (part.mean() for part in np.array_split(low, 3, axis=1))
    assert middle < 0.2 < min(left, right)
    widths = drawn(dome).sum(1)
    assert 0.2 * widths.max() < widths[len(widths) // 20] < 0.9 * widths[len(widths) // 2]
    red, leaf, blue = np.moveaxis(figure, -1, 0)
    green, brown = leaf > 1.5 * np.maximum(red, blue), (red > 1.3 * leaf) & (red < 0.5)
    # Leaves above, a trunk below: 30 cells and 10.
    assert green.sum() > 2 * brown.sum() > 2000
    assert np.flatnonzero(green.any(1)).mean() < np.flatnonzero(brown.any(1)).mean()


def _heap(**counts: int) -> Kit:
    """Straight blocks one cell high by their length in words, so many of each."""
    sizes = {"half": 1, "brick": 2, "long": 4}
    kinds = tuple(
        Kind(name, tuple((x, 0, 0) for x in range(sizes[name])), count)
        for name, count in counts.items()
    )
    return replace(load_kit("bricks"), name="heap", kinds=kinds)


def test_a_heap_that_lacks_blocks_for_props_says_how_many_more_would_do() -> None:
    """A wall over an opening of four cells, whose blocks do not stay until others lie on them."""
    wanted = np.zeros((12, 1, 5), bool)
    wanted[:4, 0, :3] = wanted[8:, 0, :3] = wanted[:, 0, 3:] = True
    design = CellDesign("deck", wanted, (0.05, 0.05, 0.05), None, 0.0, None, "test", None)
    kit = _heap(half=4, long=11)
    plan = plan_cells(design, kit)
    assert plan.status == "not found"
    reason = plan.reason or ""
    assert "nothing below carries 4 cells in a row at level 3 (the first is (4, 0, 3))" in reason
    assert "too few blocks left for props" in reason
    found = re.search(r"with ((?:\d+ x \w+(?:, )?)+) more, for props, it stands", reason)
    assert found, reason
    more = {name: int(n) for n, name in (one.split(" x ") for one in found[1].split(", "))}
    counts = {kind.name: (kind.count or 0) + more.get(kind.name, 0) for kind in kit.kinds}
    assert plan_cells(design, _heap(**counts)).complete


def test_props_are_named_in_advice_only_where_they_are_what_a_heap_lacks() -> None:
    """A wall of odd rows needs a half in each; a bridge of one's own blocks needs props."""
    cell = (0.05, 0.05, 0.05)
    rows = CellDesign("rows", np.ones((5, 1, 3), bool), cell, None, 0.0, None, "test", None)
    plan = plan_cells(rows, _heap(half=1, brick=20))
    assert plan.reason == "the heap of kit `heap` lacks 2 x half; with 2 x half more it stands"
    wanted = np.zeros((12, 1, 5), bool)
    wanted[:4, 0, :3] = wanted[8:, 0, :3] = wanted[:, 0, 3:] = True
    kit = _heap(half=4, long=11)
    tiling = tile(wanted, kit)
    assert "more, for props, it stands" in next(_trials(tiling, kit, {}))[0]
    without = _trials(tiling, kit, {"props_allowed": False})
    assert not any("props" in text or "long more" in text for text, *_ in without)
    fewer = _heap(half=4, long=9)
    assert "more, some for props, it stands" in next(_trials(tiling, fewer, {}))[0]


def test_a_heap_that_is_too_small_says_what_it_lacks() -> None:
    wall = np.ones((10, 1, 2), bool)
    design = CellDesign("wall", wall, (0.05, 0.05, 0.05), None, 0.0, None, "test", None)
    plan = plan_cells(design, _heap(half=1, brick=1, long=1))
    assert plan.status == "refused"
    assert (plan.reason or "").endswith(
        "has 7 cells; the design has 20: it lacks 13, such as 3 x long and 1 x half"
    )
    # Blocks that have no room in the design are none that it lacks.
    narrow = replace(design, wanted=np.ones((3, 1, 4), bool))
    assert (plan_cells(narrow, _heap(half=2, brick=1, long=1)).reason or "").endswith(
        "the design has 12: it lacks 4, such as 2 x brick"
    )
