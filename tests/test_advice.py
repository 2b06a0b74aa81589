"""What is said of a design that is not built. What is advised was tried, and where nothing helps,
nothing is advised; what is refused at once; the page that shows the cells to blame, in space and in
words.
"""

from __future__ import annotations

import dataclasses
import html
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import learn2assemble as l2a
from cell_shapes import wall
from headless import SPATIAL, browse, find_browser
from learn2assemble.assembly.blocks import Assembly, AssemblyStep
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.compas import from_compas, to_compas
from learn2assemble.assembly.files import from_json, to_json
from learn2assemble.assembly.instructions.appearance import PALETTE
from learn2assemble.assembly.instructions.steps import instructions
from learn2assemble.assembly.kit import Kind, Kit, load_kit
from learn2assemble.cli.parser import make_parser
from learn2assemble.design.cells import CellDesign
from learn2assemble.errors import InputError
from learn2assemble.export.formats import mjcf
from learn2assemble.planning.plan import BlamedCells, BlockSupply, Plan
from learn2assemble.planning.tiling import exact
from learn2assemble.planning.tiling.advice import NO_ADVICE, _trials, fill_below, pool
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.planning.tiling.cover.tile import Tiling
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.viewer.page import write_plan_page
from learn2assemble.viewer.picture import _standing
from learn2assemble.viewer.words import BLAME_WORDS

CELL = (0.05, 0.05, 0.05)


def reason_of(wanted: np.ndarray, kit: str | Kit) -> str:
    design = CellDesign("drawn", wanted, CELL, None, 0.0, None, "test", None)
    blocks = load_kit(kit) if isinstance(kit, str) else kit
    plan = plan_cells(design, blocks.at_pitch(CELL), seconds=600)
    assert plan.status in ("refused", "not found")
    assert plan.reason is not None
    return plan.reason


def test_a_block_that_is_advised_builds_the_design() -> None:
    """Over an opening, and over both sides of what carries a row: 3 + 2 and 1 + 3 + 1 tip."""
    lantern = np.zeros((5, 1, 4), bool)
    lantern[1:4, 0, :3] = lantern[:, 0, 3] = True
    straight = replace(
        load_kit("cubes"),
        kinds=tuple(Kind(f"1x{n}", tuple((x, 0, 0) for x in range(n))) for n in (1, 2, 3, 6)),
    )
    for wanted, kit, length in (
        (wall(8, 1, 6, (2, 6, 0, 4)), load_kit("cubes"), 6),
        (lantern, straight, 5),
        (lantern.swapaxes(0, 1), straight, 5),
    ):
        reason = reason_of(wanted, kit)
        assert reason.endswith(f"with a block of {length} x 1 x 1 cells in the kit it stands")
        longer = Kind("longer", tuple((x, 0, 0) for x in range(length)))
        more = replace(kit, kinds=(*kit.kinds, longer))
        tiling, ordering = plan_exact(wanted, more, props_allowed=False)
        assert (ordering or tiling).status == "complete"
    assert "nothing below carries the cell (0, 0, 3), and blocks of kit `cubes` fall" in reason


def test_a_kit_that_is_advised_builds_the_design() -> None:
    gate = wall(8, 1, 6, (2, 6, 0, 4))
    tiling, _ = plan_exact(gate, load_kit("cubes"))
    trials = {text: (cells, kit) for text, cells, kit, _ in _trials(tiling, load_kit("cubes"), {})}
    cells, kit = trials["kit `bricks-lintels` does"]
    assert np.array_equal(cells, gate)
    tiling, ordering = plan_exact(gate, kit)
    assert (ordering or tiling).status == "complete"


def test_cells_that_an_advised_kit_needs_are_said_with_it() -> None:
    """A kit of other cells does in those of the design alone; both ways of asking for them do."""
    flat = 0.08, 0.12, 0.03
    gate = wall(8, 1, 6, (2, 6, 0, 4))
    own = replace(load_kit("cubes"), pitch=flat)
    tiling, _ = plan_exact(gate, own)
    trials = {text: kit for text, _, kit, _ in _trials(tiling, own, {})}
    kit = trials["kit `bricks-lintels` with cells of 80 × 120 × 30 mm does"]
    assert kit.pitch == flat
    tiling, ordering = plan_exact(gate, kit)
    assert (ordering or tiling).status == "complete"
    assert l2a.load_design(gate, cell=flat).cell == flat
    for words in ("80x120x30mm", "80 × 120 × 30 mm", "0.08x0.12x0.03", "8cmx120mmx3cm"):
        asked = make_parser().parse_args(["build", "gate.npy", "--out", "new", "--cell", words])
        assert asked.cell == pytest.approx(flat)


