"""Steps a second beside another library: what is counted are steps."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from l2a_lab import speed
from learn2assemble.errors import MissingExtraError


def test_all_are_measured_by_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []

    def counted(name: str):
        def measure(seconds: float) -> float:
            assert seconds == speed.SECONDS
            calls.append(name)
            return 100.0 * len(calls)

        return measure

    monkeypatch.setattr(speed, "MEASURED", {name: counted(name) for name in "ab"})
    found = speed.entry(speed.RUN)
    assert calls == ["a", "b"] * speed.TURNS
    assert found["a"] == {"median": 500, "lowest": 100, "highest": 900}
    assert speed.summary({speed.RUN: found}) == [
        ("a", "say", "500 a second"),
        ("b", "say", "600 a second"),
    ]
    assert speed.summary({}) == []


def test_the_vector_environment_steps_all_its_worlds(monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[int] = []

    def once(step, seconds: float) -> float:
        steps.append(step())
        return 1.0

    monkeypatch.setattr(speed, "rate", once)
    assert speed._vector(1.0) == 1.0
    assert steps == [speed.BATCH]


def test_the_other_library_is_an_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str):
        raise ImportError(name)

    monkeypatch.setattr(speed.importlib, "import_module", absent)
    with pytest.raises(MissingExtraError, match="speed"):
        speed._packing(1)(1.0)


def test_the_table_of_the_documents_is_that_of_the_file() -> None:
    root = Path(__file__).resolve().parents[2]
    entries = json.loads((root / "results" / "speed.json").read_text(encoding="utf-8"))["entries"]
    text = (root / "docs" / "results.md").read_text(encoding="utf-8")
    own = text.split("## Speed of the environments\n")[1].split("\n## ")[0]
    rows = [line for line in own.splitlines() if line.startswith("|")]
    assert rows == speed.table(entries).splitlines()
