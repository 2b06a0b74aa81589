"""What the types of the public API say, by pyright's own count."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "learn2assemble"


def unsaid(report: dict) -> list[str]:
    """Every public name of a report of ``pyright --verifytypes`` whose type is not said."""
    return [
        symbol["name"]
        for symbol in report["typeCompleteness"]["symbols"]
        if symbol["isExported"] and not symbol["isTypeKnown"]
    ]


@pytest.mark.slow
def test_public_types_are_said() -> None:
    # Pyright asks the Python that it finds first where the package and its libraries are.
    folder = Path(sys.executable).parent
    found = subprocess.run(
        [
            folder / "pyright",
            "--verifytypes",
            "learn2assemble",
            "--ignoreexternal",
            "--outputjson",
        ],
        capture_output=True,
        text=True,
        env=os.environ
        | {"PATH": f"{folder}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT / "src")},
    )
    report = json.loads(found.stdout)
    assert report["typeCompleteness"]["moduleRootDirectory"] == str(SOURCE)
    assert len(report["typeCompleteness"]["symbols"]) > 5000
    assert unsaid(report) == []
    assert report["typeCompleteness"]["completenessScore"] == 1


def test_what_is_not_said_is_seen() -> None:
    """The test above can fail."""
    symbol = {"name": "x", "isExported": True, "isTypeKnown": True}
    report = {"typeCompleteness": {"symbols": [symbol]}}
    assert unsaid(report) == []
    symbol["isTypeKnown"] = False
    assert unsaid(report) == ["x"]