def test_a_wide_overhang_is_filled_or_nothing_is_advised() -> None:
    """A plate of 5 x 5 cells on one cell: no kit, no joint carries it."""
    wanted = np.zeros((5, 5, 2), bool)
    wanted[2, 2, 0] = wanted[:, :, 1] = True
    reason = reason_of(wanted, "bricks")
    filled = fill_below(wanted, np.argwhere(wanted))
    more = int(filled.sum() - wanted.sum())
    within = "within x 0 to 4, y 0 to 4, z 0"
    assert f"filled ({more} cells more, {within}) it stands" in reason or NO_ADVICE in reason
    tiling, ordering = plan_exact(filled, load_kit("bricks").at_pitch(CELL))
    stands = (ordering or tiling).status == "complete"
    assert stands == (NO_ADVICE not in reason)


def test_a_ball_is_tried_on_a_flat_base() -> None:
    x, y, z = np.meshgrid(*[np.arange(9)] * 3, indexing="ij")
    ball = (x - 4) ** 2 + (y - 4) ** 2 + (z - 4) ** 2 <= 17
    trials = {text: cells for text, cells, *_ in _trials(Tiling((), ball), load_kit("bricks"), {})}
    text = "without its lowest 1 level, on a flat base, it stands"
    assert np.array_equal(trials[text], ball[:, :, 1:])
    wall = np.ones((4, 1, 4), bool)
    trials = {text: cells for text, cells, *_ in _trials(Tiling((), wall), load_kit("bricks"), {})}
    assert not any("flat base" in text for text in trials)


def test_larger_cells_are_tried_and_longer_blocks_span_more() -> None:
    """A bar of eight cells bridges eight cells of this size only where cells are twice as large."""
    gate = wall(16, 1, 4, (3, 13, 0, 2))
    kit = load_kit("bricks-lintels")
    trials = {text: rest for text, *rest in _trials(Tiling((), gate), kit, {})}
    cells, larger, _ = trials["with cells twice as large it stands"]
    assert (cells.shape, larger.pitch) == ((8, 1, 2), (0.1, 0.1, 0.1))
    assert (pool(np.ones((3, 1, 3), bool)).shape) == (2, 1, 2)
    tiling, ordering = plan_exact(cells, larger)
    assert (ordering or tiling).status == "complete"
    tiling, ordering = plan_exact(gate, kit)
    assert (ordering or tiling).status != "complete"


# What numbers alone rule out is refused before any program is asked.


def no_program(*_: object, **__: object) -> None:
    """In place of the tiler."""
    raise AssertionError("a program was asked")


