"""What the documents say of two arms beside one is what was measured."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from l2a_lab.arm_distances import MOMENTS
from l2a_lab.two_arms import EIGHT, holds_told, stops_told, table

ROOT = Path(__file__).resolve().parents[2]
ENTRIES: dict[str, Any] = json.loads(
    (ROOT / "results" / "two_arms.json").read_text(encoding="utf-8")
)["entries"]


def test_the_table_of_the_documents_is_that_of_the_file() -> None:
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    own = text.split("## Two arms\n")[1].split("\n## ")[0]
    rows = [line for line in own.splitlines() if line.startswith("|")]
    assert rows == table(ENTRIES).splitlines()
    assert stops_told(ENTRIES) in own
    assert holds_told(ENTRIES) in own


def test_the_eight_have_as_many_blocks_as_is_said() -> None:
    told = {name: one for name, one in ENTRIES.items() if name.startswith("eight/")}
    assert told
    assert {name.split("/")[1] for name in told} <= set(EIGHT)
    assert all(40 <= one["blocks"] <= 100 for one in told.values())
    assert all(one["moments"] == MOMENTS for one in told.values() if "moments" in one)


def test_the_table_says_what_no_arm_builds_alone() -> None:
    def one(status: str, seconds: float) -> dict[str, Any]:
        return {"status": status, "robot_s": seconds, "blocks": 50, "least_distance": 0.0213}

    found = table(
        {
            "eight/bridge/ur5e": one("complete", 100.0),
            "eight/bridge/panda": one("complete", 80.0),
            "eight/bridge/both": one("complete", 50.0),
            "eight/dome/both": one("complete", 50.0),
            "eight/keep.json/both": one("incomplete", 10.0),
        }
    ).splitlines()
    assert found[2:] == [
        "| keep.json | 50 | incomplete |  |  |  |",
        "| bridge | 50 | 50.0 | 80.0 | 0.62 | 21.3 |",
        "| dome | 50 | 50.0 | no arm alone |  | 21.3 |",
        "| mean of 1 of the eight | | | | 0.62 | |",
    ]
