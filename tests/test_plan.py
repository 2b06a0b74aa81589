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

EXAMPLE = Path(__file__).parent / "data" / "example_plan"
NUMBER = st.floats(-9, 9)


def example() -> dict[str, Any]:
    return json.loads((EXAMPLE / "plan.json").read_text())


@pytest.mark.parametrize("version", [1, 2, 4])
def test_plans_of_other_versions_are_refused(version: int) -> None:
    with pytest.raises(InputError) as caught:
        Plan.from_dict(example() | {"version": version}, "my/plan.json")
    assert str(caught.value) == f"my/plan.json: version: got {version}, expected 3"


@given(
    positions=st.lists(st.tuples(NUMBER, NUMBER, NUMBER), max_size=5),
    margin=st.none() | st.floats(0, 10),
    kind=st.none() | st.text(max_size=5),
    prop=st.booleans(),
    action=st.sampled_from(["place", "remove"]),
    cells=st.none() | st.builds(CellCount, *[st.integers(0, 999)] * 3),
)
def test_writing_and_reading_changes_nothing(
    positions: list, margin: float | None, kind: str | None, prop: bool, action: Any, cells: Any
) -> None:
    steps = tuple(
        Step(
            k, k, where, (1.0, 0.0, 0.0, 0.0), action, kind, prop, margin_g=margin, tilt_deg=margin
        )
        for k, where in enumerate(positions, 1)
    )
    plan = dataclasses.replace(
        Plan.load(EXAMPLE), steps=steps, assembly=None, cells=cells, kit="bricks"
    )
    text = json.dumps(plan.to_dict(), allow_nan=False)
    again = Plan.from_dict(json.loads(text))
    assert again == plan
    assert json.dumps(again.to_dict()) == text


def test_saving_and_loading(tmp_path: Path) -> None:
    plan = Plan.load(EXAMPLE)
    files = plan.save(tmp_path / "deep" / "folder", page=False)
    names = ["assembly.json", "bill.csv", "cards.html", "plan.json"]
    assert sorted(path.name for path in files.values()) == names
    assert sorted(path.name for path in (tmp_path / "deep" / "folder").iterdir()) == names
    assert Plan.load(tmp_path / "deep" / "folder") == plan
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="can be made"):
        plan.save(tmp_path / "file")


def test_a_step_names_a_block_of_the_assembly() -> None:
    plan = Plan.load(EXAMPLE)
    steps = (*plan.steps[:-1], dataclasses.replace(plan.steps[-1], block=9))
    with pytest.raises(InputError, match=r"steps\[7\]\.block: got 9, expected 0 to 8"):
        dataclasses.replace(plan, steps=steps)


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
        ("version", True, "an integer"),
        ("status", "complet", "did you mean 'complete'"),
        ("design", ..., "the key 'design'"),
        ("blocks.used", ..., "the key 'used' in blocks"),
        ("steps.2.blok", 1, "did you mean 'block'"),
        ("steps.2.relation", "under", "steps[2].relation"),
        ("steps.2.reference", 3, "steps[2].reference"),
        ("steps.2.block", -1, "steps[2].block"),
        ("steps.2.sides", [0.5], "2 shares, one for each target"),
        ("steps.2.step", 7, "steps[2].step"),
        ("steps.2.position", [0, 0], "a list of 3 values"),
        ("steps.2.position", [0, 0, math.nan], "a finite number"),
        ("steps.2.position", [0, 0, 1e308], "steps[2].position[2]: got 1e+308"),
        ("steps.2.quaternion", [0, 0, 0, 0], "steps[2].quaternion"),
        ("steps.2.prop", 1, "true or false"),
        ("design.targets.0.outline", [[0, 0]], "design.targets[0].outline[0]"),
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
