"""Every script in ``examples`` runs, from any folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from scripts import ROOT, run_script

EXAMPLES = ROOT / "examples"
WORDS = {"train": ["40"], "own_network": ["200"], "evaluate": ["2"]}
"""Arguments that make an example small."""
SLOW = {"build_with_arm"}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(path.stem, marks=[pytest.mark.slow] if path.stem in SLOW else [])
        for path in sorted(EXAMPLES.glob("*.py"))
    ],
)
def test_example_runs(name: str, tmp_path: Path) -> None:
    assert run_script(EXAMPLES / f"{name}.py", *WORDS.get(name, []), cwd=tmp_path).strip()
