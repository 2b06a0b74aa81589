"""The sweep of hidden errors: what is measured, and the table of the page."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from l2a_lab import hidden
from learn2assemble.tasks.task import HIDDEN_TASKS

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def entries() -> dict:
    text = (ROOT / "results" / "hidden.json").read_text(encoding="utf-8")
    return json.loads(text)["entries"]


def test_the_table_of_the_page_is_that_of_the_file(entries: dict) -> None:
    page = (ROOT / "docs" / "benchmark.md").read_text(encoding="utf-8")
    assert set(entries) == set(hidden.names())
    assert hidden.page_table(entries) in page
    sturdiest = entries[f"{HIDDEN_TASKS[hidden.TASK].factor:g}/sturdiest first"]
    assert f"completes {sturdiest['completed']} of the {hidden.COUNT}" in page


def test_the_planner_with_repair_completes_what_was_asked(entries: dict) -> None:
    share = {name: one["completed"] / hidden.COUNT for name, one in entries.items()}
    assert 0.6 <= share[f"{HIDDEN_TASKS[hidden.TASK].factor:g}/with repair"] <= 0.8
    assert share["0/with repair"] == 1
    swept = [share[f"{factor:g}/with repair"] for factor in hidden.FACTORS]
    assert swept == sorted(swept, reverse=True)


@pytest.mark.parametrize("who", ["with repair", "sturdiest first"])
def test_a_measurement_counts_what_happens(who: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hidden, "COUNT", 1)
    found = hidden.entry(f"0/{who}")
    assert found == {"score": 1.0, "completed": 1, "falls": 0, "collisions": 0}
    assert hidden.summary({f"0/{who}": found}) == [(f"0/{who}", "say", "100% of 1, score 1.000")]
