"""A plan as a value: one schema writes and reads it, and refuses what is none."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from learn2assemble.errors import InputError
from learn2assemble.planning.plan import CellCount, Plan, Step

EXAMPLE = Path(__file__).parent / "data" / "example_plan.json"
NUMBER = st.floats(-9, 9)


def example() -> dict[str, Any]:
    return json.loads(EXAMPLE.read_text())


def test_a_file_of_version_1_is_read() -> None:
    old, plan = example(), Plan.load(EXAMPLE)
    assert old["version"] == 1
    assert plan.status == "complete"
    assert len(plan.steps) == 14
    assert plan.steps[3].position == tuple(old["steps"][3]["position"])
    assert [s.margin_g for s in plan.steps] == [s["stability_margin"] for s in old["steps"]]
    assert plan.margin_g == 0.333
    assert plan.search is not None
    assert plan.search.dropped == 0
    hash(plan)


@given(
    positions=st.lists(st.tuples(NUMBER, NUMBER, NUMBER), max_size=5),
    margin=st.none() | st.floats(0, 10), kind=st.none() | st.text(max_size=5),
    prop=st.booleans(), action=st.sampled_from(["place", "remove"]),
    cells=st.none() | st.builds(CellCount, *[st.integers(0, 999)] * 3),
)  # fmt: skip
def test_writing_and_reading_changes_nothing(
    positions: list, margin: float | None, kind: str | None, prop: bool, action: Any, cells: Any
) -> None:
    steps = tuple(
        Step(
            k, k, where, (1.0, 0.0, 0.0, 0.0), action, kind, prop, margin_g=margin, tilt_deg=margin
        )
        for k, where in enumerate(positions, 1)
    )
    plan = dataclasses.replace(Plan.load(EXAMPLE), steps=steps, cells=cells, kit="bricks")
    text = json.dumps(plan.to_dict(), allow_nan=False)
    again = Plan.from_dict(json.loads(text))
    assert again == plan
    assert json.dumps(again.to_dict()) == text


def test_saving_and_loading(tmp_path: Path) -> None:
    plan = Plan.load(EXAMPLE)
    files = plan.save(tmp_path / "deep" / "folder", page=False)
    assert [path.name for path in files.values()] == ["plan.json"]
    assert sorted(path.name for path in (tmp_path / "deep" / "folder").iterdir()) == ["plan.json"]
    assert Plan.load(tmp_path / "deep" / "folder") == plan
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="can be made"):
        plan.save(tmp_path / "file")


def change(path: str, value: Any) -> Callable[[dict[str, Any]], None]:
    """Set, or with ``...`` remove, what is at a path such as ``steps.2.position``."""

    def act(data: Any) -> None:
        *parents, last = [int(key) if key.isdigit() else key for key in path.split(".")]
        for key in parents:
            data = data[key]
        if value is ...:
            del data[last]
        else:
            data[last] = value

    return act


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("format", "other", "plan: format"),
        ("version", 3, "expected 1 to 2"),
        ("version", True, "an integer"),
        ("status", "complet", "did you mean 'complete'"),
        ("design", ..., "the key 'design'"),
        ("blocks.used", ..., "the key 'used' in blocks"),
        ("steps.2.blok", 1, "did you mean 'block'"),
        ("steps.2.relation", "under", "steps[2].relation"),
        ("steps.2.reference", 3, "steps[2].reference"),
        ("steps.2.block", 24, "steps[2].block"),
        ("steps.2.step", 7, "steps[2].step"),
        ("steps.2.position", [0, 0], "a list of 3 values"),
        ("steps.2.position", [0, 0, math.nan], "a finite number"),
        ("steps.2.position", [0, 0, 1e308], "steps[2].position[2]: got 1e+308"),
        ("steps.2.quaternion", [0, 0, 0, 0], "quaternion of block 3"),
        ("steps.2.stable", 1, "true or false"),
        ("design.frames", [], "design.frames"),
        ("design.block_edge", 0, "design.block_edge"),
        ("design.name", 5, "expected text"),
        ("steps", 3, "expected a list"),
    ],
)
def test_a_broken_plan_is_refused_in_one_line(path: str, value: Any, words: str) -> None:
    data = example()
    change(path, value)(data)
    with pytest.raises(InputError) as caught:
        Plan.from_dict(data)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
