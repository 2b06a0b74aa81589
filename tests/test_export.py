"""Assemblies as files of other programs: each is read back by another library."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from learn2assemble.assembly.blocks import Assembly, Step, box_block
from learn2assemble.errors import UnknownNameError
from learn2assemble.export.cards import step_cards
from learn2assemble.export.formats import bill_of_blocks, export_assembly


@pytest.fixture
def bridge() -> Assembly:
    """Two posts and a lintel, with a prop under it that is taken away again."""
    blocks = (
        box_block("left", (0, 0, 0), (0.05, 0.05, 0.05), kind="1x1", colour=(200, 30, 30)),
        box_block("right", (0.1, 0, 0), (0.15, 0.05, 0.05), kind="1x1"),
        box_block("prop", (0.05, 0, 0), (0.1, 0.05, 0.05), kind="1x1", prop=True),
        box_block("lintel", (0, 0, 0.05), (0.15, 0.05, 0.1), kind="1x3"),
    )
    steps = [Step(place=id_) for id_ in ("left", "right", "prop", "lintel")]
    return Assembly(blocks, (*steps, Step(remove="prop")), name="Bridge <1>")


def test_bill_counts_blocks_and_props(bridge: Assembly) -> None:
    rows = {row["kind"]: row for row in csv.DictReader(io.StringIO(bill_of_blocks(bridge)))}
    assert rows["1x1"]["built_in"] == "2"
    assert rows["1x1"]["props"] == "1"
    assert rows["1x3"]["total"] == "1"
    assert float(rows["1x3"]["length_m"]) == pytest.approx(0.15)
    assert float(rows["1x3"]["mass_kg"]) == pytest.approx(0.15 * 0.05 * 0.05 * 1000)


def test_a_prop_used_twice_is_billed_once(bridge: Assembly) -> None:
    again = (*bridge.steps, Step(place="prop"), Step(remove="prop"))
    rows = bill_of_blocks(Assembly(bridge.blocks, again)).splitlines()
    assert rows[1].startswith("1x1,2,1,3,")


def test_cards_have_one_card_a_step(bridge: Assembly) -> None:
    page = step_cards(bridge)
    assert page.count("<article>") == len(bridge.steps)
    assert "Bridge &lt;1&gt;" in page
    assert "take away 1x1 prop (prop)" in page
    assert page.count('class="gone"') == 1


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


def test_unknown_format_names_the_nearest(bridge: Assembly, tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'mjcf'"):
        export_assembly(bridge, "mjfc", tmp_path / "x")
    assert not list(tmp_path.iterdir())
