"""The measured builds by an arm: every entry once, and what is no result is refused."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l2a_lab import builds
from l2a_lab.measured import measure
from learn2assemble.assembly.kit import load_kit
from learn2assemble.cell.carry_out import Workcell, prepare
from learn2assemble.cell.report import deepest_overlap
from learn2assemble.design.cells import CellDesign
from learn2assemble.errors import InputError
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.robot.bodies import Part, solids


def test_every_measurement_has_a_name_of_its_own() -> None:
    names = builds.names()
    assert len(names) == len(set(names))
    count = len(builds.DESIGNS) * len(builds.ARMS)
    assert sum(name.startswith("noise/") for name in names) == builds.SEEDS * count == 160


def test_what_was_measured_is_not_measured_again(tmp_path: Path) -> None:
    calls: list[str] = []

    def fake(name: str) -> dict[str, Any]:
        calls.append(name)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return {"status": "complete", "reason": None}

    figures = replace(builds.FIGURES, entry=fake)
    out = tmp_path / "builds.json"
    with pytest.raises(KeyboardInterrupt):
        measure(figures, out, only="pyramid.json/panda")
    first = set(json.loads(out.read_text())["entries"])
    assert len(first) == 2
    calls[:] = [""] * 3
    found = measure(figures, out, only="pyramid.json/panda")
    assert not first & set(calls)
    assert set(found["entries"]) == {n for n in builds.names() if "pyramid.json/panda" in n}
    rows = builds.summary(found["entries"])
    got = {what: (asked, words) for what, asked, words in rows}
    assert got["noise"][0] == ">= 95 %, <= 2 mm"
    assert got["noise"][1].startswith("10 of 10; off by 0.00 mm")
    assert {"faults", "guarded", "coarse/touch", "coarse/blind", "worse"} <= got.keys()


def test_other_files_are_not_overwritten(tmp_path: Path) -> None:
    out = tmp_path / "builds.json"
    out.write_text("{}")
    with pytest.raises(InputError, match="--out"):
        measure(builds.FIGURES, out, only="pyramid")
    assert out.read_text() == "{}"
    with pytest.raises(InputError, match="--only"):
        measure(builds.FIGURES, tmp_path / "new.json", only="pyramdi")


@pytest.mark.slow
def test_a_small_example_is_built_and_its_program_played() -> None:
    found = builds.entry("program/arch_pair.json/panda")
    assert found["status"] == "complete"
    assert found["program"]["same"]
    assert found["program"]["worst"] < 2e-3
    assert found["attempts_per_step"] >= 1


def test_contacts_give_more_under_more_weight() -> None:
    """By Hooke, as long as they give by little: that is what blocks at rest are in one another."""
    gives = []
    for count in (2, 4):
        cells = np.ones((1, 1, 2 * count), bool)
        kit = load_kit("cubes").at_pitch((0.04, 0.04, 0.04))
        design = CellDesign("tower", cells, kit.pitch, None, 0.0, None, "", None)
        plan = plan_cells(design, kit)
        job = prepare(plan, Workcell("ur5e", "suction"), kit.joint_gap).job
        found = builds._gives(job)
        assert found is not None
        gives.append(found)
    assert 0 < gives[0] < gives[1] < 1e-4


def test_the_deepest_overlap_is_that_of_the_nearest_two() -> None:
    box = (Part((0.0, 0.0, 0.0), (0.01, 0.01, 0.01)),)
    poses = [np.array([x, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]) for x in (0.0, 0.0197, 0.1)]
    bodies = [solids(box, pose) for pose in poses]
    overlap = deepest_overlap(bodies)
    assert overlap is not None
    assert math.isclose(overlap, 3e-4, abs_tol=1e-9)
    assert deepest_overlap(bodies[1:]) is None