@pytest.mark.parametrize(
    ("shape", "kit", "words"),
    [
        ((64, 64, 36), "bricks", "at least 18432 blocks"),
        ((64, 62, 8), "cubes", "at least 31744 blocks"),
    ],
)
def test_designs_of_too_many_blocks_are_refused_at_once(
    shape: tuple[int, int, int], kit: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exact, "tile", no_program)
    with pytest.raises(InputError, match=words):
        plan_exact(np.ones(shape, bool), load_kit(kit))


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ((11, 29, 4), "multiple of 4 cells; a part of level 0 has 319"),
        ((13, 11, 1), "multiple of 4 cells; the design has 143"),
    ],
)
def test_numbers_of_cells_are_looked_at_first(
    shape: tuple[int, int, int], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """319 tetrominoes that are one cell high, in levels of which none can be filled."""
    monkeypatch.setattr(exact, "tile", no_program)
    tiling, ordering = plan_exact(np.ones(shape, bool), load_kit("tetrominoes"))
    assert (tiling.status, ordering) == ("refused", None)
    assert words in tiling.reason


def test_small_parts_are_left_to_the_program_which_says_which_cells() -> None:
    wanted = np.ones((7, 3, 4), bool)
    tiling, _ = plan_exact(wanted, load_kit("tetrominoes"))
    assert tiling.status == "refused"
    assert 0 < len(tiling.missing) < wanted.sum()


DESIGN = Path(__file__).resolve().parents[1] / "examples" / "designs" / "cannot_be_built.json"


@pytest.fixture(scope="module")
def refused() -> Plan:
    plan = l2a.build(DESIGN)
    assert plan.status == "refused"
    return plan


@pytest.fixture
def nothing(refused: Plan) -> Plan:
    """A plan without a block that blames cells."""
    supply = BlockSupply(0, 0)
    blamed = (BlamedCells("not filled", ((0, 0, 0), (4, 0, 3))),)
    return dataclasses.replace(refused, assembly=None, blocks=supply, blamed=blamed, steps=())


def written(plan: Plan, folder: Path) -> str:
    write_plan_page(plan, folder / "view.html")
    return (folder / "view.html").read_text(encoding="utf-8")


def data_of(text: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text)
    assert found
    return json.loads(found[1])


def test_cells_to_blame_lie_where_their_blocks_do(refused: Plan, tmp_path: Path) -> None:
    assert refused.assembly is not None
    text = written(refused, tmp_path)
    (mark,) = data_of(text)["marks"]
    boxes = np.array(mark["boxes"])
    assert len(boxes) == 4, "what hangs over on either side"
    bottom = {round(float(v), 6) for v in boxes[:, 2]}
    assert bottom == {0.1}
    corners = {tuple(np.round(1000 * box[:3]).astype(int).tolist()) for box in boxes}
    # The cell round a block is wider by its joint.
    lower = [b.vertices.min(0) - [5e-5, 5e-5, 0] for b in refused.assembly.blocks]
    assert corners <= {tuple(np.round(1000 * low).astype(int).tolist()) for low in lower}
    words = html.unescape(text)
    assert f"4 cells {BLAME_WORDS['not carried']}: (0, 0, 2), (1, 0, 2), (3, 0, 2)" in words
    assert f"</i>cells {BLAME_WORDS['not carried']}</li>" in words


def test_what_is_refused_does_not_read_as_built(refused: Plan, tmp_path: Path) -> None:
    text = written(refused, tmp_path)
    assert "Nothing is built. The design as blocks: 12 blocks" in text
    assert "What was asked for" in text
    assert "Verified by" not in text


def test_without_a_block_the_cells_to_blame_are_the_picture(nothing: Plan, tmp_path: Path) -> None:
    text = written(nothing, tmp_path)
    assert "No blocks were placed." in text
    assert "2 cells that no blocks of the kit fill: (0, 0, 0), (4, 0, 3)" in text
    data = data_of(text)
    assert data["blocks"] == []
    np.testing.assert_allclose(
        data["marks"][0]["boxes"][1], [0.075, -0.025, 0.15, 0.125, 0.025, 0.2]
    )
    plain = written(dataclasses.replace(nothing, blamed=()), tmp_path)
    assert "<canvas" not in plain
    assert "<script" not in plain


def test_blocks_that_are_not_built_are_kept_in_the_file(refused: Plan) -> None:
    assert refused.assembly is not None
    blocks, name = refused.assembly.blocks, refused.assembly.blocks[0].id
    made = dataclasses.replace(refused.assembly, not_built=(name,))
    again = from_json(to_json(made))
    assert again.not_built == (name,)
    assert len(again.finished.blocks) == len(blocks) - 1
    assert from_compas(to_compas(made)).not_built == (name,)
    for wrong, what in (((name, "x"), r"not_built\[1\]"), (tuple(b.id for b in blocks), "not_")):
        with pytest.raises(InputError, match=what):
            from_json({**to_json(made), "not_built": list(wrong)})


@pytest.mark.browser
def test_cells_to_blame_are_drawn(nothing: Plan, tmp_path: Path) -> None:
    browser = find_browser()
    written(nothing, tmp_path)
    address = (tmp_path / "view.html").as_uri()
    dom, log = browse(browser, tmp_path / "run", address, *SPATIAL, "--dump-dom")
    assert 'data-ready="yes"' in dom, log
    assert "data-error" not in dom
    assert "Uncaught" not in log


def test_what_is_not_built_is_not_in_the_picture_and_keeps_its_colour() -> None:
    """The kind that is not built comes first, so the other has the second colour everywhere."""
    blocks = [
        box_block(name, (0.1 * k, 0, 0), (0.1 * k + 0.05, 0.05, 0.05), kind=name)
        for k, name in enumerate(("left out", "built"))
    ]
    made = Assembly(tuple(blocks), (AssemblyStep("built"),)).as_far_as_placed()
    assert _standing(made, 0).tolist() == [False, False]
    assert _standing(made, 1).tolist() == [False, True]
    assert instructions(made).placements[0].shape.colour == PALETTE[1]
    red, green, blue = (f"{int(PALETTE[1][k : k + 2], 16) / 255:.3f}" for k in (1, 3, 5))
    assert f'rgba="{red} {green} {blue} 1"' in mjcf(made).decode()
