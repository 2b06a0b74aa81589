"""The figures of the exact planner: measured once, kept, and bounds that hold."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings

from l2a_lab import creep, shapes
from l2a_lab import designs as figures
from l2a_lab.measured import measure
from learn2assemble.cli import main
from learn2assemble.errors import InputError
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.planning.tiling.props import choose_props, unsupported
from learn2assemble.planning.tiling.tile import Tiling
from test_tiling import LINTELS, SMALL, blocks_of, covers, designs


def test_entries_are_measured_once_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "designs.json"
    call = ["measure-designs", "--out", str(out), "--only", "/arch-4"]
    assert main([*call, "--json"]) == 0
    rows = {what: got for what, _, got in json.loads(capsys.readouterr().out)["rows"]}
    assert rows["shapes built"] == "1 of 1; not: none"
    assert rows["limited heap"] == "1 of 1"
    proven = rows["step proofs, second solver"].split()
    assert proven[0] == proven[2] != "0"
    before = json.loads(out.read_text())
    assert set(before["entries"]) == {"shape/arch-4", "heap/arch-4", "proofs/arch-4"}
    assert before["configuration"]["seed"] == figures.SEED
    monkeypatch.setattr(figures, "shape_entry", lambda *_: pytest.fail("measured again"))
    assert measure(figures.FIGURES, out, only="shape/arch-4") == before
    with pytest.raises(InputError, match="--only"):
        measure(figures.FIGURES, out, only="no such thing")
    out.write_text("{}")
    with pytest.raises(InputError, match="--out"):
        measure(figures.FIGURES, out, only="shape/arch-4")
    assert out.read_text() == "{}"


@settings(max_examples=40, deadline=None)
@given(wanted=designs((4, 2, 3)))
def test_no_tiling_takes_fewer_props_than_the_bound(wanted: np.ndarray) -> None:
    least = figures.least_props(wanted, SMALL)
    for number, picked in enumerate(covers(wanted, SMALL)):
        if number >= 40:
            break
        tiling = Tiling(blocks_of(wanted, SMALL, picked), wanted)
        demands = {block: frozenset((block,)) for block in unsupported(tiling, SMALL)}
        props = choose_props(tiling, SMALL, demands)
        assert props is None or len(props) >= least


def test_the_bound_is_reached_by_a_bridge() -> None:
    wanted = shapes.SHAPES["bridge-long"]()
    tiling, _ = plan_exact(wanted, LINTELS)
    props = sum(block.prop for block in tiling.placements)
    assert figures.least_props(wanted, LINTELS) == props == 6
    assert figures.least_props(shapes.SHAPES["arch-8"](), LINTELS) == 0


def test_the_simulation_tells_what_stands() -> None:
    from learn2assemble.planning.tiling.candidates import BlockPlacement
    from learn2assemble.planning.tiling.ordering import to_assembly

    wanted = np.zeros((4, 1, 2), bool)
    wanted[:1, :, 0] = wanted[:, :, 1] = True
    blocks = (BlockPlacement("1x1", 0, (0, 0, 0)), BlockPlacement("1x4", 0, (0, 0, 1)))
    falls = to_assembly(Tiling(blocks, wanted), None, LINTELS)
    stands = to_assembly(Tiling(blocks[:1], wanted), None, LINTELS)
    assert creep.largest_move(falls, 1.0) > 0.01
    assert creep.largest_move(stands, 1.0) < 1e-3
