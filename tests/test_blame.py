"""The page of a design that is not built: which cells are to blame, in space and in words."""

from __future__ import annotations

import dataclasses
import html
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import learn2assemble as l2a
from headless import SPATIAL, browse, find_browser
from learn2assemble.assembly.appearance import PALETTE
from learn2assemble.assembly.blocks import Assembly, AssemblyStep
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.compas import from_compas, to_compas
from learn2assemble.assembly.files import from_json, to_json
from learn2assemble.assembly.instructions import instructions
from learn2assemble.errors import InputError
from learn2assemble.export.formats import mjcf
from learn2assemble.planning.plan import BlamedCells, BlockSupply, Plan
from learn2assemble.viewer.page import write_plan_page
from learn2assemble.viewer.picture import _standing
from learn2assemble.viewer.words import BLAME_WORDS

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
